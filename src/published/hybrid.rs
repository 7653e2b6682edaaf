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
    /// How a pixel is compared.
    pub loss: Loss,
}

impl Hybrid<'_> {
    /// E/π at a pixel.
    #[must_use]
    pub fn diffuse(&self, pixel: &Pixel) -> Vec3 {
        let taps = self.irradiance.taps(pixel.uv, pixel.footprint);
        Vec3::from(self.irradiance.fetch(&taps)) * FRAC_1_PI
    }

    /// Rays that a comparison traces for each of its pixels.
    #[must_use]
    pub fn rays_per_pixel(&self) -> u64 {
        u64::from(SAMPLES) * (1 + u64::from(self.independent))
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
        (0..pixels.len())
            .into_par_iter()
            .map(|i| {
                let diffuse = self.diffuse(&pixels[i]);
                let predicted = diffuse * materials[i].albedo + shown[i].radiance * self.exposure;
                let slope = self.loss.slope(predicted, pixels[i].radiance);
                MaterialSlope {
                    by_albedo: slope * diffuse,
                    by_roughness: slope.dot(mirrored[i].slope * self.exposure),
                }
            })
            .collect()
    }

    fn rays(&self, pixels: usize) -> u64 {
        self.rays_per_pixel() * pixels as u64
    }
}
