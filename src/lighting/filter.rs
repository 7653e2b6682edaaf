//! Variance-guided filtering of baked irradiance over the surface.
//!
//! Neighbouring texels of one smooth surface see almost the same light, so their samples can be shared. Every texel is replaced by a
//! local linear regression over the texels around it, in position and normal, with non-local-means weights (Bitterli et al. 2016,
//! "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo Renderings"; Rousselle et al. 2012): a gradient costs no
//! bias, not even where a chart ends, and shadow edges stay where they exceed the noise. Weights come from one half of the samples and
//! are applied to the other, so that noise does not choose its own company. Texels are neighbours in space, across charts. No surface is
//! quite as even as the regression: a texel with many samples keeps its own estimate.

use super::Irradiance;
use super::neighbourhood::{Near, Neighbourhood, Patch, total, weighted_sums};
use crate::ffi::simd::{Kernel, run_widest, with_widest};
use crate::math::{Frame, luminance};
use glam::Vec3;
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Reach of the regression in texels.
const REACH: f32 = 7.0;
/// Reach in texels of what is compared: values averaged over so small a disc that shadow edges survive.
const DISC: f32 = 2.5;
/// Relative differences that never separate two texels.
const INDIFFERENT: f32 = 2e-3;
/// Squared differences, in variances beyond the one that noise explains, from which texels have nothing in common. A kernel that falls
/// faster picks neighbours by their noise (CHANGELOG).
const DIFFERENT: f32 = 16.0;
/// Slopes of the regression: two of position, two of the normal.
const SLOPES: usize = 4;
const TERMS: usize = SLOPES + 1;
/// A turn of the normal that counts as much as the reach.
const TURN: f32 = 4.0;
/// Ridge on the slopes relative to the weights' sum: decides only where the neighbours do not.
const RIDGE: f32 = 3e-4;
/// Standard deviations of the small disc's mean that the regression may lie off it.
const PLAUSIBLE: f32 = 4.0;
/// How far irradiance departs from the regression, relative: as much of a texel's own estimate is mixed in as its noise, beside this,
/// deserves. Measured over texels of few and of many samples alike (CHANGELOG).
const UNEVEN: f32 = 0.01;
/// Variance of the mean of two halves of a net as a share of that of unrelated halves that differ as much: they complement each other
/// (measured: 0.7 for 64 rays, 0.55 for 128, 0.47 for 256 and more).
const COMPLEMENTARY: f32 = 0.6;

/// The neighbourhoods of a set of texels.
pub struct SurfaceFilter<'a> {
    patches: &'a [Patch],
    around: Neighbourhood,
}

/// Luminance of the two halves of a texel and the variance of one.
#[derive(Clone, Copy, Default)]
struct Noise {
    half: [f32; 2],
    variance: f32,
    /// Number of samples relative to other texels.
    samples: f32,
}

impl Noise {
    /// Weight of the texel's own estimate beside the regression's, whose error is taken to be [`UNEVEN`].
    fn own_share(&self) -> f32 {
        let uneven = (UNEVEN * 0.5 * (self.half[0] + self.half[1])).powi(2);
        let variance = COMPLEMENTARY * 0.5 * self.variance;
        if uneven > 0.0 { uneven / (uneven + variance) } else { 0.0 }
    }

    /// The columns by which it travels: halves, variance, samples.
    fn columns(&self) -> [f32; 4] {
        [self.half[0], self.half[1], self.variance, self.samples]
    }
}

/// Columns of the regression's data: the halves' channels, then the guide's columns.
const NODE: usize = 10;

/// Buffers of one thread, a column per candidate.
#[derive(Default)]
struct Scratch {
    weight: [Vec<f32>; 2],
    terms: [Vec<f32>; SLOPES],
    product: Vec<f32>,
}

impl<'a> SurfaceFilter<'a> {
    /// Finds the neighbourhoods of the texels.
    #[must_use]
    pub fn new(patches: &'a [Patch]) -> Self {
        Self { patches, around: Neighbourhood::new(patches) }
    }

    /// The filtered irradiance of `baked` (one value per texel, from 2^`level` times as many samples as the fewest); its `error` tells
    /// the relative error that remains, bias included. Beside it the part of that error that is
    /// not itself noise: what should decide where samples are added. Texels not `asked` for keep their own estimate.
    #[must_use]
    pub fn filter(&self, baked: &Irradiance, level: &[u8], asked: impl Fn(usize) -> bool + Sync) -> (Irradiance, Vec<f32>) {
        let noise = self.noise(baked, level);
        let columns: Vec<_> = noise.par_iter().map(Noise::columns).collect();
        let guides =
            self.around.map(self.patches, &columns, DISC, |i, near, scratch| run_widest(Guide { own: &noise[i], near, scratch }));
        let node = |i: usize| {
            let ([a, b], g) = (baked.halves[i].map(|h| h.to_array()), guides[i].columns());
            [a[0], a[1], a[2], b[0], b[1], b[2], g[0], g[1], g[2], g[3]]
        };
        let nodes: Vec<[f32; NODE]> = (0..noise.len()).into_par_iter().map(node).collect();
        let halves = self.around.map(self.patches, &nodes, REACH, |i, around, scratch| {
            if !asked(i) {
                return baked.halves[i];
            }
            let smooth =
                run_widest(Regression { patches: self.patches, i, own: &guides[i], half: baked.halves[i], around, scratch });
            let own = noise[i].own_share();
            [0, 1].map(|k| smooth[k].lerp(baked.halves[i][k], own))
        });
        let (error, certain) = self.remaining_error(&noise, &halves, &asked).into_iter().unzip();
        let value = halves.iter().map(|h| 0.5 * (h[0] + h[1])).collect();
        (Irradiance { value, halves, error, rays: baked.rays }, certain)
    }

    /// Variance of one half's luminance. A single difference is a poor variance: the relative variance of one sample is averaged over
    /// the disc.
    fn noise(&self, baked: &Irradiance, level: &[u8]) -> Vec<Noise> {
        let samples = |l: u8| f32::from(1u16 << l);
        let own = |(half, l): (&[Vec3; 2], &u8)| {
            let [a, b] = half.map(luminance);
            [samples(*l) * 0.5 * (a - b).powi(2), (0.5 * (a + b)).powi(2)]
        };
        let own: Vec<[f32; 2]> = baked.halves.par_iter().zip(level).map(own).collect();
        self.around.map(self.patches, &own, DISC, |i, near, (): &mut ()| {
            let [variance, square] = with_widest(|| disc_sums(near));
            let (half, n) = (baked.halves[i].map(luminance), samples(level[i]));
            let mean = 0.5 * (half[0] + half[1]);
            let variance = if square > 0.0 { variance / square * mean * mean / n } else { 0.0 };
            Noise { half, variance, samples: n }
        })
    }

    /// Relative error of the filtered texels: what a filtered half misses of the other, unfiltered one beyond that one's noise (noise
    /// and bias), averaged over the disc; at least what the filtered halves differ. Then the same with the first estimate less one
    /// standard error: where the noise shared is large and what is left small, it is mostly chance.
    fn remaining_error(&self, noise: &[Noise], halves: &[[Vec3; 2]], asked: &(impl Fn(usize) -> bool + Sync)) -> Vec<(f32, f32)> {
        let own: Vec<[f32; 4]> = noise
            .par_iter()
            .zip(halves)
            .enumerate()
            .map(|(i, (n, h))| {
                if !asked(i) {
                    return [0.0; 4];
                }
                let f = h.map(luminance);
                let missed = 0.5 * ((f[0] - n.half[1]).powi(2) + (f[1] - n.half[0]).powi(2)) - n.variance;
                [missed, 0.25 * (f[0] - f[1]).powi(2), (0.5 * (f[0] + f[1])).powi(2), n.variance * n.variance]
            })
            .collect();
        self.around.map(self.patches, &own, DISC, |_, near, (): &mut ()| {
            let [missed, differ, square, chance] = with_widest(|| disc_sums(near));
            let relative = |missed: f32| if square > 0.0 { (missed.max(differ) / square).sqrt() } else { 0.0 };
            (relative(missed), relative(missed - chance.sqrt()))
        })
    }
}

/// Sums of the data columns over the disc.
#[inline(always)]
fn disc_sums<const C: usize>(near: &Near<C>) -> [f32; C] {
    let mut sums = [0.0; C];
    for (sum, column) in sums.iter_mut().zip(&near.data) {
        *sum = total(column);
    }
    sums
}

/// Mean of each half over the disc, without texels that the other half finds different beyond its noise. Texels count by the square
/// root of their samples: if all counted alike, noisy ones would spoil what many samples bought; if by their precision, one or two
/// would decide, however uneven the surface (CHANGELOG).
struct Guide<'a> {
    own: &'a Noise,
    near: &'a Near<4>,
    scratch: &'a mut Scratch,
}

impl Kernel for Guide<'_> {
    type Output = Noise;

    #[inline(always)]
    fn run(self) -> Noise {
        let Self { own, near, scratch } = self;
        let n = near.len();
        let [a, b, variance, samples] = &near.data;
        let (a, b, variance, samples) = (&a[..n], &b[..n], &variance[..n], &samples[..n]);
        let [weight, square] = &mut scratch.weight;
        weight.resize(n, 0.0);
        square.resize(n, 0.0);
        let (distance2, weight, square) = (&near.distance2[..n], &mut weight[..n], &mut square[..n]);
        let floor = indifferent(own.half);
        let mut out = Noise { variance: 0.0, ..*own };
        for (source, values, targets) in [(0, a, b), (1, b, a)] {
            let (value, own_variance) = (own.half[source], own.variance);
            for k in 0..n {
                let w = (1.0 - 0.8 * distance2[k]) * alike(value - values[k], own_variance + variance[k], floor);
                weight[k] = w * samples[k].sqrt();
                square[k] = weight[k] * weight[k];
            }
            let weights = total(weight);
            if weights <= 0.0 {
                return *own;
            }
            let ([sum], [spread]) = (weighted_sums(weight, [targets]), weighted_sums(square, [variance]));
            out.half[1 - source] = sum / weights;
            out.variance = out.variance.max(spread / (weights * weights));
        }
        out
    }
}

/// Squared differences below this never separate two texels.
fn indifferent(own: [f32; 2]) -> f32 {
    // a maximum, not a sum: it leaves the last bit alone, so that exposure changes nothing
    (INDIFFERENT * own[0].max(own[1])).powi(2).max(f32::MIN_POSITIVE)
}

/// Weight of a texel that differs by `difference` where noise makes `variance` and `floor` counts as nothing: (1 − d/D)⁶ up to
/// d = D = [`DIFFERENT`], zero beyond, about exp(−6 d/D) at the price of a few products.
#[inline(always)]
fn alike(difference: f32, variance: f32, floor: f32) -> f32 {
    let d = (difference * difference - variance).max(0.0) / (variance + floor);
    let a = (1.0 - d * (1.0 / DIFFERENT)).max(0.0);
    let a2 = a * a;
    a2 * a2 * a2
}

/// The regression's value at texel `i` for both halves.
struct Regression<'a> {
    patches: &'a [Patch],
    i: usize,
    /// Its guide.
    own: &'a Noise,
    half: [Vec3; 2],
    around: &'a Near<NODE>,
    scratch: &'a mut Scratch,
}

impl Kernel for Regression<'_> {
    type Output = [Vec3; 2];

    #[inline(always)]
    fn run(self) -> [Vec3; 2] {
        let Self { patches, i, own, half, around, scratch } = self;
        let (n, patch) = (around.len(), &patches[i]);
        let Scratch { weight, terms, product } = scratch;
        let frame = Frame::from_normal(patch.normal);
        let scale = 1.0 / (REACH * patch.size).max(f32::MIN_POSITIVE);
        around.along(patches, patch, [frame.t, frame.b], [scale, TURN], terms);
        weight.iter_mut().for_each(|c| c.resize(n, 0.0));
        product.resize(n, 0.0);
        let [.., a, b, variance, samples] = &around.data;
        let (a, b, variance, samples) = (&a[..n], &b[..n], &variance[..n], &samples[..n]);
        let [w0, w1] = weight;
        let (w0, w1) = (&mut w0[..n], &mut w1[..n]);
        let distance2 = &around.distance2[..n];
        let floor = indifferent(own.half);
        let ([half0, half1], own_variance) = (own.half, own.variance);
        for k in 0..n {
            let noise = own_variance + variance[k];
            let kernel = (1.0 - distance2[k]) * (1.0 - distance2[k]) * samples[k];
            // the weights of one half's values come from the other
            w1[k] = kernel * alike(half0 - a[k], noise, floor);
            w0[k] = kernel * alike(half1 - b[k], noise, floor);
        }
        let terms = [&terms[0][..n], &terms[1][..n], &terms[2][..n], &terms[3][..n]];
        let mut out = half;
        // (closures given to library functions would be compiled for the baseline)
        for (h, weight) in [w0, w1].into_iter().enumerate() {
            let values = [&around.data[3 * h][..n], &around.data[3 * h + 1][..n], &around.data[3 * h + 2][..n]];
            let Some(value) = intercept(weight, terms, values, &mut product[..n]) else { continue };
            // where the neighbours lie to one side the slopes extrapolate: the small disc says how far that may go
            let (l, reach) = (luminance(value), PLAUSIBLE * own.variance.sqrt());
            let limited = l.clamp((own.half[h] - reach).max(0.0), own.half[h] + reach);
            out[h] = if l > 0.0 { value * (limited / l) } else { value };
        }
        out
    }
}

/// Value of a weighted regression on a constant and `slopes` where the slopes' terms vanish; `product` is overwritten.
#[inline(always)]
fn intercept(weight: &[f32], slopes: [&[f32]; SLOPES], values: [&[f32]; 3], product: &mut [f32]) -> Option<Vec3> {
    let weights = total(weight);
    if weights <= 0.0 {
        return None;
    }
    let mut a = SMatrix::<f32, TERMS, TERMS>::zeros();
    let mut right = [Vec3::ZERO; TERMS];
    a[(0, 0)] = weights;
    right[0] = Vec3::from_array(weighted_sums(weight, values));
    for r in 0..SLOPES {
        for (p, (w, t)) in product.iter_mut().zip(weight.iter().zip(slopes[r])) {
            *p = w * t;
        }
        a[(r + 1, 0)] = total(product);
        for (c, sum) in weighted_sums(product, slopes).into_iter().enumerate().take(r + 1) {
            a[(r + 1, c + 1)] = sum;
        }
        a[(r + 1, r + 1)] += RIDGE * weights;
        right[r + 1] = Vec3::from_array(weighted_sums(product, values));
    }
    let mut unit = SVector::<f32, TERMS>::zeros();
    unit[0] = 1.0;
    // the first row of the inverse times the right side; of the matrix only the lower triangle is read
    let row = a.cholesky()?.solve(&unit);
    Some((0..TERMS).fold(Vec3::ZERO, |s, r| s + right[r] * row[r]).max(Vec3::ZERO))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::KeyedRng;

    /// Every third texel has many samples and is darker than its noisy neighbours: their light must not be mixed into it.
    #[test]
    fn many_samples_are_not_spoilt_by_noisy_neighbours() {
        const SIDE: usize = 30;
        let many = |i: usize| (i % SIDE + i / SIDE).is_multiple_of(3);
        let truth = |i: usize| if many(i) { 1.0 } else { 1.1 };
        let patches: Vec<Patch> = (0..SIDE * SIDE)
            .map(|i| Patch { position: Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0), normal: Vec3::Z, size: 1.0 })
            .collect();
        let level: Vec<u8> = (0..patches.len()).map(|i| if many(i) { 8 } else { 0 }).collect();
        let halves: Vec<[Vec3; 2]> = (0..patches.len())
            .map(|i| {
                let mut rng = KeyedRng::new(7, i as u64);
                let noise = if many(i) { 0.02 } else { 0.32 };
                // even over ±√3 standard deviations
                [0, 1].map(|_| Vec3::splat(truth(i) * (1.0 + noise * 12f32.sqrt() * (rng.next_f32() - 0.5))))
            })
            .collect();
        let value = halves.iter().map(|h| 0.5 * (h[0] + h[1])).collect();
        let baked = Irradiance { value, halves, ..Irradiance::default() };
        let (filtered, _) = SurfaceFilter::new(&patches).filter(&baked, &level, |_| true);
        let fine: Vec<usize> = (0..patches.len()).filter(|&i| many(i)).collect();
        let error = |v: &[Vec3]| (fine.iter().map(|&i| (v[i].x - 1.0).powi(2)).sum::<f32>() / fine.len() as f32).sqrt();
        let (before, after) = (error(&baked.value), error(&filtered.value));
        assert!(after < 0.75 * before, "{before} before the filter, {after} after it");
    }
}
