//! Value and derivative in R of the specular lobe, one formula for f32, f64 and dual numbers.
//!
//! Two cancellations are avoided by construction. The textbook denominator (n·h)²(α²−1)+1 loses
//! every digit in f32 for n·h → 1; with s = ‖n×h‖² it is s + α²(1−s), a sum of non-negative terms.
//! And G1(x)/x = 1/(x(1−k)+k) never divides by a cosine, so the lobe is finite at grazing view and
//! light. Callers compute s as the squared length of the cross product (or hₓ²+h_y² in the local
//! frame), not as 1−(n·h)².

use crate::core::math::Real;

/// Reflectance of a dielectric at normal incidence.
pub const F0: f64 = 0.04;
/// Refractive index whose reflectance at normal incidence is [`F0`]: ((η − 1)/(η + 1))² = 0.04.
const REFRACTIVE_INDEX: f64 = 1.5;

/// GGX distribution of normals D = α²/(π(s + α²(1−s))²) from s = ‖n×h‖²; finite for α > 1e-18 in
/// f32.
#[inline(always)]
#[must_use]
pub fn ggx_d<T: Real>(sin2_nh: T, alpha: T) -> T {
    // q² with q = α/(s+α²c²) keeps the squares away from underflow: α⁴ would be 1e-16 at the lower
    // clamp of R
    let q = alpha / (sin2_nh + alpha.sq() * (T::lit(1.0) - sin2_nh));
    q.sq() * T::lit(std::f64::consts::FRAC_1_PI)
}

/// Spherical-gaussian Fresnel F = 0.04 + 0.96·2^((−5.55473 v·h − 6.98316) v·h).
#[inline(always)]
#[must_use]
pub fn fresnel<T: Real>(v_h: T) -> T {
    let exponent = (T::lit(-5.55473) * v_h - T::lit(6.98316)) * v_h;
    T::lit(F0) + T::lit(1.0 - F0) * exponent.exp2()
}

/// Fresnel's equations for unpolarised light on a dielectric of refractive index 1.5, at the cosine
/// `v_h` between view and half vector, [0, 1]: 0.04 at normal incidence, 1 at grazing. With c = v·h
/// and g² = η² − 1 + c², F = ½ ((g − c)/(g + c))² (1 + ((c(g + c) − 1)/(c(g − c) + 1))²) (Cook and
/// Torrance 1982). At 60° it is 23 % above [`fresnel`].
#[inline(always)]
#[must_use]
pub fn fresnel_exact<T: Real>(v_h: T) -> T {
    let one = T::lit(1.0);
    let g = (T::lit(REFRACTIVE_INDEX * REFRACTIVE_INDEX - 1.0) + v_h.sq()).sqrt();
    let s = (g - v_h) / (g + v_h);
    let p = (v_h * (g + v_h) - one) / (v_h * (g - v_h) + one);
    T::lit(0.5) * s.sq() * (one + p.sq())
}

/// k = (R+1)²/8 of the masking term.
#[inline(always)]
#[must_use]
pub fn smith_k<T: Real>(roughness: T) -> T {
    (roughness + T::lit(1.0)).sq() * T::lit(0.125)
}

/// G1(x) = x/(x(1−k)+k), k = (R+1)²/8.
#[inline(always)]
#[must_use]
pub fn smith_g1<T: Real>(x: T, roughness: T) -> T {
    x * visibility(x, smith_k(roughness))
}

/// G1(x)/x, finite at x = 0.
#[inline(always)]
fn visibility<T: Real>(x: T, k: T) -> T {
    T::lit(1.0) / (x * (T::lit(1.0) - k) + k)
}

/// The specular lobe D F G / (4 (n·v)(n·l)) from cosines in [0, 1] and s = ‖n×h‖²; R > 0.
#[inline(always)]
#[must_use]
pub fn specular<T: Real>(n_l: T, n_v: T, sin2_nh: T, v_h: T, roughness: T) -> T {
    let k = smith_k(roughness);
    let g = visibility(n_l, k) * visibility(n_v, k);
    ggx_d(sin2_nh, roughness.sq()) * fresnel(v_h) * g * T::lit(0.25)
}

/// The specular lobe and its derivative in R.
///
/// With α = R² and d = s + α²c²: dlnD/dR = 4(s − α²c²)/(R d), and for x = n·l and n·v: dlnG1/dR =
/// −(1−x)/(x(1−k)+k)·(R+1)/4 (method §12.3 point 6, the two terms of dlnD/dα brought over one
/// denominator so that they do not cancel).
#[inline(always)]
#[must_use]
pub fn specular_d_roughness<T: Real>(n_l: T, n_v: T, sin2_nh: T, v_h: T, roughness: T) -> (T, T) {
    let one = T::lit(1.0);
    let alpha = roughness.sq();
    let a2c2 = alpha.sq() * (one - sin2_nh);
    let inverse_d = one / (sin2_nh + a2c2);
    let q = alpha * inverse_d;
    let k = smith_k(roughness);
    let (gl, gv) = (visibility(n_l, k), visibility(n_v, k));
    let value = q.sq() * fresnel(v_h) * gl * gv * T::lit(0.25 * std::f64::consts::FRAC_1_PI);
    let d_ln_d = T::lit(4.0) * (sin2_nh - a2c2) * inverse_d / roughness;
    let d_ln_g = ((one - n_l) * gl + (one - n_v) * gv) * (roughness + one) * T::lit(-0.25);
    (value, value * (d_ln_d + d_ln_g))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::math::Dual;

    /// Configurations from the peak of the lobe to grazing, as (n·l, n·v, s, v·h).
    fn configurations() -> Vec<[f64; 4]> {
        let mut all = Vec::new();
        for &tv in &[0.0f64, 0.5, 1.2, 1.5, 1.57] {
            for &dt in &[0.0f64, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 0.4] {
                // light and view in one plane, the half vector tilted by dt
                let tl = 2.0 * dt - tv;
                if tl.abs() < std::f64::consts::FRAC_PI_2 {
                    all.push([tl.cos(), tv.cos(), dt.sin().powi(2), (tv - dt).cos().abs()]);
                }
            }
        }
        all.push([1e-5, 1e-5, 0.0, 1e-5]);
        all.push([0.0, 0.0, 0.5, 0.0]);
        all
    }

    const ROUGHNESS: [f64; 8] = [0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.8, 1.0];

    #[test]
    fn hand_written_derivative_equals_dual_numbers_and_central_differences() {
        for [n_l, n_v, s, v_h] in configurations() {
            for r in ROUGHNESS {
                let c = |x| Dual::<1>::lit(x);
                let dual = specular(c(n_l), c(n_v), c(s), c(v_h), Dual::variable(r, 0));
                let (value, slope) = specular_d_roughness(n_l, n_v, s, v_h, r);
                assert!((value - dual.x).abs() <= 1e-13 * dual.x, "value at R {r}");
                // the derivative crosses zero on the flank: relative to the larger of itself and
                // value/R
                let scale = dual.d[0].abs().max(dual.x / r);
                assert!(
                    (slope - dual.d[0]).abs() <= 1e-10 * scale,
                    "slope at R {r}: {slope} against {}",
                    dual.d[0]
                );
                let h = 1e-5 * r;
                let central = (specular(n_l, n_v, s, v_h, r + h)
                    - specular(n_l, n_v, s, v_h, r - h))
                    / (2.0 * h);
                assert!(
                    (slope - central).abs() <= 1e-6 * scale,
                    "central difference at R {r}"
                );
            }
        }
    }

    /// f32 against f64 of the same inputs: the formulas lose nothing, down to α = 1e-4 at the peak.
    #[test]
    fn single_precision_keeps_six_digits() {
        let (mut worst_value, mut worst_slope) = (0.0f64, 0.0f64);
        for [n_l, n_v, s, v_h] in configurations() {
            for r in ROUGHNESS {
                let f = [n_l, n_v, s, v_h, r].map(|x| x as f32);
                let d = f.map(f64::from);
                let (v32, s32) = specular_d_roughness(f[0], f[1], f[2], f[3], f[4]);
                let (v64, s64) = specular_d_roughness(d[0], d[1], d[2], d[3], d[4]);
                worst_value = worst_value.max((f64::from(v32) - v64).abs() / v64);
                worst_slope =
                    worst_slope.max((f64::from(s32) - s64).abs() / s64.abs().max(v64 / d[4]));
            }
        }
        assert!(worst_value < 3e-6, "value off by {worst_value:.2e}");
        assert!(worst_slope < 4e-6, "slope off by {worst_slope:.2e}");
    }

    /// Against Snell's law and the amplitudes of both polarisations, and Brewster's angle.
    #[test]
    fn fresnels_equations_are_those_of_glass() {
        assert!((fresnel_exact(1.0f64) - F0).abs() < 1e-15);
        assert!((fresnel_exact(0.0f64) - 1.0).abs() < 1e-15);
        // tan θ = η: one polarisation is not reflected, the other by ((η² − 1)/(η² + 1))²
        let brewster = 0.5 * (1.25f64 / 3.25).powi(2);
        assert!((fresnel_exact(3.25f64.sqrt().recip()) - brewster).abs() < 1e-15);
        for degrees in [10.0f64, 30.0, 60.0, 75.0, 89.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let inside = (1.0 - (sin / 1.5).powi(2)).sqrt();
            let across = (cos - 1.5 * inside) / (cos + 1.5 * inside);
            let along = (1.5 * cos - inside) / (1.5 * cos + inside);
            let expected = 0.5 * (across * across + along * along);
            assert!((fresnel_exact(cos) - expected).abs() < 1e-14, "{degrees}");
            let single = f64::from(fresnel_exact(cos as f32));
            assert!((single / expected - 1.0).abs() < 2e-6, "{degrees}");
        }
    }

    #[test]
    fn equals_the_textbook_form_where_that_is_well_conditioned() {
        for r in ROUGHNESS {
            let (n_l, n_v, n_h, v_h) = (0.6f64, 0.8f64, 0.9f64, 0.7f64);
            let a2 = r.powi(4);
            let d = a2 / (std::f64::consts::PI * (n_h * n_h * (a2 - 1.0) + 1.0).powi(2));
            let k = (r + 1.0) * (r + 1.0) / 8.0;
            let g1 = |x: f64| x / (x * (1.0 - k) + k);
            let f = 0.04 + 0.96 * 2f64.powf((-5.55473 * v_h - 6.98316) * v_h);
            let expected = d * f * g1(n_l) * g1(n_v) / (4.0 * n_l * n_v);
            let got = specular(n_l, n_v, 1.0 - n_h * n_h, v_h, r);
            assert!((got / expected - 1.0).abs() < 1e-12);
            assert!((smith_g1(n_l, r) - g1(n_l)).abs() < 1e-15);
        }
    }

    #[test]
    fn finite_at_every_extreme() {
        for r in [1e-4f32, 0.01, 0.8, 1.0] {
            for c in [0.0f32, 1e-30, 1e-5, 1.0] {
                for s in [0.0f32, 1e-12, 1e-5, 1.0] {
                    let (v, d) = specular_d_roughness(c, 1e-5, s, c, r);
                    assert!(
                        v.is_finite() && d.is_finite() && v >= 0.0,
                        "R {r} cos {c} s {s}: {v} {d}"
                    );
                }
            }
        }
    }
}
