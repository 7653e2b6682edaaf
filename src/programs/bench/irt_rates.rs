//! Rays per second of each estimator, end to end, beside a bare Embree loop over the very same
//! rays.
//!
//! A tracer that remembers what it is asked collects the rays of a bake of some runs of texels; the
//! bare C++ loops then trace the same rays in the same batches on the same threads. The ratio says
//! what ray generation, texture lookups and accumulation cost.

use super::{BenchScene, interleaved};
use crate::core::formats::atomic_write;
use crate::core::geometry::Mesh;
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::core::trace::{BATCH, EmbreeTracer, Hit, Ray, Tracer};
use crate::error::{Error, Result};
use crate::irradiance::{Estimator, IrradianceOptions};
use rayon::prelude::*;
use serde::Serialize;
use std::hint::black_box;
use std::path::Path;
use std::sync::Mutex;

/// One estimator against the bare loop.
#[derive(Clone, Debug, Serialize)]
pub struct EstimatorRate {
    /// What was run.
    pub name: String,
    /// Closest-hit rays of the sample.
    pub closest_rays: usize,
    /// Occlusion rays of the sample.
    pub occlusion_rays: usize,
    /// Seconds of the estimator, median.
    pub seconds: f64,
    /// Seconds of the bare loops over the same rays, median.
    pub bare_seconds: f64,
    /// Rays per second end to end.
    pub rays_per_second: f64,
    /// Rays per second as a share of the bare loop's.
    pub bare_ratio: f64,
}

/// The batch queries alone against the bare loop, without generating or using rays.
#[derive(Clone, Debug, Serialize)]
pub struct BatchRate {
    /// Query.
    pub name: String,
    /// Rays.
    pub rays: usize,
    /// Rays per second through the batch interface.
    pub rays_per_second: f64,
    /// Rays per second of the bare loop.
    pub bare_rays_per_second: f64,
    /// Their ratio.
    pub bare_ratio: f64,
}

/// Everything about rays per second.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Rates {
    /// Estimators end to end.
    pub estimators: Vec<EstimatorRate>,
    /// Batch queries alone.
    pub batches: Vec<BatchRate>,
    /// Cosine estimator's ratio: closest hits end to end.
    pub closest: f64,
    /// Ratio of a bake by emitter samples (two hemisphere rays per texel beside them); absent
    /// without emitters.
    pub occlusion: Option<f64>,
    /// Texels of the sample.
    pub texels: usize,
    /// Repetitions of each measurement.
    pub repetitions: usize,
}

/// Passes queries on and keeps their rays.
struct Recording<'a> {
    inner: &'a EmbreeTracer,
    closest: Mutex<Vec<Ray>>,
    occluded: Mutex<Vec<Ray>>,
}

impl Tracer for Recording<'_> {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        keep(&self.closest, rays);
        self.inner.closest(rays, hits);
    }

    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]) {
        keep(&self.occluded, rays);
        self.inner.occluded(rays, occluded);
    }
}

fn keep(into: &Mutex<Vec<Ray>>, rays: &[Ray]) {
    into.lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
        .extend_from_slice(rays);
}

fn taken(rays: Mutex<Vec<Ray>>) -> Vec<Ray> {
    let mut rays = rays
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    // the bare loop asks for finite rays
    rays.retain(Ray::is_usable);
    rays
}

/// The rays that a bake of `ids` traces: closest hits and occlusion.
pub(super) fn rays_of(
    ground: &BenchScene,
    texels: &Texels,
    ids: &[usize],
    options: &IrradianceOptions,
) -> (Vec<Ray>, Vec<Ray>) {
    let recording = Recording {
        inner: &ground.surface.tracer,
        closest: Mutex::default(),
        occluded: Mutex::default(),
    };
    let receiver = |k: usize| ground.surface.receiver(texels, ids[k]);
    let _ = crate::irradiance::bake_irradiance(
        &ground.bake(&recording),
        ids.len(),
        receiver,
        options,
        &Progress::silent(),
    );
    (taken(recording.closest), taken(recording.occluded))
}

/// The bare loops on all threads, in the batches of the tracer.
pub(super) fn bare_closest(tracer: &EmbreeTracer, rays: &[Ray]) -> usize {
    rays.par_chunks(BATCH)
        .with_max_len(1)
        .map(|r| tracer.scene().bare_closest(r))
        .sum()
}

fn bare_occluded(tracer: &EmbreeTracer, rays: &[Ray]) -> usize {
    rays.par_chunks(BATCH)
        .with_max_len(1)
        .map(|r| tracer.scene().bare_occluded(r))
        .sum()
}

/// Places of the cosine estimator and of emitter samples alone among the [`candidates`].
const COSINE: usize = 1;
const EMITTERS: usize = 3;

/// What is compared: the three estimators, the pipeline's mixture, and emitter samples (almost)
/// alone.
fn candidates(ground: &BenchScene) -> Vec<(String, IrradianceOptions)> {
    let base = IrradianceOptions {
        seed: ground.options.seed,
        ..IrradianceOptions::default()
    };
    let o = &ground.options;
    let mut all = vec![
        (
            "uniform, 512 rays".to_owned(),
            IrradianceOptions {
                estimator: Estimator::Uniform,
                rays: 512,
                emitter_samples: 0,
                ..base.clone()
            },
        ),
        (
            "cosine, 512 rays".to_owned(),
            IrradianceOptions {
                estimator: Estimator::Cosine,
                rays: 512,
                emitter_samples: 0,
                ..base.clone()
            },
        ),
        (
            format!("mis, {} + {} rays", o.irradiance_rays, o.emitter_samples),
            IrradianceOptions {
                rays: o.irradiance_rays,
                emitter_samples: o.emitter_samples,
                ..base.clone()
            },
        ),
    ];
    if !ground.light.emitters.is_empty() {
        all.push((
            "emitters, 2 + 512 rays".to_owned(),
            IrradianceOptions {
                rays: 2,
                emitter_samples: 512,
                ..base
            },
        ));
    }
    all
}

/// Median seconds of one candidate's tasks.
struct Seconds {
    /// The estimator, end to end.
    estimator: f64,
    /// Bare loops over its closest-hit and its occlusion rays.
    bare_closest: f64,
    bare_occluded: f64,
    /// Batch queries of the same.
    closest: f64,
    occluded: f64,
    /// The closest-hit rays asked for any hit, by batch query and bare loop: what other programs can
    /// be compared with.
    any_hit: f64,
    bare_any_hit: f64,
}

/// A candidate's run on a sample of texels.
struct Race {
    /// Texels of the sample.
    texels: usize,
    closest: Vec<Ray>,
    occluded: Vec<Ray>,
    seconds: Seconds,
}

impl Race {
    /// Runs a candidate on runs of texels holding about `rays` rays.
    fn run(
        ground: &BenchScene,
        options: &IrradianceOptions,
        rays: usize,
        repetitions: usize,
    ) -> Self {
        let (texels, tracer) = (&ground.light.texels, &ground.surface.tracer);
        let emitter_samples = if options.estimator == Estimator::Mis {
            options.emitter_samples
        } else {
            0
        };
        let ids = ground.runs(texels, rays / (options.rays + emitter_samples) as usize);
        let (closest, occluded) = rays_of(ground, texels, &ids, options);
        let mut flags = vec![0u8; occluded.len()];
        let mut hits = vec![Hit::miss(); closest.len()];
        let mut hidden = vec![0u8; closest.len()];
        let mut tasks: Vec<Box<dyn FnMut()>> = vec![
            Box::new(|| {
                black_box(
                    ground
                        .bake_some(texels, &ids, options, &Progress::silent())
                        .rays,
                );
            }),
            Box::new(|| {
                black_box(bare_closest(tracer, &closest));
            }),
            Box::new(|| {
                black_box(bare_occluded(tracer, &occluded));
            }),
            Box::new(|| tracer.closest(&closest, &mut hits)),
            Box::new(|| tracer.occluded(&occluded, &mut flags)),
            Box::new(|| tracer.occluded(&closest, &mut hidden)),
            Box::new(|| {
                black_box(bare_occluded(tracer, &closest));
            }),
        ];
        let seconds = interleaved(repetitions, &mut tasks);
        drop(tasks);
        Self {
            texels: ids.len(),
            seconds: Seconds {
                estimator: seconds[0],
                bare_closest: seconds[1],
                bare_occluded: if occluded.is_empty() { 0.0 } else { seconds[2] },
                closest: seconds[3],
                occluded: seconds[4],
                any_hit: seconds[5],
                bare_any_hit: seconds[6],
            },
            closest,
            occluded,
        }
    }

    /// The estimator end to end against the bare loops.
    fn estimator(&self, name: &str) -> EstimatorRate {
        let s = &self.seconds;
        let bare = s.bare_closest + s.bare_occluded;
        EstimatorRate {
            name: name.to_owned(),
            closest_rays: self.closest.len(),
            occlusion_rays: self.occluded.len(),
            seconds: s.estimator,
            bare_seconds: bare,
            rays_per_second: (self.closest.len() + self.occluded.len()) as f64 / s.estimator,
            bare_ratio: bare / s.estimator,
        }
    }

    /// The batch queries of its closest-hit rays.
    fn closest_batches(&self) -> [BatchRate; 2] {
        let (s, rays) = (&self.seconds, self.closest.len());
        [
            BatchRate::new("closest hit", rays, s.closest, s.bare_closest),
            BatchRate::new("any hit, same rays", rays, s.any_hit, s.bare_any_hit),
        ]
    }

    /// The batch query of its occlusion rays.
    fn occlusion_batch(&self) -> BatchRate {
        let (s, rays) = (&self.seconds, self.occluded.len());
        BatchRate::new("occlusion", rays, s.occluded, s.bare_occluded)
    }
}

impl BatchRate {
    /// From the seconds of the batch query and of the bare loop.
    fn new(name: &str, rays: usize, ours: f64, bare: f64) -> Self {
        Self {
            name: name.to_owned(),
            rays,
            rays_per_second: rays as f64 / ours,
            bare_rays_per_second: rays as f64 / bare,
            bare_ratio: bare / ours,
        }
    }
}

/// Measures every candidate on runs of texels holding about `rays` rays each.
///
/// # Errors
/// Rays that cannot be written.
pub(super) fn measure(
    ground: &BenchScene,
    rays: usize,
    repetitions: usize,
    export: Option<&Path>,
    progress: &Progress,
) -> Result<Rates> {
    let mut out = Rates {
        repetitions,
        ..Rates::default()
    };
    for (k, (name, options)) in candidates(ground).iter().enumerate() {
        let race = Race::run(ground, options, rays, repetitions);
        let estimator = race.estimator(name);
        match k {
            COSINE => {
                out.closest = estimator.bare_ratio;
                out.texels = race.texels;
                out.batches.extend(race.closest_batches());
                if let Some(folder) = export {
                    export_rays(folder, &ground.surface.scene.mesh, &race.closest)?;
                }
            }
            EMITTERS => {
                out.occlusion = Some(estimator.bare_ratio);
                out.batches.push(race.occlusion_batch());
            }
            _ => {}
        }
        out.estimators.push(estimator);
        progress.advance(1);
    }
    Ok(out)
}

/// Writes the mesh and rays as raw little-endian arrays for other programs: `positions.f32` (n ×
/// 3), `triangles.u32` (n × 3) and `rays.f32` (n × 6: origin, direction).
fn export_rays(folder: &Path, mesh: &Mesh, rays: &[Ray]) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    let flat: Vec<[f32; 6]> = rays
        .iter()
        .map(|r| {
            std::array::from_fn(|i| {
                if i < 3 {
                    r.origin[i]
                } else {
                    r.direction[i - 3]
                }
            })
        })
        .collect();
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    atomic_write(
        folder.join("positions.f32"),
        bytemuck::cast_slice(&positions),
    )?;
    atomic_write(
        folder.join("triangles.u32"),
        bytemuck::cast_slice(&mesh.triangles),
    )?;
    atomic_write(folder.join("rays.f32"), bytemuck::cast_slice(&flat))
}
