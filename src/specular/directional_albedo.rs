//! Specular lobes too wide to show anything: what they reflect is the mean light around, so no ray
//! needs to look for it.
//!
//! L_s(v) = ∫ L f_s (n·l) dl ≈ (E/π) ∫ f_s (n·l) dl: exact where light comes evenly from all sides,
//! and the wider the lobe the better elsewhere.

use crate::core::brdf::{
    MIN_ROUGHNESS, Reflectance, over_dielectric, sample_vndf, vndf_reflection_pdf,
};
use crate::core::sampling::hammersley;
use glam::Vec3;

/// Roughness from which a lobe counts as wide: half of its reflection comes from a cone of more
/// than 40° half angle.
pub const WIDE: f32 = 0.6;

const COSINES: usize = 24;
const LEVELS: usize = 9;
const NARROWEST: f32 = 0.5;
const SAMPLES: u32 = 1024;

/// Specular radiance at cosine `n_v` under even light of radiance 1, ∫ f_s (n·l) dl, of a dielectric and of a metal that reflects
/// everything at normal incidence; by samples of visible normals, which no lobe is too narrow for.
#[must_use]
pub fn under_even_light(model: Reflectance, n_v: f32, roughness: f32) -> [f32; 2] {
    let roughness = roughness.max(MIN_ROUGHNESS);
    let alpha = roughness * roughness;
    let view = Vec3::new((1.0 - n_v * n_v).sqrt(), 0.0, n_v);
    let mut sums = [0.0; 2];
    for s in 0..SAMPLES {
        let h = sample_vndf(view, alpha, hammersley(s, SAMPLES));
        let v_h = view.dot(h).clamp(0.0, 1.0);
        let n_l = (2.0 * v_h * h - view).z;
        let sin2 = (1.0 - h.z * h.z).max(0.0);
        let density = vndf_reflection_pdf(n_v, sin2, alpha);
        if n_l <= 0.0 || density <= 0.0 {
            continue;
        }
        let reflected = model.specular(n_l, n_v, sin2, v_h, roughness) * n_l / density;
        sums[0] += reflected;
        sums[1] += reflected * over_dielectric(Vec3::ONE, model.fresnel(v_h)).x;
    }
    sums.map(|s| s / SAMPLES as f32)
}

/// [`under_even_light`] of dielectrics, tabulated over n·v and roughness.
pub struct DirectionalAlbedo {
    table: Vec<f32>,
}

impl DirectionalAlbedo {
    /// Tabulates a model from roughness 0.5 to 1.
    #[must_use]
    pub fn new(model: Reflectance) -> Self {
        let table = (0..LEVELS * COSINES)
            .map(|i| {
                let roughness =
                    NARROWEST + (1.0 - NARROWEST) * (i / COSINES) as f32 / (LEVELS - 1) as f32;
                let n_v = ((i % COSINES) as f32 + 0.5) / COSINES as f32;
                under_even_light(model, n_v, roughness)[0]
            })
            .collect();
        Self { table }
    }

    /// Specular radiance under even light of radiance 1; roughness below 0.5 counts as 0.5.
    #[must_use]
    pub fn response(&self, n_v: f32, roughness: f32) -> f32 {
        let r = ((roughness - NARROWEST) / (1.0 - NARROWEST) * (LEVELS - 1) as f32)
            .clamp(0.0, (LEVELS - 1) as f32);
        let c = (n_v * COSINES as f32 - 0.5).clamp(0.0, (COSINES - 1) as f32);
        let (k, i) = ((r as usize).min(LEVELS - 2), (c as usize).min(COSINES - 2));
        let (fr, fc) = (r - k as f32, c - i as f32);
        let row = |k: usize| {
            self.table[k * COSINES + i] * (1.0 - fc) + self.table[k * COSINES + i + 1] * fc
        };
        row(k) * (1.0 - fr) + row(k + 1) * fr
    }

    /// Specular reflectance under even light: the share of the irradiance that leaves by specular
    /// reflection, 2 ∫ response(c) c dc.
    #[must_use]
    pub fn mean_response(&self, roughness: f32) -> f32 {
        let cosine = |i: usize| (i as f32 + 0.5) / COSINES as f32;
        (0..COSINES)
            .map(|i| 2.0 * cosine(i) * self.response(cosine(i), roughness))
            .sum::<f32>()
            / COSINES as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn a_smooth_surface_reflects_what_fresnel_says() {
        for n_v in [0.2, 0.5, 1.0] {
            let [dielectric, metal] = under_even_light(Reflectance::Smith, n_v, 0.05);
            let expected = Reflectance::Smith.fresnel(n_v);
            assert!(
                (dielectric / expected - 1.0).abs() < 0.01,
                "{n_v}: {dielectric} {expected}"
            );
            assert!((metal - 1.0).abs() < 0.01, "{n_v}: {metal}");
        }
    }

    /// The table against midpoint quadrature over the hemisphere.
    #[test]
    fn the_table_is_the_integral() {
        for model in [Reflectance::Paper, Reflectance::Smith] {
            let lobes = DirectionalAlbedo::new(model);
            // the last on a node of the table, where it rises steeply
            for (n_v, roughness) in [
                (0.97f32, 0.8f32),
                (0.5, 0.66),
                (0.2, 1.0),
                (2.5 / 24.0, 0.5625),
            ] {
                let v = Vec3::new((1.0 - n_v * n_v).sqrt(), 0.0, n_v);
                let (n, m) = (400, 800);
                let mut sum = 0.0f64;
                for a in 0..n {
                    let z = (a as f32 + 0.5) / n as f32;
                    for b in 0..m {
                        let phi = 2.0 * PI * (b as f32 + 0.5) / m as f32;
                        let s = (1.0 - z * z).sqrt();
                        let l = Vec3::new(s * phi.cos(), s * phi.sin(), z);
                        let h = (v + l).normalize();
                        sum += f64::from(
                            model.specular(
                                z,
                                n_v,
                                Vec3::Z.cross(h).length_squared(),
                                v.dot(h),
                                roughness,
                            ) * z,
                        );
                    }
                }
                let exact = sum * f64::from(2.0 * PI) / f64::from(n * m);
                let got = f64::from(lobes.response(n_v, roughness));
                assert!(
                    (got / exact - 1.0).abs() < 0.03,
                    "{model:?} n·v {n_v} R {roughness}: {got} against {exact}"
                );
            }
        }
    }

    /// The same double integral by light and view drawn evenly over their hemispheres.
    #[test]
    fn mean_response_is_the_reflectance_under_even_light() {
        const N: u32 = 1 << 17;
        for (model, roughness) in [(Reflectance::Paper, 0.6), (Reflectance::Smith, 0.9)] {
            let mut rng = crate::core::sampling::KeyedRng::new(3, 0);
            let mut direction = || {
                crate::core::sampling::square_to_uniform_hemisphere([
                    rng.next_f32(),
                    rng.next_f32(),
                ])
            };
            let sum: f64 = (0..N)
                .map(|_| {
                    let (v, l) = (direction(), direction());
                    let h = (v + l).normalize_or(Vec3::Z);
                    let sin2 = Vec3::Z.cross(h).length_squared().min(1.0);
                    f64::from(
                        model.specular(l.z, v.z, sin2, v.dot(h).max(0.0), roughness) * l.z * v.z,
                    )
                })
                .sum();
            let exact = 4.0 * std::f64::consts::PI * sum / f64::from(N);
            let got = f64::from(DirectionalAlbedo::new(model).mean_response(roughness));
            assert!(
                (got / exact - 1.0).abs() < 0.03,
                "{model:?} R {roughness}: {got} against {exact}"
            );
        }
    }
}
