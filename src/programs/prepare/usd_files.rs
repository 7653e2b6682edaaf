//! Layers of USD by their path: in a USDZ (a zip archive without compression) or beside the file.
//! Called by `usd_stage`.

use super::usd_layer::Prim;
use super::{usda, usdc};
use crate::core::formats::read_input;
use crate::error::{Error, Result};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A layer larger than this is no room.
const LARGEST_LAYER: u64 = 1 << 28;

/// A file of USD and the layers it can refer to.
pub struct Files {
    /// What was asked for.
    pub file: PathBuf,
    /// Path of the first layer.
    pub root: String,
    /// Layers of an archive; empty for a plain file.
    layers: BTreeMap<String, Vec<u8>>,
}

impl Files {
    /// Opens an archive, or notes where a plain file lies.
    ///
    /// # Errors
    /// An archive that cannot be read or holds no layer.
    pub fn open(file: &Path) -> Result<Self> {
        let fail = |e: &dyn std::fmt::Display| {
            Error::input(file, format!("cannot be read: {e}; export the room again"))
        };
        let name = file
            .file_name()
            .map(|n| n.to_string_lossy().into_owned())
            .unwrap_or_default();
        if !name.to_ascii_lowercase().ends_with(".usdz") {
            return Ok(Self {
                file: file.to_path_buf(),
                layers: BTreeMap::new(),
                root: name,
            });
        }
        let handle = std::fs::File::open(file).map_err(|e| fail(&e))?;
        let mut archive =
            zip::ZipArchive::new(std::io::BufReader::new(handle)).map_err(|e| fail(&e))?;
        let (mut layers, mut root) = (BTreeMap::new(), None);
        for i in 0..archive.len() {
            let mut entry = archive.by_index(i).map_err(|e| fail(&e))?;
            let name = normal(&entry.name().map_err(|e| fail(&e))?);
            if [".usda", ".usd", ".usdc"].iter().any(|e| name.ends_with(e)) {
                let mut bytes = Vec::new();
                entry
                    .by_ref()
                    .take(LARGEST_LAYER)
                    .read_to_end(&mut bytes)
                    .map_err(|e| fail(&e))?;
                // the first layer of the archive is its root (USDZ specification)
                root.get_or_insert_with(|| name.clone());
                layers.insert(name, bytes);
            }
        }
        Ok(Self {
            file: file.to_path_buf(),
            layers,
            root: root.ok_or_else(|| fail(&"the archive holds no layer"))?,
        })
    }

    /// Reads a layer by its path.
    ///
    /// # Errors
    /// A layer that is not there or is damaged.
    pub fn layer(&self, path: &str) -> Result<Prim> {
        let bytes = match self.layers.get(path) {
            Some(bytes) => Cow::Borrowed(bytes),
            None if self.layers.is_empty() => {
                Cow::Owned(read_input(&self.file.with_file_name(path), LARGEST_LAYER)?)
            }
            None => {
                return Err(Error::input(
                    &self.file,
                    format!("the archive has no layer {path}; export the room again"),
                ));
            }
        };
        match bytes.starts_with(usdc::MAGIC) {
            true => usdc::parse(&bytes),
            false => usda::parse(&String::from_utf8_lossy(&bytes)),
        }
        .map_err(|m| Error::input(&self.file, format!("{path}: {m}")))
    }
}

/// A path without `.` and, but for those that lead out of the file's folder, `..`.
fn normal(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|p| *p != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// Where a reference from a layer leads.
#[must_use]
pub fn relative(from: &str, to: &str) -> String {
    if to.starts_with('/') {
        return format!("/{}", normal(to));
    }
    match from.rsplit_once('/') {
        Some((folder, _)) if folder.starts_with('/') => {
            format!("/{}", normal(&format!("{folder}/{to}")))
        }
        Some((folder, _)) => normal(&format!("{folder}/{to}")),
        None => normal(to),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_layer_that_names_them() {
        assert_eq!(relative("a/b/c.usda", "../d/./e.usda"), "a/d/e.usda");
        assert_eq!(relative("Room.usda", "./assets/x.usda"), "assets/x.usda");
        assert_eq!(relative("Room.usda", "../lib/x.usda"), "../lib/x.usda");
        assert_eq!(relative("../lib/x.usda", "../y.usda"), "../y.usda");
        assert_eq!(relative("a/b.usda", "/c/d.usda"), "/c/d.usda");
        assert_eq!(relative("/c/d.usda", "e.usda"), "/c/e.usda");
    }
}
