//! A surface's parameters with evaluation, sampling and density in world space.

use super::ggx::{fresnel, specular};
use super::vndf::{sample_vndf, vndf_reflection_pdf};
use crate::core::math::{Frame, luminance};
use crate::core::sampling::{cosine_hemisphere_pdf, square_to_cosine_hemisphere};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Smallest roughness a material shows: the lower clamp of the method.
pub const MIN_ROUGHNESS: f32 = 0.01;

/// Parameters of the model at a surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse albedo, linear Rec. 709.
    pub albedo: Vec3,
    /// Roughness R (α = R²); evaluated as if at least [`MIN_ROUGHNESS`].
    pub roughness: f32,
}

/// A sampled direction of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrdfSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// BRDF · n·l / pdf.
    pub weight: Vec3,
    /// Density per steradian of the mixture.
    pub pdf: f32,
}

impl Material {
    // unlike `clamp`, `max` turns NaN into the bound
    #[allow(clippy::manual_clamp)]
    fn clamped_roughness(&self) -> f32 {
        self.roughness.max(MIN_ROUGHNESS).min(1.0)
    }

    /// BRDF · n·l; zero where view or light lies below the surface. `n`, `v`, `l` are unit vectors.
    #[inline]
    #[must_use]
    pub fn eval(&self, n: Vec3, v: Vec3, l: Vec3) -> Vec3 {
        let (n_v, n_l) = (n.dot(v), n.dot(l));
        if !(n_v > 0.0 && n_l > 0.0) {
            return Vec3::ZERO;
        }
        (self.albedo * FRAC_1_PI + Vec3::splat(self.specular_lobe(n, v, l))) * n_l
    }

    /// The specular lobe alone, without the cosine.
    #[inline]
    #[must_use]
    pub fn specular_lobe(&self, n: Vec3, v: Vec3, l: Vec3) -> f32 {
        let (n_v, n_l) = (n.dot(v), n.dot(l));
        if !(n_v > 0.0 && n_l > 0.0) {
            return 0.0;
        }
        let h = (v + l).normalize_or(n);
        specular(
            n_l.min(1.0),
            n_v.min(1.0),
            n.cross(h).length_squared().min(1.0),
            v.dot(h).clamp(0.0, 1.0),
            self.clamped_roughness(),
        )
    }

    /// Probability with which [`Self::sample`] takes the specular lobe.
    #[inline]
    #[must_use]
    pub fn specular_share(&self, n_v: f32) -> f32 {
        let f = fresnel(n_v.clamp(0.0, 1.0));
        let total = f + luminance(self.albedo);
        if total > 0.0 {
            (f / total).clamp(0.1, 0.9)
        } else {
            0.5
        }
    }

    /// Draws a direction of light from the mixture of a cosine lobe and GGX's visible normals;
    /// `None` where the drawn direction lies below the surface (its contribution is zero: the
    /// estimator stays unbiased).
    #[inline]
    #[must_use]
    pub fn sample(&self, n: Vec3, v: Vec3, choice: f32, u: [f32; 2]) -> Option<BrdfSample> {
        let share = self.specular_share(n.dot(v));
        let direction = self.sample_direction(n, v, choice < share, u)?;
        let pdf = self.pdf_with_share(n, v, direction, share);
        let weight = self.eval(n, v, direction) / pdf;
        (pdf > 0.0 && weight.is_finite()).then_some(BrdfSample {
            direction,
            weight,
            pdf,
        })
    }

    /// Draws a direction from one lobe: visible normals or cosine; `None` below the surface.
    #[inline]
    #[must_use]
    pub fn sample_direction(&self, n: Vec3, v: Vec3, specular: bool, u: [f32; 2]) -> Option<Vec3> {
        if n.dot(v) <= 0.0 {
            return None;
        }
        let frame = Frame::from_normal(n);
        let local = if specular {
            let v_local = frame.local_from_world(v);
            let alpha = self.clamped_roughness() * self.clamped_roughness();
            let h = sample_vndf(v_local, alpha, u);
            2.0 * v_local.dot(h) * h - v_local
        } else {
            square_to_cosine_hemisphere(u)
        };
        (local.z > 0.0).then(|| frame.world_from_local(local).normalize())
    }

    /// Density per steradian with which [`Self::sample`] draws `l`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, n: Vec3, v: Vec3, l: Vec3) -> f32 {
        self.pdf_with_share(n, v, l, self.specular_share(n.dot(v)))
    }

    /// Density per steradian of the mixture that takes the specular lobe with probability `share`.
    #[inline]
    #[must_use]
    pub fn pdf_with_share(&self, n: Vec3, v: Vec3, l: Vec3, share: f32) -> f32 {
        let (n_v, n_l) = (n.dot(v), n.dot(l));
        if !(n_v > 0.0 && n_l > 0.0) {
            return 0.0;
        }
        let diffuse = (1.0 - share) * cosine_hemisphere_pdf(n_l);
        if share == 0.0 {
            return diffuse;
        }
        let h = (v + l).normalize_or(n);
        let alpha = self.clamped_roughness() * self.clamped_roughness();
        diffuse
            + share * vndf_reflection_pdf(n_v.min(1.0), n.cross(h).length_squared().min(1.0), alpha)
    }
}

#[cfg(test)]
mod tests {
    use super::super::vndf::tests::{chi2, chi2_accepts};
    use super::*;
    use crate::core::sampling::{KeyedRng, SobolSequence};
    use std::f64::consts::PI;

    fn view(theta: f32) -> Vec3 {
        Vec3::new(theta.sin(), 0.0, theta.cos())
    }

    #[test]
    fn sampled_directions_follow_the_density() {
        const ROWS: usize = 16;
        const COLUMNS: usize = 16;
        const N: usize = 60_000;
        let cases: Vec<(f32, f32)> = [0.3f32, 0.5, 0.8, 1.0]
            .iter()
            .flat_map(|&r| [0.0f32, 0.7, 1.3].map(|t| (r, t)))
            .collect();
        for (case, &(roughness, theta)) in cases.iter().enumerate() {
            let m = Material {
                albedo: Vec3::splat(0.1),
                roughness,
            };
            let (n, v) = (Vec3::Z, view(theta));
            let mut rng = KeyedRng::new(11, case as u64);
            let mut observed = vec![0usize; ROWS * COLUMNS + 1];
            for _ in 0..N {
                let cell = match m.sample(n, v, rng.next_f32(), [rng.next_f32(), rng.next_f32()]) {
                    None => ROWS * COLUMNS,
                    Some(s) => {
                        let i = ((s.direction.z * ROWS as f32) as usize).min(ROWS - 1);
                        let phi = (f64::from(s.direction.y).atan2(f64::from(s.direction.x)) + PI)
                            / (2.0 * PI);
                        i * COLUMNS + ((phi * COLUMNS as f64) as usize).min(COLUMNS - 1)
                    }
                };
                observed[cell] += 1;
            }
            let sub = 32;
            let mut expected = vec![0.0f64; ROWS * COLUMNS + 1];
            let solid = 2.0 * PI / (ROWS * sub * COLUMNS * sub) as f64;
            for i in 0..ROWS * sub {
                let z = (i as f32 + 0.5) / (ROWS * sub) as f32;
                let s = (1.0 - z * z).sqrt();
                for j in 0..COLUMNS * sub {
                    let phi = std::f32::consts::TAU * (j as f32 + 0.5) / (COLUMNS * sub) as f32
                        - std::f32::consts::PI;
                    let l = Vec3::new(s * phi.cos(), s * phi.sin(), z);
                    expected[i / sub * COLUMNS + j / sub] +=
                        N as f64 * solid * f64::from(m.pdf(n, v, l));
                }
            }
            let inside: f64 = expected.iter().sum();
            assert!(
                inside <= N as f64 * 1.002,
                "density integrates to {}",
                inside / N as f64
            );
            expected[ROWS * COLUMNS] = (N as f64 - inside).max(0.0);
            let (statistic, degrees) = chi2(&observed, &expected);
            assert!(
                chi2_accepts(statistic, degrees, cases.len()),
                "R {roughness} θ {theta}: χ² {statistic:.1} of {degrees}"
            );
        }
    }

    /// The sampler's mean weight is the directional albedo, here against quadrature over half
    /// vectors.
    #[test]
    fn mean_weight_equals_quadrature() {
        for roughness in [0.15f32, 0.4, 0.9] {
            for theta in [0.2f32, 1.0, 1.45] {
                let m = Material {
                    albedo: Vec3::new(0.2, 0.5, 0.8),
                    roughness,
                };
                let (n, v) = (Vec3::Z, view(theta));
                let sobol = SobolSequence::new(2, 3);
                let samples = 1 << 16;
                let mut mean = [0.0f64; 3];
                for i in 0..samples {
                    let [a, b, c, _] = sobol.point4(i);
                    if let Some(s) = m.sample(n, v, a, [b, c]) {
                        (0..3).for_each(|k| mean[k] += f64::from(s.weight[k]) / f64::from(samples));
                    }
                }
                // half-vector quadrature: x = r²/(1+r²) of slope/α concentrates the nodes on the
                // lobe
                let alpha = f64::from(roughness).powi(2);
                let (nx, np) = (1500, 512);
                let mut glossy = 0.0f64;
                for i in 0..nx {
                    let x = (i as f64 + 0.5) / nx as f64;
                    let tan = alpha * (x / (1.0 - x)).sqrt();
                    let cos = 1.0 / (1.0 + tan * tan).sqrt();
                    for j in 0..np {
                        let phi = 2.0 * PI * (j as f64 + 0.5) / np as f64;
                        let h = glam::DVec3::new(cos * tan * phi.cos(), cos * tan * phi.sin(), cos);
                        let v = v.as_dvec3();
                        let v_h = v.dot(h);
                        let l = 2.0 * v_h * h - v;
                        if v_h > 0.0 && l.z > 0.0 {
                            // D cosθ_h dω_h = dx dφ/2π, dω_l = 4 v·h dω_h
                            let d = super::super::ggx_d(1.0 - cos * cos, alpha);
                            let f = super::super::specular(
                                l.z,
                                v.z,
                                1.0 - cos * cos,
                                v_h.min(1.0),
                                f64::from(roughness),
                            );
                            glossy += f * l.z * 4.0 * v_h / (d * cos) / (nx * np) as f64;
                        }
                    }
                }
                for (k, mean) in mean.into_iter().enumerate() {
                    let expected = glossy + f64::from(m.albedo[k]);
                    assert!(
                        (mean / expected - 1.0).abs() < 4e-3,
                        "R {roughness} θ {theta}: {} against {expected}",
                        mean
                    );
                }
            }
        }
    }

    #[test]
    fn reciprocal_and_finite_to_the_edge() {
        let mut rng = KeyedRng::new(1, 1);
        for i in 0..2000 {
            let m = Material {
                albedo: Vec3::splat(0.5),
                roughness: [0.0, 0.01, 0.1, 0.5, 1.0][i % 5],
            };
            let mut direction = || {
                let d = square_to_cosine_hemisphere([rng.next_f32(), rng.next_f32()]);
                let z = if i % 3 == 0 { 1e-5 } else { d.z.max(1e-5) };
                Vec3::new(d.x, d.y + 1e-6, 0.0).normalize() * (1.0 - z * z).sqrt() + Vec3::Z * z
            };
            let (v, l) = (direction(), direction());
            let (a, b) = (m.eval(Vec3::Z, v, l) / l.z, m.eval(Vec3::Z, l, v) / v.z);
            assert!(
                a.is_finite() && (a - b).length() <= 1e-4 * a.length(),
                "{a} {b}"
            );
            assert!(m.pdf(Vec3::Z, v, l).is_finite());
            if let Some(s) = m.sample(Vec3::Z, v, rng.next_f32(), [rng.next_f32(), rng.next_f32()])
            {
                assert!(
                    s.weight.is_finite()
                        && s.weight.min_element() >= 0.0
                        && s.weight.max_element() < 20.0,
                    "{s:?}"
                );
            }
        }
    }

    #[test]
    fn nothing_below_the_horizon() {
        let m = Material {
            albedo: Vec3::ONE,
            roughness: 0.3,
        };
        assert_eq!(m.eval(Vec3::Z, Vec3::Z, Vec3::NEG_Z), Vec3::ZERO);
        assert_eq!(m.eval(Vec3::Z, Vec3::NEG_Z, Vec3::Z), Vec3::ZERO);
        assert_eq!(m.pdf(Vec3::Z, Vec3::Z, Vec3::NEG_Z), 0.0);
        assert!(m.sample(Vec3::Z, Vec3::NEG_Z, 0.5, [0.5, 0.5]).is_none());
    }
}
