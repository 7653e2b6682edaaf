//! Angles without library calls, for lookups of which there is one per ray.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Angle of (x, y) in [−π, π], within 3e-7; signs of zeros count as in the standard library.
/// Polynomial of Moshier's Cephes library (atanf) after reduction to
/// |x| ≤ tan(π/8).
#[must_use]
#[inline(always)]
pub fn atan2(y: f32, x: f32) -> f32 {
    let (a, b) = (y.abs(), x.abs());
    let (small, large) = if a < b { (a, b) } else { (b, a) };
    // tan(π/8): beyond it the angle is counted from π/4
    let far = small > 0.414_213_57 * large;
    let (numerator, denominator) = if far {
        (small - large, small + large)
    } else {
        (small, large)
    };
    let t = numerator / denominator.max(f32::MIN_POSITIVE);
    let z = t * t;
    let p = ((8.053_745e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let angle = p * z * t + t + if far { FRAC_PI_4 } else { 0.0 };
    let angle = if a < b { angle } else { FRAC_PI_2 - angle };
    let angle = if a == 0.0 && b == 0.0 { 0.0 } else { angle };
    (if x.is_sign_negative() {
        PI - angle
    } else {
        angle
    })
    .copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_round_the_circle_and_on_the_axes() {
        for i in -1800..=1800 {
            for radius in [1e-20f64, 1.0, 1e15] {
                let phi = f64::from(i) / 1800.0 * std::f64::consts::PI;
                let (y, x) = ((phi.sin() * radius) as f32, (phi.cos() * radius) as f32);
                let (got, expected) = (f64::from(atan2(y, x)), f64::from(y).atan2(f64::from(x)));
                assert!(
                    (got - expected).abs() < 3e-7,
                    "{i}: {got} against {expected}"
                );
            }
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert_eq!(atan2(0.0, 1.0), 0.0);
        assert_eq!(atan2(1.0, 0.0), FRAC_PI_2);
        assert_eq!(atan2(-1.0, 0.0), -FRAC_PI_2);
        assert_eq!(atan2(0.0, -1.0), PI);
        for (y, x) in [(0.0, -0.0), (-0.0, 0.0), (-0.0, -0.0), (0.0f32, 0.0f32)] {
            assert_eq!(atan2(y, x).to_bits(), y.atan2(x).to_bits());
        }
    }
}
