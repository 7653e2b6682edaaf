//! Last step: estimates per texel become the textures of the solution.

use super::roughness::ROUGHNESS_PRIOR;
use super::{Light, Roughness};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::texture::fill_uncovered;
use crate::inverse::AlbedoEstimate;
use crate::observed::{Surface, filled};
use crate::solution::{Solution, find_lamps};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// The textures of a reconstruction.
pub(super) fn assemble(
    surface: &Surface,
    light: &Light,
    roughness: &Roughness,
    albedo: &AlbedoEstimate,
    errors: &[f32],
) -> Solution {
    let texels = &surface.texels;
    let per_texel = roughness_per_texel(surface, roughness, albedo);
    let confidence: Vec<Vec2> = errors
        .iter()
        .zip(&per_texel)
        .map(|(e, r)| Vec2::new(e.min(1e4), r.error))
        .collect();
    let mesh = surface.oriented_mesh();
    let emission = emission(surface, light);
    let origin = surface.scene.origin;
    Solution {
        lamps: find_lamps(&mesh, &emission, origin),
        mesh,
        origin,
        albedo: albedo_texture(surface, albedo),
        roughness: roughness_texture(surface, &per_texel),
        irradiance: light.irradiance.clone(),
        radiance: light.radiance.clone(),
        emission,
        confidence: texels.scatter(&confidence, Vec2::splat(1e4)),
        irradiance_error: Some(light.texels.scatter(&light.error, 0.0)),
        camera_masks: surface.camera_masks.clone(),
        rooms: roughness.rooms.clone(),
        labels: texels.scatter(&surface.labels, 0),
        environment: light.field.environment.map().clone(),
        reflectance: roughness.reflectance.model,
    }
}

/// Roughness of a texel and its standard error.
struct TexelRoughness {
    value: f32,
    error: f32,
}

/// That of each texel's material.
fn roughness_per_texel(
    surface: &Surface,
    roughness: &Roughness,
    albedo: &AlbedoEstimate,
) -> Vec<TexelRoughness> {
    let texels = &surface.texels;
    (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let colour = albedo.error[i].is_finite().then_some(albedo.value[i]);
            let (value, error) = roughness
                .materials
                .roughness(
                    surface.labels[i],
                    roughness.rooms.data[texels.cell[i] as usize],
                    colour,
                    texels.position(&surface.scene.mesh, i),
                )
                .unwrap_or((ROUGHNESS_PRIOR, 1e4));
            TexelRoughness { value, error }
        })
        .collect()
}

/// Albedo between 0 and 1, filled between charts and where nothing is known.
fn albedo_texture(surface: &Surface, albedo: &AlbedoEstimate) -> RgbPlane {
    // unseen texels have a value where their class says what to expect
    let known: Vec<bool> = albedo
        .error
        .iter()
        .zip(&albedo.value)
        .map(|(e, a)| e.is_finite() || *a != Vec3::ZERO)
        .collect();
    let value: Vec<Vec3> = albedo
        .value
        .iter()
        .map(|a| a.clamp(Vec3::ZERO, Vec3::ONE))
        .collect();
    fill_uncovered(
        &surface.texels.scatter(&value, Vec3::ZERO),
        &surface.texels.scatter(&known, false),
    )
}

/// Roughness at the size asked for.
fn roughness_texture(surface: &Surface, per_texel: &[TexelRoughness]) -> Plane<f32> {
    let size = surface.sizes.roughness;
    let value: Vec<f32> = per_texel.iter().map(|r| r.value).collect();
    let fine = filled(&surface.texels, &value);
    let scale = Vec2::new(fine.width as f32, fine.height as f32) / size as f32;
    let at = |i: usize| Vec2::new((i % size) as f32 + 0.5, (i / size) as f32 + 0.5) * scale;
    Plane {
        width: size,
        height: size,
        data: (0..size * size)
            .into_par_iter()
            .map(|i| fine.bilinear(at(i), Wrap::Clamp))
            .collect(),
    }
}

/// Emitted radiance: that of emissive triangles, black elsewhere.
fn emission(surface: &Surface, light: &Light) -> RgbPlane {
    let texels = &surface.texels;
    let value: Vec<Vec3> = (0..texels.len())
        .map(|i| {
            if light.emissive[texels.point[i].triangle as usize] {
                light.radiance.data[texels.cell[i] as usize]
            } else {
                Vec3::ZERO
            }
        })
        .collect();
    texels.scatter(&value, Vec3::ZERO)
}
