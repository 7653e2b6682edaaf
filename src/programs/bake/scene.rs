//! From a glTF file to what is traced: one mesh of all pieces, their materials and lights.

use super::looks::Looks;
use crate::core::formats::{GltfFile, GltfLight, GltfLightKind, Piece};
use crate::core::geometry::{Mesh, triangle_normal};
use crate::error::{Error, Result};
use crate::render::{PointLight, Shape};
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;
use std::path::Path;

/// A triangle of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of the piece.
    pub(super) piece: usize,
    /// Number of the triangle in it.
    pub(super) triangle: usize,
}

/// A file's scene. Its mesh has no texture coordinates yet.
pub(super) struct BakeScene {
    /// The file's surfaces, in the order in which they are written again.
    pub(super) pieces: Vec<Piece>,
    /// All triangles with an area, relative to the middle of the scene.
    pub(super) mesh: Mesh,
    /// Where each of them comes from.
    pub(super) places: Vec<Place>,
    /// Materials of each.
    pub(super) looks: Looks,
    /// Lights without extent.
    pub(super) lights: Vec<PointLight>,
}

impl BakeScene {
    /// Reads the scene of a file; `notes` gathers what of it the light does not know.
    ///
    /// # Errors
    /// The file is damaged, or none of its triangles has an area.
    pub(super) fn read(
        file: &GltfFile<'_>,
        path: &Path,
        notes: &mut BTreeSet<String>,
    ) -> Result<Self> {
        let pieces = file.pieces()?;
        let mut looks = Looks::read(file, notes)?;
        note_motion(file, notes);
        let origin = middle(&pieces, path)?;
        let (mut mesh, mut places) = (Mesh::default(), Vec::new());
        for (number, piece) in pieces.iter().enumerate() {
            let first = mesh.positions.len() as u32;
            let local = |p: &DVec3| (*p - origin).as_vec3();
            mesh.positions.extend(piece.positions.iter().map(local));
            let smooth = usable_normals(piece);
            // (of flat pieces, whose triangles bring their own vertices, they are not used)
            let spare = vec![Vec3::Y; piece.positions.len()];
            mesh.normals.extend(smooth.as_ref().unwrap_or(&spare));
            for triangle in 0..piece.triangles.len() {
                let mut corners = piece.triangles[triangle].map(|v| first + v);
                let own = corners.map(|v| mesh.positions[v as usize]);
                let Some(normal) = triangle_normal(own) else {
                    continue;
                };
                if smooth.is_none() {
                    let next = mesh.positions.len() as u32;
                    mesh.positions.extend(own);
                    mesh.normals.extend([normal; 3]);
                    corners = [next, next + 1, next + 2];
                }
                mesh.triangles.push(corners);
                places.push(Place {
                    piece: number,
                    triangle,
                });
                looks.push(piece, triangle);
            }
        }
        if mesh.triangles.is_empty() {
            return Err(Error::input(
                path,
                "none of its triangles has an area; expected a surface in metres. Check the export",
            ));
        }
        let lights = file.lights()?;
        let light = |l: &GltfLight| point_light(l, origin);
        Ok(Self {
            pieces,
            mesh,
            places,
            looks,
            lights: lights.iter().map(light).collect(),
        })
    }
}

/// Middle of the bounding box.
fn middle(pieces: &[Piece], path: &Path) -> Result<DVec3> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for piece in pieces {
        for &v in piece.triangles.iter().flatten() {
            let p = piece.positions[v as usize];
            if !(p.is_finite() && p.abs().max_element() < 1e9) {
                return Err(Error::input(
                    path,
                    format!(
                        "mesh {} of node {}: vertex {v} lies at {p}; expected metres within 1e9 of the origin. Repair the mesh",
                        piece.mesh, piece.node
                    ),
                ));
            }
            (low, high) = (low.min(p), high.max(p));
        }
    }
    Ok(0.5 * (low + high))
}

/// Unit normals of all vertices, if the file has them; without, glTF wants flat triangles.
fn usable_normals(piece: &Piece) -> Option<Vec<Vec3>> {
    let unit = |n: &Vec3| n.try_normalize().filter(|n| n.is_finite());
    piece.normals.as_ref()?.iter().map(unit).collect()
}

fn point_light(light: &GltfLight, origin: DVec3) -> PointLight {
    let shape = match light.kind {
        GltfLightKind::Point => Shape::Bulb,
        GltfLightKind::Spot(angles) => Shape::Spot(angles.map(|a| a.cos() as f32)),
        GltfLightKind::Directional => Shape::Distant,
    };
    PointLight {
        position: (light.position - origin).as_vec3(),
        intensity: light.intensity,
        axis: light.direction.as_vec3(),
        shape,
    }
}

/// Says what moves in the file: it is lit as it stands without its animations.
fn note_motion(file: &GltfFile<'_>, notes: &mut BTreeSet<String>) {
    let has = |key: &str| file.root()[key].as_array().is_some_and(|l| !l.is_empty());
    if has("skins") {
        notes.insert("skins are ignored: skinned meshes are lit in their bind pose".into());
    }
    if has("animations") {
        notes.insert("animations are ignored: everything is lit where its node stands".into());
    }
    let targets = |p: &serde_json::Value| p["targets"].is_array();
    let primitives = |m: &serde_json::Value| {
        m["primitives"]
            .as_array()
            .is_some_and(|l| l.iter().any(targets))
    };
    let meshes = file.root()["meshes"].as_array();
    if meshes.is_some_and(|l| l.iter().any(primitives)) {
        notes.insert("morph targets are ignored, and left out of what is written".into());
    }
}
