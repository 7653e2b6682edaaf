//! Irradiance of a whole texture from a budget of rays: where sharing samples over the surface does not suffice, more are drawn.
//!
//! A first round gives every texel the same samples. After each round the filter tells what error it leaves, noise and bias; the
//! texels where doubling the samples promises most per ray are doubled, until the budget is spent or the target reached.

use super::{Bake, Estimator, Irradiance, IrtOptions, Patch, Receiver, SurfaceFilter, bake_irradiance};
use crate::math::luminance;
use crate::progress::Progress;
use rayon::prelude::*;

/// Share of the budget that the first round may take.
const FIRST: u32 = 3;
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

/// Bakes and filters the irradiance of texels given by `patches` and `receiver(i)`.
#[must_use]
pub fn bake_surface(
    bake: &Bake,
    patches: &[Patch],
    receiver: impl Fn(usize) -> Receiver + Sync + Send,
    budget: &Budget,
    progress: &Progress,
) -> Irradiance {
    let count = patches.len();
    let more_rounds = if budget.filter { budget.rounds.saturating_sub(1) } else { 0 };
    let first = match more_rounds {
        0 => budget.samples,
        _ => budget.samples.map(|s| if s == 0 { 0 } else { power_of_two_within((s / FIRST).max(2)) }),
    };
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
    let mut filtered = filter.filter(&baked, &level);
    let round_budget = u64::from(budget.samples.iter().sum::<u32>().saturating_sub(first.iter().sum())) * count as u64
        / u64::from(more_rounds.max(1));
    for _ in 0..more_rounds {
        let chosen = most_promising(&filtered, &level, budget.target, round_budget / u64::from(first.iter().sum::<u32>().max(1)));
        if chosen.is_empty() {
            break;
        }
        for l in 0..=level.iter().copied().max().unwrap_or(0) {
            let ids: Vec<u32> = chosen.iter().copied().filter(|&i| level[i as usize] == l).collect();
            let more = bake_irradiance(bake, ids.len(), |k| receiver(ids[k] as usize), &options(l + 1), progress);
            baked.double(&ids, &more);
        }
        chosen.iter().for_each(|&i| level[i as usize] += 1);
        filtered = filter.filter(&baked, &level);
    }
    filtered
}

/// Texels above `target` whose squared error falls most per sample if theirs are doubled, in ascending order; `cost` is what may be
/// spent, in first rounds of one texel.
fn most_promising(filtered: &Irradiance, level: &[u8], target: f32, cost: u64) -> Vec<u32> {
    const MAX_LEVEL: u8 = 8;
    let light: Vec<f32> = filtered.value.par_iter().map(|e| luminance(*e)).collect();
    let mean = (crate::parallel::sum_f64(light.len(), |i| f64::from(light[i])) / light.len().max(1) as f64) as f32;
    let mut order: Vec<(f32, u32)> = (0..light.len())
        .into_par_iter()
        .filter(|&i| filtered.error[i] > target && level[i] < MAX_LEVEL)
        .map(|i| {
            let square = light[i] * light[i];
            let weight = square / (square + (DIM * mean).powi(2) + f32::MIN_POSITIVE);
            (weight * filtered.error[i].powi(2) / f32::from(1u16 << level[i]), i as u32)
        })
        .filter(|(gain, _)| *gain > 0.0)
        .collect();
    order.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut left = cost;
    let mut chosen: Vec<u32> = order
        .into_iter()
        .map_while(|(_, i)| {
            left = left.checked_sub(1 << level[i as usize])?;
            Some(i)
        })
        .collect();
    chosen.par_sort_unstable();
    chosen
}

/// The largest power of two that is not above `n`: Sobol' blocks of that length are nets.
fn power_of_two_within(n: u32) -> u32 {
    1 << n.max(1).ilog2()
}
