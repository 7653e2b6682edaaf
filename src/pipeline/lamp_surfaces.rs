//! Lamps that lie within larger triangles, as on the ceiling of a floor plan: their triangles are
//! cut along the lamps' outlines, so that a light is a set of whole triangles as everywhere else.
//!
//! A triangle of which a part emits is divided at the middles of its edges until its pieces emit
//! everywhere or nowhere, or are as small as the texture's texels. Positions, normals and places in the
//! atlas are interpolated: the surface and its textures stay what they are. Called by the last step
//! of `solve`.

use crate::core::geometry::Mesh;
use crate::core::image::RgbPlane;
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// Edge of the smallest pieces, texels. Derived: the emission of a piece is looked up at seven
/// points, which lie up to half an edge apart.
const SMALLEST: f32 = 2.0;

/// `mesh` with the triangles cut of which a part emits; itself if there are none.
pub(super) fn cut_lamps(mesh: Mesh, emission: &RgbPlane) -> Mesh {
    let mut cut = Cut {
        size: Vec2::new(emission.width as f32, emission.height as f32),
        emission,
        middles: BTreeMap::new(),
        triangles: Vec::with_capacity(mesh.triangles.len()),
        mesh,
    };
    for t in std::mem::take(&mut cut.mesh.triangles) {
        cut.add(t);
    }
    cut.mesh.triangles = cut.triangles;
    cut.mesh
}

struct Cut<'a> {
    mesh: Mesh,
    emission: &'a RgbPlane,
    size: Vec2,
    /// Vertex in the middle of an edge, by the edge's vertices.
    middles: BTreeMap<[u32; 2], u32>,
    triangles: Vec<[u32; 3]>,
}

impl Cut<'_> {
    /// Adds a triangle whole or in pieces.
    fn add(&mut self, triangle: [u32; 3]) {
        let mut open = vec![triangle];
        while let Some(t) = open.pop() {
            if !self.is_mixed(t) {
                self.triangles.push(t);
                continue;
            }
            let [a, b, c] = t;
            let [ab, bc, ca] = [self.middle(a, b), self.middle(b, c), self.middle(c, a)];
            open.extend([[ab, bc, ca], [ca, bc, c], [ab, b, bc], [a, ab, ca]]);
        }
    }

    /// Whether a part of a triangle emits and a part does not, and it is worth cutting.
    fn is_mixed(&self, t: [u32; 3]) -> bool {
        let [a, b, c] = t.map(|v| self.mesh.uvs[v as usize] * self.size);
        let longest = [a.distance(b), b.distance(c), c.distance(a)]
            .into_iter()
            .fold(0.0, f32::max);
        if longest <= SMALLEST {
            return false;
        }
        let steps = longest.ceil() as usize;
        let (mut dark, mut bright) = (false, false);
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f32 / steps as f32, j as f32 / steps as f32);
                // a little inside: the texels at the edges may be the neighbours'
                let (u, v) = (u.mul_add(0.98, 0.0066), v.mul_add(0.98, 0.0066));
                let emits = *self.emission.nearest(a + (b - a) * u + (c - a) * v) != Vec3::ZERO;
                dark |= !emits;
                bright |= emits;
            }
            if dark && bright {
                return true;
            }
        }
        false
    }

    /// The vertex between two others.
    fn middle(&mut self, a: u32, b: u32) -> u32 {
        let key = [a.min(b), a.max(b)];
        let mesh = &mut self.mesh;
        *self.middles.entry(key).or_insert_with(|| {
            let [i, j] = key.map(|v| v as usize);
            mesh.positions
                .push(0.5 * (mesh.positions[i] + mesh.positions[j]));
            mesh.normals
                .push((mesh.normals[i] + mesh.normals[j]).normalize_or(mesh.normals[i]));
            mesh.uvs.push(0.5 * (mesh.uvs[i] + mesh.uvs[j]));
            mesh.positions.len() as u32 - 1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;

    const SIDE: usize = 128;

    fn square() -> Mesh {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from_array);
        Mesh {
            positions: corners
                .map(|c| Vec3::new(4.0 * c.x, 2.5, 4.0 * c.y))
                .to_vec(),
            normals: vec![Vec3::NEG_Y; 4],
            uvs: corners.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn area(mesh: &Mesh, counts: impl Fn(usize) -> bool) -> f32 {
        (0..mesh.triangles.len())
            .filter(|&t| counts(t))
            .map(|t| mesh.area(t))
            .sum()
    }

    /// The pieces make up the ceiling, and those that emit have the lamp's area.
    #[test]
    fn a_lamp_on_a_ceiling_has_triangles_of_its_own() {
        let inside = |x: usize, y: usize| {
            let d = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) - Vec2::new(40.0, 70.0);
            d.length() < 9.0
        };
        let emission = Plane {
            width: SIDE,
            height: SIDE,
            data: (0..SIDE * SIDE)
                .map(|i| {
                    if inside(i % SIDE, i / SIDE) {
                        Vec3::ONE
                    } else {
                        Vec3::ZERO
                    }
                })
                .collect(),
        };
        let mesh = cut_lamps(square(), &emission);
        let mean = crate::solution::triangle_emission(&mesh, &emission);
        assert!((area(&mesh, |_| true) / 16.0 - 1.0).abs() < 1e-4);
        let texel = 16.0 / (SIDE * SIDE) as f32;
        let lit: f32 = (0..mean.len()).map(|t| mean[t].x * mesh.area(t)).sum();
        let expected = emission.data.iter().map(|e| e.x).sum::<f32>() * texel;
        assert!((lit / expected - 1.0).abs() < 0.05, "{lit} for {expected}");
        let touched = area(&mesh, |t| mean[t] != Vec3::ZERO);
        assert!(touched < 1.5 * expected, "{touched} for {expected}");
        assert!(mesh.triangles.len() < 2000, "{}", mesh.triangles.len());
        assert!((0..mesh.triangles.len()).all(|t| mesh.face_normal(t).y.abs() > 0.999));
    }

    #[test]
    fn what_emits_everywhere_or_nowhere_stays_whole() {
        for value in [0.0, 3.0] {
            let emission = Plane::filled(SIDE, SIDE, Vec3::splat(value));
            assert_eq!(cut_lamps(square(), &emission).triangles, square().triangles);
        }
    }
}
