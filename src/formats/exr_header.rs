//! The size an OpenEXR file states, read before any library sees it.
//!
//! An OpenEXR file starts with a magic number and a version word; then come attributes — name,
//! type, byte count, value — until an empty name. A hostile `dataWindow` can make a library
//! allocate tables for billions of rows on opening, hence this look at the header's first part.

use std::io::Read;

/// First four bytes of every OpenEXR file.
pub const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Bytes of a header worth looking at: real ones have hundreds, some carry a preview picture.
const LIMIT: u64 = 4 << 20;

/// Width and height of the data window of an OpenEXR file, or what is wrong with its header.
///
/// # Errors
/// If the header is damaged, or its window is empty or too large.
pub fn data_window(file: impl Read) -> Result<(i64, i64), String> {
    let mut bytes = Vec::new();
    file.take(LIMIT)
        .read_to_end(&mut bytes)
        .map_err(|e| e.to_string())?;
    let mut rest = bytes
        .strip_prefix(&MAGIC)
        .ok_or("it does not start like an OpenEXR file")?;
    let cut = "it ends within its header";
    let _version = take(&mut rest, 4).ok_or(cut)?;
    loop {
        let name = text(&mut rest).ok_or(cut)?;
        if name.is_empty() {
            return Err("its header has no data window".into());
        }
        let kind = text(&mut rest).ok_or(cut)?;
        let size = i32_at(take(&mut rest, 4).ok_or(cut)?, 0);
        let size =
            usize::try_from(size).map_err(|_| "an attribute of its header has a negative size")?;
        let value = take(&mut rest, size).ok_or(cut)?;
        if name == b"dataWindow" {
            if kind != b"box2i" || size != 16 {
                return Err("its data window is not a box of integers".into());
            }
            let edge = |i: usize| i64::from(i32_at(value, 4 * i));
            return Ok((edge(2) - edge(0) + 1, edge(3) - edge(1) + 1));
        }
    }
}

/// The next `n` bytes.
fn take<'a>(rest: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (head, tail) = rest.split_at_checked(n)?;
    *rest = tail;
    Some(head)
}

/// The next zero-terminated string, of at most 255 characters.
fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let n = rest.iter().take(256).position(|&b| b == 0)?;
    let name = take(rest, n)?;
    take(rest, 1)?;
    Some(name)
}

fn i32_at(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(window: [i32; 4]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([2, 0, 0, 0]);
        bytes.extend(b"compression\0compression\0\x01\0\0\0\x03");
        bytes.extend(b"dataWindow\0box2i\0\x10\0\0\0");
        window.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes
    }

    #[test]
    fn sizes_are_read_without_overflow() {
        assert_eq!(data_window(&header([0, 0, 1023, 511])[..]), Ok((1024, 512)));
        assert_eq!(data_window(&header([-5, -7, 4, 2])[..]), Ok((10, 10)));
        assert_eq!(
            data_window(&header([i32::MIN, i32::MIN, i32::MAX, i32::MAX])[..]),
            Ok((1 << 32, 1 << 32))
        );
        assert_eq!(data_window(&header([3, 3, 2, 2])[..]), Ok((0, 0)));
    }

    #[test]
    fn every_truncation_is_noticed() {
        let whole = header([0, 0, 9, 9]);
        for n in 0..whole.len() {
            assert!(data_window(&whole[..n]).is_err(), "{n} bytes");
        }
        let mut endless = MAGIC.to_vec();
        endless.resize(1000, b'a');
        assert!(data_window(&endless[..]).is_err());
        let mut negative = header([0, 0, 9, 9]);
        let at = negative.iter().position(|&b| b == 0x10).expect("size");
        negative[at + 3] = 0xff;
        assert!(data_window(&negative[..]).is_err());
    }
}
