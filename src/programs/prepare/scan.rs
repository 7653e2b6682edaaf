//! A scan that is a mesh and nothing else (3D Scanner App, Record3D, Polycam exports, LiDAR PLY):
//! the geometry for photographs that come from elsewhere.

use super::account::Account;
use super::capture::{Capture, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, meshes, pictures};
use crate::error::Result;
use std::path::Path;

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
        let pictures = pictures(&located.named).len();
        if pictures > MOST_TEXTURES {
            account.ignored(format!(
                "{pictures} images beside the mesh: no file here tells their poses in a way that is known"
            ));
        }
        Ok(Capture {
            surface: Some(Surface::of_file(located.start.clone())),
            up: Up::Y,
            ..Capture::default()
        })
    }
}

/// More images than this beside a mesh are no textures of it alone.
const MOST_TEXTURES: usize = 3;
