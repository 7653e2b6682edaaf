//! Classes without texture take the colours they are painted in, and the light takes over what
//! their albedo gives up.
//!
//! What a camera saw is the product of albedo and irradiance. Where a painted wall seems darker in
//! one place, less light arrives there than was baked: the wall shows the irradiance.

use super::decisions::report_paint;
use super::{Light, SolveOptions, Switch};
use crate::inverse::{AlbedoEstimate, Painting};
use crate::observed::Surface;
use crate::progress::Progress;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// The irradiance may be off by this factor at most; beyond it a texel is no paint rather than
/// badly lit.
const LIMITS: (f32, f32) = (0.5, 2.0);

/// Settles the albedo of painted classes and moves their unevenness into the irradiance. `errors`
/// are the albedo's standard errors before and after.
pub(super) fn settle_paint(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    errors: &mut [f32],
    options: &SolveOptions,
    progress: &Progress,
) {
    let texels = &surface.texels;
    let emissive = |i: usize| light.emissive[texels.point[i].triangle as usize];
    let labels: Vec<u16> = (0..texels.len())
        .map(|i| if emissive(i) { 0 } else { surface.labels[i] })
        .collect();
    let painting = Painting {
        albedo,
        error: errors,
        texels,
        mesh: &surface.scene.mesh,
        labels: &labels,
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
    share_out(surface, light, &ratio);
    for (i, (value, error)) in settled.into_iter().enumerate() {
        albedo.value[i] = value;
        errors[i] = error;
    }
    report_paint(surface.scene, &paints, options, progress);
}

/// Multiplies the irradiance by the mean of `ratio` over the texels that lie in each of its own.
fn share_out(surface: &Surface, light: &mut Light, ratio: &[Vec3]) {
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
