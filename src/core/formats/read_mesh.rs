//! Reads a mesh of any known format: a new format gets a file of its own and a line here.

use super::raw_mesh::RawMesh;
use super::{MOST_DATA, gltf, obj, ply, read_input};
use crate::{Error, Result};
use std::path::Path;

/// Reads a mesh; the extension decides the format (`.glb`, `.gltf`, `.obj`, `.ply`).
///
/// # Errors
/// If the file cannot be read, is damaged, or its extension is none of these.
pub fn read_mesh(path: &Path) -> Result<RawMesh> {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    let parse: fn(&[u8], &Path) -> Result<RawMesh> = match extension.as_str() {
        "glb" | "gltf" => gltf::mesh_from_gltf,
        "obj" => obj::mesh_from_obj,
        "ply" => ply::mesh_from_ply,
        _ => {
            return Err(Error::input(
                path,
                format!(
                    "\".{extension}\" is no mesh format known here; convert to .glb, .gltf, .obj or .ply"
                ),
            ));
        }
    };
    parse(&read_input(path, MOST_DATA)?, path)
}
