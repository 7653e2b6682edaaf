//! Variance-guided filtering of baked irradiance over the surface.
//!
//! Neighbouring texels of one smooth surface see almost the same light, so their samples can be
//! shared. Every texel is replaced by a local linear regression over the texels around it, in
//! position and normal, with non-local-means weights (Bitterli et al. 2016, "Nonlinearly Weighted
//! First-order Regression for Denoising Monte Carlo Renderings"; Rousselle et al. 2012): a gradient
//! costs no bias, not even where a chart ends, and shadow edges stay where they exceed the noise.
//! Each part of the samples is weighted by what the others say, so that noise does not choose its
//! own company. Texels are neighbours in space, across charts, where they see each other. No
//! surface is quite as even as the regression: a texel with many samples keeps its own estimate.

use super::surfel_grid::{Discs, Near, Surfel, SurfelGrid};
use super::surfel_visibility::find_occluded;
use super::{Irradiance, SUB_ESTIMATES, spread};
use crate::core::math::{HALF_STEP, luminance};
use crate::core::parallel::prelude::*;
use crate::core::sampling::hash_u64;
use crate::core::stats::SURELY;
use crate::core::trace::Tracer;
use crate::ffi::simd::{Kernel, run_widest};
use glam::Vec3;
use std::f32::consts::SQRT_2;

/// Reach of the regression in texels.
/// Measured: ×½ albedo −0.5 dB, ×2 albedo −0.2 dB (docs/constants.md).
const REACH: f32 = 6.0;
/// Reach in texels over which noise, error and what is compared are averaged: so small that shadow
/// edges survive.
/// Measured: ×½ little, ×2 albedo −1.1 dB (docs/constants.md).
const DISC: f32 = 2.35;
/// Squared differences, in variances beyond the one that noise explains, from which texels have
/// nothing in common. A kernel that falls faster picks neighbours by their noise
/// (docs/lab/irradiance.md).
/// Measured: ×½ albedo −0.2 dB, ×2 little (docs/constants.md).
const DIFFERENT: f32 = 16.0;
/// How far irradiance departs from the regression, relative: as much of a texel's own estimate is
/// mixed in as its noise, beside this, deserves. The parts of a net complement each other: their mean has 0.4 of the
/// variance that their scatter tells, for which this is larger by √(1 / 0.4). Measured over texels of few and of many
/// samples alike (docs/lab/irradiance.md).
const UNEVEN: f32 = 0.0126;
/// Of the texels that may be left without samples one in so many has some, and so have those in
/// whose disc fewer than `COMPANY` have. Derived: a doubling in place of one that samples are too few for; the unknowns
/// of the regression, a value, two slopes in place and two in turn.
const SAMPLED_ONE_IN: u64 = 2;
/// Derived: as above.
const COMPANY: usize = 5;

/// The neighbourhoods of a set of texels.
pub struct SurfaceFilter {
    around: SurfelGrid,
    discs: Discs,
    /// One over the difference from which texels have nothing in common ([`DIFFERENT`]).
    per_different: f32,
}

/// One value per part: what runs side by side in a vector register.
type Lanes = [f32; SUB_ESTIMATES];

/// Luminance of the parts of a texel and the variance of one.
#[derive(Clone, Copy, Default)]
struct Noise {
    part: Lanes,
    variance: f32,
    /// Number of samples relative to other texels; 0 if it has none and is nothing by itself.
    samples: f32,
}

impl Noise {
    fn mean(&self) -> f32 {
        self.part.iter().sum::<f32>() / SUB_ESTIMATES as f32
    }

    /// Weight of the texel's own estimate beside the regression's, whose error is taken to be
    /// [`UNEVEN`].
    fn own_share(&self) -> f32 {
        let uneven = (UNEVEN * self.mean()).powi(2);
        let variance = self.variance / SUB_ESTIMATES as f32;
        if uneven > 0.0 {
            uneven / (uneven + variance)
        } else {
            0.0
        }
    }

    /// In place of every part the mean of the others.
    fn others(&self) -> Self {
        let sum = self.part.iter().sum::<f32>();
        let others = (SUB_ESTIMATES - 1) as f32;
        Self {
            part: self.part.map(|p| (sum - p) / others),
            variance: self.variance / others,
            samples: self.samples,
        }
    }
}

/// The texels as the regression compares them.
struct Guided {
    /// Of what follows.
    unit: f32,
    noise: Vec<Noise>,
    /// What the small disc says of each.
    guides: Vec<Noise>,
}

/// Where samples are wanted.
pub(crate) struct Judgement {
    /// Luminance per texel.
    pub light: Vec<f32>,
    /// Relative error that is to be expected per texel.
    pub error: Vec<f32>,
}

/// What a texel tells its neighbours' guides: its parts, what the others of each say, and how much
/// it counts.
#[derive(Clone, Copy)]
struct Told {
    part: Lanes,
    others: Lanes,
    /// Of one part.
    variance: f32,
    root_samples: f32,
}

/// What a texel brings to its neighbours' regressions: its parts channel by channel, and what the
/// guides of the other parts say.
#[derive(Clone, Copy)]
struct Node {
    value: [Lanes; 3],
    others: Noise,
}

impl SurfaceFilter {
    /// Finds the neighbourhoods of the texels; those that do not see each other share nothing.
    #[must_use]
    pub fn new(patches: &[Surfel], tracer: &dyn Tracer) -> Self {
        let around = SurfelGrid::new(patches);
        let hidden = find_occluded(&around, REACH, tracer);
        let around = around.without(hidden);
        Self {
            discs: around.discs(DISC),
            around,
            per_different: 1.0 / DIFFERENT,
        }
    }

    /// The same for values of which a little bias costs more than noise: texels part at squared
    /// differences of `different` variances instead of 16.
    #[must_use]
    pub fn parting_at(self, different: f32) -> Self {
        Self {
            per_different: 1.0 / different,
            ..self
        }
    }

    /// The filtered irradiance of `baked`, of whose values the i-th comes from `samples(i)`
    /// samples, relative to the others': 0 where there are none and the neighbours decide alone.
    /// Its `error` tells the relative error that remains, bias included.
    #[must_use]
    pub fn filter(&self, baked: &Irradiance, samples: impl Fn(usize) -> f32 + Sync) -> Irradiance {
        let order = self.order();
        self.back(&self.filter_in_order(&baked.at(order), |k| samples(order[k] as usize)))
    }

    /// The texels in the order in which they are filtered: what lies close in space lies close
    /// there.
    pub(crate) fn order(&self) -> &[u32] {
        self.around.order()
    }

    /// What is given in [`Self::order`], in the order of the texels.
    pub(crate) fn back(&self, baked: &Irradiance) -> Irradiance {
        let mut place = vec![0; self.order().len()];
        self.order()
            .iter()
            .zip(0..)
            .for_each(|(&i, k)| place[i as usize] = k);
        baked.at(&place)
    }

    /// [`Self::filter`] in [`Self::order`], as all that follows.
    pub(crate) fn filter_in_order(
        &self,
        baked: &Irradiance,
        samples: impl Fn(usize) -> f32 + Sync,
    ) -> Irradiance {
        let Guided {
            unit,
            noise,
            guides,
        } = self.guided(baked, samples);
        let per_different = self.per_different;
        let scaled = |i: usize| baked.parts[i].map(|p| p / unit);
        let node = |(i, guide): (usize, &Noise)| {
            let parts = scaled(i);
            Node {
                value: std::array::from_fn(|c| parts.map(|p| p[c])),
                others: guide.others(),
            }
        };
        let nodes: Vec<Node> = guides.par_iter().enumerate().map(node).collect();
        let mut parts = self.around.map(
            REACH,
            |_| true,
            |i| guides[i].samples > 0.0,
            |i, near, weight| {
                let (part, own) = (scaled(i), noise[i].own_share());
                let smooth = run_widest(Regression {
                    own: &guides[i],
                    part: &nodes[i].value,
                    nodes: &nodes,
                    near,
                    per_different,
                    weight,
                });
                std::array::from_fn::<_, SUB_ESTIMATES, _>(|p| smooth[p].lerp(part[p], own))
            },
        );
        let error = self.remaining_error(&noise, |i| parts[i].map(luminance), 0.0);
        parts
            .par_iter_mut()
            .for_each(|parts| parts.iter_mut().for_each(|p| *p *= unit));
        let value = parts
            .par_iter()
            .map(|p| p.iter().sum::<Vec3>() / SUB_ESTIMATES as f32)
            .collect();
        Irradiance {
            value,
            parts,
            error,
            rays: baked.rays,
        }
    }

    /// Where samples are wanted, at a tenth of what filtering costs: what the small discs say of
    /// the light, and of its error. Of what they miss only as much counts as is not chance; their
    /// noise counts as if parts did not complement each other, for where they have little company,
    /// the regression will have little too.
    #[must_use]
    pub(crate) fn judge(
        &self,
        baked: &Irradiance,
        samples: impl Fn(usize) -> f32 + Sync,
    ) -> Judgement {
        let Guided {
            unit,
            noise,
            guides,
        } = self.guided(baked, samples);
        let mut error = self.remaining_error(&noise, |i| guides[i].part, 1.0);
        error
            .par_iter_mut()
            .zip(&guides)
            .for_each(|(error, guide)| {
                let mean = guide.mean();
                let noise = guide.variance / SUB_ESTIMATES as f32 / (mean * mean);
                *error = if mean > 0.0 {
                    (*error * *error + noise).sqrt()
                } else {
                    0.0
                };
            });
        Judgement {
            light: guides.par_iter().map(|g| unit * g.mean()).collect(),
            error,
        }
    }

    /// The texels to sample if all that are `needed` shall be, and the others be left to the
    /// filter: enough of these for that.
    #[must_use]
    pub(crate) fn thinned(&self, needed: impl Fn(usize) -> bool + Sync) -> Vec<bool> {
        let drawn = |i: usize| needed(i) || hash_u64(0, i as u64).is_multiple_of(SAMPLED_ONE_IN);
        let drawn: Vec<bool> = (0..self.order().len()).into_par_iter().map(drawn).collect();
        let company = |i: usize| {
            self.discs
                .of(i)
                .iter()
                .filter(|(j, _)| drawn[*j as usize])
                .count()
        };
        (0..drawn.len())
            .into_par_iter()
            .map(|i| drawn[i] || company(i) < COMPANY)
            .collect()
    }

    /// The noise of the texels and their guides.
    fn guided(&self, baked: &Irradiance, samples: impl Fn(usize) -> f32 + Sync) -> Guided {
        // in a unit near the mean: whatever the exposure, nothing squared underflows
        let unit = power_of_two_near(baked);
        let noise = self.noise(|i| baked.parts[i].map(|p| p / unit), samples);
        let told: Vec<Told> = noise.par_iter().map(Told::from).collect();
        let per_different = self.per_different;
        let guide = |i: usize| {
            run_widest(Guide {
                own: &noise[i],
                told: &told,
                near: self.discs.of(i),
                per_different,
            })
        };
        let guides = (0..noise.len()).into_par_iter().map(guide).collect();
        Guided {
            unit,
            noise,
            guides,
        }
    }

    /// Variance of one part's luminance. The scatter of a single texel's parts is a poor variance:
    /// the relative variance of one sample is averaged over the disc.
    fn noise(
        &self,
        parts: impl Fn(usize) -> [Vec3; SUB_ESTIMATES] + Sync,
        samples: impl Fn(usize) -> f32 + Sync,
    ) -> Vec<Noise> {
        let own = |i: usize| {
            let (mean, variance) = spread(&parts(i).map(luminance));
            [samples(i) * variance * mean * mean, mean * mean]
        };
        let own: Vec<[f32; 2]> = (0..self.order().len()).into_par_iter().map(own).collect();
        let of = |i: usize| {
            let [variance, square] = sums(self.discs.of(i), &own);
            let noise = Noise {
                part: parts(i).map(luminance),
                variance: 0.0,
                samples: samples(i),
            };
            let known = square > 0.0 && noise.samples > 0.0;
            Noise {
                variance: if known {
                    variance / square * noise.mean().powi(2) / noise.samples
                } else {
                    0.0
                },
                ..noise
            }
        };
        (0..own.len()).into_par_iter().map(of).collect()
    }

    /// Relative error of `smooth`, the filtered parts: what a filtered part misses of the other,
    /// unfiltered ones beyond their noise and its own (what is left is bias and the mean's noise),
    /// averaged over the disc by samples (else those with few would speak for those with many),
    /// less so many `standard_errors`: where the noise shared is large and what is left small, it
    /// is mostly chance. At least what the filtered parts' scatter tells.
    fn remaining_error(
        &self,
        noise: &[Noise],
        smooth: impl Fn(usize) -> Lanes + Sync,
        standard_errors: f32,
    ) -> Vec<f32> {
        let own: Vec<[f32; 6]> = noise
            .par_iter()
            .enumerate()
            .map(|(i, n)| {
                let smooth = smooth(i);
                let (mean, variance) = spread(&smooth);
                let variance = variance * mean * mean;
                let others = n.others();
                let missed = smooth
                    .iter()
                    .zip(&others.part)
                    .map(|(s, o)| (s - o).powi(2))
                    .sum::<f32>()
                    / SUB_ESTIMATES as f32;
                let of_mean = variance / SUB_ESTIMATES as f32;
                let terms = [
                    missed - others.variance - (variance - of_mean),
                    of_mean,
                    mean * mean,
                    n.variance,
                    1.0,
                    n.samples,
                ];
                terms.map(|t| t * n.samples)
            })
            .collect();
        let of = |i: usize| {
            let [missed, differ, square, variance, weights, squares] = sums(self.discs.of(i), &own);
            let count = weights * weights / squares.max(f32::MIN_POSITIVE);
            // parts and filtered parts differ by twice the variance of one at most, and the square of a Gaussian
            // deviates by √2 of its variance
            let deviation = 2.0 * SQRT_2 / SUB_ESTIMATES as f32;
            let chance = standard_errors * deviation * variance / count.max(1.0).sqrt();
            if square > 0.0 {
                ((missed - chance).max(differ) / square).sqrt()
            } else {
                0.0
            }
        };
        (0..own.len()).into_par_iter().map(of).collect()
    }
}

/// The power of two below the mean luminance of a bake; 1 where there is none.
fn power_of_two_near(baked: &Irradiance) -> f32 {
    let n = baked.value.len().max(1);
    let mean =
        crate::core::parallel::sum_f64(baked.value.len(), |i| f64::from(luminance(baked.value[i])))
            / n as f64;
    let exponent = mean.log2().floor();
    if exponent.abs() < 120.0 {
        2f32.powi(exponent as i32)
    } else {
        1.0
    }
}

/// Sums of the texels' terms.
fn sums<const C: usize>(near: &[(u32, f32)], terms: &[[f32; C]]) -> [f32; C] {
    let mut sums = [0.0; C];
    for (id, _) in near {
        sums.iter_mut()
            .zip(&terms[*id as usize])
            .for_each(|(sum, t)| *sum += t);
    }
    sums
}

impl From<&Noise> for Told {
    fn from(n: &Noise) -> Self {
        Self {
            part: n.part,
            others: n.others().part,
            variance: n.variance,
            root_samples: n.samples.sqrt(),
        }
    }
}

/// Mean of each part over the disc, without texels that the other parts find different beyond their
/// noise. Texels count by the square root of their samples: if all counted alike, noisy ones would
/// spoil what many samples bought; if by their precision, one or two would decide, however uneven
/// the surface (docs/lab/irradiance.md).
struct Guide<'a> {
    own: &'a Noise,
    told: &'a [Told],
    near: &'a [(u32, f32)],
    per_different: f32,
}

impl Kernel for Guide<'_> {
    type Output = Noise;

    #[inline(always)]
    fn run(self) -> Noise {
        let Self {
            own,
            told,
            near,
            per_different,
        } = self;
        let alike = Alike::new(own, per_different);
        let others = (SUB_ESTIMATES - 1) as f32;
        let (mut weights, mut sum, mut spread) = (
            [0.0; SUB_ESTIMATES],
            [0.0; SUB_ESTIMATES],
            [0.0; SUB_ESTIMATES],
        );
        for (id, distance2) in near {
            let t = &told[*id as usize];
            let weight = alike.weights(
                &t.others,
                t.variance / others,
                (1.0 - 0.8 * distance2) * t.root_samples,
            );
            add(&mut weights, &weight);
            add_product(&mut sum, &weight, &t.part);
            let squares = times(&weight, t.variance);
            add_product(&mut spread, &squares, &weight);
        }
        let mut out = *own;
        if weights.iter().all(|w| *w > 0.0) {
            out.part = std::array::from_fn(|p| sum[p] / weights[p]);
            out.variance = spread
                .iter()
                .zip(&weights)
                .map(|(s, w)| s / (w * w))
                .fold(0.0, f32::max);
        }
        out
    }
}

/// Squared differences below this, which no image shows, never separate two texels of the luminance `own`.
fn indifferent(own: f32) -> f32 {
    (HALF_STEP * own).powi(2).max(f32::MIN_POSITIVE)
}

/// Which texels count as like one.
struct Alike {
    /// What the other parts say of it.
    own: Noise,
    /// Squared difference that counts as nothing.
    floor: f32,
    per_different: f32,
}

impl Alike {
    /// All are like one that has no samples.
    #[inline(always)]
    fn new(own: &Noise, per_different: f32) -> Self {
        let per_different = if own.samples > 0.0 {
            per_different
        } else {
            0.0
        };
        Self {
            own: own.others(),
            floor: indifferent(own.mean()),
            per_different,
        }
    }

    /// Weights, part by part, of a texel of which the other parts say `told`, with `variance`;
    /// `most` where they do not differ. They are (1 − d/D)⁶ up to the squared difference d = D,
    /// zero beyond: about exp(−6 d/D) at the price of a few products.
    #[inline(always)]
    fn weights(&self, told: &Lanes, variance: f32, most: f32) -> Lanes {
        let variance = self.own.variance + variance;
        let scale = self.per_different / (variance + self.floor);
        let mut out = [0.0; SUB_ESTIMATES];
        for l in 0..SUB_ESTIMATES {
            let difference = self.own.part[l] - told[l];
            let d = (difference * difference - variance).max(0.0) * scale;
            let a = (1.0 - d).max(0.0);
            let a2 = a * a;
            out[l] = most * (a2 * a2 * a2);
        }
        out
    }
}

// Written out lane by lane, not with closures, which the compiler would leave outside, compiled for
// the baseline.

#[inline(always)]
fn add(sum: &mut Lanes, a: &Lanes) {
    for l in 0..SUB_ESTIMATES {
        sum[l] += a[l];
    }
}

#[inline(always)]
fn add_product(sum: &mut Lanes, a: &Lanes, b: &Lanes) {
    for l in 0..SUB_ESTIMATES {
        sum[l] = a[l].mul_add(b[l], sum[l]);
    }
}

#[inline(always)]
fn add_scaled(sum: &mut Lanes, a: &Lanes, scale: f32) {
    for l in 0..SUB_ESTIMATES {
        sum[l] = a[l].mul_add(scale, sum[l]);
    }
}

#[inline(always)]
fn times(a: &Lanes, scale: f32) -> Lanes {
    let mut out = [0.0; SUB_ESTIMATES];
    for l in 0..SUB_ESTIMATES {
        out[l] = a[l] * scale;
    }
    out
}

/// The regression's value at a texel, for every part.
struct Regression<'a> {
    /// The texel's guide.
    own: &'a Noise,
    /// What stays where the neighbours decide nothing.
    part: &'a [Lanes; 3],
    nodes: &'a [Node],
    near: &'a [Near],
    per_different: f32,
    /// Memory for the neighbours' weights.
    weight: &'a mut Vec<Lanes>,
}

impl Kernel for Regression<'_> {
    type Output = [Vec3; SUB_ESTIMATES];

    #[inline(always)]
    fn run(self) -> [Vec3; SUB_ESTIMATES] {
        let Self {
            own,
            part,
            nodes,
            near,
            per_different,
            weight,
        } = self;
        // the weights of one part's values come from the others
        let alike = Alike::new(own, per_different);
        weight.resize(near.len(), [0.0; SUB_ESTIMATES]);
        for (n, weight) in near.iter().zip(weight.iter_mut()) {
            let others = &nodes[n.id as usize].others;
            let falloff = (1.0 - n.distance2) * (1.0 - n.distance2);
            *weight = alike.weights(&others.part, others.variance, falloff * others.samples);
        }
        let (moments, right) = (
            moments_of_place(near, weight),
            right_of_place(near, weight, nodes),
        );
        let [red, green, blue] = if is_flat(near) {
            intercepts(moments, right)
        } else {
            let ([a, b, c, d, e, f], [g, h, i, j, k, l, m, n, o]) =
                (moments, moments_of_turn(near, weight));
            let ([p, q, r], [s, t]) = (right, right_of_turn(near, weight, nodes));
            intercepts(
                [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o],
                [p, q, r, s, t],
            )
        };
        let reach = SURELY * own.variance.sqrt();
        let mut out = [Vec3::ZERO; SUB_ESTIMATES];
        for (p, out) in out.iter_mut().enumerate() {
            let value = Vec3::new(red[p], green[p], blue[p]);
            if !value.is_finite() {
                *out = Vec3::new(part[0][p], part[1][p], part[2][p]);
                continue;
            }
            // where the neighbours lie to one side the slopes extrapolate: the small disc says how
            // far that may go
            let value = value.max(Vec3::ZERO);
            let l = luminance(value);
            let limited = l.clamp((own.part[p] - reach).max(0.0), own.part[p] + reach);
            *out = if l > 0.0 {
                value * (limited / l)
            } else {
                value
            };
        }
        out
    }
}

/// Ridge on the slopes relative to the weights' sum: decides only where the neighbours do not, being as far below 1
/// as above what is lost in rounding.
#[inline(always)]
fn ridge() -> f32 {
    f32::EPSILON.sqrt()
}

/// Whether the surface turns so little over the neighbours that the ridge outweighs the slopes of
/// the normal a hundred times.
#[inline(always)]
fn is_flat(near: &[Near]) -> bool {
    let steepest = near.iter().fold(0.0f32, |most, n| {
        most.max(n.along[2].abs()).max(n.along[3].abs())
    });
    steepest.powi(2) < 0.01 * ridge()
}

/// A neighbour's terms of the slopes of position.
#[inline(always)]
fn place(n: &Near) -> [f32; 2] {
    [n.along[0], n.along[1]]
}

/// Its terms of the slopes of the normal.
#[inline(always)]
fn turn(n: &Near) -> [f32; 2] {
    [n.along[2], n.along[3]]
}

// Sums over the neighbours: every one has a name so that it stays in a register, as many in each
// loop as there are registers.

/// Lower triangle of the normal equations' matrix, row by row: Σ w tᵣ t꜀ with t₀ = 1, then the
/// terms of position; the rows of the normal's terms follow from [`moments_of_turn`].
#[inline(always)]
fn moments_of_place(near: &[Near], weight: &[Lanes]) -> [Lanes; 6] {
    let [mut m00, mut m10, mut m11, mut m20, mut m21, mut m22] = [[0.0; SUB_ESTIMATES]; 6];
    for (n, w) in near.iter().zip(weight) {
        let [x, y] = place(n);
        add(&mut m00, w);
        let row = times(w, x);
        add(&mut m10, &row);
        add_scaled(&mut m11, &row, x);
        let row = times(w, y);
        add(&mut m20, &row);
        add_scaled(&mut m21, &row, x);
        add_scaled(&mut m22, &row, y);
    }
    [m00, m10, m11, m20, m21, m22]
}

#[inline(always)]
fn moments_of_turn(near: &[Near], weight: &[Lanes]) -> [Lanes; 9] {
    let [
        mut m30,
        mut m31,
        mut m32,
        mut m33,
        mut m40,
        mut m41,
        mut m42,
        mut m43,
        mut m44,
    ] = [[0.0; SUB_ESTIMATES]; 9];
    for (n, w) in near.iter().zip(weight) {
        let ([x, y], [u, v]) = (place(n), turn(n));
        let row = times(w, u);
        add(&mut m30, &row);
        add_scaled(&mut m31, &row, x);
        add_scaled(&mut m32, &row, y);
        add_scaled(&mut m33, &row, u);
        let row = times(w, v);
        add(&mut m40, &row);
        add_scaled(&mut m41, &row, x);
        add_scaled(&mut m42, &row, y);
        add_scaled(&mut m43, &row, u);
        add_scaled(&mut m44, &row, v);
    }
    [m30, m31, m32, m33, m40, m41, m42, m43, m44]
}

/// Right side of the normal equations: Σ w tᵣ v for each row, channel by channel.
#[inline(always)]
fn right_of_place(near: &[Near], weight: &[Lanes], nodes: &[Node]) -> [[Lanes; 3]; 3] {
    let zero = [0.0; SUB_ESTIMATES];
    let ([mut r0, mut g0, mut b0], [mut r1, mut g1, mut b1], [mut r2, mut g2, mut b2]) =
        ([zero; 3], [zero; 3], [zero; 3]);
    for (n, w) in near.iter().zip(weight) {
        let ([r, g, b], [x, y]) = (&nodes[n.id as usize].value, place(n));
        add_product(&mut r0, w, r);
        add_product(&mut g0, w, g);
        add_product(&mut b0, w, b);
        let row = times(w, x);
        add_product(&mut r1, &row, r);
        add_product(&mut g1, &row, g);
        add_product(&mut b1, &row, b);
        let row = times(w, y);
        add_product(&mut r2, &row, r);
        add_product(&mut g2, &row, g);
        add_product(&mut b2, &row, b);
    }
    [[r0, g0, b0], [r1, g1, b1], [r2, g2, b2]]
}

#[inline(always)]
fn right_of_turn(near: &[Near], weight: &[Lanes], nodes: &[Node]) -> [[Lanes; 3]; 2] {
    let zero = [0.0; SUB_ESTIMATES];
    let ([mut r3, mut g3, mut b3], [mut r4, mut g4, mut b4]) = ([zero; 3], [zero; 3]);
    for (n, w) in near.iter().zip(weight) {
        let ([r, g, b], [u, v]) = (&nodes[n.id as usize].value, turn(n));
        let row = times(w, u);
        add_product(&mut r3, &row, r);
        add_product(&mut g3, &row, g);
        add_product(&mut b3, &row, b);
        let row = times(w, v);
        add_product(&mut r4, &row, r);
        add_product(&mut g4, &row, g);
        add_product(&mut b4, &row, b);
    }
    [[r3, g3, b3], [r4, g4, b4]]
}

/// The constants of the regressions, channel by channel: the slopes are eliminated one after the
/// other, last to first. Not finite where no neighbour has weight.
#[inline(always)]
fn intercepts<const TERMS: usize, const MOMENTS: usize>(
    mut matrix: [Lanes; MOMENTS],
    mut right: [[Lanes; 3]; TERMS],
) -> [Lanes; 3] {
    let at = |row: usize, column: usize| row * (row + 1) / 2 + column;
    let ridge = times(&matrix[0], ridge());
    for r in (1..TERMS).rev() {
        let mut per_pivot = [0.0; SUB_ESTIMATES];
        for l in 0..SUB_ESTIMATES {
            per_pivot[l] = 1.0 / (matrix[at(r, r)][l] + ridge[l]);
        }
        for i in 0..r {
            let mut factor = [0.0; SUB_ESTIMATES];
            for l in 0..SUB_ESTIMATES {
                factor[l] = -matrix[at(r, i)][l] * per_pivot[l];
            }
            for c in 0..=i {
                let other = matrix[at(r, c)];
                add_product(&mut matrix[at(i, c)], &factor, &other);
            }
            let other = right[r];
            right[i]
                .iter_mut()
                .zip(&other)
                .for_each(|(sum, other)| add_product(sum, &factor, other));
        }
    }
    let mut out = right[0];
    for channel in &mut out {
        for l in 0..SUB_ESTIMATES {
            channel[l] /= matrix[0][l];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::sampling::KeyedRng;
    use crate::core::trace::BruteForce;

    /// Every third texel has many samples and is darker than its noisy neighbours: their light must
    /// not be mixed into it.
    #[test]
    fn many_samples_are_not_spoilt_by_noisy_neighbours() {
        const SIDE: usize = 30;
        let many = |i: usize| (i % SIDE + i / SIDE).is_multiple_of(3);
        let truth = |i: usize| if many(i) { 1.0 } else { 1.1 };
        let patches: Vec<Surfel> = (0..SIDE * SIDE)
            .map(|i| Surfel {
                position: Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0),
                normal: Vec3::Z,
                size: 1.0,
            })
            .collect();
        let samples = |i: usize| if many(i) { 256.0 } else { 1.0 };
        let parts: Vec<[Vec3; SUB_ESTIMATES]> = (0..patches.len())
            .map(|i| {
                let mut rng = KeyedRng::new(7, i as u64);
                let noise = if many(i) { 0.03 } else { 0.45 };
                // even over ±√3 standard deviations
                std::array::from_fn(|_| {
                    Vec3::splat(truth(i) * (1.0 + noise * 12f32.sqrt() * (rng.next_f32() - 0.5)))
                })
            })
            .collect();
        let baked = Irradiance::of_parts(parts);
        let filtered = SurfaceFilter::new(&patches, &BruteForce::new(&Mesh::default()))
            .filter(&baked, samples);
        let fine: Vec<usize> = (0..patches.len()).filter(|&i| many(i)).collect();
        let error = |v: &[Vec3]| {
            (fine.iter().map(|&i| (v[i].x - 1.0).powi(2)).sum::<f32>() / fine.len() as f32).sqrt()
        };
        let (before, after) = (error(&baked.value), error(&filtered.value));
        assert!(
            after < 0.75 * before,
            "{before} before the filter, {after} after it"
        );
    }

    /// On a slope of light, texels without samples get what lies between those that have some, to
    /// within what light changes by over a small disc: without noise no more is plausible, not even
    /// at borders, where a disc lies to one side.
    #[test]
    fn texels_without_samples_are_filled_in() {
        const SIDE: usize = 24;
        let at = |i: usize| Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0);
        let patches: Vec<Surfel> = (0..SIDE * SIDE)
            .map(|i| Surfel {
                position: at(i),
                normal: Vec3::Z,
                size: 1.0,
            })
            .collect();
        let light = |i: usize| Vec3::new(1.0, 2.0, 3.0) * (1.0 + 0.02 * at(i).x + 0.01 * at(i).y);
        let tracer = BruteForce::new(&Mesh::default());
        let filter = SurfaceFilter::new(&patches, &tracer);
        let mut sampled = vec![false; patches.len()];
        let thinned = filter.thinned(|k| filter.order()[k] < SIDE as u32);
        filter
            .order()
            .iter()
            .zip(thinned)
            .for_each(|(&i, s)| sampled[i as usize] = s);
        let count = sampled.iter().filter(|s| **s).count();
        assert!(
            sampled[..SIDE].iter().all(|s| *s)
                && count > SIDE * SIDE * 2 / 5
                && count < SIDE * SIDE * 3 / 4,
            "{count}"
        );
        let value: Vec<Vec3> = (0..patches.len())
            .map(|i| if sampled[i] { light(i) } else { Vec3::ZERO })
            .collect();
        let parts = value.iter().map(|v| [*v; SUB_ESTIMATES]).collect();
        let baked = Irradiance {
            value,
            parts,
            ..Irradiance::default()
        };
        let filtered = filter.filter(&baked, |i| f32::from(u8::from(sampled[i])));
        for (i, value) in filtered.value.iter().enumerate() {
            assert!(
                (*value / light(i) - 1.0).abs().max_element() < 0.03,
                "texel {i}: {value} for {}",
                light(i)
            );
        }
    }
}
