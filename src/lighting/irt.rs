//! The irradiance texture (IrT): E(x) = ∫ L(x, ω) cosθ dω over the hemisphere of every texel, linear RGB, in the images' exposure.
//!
//! `Uniform` is the paper's estimator: Hammersley points, one random shift per texel (method §3.1). `Mis` combines
//! cosine-distributed rays with samples on emitters by the balance heuristic (Veach & Guibas 1995), both from an Owen-scrambled
//! Sobol' sequence per texel; texels whose two halves disagree are refined.

use super::bundle::{Bundle, Round};
use super::{Emitters, LightField};
use crate::geometry::Mesh;
use crate::math::luminance;
use crate::parallel;
use crate::progress::Progress;
use crate::trace::Tracer;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};

/// Texels per parallel task.
const CHUNK: usize = 256;

/// How irradiance is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// The paper's: uniform hemisphere, Hammersley points with a random shift per texel.
    Uniform,
    /// Cosine-distributed rays, Owen-scrambled Sobol' points.
    Cosine,
    /// Cosine rays and emitter samples combined by multiple importance sampling.
    Mis,
}

/// Options of the irradiance bake.
#[derive(Clone, Debug, PartialEq)]
pub struct IrtOptions {
    /// Estimator.
    pub estimator: Estimator,
    /// Hemisphere rays and emitter samples per texel that an earlier bake has drawn: this one continues their sequences, and its values
    /// are the new samples' share of the estimate from all.
    pub drawn: [u32; 2],
    /// Hemisphere rays per texel in the first round.
    pub rays: u32,
    /// Emitter samples per texel in the first round (only `Mis`).
    pub emitter_samples: u32,
    /// Rounds at most; each round after the first doubles a texel's samples.
    pub max_rounds: u32,
    /// Relative standard error at which a texel is done.
    pub target: f32,
    /// Seed of the sample points.
    pub seed: u64,
}

impl Default for IrtOptions {
    fn default() -> Self {
        Self { estimator: Estimator::Mis, drawn: [0, 0], rays: 64, emitter_samples: 16, max_rounds: 1, target: 0.01, seed: 0 }
    }
}

/// Irradiance of a list of surface points.
#[derive(Clone, Debug, Default)]
pub struct Irradiance {
    /// E per point.
    pub value: Vec<Vec3>,
    /// Two independent estimates of E per point, from the even and the odd samples; their mean is `value`.
    pub halves: Vec<[Vec3; 2]>,
    /// Estimated standard error of E's luminance, relative.
    pub error: Vec<f32>,
    /// Rays traced in all.
    pub rays: u64,
}

/// A point that receives light.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Position on the surface, metres.
    pub position: Vec3,
    /// Unit shading normal on the lit side.
    pub normal: Vec3,
    /// Unit geometric normal on the lit side: rays start above it.
    pub face_normal: Vec3,
    /// Key of its random numbers: equal keys give equal points whatever else is baked.
    pub key: u64,
}

/// Everything rays need.
pub struct Bake<'a> {
    /// Geometry.
    pub mesh: &'a Mesh,
    /// Visibility.
    pub tracer: &'a dyn Tracer,
    /// Radiance along rays.
    pub field: &'a LightField,
    /// Emitters to sample.
    pub emitters: &'a Emitters,
    /// Distance by which rays start above the surface, metres.
    pub offset: f32,
}

/// Bakes the irradiance of `count` receivers given by `receiver(i)`.
#[must_use]
pub fn bake_irradiance(
    bake: &Bake,
    count: usize,
    receiver: impl Fn(usize) -> Receiver + Sync + Send,
    options: &IrtOptions,
    progress: &Progress,
) -> Irradiance {
    let rays = AtomicU64::new(0);
    let parts = parallel::map_chunks(count, CHUNK, |range| {
        let receivers: Vec<Receiver> = range.clone().map(&receiver).collect();
        let out = bake_chunk(bake, &receivers, options);
        rays.fetch_add(out.rays, Ordering::Relaxed);
        progress.advance(range.len() as u64);
        out
    });
    let mut all = Irradiance { rays: rays.into_inner(), ..Irradiance::default() };
    all.value.reserve_exact(count);
    all.halves.reserve_exact(count);
    all.error.reserve_exact(count);
    for p in parts {
        all.value.extend(p.value);
        all.halves.extend(p.halves);
        all.error.extend(p.error);
    }
    all
}

fn bake_chunk(bake: &Bake, receivers: &[Receiver], options: &IrtOptions) -> Irradiance {
    let n = receivers.len();
    let mut out = Irradiance { value: vec![Vec3::ZERO; n], halves: vec![[Vec3::ZERO; 2]; n], error: vec![0.0; n], rays: 0 };
    let mut pending: Vec<u32> = (0..receivers.len() as u32).collect();
    // running estimates: sums of two independent halves
    let mut sums = vec![[Vec3::ZERO; 2]; receivers.len()];
    let mut bundle = Bundle::default();
    let [mut first_ray, mut first_light] = options.drawn;
    let (mut rays, mut lights) =
        (options.rays.max(2), if options.estimator == Estimator::Mis { options.emitter_samples } else { 0 });
    // a Hammersley set cannot be extended: its points depend on their number
    let max_rounds = if options.estimator == Estimator::Uniform { 1 } else { options.max_rounds.max(1) };
    for n_round in 0..max_rounds {
        if n_round > 0 {
            // sample counts double: what is summed so far counts half
            for &i in &pending {
                sums[i as usize] = sums[i as usize].map(|s| s * 0.5);
            }
        }
        let (total_rays, total_lights) = (first_ray + rays, first_light + lights);
        let round = Round::new(options, [first_ray, total_rays], [first_light, total_lights]);
        for group in pending.chunks(round.group()) {
            let mut of_group = group.iter().map(|&i| receivers[i as usize]);
            out.rays += bundle.run(bake, &round, &mut of_group, |k, halves| {
                let sum = &mut sums[group[k] as usize];
                *sum = [sum[0] + halves[0], sum[1] + halves[1]];
            });
        }
        let last = n_round + 1 == max_rounds;
        pending.retain(|&i| {
            let sum = sums[i as usize];
            out.value[i as usize] = sum[0] + sum[1];
            out.halves[i as usize] = sum.map(|s| s * 2.0);
            let (a, b) = (luminance(sum[0]), luminance(sum[1]));
            let error = if a + b > 0.0 { (a - b).abs() / (a + b) } else { 0.0 };
            out.error[i as usize] = error;
            !last && error > options.target
        });
        if pending.is_empty() {
            break;
        }
        (first_ray, first_light) = (total_rays, total_lights);
        (rays, lights) = (total_rays, total_lights);
    }
    out
}
