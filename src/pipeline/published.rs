//! The published method in unbake's frame: its light and its learned materials become a solution
//! like any other, so that scores, pictures and exports compare like with like.

use super::decisions::choose_environment;
use super::light::light_field;
use super::roughness::rooms_of;
use super::solved::Solved;
use super::texel_radiance::{filled_radiance, texture_of};
use super::{SolveOptions, bake_irradiance_texels, observe};
use crate::Result;
use crate::core::brdf::Reflectance;
use crate::core::image::Plane;
use crate::core::progress::Progress;
use crate::core::switch::Switch;
use crate::core::texture::Texels;
use crate::irradiance::Estimator;
use crate::published::{
    Correction, PublishedInput, PublishedOptions, Sides, learn, one_view_per_texel,
};
use crate::scene::Scene;
use crate::solution::Solution;
use crate::verdict::{Findings, Reason};
use glam::{Vec2, Vec3};

/// Standard error of what states none.
const UNKNOWN: f32 = 1e4;

/// Reconstructs a scene as published.
///
/// # Errors
/// Unreadable or unusable images and labels.
pub(super) fn reconstruct_as_published(
    scene: &Scene,
    method: &PublishedOptions,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solved> {
    let options = as_published(method, options);
    let surface = observe(scene, &options, progress)?;
    let tbl = if method.corrects(Correction::W6) {
        let all = vec![true; surface.texels.len()];
        filled_radiance(&surface, &surface.fusion.radiance, &all)
    } else {
        one_view_per_texel(&surface)
    };
    let side = surface.sizes.irradiance;
    let texels = Texels::rasterize(&scene.mesh, side, side);
    let none = vec![false; scene.mesh.triangles.len()];
    let (field, emitters) = light_field(
        &surface,
        &tbl,
        &none,
        choose_environment(&surface, &options, progress),
        &texels,
        &options,
    );
    let baked = bake_irradiance_texels(&surface, &field, &emitters, &texels, &options, progress);
    let irradiance = texture_of(&texels, &baked.value);
    let rooms = rooms_of(&surface, &options, progress);
    let input = PublishedInput {
        surface: &surface,
        tbl: &tbl,
        field: &field,
        irradiance: &irradiance,
        rooms: &rooms,
        seed: options.seed,
    };
    let sides = Sides {
        albedo: surface.sizes.albedo,
        roughness: surface.sizes.roughness,
    };
    let learned = learn(&input, method, sides, progress);
    let rays = baked.rays + learned.rays;
    let solution = Solution {
        lamps: Vec::new(),
        portals: Vec::new(),
        mesh: surface.oriented_mesh(),
        origin: scene.origin,
        albedo: learned.albedo,
        roughness: learned.roughness,
        // the published method knows no emission: lamps are albedo above 1
        emission: learned
            .emission
            .unwrap_or_else(|| Plane::filled(sides.albedo, sides.albedo, Vec3::ZERO)),
        confidence: Plane::filled(sides.albedo, sides.albedo, Vec2::splat(UNKNOWN)),
        metallic: None,
        transmission: None,
        irradiance_error: Some(texels.scatter(&baked.error, 0.0)),
        camera_masks: surface.camera_masks.clone(),
        labels: surface.texels.scatter(&surface.labels, 0),
        environment: field.environment.map().clone(),
        reflectance: Reflectance::Paper,
        rooms,
        irradiance,
        radiance: tbl,
    };
    Ok(Solved {
        findings: said_of(learned.rays, &solution),
        solution,
        fits: Vec::new(),
        rays,
    })
}

/// What a reader must know of a result without stated errors.
fn said_of(own_rays: u64, solution: &Solution) -> Findings {
    let albedo = &solution.albedo.data;
    let mean = albedo.iter().map(|a| f64::from(a.element_sum()) / 3.0);
    Findings {
        mean_albedo: mean.sum::<f64>() / albedo.len().max(1) as f64,
        labelled: true,
        others: vec![Reason {
            what: format!(
                "the published method states no errors ({own_rays} rays of its own stages)"
            ),
            weight: crate::verdict::GUESS,
            place: String::new(),
        }],
        ..Findings::default()
    }
}

/// The numbers of the light and of reading photographs as published: one exposure, hemisphere rays
/// alone. Published meshes close their windows with surface of which the light texture shows what was
/// seen there; where a mesh has none, rays that leave it meet what the photographs show there
/// (`--environment off`: black).
fn as_published(method: &PublishedOptions, options: &SolveOptions) -> SolveOptions {
    let plain = SolveOptions {
        exposure: Switch::Off,
        emission: Switch::Off,
        panes: Switch::Off,
        prefilter: false,
        ..options.clone()
    };
    if method.corrects(Correction::W5) {
        return plain;
    }
    SolveOptions {
        irradiance_estimator: Estimator::Uniform,
        irradiance_rounds: 1,
        emitter_samples: 0,
        ..plain
    }
}
