//! Sine and cosine that the compiler can put into vector lanes: reduction by multiples of π
//! (Cody & Waite 1980, in two parts), then Taylor's polynomials on [−π/2, π/2].

use std::f32::consts::FRAC_1_PI;

/// π in two parts, the first with few enough digits that its small multiples are exact.
const PI_PARTS: [f32; 2] = [3.140_625, 9.676_536e-4];
/// Added to and taken from a float below 2²², it leaves the nearest whole number.
const ROUNDER: f32 = 12_582_912.0;

/// (sin x, cos x) within 1e-6 for |x| ≤ 1000; further out the reduction loses digits.
#[inline(always)]
#[must_use]
pub fn fast_sin_cos(x: f32) -> (f32, f32) {
    let shifted = x * FRAC_1_PI + ROUNDER;
    let k = shifted - ROUNDER;
    let r = (x - k * PI_PARTS[0]) - k * PI_PARTS[1];
    // the lowest bit of the shifted number is that of k: odd multiples of π change both signs
    let sign = f32::from_bits((shifted.to_bits() & 1) << 31 | 0x3f80_0000);
    let s = r * r;
    let sin = r
        * (1.0
            + s * (-1.0 / 6.0
                + s * (1.0 / 120.0
                    + s * (-1.0 / 5_040.0 + s * (1.0 / 362_880.0 - s / 39_916_800.0)))));
    let cos = 1.0
        + s * (-0.5
            + s * (1.0 / 24.0
                + s * (-1.0 / 720.0
                    + s * (1.0 / 40_320.0 + s * (-1.0 / 3_628_800.0 + s / 479_001_600.0)))));
    (sign * sin, sign * cos)
}

#[cfg(test)]
mod tests {
    use super::fast_sin_cos;

    #[test]
    fn equals_the_library_on_a_thousand_turns() {
        for i in -200_000..=200_000 {
            let x = i as f32 * 5e-3;
            let (s, c) = fast_sin_cos(x);
            let (es, ec) = f64::from(x).sin_cos();
            let error = (f64::from(s) - es).abs().max((f64::from(c) - ec).abs());
            assert!(error < 1e-6, "{x}: off by {error}");
        }
    }
}
