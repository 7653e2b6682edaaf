//! Classes without texture take the colours they are painted in, and the light takes over what
//! their albedo gives up.
//!
//! What a camera saw is the product of albedo and irradiance. Where a painted wall seems darker in
//! one place, less light arrives there than was baked: the wall shows the irradiance.

use super::decisions::report_paint;
use super::{Light, SolveOptions, Switch};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::inverse::{AlbedoEstimate, PaletteFit, Unseen};
use crate::observed::Surface;
use glam::{Vec2, Vec3};

/// The irradiance may be off by this factor at most; beyond it a texel is no paint rather than
/// badly lit.
const LIMITS: (f32, f32) = (0.5, 2.0);

/// What is known of every covered texel before its class is asked, and after.
pub(super) struct Estimate<'a> {
    /// Albedo.
    pub(super) albedo: &'a mut AlbedoEstimate,
    /// Its standard error; infinite where unobserved.
    pub(super) errors: &'a mut [f32],
    /// Room of each texel.
    pub(super) rooms: &'a [u16],
}

/// Settles the albedo of painted classes and moves their unevenness into the irradiance, unless the
/// options say no; then gives unseen surface the albedo of its room.
pub(super) fn settle_palettes(
    surface: &Surface,
    light: &mut Light,
    mut estimate: Estimate<'_>,
    options: &SolveOptions,
    progress: &Progress,
) {
    if options.painted != Switch::Off {
        settle_classes(surface, light, &mut estimate, options, progress);
    }
    let completed = Unseen {
        texels: &surface.texels,
        mesh: &surface.scene.mesh,
        labels: &surface.labels,
        rooms: estimate.rooms,
        reflects: &|i| !light.emissive[surface.texels.point[i].triangle as usize],
    }
    .complete(estimate.albedo, estimate.errors);
    progress.note(format!(
        "{completed} texels that no view tells of have the albedo of the nearest surface of their \
         class in their room"
    ));
}

fn settle_classes(
    surface: &Surface,
    light: &mut Light,
    estimate: &mut Estimate<'_>,
    options: &SolveOptions,
    progress: &Progress,
) {
    let Estimate {
        albedo,
        errors,
        rooms,
    } = estimate;
    let texels = &surface.texels;
    let emissive = |i: usize| light.emissive[texels.point[i].triangle as usize];
    let labels: Vec<u16> = (0..texels.len())
        .map(|i| if emissive(i) { 0 } else { surface.labels[i] })
        .collect();
    let painting = PaletteFit {
        albedo,
        error: errors,
        texels,
        mesh: &surface.scene.mesh,
        labels: &labels,
        rooms,
    };
    let paints = painting.paints(options.painted == Switch::On);
    let settled = painting.settle(&paints);
    let ratio: Vec<Vec3> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let (before, after) = (
                albedo.value[i].max(Vec3::splat(1e-3)),
                settled[i].0.max(Vec3::splat(1e-3)),
            );
            if errors[i].is_finite() {
                before / after
            } else {
                Vec3::ONE
            }
        })
        .collect();
    transfer_to_irradiance(surface, light, &ratio);
    for (i, (value, error)) in settled.into_iter().enumerate() {
        albedo.value[i] = value;
        errors[i] = error;
    }
    report_paint(surface.scene, &paints, options, progress);
}

/// Multiplies the irradiance by the mean of `ratio` over the texels that lie in each of its own.
fn transfer_to_irradiance(surface: &Surface, light: &mut Light, ratio: &[Vec3]) {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    let plane = &mut light.irradiance;
    let size = Vec2::new(plane.width as f32, plane.height as f32);
    let mut sums = vec![(Vec3::ZERO, 0u32); plane.data.len()];
    for (i, r) in ratio.iter().enumerate().filter(|(_, r)| **r != Vec3::ONE) {
        let p = texels.point[i];
        let at = mesh.uv(p.triangle as usize, p.u, p.v) * size;
        let (x, y) = (
            (at.x.max(0.0) as usize).min(plane.width - 1),
            (at.y.max(0.0) as usize).min(plane.height - 1),
        );
        let sum = &mut sums[y * plane.width + x];
        *sum = (sum.0 + *r, sum.1 + 1);
    }
    plane
        .data
        .par_iter_mut()
        .zip(sums)
        .filter(|(_, s)| s.1 > 0)
        .for_each(|(e, (sum, n))| {
            *e *= (sum / n as f32).clamp(Vec3::splat(LIMITS.0), Vec3::splat(LIMITS.1));
        });
}
