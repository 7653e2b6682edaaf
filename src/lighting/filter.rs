//! Variance-guided filtering of baked irradiance over the surface.
//!
//! Neighbouring texels of one smooth surface see almost the same light, so their samples can be shared. Every texel is replaced by a
//! local linear regression over the texels around it, in position and normal, with non-local-means weights (Bitterli et al. 2016,
//! "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo Renderings"; Rousselle et al. 2012): a gradient costs no
//! bias, not even where a chart ends, and shadow edges stay where they exceed the noise. Weights come from one half of the samples and
//! are applied to the other, so that noise does not choose its own company. Texels are neighbours in space, across charts. No surface is
//! quite as even as the regression: a texel with many samples keeps its own estimate.

use super::Irradiance;
use super::neighbourhood::{Candidates, Neighbourhood, Patch};
use crate::ffi::simd::with_widest;
use crate::math::{Frame, luminance};
use glam::{Vec2, Vec3, Vec4};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Reach of the regression in texels.
const REACH: f32 = 9.0;
/// Reach in texels of what is compared: values averaged over so small a disc that shadow edges survive.
const DISC: f32 = 2.5;
/// Relative differences that never separate two texels.
const INDIFFERENT: f32 = 2e-3;
/// Terms of the regression: constant, two of position, two of the normal.
const TERMS: usize = 5;
/// Ridge on the slopes relative to the weights' sum: decides only where the neighbours do not.
const RIDGE: f32 = 1e-3;
/// Standard deviations of the small disc's mean that the regression may lie off it.
const PLAUSIBLE: f32 = 3.0;
/// How far irradiance departs from the regression, relative: as much of a texel's own estimate is mixed in as its noise, beside this,
/// deserves. Measured over texels of few and of many samples alike (CHANGELOG).
const UNEVEN: f32 = 0.01;
/// Variance of the mean of two halves of a net as a share of that of unrelated halves that differ as much: they complement each other
/// (measured: 0.7 for 64 rays, 0.55 for 128, 0.47 for 256 and more).
const COMPLEMENTARY: f32 = 0.6;

/// The neighbourhoods of a set of texels.
pub struct SurfaceFilter<'a> {
    patches: &'a [Patch],
    disc: Neighbourhood,
    wide: Neighbourhood,
}

/// A texel's two halves and what its weights are made from.
#[derive(Clone, Copy, Default)]
struct Node {
    half: [Vec3; 2],
    /// Luminance of each half over the small disc.
    guide: [f32; 2],
    /// Variance of the guide.
    variance: f32,
    /// Number of samples relative to other texels.
    samples: f32,
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
}

impl<'a> SurfaceFilter<'a> {
    /// Finds the neighbourhoods of the texels.
    #[must_use]
    pub fn new(patches: &'a [Patch]) -> Self {
        Self { patches, disc: Neighbourhood::new(patches, DISC), wide: Neighbourhood::new(patches, REACH) }
    }

    /// The filtered irradiance of `baked` (one value per texel, from 2^`level` times as many samples as the fewest); its `error` tells
    /// the relative error that remains, bias included. Beside it the part of that error that is
    /// not itself noise: what should decide where samples are added. Texels not `asked` for keep their own estimate.
    #[must_use]
    pub fn filter(&self, baked: &Irradiance, level: &[u8], asked: impl Fn(usize) -> bool + Sync) -> (Irradiance, Vec<f32>) {
        let noise = self.noise(baked, level);
        let guides = self.disc.map(self.patches, &noise, |i, near| guide(&self.patches[i], &noise[i], near));
        let nodes: Vec<Node> = baked
            .halves
            .par_iter()
            .zip(&guides)
            .zip(level)
            .map(|((half, g), l)| Node { half: *half, guide: g.half, variance: g.variance, samples: f32::from(1u16 << l) })
            .collect();
        let halves = self.wide.map(self.patches, &nodes, |i, around| {
            if !asked(i) {
                return baked.halves[i];
            }
            let smooth = with_widest(|| regress(&self.patches[i], &nodes[i], around));
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
        let own: Vec<([f32; 2], f32)> =
            baked.halves.par_iter().zip(level).map(|(h, l)| (h.map(luminance), samples(*l))).collect();
        self.disc.map(self.patches, &own, |i, near| {
            let (mut variance, mut square) = (0.0, 0.0);
            near.each(&self.patches[i], |_, ([a, b], n), _| {
                variance += n * 0.5 * (a - b).powi(2);
                square += (0.5 * (a + b)).powi(2);
            });
            let (half, n) = own[i];
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
        self.disc.map(self.patches, &own, |i, near| {
            let mut sum = Vec4::ZERO;
            near.each(&self.patches[i], |_, x, _| sum += Vec4::from_array(*x));
            let relative = |missed: f32| if sum.z > 0.0 { (missed.max(sum.y) / sum.z).sqrt() } else { 0.0 };
            (relative(sum.x), relative(sum.x - sum.w.sqrt()))
        })
    }
}

/// Mean of each half over the disc, without texels that the other half finds different beyond its noise. Texels count by the square
/// root of their samples: if all counted alike, noisy ones would spoil what many samples bought; if by their precision, one or two
/// would decide, however uneven the surface (CHANGELOG).
fn guide(patch: &Patch, own: &Noise, near: &Candidates<Noise>) -> Noise {
    let (mut sum, mut total, mut square) = ([0.0f32; 2], [0.0f32; 2], [0.0f32; 2]);
    let floor = indifferent(own.half);
    near.each(patch, |_, other, distance2| {
        let noise = own.variance + other.variance;
        for source in 0..2 {
            let d = ((own.half[source] - other.half[source]).powi(2) - noise).max(0.0) / (noise + floor);
            let w = (1.0 - 0.8 * distance2) * falloff(d) * other.samples.sqrt();
            sum[1 - source] += w * other.half[1 - source];
            total[1 - source] += w;
            square[1 - source] += w * w * other.variance;
        }
    });
    if total[0].min(total[1]) <= 0.0 {
        return *own;
    }
    let variance = (square[0] / (total[0] * total[0])).max(square[1] / (total[1] * total[1]));
    Noise { half: [sum[0] / total[0], sum[1] / total[1]], variance, samples: own.samples }
}

/// Squared differences below this never separate two texels.
fn indifferent(own: [f32; 2]) -> f32 {
    // a maximum, not a sum: it leaves the last bit alone, so that exposure changes nothing
    (INDIFFERENT * own[0].max(own[1])).powi(2).max(f32::MIN_POSITIVE)
}

/// (1 − d/6)⁶ up to d = 6, zero beyond: about exp(−d) at the price of a few products.
#[inline]
fn falloff(d: f32) -> f32 {
    let a = (1.0 - d * (1.0 / 6.0)).max(0.0);
    let a2 = a * a;
    a2 * a2 * a2
}

/// Sums of a weighted regression of one half, in rows that fill vector registers: the lower triangle of the normal matrix, and the
/// right sides of the three channels.
#[derive(Clone, Copy, Default)]
struct Sums {
    matrix: [f32; ROW],
    right: [f32; ROW],
}

/// Products of terms, and of terms and channels, rounded up.
const ROW: usize = 16;
const _: () = assert!(TERMS * (TERMS + 1) / 2 <= ROW && TERMS * 3 <= ROW);

/// Where the product of two terms is stored, the later one first.
const fn place(r: usize, c: usize) -> usize {
    r * (r + 1) / 2 + c
}

/// Products of every two terms.
#[inline(always)]
fn squares(terms: &[f32; TERMS]) -> [f32; ROW] {
    let mut out = [0.0; ROW];
    for r in 0..TERMS {
        for c in 0..=r {
            out[place(r, c)] = terms[r] * terms[c];
        }
    }
    out
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, w: f32, terms: &[f32; TERMS], squares: &[f32; ROW], value: Vec3) {
        let mut right = [0.0; ROW];
        for (out, term) in right.chunks_exact_mut(3).zip(terms) {
            (out[0], out[1], out[2]) = (term * value.x, term * value.y, term * value.z);
        }
        for k in 0..ROW {
            self.matrix[k] += w * squares[k];
            self.right[k] += w * right[k];
        }
    }

    /// The regression's value where all terms but the constant vanish.
    fn intercept(&self) -> Option<Vec3> {
        let total = self.matrix[0];
        if total <= 0.0 {
            return None;
        }
        let a = SMatrix::<f32, TERMS, TERMS>::from_fn(|r, c| {
            let v = self.matrix[place(r.max(c), r.min(c))];
            if r == c && r > 0 { v + RIDGE * total } else { v }
        });
        let mut unit = SVector::<f32, TERMS>::zeros();
        unit[0] = 1.0;
        // the first row of the inverse times the right side
        let row = a.cholesky()?.solve(&unit);
        let right = |r: usize| Vec3::from_slice(&self.right[3 * r..]);
        Some((0..TERMS).fold(Vec3::ZERO, |s, r| s + right(r) * row[r]).max(Vec3::ZERO))
    }
}

/// The regression's value at a texel for both halves.
#[inline(always)]
fn regress(patch: &Patch, own: &Node, around: &Candidates<Node>) -> [Vec3; 2] {
    let frame = Frame::from_normal(patch.normal);
    let scale = 1.0 / (REACH * patch.size).max(f32::MIN_POSITIVE);
    let floor = indifferent(own.guide);
    let mut sums = [Sums::default(); 2];
    around.each(patch, |q, other, distance2| {
        let noise = own.variance + other.variance;
        let step = q.position - patch.position;
        let step = Vec2::new(step.dot(frame.t), step.dot(frame.b)) * scale;
        let turn = Vec2::new(q.normal.dot(frame.t), q.normal.dot(frame.b)) * 4.0;
        let terms = [1.0, step.x, step.y, turn.x, turn.y];
        let squares = squares(&terms);
        let kernel = (1.0 - distance2).powi(2);
        for source in 0..2 {
            let d = ((own.guide[source] - other.guide[source]).powi(2) - noise).max(0.0) / (noise + floor);
            let w = kernel * other.samples * falloff(d);
            if w > 0.0 {
                sums[1 - source].add(w, &terms, &squares, other.half[1 - source]);
            }
        }
    });
    [0, 1].map(|k| {
        let Some(value) = sums[k].intercept() else { return own.half[k] };
        // where the neighbours lie to one side the slopes extrapolate: the small disc says how far that may go
        let (l, reach) = (luminance(value), PLAUSIBLE * own.variance.sqrt());
        let limited = l.clamp((own.guide[k] - reach).max(0.0), own.guide[k] + reach);
        if l > 0.0 { value * (limited / l) } else { value }
    })
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
