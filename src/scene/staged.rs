//! A scene folder under construction: written beside its destination, then renamed into place, by
//! the programs that make scenes (`synth`, `prepare`).

use crate::error::{Error, Result};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// A folder beside its destination; dropped unpublished, it disappears.
pub struct StagedScene {
    target: PathBuf,
    temporary: PathBuf,
}

impl StagedScene {
    /// Begins a folder with the given folders in it. `mark` is the file by which `verb` knows a
    /// folder that it wrote itself and may replace.
    ///
    /// # Errors
    /// If the destination holds something that `verb` did not write, or cannot be written to.
    pub fn new(target: &Path, verb: &str, mark: &str, folders: &[&str]) -> Result<Self> {
        let occupied = target.is_file()
            || fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_some());
        if occupied && !target.join(mark).is_file() {
            let message = format!(
                "exists and was not written by `unbake {verb}`; name another folder or remove it first"
            );
            return Err(Error::input(target, message));
        }
        let name = target
            .file_name()
            .ok_or_else(|| Error::input(target, "is not a folder name; name one to create"))?;
        let temporary = target.with_file_name(format!(
            ".{}.{}.partial",
            name.to_string_lossy(),
            std::process::id()
        ));
        let staged = Self {
            target: target.to_path_buf(),
            temporary,
        };
        for folder in folders {
            let path = staged.at(folder);
            fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        }
        Ok(staged)
    }

    /// A place in the folder under construction.
    #[must_use]
    pub fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.temporary.join(name)
    }

    /// Writes a file of bytes.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.at(name);
        fs::write(&path, bytes).map_err(|e| Error::io(&path, e))
    }

    /// Writes a file of JSON.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn write_json(&self, name: &str, value: &Value) -> Result<()> {
        self.write(name, format!("{value:#}\n").as_bytes())
    }

    /// Renames the folder into place, in the stead of what was there.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn publish(self) -> Result<()> {
        if self.target.exists() {
            fs::remove_dir_all(&self.target).map_err(|e| Error::io(&self.target, e))?;
        }
        if let Some(parent) = self.target.parent().filter(|p| !p.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(|e| Error::io(parent, e))?;
        }
        fs::rename(&self.temporary, &self.target).map_err(|e| Error::io(&self.target, e))
    }
}

impl Drop for StagedScene {
    fn drop(&mut self) {
        // after `publish` the folder is no longer here; after a failure nothing of it shall stay
        let _ = fs::remove_dir_all(&self.temporary);
    }
}
