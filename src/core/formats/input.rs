//! Reading what others wrote: regular files of a sane size, nothing else.
//!
//! A scene comes from somebody else. A path in it may lead to a FIFO (reading waits for ever), a
//! device (reading never ends) or a file larger than memory; each is refused before a byte is read.

use crate::{Error, Result};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// Most bytes of a text file: `transforms.json`, room grids, lists of lamps, cameras and edits.
/// Derived: 200,000 frames with their matrices take 40 MB.
pub const MOST_TEXT: u64 = 1 << 30;

/// Most bytes of a mesh, a buffer or an image. Derived: four times the 16,384² pixels of RGBA in
/// single precision that images may have.
pub const MOST_DATA: u64 = 1 << 34;

/// Opens a file for reading if it is a regular one (links are followed).
///
/// # Errors
/// There is no such file, or it is a folder, a FIFO, a socket or a device.
pub fn open_regular(path: &Path) -> Result<File> {
    let cannot = |e: std::io::Error| match e.kind() {
        ErrorKind::NotFound => Error::input(
            path,
            "no such file; check the path where it is named (transforms.json, a list of edits or lights)",
        ),
        _ => Error::input(path, format!("cannot be read: {e}")),
    };
    let found = std::fs::metadata(path).map_err(cannot)?;
    if !found.is_file() {
        let what = if found.is_dir() {
            "a folder"
        } else {
            "a pipe, socket or device"
        };
        return Err(Error::input(
            path,
            format!("is {what}; expected a regular file: name the file itself"),
        ));
    }
    File::open(path).map_err(cannot)
}

/// All bytes of a regular file of at most `most` bytes.
///
/// # Errors
/// As [`open_regular`]; the file is larger, memory does not suffice, or reading fails.
pub fn read_input(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open_regular(path)?;
    let stated = file.metadata().map_or(0, |m| m.len());
    let too_large = |n: u64| {
        Error::input(
            path,
            format!("has {n} bytes; expected at most {most}: split or simplify it"),
        )
    };
    if stated > most {
        return Err(too_large(stated));
    }
    let mut bytes = Vec::new();
    bytes
        .try_reserve_exact(stated as usize)
        .map_err(|e| Error::Failed(format!("{}: no memory for it: {e}", path.display())))?;
    // it may grow while it is read
    file.take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::input(path, format!("cannot be read: {e}")))?;
    match bytes.len() as u64 {
        n if n > most => Err(too_large(n)),
        _ => Ok(bytes),
    }
}

/// [`read_input`] as UTF-8 text of at most [`MOST_TEXT`] bytes.
///
/// # Errors
/// As [`read_input`], or the bytes are no UTF-8.
pub fn read_input_text(path: &Path) -> Result<String> {
    let bytes = read_input(path, MOST_TEXT)?;
    let text = std::str::from_utf8(without_mark(&bytes)).map_err(|e| {
        let at = e.valid_up_to();
        Error::input(path, format!("byte {at} is not UTF-8; save it as UTF-8"))
    })?;
    Ok(text.to_owned())
}

/// Text without the mark of byte order that editors on Windows put before UTF-8.
#[must_use]
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_a_sane_size_are_read() {
        let dir = tempfile::tempdir().expect("temp");
        let file = dir.path().join("a.txt");
        std::fs::write(&file, b"abc").expect("written");
        assert_eq!(read_input(&file, 3).expect("fits"), b"abc");
        assert!(read_input(&file, 2).is_err_and(|e| e.to_string().contains("at most 2")));
        for (path, said) in [
            (Path::new("/dev/zero"), "device"),
            (dir.path(), "folder"),
            (&dir.path().join("none"), "no such file"),
        ] {
            let e = read_input(path, 10).expect_err("refused");
            assert!(e.exit_code() == 2 && e.to_string().contains(said), "{e}");
        }
        // a link to a device is a device, one to a file a file
        let link = dir.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).expect("link");
        assert!(open_regular(&link).is_err());
        let socket = dir.path().join("socket");
        let _held = std::os::unix::net::UnixListener::bind(&socket).expect("socket");
        assert!(open_regular(&socket).is_err());
    }
}
