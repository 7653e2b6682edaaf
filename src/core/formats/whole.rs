//! Files that appear whole or not at all: written aside in the same folder, then renamed.

use crate::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// A file being written beside its final place. Dropped without [`Aside::finish`], it disappears.
#[derive(Debug)]
pub struct Aside {
    temporary: TempPath,
    target: PathBuf,
}

impl Aside {
    /// Makes an empty file beside `target`, in the same folder, so that the later rename cannot
    /// cross file systems.
    ///
    /// # Errors
    /// If `target` names no file, is a folder, or its folder cannot be written to.
    pub fn new(target: impl AsRef<Path>) -> Result<Self> {
        let target = target.as_ref().to_path_buf();
        let Some(name) = target.file_name() else {
            return Err(Error::Failed(format!(
                "{}: not the name of a file",
                target.display()
            )));
        };
        if target.is_dir() {
            return Err(Error::Failed(format!(
                "{}: a folder is in the way of this file; remove or rename it",
                target.display()
            )));
        }
        let mut hidden = std::ffi::OsString::from(".");
        hidden.push(name);
        hidden.push(".");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&hidden).suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // what any new file gets: everyone's, less the user's mask
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let temporary = builder
            .tempfile_in(folder_of(&target))
            .map_err(|e| Error::io(&target, e))?
            .into_temp_path();
        Ok(Self { temporary, target })
    }

    /// Where to write.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.temporary
    }

    /// Puts the file in its place, replacing what was there.
    ///
    /// # Errors
    /// If the file system refuses; the file written aside is then removed.
    pub fn finish(self) -> Result<()> {
        let Self { temporary, target } = self;
        // or a power cut could leave the new name with nothing behind it
        sync(&temporary).map_err(|e| Error::io(&target, e))?;
        temporary
            .persist(&target)
            .map_err(|e| Error::io(&target, e.error))
    }
}

/// The folder that `file` lies in; the current one if its path does not say.
fn folder_of(file: &Path) -> &Path {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Waits until a file's, or a folder's, content is on the disk.
///
/// # Errors
/// It cannot be opened, or the disk reports a failure that writing had not seen.
pub fn sync(path: &Path) -> std::io::Result<()> {
    fs::File::open(path)?.sync_all()
}

/// Removes a file that an earlier run may have left.
///
/// # Errors
/// It is there and cannot be removed.
pub fn remove_if_there(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, e)),
        _ => Ok(()),
    }
}

/// Writes `bytes` to `path`, whole or not at all.
///
/// # Errors
/// If `path` is a folder, or its folder cannot be written to.
pub fn atomic_write(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    let path = path.as_ref();
    let aside = Aside::new(path)?;
    fs::write(aside.path(), bytes).map_err(|e| Error::io(path, e))?;
    aside.finish()
}
