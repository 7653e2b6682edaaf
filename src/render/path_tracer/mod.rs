//! Unbiased light transport over any [`crate::core::trace::Tracer`], in batches.
//!
//! A task takes a run of pixels with all their samples, a wavefront of a few thousand paths: all
//! closest hits of one bounce are found by one call, then all shadow rays by another. Light is
//! gathered by next-event estimation and by sampling the BRDF, combined by multiple importance
//! sampling (power heuristic). Numbers are keyed by (pixel, bounce) and sample index, so an image
//! does not depend on the number of threads.
//!
//! Every pixel's light is kept apart as emission, diffuse and specular part of the first hit, with
//! the variance of the last two: what [`super::denoise`] needs to filter irradiance without
//! touching textures or lamps.
//!
//! With [`KnownLight`] the vertices it is for take their diffuse light from an [`IndirectCache`]
//! and only their specular lobe is followed further. That is biased by the cache's resolution and
//! noise, and far cheaper; without it nothing is.

mod film;
mod lights;
mod options;
mod panes;
mod scene;
mod seeing;
mod tracer;
mod transport;
mod wave;

pub use film::Frame;
pub use options::{Adaptive, Noise, PathTracerOptions};
pub use scene::{BlackEnvironment, Environment, IndirectCache, KnownLight, Surface, SurfaceModel};
pub use tracer::PathTracer;

use crate::core::brdf::{DIELECTRIC, Material};
use crate::core::geometry::Camera;
use crate::core::parallel::map_chunks;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::sampling::{SobolSequence, hash_u64};
use crate::core::trace::{Hit, Ray};
use film::{PixelAccumulator, PixelResult, assemble, noisy_pixels};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;
use transport::WAVEFRONT;
use wave::{Following, Lobes, Path, PathKey, Sums, Vertex, Wave};

/// A point whose irradiance is wanted.
#[derive(Clone, Copy, Debug)]
pub struct IrradiancePoint {
    /// Position on the surface.
    pub position: Vec3,
    /// Unit geometric normal on the receiving side.
    pub face_normal: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
}

impl PathTracer<'_> {
    /// Renders a camera; `key` tells views apart. Advances `progress` by the number of pixels.
    #[must_use]
    pub fn render(&self, camera: &Camera, key: u64, progress: &Progress) -> Frame {
        self.render_with(camera, key, KnownLight::default(), progress)
    }

    /// As [`Self::render`]; light that is `known` is not sampled.
    #[must_use]
    pub fn render_with(
        &self,
        camera: &Camera,
        key: u64,
        known: KnownLight<'_>,
        progress: &Progress,
    ) -> Frame {
        let (w, h) = (camera.width, camera.height);
        let samples = self.options.samples.max(1) as usize;
        let all: Vec<usize> = (0..w * h).collect();
        let pixels_per_task = (WAVEFRONT / samples).max(1);
        let tiles = map_chunks(w * h, pixels_per_task, |range| {
            let pixels = &all[range];
            let mut out = self.begin_pixels(camera, pixels);
            self.sample_pixels(
                camera,
                key,
                Following {
                    first: Lobes::Both,
                    known,
                },
                pixels,
                [0, samples as u32],
                &mut out,
            );
            progress.advance(pixels.len() as u64);
            out.iter().map(PixelAccumulator::finish).collect::<Vec<_>>()
        });
        assemble(w, h, &tiles.into_iter().flatten().collect::<Vec<_>>())
    }

    /// Renders a camera in passes: after `first` samples everywhere, each pass doubles the samples
    /// of the blocks whose error is still above the target (those of the specular lobe alone, from
    /// two on, if its noise is watched; where the diffuse light of first hits is known, the first
    /// pass follows no lobe at all). `refined` may look at the image after every pass. The first
    /// pass advances `progress` by the number of pixels.
    pub fn render_adaptive(
        &self,
        camera: &Camera,
        key: u64,
        goal: &Adaptive,
        known: KnownLight<'_>,
        progress: &Progress,
        mut refined: impl FnMut(u32, &dyn Fn() -> Frame) -> crate::Result<()>,
    ) -> crate::Result<Frame> {
        let (w, h) = (camera.width, camera.height);
        let mut pending: Vec<usize> = (0..w * h).collect();
        let (mut states, mut results): (Vec<PixelAccumulator>, Vec<PixelResult>) =
            (Vec::new(), Vec::new());
        let (mut done, mut next) = (0u32, goal.first.max(2));
        for pass in 0.. {
            let first = match goal.noise {
                Noise::Specular if pass > 0 => Lobes::Specular,
                Noise::Specular if known.first.is_some() => Lobes::Neither,
                _ => Lobes::Both,
            };
            let per_task = (WAVEFRONT / (next - done) as usize).max(1);
            let parts = map_chunks(pending.len(), per_task, |range| {
                let pixels = &pending[range];
                let mut out: Vec<PixelAccumulator> = if done == 0 {
                    self.begin_pixels(camera, pixels)
                } else {
                    pixels.iter().map(|&p| states[p].clone()).collect()
                };
                self.sample_pixels(
                    camera,
                    key,
                    Following { first, known },
                    pixels,
                    [done, next],
                    &mut out,
                );
                if done == 0 {
                    progress.advance(pixels.len() as u64);
                }
                out.into_iter()
                    .map(|state| (state.finish(), state))
                    .collect::<Vec<_>>()
            });
            if pending.len() == w * h {
                (results, states) = parts.into_par_iter().flatten_iter().unzip();
            } else {
                for (&p, (result, state)) in pending.iter().zip(parts.into_iter().flatten()) {
                    (results[p], states[p]) = (result, state);
                }
            }
            refined(pass, &|| assemble(w, h, &results))?;
            let more = match goal.noise {
                Noise::Reflected => next,
                // a sample of the lobe alone is worth about ten that seldom follow it
                Noise::Specular => (next - goal.first.max(2)).max(2),
            };
            (done, next) = (next, next.saturating_add(more).min(goal.most));
            if first != Lobes::Neither {
                pending = noisy_pixels([w, h], &results, &pending, goal);
            }
            if next <= done || pending.is_empty() {
                return Ok(assemble(w, h, &results));
            }
        }
        unreachable!("the passes end by return")
    }

    fn begin_pixels(&self, camera: &Camera, pixels: &[usize]) -> Vec<PixelAccumulator> {
        let centre = |p: usize| {
            Vec2::new(
                (p % camera.width) as f32 + 0.5,
                (p / camera.width) as f32 + 0.5,
            )
        };
        // the class at the centre decides which samples count for the filtered materials
        let rays: Vec<Ray> = pixels
            .iter()
            .map(|&p| Ray::new(camera.position, camera.direction(centre(p)), f32::INFINITY))
            .collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        hits.iter()
            .map(|h| PixelAccumulator::new(self.class_at(h)))
            .collect()
    }

    /// Adds the samples `begin..end` of some pixels to their sums.
    fn sample_pixels(
        &self,
        camera: &Camera,
        view_key: u64,
        following: Following<'_>,
        pixels: &[usize],
        [begin, end]: [u32; 2],
        results: &mut [PixelAccumulator],
    ) {
        let mut wave = Wave::default();
        // many samples per pixel are done in several waves of whole pixels
        let per_wave = (end - begin).min(WAVEFRONT as u32).max(1);
        let mut first_sample = begin;
        while first_sample < end {
            let count = per_wave.min(end - first_sample);
            wave.paths.clear();
            wave.rays.clear();
            let mut keys = Vec::with_capacity(pixels.len() * count as usize);
            for &p in pixels {
                let key = hash_u64(hash_u64(self.options.seed, view_key), p as u64);
                let jitter = SobolSequence::new(key, 0);
                for s in first_sample..first_sample + count {
                    let j = jitter.point2(s);
                    let corner = Vec2::new((p % camera.width) as f32, (p / camera.width) as f32);
                    let direction = camera.direction(corner + Vec2::from_array(j));
                    wave.rays
                        .push(Ray::new(camera.position, direction, f32::INFINITY));
                    let slot = keys.len() as u32;
                    keys.push(PathKey { key, sample: s });
                    wave.paths.push(Path {
                        slot,
                        beta: Vec3::ONE,
                        first: [Vec3::ONE; 2],
                        origin: camera.position,
                        normal: Vec3::ZERO,
                        pdf: 0.0,
                    });
                }
            }
            let mut sums = vec![Sums::default(); keys.len()];
            let mut features = vec![None; keys.len()];
            self.trace_wave(
                &mut wave,
                &keys,
                &mut sums,
                Some(&mut features),
                following,
                0,
            );
            for (i, (s, f)) in sums.iter().zip(&features).enumerate() {
                let pixel = &mut results[i / count as usize];
                match following.first {
                    Lobes::Specular => pixel.add_specular(s),
                    Lobes::Neither => pixel.add_known(s, f.as_ref()),
                    Lobes::Both | Lobes::Diffuse if following.known.first.is_some() => {
                        pixel.add_known(s, f.as_ref());
                        pixel.add_specular(s);
                    }
                    Lobes::Both | Lobes::Diffuse => pixel.add(s, f.as_ref()),
                }
            }
            first_sample += count;
        }
    }

    fn class_at(&self, hit: &Hit) -> Option<(u16, Surface)> {
        hit.is_hit().then(|| {
            let t = hit.triangle as usize;
            (
                self.surfaces.label(t),
                self.surfaces.surface(t, hit.u, hit.v),
            )
        })
    }

    /// Irradiance at surface points, `samples` paths each; `key` tells passes apart. Advances
    /// `progress` by the number of points.
    #[must_use]
    pub fn irradiance(
        &self,
        points: &[IrradiancePoint],
        samples: u32,
        key: u64,
        progress: &Progress,
    ) -> Vec<Vec3> {
        self.irradiance_with(points, samples, key, None, progress)
    }

    /// As [`Self::irradiance`]; indirect light comes from `cache` where one is given.
    #[must_use]
    pub fn irradiance_with(
        &self,
        points: &[IrradiancePoint],
        samples: u32,
        key: u64,
        cache: Option<&dyn IndirectCache>,
        progress: &Progress,
    ) -> Vec<Vec3> {
        let samples = samples.clamp(1, WAVEFRONT as u32);
        let per_task = (WAVEFRONT / samples as usize).max(1);
        let parts = map_chunks(points.len(), per_task, |range| {
            let mut wave = Wave::default();
            let mut keys = Vec::new();
            for i in range.clone() {
                let k = hash_u64(hash_u64(self.options.seed, key), i as u64);
                keys.extend((0..samples).map(|sample| PathKey { key: k, sample }));
            }
            let mut sums = vec![Sums::default(); keys.len()];
            for slot in 0..keys.len() {
                let point = &points[range.start + slot / samples as usize];
                let vertex = Vertex {
                    position: point.position,
                    face_normal: point.face_normal,
                    normal: point.normal,
                    view: point.normal,
                    material: Material {
                        albedo: Vec3::ONE,
                        roughness: 1.0,
                    },
                    f0: DIELECTRIC,
                    lobes: Lobes::Diffuse,
                    reference: 0.0,
                };
                let path = Path {
                    slot: slot as u32,
                    beta: Vec3::ONE,
                    first: [Vec3::ONE; 2],
                    origin: point.position,
                    normal: point.normal,
                    pdf: 0.0,
                };
                self.scatter(&vertex, path, keys[slot], 0, &mut wave);
            }
            self.resolve_shadows(&mut wave, &mut sums);
            std::mem::swap(&mut wave.paths, &mut wave.next_paths);
            std::mem::swap(&mut wave.rays, &mut wave.next_rays);
            self.trace_wave(
                &mut wave,
                &keys,
                &mut sums,
                None,
                Following {
                    first: Lobes::Both,
                    known: KnownLight {
                        first: None,
                        later: cache,
                    },
                },
                1,
            );
            progress.advance(range.len() as u64);
            let mean =
                |s: &[Sums]| s.iter().map(|s| s.diffuse).sum::<Vec3>() * (PI / samples as f32);
            sums.chunks(samples as usize)
                .map(mean)
                .collect::<Vec<Vec3>>()
        });
        parts.into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests;
