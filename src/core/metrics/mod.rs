//! Image scores: MSE, PSNR, SSIM, relative RMSE, plain and masked.
//!
//! All scores have peak 1 and clip both images to [0, 1]. A non-finite value counts as the largest
//! possible error (1), so that a NaN never raises a score. Sums run in f64 over fixed chunks: the
//! same bits for any number of threads.

mod ssim;

pub use ssim::{masked_ssim, ssim};

use crate::core::image::{Plane, RgbPlane};
use crate::core::parallel::{CHUNK, map_chunks, sum_f64};
use glam::Vec3;

/// The smallest MSE that PSNR distinguishes: identical images score 100 dB, a number that every
/// reader of JSON understands.
pub const SMALLEST_MSE: f64 = 1e-10;

/// PSNR in dB of a mean squared error with peak 1: −10·log10(MSE), at most 100 dB (see
/// [`SMALLEST_MSE`]).
#[must_use]
pub fn psnr(mse: f64) -> f64 {
    -10.0 * mse.max(SMALLEST_MSE).log10()
}

/// Squared difference of two values clipped to [0, 1]; 1 where either is not finite.
#[must_use]
pub fn squared_error(a: f32, b: f32) -> f64 {
    if !a.is_finite() || !b.is_finite() {
        return 1.0;
    }
    let d = f64::from(a.clamp(0.0, 1.0)) - f64::from(b.clamp(0.0, 1.0));
    d * d
}

/// A value with one or three channels that scores treat alike.
pub trait Channels: Copy + Send + Sync {
    /// Number of channels.
    const COUNT: usize;
    /// Value of channel `c`.
    fn channel(&self, c: usize) -> f32;
}

impl Channels for f32 {
    const COUNT: usize = 1;
    fn channel(&self, _: usize) -> f32 {
        *self
    }
}

impl Channels for Vec3 {
    const COUNT: usize = 3;
    fn channel(&self, c: usize) -> f32 {
        self[c]
    }
}

/// Mean squared error over all pixels and channels, values clipped to [0, 1].
///
/// # Panics
/// If the planes differ in size.
#[must_use]
pub fn mse<T: Channels>(a: &Plane<T>, b: &Plane<T>) -> f64 {
    assert_same_size(a, b);
    let total = sum_f64(a.data.len(), |i| {
        (0..T::COUNT)
            .map(|c| squared_error(a.data[i].channel(c), b.data[i].channel(c)))
            .sum()
    });
    total / (a.data.len() * T::COUNT).max(1) as f64
}

/// Mean squared error over the pixels where `mask` holds; `None` if it holds nowhere.
///
/// # Panics
/// If the planes differ in size.
#[must_use]
pub fn masked_mse<T: Channels>(a: &Plane<T>, b: &Plane<T>, mask: &Plane<bool>) -> Option<f64> {
    assert_same_size(a, b);
    assert_same_size(a, mask);
    let count = mask.data.iter().filter(|m| **m).count();
    let total = sum_f64(a.data.len(), |i| {
        if mask.data[i] {
            (0..T::COUNT)
                .map(|c| squared_error(a.data[i].channel(c), b.data[i].channel(c)))
                .sum()
        } else {
            0.0
        }
    });
    (count > 0).then(|| total / (count * T::COUNT) as f64)
}

/// Relative RMSE √(Σ|a − b|² / Σ|b|²) over all values, unclipped; `None` if the reference is zero
/// everywhere.
///
/// # Panics
/// If the slices differ in length.
#[must_use]
pub fn relative_rmse(estimate: &[Vec3], reference: &[Vec3]) -> Option<f64> {
    assert_eq!(
        estimate.len(),
        reference.len(),
        "relative RMSE of slices of different length"
    );
    let parts = map_chunks(reference.len(), CHUNK, |r| {
        r.fold((0.0, 0.0), |(error, power), i| {
            let (a, b) = (estimate[i].as_dvec3(), reference[i].as_dvec3());
            (error + (a - b).length_squared(), power + b.length_squared())
        })
    });
    let (error, power) = parts
        .into_iter()
        .fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    (power > 0.0).then(|| (error / power).sqrt())
}

/// The scalar s that minimises Σ|s·prediction − reference|² over the masked pixels, all channels
/// together: ⟨p, r⟩ / ⟨p, p⟩. 1 where the prediction is zero (nothing to scale).
///
/// # Panics
/// If the planes differ in size.
#[must_use]
pub fn least_squares_scale(prediction: &RgbPlane, reference: &RgbPlane, mask: &Plane<bool>) -> f64 {
    assert_same_size(prediction, reference);
    assert_same_size(prediction, mask);
    let parts = map_chunks(prediction.data.len(), CHUNK, |r| {
        r.filter(|&i| {
            mask.data[i] && prediction.data[i].is_finite() && reference.data[i].is_finite()
        })
        .fold((0.0, 0.0), |(cross, power), i| {
            let (p, r) = (prediction.data[i].as_dvec3(), reference.data[i].as_dvec3());
            (cross + p.dot(r), power + p.length_squared())
        })
    });
    let (cross, power) = parts
        .into_iter()
        .fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    if power > 0.0 { cross / power } else { 1.0 }
}

fn assert_same_size<A, B>(a: &Plane<A>, b: &Plane<B>) {
    assert_eq!(
        (a.width, a.height),
        (b.width, b.height),
        "scores need planes of one size"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn psnr_of_a_constant_offset_is_its_closed_form() {
        let a = Plane::filled(40, 30, Vec3::splat(0.5));
        let b = Plane::filled(40, 30, Vec3::splat(0.6));
        let m = mse(&a, &b);
        assert!((m - 0.01).abs() < 1e-8, "{m}");
        assert!((psnr(m) - 20.0).abs() < 1e-4);
        assert!(
            (psnr(mse(&a, &a)) - 100.0).abs() < 1e-12,
            "identical images score 100 dB"
        );
    }

    #[test]
    fn values_are_clipped_and_nan_is_the_largest_error() {
        let a = Plane::filled(2, 1, 7.0f32);
        let b = Plane::filled(2, 1, 1.0f32);
        assert!(mse(&a, &b) < 1e-12, "7 clips to 1");
        let nan = Plane::filled(2, 1, f32::NAN);
        assert!((mse(&nan, &b) - 1.0).abs() < 1e-12);
        assert!((mse(&nan, &nan) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn mask_leaves_pixels_out() {
        let a = Plane {
            width: 2,
            height: 1,
            data: vec![0.0f32, 0.0],
        };
        let b = Plane {
            width: 2,
            height: 1,
            data: vec![0.2f32, 1.0],
        };
        let mask = Plane {
            width: 2,
            height: 1,
            data: vec![true, false],
        };
        let m = masked_mse(&a, &b, &mask).expect("one pixel");
        assert!((m - 0.04).abs() < 1e-8);
        assert!(masked_mse(&a, &b, &Plane::filled(2, 1, false)).is_none());
        let full = masked_mse(&a, &b, &Plane::filled(2, 1, true)).expect("two pixels");
        assert!((full - mse(&a, &b)).abs() < 1e-15);
    }

    #[test]
    fn relative_rmse_of_one_percent_is_one_percent() {
        let reference: Vec<Vec3> = (1..9999).map(|i| Vec3::new(i as f32, 2.0, 0.5)).collect();
        let estimate: Vec<Vec3> = reference.iter().map(|v| *v * 1.01).collect();
        let r = relative_rmse(&estimate, &reference).expect("power");
        assert!((r - 0.01).abs() < 1e-6, "{r}");
        assert!(relative_rmse(&[Vec3::ONE], &[Vec3::ZERO]).is_none());
    }

    #[test]
    fn least_squares_scale_recovers_a_factor_and_ignores_the_mask() {
        let p = Plane {
            width: 3,
            height: 1,
            data: vec![Vec3::new(0.1, 0.2, 0.3), Vec3::splat(0.4), Vec3::splat(9.0)],
        };
        let mut r = p.map(|v| *v * 1.7);
        r.data[2] = Vec3::ZERO;
        let mask = Plane {
            width: 3,
            height: 1,
            data: vec![true, true, false],
        };
        assert!((least_squares_scale(&p, &r, &mask) - 1.7).abs() < 1e-6);
        assert!((least_squares_scale(&p.map(|_| Vec3::ZERO), &r, &mask) - 1.0).abs() < 1e-12);
    }
}
