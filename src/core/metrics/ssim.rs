//! Structural similarity (Wang et al. 2004) in the form that `pytorch_msssim` computes, so that
//! figures compare with TexIR's.
//!
//! Gaussian window of 11×11 pixels with σ = 1.5, K₁ = 0.01, K₂ = 0.03, data range 1; windows lie
//! wholly inside the image ("valid", no padding), so the map is smaller than the image by 10 in
//! each direction; a side shorter than 11 pixels is not smoothed along that axis. The map is
//! averaged per channel, a negative channel mean counts as 0, channels are averaged.

use super::{Channels, assert_same_size};
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;

/// Window side in pixels.
const WINDOW: usize = 11;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// (K₁·L)² with L = 1.
const C1: f64 = 0.01 * 0.01;
/// (K₂·L)² with L = 1.
const C2: f64 = 0.03 * 0.03;

/// SSIM of two images clipped to [0, 1].
///
/// # Panics
/// If the planes differ in size.
#[must_use]
pub fn ssim<T: Channels>(a: &Plane<T>, b: &Plane<T>) -> f64 {
    masked_ssim(a, b, &Plane::filled(a.width, a.height, true)).unwrap_or(1.0)
}

/// SSIM over the windows whose centre `mask` holds; `None` if there is none.
///
/// Inside such a window pixels outside the mask are taken as equal in both images (the value of
/// `b`, the reference), so that what is left out cannot speak against the prediction.
///
/// # Panics
/// If the planes differ in size.
#[must_use]
pub fn masked_ssim<T: Channels>(a: &Plane<T>, b: &Plane<T>, mask: &Plane<bool>) -> Option<f64> {
    assert_same_size(a, b);
    assert_same_size(a, mask);
    let (window_x, window_y) = (axis_window(a.width), axis_window(a.height));
    let (out_w, out_h) = (
        a.width + 1 - window_x.len().min(a.width + 1),
        a.height + 1 - window_y.len().min(a.height + 1),
    );
    let centre = |x: usize, y: usize| mask[(x + window_x.len() / 2, y + window_y.len() / 2)];
    let count = (0..out_h)
        .map(|y| (0..out_w).filter(|&x| centre(x, y)).count())
        .sum::<usize>();
    if count == 0 {
        return None;
    }
    let per_channel = |c: usize| {
        let clip = |v: f32| {
            if v.is_finite() {
                f64::from(v.clamp(0.0, 1.0))
            } else {
                0.0
            }
        };
        // rows of the five moments, smoothed along x; then smoothed along y row by row
        let rows: Vec<Vec<[f64; 5]>> = (0..a.height)
            .into_par_iter()
            .map(|y| {
                let moments: Vec<[f64; 5]> = (0..a.width)
                    .map(|x| {
                        let (raw_a, raw_b) = (a[(x, y)].channel(c), b[(x, y)].channel(c));
                        let r = clip(raw_b);
                        // a non-finite prediction is as far from the reference as possible
                        let p = match (mask[(x, y)], raw_a.is_finite()) {
                            (false, _) => r,
                            (true, true) => clip(raw_a),
                            (true, false) => (r < 0.5).into(),
                        };
                        [p, r, p * p, r * r, p * r]
                    })
                    .collect();
                (0..out_w)
                    .map(|x| weighted_sum(window_x.iter().zip(&moments[x..])))
                    .collect()
            })
            .collect();
        let sums: Vec<f64> = (0..out_h)
            .into_par_iter()
            .map(|y| {
                let column = |x: usize| {
                    weighted_sum(window_y.iter().zip(rows[y..].iter().map(|row| &row[x])))
                };
                (0..out_w)
                    .filter(|&x| centre(x, y))
                    .map(|x| similarity(column(x)))
                    .sum()
            })
            .collect();
        (sums.into_iter().sum::<f64>() / count as f64).max(0.0)
    };
    Some((0..T::COUNT).map(per_channel).sum::<f64>() / T::COUNT as f64)
}

/// SSIM of one window from its smoothed moments [p, r, p², r², pr].
fn similarity([p, r, pp, rr, pr]: [f64; 5]) -> f64 {
    let (variance_p, variance_r, covariance) = (pp - p * p, rr - r * r, pr - p * r);
    let structure = (2.0 * covariance + C2) / (variance_p + variance_r + C2);
    (2.0 * p * r + C1) / (p * p + r * r + C1) * structure
}

fn weighted_sum<'a>(terms: impl Iterator<Item = (&'a f64, &'a [f64; 5])>) -> [f64; 5] {
    terms.fold([0.0; 5], |mut sum, (w, m)| {
        for (s, v) in sum.iter_mut().zip(m) {
            *s += w * v;
        }
        sum
    })
}

/// Normalised Gaussian taps, or the single tap 1 for a side that is too short.
fn axis_window(side: usize) -> Vec<f64> {
    if side < WINDOW {
        return vec![1.0];
    }
    let half = (WINDOW / 2) as f64;
    let taps: Vec<f64> = (0..WINDOW)
        .map(|i| (-(i as f64 - half).powi(2) / (2.0 * SIGMA * SIGMA)).exp())
        .collect();
    let sum: f64 = taps.iter().sum();
    taps.into_iter().map(|t| t / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn pattern(w: usize, h: usize) -> Plane<f32> {
        Plane {
            width: w,
            height: h,
            data: (0..w * h)
                .map(|i| ((i * 37) % 101) as f32 / 100.0)
                .collect(),
        }
    }

    /// Equation 13 of the article by four nested loops over every window.
    fn brute_force(a: &Plane<f32>, b: &Plane<f32>) -> f64 {
        let taps = axis_window(WINDOW);
        let mut sum = 0.0;
        let (ow, oh) = (a.width - 10, a.height - 10);
        for y in 0..oh {
            for x in 0..ow {
                let mut m = [0.0f64; 5];
                for j in 0..WINDOW {
                    for i in 0..WINDOW {
                        let w = taps[i] * taps[j];
                        let (p, r) = (f64::from(a[(x + i, y + j)]), f64::from(b[(x + i, y + j)]));
                        for (s, v) in m.iter_mut().zip([p, r, p * p, r * r, p * r]) {
                            *s += w * v;
                        }
                    }
                }
                sum += similarity(m);
            }
        }
        sum / (ow * oh) as f64
    }

    #[test]
    fn constants_have_a_closed_form() {
        // no variance: SSIM = (2pr + C1) / (p² + r² + C1)
        let (a, b) = (
            Plane::filled(20, 16, Vec3::splat(0.25)),
            Plane::filled(20, 16, Vec3::splat(0.5)),
        );
        let expected = (2.0 * 0.125 + 1e-4) / (0.0625 + 0.25 + 1e-4);
        assert!((ssim(&a, &b) - expected).abs() < 1e-9);
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn separable_sums_agree_with_the_definition() {
        let a = pattern(23, 17);
        let b = a.map(|v| (v * 0.7 + 0.1).min(0.6));
        assert!((ssim(&a, &b) - brute_force(&a, &b)).abs() < 1e-12);
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_inverted_image_scores_zero_rather_than_negative() {
        let a = pattern(30, 30);
        assert_eq!(ssim(&a, &a.map(|v| 1.0 - v)), 0.0);
    }

    #[test]
    fn what_the_mask_leaves_out_does_not_count() {
        let a = pattern(30, 20);
        let mut damaged = a.clone();
        let mut mask = Plane::filled(30, 20, true);
        for y in 5..12 {
            for x in 8..21 {
                damaged[(x, y)] = f32::NAN;
                mask[(x, y)] = false;
            }
        }
        assert!((masked_ssim(&damaged, &a, &mask).expect("windows") - 1.0).abs() < 1e-12);
        assert!(ssim(&damaged, &a) < 0.9);
        assert!(masked_ssim(&a, &a, &Plane::filled(30, 20, false)).is_none());
    }

    #[test]
    fn sides_shorter_than_the_window_are_not_smoothed() {
        let a = pattern(3, 2);
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
        assert!(ssim(&a, &a.map(|v| v * 0.5)) < 1.0);
    }
}
