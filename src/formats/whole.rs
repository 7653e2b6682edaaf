//! Files that appear whole or not at all: written aside in the same folder, then renamed.

use crate::{Error, Result};
use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A file being written beside its final place. Dropped without [`Aside::finish`], it disappears.
#[derive(Debug)]
pub struct Aside {
    temporary: PathBuf,
    target: PathBuf,
    finished: bool,
}

impl Aside {
    /// Makes an empty file beside `target`, in the same folder, so that the later rename cannot
    /// cross file systems.
    pub fn new(target: impl AsRef<Path>) -> Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
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
        loop {
            let mut hidden = std::ffi::OsString::from(".");
            // The number keeps threads apart, the process id other runs.
            hidden.push(name);
            hidden.push(format!(
                ".{}-{}.part",
                std::process::id(),
                COUNT.fetch_add(1, Ordering::Relaxed)
            ));
            let temporary = target.with_file_name(hidden);
            match OpenOptions::new()
                .write(true)
                .create_new(true)
                .open(&temporary)
            {
                Ok(_) => {
                    return Ok(Self {
                        temporary,
                        target,
                        finished: false,
                    });
                }
                // Left over from a killed run that had the same process id.
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(e) => return Err(Error::io(&target, e)),
            }
        }
    }

    /// Where to write.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.temporary
    }

    /// Puts the file in its place, replacing what was there.
    pub fn finish(mut self) -> Result<()> {
        fs::rename(&self.temporary, &self.target).map_err(|e| Error::io(&self.target, e))?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        if !self.finished {
            // Nothing better to do if this fails as well: the write's own error is on its way.
            let _ = fs::remove_file(&self.temporary);
        }
    }
}

/// Writes `bytes` to `path`, whole or not at all.
pub fn atomic_write(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    let path = path.as_ref();
    let aside = Aside::new(path)?;
    fs::write(aside.path(), bytes).map_err(|e| Error::io(path, e))?;
    aside.finish()
}
