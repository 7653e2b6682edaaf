//! The paper's neural irradiance field beside the texture: error at the reference's texels, and
//! time.

use super::fixture::relative_errors;
use super::{BenchScene, ErrorPoint, Reference, timed};
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::irradiance::{Nirf, NirfCost, NirfOptions, train_nirf};
use glam::Vec3;
use serde::Serialize;

/// Epochs of the paper.
const PAPER_EPOCHS: f64 = 2000.0;
/// Texels whose read-out is timed.
const READ: usize = 4096;

/// What a neural irradiance field cost and how good it became.
#[derive(Clone, Debug, Serialize)]
pub struct NirfReport {
    /// Epochs trained.
    pub epochs: u32,
    /// Rays traced.
    pub rays: u64,
    /// Seconds on targets.
    pub ray_seconds: f64,
    /// Seconds on steps.
    pub step_seconds: f64,
    /// Mean L1 loss in log(1+E) of the last epoch.
    pub loss: f64,
    /// Seconds that the paper's 2000 epochs would take at this pace; their error is not known from
    /// here.
    pub seconds_2000: f64,
    /// Seconds to read out the whole texture, scaled up from a part.
    pub readout_seconds: f64,
    /// Error after a quarter, a half and all of the epochs; `rays` counts epochs here.
    pub checkpoints: Vec<ErrorPoint>,
}

/// Trains for `epochs` and takes errors on the way.
#[must_use]
pub(super) fn measure(
    ground: &BenchScene,
    texels: &Texels,
    reference: &Reference,
    epochs: u32,
    progress: &Progress,
) -> NirfReport {
    let epochs = epochs.max(1);
    let surface = &ground.surface;
    let place = |i: usize| {
        let r = surface.receiver(texels, i);
        (r.position, r.normal)
    };
    let points: Vec<(Vec3, Vec3)> = reference.ids.iter().map(|&i| place(i)).collect();
    let options = NirfOptions::of_run(epochs, ground.options.seed);
    let mut checkpoints = Vec::new();
    let bake = ground.bake(&surface.tracer);
    let mut each = |field: &Nirf, cost: &NirfCost| {
        if [epochs.div_ceil(4), epochs.div_ceil(2), epochs].contains(&cost.epochs) {
            let (relative_rmse, median_relative_error) =
                relative_errors(&field.irradiance(&points), &reference.value);
            checkpoints.push(ErrorPoint {
                curve: "nirf".to_owned(),
                rays: cost.epochs,
                emitter_samples: 0,
                rays_per_texel: cost.rays as f64 / texels.len().max(1) as f64,
                seconds: cost.ray_seconds + cost.step_seconds,
                measured_whole: true,
                relative_rmse,
                median_relative_error,
            });
        }
    };
    let (field, cost) = train_nirf(
        &bake,
        &|t, u, v| surface.normals(t, u, v),
        &options,
        progress,
        &mut each,
    );
    let some: Vec<(Vec3, Vec3)> = ground
        .runs(texels, READ)
        .iter()
        .map(|&i| place(i))
        .collect();
    let (_, seconds) = timed(|| field.irradiance(&some));
    let total = cost.ray_seconds + cost.step_seconds;
    NirfReport {
        epochs: cost.epochs,
        rays: cost.rays,
        ray_seconds: cost.ray_seconds,
        step_seconds: cost.step_seconds,
        loss: cost.loss,
        seconds_2000: total * PAPER_EPOCHS / f64::from(cost.epochs.max(1)),
        readout_seconds: seconds * texels.len() as f64 / some.len().max(1) as f64,
        checkpoints,
    }
}
