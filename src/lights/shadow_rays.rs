//! Emitter samples of one receiver, from chosen sources to shadow rays and the weights of what they
//! bring, side by side in vector registers.

use super::primitives::{Columns, Sources};
use crate::core::trace::Ray;
use crate::ffi::simd::{Kernel, transpose4};
use crate::radiance::LightField;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Samples that are aimed side by side. Derived: a column of as many numbers fills a pair of cache lines.
const BLOCK: usize = 32;

/// How many blocks before their turn the memory is asked for the sources: size of work.
const AHEAD: usize = 2;

/// Emitter samples of which the sources are chosen, a column per property, in whole blocks.
#[derive(Default)]
pub(crate) struct LightPicks {
    /// Number of the source.
    pub source: Vec<u32>,
    /// Probability of its lamp.
    pub probability: Vec<f32>,
    /// Point of the unit square that stands for one on the source.
    pub place: [Vec<f32>; 2],
    /// Index into the sums.
    pub owner: Vec<u32>,
}

impl LightPicks {
    /// Makes room for `n` samples, and for the rest of a block.
    pub(crate) fn reserve(&mut self, n: usize) {
        let n = n.next_multiple_of(BLOCK);
        self.source.clear();
        self.source.resize(n, 0);
        self.probability.resize(n, 0.0);
        self.place.iter_mut().for_each(|p| p.resize(n, 0.0));
        self.owner.resize(n, 0);
    }
}

/// An emitter sample that waits for its shadow ray: what its radiance is multiplied by, where that
/// is stored, whose it is.
#[derive(Clone, Copy, Default)]
pub(crate) struct ShadowSample {
    pub weight: f32,
    /// Address in the light field, or `PORTAL`.
    pub address: u32,
    pub owner: u32,
}

/// Writes the shadow rays of `picks` that can carry light and what waits for them; returns how many
/// there are.
pub(crate) struct ShadowSampler<'a> {
    pub sources: &'a Sources,
    pub field: &'a LightField,
    pub picks: &'a LightPicks,
    /// How many of the picks there are.
    pub count: usize,
    /// Where the rays start, metres.
    pub origin: Vec3,
    /// Unit shading normal and face normal.
    pub normal: Vec3,
    pub face_normal: Vec3,
    /// Samples of all sources, and hemisphere rays, that the balance heuristic weighs against one
    /// another.
    pub samples: f32,
    pub rays: f32,
    pub shadow: &'a mut [Ray],
    pub aimed: &'a mut [ShadowSample],
}

impl Kernel for ShadowSampler<'_> {
    type Output = usize;

    #[inline(always)]
    fn run(self) -> usize {
        let Self {
            sources,
            picks,
            origin,
            normal,
            face_normal: face,
            ..
        } = self;
        let rays = self.rays * FRAC_1_PI;
        let n = self.count;
        let (sources_of, probabilities, owners) = (
            picks.source.as_chunks().0,
            picks.probability.as_chunks().0,
            picks.owner.as_chunks::<BLOCK>().0,
        );
        let places = picks.place.each_ref().map(|p| p.as_chunks().0);
        let mut columns = Columns::default();
        let (mut kept, start) = (0, origin.to_array());
        let expect = |block: &[u32; BLOCK]| block.iter().for_each(|s| sources.expect(*s));
        sources_of.iter().take(AHEAD).for_each(expect);
        for b in 0..n.div_ceil(BLOCK) {
            sources_of.get(b + AHEAD).into_iter().for_each(expect);
            let (probability, owner): (&[f32; BLOCK], _) = (&probabilities[b], &owners[b]);
            let aims = sources.aim(
                self.field,
                origin,
                &sources_of[b],
                [&places[0][b], &places[1][b]],
                &mut columns,
            );
            let [x, y, z] = &aims.direction;
            let (mut weight, mut useful) = ([0.0f32; BLOCK], [false; BLOCK]);
            for k in 0..BLOCK {
                let direction = Vec3::new(x[k], y[k], z[k]);
                let cosine = normal.dot(direction);
                // balance heuristic, over a common denominator
                let both = cosine * aims.facing[k];
                weight[k] =
                    both / (self.samples * (probability[k] * aims.density[k]) + rays * both);
                // (false too where something is not a number)
                useful[k] = (aims.facing[k] > 0.0) & (cosine > 0.0) & (face.dot(direction) > 0.0);
            }
            let left = BLOCK.min(n - b * BLOCK);
            for first in (0..left).step_by(4) {
                let four = |column: &[f32; BLOCK]| -> [f32; 4] {
                    std::array::from_fn(|k| column[first + k])
                };
                let ends = transpose4([four(x), four(y), four(z), four(&aims.t_far)]);
                for (k, [x, y, z, t_far]) in (first..left).zip(ends) {
                    self.shadow[kept] = Ray {
                        origin: start,
                        t_near: 0.0,
                        direction: [x, y, z],
                        t_far,
                    };
                    self.aimed[kept] = ShadowSample {
                        weight: weight[k],
                        address: aims.address[k],
                        owner: owner[k],
                    };
                    kept += usize::from(useful[k]);
                }
            }
        }
        kept
    }
}
