//! Irradiance of a whole texture from a budget of rays: where sharing samples over the surface does
//! not suffice, more are drawn.
//!
//! A first round gives every texel that matters the same samples, the others a quarter of them;
//! samples too few to be divided by so much go to every other one of these instead. After each
//! round small discs around the texels tell what error is to be expected; of the texels that
//! matter, those where doubling the samples promises most per ray are doubled, once or several
//! times, until the budget is spent or the target reached. At last all are filtered. Several rounds
//! draw powers of two, whatever the budget: Sobol' points in other numbers are no nets.

use super::Bake;
use super::surface_filter::Judgement;
use super::{
    Estimator, Irradiance, IrradianceOptions, Receiver, SUB_ESTIMATES, SurfaceFilter, Surfel,
    bake_irradiance,
};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use glam::Vec3;

/// One over the share of the budget that the first of several rounds may take: what fewer samples
/// have not found is not looked for.
/// Measured: ×½ albedo within two errors −1 %, ×2 albedo −0.3 dB (docs/constants.md).
const FIRST: u32 = 2;
/// Doublings between the first round's samples where texels do not matter and where they do. Derived: twice the error.
const SPARED: u8 = 2;
/// Doublings of a texel in one round.
/// Measured: ×½ albedo within two errors +8 %, ×2 albedo within two errors +6 % (docs/constants.md).
const MAX_STEPS: u8 = 4;
/// Share of the budget that is kept back: of the samples of doubled texels, fewer may go untraced
/// than of the others'. Measured: 0.15 % more is traced without it (`samples_go_where_they_matter`).
const KEPT_BACK: f64 = 0.005;

/// What a texture's irradiance may cost.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleBudget {
    /// How irradiance is estimated. Only `Mis` asks emitters, and only what can be continued is
    /// spent in several rounds: `Uniform` draws all at once.
    pub estimator: Estimator,
    /// Hemisphere rays and emitter samples per texel, on average; without emitters these are
    /// hemisphere rays as well.
    pub samples: [u32; 2],
    /// Rounds in which they are spent; 1 = all texels alike.
    pub rounds: u32,
    /// Whether samples are shared over the surface. Without, samples are spent evenly too: nothing
    /// tells where they are wanted.
    pub filter: bool,
    /// Relative error at which a texel is done.
    pub target: f32,
    /// Seed of the sample points.
    pub seed: u64,
}

impl SampleBudget {
    /// What is spent where the estimator allows for no more.
    fn within_estimator(&self) -> Self {
        let samples = if self.estimator == Estimator::Mis {
            self.samples
        } else {
            [self.samples.iter().sum(), 0]
        };
        let rounds = if self.estimator == Estimator::Uniform {
            1
        } else {
            self.rounds
        };
        Self {
            samples,
            rounds,
            ..self.clone()
        }
    }
}

/// The samples of texels level by level: none on level 0, then twice as many on each as on the one
/// below.
struct Levels {
    /// Hemisphere rays and emitter samples of level 1.
    base: [u32; 2],
    /// The level of the first round where texels matter; elsewhere it is 1.
    first: u8,
    /// Whether samples are too few to be divided where texels do not matter: some of these have
    /// none then.
    thinned: bool,
    estimator: Estimator,
    seed: u64,
}

impl Levels {
    fn new(budget: &SampleBudget) -> Self {
        let first = match budget.rounds {
            0 | 1 => budget.samples,
            _ => budget.samples.map(|s| {
                if s == 0 {
                    0
                } else {
                    power_of_two_within(s / FIRST)
                }
            }),
        };
        // what the filter decides by are parts, none of which may lack a kind of samples
        let least = SUB_ESTIMATES as u32;
        let first = first.map(|s| if s == 0 { 0 } else { s.max(least) });
        let spare = |steps: &u8| {
            first
                .iter()
                .all(|s| *s == 0 || (s % (1 << steps) == 0 && s >> steps >= least))
        };
        let steps = if budget.rounds > 1 {
            (0..=SPARED).rev().find(spare).unwrap_or(0)
        } else {
            0
        };
        Self {
            base: first.map(|s| s >> steps),
            first: 1 + steps,
            thinned: budget.rounds > 1 && steps < SPARED,
            estimator: budget.estimator,
            seed: budget.seed,
        }
    }

    /// The levels of the first round.
    fn of_first_round(
        &self,
        filter: &SurfaceFilter,
        importance: &(impl Fn(usize) -> f32 + Sync),
    ) -> Vec<u8> {
        let matters = |i: usize| importance(i) > 0.0;
        let sampled = if self.thinned {
            filter.thinned(matters)
        } else {
            vec![true; filter.order().len()]
        };
        let level = |(i, sampled): (usize, &bool)| {
            if matters(i) {
                self.first
            } else {
                u8::from(*sampled)
            }
        };
        sampled.par_iter().enumerate().map(level).collect()
    }

    /// The highest level: its samples still have numbers of 32 bits.
    fn most(&self) -> u8 {
        1 + self.base[0].max(self.base[1]).leading_zeros() as u8
    }

    /// What takes a texel from a level to a higher one.
    fn options(&self, from: u8, to: u8) -> IrradianceOptions {
        let drawn = self.base.map(|s| s * samples(from));
        let [rays, emitter_samples] = [0, 1].map(|k| self.base[k] * samples(to) - drawn[k]);
        IrradianceOptions {
            estimator: self.estimator,
            drawn,
            rays,
            emitter_samples,
            seed: self.seed,
        }
    }
}

/// The samples of a level, in those of level 1.
fn samples(level: u8) -> u32 {
    (1 << level) >> 1
}

/// Bakes and filters the irradiance of texels given by `patches` and `receiver(i)`. An error of
/// texel i counts `importance[i]` in [0, 1]; where that is 0, the first of several rounds is all it
/// gets, with a quarter or half of the others' samples on average.
#[must_use]
pub fn bake_surface(
    bake: &Bake,
    patches: &[Surfel],
    receiver: impl Fn(usize) -> Receiver + Sync + Send,
    importance: &[f32],
    budget: &SampleBudget,
    progress: &Progress,
) -> Irradiance {
    let (count, budget) = (patches.len(), &budget.within_estimator());
    if !budget.filter {
        let levels = Levels::new(&SampleBudget {
            rounds: 1,
            ..budget.clone()
        });
        return bake_irradiance(bake, count, &receiver, &levels.options(0, 1), progress);
    }
    let levels = Levels::new(budget);
    let filter = SurfaceFilter::new(patches, bake.lit.tracer);
    // from here on in the filter's order
    let order = filter.order();
    let receiver = |k: usize| receiver(order[k] as usize);
    let importance = |k: usize| importance[order[k] as usize];
    let mut spending = Spending {
        bake,
        receiver,
        level: levels.of_first_round(&filter, &importance),
        levels,
        baked: Irradiance {
            value: vec![Vec3::ZERO; count],
            parts: vec![Default::default(); count],
            ..Irradiance::default()
        },
        rays: 0,
        drawn: 0,
        progress,
    };
    spending.first_round();
    let total = (1.0 - KEPT_BACK) * f64::from(budget.samples.iter().sum::<u32>()) * count as f64;
    for round in 1..budget.rounds {
        let (baked, level) = (&spending.baked, &spending.level);
        let Judgement { light, error } = filter.judge(baked, |i| samples(level[i]) as f32);
        let promising = |i: usize| {
            if error[i] > budget.target {
                error[i] * importance(i).sqrt()
            } else {
                0.0
            }
        };
        let left = (total - baked.rays as f64).max(0.0) / f64::from(budget.rounds - round);
        let cost = left * spending.drawn as f64 / spending.rays.max(1) as f64;
        let most = spending.levels.most();
        let wanted = most_promising(&light, &promising, level, cost as u64, most);
        if wanted == *level {
            break;
        }
        spending.double(&wanted);
    }
    let Spending { baked, level, .. } = spending;
    filter.back(&filter.filter_in_order(&baked, |i| samples(level[i]) as f32))
}

/// Rounds of a bake: the level that every texel has reached, and what it has found.
struct Spending<'a, R> {
    bake: &'a Bake<'a>,
    receiver: R,
    levels: Levels,
    level: Vec<u8>,
    baked: Irradiance,
    /// Rays traced where it matters, and for how many samples: what cannot carry light is not
    /// traced and costs nothing.
    rays: u64,
    drawn: u64,
    progress: &'a Progress,
}

impl<R: Fn(usize) -> Receiver + Sync + Send> Spending<'_, R> {
    /// The samples of the first round, level by level.
    fn first_round(&mut self) {
        for l in 1..=self.levels.first {
            let ids = at(&self.level, l, |_| true);
            let first = self.draw(&ids, &self.levels.options(0, l));
            self.baked.put(&ids, &first);
            self.rays = first.rays;
            self.drawn = ids.len() as u64 * u64::from(samples(l));
        }
    }

    /// Doubles the samples of texels below the levels wanted, from the lowest level up.
    fn double(&mut self, wanted: &[u8]) {
        let most = wanted.iter().copied().max().unwrap_or(0);
        for l in 1..most {
            let ids = at(&self.level, l, |i| wanted[i] > l);
            let more = self.draw(&ids, &self.levels.options(l, l + 1));
            self.baked.double(&ids, &more);
            self.rays += more.rays;
            self.drawn += ids.len() as u64 * u64::from(samples(l));
            ids.iter().for_each(|&i| self.level[i as usize] = l + 1);
        }
    }

    fn draw(&self, ids: &[u32], options: &IrradianceOptions) -> Irradiance {
        let receiver = |k: usize| (self.receiver)(ids[k] as usize);
        bake_irradiance(self.bake, ids.len(), receiver, options, self.progress)
    }
}

/// The texels on a level, of those to keep.
fn at(level: &[u8], l: u8, keep: impl Fn(usize) -> bool + Sync + Send) -> Vec<u32> {
    (0..level.len() as u32)
        .into_par_iter()
        .filter(|&i| level[i as usize] == l && keep(i as usize))
        .collect()
}

/// The level that each texel should reach. Those with a relative `error` are doubled in the order
/// in which their squared error falls most per sample, taking it to halve each time; `cost` is what
/// may be spent, in samples of a texel of level 1, and `most` the highest level.
fn most_promising(
    light: &[f32],
    error: &(impl Fn(usize) -> f32 + Sync),
    level: &[u8],
    cost: u64,
    most: u8,
) -> Vec<u8> {
    let mean = (crate::core::parallel::sum_f64(light.len(), |i| f64::from(light[i]))
        / light.len().max(1) as f64) as f32;
    let mut order: Vec<(f32, u32)> = (0..light.len())
        .into_par_iter()
        .filter(|&i| error(i) > 0.0)
        .flat_map_iter(|i| {
            // between relative error, which albedos inherit, and absolute error, by which
            // irradiance is judged: below the mean an error counts less than its relative size
            let share = light[i] / mean.max(f32::MIN_POSITIVE);
            let weight = share * share * share / (share * share + 1.0);
            let gain = weight * error(i).powi(2) / samples(level[i]) as f32;
            (0..MAX_STEPS.min(most - level[i]))
                .map(move |s| (gain / f32::from(1u16 << (2 * s)), i as u32))
        })
        .filter(|(gain, _)| *gain > 0.0)
        .collect();
    order.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut wanted = level.to_vec();
    let mut left = cost;
    for (_, i) in order {
        let w = &mut wanted[i as usize];
        let Some(rest) = left.checked_sub(u64::from(samples(*w))) else {
            break;
        };
        left = rest;
        *w += 1;
    }
    wanted
}

/// The largest power of two that is not above `n`: Sobol' blocks of that length are nets.
fn power_of_two_within(n: u32) -> u32 {
    1 << n.max(1).ilog2()
}
