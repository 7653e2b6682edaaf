//! Variance-guided filtering of baked irradiance over the surface.
//!
//! Neighbouring texels of one smooth surface see almost the same light, so their samples can be shared. Every texel is replaced by a
//! local linear regression over the texels around it, in position and normal, with non-local-means weights (Bitterli et al. 2016,
//! "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo Renderings"; Rousselle et al. 2012): a gradient costs no
//! bias, not even where a chart ends, and shadow edges stay where they exceed the noise. Each part of the samples is weighted by what
//! the others say, so that noise does not choose its own company. Texels are neighbours in space, across charts. No surface is
//! quite as even as the regression: a texel with many samples keeps its own estimate.

use super::neighbourhood::{Near, Neighbourhood, Patch, total, weighted_sums};
use super::{Irradiance, PARTS, spread};
use crate::ffi::simd::{Kernel, run_widest, with_widest};
use crate::math::{Frame, luminance};
use glam::Vec3;
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Reach of the regression in texels.
const REACH: f32 = 6.0;
/// Reach in texels of what is compared: values averaged over so small a disc that shadow edges survive.
const COMPARED: f32 = 2.2;
/// Reach in texels over which noise and error are averaged.
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
const RIDGE: f32 = 1e-4;
/// Standard deviations of the small disc's mean that the regression may lie off it.
const PLAUSIBLE: f32 = 4.0;
/// How far irradiance departs from the regression, relative: as much of a texel's own estimate is mixed in as its noise, beside this,
/// deserves. Measured over texels of few and of many samples alike (CHANGELOG).
const UNEVEN: f32 = 0.008;
/// Variance of the mean of the parts of a net as a share of that of unrelated parts that differ as much: they complement each other.
const COMPLEMENTARY: f32 = 0.4;
/// Standard deviation of the mean of squares by which parts and filtered parts differ, in one part's variance.
const CHANCE: f32 = 0.36;
/// How many other parts a part is compared with.
const OTHERS: f32 = (PARTS - 1) as f32;

/// The neighbourhoods of a set of texels.
pub struct SurfaceFilter<'a> {
    patches: &'a [Patch],
    around: Neighbourhood,
    /// One over the difference from which texels have nothing in common ([`DIFFERENT`]).
    per_different: f32,
}

/// Luminance of the parts of a texel and the variance of one.
#[derive(Clone, Copy, Default)]
struct Noise {
    part: [f32; PARTS],
    variance: f32,
    /// Number of samples relative to other texels.
    samples: f32,
}

/// Columns of [`Noise`].
const NOISE: usize = PARTS + 2;

impl Noise {
    fn mean(&self) -> f32 {
        self.part.iter().sum::<f32>() / PARTS as f32
    }

    /// Weight of the texel's own estimate beside the regression's, whose error is taken to be [`UNEVEN`].
    fn own_share(&self) -> f32 {
        let uneven = (UNEVEN * self.mean()).powi(2);
        let variance = COMPLEMENTARY / PARTS as f32 * self.variance;
        if uneven > 0.0 { uneven / (uneven + variance) } else { 0.0 }
    }

    /// In place of every part the mean of the others.
    fn others(&self) -> Self {
        let sum = self.part.iter().sum::<f32>();
        Self { part: self.part.map(|p| (sum - p) / OTHERS), variance: self.variance / OTHERS, samples: self.samples }
    }

    /// The columns by which it travels: parts, variance, samples.
    fn columns(&self) -> [f32; NOISE] {
        std::array::from_fn(|c| match c.checked_sub(PARTS) {
            None => self.part[c],
            Some(0) => self.variance,
            Some(_) => self.samples,
        })
    }
}

/// Columns of the regression's data: the parts' channels, then those of the other parts' guides.
const NODE: usize = 3 * PARTS + NOISE;

/// Buffers of one thread, a column per candidate.
#[derive(Default)]
struct Scratch {
    weight: [Vec<f32>; 2],
    total: Vec<f32>,
    terms: [Vec<f32>; SLOPES],
}

impl<'a> SurfaceFilter<'a> {
    /// Finds the neighbourhoods of the texels.
    #[must_use]
    pub fn new(patches: &'a [Patch]) -> Self {
        Self { patches, around: Neighbourhood::new(patches), per_different: 1.0 / DIFFERENT }
    }

    /// The same for values of which a little bias costs more than noise: texels part at squared differences of `different` variances
    /// instead of 16.
    #[must_use]
    pub fn parting_at(self, different: f32) -> Self {
        Self { per_different: 1.0 / different, ..self }
    }

    /// The filtered irradiance of `baked` (one value per texel, from 2^`level` times as many samples as the fewest); its `error` tells
    /// the relative error that remains, bias included. Beside it the part of that error that is
    /// not itself noise: what should decide where samples are added. Texels not `asked` for keep their own estimate.
    #[must_use]
    pub fn filter(&self, baked: &Irradiance, level: &[u8], asked: impl Fn(usize) -> bool + Sync) -> (Irradiance, Vec<f32>) {
        // in a unit near the mean: whatever the exposure, nothing squared underflows
        let unit = power_of_two_near(baked);
        let scaled = baked.parts.par_iter().map(|parts| parts.map(|p| p / unit)).collect();
        let baked = &Irradiance { parts: scaled, rays: baked.rays, ..Irradiance::default() };
        let noise = self.noise(baked, level);
        let per_different = self.per_different;
        let columns: Vec<_> = noise.par_iter().map(Noise::columns).collect();
        let guides: Vec<Noise> = self.around.map(self.patches, &columns, COMPARED, |i, near, scratch| {
            run_widest(Guide { own: &noise[i], near, per_different, scratch })
        });
        let node = |i: usize| -> [f32; NODE] {
            let guide = guides[i].others().columns();
            let parts = &baked.parts[i];
            std::array::from_fn(|c| if c < 3 * PARTS { parts[c / 3][c % 3] } else { guide[c - 3 * PARTS] })
        };
        let nodes: Vec<[f32; NODE]> = (0..noise.len()).into_par_iter().map(node).collect();
        let parts = self.around.map(self.patches, &nodes, REACH, |i, around, scratch| {
            if !asked(i) {
                return baked.parts[i];
            }
            let regression =
                Regression { patches: self.patches, i, own: &guides[i], part: baked.parts[i], around, per_different, scratch };
            let (mut parts, own) = (run_widest(regression), noise[i].own_share());
            parts.iter_mut().zip(&baked.parts[i]).for_each(|(smooth, part)| *smooth = smooth.lerp(*part, own));
            parts
        });
        let (error, certain) = self.remaining_error(&noise, &parts, &asked).into_iter().unzip();
        let parts: Vec<[Vec3; PARTS]> = parts.into_par_iter().map(|parts| parts.map(|p| p * unit)).collect();
        let value = parts.par_iter().map(|p| p.iter().sum::<Vec3>() / PARTS as f32).collect();
        (Irradiance { value, parts, error, rays: baked.rays }, certain)
    }

    /// Variance of one part's luminance. The scatter of a single texel's parts is a poor variance: the relative variance of one sample is
    /// averaged over the disc.
    fn noise(&self, baked: &Irradiance, level: &[u8]) -> Vec<Noise> {
        let samples = |l: u8| f32::from(1u16 << l);
        let own = |(parts, l): (&[Vec3; PARTS], &u8)| {
            let (mean, variance) = spread(&parts.map(luminance));
            [samples(*l) * variance * mean * mean, mean * mean]
        };
        let own: Vec<[f32; 2]> = baked.parts.par_iter().zip(level).map(own).collect();
        self.around.map(self.patches, &own, DISC, |i, near, (): &mut ()| {
            let [variance, square] = with_widest(|| disc_sums(near));
            let (part, n) = (baked.parts[i].map(luminance), samples(level[i]));
            let noise = Noise { part, variance: 0.0, samples: n };
            Noise { variance: if square > 0.0 { variance / square * noise.mean().powi(2) / n } else { 0.0 }, ..noise }
        })
    }

    /// Relative error of the filtered texels: what a filtered part misses of the other, unfiltered ones beyond their noise and its own
    /// (what is left is bias and the mean's noise), averaged over the disc by samples (else those with few would speak for those with many); at least what the filtered parts' scatter tells. Then the same
    /// with the first estimate less one standard error: where the noise shared is large and what is left small, it is mostly chance.
    fn remaining_error(
        &self,
        noise: &[Noise],
        parts: &[[Vec3; PARTS]],
        asked: &(impl Fn(usize) -> bool + Sync),
    ) -> Vec<(f32, f32)> {
        let own: Vec<[f32; 6]> = noise
            .par_iter()
            .zip(parts)
            .enumerate()
            .map(|(i, (n, parts))| {
                if !asked(i) {
                    return [0.0; 6];
                }
                let smooth = parts.map(luminance);
                let (mean, variance) = spread(&smooth);
                let variance = variance * mean * mean;
                let others = n.others();
                let missed = smooth.iter().zip(&others.part).map(|(s, o)| (s - o).powi(2)).sum::<f32>() / PARTS as f32;
                let of_mean = variance / PARTS as f32;
                let terms = [missed - others.variance - (variance - of_mean), of_mean, mean * mean, n.variance, 1.0, n.samples];
                terms.map(|t| t * n.samples)
            })
            .collect();
        self.around.map(self.patches, &own, DISC, |_, near, (): &mut ()| {
            let [missed, differ, square, variance, weights, squares] = with_widest(|| disc_sums(near));
            let count = weights * weights / squares.max(f32::MIN_POSITIVE);
            let relative = |missed: f32| if square > 0.0 { (missed.max(differ) / square).sqrt() } else { 0.0 };
            (relative(missed), relative(missed - CHANCE * variance / count.max(1.0).sqrt()))
        })
    }
}

/// The power of two below the mean luminance of a bake; 1 where there is none.
fn power_of_two_near(baked: &Irradiance) -> f32 {
    let n = baked.value.len().max(1);
    let mean = crate::parallel::sum_f64(baked.value.len(), |i| f64::from(luminance(baked.value[i]))) / n as f64;
    let exponent = mean.log2().floor();
    if exponent.abs() < 120.0 { 2f32.powi(exponent as i32) } else { 1.0 }
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

/// Mean of each part over the disc, without texels that the other parts find different beyond their noise. Texels count by the square
/// root of their samples: if all counted alike, noisy ones would spoil what many samples bought; if by their precision, one or two
/// would decide, however uneven the surface (CHANGELOG).
struct Guide<'a> {
    own: &'a Noise,
    near: &'a Near<NOISE>,
    per_different: f32,
    scratch: &'a mut Scratch,
}

impl Kernel for Guide<'_> {
    type Output = Noise;

    #[inline(always)]
    fn run(self) -> Noise {
        let Self { own, near, per_different, scratch } = self;
        let n = near.len();
        let (variance, samples) = (&near.data[PARTS][..n], &near.data[PARTS + 1][..n]);
        let [weight, square] = &mut scratch.weight;
        for buffer in [&mut *weight, &mut *square, &mut scratch.total] {
            buffer.clear();
            buffer.resize(n, 0.0);
        }
        let (distance2, weight, square, total_of) =
            (&near.distance2[..n], &mut weight[..n], &mut square[..n], &mut scratch.total[..n]);
        for part in &near.data[..PARTS] {
            for (t, p) in total_of.iter_mut().zip(part) {
                *t += p;
            }
        }
        let sum = own.part.iter().sum::<f32>();
        let floor = indifferent(sum / PARTS as f32);
        let (own_variance, per_others) = (own.variance, 1.0 / OTHERS);
        let mut out = Noise { variance: 0.0, ..*own };
        for p in 0..PARTS {
            let (target, rest) = (&near.data[p][..n], sum - own.part[p]);
            for k in 0..n {
                let difference = (rest - (total_of[k] - target[k])) * per_others;
                let w = (1.0 - 0.8 * distance2[k])
                    * alike(difference, (own_variance + variance[k]) * per_others, floor, per_different);
                weight[k] = w * samples[k].sqrt();
                square[k] = weight[k] * weight[k];
            }
            let weights = total(weight);
            if weights <= 0.0 {
                return *own;
            }
            let ([sum], [spread]) = (weighted_sums(weight, [target]), weighted_sums(square, [variance]));
            out.part[p] = sum / weights;
            out.variance = out.variance.max(spread / (weights * weights));
        }
        out
    }
}

/// Squared differences below this never separate two texels of the luminance `own`.
fn indifferent(own: f32) -> f32 {
    (INDIFFERENT * own).powi(2).max(f32::MIN_POSITIVE)
}

/// Weight of a texel that differs by `difference` where noise makes `variance` and `floor` counts as nothing: (1 − d/D)⁶ up to
/// d = D, zero beyond, about exp(−6 d/D) at the price of a few products.
#[inline(always)]
fn alike(difference: f32, variance: f32, floor: f32, per_different: f32) -> f32 {
    let d = (difference * difference - variance).max(0.0) / (variance + floor);
    let a = (1.0 - d * per_different).max(0.0);
    let a2 = a * a;
    a2 * a2 * a2
}

/// The regression's value at texel `i` for every part.
struct Regression<'a> {
    patches: &'a [Patch],
    i: usize,
    /// Its guide.
    own: &'a Noise,
    part: [Vec3; PARTS],
    around: &'a Near<NODE>,
    per_different: f32,
    scratch: &'a mut Scratch,
}

impl Kernel for Regression<'_> {
    type Output = [Vec3; PARTS];

    #[inline(always)]
    fn run(self) -> [Vec3; PARTS] {
        let Self { patches, i, own, part, around, per_different, scratch } = self;
        let (n, patch) = (around.len(), &patches[i]);
        let Scratch { weight: [weight, product], total: kernel, terms } = scratch;
        let frame = Frame::from_normal(patch.normal);
        let scale = 1.0 / (REACH * patch.size).max(f32::MIN_POSITIVE);
        around.along(patches, patch, [frame.t, frame.b], [scale, TURN], terms);
        for buffer in [&mut *weight, &mut *product, &mut *kernel] {
            buffer.resize(n, 0.0);
        }
        let (weight, product, kernel) = (&mut weight[..n], &mut product[..n], &mut kernel[..n]);
        let [variance, samples] = [&around.data[NODE - 2], &around.data[NODE - 1]].map(|c| &c[..n]);
        let distance2 = &around.distance2[..n];
        for k in 0..n {
            kernel[k] = (1.0 - distance2[k]) * (1.0 - distance2[k]) * samples[k];
        }
        let terms = [&terms[0][..n], &terms[1][..n], &terms[2][..n], &terms[3][..n]];
        let (others, floor) = (own.others(), indifferent(own.mean()));
        let (own_variance, reach) = (others.variance, PLAUSIBLE * own.variance.sqrt());
        let mut out = part;
        // (closures given to library functions would be compiled for the baseline)
        for (p, out) in out.iter_mut().enumerate() {
            // the weights of one part's values come from the others
            let (told, own_told) = (&around.data[3 * PARTS + p][..n], others.part[p]);
            for k in 0..n {
                weight[k] = kernel[k] * alike(own_told - told[k], own_variance + variance[k], floor, per_different);
            }
            let values = [&around.data[3 * p][..n], &around.data[3 * p + 1][..n], &around.data[3 * p + 2][..n]];
            let Some(value) = intercept(weight, terms, values, product) else { continue };
            // where the neighbours lie to one side the slopes extrapolate: the small disc says how far that may go
            let l = luminance(value);
            let limited = l.clamp((own.part[p] - reach).max(0.0), own.part[p] + reach);
            *out = if l > 0.0 { value * (limited / l) } else { value };
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
        let parts: Vec<[Vec3; PARTS]> = (0..patches.len())
            .map(|i| {
                let mut rng = KeyedRng::new(7, i as u64);
                let noise = if many(i) { 0.03 } else { 0.45 };
                // even over ±√3 standard deviations
                std::array::from_fn(|_| Vec3::splat(truth(i) * (1.0 + noise * 12f32.sqrt() * (rng.next_f32() - 0.5))))
            })
            .collect();
        let value = parts.iter().map(|p| p.iter().sum::<Vec3>() / PARTS as f32).collect();
        let baked = Irradiance { value, parts, ..Irradiance::default() };
        let (filtered, _) = SurfaceFilter::new(&patches).filter(&baked, &level, |_| true);
        let fine: Vec<usize> = (0..patches.len()).filter(|&i| many(i)).collect();
        let error = |v: &[Vec3]| (fine.iter().map(|&i| (v[i].x - 1.0).powi(2)).sum::<f32>() / fine.len() as f32).sqrt();
        let (before, after) = (error(&baked.value), error(&filtered.value));
        assert!(after < 0.75 * before, "{before} before the filter, {after} after it");
    }
}
