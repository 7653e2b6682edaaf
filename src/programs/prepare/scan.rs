//! A scan that is a mesh and nothing else (3D Scanner App, Record3D, Polycam exports, LiDAR PLY):
//! the geometry for photographs that come from elsewhere.

use super::account::Account;
use super::capture::{Capture, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, meshes};
use crate::error::Result;
use glam::DMat4;
use std::path::{Path, PathBuf};

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
        let pictures = pictures_beside(&located.named);
        if pictures > MOST_TEXTURES {
            account.ignored(format!(
                "{pictures} images beside the mesh: no file here tells their poses in a way that is known"
            ));
        }
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

/// More images than this beside a mesh are no textures of it alone.
const MOST_TEXTURES: usize = 3;

/// Images in a folder; 0 where a file was named.
fn pictures_beside(named: &Path) -> usize {
    let entries = std::fs::read_dir(named).into_iter().flatten().flatten();
    let is_picture = |p: &PathBuf| {
        let e = p.extension().and_then(|e| e.to_str()).unwrap_or("");
        ["jpg", "jpeg", "png", "exr", "hdr", "heic"].contains(&e.to_ascii_lowercase().as_str())
    };
    entries.map(|e| e.path()).filter(is_picture).count()
}
