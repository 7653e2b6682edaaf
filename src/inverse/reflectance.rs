//! How the surface reflects as far as it is known: the reflection model and the roughness of every
//! texel, with what follows from them.

use crate::core::brdf::Reflectance;
use crate::specular::DirectionalAlbedo;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Reflection of the covered texels.
pub struct TexelReflectance {
    /// Reflection model.
    pub model: Reflectance,
    /// Directional albedo of its specular lobes under even light.
    pub lobes: DirectionalAlbedo,
    /// Roughness per covered texel, [0, 1].
    pub roughness: Vec<f32>,
}

impl TexelReflectance {
    /// The model with a roughness per covered texel.
    #[must_use]
    pub fn new(model: Reflectance, roughness: Vec<f32>) -> Self {
        Self {
            model,
            lobes: DirectionalAlbedo::new(model),
            roughness,
        }
    }

    /// Factor of the diffuse part of texel `i` seen at cosine `n_v`.
    #[must_use]
    pub fn diffuse_factor(&self, i: usize, n_v: f32) -> f32 {
        self.model.diffuse_factor(n_v, self.roughness[i])
    }

    /// Specular radiance of texel `i` seen at cosine `n_v` in even light of the given irradiance.
    #[must_use]
    pub fn even_specular(&self, i: usize, n_v: f32, irradiance: Vec3) -> Vec3 {
        irradiance * (FRAC_1_PI * self.lobes.response(n_v, self.roughness[i]))
    }
}
