//! Visible GGX normals: sampling and density.
//!
//! The sampler is the spherical-cap construction (Dupuy & Benyoub 2023, "Sampling Visible GGX
//! Normals with Spherical Caps"), which draws from the density of Heitz 2018. That density contains
//! the *exact* Smith masking of GGX, not the paper's remapped G1: the density must match what is
//! sampled, the model's G stays in the integrand.

use super::ggx::ggx_d;
use glam::Vec3;
use std::f32::consts::TAU;

/// Exact Smith masking of GGX, G1(x) = 2x/(x + √(α² + (1−α²)x²)).
#[inline]
#[must_use]
pub fn ggx_g1_exact(n_x: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let root = (a2 + (1.0 - a2) * n_x * n_x).sqrt();
    if n_x + root > 0.0 {
        2.0 * n_x / (n_x + root)
    } else {
        0.0
    }
}

/// A unit half vector visible from `v_local` (unit, z along the normal, z ≥ 0), from `u` in [0,
/// 1)².
#[inline]
#[must_use]
pub fn sample_vndf(v_local: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    // in the space where the ellipsoid of normals is a hemisphere
    let v = Vec3::new(alpha * v_local.x, alpha * v_local.y, v_local.z).normalize_or(Vec3::Z);
    let (sin_phi, cos_phi) = (TAU * u[0]).sin_cos();
    let z = (1.0 - u[1]) * (1.0 + v.z) - v.z;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let h = Vec3::new(r * cos_phi, r * sin_phi, z) + v;
    Vec3::new(alpha * h.x, alpha * h.y, h.z.max(0.0)).normalize_or(Vec3::Z)
}

/// Density per steradian of the direction reflected about a visible normal: G1(v)·D/(4 n·v), from
/// n·v and s = ‖n×h‖².
#[inline]
#[must_use]
pub fn vndf_reflection_pdf(n_v: f32, sin2_nh: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let root = (a2 + (1.0 - a2) * n_v * n_v).sqrt();
    0.5 * ggx_d(sin2_nh, alpha) / (n_v.max(0.0) + root)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;
    use std::f64::consts::PI;

    /// One-sided significance bound of a χ² statistic by Wilson & Hilferty's cube-root normal
    /// approximation.
    pub fn chi2_accepts(statistic: f64, degrees: usize, tests: usize) -> bool {
        // Šidák: each of `tests` tests at 1−(1−0.01)^(1/tests)
        let level = 1.0 - 0.99f64.powf(1.0 / tests as f64);
        let k = degrees as f64;
        let z = ((statistic / k).cbrt() - (1.0 - 2.0 / (9.0 * k))) / (2.0 / (9.0 * k)).sqrt();
        // upper tail of the normal by its asymptotic series; loose for small z, where nothing is
        // rejected anyway
        let tail = if z < 1.0 {
            1.0
        } else {
            (-0.5 * z * z).exp() / (z * (2.0 * PI).sqrt()) * (1.0 - 1.0 / (z * z + 2.0))
        };
        tail > level
    }

    /// χ² over cells with expectation below 5 pooled; returns (statistic, degrees of freedom).
    pub fn chi2(observed: &[usize], expected: &[f64]) -> (f64, usize) {
        let (mut statistic, mut cells) = (0.0, 0usize);
        let (mut pooled_o, mut pooled_e) = (0.0, 0.0);
        for (&o, &e) in observed.iter().zip(expected) {
            if e < 5.0 {
                pooled_o += o as f64;
                pooled_e += e;
            } else {
                statistic += (o as f64 - e).powi(2) / e;
                cells += 1;
            }
        }
        if pooled_e >= 5.0 {
            statistic += (pooled_o - pooled_e).powi(2) / pooled_e;
            cells += 1;
        } else {
            assert!(
                pooled_o <= 30.0,
                "{pooled_o} samples where {pooled_e} were expected"
            );
        }
        (statistic, cells.saturating_sub(1).max(1))
    }

    /// Half vectors in polar cells of slope/α, where the lobe has unit width whatever α is.
    #[test]
    fn sampled_normals_follow_the_visible_normal_density() {
        const RADII: usize = 16;
        const ANGLES: usize = 16;
        const N: usize = 100_000;
        let cases: Vec<(f32, f32)> = [0.02f32, 0.1, 0.3, 0.6, 1.0]
            .iter()
            .flat_map(|&r| [0.0f32, 0.8, 1.3, 1.5].map(|t| (r * r, t)))
            .collect();
        for (case, &(alpha, theta)) in cases.iter().enumerate() {
            let v = Vec3::new(theta.sin(), 0.0, theta.cos());
            let mut observed = vec![0usize; RADII * ANGLES];
            let mut rng = KeyedRng::new(5, case as u64);
            for _ in 0..N {
                let h = sample_vndf(v, alpha, [rng.next_f32(), rng.next_f32()]);
                assert!((h.length() - 1.0).abs() < 1e-5 && h.z >= 0.0);
                let r2 = f64::from(h.x * h.x + h.y * h.y)
                    / f64::from(h.z * h.z)
                    / f64::from(alpha * alpha);
                let i = ((r2 / (1.0 + r2) * RADII as f64) as usize).min(RADII - 1);
                let phi = f64::from(h.y).atan2(f64::from(h.x)) + PI;
                let j = ((phi / (2.0 * PI) * ANGLES as f64) as usize).min(ANGLES - 1);
                observed[i * ANGLES + j] += 1;
            }
            // D_v(h) dω_h in the same coordinates: with x = r²/(1+r²) and φ, P22 dslope = dx
            // dφ/(2π)
            let g1 = f64::from(ggx_g1_exact(v.z, alpha));
            let sub = 24;
            let mut expected = vec![0.0f64; RADII * ANGLES];
            for i in 0..RADII * sub {
                // w² = 1−x removes the integrable singularity of r at x = 1
                let (cell, k) = (i / sub, (i % sub) as f64);
                let edge = |c: usize| (1.0 - c as f64 / RADII as f64).sqrt();
                let dw = (edge(cell) - edge(cell + 1)) / sub as f64;
                let w = edge(cell + 1) + (k + 0.5) * dw;
                let r = (1.0 - w * w).sqrt() / w * f64::from(alpha);
                for j in 0..ANGLES * sub {
                    let phi = 2.0 * PI * (j as f64 + 0.5) / (ANGLES * sub) as f64 - PI;
                    // v·h/(n·v n·h) · G1
                    let projected =
                        (f64::from(v.x) * r * phi.cos() + f64::from(v.z)).max(0.0) / f64::from(v.z);
                    expected[cell * ANGLES + j / sub] +=
                        N as f64 * g1 * projected * 2.0 * w * dw / (ANGLES * sub) as f64;
                }
            }
            let total: f64 = expected.iter().sum();
            assert!(
                (total / N as f64 - 1.0).abs() < 5e-3,
                "density integrates to {}",
                total / N as f64
            );
            let (statistic, degrees) = chi2(&observed, &expected);
            assert!(
                chi2_accepts(statistic, degrees, cases.len()),
                "α {alpha} θ {theta}: χ² {statistic:.1} with {degrees} degrees of freedom"
            );
        }
    }
}
