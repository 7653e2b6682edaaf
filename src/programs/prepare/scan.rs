//! A scan that is a mesh and nothing else (3D Scanner App, Record3D, Polycam exports, LiDAR PLY):
//! the geometry for photographs that come from elsewhere.

use super::account::Account;
use super::capture::{Capture, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions};
use crate::error::Result;
use glam::DMat4;
use std::path::{Path, PathBuf};

/// Endings of meshes the program reads.
const MESHES: [&str; 4] = ["glb", "gltf", "obj", "ply"];

/// The importer.
pub struct Scan;

impl Importer for Scan {
    fn kind(&self) -> &'static str {
        "scan"
    }

    fn looks_like(&self) -> &'static str {
        "a mesh alone: one .glb, .gltf, .obj or .ply"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let mut found = meshes(path);
        let expected = format!(
            "{} meshes here, expected one; name the file itself",
            found.len()
        );
        let only = found.pop().filter(|_| found.is_empty());
        Located::new(path, only, expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        account.ignored("materials and colours of the mesh");
        Ok(Capture {
            surface: Some(Surface::File {
                path: located.start.clone(),
                world_from_file: DMat4::IDENTITY,
            }),
            up: Up::Y,
            ..Capture::default()
        })
    }
}

/// Meshes in a folder, or the file itself if it is one.
pub(super) fn meshes(path: &Path) -> Vec<PathBuf> {
    let is_mesh = |p: &PathBuf| {
        let e = p.extension().and_then(|e| e.to_str()).unwrap_or("");
        MESHES.contains(&e.to_ascii_lowercase().as_str())
    };
    if path.is_file() {
        return vec![path.to_path_buf()]
            .into_iter()
            .filter(is_mesh)
            .collect();
    }
    std::fs::read_dir(path)
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path())
        .filter(is_mesh)
        .collect()
}
