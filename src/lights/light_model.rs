//! What the light sampler has to know of a scene: which triangles send out light, how much, to which
//! side, and what shines in from outside. The irradiance bake answers from its light field, the path
//! tracer from its surfaces.

use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::radiance::LightField;
use glam::Vec3;

/// Barycentrics at which a triangle is looked at. Cited: the places of the four-point rule of degree 3 (Hammer and
/// Stroud 1956).
pub(super) const PLACES: [(f32, f32); 4] =
    [(1.0 / 3.0, 1.0 / 3.0), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)];

/// A scene as a source of light. Only `radiance` and `environment` enter an estimate; the rest
/// decides how often what is sampled, and so the noise.
pub trait LightModel: Sync {
    /// Whether a triangle emits; one that does not may be sampled for the light it reflects.
    fn is_emissive(&self, triangle: usize) -> bool;
    /// Luminance × area by which a triangle is sampled, positive where any part of it sends out
    /// light; zero for what is never sampled.
    fn power(&self, mesh: &Mesh, triangle: usize) -> f64;
    /// Radiance that leaves a triangle at barycentrics (u, v).
    fn radiance(&self, triangle: usize, u: f32, v: f32) -> Vec3;
    /// Unit normal of the side by which light leaves a triangle; zero if by both alike.
    fn outward_normal(&self, triangle: usize) -> Vec3;
    /// Radiance from outside along a unit direction that points away from the scene.
    fn environment(&self, direction: Vec3) -> Vec3;
    /// Whether no light comes from outside.
    fn is_dark_outside(&self) -> bool;
}

impl LightModel for LightField {
    fn is_emissive(&self, triangle: usize) -> bool {
        Self::is_emissive(self, triangle)
    }

    /// From a few points; a floor keeps dim corners possible.
    fn power(&self, mesh: &Mesh, triangle: usize) -> f64 {
        let lum = PLACES.map(|(u, v)| luminance(self.emitted(triangle, u, v)).max(0.0));
        let peak = lum.iter().copied().fold(0.0, f32::max);
        f64::from((lum.iter().sum::<f32>() / 4.0).max(0.1 * peak)) * f64::from(mesh.area(triangle))
    }

    fn radiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        self.emitted(triangle, u, v)
    }

    fn outward_normal(&self, triangle: usize) -> Vec3 {
        Self::outward_normal(self, triangle)
    }

    fn environment(&self, direction: Vec3) -> Vec3 {
        self.environment.radiance(direction)
    }

    fn is_dark_outside(&self) -> bool {
        self.environment.is_black()
    }
}
