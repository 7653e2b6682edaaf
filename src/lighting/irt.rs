//! The irradiance texture (IrT): E(x) = ∫ L(x, ω) cosθ dω over the hemisphere of every texel, linear RGB, in the images' exposure.
//!
//! `Uniform` is the paper's estimator: Hammersley points, one random shift per texel (method §3.1). `Mis` combines
//! cosine-distributed rays with samples on emitters by the balance heuristic (Veach & Guibas 1995), both from an Owen-scrambled
//! Sobol' sequence per texel; texels whose two halves disagree are refined.

use super::{Emitters, LightField};
use crate::geometry::Mesh;
use crate::math::Frame;
use crate::parallel;
use crate::progress::Progress;
use crate::sampling::{KeyedRng, SobolSequence, hammersley, square_to_cosine_hemisphere, square_to_uniform_hemisphere};
use crate::trace::{Hit, Ray, Tracer};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::f32::consts::{FRAC_1_PI, PI, TAU};
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

/// Running estimate of one receiver: sums of two independent halves.
#[derive(Clone, Copy, Default)]
struct Halves {
    sum: [Vec3; 2],
}

fn bake_chunk(bake: &Bake, receivers: &[Receiver], options: &IrtOptions) -> Irradiance {
    let n = receivers.len();
    let mut out = Irradiance { value: vec![Vec3::ZERO; n], halves: vec![[Vec3::ZERO; 2]; n], error: vec![0.0; n], rays: 0 };
    let mut pending: Vec<u32> = (0..receivers.len() as u32).collect();
    let mut halves = vec![Halves::default(); receivers.len()];
    let mut scratch = Scratch::default();
    let [mut first_ray, mut first_light] = options.drawn;
    let (mut rays, mut lights) =
        (options.rays.max(2), if options.estimator == Estimator::Mis { options.emitter_samples } else { 0 });
    // a Hammersley set cannot be extended: its points depend on their number
    let max_rounds = if options.estimator == Estimator::Uniform { 1 } else { options.max_rounds.max(1) };
    for round in 0..max_rounds {
        if round > 0 {
            // sample counts double: what is summed so far counts half
            for &i in &pending {
                let h = &mut halves[i as usize];
                h.sum = h.sum.map(|s| s * 0.5);
            }
        }
        let total_rays = first_ray + rays;
        let total_lights = first_light + lights;
        for group in pending.chunks(32) {
            out.rays +=
                scratch.run(bake, receivers, group, options, [first_ray, total_rays], [first_light, total_lights], &mut halves);
        }
        let last = round + 1 == max_rounds;
        pending.retain(|&i| {
            let h = halves[i as usize];
            let e = h.sum[0] + h.sum[1];
            out.value[i as usize] = e;
            out.halves[i as usize] = h.sum.map(|s| s * 2.0);
            let (a, b) = (crate::math::luminance(h.sum[0]), crate::math::luminance(h.sum[1]));
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

/// The half that sample `s` of a round belongs to. Halves of a Sobol' block are nets of their own, so that their difference tells of
/// the whole's error; the halves of a Hammersley set would be half hemispheres, hence a coin per sample there.
fn half_of(s: u32, [begin, end]: [u32; 2], estimator: Estimator) -> u8 {
    match estimator {
        Estimator::Uniform => (s.wrapping_mul(0x9E37_79B9) >> 31) as u8,
        Estimator::Cosine | Estimator::Mis => u8::from(s - begin >= (end - begin) / 2),
    }
}

#[derive(Default)]
struct Scratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// Per ray: cosine at the receiver, receiver, half.
    tags: Vec<(f32, u32, u8)>,
    shadow: Vec<Ray>,
    hidden: Vec<u8>,
    /// Per shadow ray: contribution if unoccluded, receiver, half.
    pending: Vec<(Vec3, u32, u8)>,
}

impl Scratch {
    /// Traces the samples `rays` and `lights` of every receiver in `group`; returns the number of rays.
    #[allow(clippy::too_many_arguments)] // buffers apart from what they are filled with
    fn run(
        &mut self,
        bake: &Bake,
        receivers: &[Receiver],
        group: &[u32],
        options: &IrtOptions,
        rays: [u32; 2],
        lights: [u32; 2],
        halves: &mut [Halves],
    ) -> u64 {
        self.rays.clear();
        self.tags.clear();
        self.shadow.clear();
        self.pending.clear();
        for &i in group {
            self.hemisphere_rays(bake, &receivers[i as usize], i, options, rays);
            self.emitter_rays(bake, &receivers[i as usize], i, options, rays[1], lights);
        }
        self.hits.resize(self.rays.len(), Hit::miss());
        bake.tracer.closest(&self.rays, &mut self.hits);
        self.hidden.resize(self.shadow.len(), 0);
        bake.tracer.occluded(&self.shadow, &mut self.hidden);
        self.gather_hemisphere(bake, receivers, options, rays[1], lights[1], halves);
        for (k, (value, i, half)) in self.pending.iter().enumerate() {
            if self.hidden[k] == 0 {
                halves[*i as usize].sum[*half as usize] += *value;
            }
        }
        (self.rays.len() + self.shadow.len()) as u64
    }

    fn hemisphere_rays(&mut self, bake: &Bake, r: &Receiver, i: u32, options: &IrtOptions, [begin, end]: [u32; 2]) {
        let frame = Frame::from_normal(r.normal);
        let origin = r.position + r.face_normal * bake.offset;
        let sequence = SobolSequence::new(options.seed, r.key);
        let mut rng = KeyedRng::new(options.seed, r.key);
        let shift = [rng.next_f32(), rng.next_f32()];
        for s in begin..end {
            let local = match options.estimator {
                Estimator::Uniform => {
                    let h = hammersley(s, end);
                    square_to_uniform_hemisphere([(h[0] + shift[0]).fract(), (h[1] + shift[1]).fract()])
                }
                Estimator::Cosine | Estimator::Mis => square_to_cosine_hemisphere(sequence.point2(s)),
            };
            let direction = frame.world_from_local(local);
            // below the true surface the surface itself blocks the light
            if r.face_normal.dot(direction) <= 0.0 || local.z <= 0.0 {
                continue;
            }
            self.rays.push(Ray::new(origin, direction, f32::INFINITY));
            self.tags.push((local.z, i, half_of(s, [begin, end], options.estimator)));
        }
    }

    fn emitter_rays(&mut self, bake: &Bake, r: &Receiver, i: u32, options: &IrtOptions, n_rays: u32, [begin, end]: [u32; 2]) {
        let Some(choice) = bake.emitters.choice_at(r.position).filter(|_| end > begin) else { return };
        let origin = r.position + r.face_normal * bake.offset;
        let sequence = SobolSequence::new(options.seed ^ 0x5eed_1a3b, r.key);
        for s in begin..end {
            let Some(e) = bake.emitters.sample(bake.mesh, bake.field, choice, origin, sequence.point3(s)) else { continue };
            let w = Vec3::from_array(e.ray.direction);
            let cosine = r.normal.dot(w);
            if !(cosine > 0.0 && r.face_normal.dot(w) > 0.0) {
                continue;
            }
            // balance heuristic with n_e light samples and n_r rays
            let value = e.radiance * (cosine / (end as f32 * e.pdf + n_rays as f32 * cosine * FRAC_1_PI));
            self.shadow.push(e.ray);
            self.pending.push((value, i, half_of(s, [begin, end], options.estimator)));
        }
    }

    fn gather_hemisphere(
        &self,
        bake: &Bake,
        receivers: &[Receiver],
        options: &IrtOptions,
        n_rays: u32,
        n_lights: u32,
        halves: &mut [Halves],
    ) {
        // diameter per metre of the cone one ray stands for
        let spread = 2.0 * (1.0 / n_rays as f32).sqrt();
        let mut current = (u32::MAX, None);
        for (k, hit) in self.hits.iter().enumerate() {
            let (cosine, i, half) = self.tags[k];
            let direction = Vec3::from_array(self.rays[k].direction);
            let l = bake.field.arriving(hit, direction, if options.estimator == Estimator::Uniform { 0.0 } else { spread });
            let weight = match options.estimator {
                Estimator::Uniform => TAU * cosine / n_rays as f32,
                Estimator::Cosine => PI / n_rays as f32,
                Estimator::Mis => {
                    let pdf_ray = cosine * FRAC_1_PI;
                    let mut pdf_light = 0.0;
                    if n_lights > 0 {
                        if current.0 != i {
                            current = (i, bake.emitters.choice_at(receivers[i as usize].position));
                        }
                        if let Some(choice) = current.1 {
                            let origin = Vec3::from_array(self.rays[k].origin);
                            pdf_light = bake.emitters.pdf(bake.field, choice, origin, direction, hit);
                        }
                    }
                    cosine / (n_rays as f32 * pdf_ray + n_lights as f32 * pdf_light)
                }
            };
            halves[i as usize].sum[half as usize] += l * weight;
        }
    }
}
