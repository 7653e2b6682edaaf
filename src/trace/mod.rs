//! Rays against the mesh in batches: closest hit and occlusion through Embree, and a brute-force twin for tests.

use glam::Vec3;

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
pub trait Tracer: Sync {
    /// Closest hits; `hits.len() == rays.len()`.
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]);
    /// `occluded[i] = 1` if anything lies on ray i's segment, else 0; `occluded.len() == rays.len()`.
    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]);
}
