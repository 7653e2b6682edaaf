//! Scores with the exposure taken out (gain-compensated PSNR), and the ceiling they stand under.
//!
//! A photograph of a real room often has an exposure and a white balance of its own, which says
//! nothing about materials. A gain g multiplies linear radiance L before the display transform
//! v = clamp((g·L)^(1/2.2), 0, 1). Since (g·L)^(1/2.2) = s·L^(1/2.2) with s = g^(1/2.2), the gain
//! that minimises the scored error is linear least squares in s over the values s does not clip.
//!
//! The ceiling is the fused radiance itself (`radiance.exr`) seen through the same cameras: what
//! mesh, poses and texture resolution allow before any model of light and material. Called by
//! [`super::evaluate`] for every view it scores.

use super::image_scores::ImageScores;
use super::protocol::DISPLAY_EXPONENT;
use crate::core::image::{Plane, RgbPlane};
use crate::core::metrics::{masked_mse, psnr};
use crate::core::parallel::{CHUNK, map_chunks};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Rounds of least squares, each over what the last one left unclipped. Derived: which values are
/// clipped settles in a handful of rounds; the best round counts, settled or not.
const ROUNDS: usize = 32;

/// Scores of a set of views as they are and with fitted gains; PSNRs are those of the mean MSE, dB.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainScores {
    /// The re-rendering as it is.
    pub psnr: f64,
    /// The re-rendering with one gain per view.
    pub psnr_gain_per_view: f64,
    /// The re-rendering with one gain per view and channel.
    pub psnr_gain_per_channel: f64,
    /// The fused radiance seen through the cameras, with one gain per view: to be compared with
    /// `psnr_gain_per_view`. Absent where the renderer holds no radiance.
    pub ceiling_reprojected_psnr: Option<f64>,
    /// The same as it is: to be compared with `psnr`.
    pub ceiling_reprojected_psnr_as_is: Option<f64>,
    /// Mean structural similarity of the re-rendering as it is.
    pub ssim: f64,
    /// Mean over views of the mean squared error of the re-rendering as it is.
    pub mse: f64,
}

/// A view's gain and its mean squared errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GainFit {
    /// Gain on linear radiance with which an image comes closest to the photograph.
    pub(super) gain: f64,
    /// Error with one gain.
    pub(super) per_view: f64,
    /// Error with one gain per channel.
    pub(super) per_channel: f64,
    /// Error as it is.
    pub(super) as_is: f64,
}

impl GainFit {
    /// Fits gains to an image of a view. `image` and `photograph` are in display values at the
    /// working size, the image unclipped above; `None` if nothing counts.
    pub(super) fn of(
        image: &RgbPlane,
        photograph: &RgbPlane,
        counted: &Plane<bool>,
    ) -> Option<Self> {
        let as_is = masked_mse(image, photograph, counted)?;
        let (s, per_view) = best_scale(image, photograph, counted, 0..3);
        let channels = (0..3).map(|c| best_scale(image, photograph, counted, c..c + 1).1);
        Some(Self {
            gain: s.powf(DISPLAY_EXPONENT.into()),
            // (a fit may lose to no gain at all only by rounding)
            per_view: per_view.min(as_is),
            per_channel: (channels.sum::<f64>() / 3.0).min(per_view),
            as_is,
        })
    }
}

/// The factor on display values that minimises the squared error over some channels, and the mean
/// of that error over the counted pixels and these channels.
fn best_scale(
    image: &RgbPlane,
    photograph: &RgbPlane,
    counted: &Plane<bool>,
    channels: Range<usize>,
) -> (f64, f64) {
    let mut best = (1.0, f64::INFINITY);
    // 0 clips nothing: the first round is that of all values
    let mut s = 0.0;
    for _ in 0..ROUNDS {
        let sums = Sums::at(s, image, photograph, counted, channels.clone());
        let error = sums.error / sums.values.max(1) as f64;
        if error < best.1 && s > 0.0 {
            best = (s, error);
        }
        let next = sums.cross / sums.power;
        if !(next.is_finite() && next > 0.0) || next == s {
            break;
        }
        s = next;
    }
    if best.1.is_infinite() {
        // nothing to scale
        let sums = Sums::at(1.0, image, photograph, counted, channels);
        best.1 = sums.error / sums.values.max(1) as f64;
    }
    best
}

/// Sums over display values a of an image and b of a photograph under a factor s.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Σ ab over values that s does not clip.
    cross: f64,
    /// Σ a² over the same.
    power: f64,
    /// Σ (min(s·a, 1) − b)²; 1 for each value that is not finite, as in all scores.
    error: f64,
    values: usize,
}

impl Sums {
    fn at(
        s: f64,
        image: &RgbPlane,
        photograph: &RgbPlane,
        counted: &Plane<bool>,
        channels: Range<usize>,
    ) -> Self {
        let parts = map_chunks(image.data.len(), CHUNK, |range| {
            let mut sums = Self::default();
            for i in range.filter(|&i| counted.data[i]) {
                for c in channels.clone() {
                    sums.add(s, image.data[i][c].into(), photograph.data[i][c].into());
                }
            }
            sums
        });
        parts.into_iter().fold(Self::default(), |a, b| Self {
            cross: a.cross + b.cross,
            power: a.power + b.power,
            error: a.error + b.error,
            values: a.values + b.values,
        })
    }

    fn add(&mut self, s: f64, a: f64, b: f64) {
        self.values += 1;
        if !a.is_finite() || !b.is_finite() {
            self.error += 1.0;
            return;
        }
        self.error += ((s * a).clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2);
        if s * a < 1.0 {
            self.cross += a * b.clamp(0.0, 1.0);
            self.power += a * a;
        }
    }
}

/// Sums over the views of a split.
#[derive(Clone, Debug, Default)]
pub(super) struct GainTally {
    per_view: f64,
    per_channel: f64,
    ceiling_as_is: f64,
    ceiling_per_view: f64,
    views: usize,
    ceilings: usize,
}

impl GainTally {
    /// Adds a view: its re-rendering and, if there is one, its re-projected radiance.
    pub(super) fn add(&mut self, rendered: &GainFit, reprojected: Option<&GainFit>) {
        self.per_view += rendered.per_view;
        self.per_channel += rendered.per_channel;
        self.views += 1;
        if let Some(r) = reprojected {
            self.ceiling_as_is += r.as_is;
            self.ceiling_per_view += r.per_view;
            self.ceilings += 1;
        }
    }

    /// Beside the scores as they are.
    pub(super) fn finish(&self, plain: &ImageScores) -> GainScores {
        let mean = |sum: f64| psnr(sum / self.views.max(1) as f64);
        let every = self.ceilings == self.views && self.views > 0;
        GainScores {
            psnr: plain.psnr_of_mean_mse,
            psnr_gain_per_view: mean(self.per_view),
            psnr_gain_per_channel: mean(self.per_channel),
            ceiling_reprojected_psnr: every.then(|| mean(self.ceiling_per_view)),
            ceiling_reprojected_psnr_as_is: every.then(|| mean(self.ceiling_as_is)),
            ssim: plain.ssim,
            mse: plain.mse,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::programs::evaluate::protocol::{display, tone_mapped};
    use glam::Vec3;

    /// Radiance from 0.02 to about 1.5, every channel different.
    fn ramp() -> RgbPlane {
        Plane {
            width: 40,
            height: 20,
            data: (0..800)
                .map(|i| Vec3::new(1.0, 0.8, 0.5) * (0.02 + 1.5 * (i * i % 797) as f32 / 797.0))
                .collect(),
        }
    }

    fn fit(image: &RgbPlane, photograph: &RgbPlane) -> GainFit {
        let counted = Plane::filled(image.width, image.height, true);
        GainFit::of(
            &display(image, 1.0),
            &tone_mapped(photograph, 1.0),
            &counted,
        )
        .expect("counts")
    }

    #[test]
    fn a_known_gain_is_found_and_costs_nothing_though_pixels_clip() {
        for gain in [0.05f32, 0.5, 1.0, 1.7, 8.0] {
            let photograph = ramp().map(|v| *v * gain);
            let f = fit(&ramp(), &photograph);
            assert!(
                (f.gain / f64::from(gain) - 1.0).abs() < 1e-3,
                "{gain}: {f:?}"
            );
            assert!(psnr(f.per_view) > 80.0, "{gain}: {f:?}");
            assert!(gain == 1.0 || psnr(f.as_is) < 40.0, "{gain}: {f:?}");
        }
    }

    #[test]
    fn white_balance_needs_a_gain_per_channel() {
        let balance = Vec3::new(1.3, 1.0, 0.6);
        let f = fit(&ramp(), &ramp().map(|v| *v * balance));
        assert!(
            psnr(f.per_channel) > 80.0 && psnr(f.per_view) < 40.0,
            "{f:?}"
        );
        assert!(f.per_view < f.as_is);
    }

    #[test]
    fn what_no_gain_explains_stays_an_error() {
        // alternating ±: the mean level is right already
        let image = Plane::filled(16, 16, Vec3::splat(0.25));
        let photograph = Plane {
            data: (0..256)
                .map(|i| Vec3::splat(if i % 2 == 0 { 0.16 } else { 0.36 }))
                .collect(),
            ..image.clone()
        };
        let f = fit(&image, &photograph);
        let [a, b] = [0.16f64, 0.36].map(|x| x.powf(1.0 / 2.2));
        // the best constant is the mean of the two, its error half their difference squared
        let closed = (0.5 * (a - b)).powi(2);
        assert!((f.per_view / closed - 1.0).abs() < 1e-4, "{f:?} {closed}");
    }

    #[test]
    fn black_images_and_nan_are_no_trouble() {
        let black = Plane::filled(4, 4, Vec3::ZERO);
        let f = fit(&black, &ramp_of(&black));
        assert_eq!(f.gain, 1.0);
        let nan = Plane::filled(4, 4, Vec3::NAN);
        assert_eq!(fit(&nan, &ramp_of(&black)).per_view, 1.0);
        let none = Plane::filled(4, 4, false);
        assert_eq!(GainFit::of(&black, &black, &none), None);
    }

    fn ramp_of(like: &RgbPlane) -> RgbPlane {
        like.map(|_| Vec3::splat(0.3))
    }
}
