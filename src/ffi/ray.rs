//! Rays and hits as both sides of the border see them: the layouts of `ffi/trace_shim.h`.

use glam::Vec3;

/// Triple products of coordinates beyond this would overflow inside the intersection test; Embree
/// itself refuses vertices beyond 1.8e18, but returns infinite distances long before. The shim uses
/// the same limit.
pub const FAR_AWAY: f32 = 1e12;

/// Squared length below which a direction is none (directions are unit vectors); the shim uses the
/// same limit.
pub const TINY: f32 = 1e-30;

/// Whether a position can take part in tracing: finite and not so far out that products of it
/// overflow.
#[must_use]
pub fn is_usable(p: Vec3) -> bool {
    p.abs().max_element() < FAR_AWAY && p.is_finite()
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
        Self {
            origin: origin.to_array(),
            t_near: 0.0,
            direction: direction.to_array(),
            t_far,
        }
    }

    /// Whether the ray can hit anything at all: finite origin and direction, a direction that is
    /// not zero, and a segment that is not empty. Other rays miss.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        let d2 = Vec3::from(self.direction).length_squared();
        let segment = self.t_near < FAR_AWAY && self.t_far >= self.t_near && self.t_far > 0.0;
        is_usable(self.origin.into()) && d2 > TINY && d2 < FAR_AWAY && segment
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
        Self {
            t: f32::INFINITY,
            u: 0.0,
            v: 0.0,
            triangle: Self::MISS,
        }
    }

    /// Whether a triangle was hit.
    #[must_use]
    pub fn is_hit(&self) -> bool {
        self.triangle != Self::MISS
    }
}
