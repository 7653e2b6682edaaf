//! Surfaces with holes, before any [`Tracer`]: leaves and fences whose texture says where nothing
//! is, panes that let a share of the light through.

use super::{Hit, Ray, Tracer};
use crate::core::sampling::hash_u64;
use glam::Vec3;

/// Layers that a ray may pass: a bound for rays along a stack of coincident surfaces.
pub const MOST_LAYERS: usize = 256;

/// What is there of a surface.
pub trait Coverage: Sync {
    /// Whether anything stops the ray where it hits. The answer for equal rays and hits is equal.
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool;

    /// What a ray's light counts per channel once it has passed where it hits: of glass that passes it by
    /// chance, its transmittance over that chance.
    fn passed(&self, _ray: &Ray, _hit: &Hit) -> Vec3 {
        Vec3::ONE
    }
}

/// A number in [0, 1) of a ray's own at a hit, as good as random: what lets a share of the light
/// through stops a ray where the number lies below the rest, and stops the same ray again.
#[must_use]
pub fn number_of_ray(ray: &Ray, hit: &Hit) -> f32 {
    let numbers = ray
        .origin
        .iter()
        .chain(&ray.direction)
        .chain(std::iter::once(&ray.t_near));
    let key = numbers.fold(u64::from(hit.triangle), |k, x| {
        hash_u64(k, x.to_bits().into())
    });
    ((key >> 40) as f32) / ((1u64 << 24) as f32)
}

/// Whether a ray passes by chance what lets a share of the light through, [0, 1]: the same ray
/// always or never.
#[must_use]
pub fn passes_by_chance(ray: &Ray, hit: &Hit, share: f32) -> bool {
    share > 0.0 && number_of_ray(ray, hit) < share
}

/// The ray behind what it has hit.
#[must_use]
pub fn beyond(ray: &Ray, hit: &Hit) -> Ray {
    Ray {
        // four units in the last place: the same hit is not found again
        t_near: hit.t * (1.0 + 4.0 * f32::EPSILON),
        ..*ray
    }
}

/// Rays that pass through holes.
pub struct CutOut<'a> {
    tracer: &'a dyn Tracer,
    coverage: &'a dyn Coverage,
}

impl<'a> CutOut<'a> {
    /// What `tracer` finds, where `coverage` says that it is there.
    #[must_use]
    pub fn new(tracer: &'a dyn Tracer, coverage: &'a dyn Coverage) -> Self {
        Self { tracer, coverage }
    }

    /// What rays find; `passed` is multiplied by what their light counts for what they passed before it.
    pub fn closest_and_passed(&self, rays: &[Ray], hits: &mut [Hit], passed: &mut [Vec3]) {
        self.walk(rays, hits, |i, hit| {
            passed[i] *= self.coverage.passed(&rays[i], hit);
        });
    }

    /// Whether rays find anything; `passed` as in [`Self::closest_and_passed`] for those that do not.
    pub fn occluded_and_passed(&self, rays: &[Ray], occluded: &mut [u8], passed: &mut [Vec3]) {
        self.ask_again(rays, occluded, |i, hit| {
            passed[i] *= self.coverage.passed(&rays[i], hit);
        });
    }

    /// What rays find, `pass(i, hit)` told of what ray `i` passes before.
    fn walk(&self, rays: &[Ray], hits: &mut [Hit], mut pass: impl FnMut(usize, &Hit)) {
        self.tracer.closest(rays, hits);
        let mut open: Vec<usize> = (0..rays.len()).collect();
        let mut next = Vec::new();
        for _ in 0..=MOST_LAYERS {
            open.retain(|&i| hits[i].is_hit() && !self.coverage.stops(&rays[i], &hits[i]));
            if open.is_empty() {
                return;
            }
            open.iter().for_each(|&i| pass(i, &hits[i]));
            let further: Vec<Ray> = open.iter().map(|&i| beyond(&rays[i], &hits[i])).collect();
            next.clear();
            next.resize(further.len(), Hit::miss());
            self.tracer.closest(&further, &mut next);
            for (&i, hit) in open.iter().zip(&next) {
                hits[i] = *hit;
            }
        }
    }

    /// Whether rays find anything: those that meet something at all are followed through what they pass.
    fn ask_again(&self, rays: &[Ray], occluded: &mut [u8], mut pass: impl FnMut(usize, &Hit)) {
        self.tracer.occluded(rays, occluded);
        let doubtful: Vec<usize> = (0..rays.len()).filter(|&i| occluded[i] != 0).collect();
        let again: Vec<Ray> = doubtful.iter().map(|&i| rays[i]).collect();
        let mut hits = vec![Hit::miss(); again.len()];
        self.walk(&again, &mut hits, |k, hit| pass(doubtful[k], hit));
        for (&i, hit) in doubtful.iter().zip(&hits) {
            occluded[i] = u8::from(hit.is_hit());
        }
    }
}

impl Tracer for CutOut<'_> {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        self.walk(rays, hits, |_, _| ());
    }

    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]) {
        self.ask_again(rays, occluded, |_, _| ());
    }
}
