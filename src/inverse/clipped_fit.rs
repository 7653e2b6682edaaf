//! Radiance of clipped lights from the shape of the shading they throw.
//!
//! A pixel at the sensor's ceiling c is a lower bound. Lights are grouped; group k sends an unknown
//! radiance t_k ≥ c_k, and what exceeds the ceiling, e_k = t_k − c_k, gives a surface the irradiance
//! e_k B_k(x) (direct: the rest of the light was photographed and holds its bounces). Where the
//! albedo ρ of a class is constant
//!
//! > ln L(x) = ln ρ − ln π + ln(B_0(x) + Σ_k e_k B_k(x)) + noise,
//!
//! so the *shape* of L against the B fixes the e_k in the known units of B_0, whatever ρ is.
//! Unknown are φ_k = ln t_k per channel; ρ is eliminated class by class (variable projection, Golub
//! & Pereyra 1973), the residuals are weighted by Geman & McClure's function, and Gauss-Newton
//! steps follow. A clipped reflecting surface is a row too, of which only the side counts on which
//! L would fall below its bound. Where the shape says nothing, weak priors speak: lights of a kind
//! are alike, as far as they prove to be ([`Spread`]), no large class reflects more than all,
//! the brightest is white paint.
//!
//! Neighbouring pieces err together (gloss, texture, the bake), so that they tell less than their
//! number says: each class's rows are worth 1/d of what independent ones would be, d being the
//! [`design_effect`] of its residuals. Stated errors follow from it.
//!
//! Called by the pipeline's stage `clipped_light`.

use super::albedo_palette::MOST_TEXTURE;
use super::class_prior::{LEAST_SHARE, LEAST_SPREAD};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{MAD_SCALE, USUALLY, design_effect, median};
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use std::f32::consts::PI;
use std::f64::consts::LN_2;

/// Iterations of a fit at most.
/// Measured: ×½ albedo within two errors +16 %, ×2 albedo within two errors +1 % (docs/constants.md).
const ITERATIONS: usize = 40;
/// Fits, each with the design effects and the spreads of the one before.
/// Measured: ×½ roughness within two errors +24 %, ×2 albedo within two errors +15 % (docs/constants.md).
const PASSES: usize = 3;
/// Largest step of ln t per iteration: a doubling.
const MOST_STEP: f64 = LN_2;
/// ln of radiance over ceiling, at least and at most. Derived: by a step of 8-bit sRGB at white, 0.9 %, and by as much as a
/// half float holds, 65 504.
const RANGE: (f64, f64) = (0.01, 11.0);
/// Prior of a kind's mean ln(t/ceiling): lamps are some ten times brighter than white paint beside
/// them, give or take a factor of ten.
/// Measured: ×½ roughness within two errors −19 %, ×2 roughness +0.3 dB (docs/constants.md).
const KIND: (f64, f64) = (2.0, 2.5);
/// How far lights of a kind differ as long as nothing is known of it.
const UNLIKE: Spread = Spread {
    level: 1.0,
    colour: 0.15,
};
/// How far they usually do: worth one more light when the spread of a kind is estimated.
const USUAL: Spread = Spread {
    level: 0.3,
    colour: 0.15,
};
/// Colour of a kind's mean against neutral: ln of one channel over the next. Derived: of a black body of 4000 K, between
/// incandescent light and daylight, 0.42 and 0.55.
const NEUTRAL: f64 = 0.5;
/// White paint: ln albedo of the brightest large class, and its spread.
/// Measured: ×½ roughness within two errors −19 %, ×2 roughness within two errors −19 % (docs/constants.md).
const WHITE: (f64, f64) = (0.82, 0.35);

/// A piece of surface with the light it gets.
#[derive(Clone, Debug)]
pub struct ShadingRow {
    /// Index of its class.
    pub class: usize,
    /// Area, in any unit.
    pub weight: f32,
    /// Position, in any unit.
    pub position: Vec3,
    /// Radiance sent out, or the ceiling it is above.
    pub radiance: Vec3,
    /// `radiance` is a lower bound.
    pub is_bound: bool,
    /// Irradiance B_0 from all that is not clipped, and from the clipped up to the ceiling.
    pub base: Vec3,
    /// Irradiance B_k per unit excess radiance of each group.
    pub basis: Vec<f32>,
}

/// A group of clipped lights of one radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightGroup {
    /// Groups of equal kind are alike.
    pub kind: usize,
    /// Mean radiance at the ceiling.
    pub ceiling: Vec3,
    /// Channels that are clipped.
    pub free: [bool; 3],
}

/// The light beyond the ceiling.
#[derive(Clone, Debug, Default)]
pub struct ClippedFit {
    /// Excess radiance per group.
    pub excess: Vec<Vec3>,
    /// Standard error of ln radiance, the ceiling included (luminance), per group.
    pub log_error: Vec<f32>,
    /// Albedo per class; zero where no row tells.
    pub albedo: Vec<Vec3>,
    /// Spread of ln L of each class about the model.
    pub spread: Vec<f32>,
}

/// Fits the excess of every group.
#[must_use]
pub fn fit_clipped(rows: &[ShadingRow], groups: &[LightGroup], classes: usize) -> ClippedFit {
    let mut problem = Problem {
        rows,
        groups,
        classes,
        share: class_shares(rows, classes),
        worth: vec![0.0; classes],
        spread: Vec::new(),
    };
    problem.spread = vec![UNLIKE; problem.kinds()];
    let middle = problem.guess(&vec![KIND.0; problem.kinds()]);
    problem.worth = problem.worths(&problem.state(&middle));
    let mut phi = problem.first_guess();
    if phi.is_empty() {
        return problem.result(&phi, None);
    }
    let mut information = None;
    for pass in 0..PASSES {
        if pass > 0 {
            problem.worth = problem.worths(&problem.state(&phi));
        }
        if let Some(covariance) = information.take().and_then(DMatrix::try_inverse) {
            problem.spread = (0..problem.kinds())
                .map(|kind| problem.spread_of(kind, &phi, &covariance))
                .collect();
        }
        information = problem.descend(&mut phi);
    }
    problem.result(&phi, information)
}

/// Weight of each class as a share of all.
fn class_shares(rows: &[ShadingRow], classes: usize) -> Vec<f32> {
    let mut share = vec![0.0f32; classes];
    rows.iter().for_each(|r| share[r.class] += r.weight);
    let total: f32 = share.iter().sum();
    share
        .iter_mut()
        .for_each(|s| *s /= total.max(f32::MIN_POSITIVE));
    share
}

struct Problem<'a> {
    rows: &'a [ShadingRow],
    groups: &'a [LightGroup],
    classes: usize,
    share: Vec<f32>,
    /// Independent rows that a unit of weight of each class is worth.
    worth: Vec<f32>,
    /// How far the lights of each kind differ.
    spread: Vec<Spread>,
}

/// Standard deviations of lights of a kind about its mean.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// Of ln radiance, mean of the channels.
    level: f64,
    /// Of ln radiance of a channel against the other channels'.
    colour: f64,
}

/// Location and spread of every class at some excess.
struct State {
    /// ln ρ per class.
    log_albedo: Vec<Vec3>,
    spread: Vec<f32>,
    /// ln L − ln(E/π) per row.
    residual: Vec<Vec3>,
}

/// Normal matrix and gradient of a Gauss-Newton step for ln t and the kinds' means.
struct Normal {
    a: DMatrix<f64>,
    g: DVector<f64>,
}

impl Problem<'_> {
    /// Damped Gauss-Newton steps from `phi`; the information matrix of the last.
    fn descend(&self, phi: &mut [f64]) -> Option<DMatrix<f64>> {
        let mut information = None;
        for iteration in 0..ITERATIONS {
            let state = self.state(phi);
            let Normal { a, g } = self.normal_equations(phi, &state);
            let damping = 0.5f64.powi(iteration as i32 / 2);
            let mut damped = a.clone();
            for i in 0..phi.len() {
                damped[(i, i)] *= 1.0 + damping;
            }
            information = Some(a);
            let Some(factor) = damped.cholesky() else {
                break;
            };
            let step = factor.solve(&g);
            let most = step.amax();
            let shorten = (MOST_STEP / most.max(1e-12)).min(1.0);
            for i in 0..phi.len() {
                phi[i] += step[i] * shorten;
            }
            self.limit(phi);
            if most < 1e-4 && iteration > 10 {
                break;
            }
        }
        information
    }

    /// What a unit of weight of each class is worth, from how its residuals go together.
    fn worths(&self, state: &State) -> Vec<f32> {
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); self.classes];
        for (i, r) in self.rows.iter().enumerate().filter(|(_, r)| !r.is_bound) {
            members[r.class].push(i);
        }
        members
            .par_iter()
            .enumerate()
            .map(|(class, members)| self.worth_of(class, members, state))
            .collect()
    }

    fn worth_of(&self, class: usize, members: &[usize], state: &State) -> f32 {
        let off = |i: usize| state.residual[i] - state.log_albedo[class];
        let values: Vec<f64> = (members.iter())
            .map(|&i| {
                let weight = self.rows[i].weight * robust_weight(off(i), state.spread[class]);
                f64::from(weight * off(i).element_sum() / 3.0)
            })
            .collect();
        let places: Vec<Vec3> = members.iter().map(|&i| self.rows[i].position).collect();
        let (mut weight, mut square) = (0.0f64, 0.0f64);
        for &i in members {
            weight += f64::from(self.rows[i].weight);
            square += f64::from(self.rows[i].weight).powi(2);
        }
        // rows of equal weight that tell as much (Kish), less what they have in common
        (weight / square.max(f64::MIN_POSITIVE) / design_effect(&places, &values)) as f32
    }

    /// Kinds of groups: the highest index and one.
    fn kinds(&self) -> usize {
        self.groups.iter().map(|g| g.kind + 1).max().unwrap_or(0)
    }

    /// Where ln t of group `k`, channel `c` stands; after all groups, the kinds' means.
    const fn at(k: usize, c: usize) -> usize {
        3 * k + c
    }

    /// Where the mean of a kind stands.
    fn mean_at(&self, kind: usize, c: usize) -> usize {
        3 * (self.groups.len() + kind) + c
    }

    /// How far group `k` differs from its kind in channel `c` against the next: indices into φ and
    /// factors.
    fn colour_contrast(&self, k: usize, c: usize) -> [(usize, f64); 4] {
        let (kind, next) = (self.groups[k].kind, (c + 1) % 3);
        [
            (Self::at(k, c), 1.0),
            (Self::at(k, next), -1.0),
            (self.mean_at(kind, c), -1.0),
            (self.mean_at(kind, next), 1.0),
        ]
    }

    /// Radiance of a group beyond its ceiling.
    fn excess(&self, phi: &[f64], k: usize) -> Vec3 {
        let beyond = self.clipped_radiance(phi, k) - self.groups[k].ceiling;
        beyond.max(Vec3::ZERO)
    }

    /// Radiance of a group in its clipped channels; zero in the others.
    fn clipped_radiance(&self, phi: &[f64], k: usize) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|c| {
            if self.groups[k].free[c] {
                phi[Self::at(k, c)].exp() as f32
            } else {
                0.0
            }
        }))
    }

    fn all_excess(&self, phi: &[f64]) -> Vec<Vec3> {
        (0..self.groups.len())
            .map(|k| self.excess(phi, k))
            .collect()
    }

    fn ceiling(&self, k: usize, c: usize) -> f64 {
        f64::from(self.groups[k].ceiling[c].max(1e-9))
    }

    /// Every kind at a ln of radiance over ceiling.
    fn guess(&self, above: &[f64]) -> Vec<f64> {
        let mut phi: Vec<f64> = (0..self.groups.len())
            .flat_map(|k| {
                let above = above[self.groups[k].kind];
                (0..3).map(move |c| (k, c, above))
            })
            .map(|(k, c, above)| self.ceiling(k, c).ln() + above)
            .collect();
        let means: Vec<f64> = (0..above.len())
            .flat_map(|kind| {
                let first = self.groups.iter().position(|g| g.kind == kind).unwrap_or(0);
                [0, 1, 2].map(|c| phi[Self::at(first, c)])
            })
            .collect();
        phi.extend(means);
        phi
    }

    /// The best of a grid of excess over ceiling, one factor for each kind: all of [`RANGE`], doubled from step to step.
    fn first_guess(&self) -> Vec<f64> {
        let kinds = self.kinds();
        let excess = std::iter::successors(Some(RANGE.0.exp_m1()), |e| Some(e + e));
        let grid: Vec<f64> = excess
            .map(f64::ln_1p)
            .take_while(|above| *above < RANGE.1)
            .collect();
        let mut choice = vec![KIND.0; kinds];
        // coordinate by coordinate, twice: kinds are few and the score is nearly convex
        for kind in (0..kinds).chain(0..kinds) {
            let score = |above: &f64| {
                let mut trial = choice.clone();
                trial[kind] = *above;
                (self.score(&self.guess(&trial)), *above)
            };
            let best = grid.iter().map(score).min_by(|a, b| a.0.total_cmp(&b.0));
            choice[kind] = best.map_or(KIND.0, |(_, above)| above);
        }
        self.guess(&choice)
    }

    /// −ln likelihood up to a constant: Σ weight · ln spread, and the bound on albedo.
    fn score(&self, phi: &[f64]) -> f64 {
        let state = self.state(phi);
        let total: f32 = self.rows.iter().map(|r| r.weight).sum();
        (0..self.classes)
            .map(|c| {
                let told = f64::from(self.share[c] * total * self.worth[c]);
                let fit = told * f64::from(state.spread[c]).ln();
                let over = f64::from(state.log_albedo[c].max_element());
                let bound = if self.share[c] > LEAST_SHARE {
                    0.5 * (over.max(0.0) / f64::from(LEAST_SPREAD)).powi(2)
                } else {
                    0.0
                };
                fit + bound
            })
            .sum()
    }

    fn state(&self, phi: &[f64]) -> State {
        let excess = self.all_excess(phi);
        let residual: Vec<Vec3> = self
            .rows
            .par_iter()
            .map(|r| {
                let e = excess
                    .iter()
                    .zip(&r.basis)
                    .fold(r.base, |sum, (e, b)| sum + *e * *b);
                (r.radiance * PI / e.max(Vec3::splat(1e-12)))
                    .max(Vec3::splat(1e-9))
                    .map(f32::ln)
            })
            .collect();
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); self.classes];
        for (i, r) in self.rows.iter().enumerate() {
            if !r.is_bound {
                members[r.class].push(i);
            }
        }
        let found: Vec<(Vec3, f32)> = members
            .par_iter()
            .map(|m| self.location(m, &residual))
            .collect();
        State {
            log_albedo: found.iter().map(|f| f.0).collect(),
            spread: found.iter().map(|f| f.1).collect(),
            residual,
        }
    }

    /// Robust mean and spread of a class's residuals.
    fn location(&self, members: &[usize], residual: &[Vec3]) -> (Vec3, f32) {
        if members.is_empty() {
            return (Vec3::splat(0.5f32.ln()), 1.0);
        }
        let of = |f: &dyn Fn(Vec3) -> f32| {
            let mut values: Vec<(f32, f32)> = members
                .iter()
                .map(|&i| (f(residual[i]), self.rows[i].weight))
                .collect();
            weighted_middle(&mut values)
        };
        let centre = Vec3::new(of(&|r| r.x), of(&|r| r.y), of(&|r| r.z));
        let spread = MAD_SCALE * of(&|r| (r - centre).abs().element_sum() / 3.0);
        let spread = spread.max(MOST_TEXTURE);
        // one step of the robust mean from the median
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for &i in members {
            let w = self.rows[i].weight * robust_weight(residual[i] - centre, spread);
            sum += residual[i] * w;
            total += w;
        }
        (if total > 0.0 { sum / total } else { centre }, spread)
    }

    /// Normal matrix and gradient of a Gauss-Newton step for ln t and the kinds' means.
    fn normal_equations(&self, phi: &[f64], state: &State) -> Normal {
        let n = phi.len();
        let mut out = Normal {
            a: DMatrix::zeros(n, n),
            g: DVector::zeros(n),
        };
        for c in 0..3 {
            self.add_channel(c, phi, state, &mut out);
        }
        self.add_priors(phi, &mut out);
        for k in 0..self.groups.len() {
            for c in 0..3 {
                if !self.groups[k].free[c] {
                    out.a[(Self::at(k, c), Self::at(k, c))] += 1e6;
                }
            }
        }
        out
    }

    /// The rows of one channel.
    fn add_channel(&self, c: usize, phi: &[f64], state: &State, out: &mut Normal) {
        let k = self.groups.len();
        let excess = self.all_excess(phi);
        let sent: Vec<f32> = (0..k).map(|k| self.clipped_radiance(phi, k)[c]).collect();
        // shares of every group in a row's light, and the row's weight
        let shares: Vec<(Vec<f32>, f32)> = self
            .rows
            .par_iter()
            .zip(&state.residual)
            .map(|(r, residual)| {
                let e = excess
                    .iter()
                    .zip(&r.basis)
                    .fold(r.base[c], |sum, (e, b)| sum + e[c] * b)
                    .max(1e-12);
                let share = sent.iter().zip(&r.basis).map(|(t, b)| t * b / e);
                let off = *residual - state.log_albedo[r.class];
                let spread = state.spread[r.class];
                let counts = !r.is_bound || off[c] > 0.0;
                let weight = if counts {
                    // the channels of a piece err together: each has a third of what it tells
                    self.worth[r.class] * r.weight * robust_weight(off, spread)
                        / (3.0 * spread * spread)
                } else {
                    0.0
                };
                (share.collect(), weight)
            })
            .collect();
        let mut mean = vec![vec![0.0f64; k]; self.classes];
        let mut total = vec![0.0f64; self.classes];
        for (r, (share, w)) in self.rows.iter().zip(&shares) {
            if !r.is_bound {
                total[r.class] += f64::from(*w);
                for j in 0..k {
                    mean[r.class][j] += f64::from(*w) * f64::from(share[j]);
                }
            }
        }
        for (m, t) in mean.iter_mut().zip(&total) {
            m.iter_mut().for_each(|v| *v /= t.max(1e-12));
        }
        let parts = crate::core::parallel::map_chunks(self.rows.len(), 4096, |range| {
            let mut part = (vec![0.0f64; k * k], vec![0.0f64; k]);
            let mut j = vec![0.0f64; k];
            for i in range {
                let (share, w) = &shares[i];
                if *w == 0.0 {
                    continue;
                }
                let class = self.rows[i].class;
                let off = f64::from(state.residual[i][c] - state.log_albedo[class][c]);
                for q in 0..k {
                    j[q] = f64::from(share[q]) - mean[class][q];
                }
                for q in 0..k {
                    let wj = f64::from(*w) * j[q];
                    part.1[q] += wj * off;
                    for (sum, j) in part.0[q * k..=q * k + q].iter_mut().zip(&j) {
                        *sum += wj * j;
                    }
                }
            }
            part
        });
        for part in parts {
            for q in 0..k {
                out.g[Self::at(q, c)] += part.1[q];
                for p in 0..=q {
                    out.a[(Self::at(q, c), Self::at(p, c))] += part.0[q * k + p];
                    if p < q {
                        out.a[(Self::at(p, c), Self::at(q, c))] += part.0[q * k + p];
                    }
                }
            }
        }
        self.add_albedo_priors(c, state, &mean, out);
    }

    /// Bound and expectation of large classes' albedo: ln ρ falls with every share of the light.
    fn add_albedo_priors(&self, c: usize, state: &State, mean: &[Vec<f64>], out: &mut Normal) {
        let k = self.groups.len();
        let large = |class: &usize| self.share[*class] > LEAST_SHARE;
        let brightest = (0..self.classes).filter(large).max_by(|x, y| {
            let l = |i: &usize| luminance(state.log_albedo[*i]);
            l(x).total_cmp(&l(y))
        });
        for class in (0..self.classes).filter(large) {
            let log = f64::from(state.log_albedo[class][c]);
            let mut pull = |off: f64, sd: f64| {
                let w = 1.0 / (sd * sd);
                for q in 0..k {
                    out.g[Self::at(q, c)] += w * mean[class][q] * off;
                    for p in 0..k {
                        out.a[(Self::at(q, c), Self::at(p, c))] +=
                            w * mean[class][q] * mean[class][p];
                    }
                }
            };
            // nothing reflects more than all, as surely as an albedo is known
            if log > 0.0 {
                pull(log, f64::from(LEAST_SPREAD));
            }
            if Some(class) == brightest {
                pull(log - WHITE.0.ln(), WHITE.1);
            }
        }
    }

    /// Lights of a kind are alike; a kind's mean is some way above the ceiling and near neutral.
    fn add_priors(&self, phi: &[f64], out: &mut Normal) {
        // each term: Σ coefficient · φ − target, with a standard deviation
        let mut term = |parts: &[(usize, f64)], target: f64, sd: f64| {
            let w = 1.0 / (sd * sd);
            let off = parts.iter().map(|(i, f)| f * phi[*i]).sum::<f64>() - target;
            for (i, f) in parts {
                out.g[*i] -= w * f * off;
                for (j, h) in parts {
                    out.a[(*i, *j)] += w * f * h;
                }
            }
        };
        for (k, group) in self.groups.iter().enumerate() {
            for c in 0..3 {
                let (own, all) = (Self::at(k, c), self.mean_at(group.kind, c));
                let spread = self.spread[group.kind];
                // three channels share what is known of one light
                term(&[(own, 1.0), (all, -1.0)], 0.0, spread.level * 3f64.sqrt());
                let contrast = self.colour_contrast(k, c);
                term(&contrast, 0.0, spread.colour * 3f64.sqrt());
            }
        }
        for kind in 0..self.kinds() {
            let ceiling = |c: usize| {
                let of: Vec<f32> = (self.groups.iter().filter(|g| g.kind == kind))
                    .map(|g| g.ceiling[c])
                    .collect();
                f64::from(median(of).unwrap_or(1.0).max(1e-9)).ln()
            };
            for c in 0..3 {
                let own = self.mean_at(kind, c);
                term(&[(own, 1.0)], ceiling(c) + KIND.0, KIND.1 * 3f64.sqrt());
                let next = (c + 1) % 3;
                let other = self.mean_at(kind, next);
                term(&[(own, 1.0), (other, -1.0)], 0.0, NEUTRAL);
            }
        }
    }

    /// How far the lights of a kind differ, as the fit has it: the expected squares of their
    /// deviations from the kind's mean given all rows (a step of expectation maximisation, Dempster
    /// et al. 1977), with one light more that differs as lights usually do.
    fn spread_of(&self, kind: usize, phi: &[f64], covariance: &DMatrix<f64>) -> Spread {
        // expected square of Σ factor · φ
        let square = |parts: &[(usize, f64)]| {
            let value: f64 = parts.iter().map(|(i, f)| f * phi[*i]).sum();
            let variance: f64 = (parts.iter())
                .flat_map(|(i, f)| parts.iter().map(move |(j, h)| f * h * covariance[(*i, *j)]))
                .sum();
            value * value + variance.max(0.0)
        };
        let (mut lights, mut level, mut colour) = (1.0, USUAL.level.powi(2), USUAL.colour.powi(2));
        for k in (0..self.groups.len()).filter(|&k| self.groups[k].kind == kind) {
            let free: Vec<usize> = (0..3).filter(|&c| self.groups[k].free[c]).collect();
            if free.is_empty() {
                continue;
            }
            let share = 1.0 / free.len() as f64;
            let off: Vec<(usize, f64)> = (free.iter())
                .flat_map(|&c| [(Self::at(k, c), share), (self.mean_at(kind, c), -share)])
                .collect();
            lights += 1.0;
            level += square(&off);
            colour += if free.len() == 3 {
                let squares = (0..3).map(|c| square(&self.colour_contrast(k, c)));
                squares.sum::<f64>() / 3.0
            } else {
                USUAL.colour.powi(2)
            };
        }
        Spread {
            level: (level / lights).sqrt(),
            colour: (colour / lights).sqrt(),
        }
    }

    /// Keeps ln t within its range about the ceiling.
    fn limit(&self, phi: &mut [f64]) {
        for k in 0..self.groups.len() {
            for c in 0..3 {
                let at = self.ceiling(k, c).ln();
                let own = &mut phi[Self::at(k, c)];
                *own = own.clamp(at + RANGE.0, at + RANGE.1);
            }
        }
    }

    fn result(&self, phi: &[f64], information: Option<DMatrix<f64>>) -> ClippedFit {
        let state = self.state(phi);
        let covariance = information.and_then(DMatrix::try_inverse);
        let error = |k: usize| {
            let free: Vec<usize> = (0..3).filter(|&c| self.groups[k].free[c]).collect();
            let n = free.len().max(1) as f64;
            let sum: f64 = (free.iter())
                .flat_map(|&c| free.iter().map(move |&d| (c, d)))
                .map(|(c, d)| {
                    covariance
                        .as_ref()
                        .map_or(KIND.1 * KIND.1, |v| v[(Self::at(k, c), Self::at(k, d))])
                })
                .sum();
            (sum.max(0.0).sqrt() / n) as f32
        };
        let known = |c: usize| self.rows.iter().any(|r| r.class == c && !r.is_bound);
        ClippedFit {
            excess: self.all_excess(phi),
            log_error: (0..self.groups.len()).map(error).collect(),
            albedo: (0..self.classes)
                .map(|c| {
                    if known(c) {
                        state.log_albedo[c].map(f32::exp)
                    } else {
                        Vec3::ZERO
                    }
                })
                .collect(),
            spread: state.spread,
        }
    }
}

/// Geman & McClure's weight of a deviation (mean over channels): a quarter at [`USUALLY`] spreads.
fn robust_weight(off: Vec3, spread: f32) -> f32 {
    let d = off.abs().element_sum() / (3.0 * USUALLY * spread);
    1.0 / (1.0 + d * d).powi(2)
}

/// Weighted median of (value, weight).
fn weighted_middle(values: &mut [(f32, f32)]) -> f32 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| v.1).sum::<f32>();
    let mut sum = 0.0;
    for (v, w) in values.iter() {
        sum += w;
        if sum >= half {
            return *v;
        }
    }
    values.last().map_or(0.0, |v| v.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    const LAMPS: [Vec3; 2] = [Vec3::new(30.0, 24.0, 15.0), Vec3::new(6.0, 7.0, 9.0)];

    /// Three classes of paint under two clipped lights (ceiling 1) and light that is known; the
    /// third class is of two colours, and its texture is strong.
    fn room(basis: impl Fn(f32, f32) -> [f32; 2]) -> Vec<ShadingRow> {
        let mut rng = KeyedRng::new(3, 7);
        let mut next = || rng.next_f32();
        (0..6000)
            .map(|i| {
                let (x, y) = (next(), next());
                let b = basis(x, y);
                let base = Vec3::new(1.0, 0.9, 0.8) * (0.6 + 0.3 * y) + Vec3::splat(b[0] + b[1]);
                let total = base + LAMPS[0] * b[0] + LAMPS[1] * b[1];
                let (albedo, texture) = match i % 3 {
                    0 => (Vec3::new(0.8, 0.78, 0.75), 0.02),
                    1 => (Vec3::new(0.3, 0.2, 0.1), 0.05),
                    _ if next() < 0.3 => (Vec3::splat(0.1), 0.4),
                    _ => (Vec3::new(0.2, 0.5, 0.6), 0.4),
                };
                let noise = (texture * 3.46 * (next() - 0.5)).exp();
                ShadingRow {
                    class: i % 3,
                    weight: 0.1,
                    position: Vec3::new(x, y, 0.0),
                    radiance: total * albedo * (noise / PI),
                    is_bound: false,
                    base,
                    basis: b.to_vec(),
                }
            })
            .collect()
    }

    fn groups(free: bool) -> Vec<LightGroup> {
        (0..2)
            .map(|kind| LightGroup {
                kind,
                ceiling: Vec3::ONE,
                free: [free; 3],
            })
            .collect()
    }

    /// The shape of the shading tells both lights and with them the albedo, without any prior near
    /// the truth.
    #[test]
    fn shading_tells_the_light_beyond_the_ceiling() {
        let rows = room(|x, y| [0.2 / (0.05 + x * x), 0.3 * y * (1.0 - 0.5 * x)]);
        let fit = fit_clipped(&rows, &groups(true), 3);
        for (found, truth) in fit.excess.iter().zip(LAMPS) {
            let ratio = *found / truth;
            assert!(
                (ratio - Vec3::ONE).abs().max_element() < 0.15,
                "{found} {truth}"
            );
        }
        // what is stated contains what is, and is a fraction of the priors' spread
        for ((found, truth), error) in fit.excess.iter().zip(LAMPS).zip(&fit.log_error) {
            let off = (luminance(*found) / luminance(truth)).ln().abs();
            assert!(off < 3.0 * error && *error < 0.25, "{off} ± {error}");
        }
        let off = fit.albedo[0] / Vec3::new(0.8, 0.78, 0.75) - Vec3::ONE;
        assert!(off.abs().max_element() < 0.05, "{:?}", fit.albedo);
        assert!(
            fit.spread[0] < 0.05 && fit.spread[2] > 0.15,
            "{:?}",
            fit.spread
        );
    }

    /// Where the light beyond the ceiling is spread as the light below, shape is silent: the error
    /// says so, and albedo stays possible.
    #[test]
    fn where_shape_is_silent_the_error_says_so() {
        let mut rows = room(|_, _| [0.2, 0.1]);
        for r in &mut rows {
            r.base = Vec3::splat(0.5);
            r.radiance = Vec3::splat(1.2 / PI);
        }
        let fit = fit_clipped(&rows, &groups(true), 3);
        assert!(
            fit.log_error.iter().all(|e| *e > 0.3),
            "{:?}",
            fit.log_error
        );
        assert!(
            fit.albedo.iter().all(|a| a.max_element() < 1.05),
            "{:?}",
            fit.albedo
        );
    }

    /// Channels below the ceiling have no excess; nothing clipped is nothing found.
    #[test]
    fn what_is_not_clipped_stays() {
        let rows = room(|x, y| [0.2 / (0.05 + x * x), 0.3 * y]);
        let fit = fit_clipped(&rows, &groups(false), 3);
        assert!(fit.excess.iter().all(|e| *e == Vec3::ZERO));
        assert!(fit_clipped(&rows, &[], 3).excess.is_empty());
        assert!(fit_clipped(&[], &groups(true), 0).albedo.is_empty());
    }
}
