//! Files of one result, written aside and renamed into place together.

use super::whole::sync;
use crate::error::{Error, Result};
use std::path::Path;

/// A hidden folder for files in the making; removed when dropped.
#[derive(Debug)]
pub struct AsideFolder {
    folder: tempfile::TempDir,
}

impl AsideFolder {
    /// Creates `target` and an empty hidden folder in it.
    ///
    /// # Errors
    /// If `target` is a file or cannot be written to.
    pub fn new(target: &Path) -> Result<Self> {
        std::fs::create_dir_all(target).map_err(|e| Error::io(target, e))?;
        let folder = tempfile::Builder::new()
            .prefix(".writing-")
            .tempdir_in(target)
            .map_err(|e| Error::io(target, e))?;
        Ok(Self { folder })
    }

    /// Where to write.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Renames the named files into `target`, in order, once all of them are on the disk.
    ///
    /// # Errors
    /// If the file system refuses one; those before it have then been renamed.
    pub fn publish<N: AsRef<Path>>(&self, target: &Path, names: &[N]) -> Result<()> {
        for name in names {
            let to = target.join(name);
            sync(&self.path().join(name)).map_err(|e| Error::io(&to, e))?;
        }
        for name in names {
            let to = target.join(name);
            std::fs::rename(self.path().join(name), &to).map_err(|e| Error::io(&to, e))?;
        }
        sync(target).map_err(|e| Error::io(target, e))
    }
}
