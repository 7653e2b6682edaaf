//! Half-vector sampling of the specular lobe with the light held fixed (method §4.2, §4.3):
//!
//! L_s = (1/S) Σ_j L(l_j) · F G (v·h) / ((n·v)(n·h)), h from p(h) = D (n·h).
//!
//! D cancels, so the weight's derivative along the moving sample knows nothing of how the lobe
//! changes over the light (weakness W1). The corrected one keeps the sample where it is and
//! differentiates the lobe: w · d ln(D G)/dR, unbiased for the light's real dependence.

use crate::core::brdf::{fresnel, smith_g1, specular_d_roughness};
use crate::core::math::{Dual, Real};
use std::f64::consts::TAU;

/// cos θ of a half vector is kept this far from ±1 by the published sampler (method §4.2).
const MOST_COSINE: f64 = 1.0 - 1e-6;

/// One sample in the frame of the surface normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeSample {
    /// Direction to the light, unit, z along the normal.
    pub direction: [f64; 3],
    /// Factor of the radiance from there.
    pub weight: f64,
    /// Derivative of the weight by roughness.
    pub slope: f64,
}

/// A half vector, the light direction it reflects to, and the weight.
struct Sampled<T> {
    light: [T; 3],
    weight: T,
    half: [T; 3],
    v_h: T,
}

/// The sample of `s` in [0, 1)² for a view direction in the frame of the normal; `None` if it lies
/// below the surface.
fn sample<T: Real>(s: [f64; 2], view: [f64; 3], roughness: T) -> Option<Sampled<T>> {
    let one = T::lit(1.0);
    let a2 = roughness.sq().sq();
    let cos2 = T::lit(1.0 - s[0]) / (one + (a2 - one) * T::lit(s[0]));
    let cos = cos2.sqrt();
    let cos = if cos.value() > MOST_COSINE {
        T::lit(MOST_COSINE)
    } else {
        cos
    };
    let sin = (one - cos.sq()).max(T::lit(0.0)).sqrt();
    let (y, x) = (TAU * s[1]).sin_cos();
    let half = [sin * T::lit(x), sin * T::lit(y), cos];
    let v = view.map(T::lit);
    let v_h = (v[0] * half[0] + v[1] * half[1] + v[2] * half[2]).max(T::lit(0.0));
    let light: [T; 3] = std::array::from_fn(|k| T::lit(2.0) * v_h * half[k] - v[k]);
    if light[2].value() <= 0.0 || v_h.value() <= 0.0 || view[2] <= 0.0 {
        return None;
    }
    let g = smith_g1(light[2], roughness) * smith_g1(v[2], roughness);
    let weight = fresnel(v_h) * g * v_h / (v[2] * half[2]);
    Some(Sampled {
        light,
        weight,
        half,
        v_h,
    })
}

/// A sample with the derivative of its weight by roughness: along the moving sample as published,
/// or, `corrected`, of the lobe where the sample lies. `view` is unit with z along the normal.
#[must_use]
pub fn half_vector_sample(
    s: [f64; 2],
    view: [f64; 3],
    roughness: f64,
    corrected: bool,
) -> Option<LobeSample> {
    if corrected {
        let at = sample(s, view, roughness)?;
        let sin2 = at.half[0].sq() + at.half[1].sq();
        let (value, slope) = specular_d_roughness(at.light[2], view[2], sin2, at.v_h, roughness);
        return Some(LobeSample {
            direction: at.light,
            weight: at.weight,
            slope: at.weight * slope / value.max(f64::MIN_POSITIVE),
        });
    }
    let at = sample(s, view, Dual::<1>::variable(roughness, 0))?;
    Some(LobeSample {
        direction: at.light.map(|l| l.x),
        weight: at.weight.x,
        slope: at.weight.d[0],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::specular;
    use crate::core::sampling::hammersley;

    fn view(degrees: f64) -> [f64; 3] {
        let (s, c) = degrees.to_radians().sin_cos();
        [s, 0.0, c]
    }

    #[test]
    fn the_published_slope_is_the_derivative_of_the_weight() {
        for r in [0.05, 0.2, 0.5, 0.8] {
            for (i, degrees) in [5.0, 40.0, 75.0].into_iter().enumerate() {
                let s = [0.1 + 0.25 * i as f64, 0.37];
                let Some(at) = half_vector_sample(s, view(degrees), r, false) else {
                    continue;
                };
                let h = 1e-6;
                let w = |r| half_vector_sample(s, view(degrees), r, false).map(|x| x.weight);
                let (Some(a), Some(b)) = (w(r + h), w(r - h)) else {
                    continue;
                };
                let central = (a - b) / (2.0 * h);
                assert!(
                    (at.slope - central).abs() < 1e-5 * (1.0 + central.abs()),
                    "R {r}, {degrees}°: {} for {central}",
                    at.slope
                );
            }
        }
    }

    /// Radiance of a light that falls off smoothly from a direction.
    fn light(l: [f64; 3]) -> f64 {
        let to = view(30.0);
        let cosine = -l[0] * to[0] + l[1] * to[1] + l[2] * to[2];
        5.0 * (20.0 * (cosine - 1.0)).exp()
    }

    /// ∫ L f_s (n·l) dω by brute force over the hemisphere.
    fn quadrature(view: [f64; 3], r: f64) -> f64 {
        let (rows, columns) = (600, 1200);
        let mut sum = 0.0;
        for i in 0..rows {
            let c = (i as f64 + 0.5) / rows as f64;
            let s = (1.0 - c * c).sqrt();
            for j in 0..columns {
                let (y, x) = (TAU * (j as f64 + 0.5) / columns as f64).sin_cos();
                let l = [s * x, s * y, c];
                let h: [f64; 3] = std::array::from_fn(|k| l[k] + view[k]);
                let length = h.iter().map(|x| x * x).sum::<f64>().sqrt();
                let h = h.map(|x| x / length);
                let v_h = (0..3).map(|k| h[k] * view[k]).sum::<f64>();
                sum += light(l) * c * specular(c, view[2], h[0] * h[0] + h[1] * h[1], v_h, r);
            }
        }
        sum * TAU / (rows * columns) as f64
    }

    /// Estimate of radiance and slope from `n` samples.
    fn estimate(view: [f64; 3], r: f64, corrected: bool) -> (f64, f64) {
        let n = 1 << 16;
        let (mut value, mut slope) = (0.0, 0.0);
        for i in 0..n {
            let s = hammersley(i, n).map(f64::from);
            if let Some(x) = half_vector_sample(s, view, r, corrected) {
                value += light(x.direction) * x.weight;
                slope += light(x.direction) * x.slope;
            }
        }
        (value / f64::from(n), slope / f64::from(n))
    }

    #[test]
    fn the_estimator_is_the_integral_and_only_the_corrected_slope_its_derivative() {
        for r in [0.3, 0.6] {
            let v = view(30.0);
            let exact = quadrature(v, r);
            let central = (quadrature(v, r + 1e-3) - quadrature(v, r - 1e-3)) / 2e-3;
            let (value, slope) = estimate(v, r, true);
            assert!((value / exact - 1.0).abs() < 0.01, "R {r}: {value} {exact}");
            assert!(
                (slope / central - 1.0).abs() < 0.03,
                "R {r}: {slope} {central}"
            );
            let (_, published) = estimate(v, r, false);
            assert!(
                published.abs() < 0.3 * central.abs(),
                "method §12.2, W1: {published} for {central}"
            );
        }
    }
}
