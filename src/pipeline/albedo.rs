//! Stage "albedo": in closed form where views see texels clean, from mixed pixels where they do not,
//! and what is known of its error.

use super::{Light, Reflections, Roughness, SolveOptions};
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::switch::Switch;
use crate::inverse::{
    AlbedoEstimate, ErrorSources, MixedPixelSolver, Shading, albedo_error, estimate_albedo,
};
use crate::observed::Surface;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
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
    let affordable = || {
        let budget = options.budget.as_ref();
        budget.is_none_or(|b| b.allows_edges(progress))
    };
    // a pixel's mixture says nothing where what it mixes is not in the mesh
    let allowed = match options.edges {
        Switch::Auto => surface.contradictions.deviation.is_empty(),
        switch => switch == Switch::On,
    };
    let rays = if allowed && affordable() {
        solve_edges(
            surface,
            light,
            reflections,
            roughness,
            &mut albedo,
            progress,
        )
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

/// Solves for the albedo of texels without a clean look; returns the rays traced.
fn solve_edges(
    surface: &Surface,
    light: &Light,
    reflections: &Reflections,
    roughness: &Roughness,
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
            rooms: &roughness.texel_rooms(texels),
            irradiance: &irradiance,
            specular: &reflections.images,
            reflectance: &roughness.reflectance,
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
pub(super) fn albedo_errors(surface: &Surface, light: &Light, albedo: &AlbedoEstimate) -> Vec<f32> {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    // beyond the charts of the irradiance texture nothing is known of its error
    let noise = light.texels.scatter(&light.error, 1.0);
    let size = Vec2::new(noise.width as f32, noise.height as f32);
    let irradiance_error = |i: usize| {
        let p = texels.point[i];
        noise
            .nearest(mesh.uv(p.triangle as usize, p.u, p.v) * size)
            .clamp(0.0, 1.0)
    };
    let footprint = |i: usize| {
        let side = texels
            .texel_area(mesh, texels.point[i].triangle as usize)
            .sqrt();
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
