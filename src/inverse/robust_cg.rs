//! Albedos from pixels that mix several surfaces: sparse linear equations, solved robustly with a
//! prior.
//!
//! Least squares over pixels and prior by conjugate gradients on the normal equations, repeated
//! with new weights: residuals beyond the noise lose weight (Cauchy: half at [`USUALLY`] standard errors). The prior is a mixture,
//! what is expected or, in [`LEAST_SHARE`] of all cases, anything, each as likely as what pixels alone say makes it; the first
//! round takes anything, so that no narrow expectation keeps the pixels out. Pixels that are lower bounds count where the unknowns fall short of them.

use super::class_prior::{ANYTHING, Expected, LEAST_SHARE};
use super::confidence::LIGHT_ERROR;
use crate::core::math::luminance;
use crate::core::parallel;
use crate::core::parallel::prelude::*;
use crate::core::stats::{self, MAD_SCALE, USUALLY};
use glam::Vec3;

/// Reweightings.
/// Measured: ×½ albedo −0.2 dB, views +0.4 dB, ×2 little (docs/constants.md).
const ROUNDS: usize = 4;

/// One pixel: what it shows beyond the unknowns, and its noise.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    /// Photographed radiance less all that is known.
    pub(super) rest: Vec3,
    /// Variance of its luminance.
    pub(super) variance: f32,
    /// It shows at least that: it tells where the unknowns fall short of it.
    pub(super) is_bound: bool,
}

/// Mixtures in rows: terms of pixel k are `term[end[k-1]..end[k]]`, an unknown and the factor of
/// its E·A/π.
#[derive(Default)]
pub(super) struct RobustSystem {
    pub(super) pixel: Vec<Pixel>,
    pub(super) end: Vec<usize>,
    pub(super) term: Vec<(u32, f32)>,
}

impl RobustSystem {
    fn row(&self, k: usize) -> &[(u32, f32)] {
        &self.term[if k == 0 { 0 } else { self.end[k - 1] }..self.end[k]]
    }

    /// The most plausible albedos, from `start`; `light` is E/π per unknown.
    pub(super) fn solve(&self, light: &[Vec3], prior: &[Expected], start: Vec<Vec3>) -> Solved {
        let columns = self.transposed(prior.len());
        let mut x = start;
        let (mut misfit, mut data, mut pull) = (1.0, vec![0.0; x.len()], Vec::new());
        for round in 0..ROUNDS {
            let residual = self.residuals(&x, light);
            misfit = self.misfit(&residual);
            let weight = self.weights(&residual, misfit);
            pull = if round == 0 {
                vec![(ANYTHING * ANYTHING).recip(); x.len()]
            } else {
                self::pull(prior, &x, &data, &pull)
            };
            let equations = NormalEquations {
                mixtures: self,
                columns: &columns,
                light,
                information: columns.information(&weight, light),
                weight,
                prior,
                pull: &pull,
            };
            equations.conjugate_gradients(&residual, &mut x);
            data = equations.information;
            if round + 1 == ROUNDS {
                data.iter_mut().zip(&pull).for_each(|(d, p)| *d += p);
            }
        }
        Solved {
            albedo: x,
            precision: data,
            misfit,
        }
    }

    fn residuals(&self, x: &[Vec3], light: &[Vec3]) -> Vec<Vec3> {
        (0..self.pixel.len())
            .into_par_iter()
            .map(|k| {
                self.pixel[k].rest
                    - self
                        .row(k)
                        .iter()
                        .map(|&(u, w)| light[u as usize] * x[u as usize] * w)
                        .sum::<Vec3>()
            })
            .collect()
    }

    /// Median residual relative to its noise, as a multiple of a Gaussian's; at least 1.
    fn misfit(&self, residual: &[Vec3]) -> f32 {
        let mut all: Vec<f32> = residual
            .iter()
            .zip(&self.pixel)
            .filter(|(_, p)| !p.is_bound)
            .map(|(r, p)| luminance(*r).abs() / p.variance.sqrt())
            .collect();
        if all.is_empty() {
            return 1.0;
        }
        let middle = all.len() / 2;
        let (_, m, _) = all.select_nth_unstable_by(middle, f32::total_cmp);
        (*m * MAD_SCALE).max(1.0)
    }

    fn weights(&self, residual: &[Vec3], misfit: f32) -> Vec<f32> {
        residual
            .iter()
            .zip(&self.pixel)
            .map(|(r, p)| {
                if p.is_bound && luminance(*r) <= 0.0 {
                    return 0.0;
                }
                let variance = p.variance * misfit * misfit;
                1.0 / (variance + (luminance(*r) / USUALLY).powi(2))
            })
            .collect()
    }

    fn transposed(&self, unknowns: usize) -> Columns {
        let mut begin = vec![0usize; unknowns + 1];
        self.term.iter().for_each(|t| begin[t.0 as usize + 1] += 1);
        (0..unknowns).for_each(|u| begin[u + 1] += begin[u]);
        let mut next = begin.clone();
        let mut term = vec![(0u32, 0.0f32); self.term.len()];
        for k in 0..self.pixel.len() {
            for &(u, w) in self.row(k) {
                term[next[u as usize]] = (k as u32, w);
                next[u as usize] += 1;
            }
        }
        Columns { begin, term }
    }
}

/// What the equations say.
pub(super) struct Solved {
    /// Most plausible albedo per unknown.
    pub(super) albedo: Vec<Vec3>,
    /// Precision of its luminance.
    pub(super) precision: Vec<f32>,
    /// Factor by which residuals exceed the noise assumed, at least 1.
    pub(super) misfit: f32,
}

/// Precision of the prior per unknown, that of what is expected and of anything by their posterior odds. `data` is the
/// precision that pixels alone give, `before` the pull under which they gave `x`.
fn pull(prior: &[Expected], x: &[Vec3], data: &[f32], before: &[f32]) -> Vec<f32> {
    (0..x.len())
        .into_par_iter()
        .map(|u| {
            let Expected { mean, variance } = prior[u];
            if data[u] <= 0.0 {
                return variance.recip();
            }
            let anything = (ANYTHING * ANYTHING).max(variance);
            // many pixels do not average out an error that they share
            let shared = (LIGHT_ERROR * luminance(x[u])).powi(2);
            let own = data[u].recip() + shared;
            // where pixels alone would have it
            let off = (luminance(x[u] - mean) * (1.0 + before[u] / data[u])).clamp(-1.0, 1.0);
            let log_density = |variance: f32| -0.5 * (off * off / variance + variance.ln());
            let odds = (log_density(anything + own) - log_density(variance + own)).exp()
                * LEAST_SHARE
                / (1.0 - LEAST_SHARE);
            let usual = (1.0 + odds).recip();
            (1.0 + data[u] * shared) * (usual / variance + (1.0 - usual) / anything)
        })
        .collect()
}

/// The normal equations (MᵀWM + P)·x = MᵀW·b + P·μ of the mixtures M with weights W and a prior of
/// mean μ and precision P.
struct NormalEquations<'a> {
    mixtures: &'a RobustSystem,
    columns: &'a Columns,
    /// E/π per unknown.
    light: &'a [Vec3],
    /// W, per pixel.
    weight: Vec<f32>,
    /// Diagonal of MᵀWM, of luminance.
    information: Vec<f32>,
    prior: &'a [Expected],
    /// P, per unknown.
    pull: &'a [f32],
}

impl NormalEquations<'_> {
    /// The right side less the left at `x`, whose residuals b − M·x are given.
    fn remainder(&self, residual: &[Vec3], x: &[Vec3]) -> Vec<Vec3> {
        (0..x.len())
            .into_par_iter()
            .map(|u| {
                self.columns.gather(u, |k| residual[k] * self.weight[k]) * self.light[u]
                    + (self.prior[u].mean - x[u]) * self.pull[u]
            })
            .collect()
    }

    /// (MᵀWM + P)·p.
    fn apply(&self, p: &[Vec3]) -> Vec<Vec3> {
        let image: Vec<Vec3> = (0..self.mixtures.pixel.len())
            .into_par_iter()
            .map(|k| {
                self.weight[k]
                    * self
                        .mixtures
                        .row(k)
                        .iter()
                        .map(|&(u, w)| self.light[u as usize] * p[u as usize] * w)
                        .sum::<Vec3>()
            })
            .collect();
        (0..p.len())
            .into_par_iter()
            .map(|u| self.columns.gather(u, |k| image[k]) * self.light[u] + p[u] * self.pull[u])
            .collect()
    }

    /// A remainder divided by the diagonal.
    fn conditioned(&self, r: &[Vec3]) -> Vec<Vec3> {
        (0..r.len())
            .into_par_iter()
            .map(|u| r[u] / (self.information[u] + self.pull[u]))
            .collect()
    }

    /// Conjugate gradients with a diagonal preconditioner, the three channels side by side, from
    /// `x`, whose residuals are given.
    fn conjugate_gradients(&self, residual: &[Vec3], x: &mut [Vec3]) {
        let mut r = self.remainder(residual, x);
        let mut z = self.conditioned(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        for _ in 0..stats::ROUNDS {
            let ap = self.apply(&p);
            let alpha = divide(rz, dot(&p, &ap));
            x.par_iter_mut().zip(&p).for_each(|(x, p)| *x += alpha * *p);
            r.par_iter_mut()
                .zip(&ap)
                .for_each(|(r, a)| *r -= alpha * *a);
            z = self.conditioned(&r);
            let next = dot(&r, &z);
            let beta = divide(next, rz);
            rz = next;
            p.par_iter_mut()
                .zip(&z)
                .for_each(|(p, z)| *p = *z + beta * *p);
        }
        x.par_iter_mut()
            .for_each(|x| *x = x.clamp(Vec3::ZERO, Vec3::ONE));
    }
}

/// Scalar products channel by channel.
fn dot(a: &[Vec3], b: &[Vec3]) -> [f64; 3] {
    let sum = |c: usize| parallel::sum_f64(a.len(), |i| f64::from(a[i][c]) * f64::from(b[i][c]));
    [sum(0), sum(1), sum(2)]
}

/// Quotients channel by channel; 0 where the divisor is not positive.
fn divide(a: [f64; 3], b: [f64; 3]) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|c| {
        if b[c] > 0.0 {
            (a[c] / b[c]) as f32
        } else {
            0.0
        }
    }))
}

/// The equations by unknown: terms of unknown u are `term[begin[u]..begin[u+1]]`, a pixel and the
/// factor.
struct Columns {
    begin: Vec<usize>,
    term: Vec<(u32, f32)>,
}

impl Columns {
    fn gather(&self, u: usize, value: impl Fn(usize) -> Vec3) -> Vec3 {
        self.term[self.begin[u]..self.begin[u + 1]]
            .iter()
            .map(|&(k, w)| value(k as usize) * w)
            .sum()
    }

    /// Diagonal of the normal equations without the prior, of luminance: the inverse of the
    /// variance that the pixels leave.
    fn information(&self, weight: &[f32], light: &[Vec3]) -> Vec<f32> {
        (0..light.len())
            .into_par_iter()
            .map(|u| {
                let sum: f32 = self.term[self.begin[u]..self.begin[u + 1]]
                    .iter()
                    .map(|&(k, w)| w * w * weight[k as usize])
                    .sum();
                luminance(light[u]).powi(2) * sum
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four pieces of a surface expected to be dark, 0.02 ± 0.001, of an irradiance of π: forty pixels
    /// show the first as bright as 0.5, eighty the second as it is expected, one the third within its
    /// noise of 0.1, none the fourth.
    #[test]
    fn a_narrow_prior_gives_way_to_many_pixels_and_not_to_noise() {
        let shown = |count: usize, unknown: u32, shown: f32, variance: f32| {
            let pixel = Pixel {
                rest: Vec3::splat(shown),
                variance,
                is_bound: false,
            };
            std::iter::repeat_n((pixel, (unknown, 1.0)), count)
        };
        let first = shown(40, 0, 0.5, 1e-3);
        let all = first
            .chain(shown(80, 1, 0.02, 1e-3))
            .chain(shown(1, 2, 0.1, 4e-3));
        let (pixel, term): (Vec<_>, Vec<_>) = all.unzip();
        let system = RobustSystem {
            end: (1..=pixel.len()).collect(),
            pixel,
            term,
        };
        let dark = Expected {
            mean: Vec3::splat(0.02),
            variance: 1e-6,
        };
        let solved = system.solve(&[Vec3::ONE; 4], &[dark; 4], vec![dark.mean; 4]);
        let [bright, usual, noisy, unseen] = [0, 1, 2, 3].map(|u| solved.albedo[u].x);
        // 15 % that all pixels share beside the 0.3 of anything: 6 % of the way
        assert!((bright - 0.47).abs() < 0.01, "{bright}");
        assert!((usual - 0.02).abs() < 1e-3, "{usual}");
        assert!((noisy - 0.02).abs() < 5e-3, "{noisy}");
        assert!((unseen - 0.02).abs() < 1e-4, "{unseen}");
    }

    /// Two pieces of surface that pixels of their own show at least 0.6 bright: the one that is
    /// expected darker rises to that, the one that is expected brighter stays as if there were no
    /// pixel.
    #[test]
    fn a_bound_counts_from_one_side_only() {
        let pixel = |_| Pixel {
            rest: Vec3::splat(0.6),
            variance: 1e-4,
            is_bound: true,
        };
        let system = RobustSystem {
            pixel: (0..2).map(pixel).collect(),
            end: vec![1, 2],
            term: vec![(0, 1.0), (1, 1.0)],
        };
        let expected = |mean| Expected {
            mean: Vec3::splat(mean),
            variance: 0.09,
        };
        let prior = [expected(0.4), expected(0.8)];
        let start = vec![Vec3::splat(0.4), Vec3::splat(0.8)];
        let solved = system.solve(&[Vec3::ONE; 2], &prior, start);
        let [dark, bright] = [0, 1].map(|u| solved.albedo[u].x);
        assert!((dark - 0.6).abs() < 0.03, "{dark}");
        assert!((bright - 0.8).abs() < 1e-4, "{bright}");
        assert!(solved.precision[0] > 10.0 * solved.precision[1]);
    }
}
