//! A mesh as a file holds it: not yet validated, in the file's own coordinates and precision.

use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::path::Path;

/// Triangles as read from a file. Indices may be out of range and positions non-finite: `scene`
/// decides what is usable.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawMesh {
    /// Vertex positions in file coordinates; f64 because scenes far from their origin would lose
    /// millimetres in f32.
    pub positions: Vec<DVec3>,
    /// Vertex normals; empty where the file has none for at least one part, else as long as
    /// `positions`.
    pub normals: Vec<Vec3>,
    /// Texture coordinates with v = 0 at texture row 0; empty where at least one part has none,
    /// else as long as `positions`.
    pub uvs: Vec<Vec2>,
    /// Vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// One piece of a file's geometry on its way into a [`RawMesh`].
#[derive(Default)]
pub(super) struct Part {
    pub positions: Vec<DVec3>,
    pub normals: Option<Vec<Vec3>>,
    pub uvs: Option<Vec<Vec2>>,
    pub triangles: Vec<[u32; 3]>,
}

impl RawMesh {
    /// Joins parts; an attribute one part lacks is dropped from the whole, because half an atlas is
    /// no atlas.
    pub(super) fn from_parts(parts: Vec<Part>, path: &Path) -> Result<Self> {
        let total: usize = parts.iter().map(|p| p.positions.len()).sum();
        if u32::try_from(total).is_err() {
            return Err(Error::input(
                path,
                format!(
                    "{total} vertices; at most {} are supported. Simplify the mesh",
                    u32::MAX
                ),
            ));
        }
        let with_normals = parts.iter().all(|p| p.normals.is_some());
        let with_uvs = parts.iter().all(|p| p.uvs.is_some());
        let mut mesh = Self::default();
        for part in parts {
            let first = mesh.positions.len() as u64;
            let count = part.positions.len();
            for t in part.triangles {
                if let Some(bad) = t.iter().find(|&&i| i as usize >= count) {
                    return Err(Error::input(
                        path,
                        format!(
                            "a triangle uses vertex {bad}, but its part has {count} vertices; export the mesh again"
                        ),
                    ));
                }
                mesh.triangles
                    .push(t.map(|i| (first + u64::from(i)) as u32));
            }
            mesh.positions.extend(part.positions);
            if with_normals {
                mesh.normals.extend(part.normals.unwrap_or_default());
            }
            if with_uvs {
                mesh.uvs.extend(part.uvs.unwrap_or_default());
            }
        }
        Ok(mesh)
    }
}
