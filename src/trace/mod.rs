//! Rays against the mesh in batches: closest hit and occlusion through Embree, and a brute-force twin for tests.

mod brute;
mod embree;
#[cfg(test)]
mod tests;

pub use brute::BruteForce;
pub use embree::{BATCH, EmbreeTracer, embree_version, rays_traced};

use glam::Vec3;

/// Whether a position can take part in tracing: finite and not so far out that products of it overflow.
fn is_usable(p: Vec3) -> bool {
    p.abs().max_element() < embree::FAR_AWAY && p.is_finite()
}

/// A ray segment: 32 bytes, the layout the C++ shim reads.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Ray {
    /// Origin, metres.
    pub origin: [f32; 3],
    /// Hits nearer than this are ignored.
    pub t_near: f32,
    /// Unit direction.
    pub direction: [f32; 3],
    /// Hits farther than this are ignored; may be infinite.
    pub t_far: f32,
}

impl Ray {
    /// A ray from `origin` along `direction` up to `t_far`, starting at 0.
    #[must_use]
    pub fn new(origin: Vec3, direction: Vec3, t_far: f32) -> Self {
        Self { origin: origin.to_array(), t_near: 0.0, direction: direction.to_array(), t_far }
    }

    /// Whether the ray can hit anything at all: finite origin and direction, a direction that is not zero, and a segment that
    /// is not empty. Other rays miss.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        let d2 = Vec3::from(self.direction).length_squared();
        let segment = self.t_near < embree::FAR_AWAY && self.t_far >= self.t_near && self.t_far > 0.0;
        is_usable(self.origin.into()) && d2 > embree::TINY && d2 < embree::FAR_AWAY && segment
    }
}

/// The closest hit of a ray: 16 bytes, the layout the C++ shim writes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Hit {
    /// Distance; infinite for a miss.
    pub t: f32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// Triangle index; [`Hit::MISS`] for a miss.
    pub triangle: u32,
}

impl Hit {
    /// The triangle index of a miss.
    pub const MISS: u32 = u32::MAX;

    /// A miss.
    #[must_use]
    pub fn miss() -> Self {
        Self { t: f32::INFINITY, u: 0.0, v: 0.0, triangle: Self::MISS }
    }

    /// Whether a triangle was hit.
    #[must_use]
    pub fn is_hit(&self) -> bool {
        self.triangle != Self::MISS
    }
}

/// Anything that answers visibility queries in batches.
///
/// A hit lies in `t_near < t <= t_far` (a negative `t_near` counts as 0), both faces count, and a ray that is not finite or
/// has no direction misses.
pub trait Tracer: Sync {
    /// Closest hits; `hits.len() == rays.len()`.
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]);
    /// `occluded[i] = 1` if anything lies on ray i's segment, else 0; `occluded.len() == rays.len()`.
    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]);
}
