//! The rays of a group of receivers: drawn, traced and summed in batches.
//!
//! Whatever all receivers share (unscrambled sample points) is computed once per round, whatever is
//! the same for every ray of one receiver runs in vector registers, and a ray costs no allocation,
//! no library call and few branches.

use super::estimate::{Bake, Estimator, IrradianceOptions, Receiver, SUB_ESTIMATES};
use super::hilbert_order::HilbertOrder;
use super::next_bounce::Bounces;
use crate::core::math::Frame;
use crate::core::sampling::{
    KeyedRng, SobolBlock, SobolSequence, hammersley, square_to_cosine_hemisphere,
    square_to_uniform_hemisphere,
};
use crate::core::trace::{BATCH, Hit, Ray};
use crate::ffi::simd::{Kernel, floor_to_index, run_widest};
use crate::lights::LitScene;
use crate::lights::PORTAL;
use crate::lights::SamplerCache;
use crate::lights::{LightPicks, ShadowSample, ShadowSampler};
use glam::Vec3;
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::ops::Range;

/// Emitter samples of a receiver from which a table of the lamps at its numbers pays: size of work.
const GUIDED: usize = 24;
/// How many rays before its turn the memory is asked for what a hit needs: size of work.
const AHEAD: usize = 24;

/// What one round of samples has in common for all receivers.
pub(crate) struct SamplePass {
    estimator: Estimator,
    seed: u64,
    /// Samples per receiver up to the end of this round: what weights divide by.
    total_rays: u32,
    total_lights: u32,
    hemisphere: Points,
    /// The part that each hemisphere sample belongs to.
    part: Vec<u8>,
    sweep: HilbertOrder,
    lights: SobolBlock,
    /// Intervals of [0, 1), of which no two samples of this round share one in the first dimension.
    slots: usize,
}

/// Points of the unit square, part by part.
enum Points {
    /// Coordinates before the receiver's shift, and where each part ends.
    Hammersley([Vec<f32>; 2], [usize; SUB_ESTIMATES]),
    /// Scrambled per receiver. Parts of a block are nets of their own, so that their differences
    /// tell of the whole's error.
    Sobol(SobolBlock),
}

impl Points {
    /// The paper's points. Their parts in order would be parts of the hemisphere, hence a die per
    /// sample.
    fn hammersley(n: u32) -> Self {
        let part = |s: u32| (u64::from(s.wrapping_mul(0x9E37_79B9)) * SUB_ESTIMATES as u64) >> 32;
        let mut all: Vec<u32> = (0..n).collect();
        all.sort_by_key(|s| part(*s));
        let ends = std::array::from_fn(|p| all.partition_point(|s| part(*s) <= p as u64));
        Self::Hammersley(
            [0, 1].map(|d| all.iter().map(|&s| hammersley(s, n)[d]).collect()),
            ends,
        )
    }

    fn len(&self) -> usize {
        match self {
            Self::Hammersley(points, _) => points[0].len(),
            Self::Sobol(block) => block.len(),
        }
    }

    /// The part that each point belongs to.
    fn parts(&self) -> Vec<u8> {
        let ends: [usize; SUB_ESTIMATES] = match self {
            Self::Hammersley(_, ends) => *ends,
            Self::Sobol(block) => std::array::from_fn(|p| block.len() * (p + 1) / SUB_ESTIMATES),
        };
        (0..self.len())
            .map(|k| ends.partition_point(|end| *end <= k) as u8)
            .collect()
    }
}

impl SamplePass {
    /// The hemisphere rays and emitter samples given by index ranges.
    pub(crate) fn new(
        options: &IrradianceOptions,
        [first_ray, rays]: [u32; 2],
        [first_light, lights]: [u32; 2],
    ) -> Self {
        let hemisphere = match options.estimator {
            Estimator::Uniform => Points::hammersley(rays),
            Estimator::Cosine | Estimator::Mis => Points::Sobol(SobolBlock::new(first_ray, rays)),
        };
        Self {
            estimator: options.estimator,
            seed: options.seed,
            total_rays: rays,
            total_lights: lights,
            part: hemisphere.parts(),
            sweep: HilbertOrder::new(hemisphere.len()),
            hemisphere,
            lights: SobolBlock::new(first_light, lights),
            slots: (lights as usize).next_power_of_two(),
        }
    }

    /// Whether lamps are drawn by a table ([`LightSampler::guide`](super::LampChoice::guide)).
    fn is_guided(&self) -> bool {
        self.lights.len() >= GUIDED
    }

    /// Receivers per batch of rays, about as many as the tracer takes at once.
    pub(crate) fn group(&self) -> usize {
        (BATCH / (self.hemisphere.len() + self.lights.len()).max(1)).clamp(1, 64)
    }
}

/// Buffers of one thread's batches.
#[derive(Default)]
pub(crate) struct RayBatch {
    spans: Vec<Span>,
    /// Which lamps receivers ask.
    choices: SamplerCache,
    rays: Vec<Ray>,
    cosines: Vec<f32>,
    /// Per hemisphere ray: index into the sums.
    owners: Vec<u32>,
    hits: Vec<Hit>,
    shadow: Vec<Ray>,
    hidden: Vec<u8>,
    /// Of the last choice: the first lamp of each interval of numbers.
    guide: Vec<u32>,
    /// Emitter samples of one receiver.
    picks: LightPicks,
    /// Per shadow ray.
    aimed: Vec<ShadowSample>,
    /// Per hemisphere ray: where its radiance is stored, and its weight.
    terms: Vec<(u32, f32)>,
    /// Numbers of the shadow rays that arrive at a surface.
    arrived: Vec<u32>,
    /// Rays that leave the scene, and their directions.
    outside: Vec<u32>,
    sky: [Vec<f32>; 3],
    /// Per sample of one receiver: coordinates, directions, cosines.
    columns: [Vec<f32>; 7],
    order: Vec<u32>,
    bounces: Bounces,
    /// Per receiver and part.
    sums: Vec<Vec3>,
}

/// One receiver's part of a batch.
struct Span {
    /// Its choice of lamps, if it samples any.
    choice: Option<usize>,
    /// Where its hemisphere rays lie.
    rays: Range<usize>,
}

impl RayBatch {
    /// Traces one round of samples of every receiver; `add(k, parts)` takes the contributions of
    /// the k-th. Returns the rays traced.
    pub(crate) fn run(
        &mut self,
        bake: &Bake,
        round: &SamplePass,
        receivers: impl ExactSizeIterator<Item = Receiver>,
        mut add: impl FnMut(usize, [Vec3; SUB_ESTIMATES]),
    ) -> u64 {
        let (lit, n) = (&bake.lit, receivers.len());
        self.reserve(n * round.hemisphere.len(), n * round.lights.len(), round);
        self.spans.clear();
        self.choices.clear();
        let (mut rays, mut lights) = (0, 0);
        for r in receivers {
            let drawn = self.draw_hemisphere(lit, round, &r, rays);
            rays = drawn.end;
            let choice = if round.lights.is_empty() {
                None
            } else {
                self.choose(lit, round, &r)
            };
            if let Some(choice) = choice {
                lights = self.draw_lights(lit, round, &r, choice, lights);
            }
            self.spans.push(Span {
                choice,
                rays: drawn,
            });
        }
        lit.tracer
            .closest(&self.rays[..rays], &mut self.hits[..rays]);
        lit.tracer
            .occluded(&self.shadow[..lights], &mut self.hidden[..lights]);
        self.sums.clear();
        self.sums.resize(SUB_ESTIMATES * n, Vec3::ZERO);
        self.gather_surfaces(lit, round, rays);
        let bounced = self.gather_bounces(bake, rays);
        self.gather_lights(lit, lights);
        for (k, parts) in self.sums.as_chunks::<SUB_ESTIMATES>().0.iter().enumerate() {
            add(k, *parts);
        }
        (rays + lights) as u64 + bounced
    }

    fn reserve(&mut self, rays: usize, lights: usize, round: &SamplePass) {
        let nowhere = Ray::new(Vec3::ZERO, Vec3::Z, 0.0);
        grow(&mut self.rays, rays, nowhere);
        grow(&mut self.cosines, rays, 0.0);
        grow(&mut self.owners, rays, 0);
        grow(&mut self.hits, rays, Hit::miss());
        grow(&mut self.terms, rays, (0, 0.0));
        grow(&mut self.shadow, lights, nowhere);
        grow(&mut self.hidden, lights, 0);
        grow(&mut self.aimed, lights, ShadowSample::default());
        grow(&mut self.arrived, lights, 0);
        grow(&mut self.outside, rays.max(lights), 0);
        self.sky
            .iter_mut()
            .for_each(|c| grow(c, rays.max(lights), 0.0));
        self.columns
            .iter_mut()
            .for_each(|c| grow(c, round.hemisphere.len().max(round.lights.len()), 0.0));
    }

    /// Writes the hemisphere rays of the next receiver from index `at` on, neighbours in direction
    /// side by side; returns where they lie.
    fn draw_hemisphere(
        &mut self,
        lit: &LitScene,
        round: &SamplePass,
        r: &Receiver,
        at: usize,
    ) -> Range<usize> {
        let n = round.hemisphere.len();
        let columns = self.columns.each_mut().map(|c| &mut c[..n]);
        run_widest(Directions {
            points: &round.hemisphere,
            seed: round.seed,
            receiver: r,
            columns,
        });
        let [u, v, x, y, z, cosine, facing] = self.columns.each_ref().map(|c| &c[..n]);
        let origin = r.position + r.face_normal * lit.offset;
        let first = (SUB_ESTIMATES * self.spans.len()) as u32;
        let (rays, cosines, owners) = (
            &mut self.rays[at..at + n],
            &mut self.cosines[at..at + n],
            &mut self.owners[at..at + n],
        );
        let mut kept = 0;
        round.sweep.order([u, v], &mut self.order);
        for k in self.order[..n].iter().map(|k| *k as usize) {
            rays[kept] = Ray::new(origin, Vec3::new(x[k], y[k], z[k]), f32::INFINITY);
            cosines[kept] = cosine[k];
            owners[kept] = first + u32::from(round.part[k]);
            // below the true surface the surface itself blocks the light
            kept += usize::from((facing[k] > 0.0) & (cosine[k] > 0.0));
        }
        at..at + kept
    }

    /// Finds which lamps the next receiver asks. `None` if none can send it light.
    fn choose(&mut self, lit: &LitScene, round: &SamplePass, r: &Receiver) -> Option<usize> {
        let rays_per_sample = round.total_rays as f32 / round.total_lights.max(1) as f32;
        let known = self.choices.len();
        let number = self
            .choices
            .choose(lit.emitters, r.position, r.normal, rays_per_sample);
        let choice = &self.choices[number];
        if number == known && round.is_guided() && !choice.is_empty() {
            choice.guide(round.slots, &mut self.guide);
        }
        (!choice.is_empty()).then_some(number)
    }

    /// Writes the shadow rays of the next receiver from index `at` on, in the order of the lamps:
    /// neighbours in a packet then go the same way. Returns where they end.
    fn draw_lights(
        &mut self,
        lit: &LitScene,
        round: &SamplePass,
        r: &Receiver,
        choice: usize,
        at: usize,
    ) -> usize {
        let n = round.lights.len();
        let [u, v, w, ..] = self.columns.each_mut().map(|c| &mut c[..n]);
        let sequence = SobolSequence::new(round.seed ^ 0x5eed_1a3b, r.key);
        run_widest(Coordinates {
            block: &round.lights,
            sequence,
            columns: [&mut *u, &mut *v, &mut *w],
        });
        self.order.clear();
        self.order.resize(round.slots, u32::MAX);
        let slots = round.slots as f32;
        for (s, u) in u.iter().enumerate() {
            self.order[floor_to_index(u * slots, slots - 1.0) as usize] = s as u32;
        }
        let first = (SUB_ESTIMATES * self.spans.len()) as u32;
        let picks = &mut self.picks;
        picks.reserve(n);
        let choice = &self.choices[choice];
        let guided = round.is_guided();
        let mut k = 0;
        for (interval, &s) in self.order.iter().enumerate() {
            // (an interval may have no sample)
            let s = s as usize;
            if s < n {
                let (slot, probability) =
                    lit.emitters
                        .pick(choice, guided.then(|| self.guide[interval]), u[s]);
                picks.source[k] = slot;
                picks.probability[k] = probability;
                picks.place[0][k] = v[s];
                picks.place[1][k] = w[s];
                picks.owner[k] = first + (s * SUB_ESTIMATES / n) as u32;
                k += 1;
            }
        }
        picks.source[..n]
            .iter_mut()
            .for_each(|s| *s = lit.emitters.source_in(*s));
        at + run_widest(ShadowSampler {
            sources: lit.emitters.sources(),
            field: lit.field,
            picks,
            count: n,
            origin: r.position + r.face_normal * lit.offset,
            normal: r.normal,
            face_normal: r.face_normal,
            samples: round.total_lights as f32,
            rays: round.total_rays as f32,
            shadow: &mut self.shadow[at..at + n],
            aimed: &mut self.aimed[at..at + n],
        })
    }

    /// Adds what the first `count` hemisphere rays meet.
    fn gather_surfaces(&mut self, lit: &LitScene, round: &SamplePass, count: usize) {
        let (n, lights) = (round.total_rays as f32, round.total_lights as f32);
        let mut outside = 0;
        let mixed = round.estimator == Estimator::Mis && lights > 0.0;
        let expect = |hit: &Hit| {
            lit.field.prefetch_triangle(hit.triangle);
            if mixed {
                lit.emitters.prefetch_hit(hit.triangle);
            }
        };
        self.hits.iter().take(AHEAD).for_each(expect);
        for span in &self.spans {
            let choice = span.choice.filter(|_| mixed).map(|c| &self.choices[c]);
            for k in span.rays.clone() {
                if let Some(later) = self.hits.get(k + AHEAD) {
                    expect(later);
                }
                let (hit, cosine) = (&self.hits[k], self.cosines[k]);
                // a single texel: the mean over the ray's cone mixes charts and gains nothing
                // beside this many rays (docs/lab/irradiance.md)
                let (address, facing) =
                    lit.field
                        .address(hit, Vec3::from_array(self.rays[k].direction), 0.0);
                lit.field.prefetch_texel(address);
                let weight = match choice {
                    Some(choice) => {
                        cosine
                            / (n * (cosine * FRAC_1_PI)
                                + lights * lit.emitters.hit_pdf(choice, hit, facing))
                    }
                    None if round.estimator == Estimator::Uniform => TAU * cosine / n,
                    None => PI / n,
                };
                self.terms[k] = (address, weight);
                self.outside[outside] = k as u32;
                outside += usize::from(!hit.is_hit());
            }
        }
        for (&(address, weight), owner) in self.terms[..count].iter().zip(&self.owners) {
            self.sums[*owner as usize] += lit.field.texel(address) * weight;
        }
        self.look_outside(outside, |b, k| &b.rays[k]);
        let [x, y, z] = self.sky.each_mut().map(|c| &mut c[..outside]);
        lit.field.environment.radiances([x, y, z], |i, radiance| {
            let k = self.outside[i] as usize;
            let owner = self.owners[k] as usize;
            let weight = match (round.estimator, &self.spans[owner / SUB_ESTIMATES]) {
                (
                    Estimator::Mis,
                    Span {
                        choice: Some(choice),
                        ..
                    },
                ) => {
                    let ray = &self.rays[k];
                    let (origin, direction) = (
                        Vec3::from_array(ray.origin),
                        Vec3::from_array(ray.direction),
                    );
                    let pdf = lit
                        .emitters
                        .miss_pdf(&self.choices[*choice], origin, direction);
                    self.cosines[k] / (n * (self.cosines[k] * FRAC_1_PI) + lights * pdf)
                }
                _ => self.terms[k].1,
            };
            self.sums[owner] += radiance * weight;
        });
    }

    /// Adds what the next bounce brings along the first `count` hemisphere rays; returns the rays
    /// traced.
    fn gather_bounces(&mut self, bake: &Bake, count: usize) -> u64 {
        let Some(bounce) = bake.bounce else { return 0 };
        let Self {
            rays,
            hits,
            bounces,
            sums,
            owners,
            terms,
            ..
        } = self;
        bounce.follow(&rays[..count], &hits[..count], bounces, |k, radiance| {
            sums[owners[k] as usize] += radiance * terms[k].1
        })
    }

    /// Adds what arrives from emitters along the first `count` shadow rays.
    fn gather_lights(&mut self, lit: &LitScene, count: usize) {
        let (mut arrived, mut outside) = (0, 0);
        for l in 0..count {
            let (free, portal) = (self.hidden[l] == 0, self.aimed[l].address == PORTAL);
            self.arrived[arrived] = l as u32;
            self.outside[outside] = l as u32;
            arrived += usize::from(free & !portal);
            outside += usize::from(free & portal);
        }
        let arrived = self.arrived[..arrived]
            .iter()
            .map(|l| &self.aimed[*l as usize]);
        arrived
            .clone()
            .for_each(|aimed| lit.field.prefetch_texel(aimed.address));
        for aimed in arrived {
            self.sums[aimed.owner as usize] += lit.field.texel(aimed.address) * aimed.weight;
        }
        self.look_outside(outside, |b, k| &b.shadow[k]);
        let [x, y, z] = self.sky.each_mut().map(|c| &mut c[..outside]);
        lit.field.environment.radiances([x, y, z], |i, radiance| {
            let aimed = &self.aimed[self.outside[i] as usize];
            self.sums[aimed.owner as usize] += radiance * aimed.weight;
        });
    }

    /// Writes the directions of the first `count` rays that leave the scene.
    fn look_outside(&mut self, count: usize, ray: impl Fn(&Self, usize) -> &Ray) {
        for i in 0..count {
            let d = ray(self, self.outside[i] as usize).direction;
            for (column, x) in self.sky.iter_mut().zip(d) {
                column[i] = x;
            }
        }
    }
}

/// The hemisphere samples of a receiver: coordinates in the unit square, world directions, and
/// their cosines to the shading normal and to the face, a column each.
struct Directions<'a> {
    points: &'a Points,
    seed: u64,
    receiver: &'a Receiver,
    columns: [&'a mut [f32]; 7],
}

impl Kernel for Directions<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            points,
            seed,
            receiver: r,
            columns: [u, v, x, y, z, cosine, facing],
        } = self;
        let (frame, out) = (Frame::from_normal(r.normal), [x, y, z, cosine, facing]);
        match points {
            Points::Sobol(block) => {
                let sequence = SobolSequence::new(seed, r.key);
                block.fill(&sequence, 0, u);
                block.fill(&sequence, 1, v);
                directions(
                    &frame,
                    r.face_normal,
                    square_to_cosine_hemisphere,
                    [u, v],
                    out,
                );
            }
            Points::Hammersley(points, _) => {
                let mut rng = KeyedRng::new(seed, r.key);
                for (out, points) in [&mut *u, &mut *v].into_iter().zip(points) {
                    let shift = rng.next_f32();
                    for (o, p) in out.iter_mut().zip(points) {
                        let x = p + shift;
                        *o = if x >= 1.0 { x - 1.0 } else { x };
                    }
                }
                directions(
                    &frame,
                    r.face_normal,
                    square_to_uniform_hemisphere,
                    [u, v],
                    out,
                );
            }
        }
    }
}

/// A block's points under a sequence's scrambling, a column per dimension.
struct Coordinates<'a> {
    block: &'a SobolBlock,
    sequence: SobolSequence,
    columns: [&'a mut [f32]; 3],
}

impl Kernel for Coordinates<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            block,
            sequence,
            columns: [u, v, w],
        } = self;
        block.fill(&sequence, 0, u);
        block.fill(&sequence, 1, v);
        block.fill(&sequence, 2, w);
    }
}

/// World directions of points of the unit square under a warp around a frame's normal, with their
/// cosines.
#[inline(always)]
fn directions(
    frame: &Frame,
    face: Vec3,
    warp: impl Fn([f32; 2]) -> Vec3,
    [u, v]: [&[f32]; 2],
    [x, y, z, cosine, facing]: [&mut [f32]; 5],
) {
    let n = u.len();
    let (v, x, y, z, cosine, facing) = (
        &v[..n],
        &mut x[..n],
        &mut y[..n],
        &mut z[..n],
        &mut cosine[..n],
        &mut facing[..n],
    );
    for k in 0..n {
        let local = warp([u[k], v[k]]);
        let d = frame.world_from_local(local);
        (x[k], y[k], z[k]) = (d.x, d.y, d.z);
        cosine[k] = local.z;
        facing[k] = face.dot(d);
    }
}

fn grow<T: Clone>(buffer: &mut Vec<T>, least: usize, value: T) {
    if buffer.len() < least {
        buffer.resize(least, value);
    }
}
