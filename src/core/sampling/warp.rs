//! Warps from the unit square, each with its density.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// Direction with density cosθ/π around +z.
#[must_use]
#[inline(always)]
pub fn square_to_cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let d = disk_from_square(u);
    Vec3::new(d.x, d.y, (1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Density of [`square_to_cosine_hemisphere`] per steradian.
#[must_use]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Direction with constant density around +z; cosθ = 1 − u₀ as in the authors' code (method §3.1).
#[must_use]
#[inline(always)]
pub fn square_to_uniform_hemisphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - u[0];
    let s = (1.0 - z * z).max(0.0).sqrt();
    // quarter turns: the nearest whole number of them, and an angle of at most π/4
    let quarter = (4.0 * u[1] + 0.5) as i32;
    let (sin, cos) = small_sin_cos(0.5 * PI * (4.0 * u[1] - quarter as f32));
    // selections instead of branches, so that a loop over samples runs in vector registers
    let (x, y) = if quarter & 1 == 1 {
        (sin, cos)
    } else {
        (cos, sin)
    };
    let (s_x, s_y) = (
        if (quarter + 1) & 2 == 2 { -s } else { s },
        if quarter & 2 == 2 { -s } else { s },
    );
    Vec3::new(s_x * x, s_y * y, z)
}

/// Density of [`square_to_uniform_hemisphere`] per steradian.
#[must_use]
pub fn uniform_hemisphere_pdf() -> f32 {
    0.5 * FRAC_1_PI
}

/// Concentric map of the unit square onto the unit disk (Shirley & Chiu 1997).
#[must_use]
#[inline(always)]
pub fn disk_from_square(u: [f32; 2]) -> Vec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    // both cases without a branch: samples alternate between them at random
    let wide = a.abs() > b.abs();
    let (r, other) = if wide { (a, b) } else { (b, a) };
    let (sin, cos) = small_sin_cos(PI / 4.0 * (other / if r == 0.0 { 1.0 } else { r }));
    let (x, y) = if wide { (cos, sin) } else { (sin, cos) };
    Vec2::new(r * x, r * y)
}

/// Sine and cosine for |x| ≤ π/4 to single precision, by Taylor polynomials: library calls are a
/// large part of what a ray costs besides tracing it.
#[inline(always)]
fn small_sin_cos(x: f32) -> (f32, f32) {
    let x2 = x * x;
    let sin = x
        * (1.0
            + x2 * (-1.0 / 6.0
                + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 * (1.0 / 362_880.0)))));
    let cos = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40_320.0))));
    (sin, cos)
}

/// Barycentric coordinates (b₁, b₂) uniform over a triangle (Heitz 2019 low-distortion map; both of
/// its cases take half of the smaller coordinate from both).
#[must_use]
#[inline(always)]
pub fn square_to_triangle(u: [f32; 2]) -> [f32; 2] {
    let half = 0.5 * u[0].min(u[1]);
    [u[0] - half, u[1] - half]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::SobolSequence;

    #[test]
    fn polynomials_and_quarter_turns_equal_the_library() {
        for i in 0..=1000 {
            let u = i as f32 / 1000.0;
            let (sin, cos) = small_sin_cos((u - 0.5) * PI / 2.0);
            let x = (f64::from(u) - 0.5) * std::f64::consts::FRAC_PI_2;
            assert!(
                (f64::from(sin) - x.sin()).abs() < 2e-7 && (f64::from(cos) - x.cos()).abs() < 2e-7
            );
            let d = square_to_uniform_hemisphere([1.0, u]);
            let phi = 2.0 * std::f64::consts::PI * f64::from(u);
            assert!(
                (f64::from(d.x) - phi.cos()).abs() < 1e-6
                    && (f64::from(d.y) - phi.sin()).abs() < 1e-6,
                "{u}"
            );
        }
        assert_eq!(disk_from_square([0.5, 0.5]), Vec2::ZERO);
    }

    #[test]
    fn warps_integrate_to_known_moments() {
        let s = SobolSequence::new(0, 0);
        let n = 1 << 14;
        let (mut cos1, mut uni1, mut tri) = (0.0f64, 0.0f64, [0.0f64; 2]);
        for i in 0..n {
            let u = s.point2(i);
            let c = square_to_cosine_hemisphere(u);
            let h = square_to_uniform_hemisphere(u);
            assert!((c.length() - 1.0).abs() < 1e-4 && (h.length() - 1.0).abs() < 1e-4);
            cos1 += f64::from(c.z);
            uni1 += f64::from(h.z);
            let t = square_to_triangle(u);
            assert!(t[0] >= 0.0 && t[1] >= 0.0 && t[0] + t[1] <= 1.0 + 1e-6);
            tri[0] += f64::from(t[0]);
            tri[1] += f64::from(t[1]);
        }
        let n = f64::from(n);
        assert!(
            (cos1 / n - 2.0 / 3.0).abs() < 1e-3,
            "E[cos] of the cosine lobe is 2/3"
        );
        assert!(
            (uni1 / n - 0.5).abs() < 1e-3,
            "E[cos] of the uniform hemisphere is 1/2"
        );
        assert!((tri[0] / n - 1.0 / 3.0).abs() < 1e-3 && (tri[1] / n - 1.0 / 3.0).abs() < 1e-3);
    }
}
