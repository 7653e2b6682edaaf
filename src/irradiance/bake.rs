//! The irradiance texture (IrT): E(x) = ∫ L(x, ω) cosθ dω over the hemisphere of every texel,
//! linear RGB, in the images' exposure.
//!
//! `Uniform` is the paper's estimator: Hammersley points, one random shift per texel (method §3.1).
//! `Mis` combines cosine-distributed rays with samples on emitters by the balance heuristic (Veach
//! & Guibas 1995), both from an Owen-scrambled Sobol' sequence per texel that a later bake
//! continues where more samples are wanted.

use super::ray_batch::{RayBatch, SamplePass};
use super::{Bake, Estimator, Irradiance, IrradianceOptions, Receiver, SUB_ESTIMATES, spread};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use glam::Vec3;
use std::sync::{Mutex, PoisonError};

/// Bakes the irradiance of `count` receivers given by `receiver(i)`.
#[must_use]
pub fn bake_irradiance(
    bake: &Bake,
    count: usize,
    receiver: impl Fn(usize) -> Receiver + Sync + Send,
    options: &IrradianceOptions,
    progress: &Progress,
) -> Irradiance {
    let mut out = Irradiance {
        value: vec![Vec3::ZERO; count],
        parts: vec![[Vec3::ZERO; SUB_ESTIMATES]; count],
        error: vec![0.0; count],
        rays: 0,
    };
    let lights = if options.estimator == Estimator::Mis {
        options.emitter_samples
    } else {
        0
    };
    let [ray, light] = options.drawn;
    let round = SamplePass::new(
        options,
        [ray, ray + options.rays.max(SUB_ESTIMATES as u32)],
        [light, light + lights],
    );
    let group = round.group();
    // buffers that no thread uses
    let idle: Mutex<Vec<RayBatch>> = Mutex::default();
    let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
    let groups = out
        .value
        .par_chunks_mut(group)
        .zip(out.parts.par_chunks_mut(group))
        .zip(out.error.par_chunks_mut(group));
    out.rays = groups
        .enumerate()
        .with_max_len(1)
        .map(|(g, ((value, parts), error))| {
            let mut bundle = idle().pop().unwrap_or_default();
            let members = g * group..g * group + value.len();
            let rays = bundle.run(bake, &round, members.map(&receiver), |k, shares| {
                value[k] = shares.iter().sum();
                parts[k] = shares.map(|s| SUB_ESTIMATES as f32 * s);
                error[k] = (spread(&parts[k].map(luminance)).1 / SUB_ESTIMATES as f32).sqrt();
            });
            idle().push(bundle);
            progress.advance(value.len() as u64);
            rays
        })
        .sum();
    out
}
