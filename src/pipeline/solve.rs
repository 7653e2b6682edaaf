//! The main job: light, then materials. Reads as the figure in README, one call a stage.

use super::clipped_light::restore_clipped_light;
use super::published::reconstruct_as_published;
use super::segments::doubt_of_segments;
use super::settle::{Estimated, settle};
use super::solved::Solved;
use super::{
    SolveOptions, fit_roughness, gather_highlights, observe, reconstruct_light, solve_albedo,
    trace_reflections,
};
use crate::Result;
use crate::core::progress::Progress;
use crate::scene::Scene;

/// Reconstructs materials and light of a scene.
///
/// # Errors
/// Unusable options, unreadable or unusable images and labels.
pub fn reconstruct(scene: &Scene, options: &SolveOptions, progress: &Progress) -> Result<Solved> {
    options.validate()?;
    if let Some(method) = &options.published {
        return reconstruct_as_published(scene, method, options, progress);
    }
    let mut surface = observe(scene, options, progress)?;
    let clipped_light = restore_clipped_light(&mut surface, options, progress);
    let mut light = reconstruct_light(&surface, options, progress);
    let mut doubts = Vec::new();
    if let Some(segments) = light.segments.take() {
        surface.labels = segments;
        doubts.push(doubt_of_segments());
    }
    let highlights = gather_highlights(&surface, &light, options, progress);
    let roughness = fit_roughness(&surface, &light, &highlights.evidence, options, progress);
    let reflections =
        trace_reflections(&surface, &light, &highlights, &roughness, options, progress);
    let solved = solve_albedo(
        &surface,
        &light,
        &reflections,
        &roughness,
        options,
        progress,
    );
    let rays = light.rays + highlights.evidence.rays + reflections.rays + solved.rays;
    let estimated = Estimated {
        albedo: solved.albedo,
        roughness: &roughness,
        clipped_light,
        doubts,
        rays,
    };
    Ok(settle(&surface, light, estimated, options, progress))
}
