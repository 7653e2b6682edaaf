//! Irradiance from the paper's neural field in place of the texture's rays: its lighting ablation
//! (method §3.2).

use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::irradiance::{Irradiance, NirfOptions, SUB_ESTIMATES, train_nirf};
use crate::lights::LitScene;
use crate::observed::Surface;
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// Trains a field and reads it out at every texel. The stated error is what the last
/// epoch's loss amounts to, the noise of its targets included.
pub(super) fn field_at_texels(
    surface: &Surface,
    lit: LitScene<'_>,
    texels: &Texels,
    training: &NirfOptions,
    progress: &Progress,
) -> Irradiance {
    let bake = lit.into();
    let epochs = u64::from(training.epochs);
    let (nirf, cost) = progress.stage("neural irradiance field", epochs, |p| {
        train_nirf(
            &bake,
            &|t, u, v| surface.normals(t, u, v),
            training,
            p,
            &mut |_, _| {},
        )
    });
    let points: Vec<(Vec3, Vec3)> = (0..texels.len())
        .into_par_iter()
        .map(|i| surface.receiver(texels, i))
        .map(|r| (r.position, r.normal))
        .collect();
    let value: Vec<Vec3> = nirf
        .irradiance(&points)
        .into_iter()
        .map(|e| e.max(Vec3::ZERO))
        .collect();
    // a mean |log(1+E) − target| of l is a standard deviation of √(π/2)·l, if it is normal
    let spread = FRAC_PI_2.sqrt() * cost.loss as f32;
    let error = value
        .iter()
        .map(|e| luminance(*e))
        .map(|e| spread * (1.0 + e) / e.max(f32::MIN_POSITIVE))
        .map(|e| e.min(1e4));
    Irradiance {
        error: error.collect(),
        parts: value.iter().map(|e| [*e; SUB_ESTIMATES]).collect(),
        value,
        rays: cost.rays,
    }
}
