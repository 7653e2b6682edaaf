//! The scene folder that `prepare` writes into.

use crate::core::formats::Marked;
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use crate::scene::StagedScene;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// File that marks a folder as ours: it may be replaced.
pub(super) const MARK: &str = "prepare.json";
/// Folders of a scene that a capture may leave empty.
const FOLDERS: [&str; 4] = ["images", "labels", "masks", "depth"];

/// The scene folder under construction.
pub(super) struct SceneFolder(StagedScene);

impl SceneFolder {
    /// Begins a folder; refuses to replace one that `unbake prepare` did not write.
    pub(super) fn new(target: &Path) -> Result<Self> {
        StagedScene::new(target, "prepare", MARK, &FOLDERS).map(Self)
    }

    pub(super) fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.0.at(name)
    }

    pub(super) fn write_json(&self, name: &str, value: &Value) -> Result<()> {
        self.0.write_json(name, value)
    }

    /// Writes linear radiance.
    pub(super) fn write_radiance(&self, name: &str, image: &RgbPlane) -> Result<()> {
        Marked("").radiance(&self.at(name), image)
    }

    /// Copies (or links) a file of the capture.
    pub(super) fn take(&self, from: &Path, name: &str, link: bool) -> Result<()> {
        let to = self.at(name);
        let from = from
            .canonicalize()
            .map_err(|e| Error::input(from, format!("cannot be read: {e}")))?;
        if link && std::os::unix::fs::symlink(&from, &to).is_ok() {
            return Ok(());
        }
        // not fs::copy: a capture's files may be read-only, the scene's are the user's own
        let mut source = fs::File::open(&from)
            .map_err(|e| Error::input(&from, format!("cannot be read: {e}")))?;
        let mut target = fs::File::create(&to).map_err(|e| Error::io(&to, e))?;
        std::io::copy(&mut source, &mut target).map_err(|e| Error::io(&to, e))?;
        Ok(())
    }

    /// Renames the folder into place.
    pub(super) fn publish(self) -> Result<()> {
        for folder in FOLDERS {
            // only empty ones can be removed this way
            let _ = fs::remove_dir(self.at(folder));
        }
        self.0.publish()
    }
}

/// Extension of a file in small letters; `bin` without one.
pub(super) fn extension(path: &Path) -> String {
    path.extension().map_or_else(
        || "bin".into(),
        |e| e.to_string_lossy().to_ascii_lowercase(),
    )
}
