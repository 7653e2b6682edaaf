//! A part of a solution's mesh that a file of another program keeps as an object of its own: a node
//! of `scene.glb`, a prim of `scene.usda`. `programs/export/objects.rs` decides which there are.

use crate::core::geometry::{Mesh, MeshCopy, copies};
use glam::Vec3;
use std::borrow::Cow;

/// Triangles that move together.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshPart {
    /// Name, unlike that of any other part.
    pub name: String,
    /// Where it stands, relative to the solution's origin, metres: its vertices are stored relative
    /// to it.
    pub pivot: Vec3,
    /// Its triangles in the solution's mesh.
    pub triangles: Vec<u32>,
    /// Coarser meshes to show it by from afar, the finest first; empty = none.
    pub levels: Vec<DetailLevel>,
}

/// A coarser mesh of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct DetailLevel {
    /// Geometry, relative to the part's pivot; panes last.
    pub mesh: Mesh,
    /// How many of its triangles are panes.
    pub panes: usize,
    /// Longest distance of a vertex of the part to this mesh, metres.
    pub error: f32,
    /// Share of the picture's height from which on downwards it serves.
    pub coverage: f32,
}

impl MeshPart {
    /// All of a mesh as one part that stands at its origin.
    #[must_use]
    pub fn whole(name: &str, mesh: &Mesh) -> Self {
        Self {
            name: name.to_owned(),
            pivot: Vec3::ZERO,
            triangles: (0..mesh.triangles.len() as u32).collect(),
            levels: Vec::new(),
        }
    }

    /// Some triangles of a mesh, standing at the middle of the lower side of their bounding box
    /// (y is up): where a thing is put down and turned.
    #[must_use]
    pub fn standing(name: String, mesh: &Mesh, triangles: Vec<u32>) -> Self {
        let corners = triangles.iter().flat_map(|&t| mesh.corners(t as usize));
        let (low, high) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| {
            (b.0.min(p), b.1.max(p))
        });
        let middle = 0.5 * (low + high);
        Self {
            name,
            pivot: Vec3::new(middle.x, low.y, middle.z),
            triangles,
            levels: Vec::new(),
        }
    }

    /// Its geometry, relative to its pivot; to the bit as it is where the pivot is 0.
    #[must_use]
    pub fn mesh(&self, whole: &Mesh) -> Mesh {
        let mut mesh = whole.part(&self.triangles);
        if self.pivot != Vec3::ZERO {
            mesh.positions.iter_mut().for_each(|p| *p -= self.pivot);
        }
        mesh
    }
}

/// Which of some parts' meshes, each relative to its pivot, are copies of others; `whole` is the mesh
/// that they are parts of, whose size says to what places are rounded.
#[must_use]
pub fn copies_among(meshes: &[Cow<'_, Mesh>], whole: &Mesh) -> Vec<Option<MeshCopy>> {
    let (low, high) = whole.bounds();
    let rounding = 4.0 * f32::EPSILON * low.abs().max(high.abs()).max_element();
    let meshes: Vec<&Mesh> = meshes.iter().map(Cow::as_ref).collect();
    copies(&meshes, rounding)
}
