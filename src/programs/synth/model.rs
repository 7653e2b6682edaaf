//! The apartment as the renderer sees it: textures, lamps, sky, and irradiance cached on the
//! surfaces.

use super::charts::Chart;
use crate::core::brdf::BaseColour;
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, Wrap};
use crate::core::progress::Progress;
use crate::core::trace::Tracer;
use crate::render::{
    Environment, IndirectCache, IrradiancePoint, PathTracer, Surface, SurfaceModel, buried,
};
use glam::{Vec3, Vec4};
use std::collections::HashMap;

/// Materials by texture, class and emission by triangle.
pub struct Textured<'a> {
    mesh: &'a Mesh,
    /// Albedo (x, y, z) and roughness (w).
    pub texture: &'a Plane<Vec4>,
    class: Vec<u16>,
    emission: Vec<Vec3>,
    metallic: Vec<f32>,
    transmission: Vec<f32>,
    has_panes: bool,
}

impl<'a> Textured<'a> {
    /// The model of packed charts; `mesh` holds their triangles in order.
    #[must_use]
    pub fn new(mesh: &'a Mesh, charts: &[Chart], texture: &'a Plane<Vec4>) -> Self {
        let per_triangle = |c: &Chart| std::iter::repeat_n(c.finish, c.triangles.len());
        let finishes: Vec<_> = charts.iter().flat_map(per_triangle).collect();
        Self {
            mesh,
            texture,
            class: finishes.iter().map(|f| f.class).collect(),
            emission: finishes.iter().map(|f| f.emission).collect(),
            metallic: finishes.iter().map(|f| f.metallic).collect(),
            transmission: finishes.iter().map(|f| f.transmission).collect(),
            has_panes: finishes.iter().any(|f| f.transmission > 0.0),
        }
    }
}

impl SurfaceModel for Textured<'_> {
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface {
        let side = self.texture.width as f32;
        let texel = self
            .texture
            .bilinear(self.mesh.uv(triangle, u, v) * side, Wrap::Clamp);
        Surface {
            base: BaseColour {
                colour: texel.truncate(),
                metallic: self.metallic[triangle],
            },
            transmission: self.transmission[triangle],
            roughness: texel.w,
            emission: self.emission[triangle],
        }
    }
    fn mean_emission(&self, triangle: usize) -> Vec3 {
        self.emission[triangle]
    }
    fn label(&self, triangle: usize) -> u16 {
        self.class[triangle]
    }
    fn has_panes(&self) -> bool {
        self.has_panes
    }
}

/// An overcast sky above a grey-green ground, seen through the windows.
pub struct Sky {
    /// Radiance at the horizon.
    pub horizon: Vec3,
    /// Radiance at the zenith.
    pub zenith: Vec3,
    /// Radiance of the ground.
    pub ground: Vec3,
}

impl Environment for Sky {
    fn radiance(&self, d: Vec3) -> Vec3 {
        let sky = self.horizon.lerp(self.zenith, d.y.max(0.0));
        // a soft horizon four degrees wide, so that no pixel depends on a discontinuity
        let t = (d.y / 0.07 + 0.5).clamp(0.0, 1.0);
        self.ground.lerp(sky, t * t * (3.0 - 2.0 * t))
    }
}

/// Irradiance at vertices and in the middle of edges, interpolated over triangles by their
/// quadratic polynomials: towards corners of a room light falls ever faster, and straight lines
/// between vertices would lose 1 % of all bounced light.
pub struct SurfaceIrradiance {
    /// Nodes per triangle: its corners a, b, c and the middles of bc, ca, ab.
    nodes: Vec<[u32; 6]>,
    values: Vec<Vec3>,
}

impl IndirectCache for SurfaceIrradiance {
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        let w = 1.0 - u - v;
        let basis = [w, u, v].map(|x| x * (2.0 * x - 1.0)).into_iter().chain([
            4.0 * u * v,
            4.0 * v * w,
            4.0 * w * u,
        ]);
        let sum: Vec3 = basis
            .zip(&self.nodes[triangle])
            .map(|(b, i)| self.values[*i as usize] * b)
            .sum();
        // a parabola may dip where light falls off steeply
        let least = self.nodes[triangle]
            .iter()
            .fold(Vec3::INFINITY, |m, i| m.min(self.values[*i as usize]));
        sum.max(least)
    }
}

/// Passes of the cache: samples per node, the first with full paths, the others on top of the pass
/// before.
const PASSES: [u32; 3] = [16, 32, 64];
/// A node most of whose view is blocked nearer than this lies inside or under something; metres.
pub(super) const BURIED: f32 = 0.03;

impl SurfaceIrradiance {
    /// The nodes of a mesh, without any light yet.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let (nodes, count) = nodes(mesh);
        Self {
            nodes,
            values: vec![Vec3::ZERO; count],
        }
    }

    /// Steps that [`Self::bake`] reports.
    #[must_use]
    pub fn steps(&self) -> u64 {
        (self.values.len() * PASSES.len()) as u64
    }

    /// Bakes the cache of the same `mesh` with the renderer itself.
    #[must_use]
    pub fn bake(
        mut self,
        mesh: &Mesh,
        tracer: &dyn Tracer,
        renderer: &PathTracer<'_>,
        effort: f32,
        progress: &Progress,
    ) -> Self {
        let points = receivers(mesh, &self.nodes, self.values.len());
        let buried = buried(&points, BURIED, tracer);
        for (pass, samples) in PASSES.into_iter().enumerate() {
            let samples = ((samples as f32 * effort) as u32).max(4);
            let cache = (pass > 0).then_some(&self as &dyn IndirectCache);
            self.values =
                renderer.irradiance_with(&points, samples, 0x1337 + pass as u64, cache, progress);
            self.fill(&buried);
        }
        self
    }

    /// Gives buried nodes the mean of their visible neighbours, ring by ring: the interpolation
    /// across the border of a cupboard's footprint must not darken the floor that can be seen.
    fn fill(&mut self, buried: &[bool]) {
        let mut known: Vec<bool> = buried.iter().map(|b| !b).collect();
        for _ in 0..12 {
            let mut sums = vec![(Vec3::ZERO, 0.0f32); known.len()];
            for &[a, b, c, bc, ca, ab] in &self.nodes {
                for (i, j) in [
                    (a, ab),
                    (ab, b),
                    (b, bc),
                    (bc, c),
                    (c, ca),
                    (ca, a),
                    (ab, bc),
                    (bc, ca),
                    (ca, ab),
                ] {
                    for (to, from) in [(i as usize, j as usize), (j as usize, i as usize)] {
                        if !known[to] && known[from] {
                            sums[to].0 += self.values[from];
                            sums[to].1 += 1.0;
                        }
                    }
                }
            }
            for (i, (sum, count)) in sums.iter().enumerate().filter(|(_, s)| s.1 > 0.0) {
                self.values[i] = *sum / *count;
                known[i] = true;
            }
        }
    }
}

/// The nodes of every triangle, and how many there are: vertices keep their numbers, edges come
/// behind.
fn nodes(mesh: &Mesh) -> (Vec<[u32; 6]>, usize) {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    let mut middle = |i: u32, j: u32| {
        let next = (mesh.positions.len() + edges.len()) as u32;
        *edges.entry((i.min(j), i.max(j))).or_insert(next)
    };
    let nodes = mesh
        .triangles
        .iter()
        .map(|&[a, b, c]| [a, b, c, middle(b, c), middle(c, a), middle(a, b)])
        .collect();
    (nodes, mesh.positions.len() + edges.len())
}

/// One receiver for each of `count` nodes, drawn a little towards the adjacent triangles so that it
/// does not sit in a corner.
fn receivers(mesh: &Mesh, nodes: &[[u32; 6]], count: usize) -> Vec<IrradiancePoint> {
    #[derive(Clone, Copy, Default)]
    struct Node {
        position: Vec3,
        normal: Vec3,
        centres: Vec3,
        face_normals: Vec3,
        triangles: f32,
    }
    let mut sums = vec![Node::default(); count];
    for (t, of_triangle) in nodes.iter().enumerate() {
        let corners = mesh.corners(t);
        let normals = mesh.triangles[t].map(|i| mesh.normals[i as usize]);
        let middle = |v: [Vec3; 3], k: usize| 0.5 * (v[(k + 1) % 3] + v[(k + 2) % 3]);
        let centre = corners.iter().sum::<Vec3>() / 3.0;
        for (k, &i) in of_triangle.iter().enumerate() {
            let n = &mut sums[i as usize];
            (n.position, n.normal) = if k < 3 {
                (corners[k], normals[k])
            } else {
                (
                    middle(corners, k - 3),
                    middle(normals, k - 3).normalize_or_zero(),
                )
            };
            n.centres += centre;
            n.face_normals += mesh.double_area_normal(t);
            n.triangles += 1.0;
        }
    }
    let point = |n: &Node| {
        // within the tangent plane: straight towards the centroid would enter a convex body, and
        // see a lamp from inside
        let inwards = if n.triangles > 0.0 {
            n.centres / n.triangles - n.position
        } else {
            Vec3::ZERO
        };
        let position = n.position + 0.06 * (inwards - n.normal * n.normal.dot(inwards));
        let face_normal = n.face_normals.normalize_or(n.normal);
        IrradiancePoint {
            position: position + n.normal * 2e-4,
            face_normal,
            normal: n.normal,
        }
    };
    sums.iter().map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// Light that falls off quadratically is interpolated exactly, on two triangles that share an
    /// edge.
    #[test]
    fn quadratic_light_is_interpolated_exactly() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 2.0, 0.0), Vec3::Y],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let light = |p: Vec3| Vec3::new(3.0 - p.x * p.x, 4.0 + p.x * p.y - 0.5 * p.y * p.y, 1.0);
        let (nodes, count) = nodes(&mesh);
        assert_eq!(count, 9, "four vertices and five edges");
        let mut values = vec![Vec3::ZERO; count];
        for (t, [a, b, c, bc, ca, ab]) in nodes.iter().copied().enumerate() {
            let at = [
                (a, 0.0, 0.0),
                (b, 1.0, 0.0),
                (c, 0.0, 1.0),
                (bc, 0.5, 0.5),
                (ca, 0.0, 0.5),
                (ab, 0.5, 0.0),
            ];
            at.iter()
                .for_each(|&(i, u, v)| values[i as usize] = light(mesh.position(t, u, v)));
        }
        let cache = SurfaceIrradiance { nodes, values };
        for (t, u, v) in [
            (0, 0.2, 0.3),
            (0, 0.6, 0.1),
            (1, 0.33, 0.33),
            (1, 0.05, 0.9),
        ] {
            let (got, want) = (cache.irradiance(t, u, v), light(mesh.position(t, u, v)));
            assert!(
                (got - want).abs().max_element() < 1e-5,
                "{t} {u} {v}: {got} instead of {want}"
            );
        }
    }
}
