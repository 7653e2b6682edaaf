//! Which meshes are copies of others: the same triangles, moved, turned and scaled evenly.

use super::Mesh;
use glam::{Mat3, Quat, Vec3};
use std::collections::HashMap;

/// Where a copy stands: `p ↦ scale · rotation · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Above 0.
    pub scale: f32,
    /// Unit quaternion.
    pub rotation: Quat,
    /// In the units of the mesh.
    pub translation: Vec3,
}

impl Similarity {
    /// The place of a point.
    #[must_use]
    pub fn apply(&self, p: Vec3) -> Vec3 {
        self.rotation * (self.scale * p) + self.translation
    }
}

/// A mesh that is a copy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshCopy {
    /// Number of the mesh that it is a copy of, which is none itself and comes before it.
    pub of: usize,
    /// What takes that mesh's vertices to this one's.
    pub placed: Similarity,
}

/// How far a vertex of a copy may be off, as a share of the mesh's extent (derived: a hundred units in the
/// last place of single precision, for places went through a transform or two).
const SHARE: f32 = 1e-5;
/// Cosine from which on two normals are one (derived: 0.5°).
const SAME_NORMAL: f32 = 0.999_96;

/// For each mesh of which it is a copy, if it is one of an earlier one: vertices and triangles in the same
/// order, every vertex within `SHARE` of the extent and `rounding` metres (what places are rounded
/// to), normals turned alike. Texture coordinates may differ.
#[must_use]
pub fn copies(meshes: &[&Mesh], rounding: f32) -> Vec<Option<MeshCopy>> {
    let mut originals: HashMap<(usize, &[[u32; 3]]), Vec<usize>> = HashMap::new();
    let mut out = Vec::with_capacity(meshes.len());
    for (k, mesh) in meshes.iter().enumerate() {
        let key = (mesh.positions.len(), mesh.triangles.as_slice());
        let known = originals.entry(key).or_default();
        let copy = known.iter().find_map(|&of| {
            let placed = similarity(meshes[of], mesh, rounding)?;
            Some(MeshCopy { of, placed })
        });
        if copy.is_none() {
            known.push(k);
        }
        out.push(copy);
    }
    out
}

/// What takes the vertices of `a` to those of `b`, if anything does.
fn similarity(a: &Mesh, b: &Mesh, rounding: f32) -> Option<Similarity> {
    let [i, j, k] = widest_corners(&a.positions)?;
    let sides = |m: &Mesh| [j, k].map(|c| m.positions[c] - m.positions[i]);
    let ([a1, a2], [b1, b2]) = (sides(a), sides(b));
    let scale = b1.length() / a1.length();
    let allowed = SHARE * b1.length() + rounding;
    let alike = ((b2.length() - scale * a2.length()).abs()) <= 2.0 * allowed;
    if !(alike && scale.is_finite() && scale > 0.0) {
        return None;
    }
    let rotation = Quat::from_mat3(&(frame(b1, b2)? * frame(a1, a2)?.transpose())).normalize();
    let turned = Similarity {
        scale,
        rotation,
        translation: Vec3::ZERO,
    };
    let placed = Similarity {
        translation: b.positions[i] - turned.apply(a.positions[i]),
        ..turned
    };
    let near = |(p, q): (&Vec3, &Vec3)| (placed.apply(*p) - *q).length() <= allowed;
    let parallel =
        |(m, n): (&Vec3, &Vec3)| (rotation * *m).dot(*n) >= SAME_NORMAL * m.length() * n.length();
    let all = a.positions.iter().zip(&b.positions).all(near)
        && a.normals.len() == b.normals.len()
        && a.normals.iter().zip(&b.normals).all(parallel);
    all.then_some(placed)
}

/// Three vertices far apart: the first, the farthest from it, the farthest from the line through both.
fn widest_corners(positions: &[Vec3]) -> Option<[usize; 3]> {
    let first = *positions.first()?;
    let farthest = |distance: &dyn Fn(Vec3) -> f32| {
        let far = positions.iter().enumerate().map(|(i, p)| (i, distance(*p)));
        far.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let (j, length) = farthest(&|p| (p - first).length())?;
    let axis = (positions[j] - first).try_normalize()?;
    let (k, off) = farthest(&|p| (p - first).cross(axis).length())?;
    (off > 1e-3 * length).then_some([0, j, k])
}

/// The axes that two sides of a triangle span.
fn frame(x: Vec3, y: Vec3) -> Option<Mat3> {
    let x = x.try_normalize()?;
    let z = x.cross(y).try_normalize()?;
    Some(Mat3::from_cols(x, z.cross(x), z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// A tetrahedron without symmetry.
    fn wedge() -> Mesh {
        let positions = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.1],
            [0.2, 0.7, 0.0],
            [0.1, 0.2, 0.5],
        ];
        Mesh {
            positions: positions.map(Vec3::from_array).to_vec(),
            normals: positions
                .map(|p| (Vec3::from_array(p) - 0.3).normalize())
                .to_vec(),
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]],
        }
    }

    fn placed(mesh: &Mesh, by: Similarity) -> Mesh {
        Mesh {
            positions: mesh.positions.iter().map(|p| by.apply(*p)).collect(),
            normals: mesh.normals.iter().map(|n| by.rotation * *n).collect(),
            ..mesh.clone()
        }
    }

    /// Moved, turned and scaled copies are found with what placed them; each refers to the first.
    #[test]
    fn what_was_placed_is_found_again() {
        let original = wedge();
        let by = |scale: f32, turn: f32| Similarity {
            scale,
            rotation: Quat::from_euler(glam::EulerRot::XYZ, turn, 2.0 * turn, -turn),
            translation: Vec3::new(3.0, -1.0, 8.0 * turn),
        };
        let places = [by(1.0, 0.0), by(1.0, 0.7), by(2.5, 2.9)];
        let meshes: Vec<Mesh> = places.iter().map(|p| placed(&original, *p)).collect();
        let all: Vec<&Mesh> = std::iter::once(&original).chain(&meshes).collect();
        let found = copies(&all, 1e-6);
        assert_eq!(found[0], None);
        for (copy, by) in found[1..].iter().zip(places) {
            let copy = copy.expect("a copy");
            assert_eq!(copy.of, 0);
            for p in &original.positions {
                assert!((copy.placed.apply(*p) - by.apply(*p)).length() < 1e-5);
            }
        }
    }

    /// Mirrored, bent, unevenly scaled and otherwise shaded meshes are no copies, nor are other triangles.
    #[test]
    fn what_only_resembles_is_no_copy() {
        let original = wedge();
        let changed = |change: &dyn Fn(&mut Mesh)| {
            let mut mesh = original.clone();
            change(&mut mesh);
            mesh
        };
        let others = [
            changed(&|m| m.positions.iter_mut().for_each(|p| p.x = -p.x)),
            changed(&|m| m.positions[3].y += 0.001),
            changed(&|m| m.positions.iter_mut().for_each(|p| p.z *= 1.1)),
            changed(&|m| m.normals[0] = -m.normals[0]),
            changed(&|m| m.triangles.swap(0, 1)),
            changed(&|m| m.positions.iter_mut().for_each(|p| *p = Vec3::ZERO)),
        ];
        for (k, other) in others.iter().enumerate() {
            assert_eq!(copies(&[&original, other], 1e-6)[1], None, "{k}");
        }
    }
}
