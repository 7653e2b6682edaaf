//! Detail of painted surface: a pattern that covers little of it is texture, and stays.
//!
//! A class whose flat surface hardly varies is painted ([`super::albedo_palette`]), though a pale
//! pattern may lie on a tenth of it. Errors of the light are smooth there, so that what a texel
//! differs by from the level around it, d, is noise or pattern. Both are taken for Gaussian about
//! zero: noise of the scale that most texels show, pattern of a wider one that covers a share π of
//! the class; π and the wider scale follow from the texels by expectation maximisation (Dempster,
//! Laird and Rubin 1977). What is kept of d is its posterior share of pattern: nothing of ordinary
//! noise, all of what stands out far, in hue above all, in which light errs least.

use super::flat_surface::{ENOUGH_FLAT, FlatSurface, LAG};
use super::palette_look::Look;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ROUNDS, median, passing_weight};
use glam::Vec3;
use std::collections::BTreeMap;

/// The level around a texel is that of 81 texels in a square of this share of the atlas to either
/// side, [`LAG`] apart at least: light varies over more, patterns over less (measured: docs/lab/albedo.md).
const AROUND: usize = 128;
/// Texels to either side. Derived: the median of (2 · 4 + 1)² errs by √(π/2) / 9, a seventh of their spread.
const SAMPLES: i64 = 4;
/// Texels that tell a level, of 81. Derived: between the 45 that a straight edge leaves and the 25 of a corner.
const ENOUGH: usize = 27;
/// Scale of a pattern over that of the noise from which it is one. Measured: noise with tails gives
/// 2.0 to 3.2 on plain paint of four scenes, pale sprigs 4.4 (docs/lab/albedo.md).
const DISTINCT: f64 = 4.0;
/// Median of the length of a Gaussian vector of three unit components. Derived: the root of χ²₃'s
/// median, 2.366.
const MEDIAN_OF_THREE: f32 = 1.538;

/// What texel `i` differs by from the level of flat surface around it, ln albedo; `None` where the
/// surface is not flat.
fn deviation(flat: &FlatSurface, looks: &[Look], i: usize) -> Option<Vec3> {
    if !flat.is_far_from_edges(i) {
        return None;
    }
    let step = ((flat.width() / AROUND) as i64 / SAMPLES).max(LAG);
    let mut around = Vec::with_capacity(81);
    for y in -SAMPLES..=SAMPLES {
        for x in -SAMPLES..=SAMPLES {
            around.extend(flat.alike(i, x * step, y * step).map(|j| looks[j].log));
        }
    }
    if around.len() < ENOUGH {
        return None;
    }
    // the median, for a pattern is the lesser part
    let half = around.len() / 2;
    let level = [0, 1, 2].map(|c| {
        let (_, middle, _) = around.select_nth_unstable_by(half, |a, b| a[c].total_cmp(&b[c]));
        middle[c]
    });
    Some(looks[i].log - Vec3::from_array(level))
}

/// What a texel differs by from the level around it.
#[derive(Clone, Copy, Debug)]
struct Deviation {
    /// ln albedo.
    log: Vec3,
    /// The texel's relative standard error.
    error: f32,
}

impl Deviation {
    fn length2(&self) -> f32 {
        Look::at(self.log, 1.0).distance2(Vec3::ZERO)
    }
}

/// Noise and pattern of one class.
#[derive(Clone, Copy, Debug)]
struct Mixture {
    noise: f32,
    pattern: f32,
    /// Share of pattern.
    share: f32,
    /// How surely there is one.
    surely: f32,
}

impl Mixture {
    fn of(deviations: &[Deviation]) -> Self {
        let lengths = (deviations.iter()).map(|d| d.length2().sqrt() / d.error);
        let noise = median(lengths.collect()).unwrap_or(0.0) / MEDIAN_OF_THREE;
        let usual = median(deviations.iter().map(|d| d.error).collect()).unwrap_or(1.0);
        let mut out = Self {
            noise,
            pattern: 6.0 * noise * usual,
            share: 0.1,
            surely: 1.0,
        };
        if noise <= f32::EPSILON {
            // (most texels are as their class says, to the bit: their noise is not known)
            return Self { surely: 0.0, ..out };
        }
        for _ in 0..ROUNDS {
            let (mut weight, mut square) = (0.0f64, 0.0f64);
            for d in deviations {
                let w = f64::from(out.pattern_share(*d));
                weight += w;
                square += w * f64::from(d.length2());
            }
            out.share = (weight / deviations.len() as f64) as f32;
            let scale = (square / (3.0 * weight).max(f64::MIN_POSITIVE)).sqrt() as f32;
            out.pattern = scale.max(noise * usual);
        }
        let wider = f64::from(out.pattern / (noise * usual));
        out.surely = passing_weight(wider, DISTINCT) as f32;
        out
    }

    /// How likely a deviation is pattern.
    fn pattern_share(&self, d: Deviation) -> f32 {
        let density = |scale: f32| {
            let look = Look::at(d.log, scale);
            look.density(look.distance2(Vec3::ZERO))
        };
        let (p, n) = (
            self.share * density(self.pattern),
            (1.0 - self.share) * density(self.noise * d.error),
        );
        // (far out both densities may vanish)
        if p + n > 0.0 { p / (p + n) } else { 1.0 }
    }
}

/// What is kept of every texel's deviation from its surroundings, ln albedo: zero where the class
/// is not asked for, or the surface not flat.
pub(super) fn kept_details(
    flat: &FlatSurface,
    looks: &[Look],
    labels: &[u16],
    is_painted: impl Fn(u16) -> bool + Sync,
) -> Vec<Vec3> {
    let found: Vec<Option<Deviation>> = (0..looks.len())
        .into_par_iter()
        .map(|i| {
            let log = is_painted(labels[i]).then(|| deviation(flat, looks, i))??;
            let error = looks[i].error;
            Some(Deviation { log, error })
        })
        .collect();
    let mut classes: BTreeMap<u16, Vec<Deviation>> = BTreeMap::new();
    for (label, d) in labels.iter().zip(&found) {
        if let Some(d) = d {
            classes.entry(*label).or_default().push(*d);
        }
    }
    let classes: Vec<(u16, Vec<Deviation>)> = classes.into_iter().collect();
    let mixtures: BTreeMap<u16, Mixture> = classes
        .into_par_iter()
        .filter(|(_, d)| d.len() >= ENOUGH_FLAT)
        .map(|(class, d)| (class, Mixture::of(&d)))
        .collect();
    (labels.par_iter().zip(&found))
        .map(|(label, d)| match (mixtures.get(label), d) {
            (Some(mixture), Some(d)) => d.log * (mixture.surely * mixture.pattern_share(*d)),
            _ => Vec3::ZERO,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    fn normal(rng: &mut KeyedRng) -> f32 {
        let (a, b) = (rng.next_f32().max(1e-7), rng.next_f32());
        (-2.0 * a.ln()).sqrt() * (std::f32::consts::TAU * b).cos()
    }

    /// Deviations in luminance of `noise(rng)`, and a step of `contrast` on a share of them.
    fn drawn(noise: impl Fn(&mut KeyedRng) -> f32, contrast: f32, share: f32) -> Vec<Deviation> {
        let mut rng = KeyedRng::new(5, 9);
        (0..20_000)
            .map(|_| {
                let step = if rng.next_f32() < share {
                    contrast
                } else {
                    0.0
                };
                let hue = Vec3::from_array([0, 1, 2].map(|_| 0.4 * 0.01 * normal(&mut rng)));
                Deviation {
                    log: Vec3::splat(noise(&mut rng) - step) + hue,
                    error: 0.03,
                }
            })
            .collect()
    }

    /// Gaussian noise of 1 % and a pattern of 12 % on a tenth: it is found with its share, its
    /// texels are kept and the others lose theirs.
    #[test]
    fn a_pattern_on_a_tenth_of_the_surface_is_kept() {
        let found = Mixture::of(&drawn(|rng| 0.01 * normal(rng), 0.12, 0.1));
        assert!((found.share - 0.1).abs() < 0.02, "{found:?}");
        assert!(found.surely > 0.99, "{found:?}");
        let kept = |level: f32| {
            found.pattern_share(Deviation {
                log: Vec3::splat(level),
                error: 0.03,
            })
        };
        assert!(kept(-0.12) > 0.99 && kept(0.01) < 0.05, "{found:?}");
    }

    /// Noise with tails is no pattern: Student's t with five degrees of freedom; nor is noise whose
    /// scale is zero.
    #[test]
    fn noise_with_tails_is_no_pattern() {
        let student = |rng: &mut KeyedRng| {
            let chi: f32 = (0..5).map(|_| normal(rng).powi(2)).sum();
            0.01 * normal(rng) / (chi / 5.0).sqrt()
        };
        let found = Mixture::of(&drawn(student, 0.0, 0.0));
        assert!(found.surely == 0.0, "{found:?}");
        let even = vec![
            Deviation {
                log: Vec3::ZERO,
                error: 0.03,
            };
            500
        ];
        assert!(Mixture::of(&even).surely == 0.0);
    }
}
