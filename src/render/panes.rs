//! The panes of a solution (`transmission.exr`) as the hybrid renderer sees through them, and what
//! both renderers take for the chance to pass one.

use crate::core::brdf::BaseColour;
use crate::core::image::Wrap;
use crate::core::trace::{Coverage, Hit, Ray, passes_by_chance};
use crate::solution::Solution;
use glam::{Vec2, Vec3};

/// The probability with which a ray passes by chance.
pub(super) fn grey(transmittance: Vec3) -> f32 {
    transmittance.element_sum() / 3.0
}

/// A solution as what lets light through. A reflected ray passes by chance, with the mean
/// transmittance; what stops it shows the solution's radiance at the pane.
pub(super) struct SolutionPanes<'a>(pub(super) &'a Solution);

impl SolutionPanes<'_> {
    /// What goes straight through where a ray hits, [0, 1] per channel.
    pub(super) fn transmittance(&self, ray: &Ray, hit: &Hit) -> Vec3 {
        let s = self.0;
        let triangle = hit.triangle as usize;
        let uv = s.mesh.uv(triangle, hit.u, hit.v);
        let transmission = s.transmission_at(uv);
        if transmission == 0.0 {
            return Vec3::ZERO;
        }
        let size = Vec2::new(s.albedo.width as f32, s.albedo.height as f32);
        let base = BaseColour {
            colour: s.albedo.bilinear(uv * size, Wrap::Clamp),
            metallic: s.metal_at(uv),
        };
        let cosine = s
            .mesh
            .face_normal(triangle)
            .dot(Vec3::from_array(ray.direction));
        base.transmitted(transmission, cosine.abs())
    }
}

impl Coverage for SolutionPanes<'_> {
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool {
        !passes_by_chance(ray, hit, grey(self.transmittance(ray, hit)))
    }
}
