//! Last step: estimates per texel become the textures of the solution.

use super::roughness::ROUGHNESS_PRIOR;
use super::{Light, Roughness};
use crate::image::{Plane, Wrap};
use crate::inverse::AlbedoEstimate;
use crate::observed::{Surface, filled};
use crate::solution::{Solution, find_lamps};
use crate::texture::fill_uncovered;
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
    let Roughness {
        materials,
        rooms,
        reflectance,
    } = roughness;
    let roughness: Vec<(f32, f32)> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let colour = albedo.error[i].is_finite().then_some(albedo.value[i]);
            materials
                .roughness(
                    surface.labels[i],
                    rooms.data[texels.cell[i] as usize],
                    colour,
                    surface.texels.position(&surface.scene.mesh, i),
                )
                .unwrap_or((ROUGHNESS_PRIOR, 1e4))
        })
        .collect();
    // unseen texels have a value where their class says what to expect
    let observed: Vec<bool> = albedo
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
    let albedo_plane = fill_uncovered(
        &texels.scatter(&value, Vec3::ZERO),
        &texels.scatter(&observed, false),
    );
    let confidence: Vec<Vec2> = errors
        .iter()
        .zip(&roughness)
        .map(|(e, r)| Vec2::new(e.min(1e4), r.1))
        .collect();
    let emission: Vec<Vec3> = (0..texels.len())
        .map(|i| {
            if light.emissive[texels.point[i].triangle as usize] {
                light.radiance.data[texels.cell[i] as usize]
            } else {
                Vec3::ZERO
            }
        })
        .collect();
    let size = surface.sizes.roughness;
    let r = filled(texels, &roughness.iter().map(|r| r.0).collect::<Vec<f32>>());
    let scale = Vec2::new(r.width as f32, r.height as f32) / size as f32;
    let at = |i: usize| Vec2::new((i % size) as f32 + 0.5, (i / size) as f32 + 0.5) * scale;
    let data = (0..size * size)
        .into_par_iter()
        .map(|i| r.bilinear(at(i), Wrap::Clamp))
        .collect();
    let roughness = Plane {
        width: size,
        height: size,
        data,
    };
    let mesh = surface.oriented_mesh();
    let emission = texels.scatter(&emission, Vec3::ZERO);
    let origin = surface.scene.origin;
    Solution {
        lamps: find_lamps(&mesh, &emission, origin),
        mesh,
        origin,
        albedo: albedo_plane,
        roughness,
        irradiance: light.irradiance.clone(),
        radiance: light.radiance.clone(),
        emission,
        confidence: texels.scatter(&confidence, Vec2::splat(1e4)),
        irradiance_error: Some(light.texels.scatter(&light.error, 0.0)),
        rooms: rooms.clone(),
        labels: texels.scatter(&surface.labels, 0),
        environment: light.field.environment.map().clone(),
        reflectance: reflectance.model,
    }
}
