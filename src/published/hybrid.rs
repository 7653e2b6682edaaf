//! The published hybrid light: I = E A/π + L_s, E of the irradiance texture, L_s by rays to the
//! light texture (method §5), and how far it is from the photographs.

use super::learned_texture::MipTexture;
use super::pixels::Pixel;
use super::reflection::{Reflector, SAMPLES};
use super::strategy::{Lighting, Loss, MaterialSlope};
use crate::core::brdf::Material;
use crate::core::parallel::prelude::*;
use crate::core::sampling::hash_u64;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Irradiance and reflections, both known.
#[derive(Clone, Copy)]
pub struct Hybrid<'a> {
    /// The irradiance texture in the units of the losses.
    pub irradiance: &'a MipTexture<3>,
    /// What reflects, in the units of the photographs.
    pub reflector: Reflector<'a>,
    /// Factor from the photographs' units to those of the losses.
    pub exposure: f32,
    /// Residuals from samples of their own ([`super::Correction::W2`]).
    pub independent: bool,
    /// Rays of a pixel's irradiance in each step; 0: the texture tells it.
    pub light_samples: u32,
    /// How a pixel is compared.
    pub loss: Loss,
}

impl Hybrid<'_> {
    /// E/π at each of `pixels`; `key` decides samples, where there are some.
    #[must_use]
    pub fn diffuse(&self, pixels: &[Pixel], key: u64) -> Vec<Vec3> {
        if self.light_samples > 0 {
            let key = hash_u64(key, 0x7b1);
            let mut diffuse = self.reflector.gather(pixels, self.light_samples, key);
            diffuse.iter_mut().for_each(|d| *d *= self.exposure);
            return diffuse;
        }
        let fetched = |pixel: &Pixel| {
            let taps = self.irradiance.taps(pixel.uv, pixel.footprint);
            Vec3::from(self.irradiance.fetch(&taps)) * FRAC_1_PI
        };
        pixels.par_iter().map(fetched).collect()
    }

    /// Rays that a comparison traces for each of its pixels.
    #[must_use]
    pub fn rays_per_pixel(&self) -> u64 {
        u64::from(SAMPLES) * (1 + u64::from(self.independent)) + u64::from(self.light_samples)
    }
}

impl Lighting for Hybrid<'_> {
    fn compare(
        &mut self,
        pixels: &[Pixel],
        materials: &[Material],
        key: u64,
    ) -> Vec<MaterialSlope> {
        let roughness: Vec<f32> = materials.iter().map(|m| m.roughness).collect();
        let mirrored = self.reflector.reflect(pixels, &roughness, key);
        // residuals from samples of their own do not conspire with their slopes
        let independent = self.independent.then(|| {
            self.reflector
                .reflect(pixels, &roughness, hash_u64(key, 0x1d))
        });
        let shown = independent.as_ref().unwrap_or(&mirrored);
        let diffuse = self.diffuse(pixels, key);
        (0..pixels.len())
            .into_par_iter()
            .map(|i| {
                let predicted =
                    diffuse[i] * materials[i].albedo + shown[i].radiance * self.exposure;
                let slope = self.loss.slope(predicted, pixels[i].radiance);
                MaterialSlope {
                    by_albedo: slope * diffuse[i],
                    by_roughness: slope.dot(mirrored[i].slope * self.exposure),
                }
            })
            .collect()
    }

    fn rays(&self, pixels: usize) -> u64 {
        self.rays_per_pixel() * pixels as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::image::Plane;
    use crate::core::trace::BruteForce;
    use crate::gbuffer::Orientation;
    use crate::published::place::test_points;
    use crate::radiance::{Environment, LightField, SurfaceRadiance};

    /// Under a uniform sky E/π is its radiance; the texture is asked only without rays.
    #[test]
    fn sampled_light_is_the_integral_and_the_texture_is_not_asked() {
        let mesh = Mesh::default();
        let sky = Environment::from_map(Plane::filled(8, 4, Vec3::splat(1.5)));
        let field = LightField::new(
            &mesh,
            &Orientation::of_winding(0),
            SurfaceRadiance::reflected(Plane::filled(1, 1, Vec3::ZERO)),
            sky,
        );
        let tracer = BruteForce::new(&mesh);
        let irradiance = MipTexture::new(1, vec![[9.0; 3]]);
        let hybrid = |light_samples| Hybrid {
            irradiance: &irradiance,
            reflector: Reflector {
                tracer: &tracer,
                field: &field,
                corrected: false,
            },
            exposure: 2.0,
            independent: false,
            light_samples,
            loss: Loss::Absolute,
        };
        let (points, _) = test_points(20, 1.0);
        let mean = |samples| {
            let all = hybrid(samples).diffuse(&points, 1);
            all.iter().map(|d| d.x).sum::<f32>() / all.len() as f32
        };
        assert!((mean(0) - 9.0 * FRAC_1_PI).abs() < 1e-4);
        assert!((mean(1024) - 3.0).abs() < 0.02, "{}", mean(1024));
        assert_eq!(hybrid(16).rays(10), 10 * (16 + u64::from(SAMPLES)));
    }
}
