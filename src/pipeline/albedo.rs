//! Stage "albedo": in closed form where views see texels clean, from mixed pixels where they do not,
//! and what is known of its error.

use super::{Light, Reflections, Roughness, SolveOptions};
use crate::core::image::Plane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::inverse::{
    AlbedoEstimate, ErrorSources, Ground, LeastAlbedo, MixedPixelSolver, Shading, StatedErrors,
    albedo_error, estimate_albedo, settle_clipped,
};
use crate::observed::Surface;
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Albedo and the rays that it took.
pub struct SolvedAlbedo {
    /// The estimate per covered texel.
    pub albedo: AlbedoEstimate,
    /// Rays traced.
    pub rays: u64,
}

/// Solves for the albedo of every covered texel.
#[must_use]
pub fn solve_albedo(
    surface: &Surface,
    light: &Light,
    reflections: &Reflections,
    roughness: &Roughness,
    options: &SolveOptions,
    progress: &Progress,
) -> SolvedAlbedo {
    let mut albedo = progress.stage("albedo", surface.texels.len() as u64, |p| {
        estimate_albedo(
            &surface.observer(),
            &surface.texels,
            &surface.orientation,
            Shading {
                irradiance: &light.irradiance,
                specular: &reflections.images,
            },
            &roughness.reflectance,
            p,
        )
    });
    settle_contradicted(surface, light, &mut albedo);
    let rooms = roughness.texel_rooms(&surface.texels);
    let settled = settle_bounds(surface, light, &rooms, &mut albedo);
    let affordable = || {
        let budget = options.budget.as_ref();
        budget.is_none_or(|b| b.allows_edges(progress))
    };
    // a pixel's mixture says nothing where what it mixes is not in the mesh
    let allowed = (options.edges).or(surface.contradictions.deviation.is_empty());
    let rays = if allowed && affordable() {
        let known = Known {
            reflections,
            roughness,
            rooms: &rooms,
            settled: &settled,
        };
        solve_edges(surface, light, &known, &mut albedo, progress)
    } else {
        0
    };
    SolvedAlbedo { albedo, rays }
}

/// Texels on which views contradict each other reflect the mean of what the views show, with the
/// disagreement as their error.
fn settle_contradicted(surface: &Surface, light: &Light, albedo: &mut AlbedoEstimate) {
    let texels = &surface.texels;
    let found = &surface.contradictions;
    for i in (0..texels.len()).filter(|&i| found.contradicted(i)) {
        let e = texels.lookup(&surface.scene.mesh, &light.irradiance, i);
        if luminance(e) <= 0.0 || !albedo.error[i].is_finite() {
            continue;
        }
        let e = e.max(Vec3::splat(luminance(e) * 1e-6));
        let diffuse = 1.0 - albedo.specular_share[i].clamp(0.0, 1.0);
        albedo.value[i] = surface.fusion.radiance[i] * (diffuse * PI) / e;
        let looks = f32::from(surface.fusion.views[i]).max(1.0);
        albedo.looks[i] = looks;
        albedo.error[i] = found.deviation[i] * luminance(albedo.value[i]) / looks.sqrt();
    }
}

/// Error of a bound from what glossy surfaces add to their diffuse light, relative: the reflectance
/// of dielectrics at normal incidence (derived, F0 = 0.04 for a refractive index of 1.5).
const GLOSS: f32 = 0.04;

/// Gives texels of which only clipped looks are known the albedo of their class above that bound;
/// the texels concerned, ascending.
pub(super) fn settle_bounds(
    surface: &Surface,
    light: &Light,
    rooms: &[u16],
    albedo: &mut AlbedoEstimate,
) -> Vec<u32> {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    let noise = light.texels.scatter(&light.error, 1.0);
    let reflects = |i: usize| !light.emissive[texels.point[i].triangle as usize];
    let bounds: Vec<LeastAlbedo> = surface
        .clipped
        .iter()
        .filter(|t| reflects(t.texel as usize))
        .filter_map(|t| {
            let i = t.texel as usize;
            let e = texels.lookup(mesh, &light.irradiance, i);
            let error = light_error(surface, &noise, i).hypot(GLOSS);
            (e.min_element() > 0.0).then(|| LeastAlbedo {
                texel: t.texel,
                albedo: t.least * PI / e,
                error,
                footprint: t.footprint,
            })
        })
        .collect();
    let ground = Ground {
        texels,
        mesh,
        labels: &surface.labels,
        rooms,
    };
    settle_clipped(&ground, &bounds, albedo)
}

/// Relative error of the irradiance on a texel; `noise` is that of the light on its texture.
fn light_error(surface: &Surface, noise: &Plane<f32>, i: usize) -> f32 {
    let p = surface.texels.point[i];
    let size = Vec2::new(noise.width as f32, noise.height as f32);
    noise
        .nearest(surface.scene.mesh.uv(p.triangle as usize, p.u, p.v) * size)
        .clamp(0.0, 1.0)
}

/// What is known when mixed pixels are taken apart.
struct Known<'a> {
    reflections: &'a Reflections,
    roughness: &'a Roughness,
    /// Room per texel.
    rooms: &'a [u16],
    /// Texels without a clean look whose albedo is known all the same, ascending.
    settled: &'a [u32],
}

/// Solves for the albedo of texels without a clean look; returns the rays traced.
fn solve_edges(
    surface: &Surface,
    light: &Light,
    known: &Known<'_>,
    albedo: &mut AlbedoEstimate,
    progress: &Progress,
) -> u64 {
    let texels = &surface.texels;
    let report = progress.stage("albedo at edges", 0, |_| {
        let irradiance: Vec<Vec3> = (0..texels.len())
            .into_par_iter()
            .map(|i| texels.lookup(&surface.scene.mesh, &light.irradiance, i))
            .collect();
        let unmixing = MixedPixelSolver {
            observer: surface.observer(),
            orientation: &surface.orientation,
            tracer: &surface.tracer,
            field: &light.field,
            texels,
            labels: &surface.labels,
            rooms: known.rooms,
            irradiance: &irradiance,
            specular: &known.reflections.images,
            reflectance: &known.roughness.reflectance,
            settled: known.settled,
            bounds: &surface.bounds,
        };
        unmixing.solve(albedo)
    });
    progress.note(format!(
        "{} pixels at edges tell of {} texels that no view sees clean (misfit {:.2})",
        report.pixels, report.texels, report.misfit
    ));
    report.rays
}

/// Standard error of the albedo per covered texel, with what irradiance and geometry contribute.
pub(super) fn albedo_errors(
    surface: &Surface,
    light: &Light,
    albedo: &AlbedoEstimate,
) -> StatedErrors {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    // beyond the charts of the irradiance texture nothing is known of its error
    let noise = light.texels.scatter(&light.error, 1.0);
    let irradiance_error = |i: usize| light_error(surface, &noise, i);
    let footprint = |i: usize| {
        let side = texels.area(mesh, i).sqrt();
        albedo.footprint[i] / side.max(f32::MIN_POSITIVE)
    };
    let reflects = |i: usize| !light.emissive[texels.point[i].triangle as usize];
    let all = || (0..texels.len()).into_par_iter();
    let sources = ErrorSources {
        irradiance: all().map(irradiance_error).collect(),
        footprint: all().map(footprint).collect(),
        reflects: all().map(reflects).collect(),
    };
    albedo_error(albedo, texels, &surface.labels, &sources)
}
