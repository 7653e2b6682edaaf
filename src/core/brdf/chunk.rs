//! The specular lobe and its derivative over structure-of-arrays slices.
//!
//! One branch-free loop that the compiler vectorises; [`crate::ffi::simd::with_widest`] runs it
//! with the widest instructions this processor has. No fused multiply-add and a polynomial of our
//! own for 2^x: the bits are the same for every instruction set, so results do not depend on the
//! machine. [`super::specular_d_roughness`] is the plain reference beside it.

use super::ggx::F0;
use crate::ffi::simd::with_widest;

/// Inputs of [`specular_chunk`]: slices of equal length, cosines in [0, 1], R > 0.
#[derive(Clone, Copy, Debug)]
pub struct SpecularChunk<'a> {
    /// n·l.
    pub n_l: &'a [f32],
    /// n·v.
    pub n_v: &'a [f32],
    /// ‖n×h‖².
    pub sin2_nh: &'a [f32],
    /// v·h.
    pub v_h: &'a [f32],
    /// Roughness R.
    pub roughness: &'a [f32],
}

/// Writes D F G/(4 (n·v)(n·l)) and its derivative in R for every element.
///
/// # Panics
/// If the slices differ in length.
pub fn specular_chunk(input: SpecularChunk<'_>, value: &mut [f32], slope: &mut [f32]) {
    with_widest(
        #[inline(always)]
        || kernel(input, value, slope),
    );
}

#[inline(always)]
fn kernel(input: SpecularChunk<'_>, value: &mut [f32], slope: &mut [f32]) {
    let n = value.len();
    assert!(
        [
            input.n_l.len(),
            input.n_v.len(),
            input.sin2_nh.len(),
            input.v_h.len(),
            input.roughness.len(),
            slope.len()
        ] == [n; 6],
        "slices of unequal length"
    );
    // re-slicing lets the compiler drop every bounds check of the loop
    let (n_l, n_v, sin2, v_h) = (
        &input.n_l[..n],
        &input.n_v[..n],
        &input.sin2_nh[..n],
        &input.v_h[..n],
    );
    let (roughness, value, slope) = (&input.roughness[..n], &mut value[..n], &mut slope[..n]);
    for i in 0..n {
        let (r, s) = (roughness[i], sin2[i]);
        let alpha = r * r;
        let a2c2 = alpha * alpha * (1.0 - s);
        let inverse_d = 1.0 / (s + a2c2);
        let q = alpha * inverse_d;
        let k = (r + 1.0) * (r + 1.0) * 0.125;
        let (gl, gv) = (
            1.0 / (n_l[i] * (1.0 - k) + k),
            1.0 / (n_v[i] * (1.0 - k) + k),
        );
        let f =
            F0 as f32 + (1.0 - F0) as f32 * exp2_near_zero((-5.55473 * v_h[i] - 6.98316) * v_h[i]);
        let v = q * q * f * gl * gv * (0.25 * std::f32::consts::FRAC_1_PI);
        let d_ln_d = 4.0 * (s - a2c2) * inverse_d / r;
        let d_ln_g = ((1.0 - n_l[i]) * gl + (1.0 - n_v[i]) * gv) * (r + 1.0) * -0.25;
        value[i] = v;
        slope[i] = v * (d_ln_d + d_ln_g);
    }
}

/// 2^x for −100 < x < 100, relative error below 2e-7: rounding by a magic number, a Taylor
/// polynomial on [−½, ½], and the exponent put in by its bits. `f32::exp2` is a library call that
/// would keep the loop scalar.
#[inline(always)]
fn exp2_near_zero(x: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to an integer in the low mantissa bits
    let rounded = x + MAGIC;
    let t = (x - (rounded - MAGIC)) * std::f32::consts::LN_2;
    let p = 1.0
        + t * (1.0
            + t * (0.5
                + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0))))));
    let exponent = rounded.to_bits().wrapping_sub(MAGIC.to_bits());
    p * f32::from_bits(exponent.wrapping_add(127) << 23)
}

#[cfg(test)]
mod tests {
    use super::super::specular_d_roughness;
    use super::*;
    use crate::core::sampling::KeyedRng;

    #[test]
    fn equals_the_scalar_reference() {
        let mut rng = KeyedRng::new(3, 9);
        for n in [0usize, 1, 7, 64, 1003] {
            let mut draw =
                |f: fn(f32) -> f32| (0..n).map(|_| f(rng.next_f32())).collect::<Vec<f32>>();
            let (n_l, n_v, v_h) = (draw(|x| x), draw(|x| x * x), draw(|x| x));
            let (sin2, roughness) = (draw(|x| x.powi(8)), draw(|x| 0.01 + 0.99 * x));
            let (mut value, mut slope) = (vec![f32::NAN; n], vec![f32::NAN; n]);
            let input = SpecularChunk {
                n_l: &n_l,
                n_v: &n_v,
                sin2_nh: &sin2,
                v_h: &v_h,
                roughness: &roughness,
            };
            specular_chunk(input, &mut value, &mut slope);
            for i in 0..n {
                let d = |x: &[f32]| f64::from(x[i]);
                let (v, s) =
                    specular_d_roughness(d(&n_l), d(&n_v), d(&sin2), d(&v_h), d(&roughness));
                assert!((f64::from(value[i]) - v).abs() <= 3e-6 * v, "value {i}");
                assert!(
                    (f64::from(slope[i]) - s).abs() <= 4e-6 * s.abs().max(v / d(&roughness)),
                    "slope {i}"
                );
            }
        }
    }

    #[test]
    fn powers_of_two_to_single_precision() {
        for i in -2000..=2000 {
            let x = i as f32 * 0.01;
            let error = f64::from(exp2_near_zero(x)) / f64::from(x).exp2() - 1.0;
            assert!(error.abs() < 2.5e-7, "2^{x} off by {error:.1e}");
        }
    }
}
