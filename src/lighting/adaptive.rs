//! Irradiance of a whole texture from a budget of rays: where sharing samples over the surface does not suffice, more are drawn.
//!
//! A first round gives every texel the same samples. After each round the filter tells what error it leaves, noise and bias; of the
//! texels that matter, those where doubling the samples promises most per ray are doubled, once or several times, until the budget is
//! spent or the target reached. Several rounds draw powers of two, whatever the budget: Sobol' points in other numbers are no nets.

use super::{Bake, Estimator, Irradiance, IrtOptions, PARTS, Patch, Receiver, SurfaceFilter, bake_irradiance};
use crate::math::luminance;
use crate::progress::Progress;
use glam::Vec3;
use rayon::prelude::*;

/// Share of the budget that the first of several rounds may take.
const FIRST: [u32; 2] = [2, 3];
/// Doublings of a texel in one round, and in all.
const MAX_STEPS: u8 = 4;
const MAX_LEVEL: u8 = 8;
/// Irradiance, as a share of the mean, below which an error counts less than its relative size.
const DIM: f32 = 0.5;

/// What a texture's irradiance may cost.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// Hemisphere rays and emitter samples per texel, on average.
    pub samples: [u32; 2],
    /// Rounds in which they are spent; 1 = all texels alike.
    pub rounds: u32,
    /// Whether samples are shared over the surface. Without, samples are spent evenly too: nothing tells where they are wanted.
    pub filter: bool,
    /// Relative error at which a texel is done.
    pub target: f32,
    /// Seed of the sample points.
    pub seed: u64,
}

/// Bakes and filters the irradiance of texels given by `patches` and `receiver(i)`. Where `matters` is false, the first of several
/// rounds is all a texel gets.
#[must_use]
pub fn bake_surface(
    bake: &Bake,
    patches: &[Patch],
    receiver: impl Fn(usize) -> Receiver + Sync + Send,
    matters: &[bool],
    budget: &Budget,
    progress: &Progress,
) -> Irradiance {
    let count = patches.len();
    let more_rounds = if budget.filter { budget.rounds.saturating_sub(1) } else { 0 };
    let first = match more_rounds {
        0 => budget.samples,
        _ => budget.samples.map(|s| if s == 0 { 0 } else { power_of_two_within(s * FIRST[0] / FIRST[1]) }),
    };
    // what the filter decides by are parts, none of which may lack a kind of samples
    let first = first.map(|s| if s == 0 { 0 } else { s.max(PARTS as u32) });
    let options = |level: u8| IrtOptions {
        estimator: Estimator::Mis,
        drawn: if level == 0 { [0, 0] } else { first.map(|s| s << (level - 1)) },
        rays: first[0] << level.saturating_sub(1),
        emitter_samples: first[1] << level.saturating_sub(1),
        seed: budget.seed,
    };
    if !budget.filter {
        return bake_irradiance(bake, count, &receiver, &options(0), progress);
    }
    let filter = SurfaceFilter::new(patches);
    let mut level = vec![0u8; count];
    let mut baked = bake_irradiance(bake, count, &receiver, &options(0), progress);
    let round_budget = u64::from(budget.samples.iter().sum::<u32>().saturating_sub(first.iter().sum())) * count as u64
        / u64::from(more_rounds.max(1));
    for _ in 0..more_rounds {
        let (filtered, certain) = filter.filter(&baked, &level, |i| matters[i]);
        let promising = |i: usize| if matters[i] && certain[i] > budget.target { certain[i] } else { 0.0 };
        let cost = round_budget / u64::from(first.iter().sum::<u32>().max(1));
        let wanted = most_promising(&filtered.value, &promising, &level, cost);
        if wanted == level {
            break;
        }
        for l in 0..MAX_LEVEL {
            let ids: Vec<u32> = (0..count as u32).filter(|&i| level[i as usize] == l && wanted[i as usize] > l).collect();
            let more = bake_irradiance(bake, ids.len(), |k| receiver(ids[k] as usize), &options(l + 1), progress);
            baked.double(&ids, &more);
            ids.iter().for_each(|&i| level[i as usize] = l + 1);
        }
    }
    filter.filter(&baked, &level, |_| true).0
}

/// The level that each texel should reach. Those with a relative `error` are doubled in the order in which their squared error falls
/// most per sample, taking it to halve each time; `cost` is what may be spent, in first rounds of one texel.
fn most_promising(value: &[Vec3], error: &(impl Fn(usize) -> f32 + Sync), level: &[u8], cost: u64) -> Vec<u8> {
    let light: Vec<f32> = value.par_iter().map(|e| luminance(*e)).collect();
    let mean = (crate::parallel::sum_f64(light.len(), |i| f64::from(light[i])) / light.len().max(1) as f64) as f32;
    let mut order: Vec<(f32, u32)> = (0..light.len())
        .into_par_iter()
        .filter(|&i| error(i) > 0.0)
        .flat_map_iter(|i| {
            // between relative error, which albedos inherit, and absolute error, by which irradiance is judged
            let share = light[i] / mean.max(f32::MIN_POSITIVE);
            let weight = share * share * share / (share * share + DIM * DIM);
            let gain = weight * error(i).powi(2) / f32::from(1u16 << level[i]);
            (0..MAX_STEPS.min(MAX_LEVEL - level[i])).map(move |s| (gain / f32::from(1u16 << (2 * s)), i as u32))
        })
        .filter(|(gain, _)| *gain > 0.0)
        .collect();
    order.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut wanted = level.to_vec();
    let mut left = cost;
    for (_, i) in order {
        let w = &mut wanted[i as usize];
        let Some(rest) = left.checked_sub(1 << *w) else { break };
        left = rest;
        *w += 1;
    }
    wanted
}

/// The largest power of two that is not above `n`: Sobol' blocks of that length are nets.
fn power_of_two_within(n: u32) -> u32 {
    1 << n.max(1).ilog2()
}
