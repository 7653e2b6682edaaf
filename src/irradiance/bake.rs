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
use std::ops::Range;
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
    let unit = (BLOCK_SAMPLES / (options.rays + lights).max(1) as usize).next_multiple_of(group);
    let bake_run = |run: Range<usize>| bake_points(bake, &round, &receiver, run, progress);
    Irradiance::joined(progress.share(count, unit, bake_run))
}

/// Samples per block that processes share: size of work. Derived: a quarter of a second at a million a second, beside
/// which files of a hundred bytes a receiver are nothing.
const BLOCK_SAMPLES: usize = 1 << 18;

/// Bakes the receivers of a range that begins with a group.
fn bake_points(
    bake: &Bake,
    round: &SamplePass,
    receiver: &(impl Fn(usize) -> Receiver + Sync + Send),
    run: Range<usize>,
    progress: &Progress,
) -> Irradiance {
    let (count, group) = (run.len(), round.group());
    let mut out = Irradiance {
        value: vec![Vec3::ZERO; count],
        parts: vec![[Vec3::ZERO; SUB_ESTIMATES]; count],
        error: vec![0.0; count],
        rays: 0,
    };
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
            let first = run.start + g * group;
            let members = first..first + value.len();
            let rays = bundle.run(bake, round, members.map(receiver), |k, shares| {
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
