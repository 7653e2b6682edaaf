//! Last step: estimates per texel become the textures of the solution.

use super::clipped_light::FoundLight;
use super::lamp_surfaces::cut_lamps;
use super::metals::metal_texels;
use super::portal_list::portals;
use super::usual_roughness::SMOOTH;
use super::{Light, Roughness};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use crate::core::texture::fill_uncovered;
use crate::inverse::AlbedoEstimate;
use crate::observed::{Surface, filled};
use crate::scene::Class;
use crate::solution::{Lamp, LampKind, Solution, find_lamps};
use glam::{Vec2, Vec3};

/// The textures of a reconstruction.
pub(super) fn assemble(
    surface: &Surface,
    light: &Light,
    roughness: &Roughness,
    albedo: &AlbedoEstimate,
    errors: &[f32],
    found: &[FoundLight],
) -> Solution {
    let texels = &surface.texels;
    let per_texel = roughness_per_texel(surface, roughness, albedo);
    let confidence: Vec<Vec2> = errors
        .iter()
        .zip(&per_texel)
        .map(|(e, r)| Vec2::new(e.min(1e4), r.error))
        .collect();
    let emission = emission(surface, light, found);
    let mesh = cut_lamps(surface.oriented_mesh(), &emission);
    let origin = surface.scene.origin;
    let mut lamps = find_lamps(&mesh, &emission, origin);
    let marks = LightMarks::of(surface, found);
    lamps
        .iter_mut()
        .for_each(|lamp| marks.describe(&mesh, lamp));
    let portals = portals(
        &mesh,
        &surface.tracer,
        &light.field.environment,
        origin,
        lamps.len(),
    );
    Solution {
        lamps,
        portals,
        mesh,
        origin,
        albedo: albedo_texture(surface, albedo),
        roughness: roughness_texture(surface, &per_texel),
        irradiance: light.irradiance.clone(),
        radiance: light.radiance.clone(),
        emission,
        confidence: texels.scatter(&confidence, Vec2::splat(1e4)),
        metallic: metallic_texture(surface, light, roughness),
        transmission: transmission_texture(surface),
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
            // of a pane nothing but what it lets through is known
            if surface.panes.of(texels.point[i].triangle).is_some() {
                return TexelRoughness {
                    value: SMOOTH,
                    error: 1e4,
                };
            }
            let colour = albedo.error[i].is_finite().then_some(albedo.value[i]);
            let (value, error) = roughness
                .materials
                .roughness(
                    surface.labels[i],
                    roughness.rooms.data[texels.cell[i] as usize],
                    colour,
                    texels.position(&surface.scene.mesh, i),
                )
                .unwrap_or_else(|| (roughness.usual.of_class(surface.labels[i]), 1e4));
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

/// Where the surface is metal; `None` if nowhere.
fn metallic_texture(surface: &Surface, light: &Light, roughness: &Roughness) -> Option<Plane<f32>> {
    let texels = metal_texels(surface, light, &roughness.metals);
    if texels.is_empty() {
        return None;
    }
    let mut metal = vec![0.0; surface.texels.len()];
    texels.iter().for_each(|(i, _)| metal[*i as usize] = 1.0);
    Some(filled(&surface.texels, &metal))
}

/// Where light goes straight through; `None` if nowhere.
fn transmission_texture(surface: &Surface) -> Option<Plane<f32>> {
    if surface.panes.is_empty() {
        return None;
    }
    let texels = &surface.texels;
    let mut share = vec![0.0; texels.len()];
    let panes = surface.panes.texels(texels);
    panes.for_each(|(i, _)| share[i] = 1.0);
    Some(filled(texels, &share))
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

/// Emitted radiance: that of emissive triangles and of lamps within other triangles, black
/// elsewhere.
fn emission(surface: &Surface, light: &Light, found: &[FoundLight]) -> RgbPlane {
    let texels = &surface.texels;
    let mut emits: Vec<bool> = (texels.point.iter())
        .map(|p| light.emissive[p.triangle as usize])
        .collect();
    for &i in found.iter().filter(|l| l.emits).flat_map(|l| &l.texels) {
        emits[i as usize] = true;
    }
    let value: Vec<Vec3> = (texels.cell.iter().zip(&emits))
        .map(|(&cell, &emits)| {
            if emits {
                light.radiance.data[cell as usize]
            } else {
                Vec3::ZERO
            }
        })
        .collect();
    texels.scatter(&value, Vec3::ZERO)
}

/// What is known of lights by texel.
struct LightMarks {
    /// Window panes.
    window: Plane<bool>,
    /// Relative standard error where the radiance was beyond the photographs' ceiling, else zero.
    error: Plane<f32>,
}

impl LightMarks {
    fn of(surface: &Surface, found: &[FoundLight]) -> Self {
        let texels = &surface.texels;
        let window = surface.texels_of(Class::is_window);
        let mut error = vec![0.0f32; texels.len()];
        for light in found {
            for &i in &light.texels {
                error[i as usize] = light.log_error.max(f32::MIN_POSITIVE);
            }
        }
        Self {
            window: texels.scatter(&window, false),
            error: texels.scatter(&error, 0.0),
        }
    }

    /// Says of a lamp what most of its surface is.
    fn describe(&self, mesh: &Mesh, lamp: &mut Lamp) {
        let size = Vec2::new(self.window.width as f32, self.window.height as f32);
        let (mut all, mut window, mut clipped, mut square) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for &t in &lamp.triangles {
            let at = mesh.uv(t as usize, 1.0 / 3.0, 1.0 / 3.0) * size;
            let (area, error) = (mesh.area(t as usize), *self.error.nearest(at));
            all += area;
            window += area * f32::from(u8::from(*self.window.nearest(at)));
            clipped += area * f32::from(u8::from(error > 0.0));
            square += area * error * error;
        }
        if window > 0.5 * all {
            lamp.kind = LampKind::Window;
        }
        lamp.clipped = clipped > 0.5 * all;
        lamp.standard_error = (square / all.max(f32::MIN_POSITIVE)).sqrt();
    }
}
