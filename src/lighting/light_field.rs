//! What radiance arrives along a ray: the TBL on the surface it hits, or the environment if it hits none.

use super::Environment;
use crate::gbuffer::Orientation;
use crate::geometry::Mesh;
use crate::image::{Plane, RgbPlane};
use crate::texture::MipChain;
use crate::trace::Hit;
use glam::{Vec2, Vec3};

/// Prefiltered copies of the TBL beyond the full resolution: footprints up to 8 texels; coarser ones would mix charts.
const MIP_LEVELS: usize = 4;

/// Per-triangle constants of a lookup, one cache line.
#[derive(Clone, Copy, Debug)]
struct Lookup {
    uv: Vec2,
    uv_edge1: Vec2,
    uv_edge2: Vec2,
    /// Unit normal on the side the cameras see.
    normal: Vec3,
    /// Texels of the TBL per metre.
    density: f32,
    /// Whether any texel of the triangle emits.
    emissive: bool,
}

/// Incident radiance along traced rays.
#[derive(Clone, Debug)]
pub struct LightField {
    lookups: Vec<Lookup>,
    /// Reflected radiance with emissive texels filled from their surroundings, prefiltered.
    reflected: MipChain<Vec3>,
    /// Full radiance, unfiltered, for emissive triangles.
    full: RgbPlane,
    /// Mean radiance of the side away from the cameras' main side; zero where nobody saw it.
    back: Vec<Vec3>,
    /// Directions without geometry.
    pub environment: Environment,
    /// Whether cones look up prefiltered radiance; a single texel otherwise.
    pub prefilter: bool,
}

impl LightField {
    /// Assembles the field. `radiance` is filled outside charts; `emissive` marks emitting texels; `back` holds the radiance of
    /// each triangle's far side (empty = black).
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        orientation: &Orientation,
        radiance: RgbPlane,
        emissive: &Plane<bool>,
        emissive_triangles: &[bool],
        back: Vec<Vec3>,
        environment: Environment,
    ) -> Self {
        let size = Vec2::new(radiance.width as f32, radiance.height as f32);
        let lookups = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corner_uvs(t);
                let area = mesh.area(t);
                let texels = 0.5 * ((b - a) * size).perp_dot((c - a) * size).abs();
                Lookup {
                    uv: a,
                    uv_edge1: b - a,
                    uv_edge2: c - a,
                    normal: mesh.face_normal(t) * orientation.sign(t),
                    density: if area > 0.0 { (texels / area).sqrt() } else { 0.0 },
                    emissive: emissive_triangles.get(t).copied().unwrap_or(false),
                }
            })
            .collect();
        let keep = emissive.map(|e| !e);
        let reflected =
            if emissive.data.iter().any(|e| *e) { crate::texture::fill_uncovered(&radiance, &keep) } else { radiance.clone() };
        let back = if back.len() == mesh.triangles.len() { back } else { vec![Vec3::ZERO; mesh.triangles.len()] };
        Self { lookups, reflected: MipChain::new(reflected, MIP_LEVELS), full: radiance, back, environment, prefilter: true }
    }

    /// Radiance arriving along `direction` from `hit`, averaged over a cone whose diameter at the hit is
    /// `spread · t` metres (0 = a point lookup). Emissive surfaces are never blurred.
    #[must_use]
    #[inline]
    pub fn arriving(&self, hit: &Hit, direction: Vec3, spread: f32) -> Vec3 {
        if !hit.is_hit() {
            return self.environment.radiance(direction);
        }
        let l = &self.lookups[hit.triangle as usize];
        let cosine = -l.normal.dot(direction);
        if cosine < 0.0 {
            return self.back[hit.triangle as usize];
        }
        let uv = l.uv + l.uv_edge1 * hit.u + l.uv_edge2 * hit.v;
        if l.emissive {
            let size = Vec2::new(self.full.width as f32, self.full.height as f32);
            return *self.full.nearest(uv * size);
        }
        self.reflected.lookup(uv, if self.prefilter { spread * hit.t * l.density } else { 0.0 })
    }

    /// Radiance that an emissive triangle sends out at barycentrics (u, v).
    #[must_use]
    pub fn emitted(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        let l = &self.lookups[triangle];
        let uv = l.uv + l.uv_edge1 * u + l.uv_edge2 * v;
        *self.full.nearest(uv * Vec2::new(self.full.width as f32, self.full.height as f32))
    }

    /// Whether any texel of triangle `t` emits.
    #[must_use]
    pub fn is_emissive(&self, t: usize) -> bool {
        self.lookups[t].emissive
    }

    /// Unit normal of triangle `t` on the side the cameras see.
    #[must_use]
    pub fn outward_normal(&self, t: usize) -> Vec3 {
        self.lookups[t].normal
    }
}
