//! What an irradiance bake takes and gives: options, receivers, and estimates E(x) = ∫ L(x, ω)
//! cosθ dω in independent parts, whose scatter tells their error.

use super::next_bounce::NextBounce;
use crate::core::blocks::{Columns, Packed, column, values};
use crate::core::parallel::prelude::*;
use crate::ffi::simd::LANES;
use crate::lights::LitScene;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Independent estimates that a bake keeps of every value: what the others say decides which
/// neighbours one is filtered with, so more of them leave more to decide by. As many as run side by
/// side.
pub const SUB_ESTIMATES: usize = LANES;

/// How irradiance is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// The paper's: uniform hemisphere, Hammersley points with a random shift per texel.
    Uniform,
    /// Cosine-distributed rays, Owen-scrambled Sobol' points.
    Cosine,
    /// Cosine rays and emitter samples combined by multiple importance sampling.
    Mis,
}

/// Options of the irradiance bake.
#[derive(Clone, Debug, PartialEq)]
pub struct IrradianceOptions {
    /// Estimator.
    pub estimator: Estimator,
    /// Hemisphere rays and emitter samples per texel that earlier bakes have drawn: this one
    /// continues their sequences, and its values are the new samples' share of the estimate from
    /// all ([`Irradiance::double`]). Not for `Uniform`: a Hammersley set cannot be extended, for
    /// its points depend on their number.
    pub drawn: [u32; 2],
    /// Hemisphere rays per texel.
    pub rays: u32,
    /// Emitter samples per texel (only `Mis`).
    pub emitter_samples: u32,
    /// Seed of the sample points.
    pub seed: u64,
}

impl Default for IrradianceOptions {
    fn default() -> Self {
        Self {
            estimator: Estimator::Mis,
            drawn: [0, 0],
            rays: 64,
            emitter_samples: 16,
            seed: 0,
        }
    }
}

/// Irradiance of a list of surface points.
#[derive(Clone, Debug, Default)]
pub struct Irradiance {
    /// E per point.
    pub value: Vec<Vec3>,
    /// Independent estimates of E per point, from equally many samples each; their mean is `value`.
    pub parts: Vec<[Vec3; SUB_ESTIMATES]>,
    /// Estimated standard error of E's luminance, relative.
    pub error: Vec<f32>,
    /// Rays traced in all.
    pub rays: u64,
}

impl Irradiance {
    /// Of independent estimates alone, whose error nobody asks for.
    #[must_use]
    pub fn of_parts(parts: Vec<[Vec3; SUB_ESTIMATES]>) -> Self {
        let mean = |p: &[Vec3; SUB_ESTIMATES]| p.iter().sum::<Vec3>() / SUB_ESTIMATES as f32;
        Self {
            value: parts.iter().map(mean).collect(),
            error: vec![0.0; parts.len()],
            parts,
            rays: 0,
        }
    }
}

impl Packed for Irradiance {
    fn columns(&self) -> Columns {
        let Self {
            value,
            parts,
            error,
            rays,
        } = self;
        vec![
            column(value),
            column(parts),
            column(error),
            column(&[*rays]),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [value, parts, error, rays] = columns else {
            return None;
        };
        let rays = values(rays)?.first().copied()?;
        Some(Self {
            value: values(value)?,
            parts: values(parts)?,
            error: values(error)?,
            rays,
        })
    }
}

/// A point that receives light.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Position on the surface, metres.
    pub position: Vec3,
    /// Unit shading normal on the lit side.
    pub normal: Vec3,
    /// Unit geometric normal on the lit side: rays start above it.
    pub face_normal: Vec3,
    /// Key of its random numbers: equal keys give equal points whatever else is baked. The lamps
    /// asked may be those that suit the receiver before it in the list, if that lies close.
    pub key: u64,
}

/// A bake's scene: what is lit, and what its surfaces add.
#[derive(Clone, Copy)]
pub struct Bake<'a> {
    /// Geometry, light field and lights.
    pub lit: LitScene<'a>,
    /// What surfaces send towards the receivers beyond what the field says that they send.
    pub bounce: Option<&'a NextBounce<'a>>,
}

impl<'a> From<LitScene<'a>> for Bake<'a> {
    fn from(lit: LitScene<'a>) -> Self {
        Self { lit, bounce: None }
    }
}

impl Irradiance {
    /// That of lists of points one after the other.
    pub(super) fn joined(lists: Vec<Self>) -> Self {
        let mut lists = lists.into_iter();
        let mut all = lists.next().unwrap_or_default();
        for more in lists {
            all.value.extend(more.value);
            all.parts.extend(more.parts);
            all.error.extend(more.error);
            all.rays += more.rays;
        }
        all
    }

    /// That of the points `ids`, in their order.
    pub(crate) fn at(&self, ids: &[u32]) -> Self {
        fn at<T: Copy + Send + Sync>(ids: &[u32], from: &[T]) -> Vec<T> {
            // (what a bake has not told of, it does not tell of in another order)
            let ids = if from.is_empty() { &[] } else { ids };
            ids.par_iter().map(|&i| from[i as usize]).collect()
        }
        Self {
            value: at(ids, &self.value),
            parts: at(ids, &self.parts),
            error: at(ids, &self.error),
            rays: self.rays,
        }
    }

    /// Sets the points `ids`, ascending, to what a bake of them found. `error` stays as it was.
    pub(crate) fn put(&mut self, ids: &[u32], baked: &Self) {
        self.rays += baked.rays;
        for_each_of(ids, &mut self.value, &baked.value, |value, new| {
            *value = *new
        });
        for_each_of(ids, &mut self.parts, &baked.parts, |parts, new| {
            *parts = *new
        });
    }

    /// Adds what a later bake drew at the points `ids`, ascending: as many samples again as they
    /// had before ([`IrradianceOptions::drawn`]). `error` stays as it was.
    pub fn double(&mut self, ids: &[u32], more: &Self) {
        self.rays += more.rays;
        for_each_of(ids, &mut self.value, &more.value, |value, more| {
            *value = 0.5 * *value + *more
        });
        for_each_of(ids, &mut self.parts, &more.parts, |parts, more| {
            parts
                .iter_mut()
                .zip(more)
                .for_each(|(part, more)| *part = 0.5 * *part + *more);
        });
    }
}

/// `each(&mut to[ids[k]], &from[k])` for all `ids`, which ascend, in parallel.
fn for_each_of<T: Send, U: Sync>(
    ids: &[u32],
    to: &mut [T],
    from: &[U],
    each: impl Fn(&mut T, &U) + Sync,
) {
    // size of work
    const AT_ONCE: usize = 4096;
    let (mut rest, mut skipped, mut tasks) = (to, 0, Vec::new());
    for (ids, from) in ids.chunks(AT_ONCE).zip(from.chunks(AT_ONCE)) {
        let first = skipped;
        skipped = ids[ids.len() - 1] as usize + 1;
        let (own, others) = rest.split_at_mut(skipped - first);
        rest = others;
        tasks.push((first, ids, own, from));
    }
    tasks.into_par_iter().for_each(|(first, ids, own, from)| {
        ids.iter()
            .zip(from)
            .for_each(|(i, from)| each(&mut own[*i as usize - first], from));
    });
}

/// Mean of the parts, and the variance of one relative to its square.
#[inline]
#[must_use]
pub(crate) fn spread(parts: &[f32; SUB_ESTIMATES]) -> (f32, f32) {
    let mean = parts.iter().sum::<f32>() / SUB_ESTIMATES as f32;
    if mean > 0.0 {
        // relative before it is squared: however dim, nothing underflows
        (
            mean,
            parts.iter().map(|p| (p / mean - 1.0).powi(2)).sum::<f32>()
                / (SUB_ESTIMATES - 1) as f32,
        )
    } else {
        (mean, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_of_the_ascending_ids_is_visited_once_with_its_own() {
        // more than are handed out at once, with gaps at both ends
        let ids: Vec<u32> = (3..40_000).filter(|i| i % 7 > 2).collect();
        let from: Vec<u32> = ids.iter().map(|i| 10 * i).collect();
        let mut to = vec![1u32; 50_000];
        for_each_of(&ids, &mut to, &from, |to, from| *to += from);
        for (i, to) in (0u32..).zip(&to) {
            let expected = if ids.binary_search(&i).is_ok() {
                1 + 10 * i
            } else {
                1
            };
            assert_eq!(*to, expected, "{i}");
        }
        for_each_of(&[], &mut to, &from, |to, _| *to = 0);
        assert!(to.iter().all(|to| *to > 0));
    }
}
