//! Warps from the unit square, each with its density.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// Direction with density cosθ/π around +z.
#[must_use]
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
pub fn square_to_uniform_hemisphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - u[0];
    let s = (1.0 - z * z).max(0.0).sqrt();
    let phi = 2.0 * PI * u[1];
    Vec3::new(s * phi.cos(), s * phi.sin(), z)
}

/// Density of [`square_to_uniform_hemisphere`] per steradian.
#[must_use]
pub fn uniform_hemisphere_pdf() -> f32 {
    0.5 * FRAC_1_PI
}

/// Concentric map of the unit square onto the unit disk (Shirley & Chiu 1997).
#[must_use]
pub fn disk_from_square(u: [f32; 2]) -> Vec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return Vec2::ZERO;
    }
    let (r, phi) = if a.abs() > b.abs() { (a, PI / 4.0 * (b / a)) } else { (b, PI / 2.0 - PI / 4.0 * (a / b)) };
    Vec2::new(r * phi.cos(), r * phi.sin())
}

/// Barycentric coordinates (b₁, b₂) uniform over a triangle (Heitz 2019 low-distortion map).
#[must_use]
pub fn square_to_triangle(u: [f32; 2]) -> [f32; 2] {
    let (mut x, mut y) = (u[0], u[1]);
    if y > x {
        x *= 0.5;
        y -= x;
    } else {
        y *= 0.5;
        x -= y;
    }
    [x, y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::SobolSequence;

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
        assert!((cos1 / n - 2.0 / 3.0).abs() < 1e-3, "E[cos] of the cosine lobe is 2/3");
        assert!((uni1 / n - 0.5).abs() < 1e-3, "E[cos] of the uniform hemisphere is 1/2");
        assert!((tri[0] / n - 1.0 / 3.0).abs() < 1e-3 && (tri[1] / n - 1.0 / 3.0).abs() < 1e-3);
    }
}
