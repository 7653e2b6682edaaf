//! Rays against the mesh in batches: closest hit and occlusion through Embree, through surfaces
//! with holes, and a brute-force twin for tests.

mod brute;
mod cut_out;
mod embree;
#[cfg(test)]
mod tests;

pub use crate::ffi::ray::{Hit, Ray};
pub use brute::BruteForce;
pub use cut_out::{Coverage, CutOut, MOST_LAYERS, beyond, number_of_ray, passes_by_chance};
pub use embree::{BATCH, EmbreeTracer, embree_version, rays_traced};

/// Anything that answers visibility queries in batches.
///
/// A hit lies in `t_near < t <= t_far` (a negative `t_near` counts as 0), both faces count, and a
/// ray that is not finite or has no direction misses.
pub trait Tracer: Sync {
    /// Closest hits; `hits.len() == rays.len()`.
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]);
    /// `occluded[i] = 1` if anything lies on ray i's segment, else 0; `occluded.len() ==
    /// rays.len()`.
    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]);
}
