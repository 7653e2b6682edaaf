//! The apartment as the renderer sees it: textures, lamps, sky, and irradiance cached at vertices.

use super::charts::Chart;
use crate::brdf::Material;
use crate::geometry::Mesh;
use crate::image::{Plane, Wrap};
use crate::parallel::map_chunks;
use crate::progress::Progress;
use crate::render::{Environment, IndirectCache, IrradiancePoint, PathTracer, Surface, SurfaceModel};
use crate::trace::{Ray, Tracer};
use glam::{Vec3, Vec4};

/// Materials by texture, class and emission by triangle.
pub struct Textured<'a> {
    mesh: &'a Mesh,
    /// Albedo (x, y, z) and roughness (w).
    pub texture: &'a Plane<Vec4>,
    class: Vec<u16>,
    emission: Vec<Vec3>,
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
        }
    }
}

impl SurfaceModel for Textured<'_> {
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface {
        let side = self.texture.width as f32;
        let texel = self.texture.bilinear(self.mesh.uv(triangle, u, v) * side, Wrap::Clamp);
        Surface { material: Material { albedo: texel.truncate(), roughness: texel.w }, emission: self.emission[triangle] }
    }
    fn mean_emission(&self, triangle: usize) -> Vec3 {
        self.emission[triangle]
    }
    fn label(&self, triangle: usize) -> u16 {
        self.class[triangle]
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
    /// Window openings.
    pub portals: Vec<[Vec3; 3]>,
}

impl Environment for Sky {
    fn radiance(&self, d: Vec3) -> Vec3 {
        let sky = self.horizon.lerp(self.zenith, d.y.max(0.0));
        // a soft horizon four degrees wide, so that no pixel depends on a discontinuity
        let t = (d.y / 0.07 + 0.5).clamp(0.0, 1.0);
        self.ground.lerp(sky, t * t * (3.0 - 2.0 * t))
    }
    fn portals(&self) -> &[[Vec3; 3]] {
        &self.portals
    }
}

/// Irradiance at vertices, interpolated over triangles.
pub struct VertexIrradiance<'a> {
    mesh: &'a Mesh,
    values: Vec<Vec3>,
}

impl IndirectCache for VertexIrradiance<'_> {
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.mesh.triangles[triangle].map(|i| self.values[i as usize]);
        a + (b - a) * u + (c - a) * v
    }
}

/// Passes of the cache: samples per vertex, the first with full paths, the others on top of the pass before.
const PASSES: [u32; 3] = [24, 48, 128];
/// A vertex most of whose view is blocked nearer than this lies inside or under something; metres.
const BURIED: f32 = 0.03;

impl<'a> VertexIrradiance<'a> {
    /// Steps that [`Self::bake`] reports.
    #[must_use]
    pub fn steps(mesh: &Mesh) -> u64 {
        (mesh.positions.len() * PASSES.len()) as u64
    }

    /// Bakes the cache with the renderer itself.
    #[must_use]
    pub fn bake(mesh: &'a Mesh, tracer: &dyn Tracer, renderer: &PathTracer<'_>, effort: f32, progress: &Progress) -> Self {
        let points = receivers(mesh);
        let buried = buried(&points, tracer);
        let mut out = Self { mesh, values: Vec::new() };
        for (pass, samples) in PASSES.into_iter().enumerate() {
            let samples = ((samples as f32 * effort) as u32).max(4);
            let cache = (pass > 0).then_some(&out as &dyn IndirectCache);
            let values = renderer.irradiance_with(&points, samples, 0x1337 + pass as u64, cache, progress);
            out.values = values;
            out.fill(&buried);
        }
        out
    }

    /// Gives buried vertices the mean of their visible neighbours, ring by ring: the interpolation across the border of
    /// a cupboard's footprint must not darken the floor that can be seen.
    fn fill(&mut self, buried: &[bool]) {
        let mut known: Vec<bool> = buried.iter().map(|b| !b).collect();
        for _ in 0..6 {
            let mut sums = vec![(Vec3::ZERO, 0.0f32); known.len()];
            for t in &self.mesh.triangles {
                for (i, j) in [(0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)] {
                    let (to, from) = (t[i] as usize, t[j] as usize);
                    if !known[to] && known[from] {
                        sums[to].0 += self.values[from];
                        sums[to].1 += 1.0;
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

/// One receiver per vertex, drawn a little towards the adjacent triangles so that it does not sit in a corner.
fn receivers(mesh: &Mesh) -> Vec<IrradiancePoint> {
    let mut sums = vec![(Vec3::ZERO, 0.0f32, Vec3::ZERO); mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let centre = mesh.corners(t).iter().sum::<Vec3>() / 3.0;
        let normal = mesh.double_area_normal(t);
        for &i in triangle {
            let s = &mut sums[i as usize];
            *s = (s.0 + centre, s.1 + 1.0, s.2 + normal);
        }
    }
    let point = |(i, (centre, count, normal)): (usize, &(Vec3, f32, Vec3))| {
        let p = mesh.positions[i];
        let n = mesh.normals[i];
        // within the tangent plane: straight towards the centroid would enter a convex body, and see a lamp from inside
        let inwards = if *count > 0.0 { *centre / *count - p } else { Vec3::ZERO };
        let position = p + 0.06 * (inwards - n * n.dot(inwards));
        IrradiancePoint { position: position + n * 2e-4, face_normal: normal.normalize_or(n), normal: n }
    };
    sums.iter().enumerate().map(point).collect()
}

fn buried(points: &[IrradiancePoint], tracer: &dyn Tracer) -> Vec<bool> {
    const RAYS: usize = 16;
    let parts = map_chunks(points.len(), 256, |range| {
        let mut rays = Vec::with_capacity(range.len() * RAYS);
        for point in &points[range.clone()] {
            let frame = crate::math::Frame::from_normal(point.normal);
            for k in 0..RAYS {
                let u = crate::sampling::hammersley(k as u32, RAYS as u32);
                let d = frame.world_from_local(crate::sampling::square_to_cosine_hemisphere([u[0] + 0.5 / RAYS as f32, u[1]]));
                rays.push(Ray::new(point.position + point.face_normal * 1e-4, d, BURIED));
            }
        }
        let mut occluded = vec![0u8; rays.len()];
        tracer.occluded(&rays, &mut occluded);
        occluded.chunks(RAYS).map(|o| o.iter().map(|&x| usize::from(x)).sum::<usize>() > RAYS * 3 / 4).collect::<Vec<bool>>()
    });
    parts.into_iter().flatten().collect()
}
