//! Unbiased light transport over any [`Tracer`], in batches.
//!
//! A task takes a run of pixels with all their samples, a wavefront of a few thousand paths: all closest hits of one bounce are
//! found by one call, then all shadow rays by another. Light is gathered by next-event estimation and by sampling the
//! BRDF, combined by multiple importance sampling (power heuristic). Numbers are keyed by (pixel, bounce) and sample index, so
//! an image does not depend on the number of threads.
//!
//! Every pixel's light is kept apart as emission, diffuse and specular part of the first hit, with the variance of the
//! last two: what [`super::denoise`] needs to filter irradiance without touching textures or lamps.
//!
//! With an [`IndirectCache`] the second and later vertices take their diffuse light from it and only their specular lobe is
//! followed further. That is biased by the cache's resolution and noise, and far cheaper; without a cache nothing is.

use super::path_tracer_lights::Lights;
use crate::brdf::Material;
use crate::geometry::{Camera, Mesh};
use crate::image::{Plane, RgbPlane};
use crate::math::luminance;
use crate::parallel::map_chunks;
use crate::progress::Progress;
use crate::sampling::{KeyedRng, SobolSequence, hash_u64};
use crate::trace::{Hit, Ray, Tracer};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// What light meets at a surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Reflection.
    pub material: Material,
    /// Emitted radiance, towards both sides.
    pub emission: Vec3,
}

/// Materials and emission of a mesh.
pub trait SurfaceModel: Sync {
    /// The surface at barycentrics (u, v) of a triangle.
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface;
    /// Mean emitted radiance of a triangle: decides how often it is sampled as a light. Must be positive where it emits.
    fn mean_emission(&self, triangle: usize) -> Vec3;
    /// Class id of a triangle; 0 = unlabelled.
    fn label(&self, triangle: usize) -> u16;
    /// Whether triangles emit only towards the side their winding faces (false: towards both).
    fn emits_forward_only(&self) -> bool {
        false
    }
}

/// Light from directions without geometry.
pub trait Environment: Sync {
    /// Radiance arriving from a unit direction (pointing away from the scene).
    fn radiance(&self, direction: Vec3) -> Vec3;
    /// Triangles in the openings the environment is seen through; a hint for sampling only.
    fn portals(&self) -> &[[Vec3; 3]] {
        &[]
    }
}

/// No light from outside.
pub struct BlackEnvironment;
impl Environment for BlackEnvironment {
    fn radiance(&self, _: Vec3) -> Vec3 {
        Vec3::ZERO
    }
}

/// Known irradiance, to end paths early.
pub trait IndirectCache: Sync {
    /// Irradiance on the front side at barycentrics (u, v) of a triangle.
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3;
}

/// Settings of the path tracer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTracerOptions {
    /// Samples per pixel.
    pub samples: u32,
    /// Surface interactions after which a path ends for certain; Russian roulette ends most long before.
    pub max_bounces: u32,
    /// First bounce at which Russian roulette may end a path.
    pub roulette_from: u32,
    /// Seed of all numbers.
    pub seed: u64,
    /// Leave out the specular lobe (tests, furnace).
    pub lambertian: bool,
    /// Shade with the triangles' own normals (comparison with renderers that treat smooth normals otherwise).
    pub flat: bool,
    /// Largest luminance a single indirect contribution may have; biased, off by default.
    pub clamp: Option<f32>,
}

impl Default for PathTracerOptions {
    fn default() -> Self {
        Self { samples: 64, max_bounces: 64, roulette_from: 3, seed: 0, lambertian: false, flat: false, clamp: None }
    }
}

/// An image with what its first hits saw.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Light emitted by the first hit, or the environment's.
    pub emission: RgbPlane,
    /// Light reflected by the diffuse lobe of the first hit.
    pub diffuse: RgbPlane,
    /// Light reflected by the specular lobe of the first hit.
    pub specular: RgbPlane,
    /// Variance of the luminance of the pixel's diffuse and specular mean.
    pub variance: Plane<[f32; 2]>,
    /// Mean albedo over the pixel's samples that met geometry.
    pub albedo: RgbPlane,
    /// Mean normal over the pixel's samples (zero without geometry).
    pub normal: RgbPlane,
    /// Mean distance over the pixel's samples that met geometry; 0 without.
    pub depth: Plane<f32>,
    /// Class at the pixel's centre; 0 without geometry.
    pub label: Plane<u16>,
    /// Albedo, box-filtered over the part of the pixel that has the centre's class.
    pub class_albedo: RgbPlane,
    /// Roughness, likewise.
    pub class_roughness: Plane<f32>,
}

impl Frame {
    /// The image: emission + diffuse + specular.
    #[must_use]
    pub fn radiance(&self) -> RgbPlane {
        let mut out = self.emission.clone();
        for (i, p) in out.data.iter_mut().enumerate() {
            *p += self.diffuse.data[i] + self.specular.data[i];
        }
        out
    }
}

/// A light without extent: a bulb, or a spot with a soft cone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLight {
    /// Where it is.
    pub position: Vec3,
    /// Radiant intensity on its axis, per steradian.
    pub intensity: Vec3,
    /// Unit axis of the cone.
    pub axis: Vec3,
    /// Cosines of the angles to the axis at which the light begins to fall and at which it has ended; -1, -1 for a bulb.
    pub cosines: [f32; 2],
}

impl PointLight {
    /// Intensity towards the unit direction `d` (away from the light).
    #[must_use]
    pub fn towards(&self, d: Vec3) -> Vec3 {
        let [inner, outer] = self.cosines;
        if outer <= -1.0 {
            return self.intensity;
        }
        let t = ((self.axis.dot(d) - outer) / (inner - outer).max(1e-6)).clamp(0.0, 1.0);
        self.intensity * (t * t * (3.0 - 2.0 * t))
    }
}

/// When [`PathTracer::render_adaptive`] is content.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Samples every pixel gets at least.
    pub first: u32,
    /// Samples no pixel exceeds.
    pub most: u32,
    /// Standard error, relative to the local brightness, at which a block of pixels is done.
    pub error: f32,
}

/// Side of the blocks that adaptive sampling decides about.
const BLOCK: usize = 8;

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

/// A scene ready to be rendered.
pub struct PathTracer<'a> {
    mesh: &'a Mesh,
    tracer: &'a dyn Tracer,
    surfaces: &'a dyn SurfaceModel,
    environment: &'a dyn Environment,
    lights: Lights,
    points: Vec<PointLight>,
    options: PathTracerOptions,
    /// Offset of ray origins relative to the largest coordinate involved.
    offset_floor: f32,
}

/// Paths per task.
const WAVEFRONT: usize = 4096;
/// Ray origins move this many units in the last place of the largest coordinate off the surface.
const OFFSET_ULPS: f32 = 64.0;

/// Which lobes of a vertex are followed.
#[derive(Clone, Copy, PartialEq)]
enum Lobes {
    Both,
    Diffuse,
    Specular,
}

/// A surface interaction.
struct Vertex {
    position: Vec3,
    face_normal: Vec3,
    normal: Vec3,
    view: Vec3,
    material: Material,
    lobes: Lobes,
    /// Luminance against which a shadow ray's worth is measured; 0 traces every one.
    reference: f32,
}

#[derive(Clone, Copy)]
struct Path {
    slot: u32,
    /// Throughput after the first vertex.
    beta: Vec3,
    /// Factors of the first vertex' diffuse (with albedo) and specular lobe.
    first: [Vec3; 2],
    /// Where the last direction was drawn and with what density.
    origin: Vec3,
    pdf: f32,
}

/// Collected light of one path.
#[derive(Clone, Copy, Default)]
struct Sums {
    emission: Vec3,
    diffuse: Vec3,
    specular: Vec3,
}

struct ShadowRay {
    slot: u32,
    diffuse: Vec3,
    specular: Vec3,
}

/// First-hit features of a path.
#[derive(Clone, Copy)]
struct Feature {
    albedo: Vec3,
    roughness: f32,
    normal: Vec3,
    depth: f32,
    label: u16,
}

/// Keys of a path: what its random numbers derive from.
#[derive(Clone, Copy)]
struct PathKey {
    key: u64,
    sample: u32,
}

/// Buffers of one task, kept between bounces.
#[derive(Default)]
struct Wave {
    paths: Vec<Path>,
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    next_paths: Vec<Path>,
    next_rays: Vec<Ray>,
    shadow: Vec<ShadowRay>,
    shadow_rays: Vec<Ray>,
    occluded: Vec<u8>,
}

fn power_heuristic(a: f32, b: f32) -> f32 {
    if a.is_infinite() {
        return 1.0;
    }
    let (a, b) = (a * a, b * b);
    if a + b > 0.0 && (a + b).is_finite() { a / (a + b) } else { 0.5 }
}

impl<'a> PathTracer<'a> {
    /// Prepares a scene: collects its lights and builds the tables they are sampled by.
    #[must_use]
    pub fn new(
        mesh: &'a Mesh,
        tracer: &'a dyn Tracer,
        surfaces: &'a dyn SurfaceModel,
        environment: &'a dyn Environment,
        options: PathTracerOptions,
    ) -> Self {
        let lights = Lights::new(mesh, surfaces, environment, tracer, options.seed);
        let (low, high) = mesh.bounds();
        let offset_floor = 0.01 * (high - low).max_element();
        Self { mesh, tracer, surfaces, environment, lights, points: Vec::new(), options, offset_floor }
    }

    /// Adds lights without extent.
    #[must_use]
    pub fn with_points(mut self, points: Vec<PointLight>) -> Self {
        self.points = points;
        self
    }

    /// Sets the samples per pixel.
    pub fn set_samples(&mut self, samples: u32) {
        self.options.samples = samples.max(1);
    }

    /// Renders a camera; `key` tells views apart. Advances `progress` by the number of pixels.
    #[must_use]
    pub fn render(&self, camera: &Camera, key: u64, progress: &Progress) -> Frame {
        self.render_with(camera, key, None, progress)
    }

    /// As [`Self::render`]; indirect light comes from `cache` where one is given.
    #[must_use]
    pub fn render_with(&self, camera: &Camera, key: u64, cache: Option<&dyn IndirectCache>, progress: &Progress) -> Frame {
        let (w, h) = (camera.width, camera.height);
        let samples = self.options.samples.max(1) as usize;
        let all: Vec<usize> = (0..w * h).collect();
        let pixels_per_task = (WAVEFRONT / samples).max(1);
        let tiles = map_chunks(w * h, pixels_per_task, |range| {
            let pixels = &all[range];
            let mut out = self.begin_pixels(camera, pixels);
            self.sample_pixels(camera, key, cache, pixels, [0, samples as u32], &mut out);
            progress.advance(pixels.len() as u64);
            out.iter().map(PixelAccumulator::finish).collect::<Vec<_>>()
        });
        assemble(w, h, &tiles.into_iter().flatten().collect::<Vec<_>>())
    }

    /// Renders a camera in passes: after `first` samples everywhere, each pass doubles the samples of the blocks whose error is
    /// still above the target. `refined` sees the image after every pass. Advances `progress` by one per pixel and pass.
    pub fn render_adaptive(
        &self,
        camera: &Camera,
        key: u64,
        goal: &Adaptive,
        progress: &Progress,
        mut refined: impl FnMut(u32, &Frame) -> crate::Result<()>,
    ) -> crate::Result<Frame> {
        let (w, h) = (camera.width, camera.height);
        let mut pending: Vec<usize> = (0..w * h).collect();
        let mut states: Vec<Option<PixelAccumulator>> = vec![None; w * h];
        let (mut done, mut next) = (0u32, goal.first.max(2));
        for pass in 0.. {
            let per_task = (WAVEFRONT / (next - done) as usize).max(1);
            let parts = map_chunks(pending.len(), per_task, |range| {
                let pixels = &pending[range];
                let mut out: Vec<PixelAccumulator> = if done == 0 {
                    self.begin_pixels(camera, pixels)
                } else {
                    pixels.iter().filter_map(|&p| states[p].clone()).collect()
                };
                self.sample_pixels(camera, key, None, pixels, [done, next], &mut out);
                progress.advance(pixels.len() as u64);
                out
            });
            for (&p, state) in pending.iter().zip(parts.into_iter().flatten()) {
                states[p] = Some(state);
            }
            let results: Vec<PixelResult> = states.iter().flatten().map(PixelAccumulator::finish).collect();
            let frame = assemble(w, h, &results);
            refined(pass, &frame)?;
            (done, next) = (next, next.saturating_mul(2).min(goal.most));
            pending = noisy_pixels(&frame, &pending, goal.error);
            if next <= done || pending.is_empty() {
                return Ok(frame);
            }
        }
        unreachable!("the passes end by return")
    }

    fn begin_pixels(&self, camera: &Camera, pixels: &[usize]) -> Vec<PixelAccumulator> {
        let centre = |p: usize| Vec2::new((p % camera.width) as f32 + 0.5, (p / camera.width) as f32 + 0.5);
        // the class at the centre decides which samples count for the filtered materials
        let rays: Vec<Ray> =
            pixels.iter().map(|&p| Ray::new(camera.position, camera.direction(centre(p)), f32::INFINITY)).collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        hits.iter().map(|h| PixelAccumulator::new(self.class_at(h))).collect()
    }

    /// Adds the samples `begin..end` of some pixels to their sums.
    fn sample_pixels(
        &self,
        camera: &Camera,
        view_key: u64,
        cache: Option<&dyn IndirectCache>,
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
                    wave.rays.push(Ray::new(camera.position, direction, f32::INFINITY));
                    let slot = keys.len() as u32;
                    keys.push(PathKey { key, sample: s });
                    wave.paths.push(Path { slot, beta: Vec3::ONE, first: [Vec3::ONE; 2], origin: camera.position, pdf: 0.0 });
                }
            }
            let mut sums = vec![Sums::default(); keys.len()];
            let mut features = vec![None; keys.len()];
            self.trace_wave(&mut wave, &keys, &mut sums, Some(&mut features), cache, 0);
            for (i, (s, f)) in sums.iter().zip(&features).enumerate() {
                results[i / count as usize].add(s, f.as_ref());
            }
            first_sample += count;
        }
    }

    fn class_at(&self, hit: &Hit) -> Option<(u16, Material)> {
        hit.is_hit().then(|| {
            let t = hit.triangle as usize;
            (self.surfaces.label(t), self.surfaces.surface(t, hit.u, hit.v).material)
        })
    }

    /// Irradiance at surface points, `samples` paths each; `key` tells passes apart. Advances `progress` by the number of points.
    #[must_use]
    pub fn irradiance(&self, points: &[IrradiancePoint], samples: u32, key: u64, progress: &Progress) -> Vec<Vec3> {
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
                    material: Material { albedo: Vec3::ONE, roughness: 1.0 },
                    lobes: Lobes::Diffuse,
                    reference: 0.0,
                };
                let path = Path { slot: slot as u32, beta: Vec3::ONE, first: [Vec3::ONE; 2], origin: point.position, pdf: 0.0 };
                self.scatter(&vertex, path, keys[slot], 0, &mut wave);
            }
            self.resolve_shadows(&mut wave, &mut sums);
            std::mem::swap(&mut wave.paths, &mut wave.next_paths);
            std::mem::swap(&mut wave.rays, &mut wave.next_rays);
            self.trace_wave(&mut wave, &keys, &mut sums, None, cache, 1);
            progress.advance(range.len() as u64);
            let mean = |s: &[Sums]| s.iter().map(|s| s.diffuse).sum::<Vec3>() * (PI / samples as f32);
            sums.chunks(samples as usize).map(mean).collect::<Vec<Vec3>>()
        });
        parts.into_iter().flatten().collect()
    }

    /// Follows the paths in `wave` until all have ended.
    fn trace_wave(
        &self,
        wave: &mut Wave,
        keys: &[PathKey],
        sums: &mut [Sums],
        mut features: Option<&mut [Option<Feature>]>,
        cache: Option<&dyn IndirectCache>,
        first_bounce: u32,
    ) {
        for bounce in first_bounce..self.options.max_bounces.max(first_bounce + 1) {
            if wave.paths.is_empty() {
                break;
            }
            wave.hits.clear();
            wave.hits.resize(wave.rays.len(), Hit::miss());
            self.tracer.closest(&wave.rays, &mut wave.hits);
            wave.next_paths.clear();
            wave.next_rays.clear();
            for i in 0..wave.paths.len() {
                let (path, hit, ray) = (wave.paths[i], wave.hits[i], wave.rays[i]);
                let direction = Vec3::from_array(ray.direction);
                let slot = path.slot as usize;
                if !hit.is_hit() {
                    let radiance = self.environment.radiance(direction);
                    if bounce == 0 {
                        sums[slot].emission += radiance;
                    } else {
                        let weight = power_heuristic(path.pdf, self.lights.environment_pdf(path.origin, direction));
                        self.deposit(&mut sums[slot], &path, radiance * weight, bounce);
                    }
                    continue;
                }
                let triangle = hit.triangle as usize;
                let surface = self.surfaces.surface(triangle, hit.u, hit.v);
                if surface.emission != Vec3::ZERO && self.emits_towards(triangle, direction) {
                    if bounce == 0 {
                        sums[slot].emission += surface.emission;
                    } else {
                        let distance = hit.t + self.offset(path.origin);
                        let other = self.lights.triangle_pdf(path.origin, direction, distance, hit.triangle);
                        self.deposit(&mut sums[slot], &path, surface.emission * power_heuristic(path.pdf, other), bounce);
                    }
                }
                let mut vertex = self.vertex(&hit, -direction, surface.material);
                if let Some(f) = features.as_deref_mut().filter(|_| bounce == 0) {
                    f[slot] = Some(Feature {
                        albedo: surface.material.albedo,
                        roughness: surface.material.roughness,
                        normal: vertex.normal,
                        depth: hit.t,
                        label: self.surfaces.label(triangle),
                    });
                }
                if bounce + 1 >= self.options.max_bounces {
                    continue;
                }
                if let Some(cache) = cache.filter(|_| bounce > 0) {
                    let light = cache.irradiance(triangle, hit.u, hit.v) * surface.material.albedo * FRAC_1_PI;
                    self.deposit(&mut sums[slot], &path, light, bounce);
                    if self.options.lambertian {
                        continue;
                    }
                    vertex.lobes = Lobes::Specular;
                    vertex.reference = luminance(path.beta * light);
                }
                self.scatter(&vertex, path, keys[slot], bounce, wave);
            }
            self.resolve_shadows(wave, sums);
            std::mem::swap(&mut wave.paths, &mut wave.next_paths);
            std::mem::swap(&mut wave.rays, &mut wave.next_rays);
        }
    }

    /// Whether a triangle's light leaves on the side that a ray along `direction` meets.
    fn emits_towards(&self, triangle: usize, direction: Vec3) -> bool {
        !self.surfaces.emits_forward_only() || self.mesh.face_normal(triangle).dot(direction) < 0.0
    }

    /// Adds radiance arriving along a path to the lobes of its first vertex.
    fn deposit(&self, sums: &mut Sums, path: &Path, radiance: Vec3, bounce: u32) {
        let mut light = path.beta * radiance;
        if let Some(limit) = self.options.clamp.filter(|_| bounce > 1) {
            light *= (limit / luminance(light).max(1e-20)).min(1.0);
        }
        sums.diffuse += path.first[0] * light;
        sums.specular += path.first[1] * light;
    }

    /// Distance by which origins near `p` are moved off the surface.
    fn offset(&self, p: Vec3) -> f32 {
        OFFSET_ULPS * f32::EPSILON * p.abs().max_element().max(self.offset_floor)
    }

    fn vertex(&self, hit: &Hit, view: Vec3, material: Material) -> Vertex {
        let t = hit.triangle as usize;
        let mut face_normal = self.mesh.face_normal(t);
        let mut normal = self.mesh.shading_normal(t, hit.u, hit.v);
        if face_normal.dot(view) < 0.0 {
            face_normal = -face_normal;
            normal = -normal;
        }
        // a smooth normal that turns away from the viewer at a silhouette would be black
        if self.options.flat || normal.dot(view) < 1e-3 {
            normal = face_normal;
        }
        let lobes = if self.options.lambertian { Lobes::Diffuse } else { Lobes::Both };
        Vertex { position: self.mesh.position(t, hit.u, hit.v), face_normal, normal, view, material, lobes, reference: 0.0 }
    }

    /// Next-event estimation and the continuation of a path at a vertex.
    fn scatter(&self, vertex: &Vertex, path: Path, key: PathKey, bounce: u32, wave: &mut Wave) {
        let u = if bounce < 4 {
            SobolSequence::new(key.key, u64::from(bounce) + 1).point4(key.sample)
        } else {
            let mut rng = KeyedRng::new(key.key, (u64::from(bounce) << 32) | u64::from(key.sample));
            std::array::from_fn(|_| rng.next_f32())
        };
        let (n, v, m) = (vertex.normal, vertex.view, vertex.material);
        if n.dot(v) <= 0.0 {
            return;
        }
        let share = match vertex.lobes {
            Lobes::Both => m.specular_share(n.dot(v)),
            Lobes::Diffuse => 0.0,
            Lobes::Specular => 1.0,
        };
        let first = bounce == 0;
        let offset = self.offset(vertex.position);
        let origin = vertex.position + vertex.face_normal * offset;
        // diffuse and specular BRDF·cos/pdf for a direction
        let lobes = |l: Vec3, pdf: f32| {
            let scale = n.dot(l) / pdf;
            let diffuse = if vertex.lobes == Lobes::Specular { Vec3::ZERO } else { m.albedo * (FRAC_1_PI * scale) };
            let specular = if vertex.lobes == Lobes::Diffuse { 0.0 } else { m.specular_lobe(n, v, l) * scale };
            (diffuse, Vec3::splat(specular))
        };
        let above = |l: Vec3| n.dot(l) > 0.0 && vertex.face_normal.dot(l) > 0.0;
        let advance = |(diffuse, specular): (Vec3, Vec3)| {
            if first {
                Path { first: [diffuse, specular], ..path }
            } else {
                Path { beta: path.beta * (diffuse + specular), ..path }
            }
        };
        if let Some(s) = self.lights.sample(vertex.position, [u[0], u[1]]).filter(|s| above(s.direction)) {
            let pdf = m.pdf_with_share(n, v, s.direction, share);
            let weight = power_heuristic(s.pdf, pdf);
            let radiance = match s.hit {
                Some((t, _, _)) if !self.emits_towards(t as usize, s.direction) => Vec3::ZERO,
                Some((t, b1, b2)) => self.surfaces.surface(t as usize, b1, b2).emission,
                None => self.environment.radiance(s.direction),
            };
            let mut light = Sums::default();
            self.deposit(&mut light, &advance(lobes(s.direction, s.pdf)), radiance * weight, bounce + 1);
            // beside the diffuse light of a cached vertex a faint highlight is worth a shadow ray only now and then
            let worth = luminance(advance(lobes(s.direction, s.pdf)).beta * radiance * weight);
            let keep = if vertex.reference > 0.0 { (2.0 * worth / vertex.reference).clamp(0.1, 1.0) } else { 1.0 };
            let kept = keep >= 1.0
                || KeyedRng::new(key.key ^ 0xa11e, (u64::from(bounce) << 32) | u64::from(key.sample)).next_f32() < keep;
            if kept && light.diffuse + light.specular != Vec3::ZERO {
                // from the moved origin the same point of the light is aimed at; the end stays clear of it
                let (direction, t_far) = if s.distance.is_finite() {
                    let d = vertex.position + s.direction * s.distance - origin;
                    (d.normalize(), d.length() * (1.0 - 1e-4) - offset)
                } else {
                    (s.direction, f32::INFINITY)
                };
                wave.shadow.push(ShadowRay { slot: path.slot, diffuse: light.diffuse / keep, specular: light.specular / keep });
                wave.shadow_rays.push(Ray::new(origin, direction, t_far.max(0.0)));
            }
        }
        if let Some((light, share)) = self.choose_point(&vertex.position, key, bounce) {
            let d = light.position - origin;
            let distance = d.length();
            let l = d / distance.max(1e-9);
            if above(l) {
                let radiance = light.towards(-l) / (distance * distance).max(1e-12);
                let mut sums = Sums::default();
                self.deposit(&mut sums, &advance(lobes(l, share)), radiance, bounce + 1);
                if sums.diffuse + sums.specular != Vec3::ZERO {
                    wave.shadow.push(ShadowRay { slot: path.slot, diffuse: sums.diffuse, specular: sums.specular });
                    wave.shadow_rays.push(Ray::new(origin, l, (distance * (1.0 - 1e-4)).max(0.0)));
                }
            }
        }
        // the first number also chooses the lobe and is stretched back to [0, 1)
        let specular = u[2] < share;
        let u2 = if specular { u[2] / share } else { (u[2] - share) / (1.0 - share).max(1e-6) };
        let Some(l) = m.sample_direction(n, v, specular, [u2.clamp(0.0, 1.0 - 1e-7), u[3]]).filter(|&l| above(l)) else {
            return;
        };
        let pdf = m.pdf_with_share(n, v, l, share);
        let mut next = advance(lobes(l, pdf));
        next.pdf = pdf;
        next.origin = vertex.position;
        let strength = next.beta.max_element();
        if !(pdf > 0.0 && strength > 0.0 && next.beta.is_finite() && next.first.iter().all(|f| f.is_finite())) {
            return;
        }
        let survival = if vertex.lobes == Lobes::Specular && !first {
            (next.beta.max_element() / path.beta.max_element()).clamp(0.05, 1.0)
        } else if bounce >= self.options.roulette_from {
            (strength * next.first[0].max(next.first[1]).max_element().min(1.0)).clamp(0.05, 0.95)
        } else {
            1.0
        };
        if survival < 1.0 {
            let mut rng = KeyedRng::new(key.key ^ 0x5f5f, (u64::from(bounce) << 32) | u64::from(key.sample));
            if rng.next_f32() >= survival {
                return;
            }
            next.beta /= survival;
        }
        wave.next_paths.push(next);
        wave.next_rays.push(Ray::new(origin, l, f32::INFINITY));
    }

    /// One of the lights without extent, chosen by what it could send to `p`, with its probability.
    fn choose_point(&self, p: &Vec3, key: PathKey, bounce: u32) -> Option<(&PointLight, f32)> {
        let worth = |l: &PointLight| {
            let d = *p - l.position;
            luminance(l.towards(d.normalize_or_zero())) / d.length_squared().max(1e-6)
        };
        let total: f32 = self.points.iter().map(worth).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut rng = KeyedRng::new(key.key ^ 0x90_1e75, (u64::from(bounce) << 32) | u64::from(key.sample));
        let mut rest = rng.next_f32() * total;
        let mut chosen = None;
        for l in &self.points {
            let w = worth(l);
            if w > 0.0 {
                chosen = Some((l, w / total));
                rest -= w;
                if rest < 0.0 {
                    break;
                }
            }
        }
        chosen
    }

    fn resolve_shadows(&self, wave: &mut Wave, sums: &mut [Sums]) {
        wave.occluded.clear();
        wave.occluded.resize(wave.shadow_rays.len(), 0);
        self.tracer.occluded(&wave.shadow_rays, &mut wave.occluded);
        for (s, _) in wave.shadow.iter().zip(&wave.occluded).filter(|(_, o)| **o == 0) {
            sums[s.slot as usize].diffuse += s.diffuse;
            sums[s.slot as usize].specular += s.specular;
        }
        wave.shadow.clear();
        wave.shadow_rays.clear();
    }
}

/// What a finished pixel holds: one element of every plane of [`Frame`].
struct PixelResult {
    emission: Vec3,
    diffuse: Vec3,
    specular: Vec3,
    variance: [f32; 2],
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    label: u16,
    class_albedo: Vec3,
    class_roughness: f32,
}

/// The planes of an image from its pixels.
fn assemble(w: usize, h: usize, pixels: &[PixelResult]) -> Frame {
    let plane = |f: fn(&PixelResult) -> Vec3| Plane { width: w, height: h, data: pixels.iter().map(f).collect() };
    Frame {
        emission: plane(|p| p.emission),
        diffuse: plane(|p| p.diffuse),
        specular: plane(|p| p.specular),
        variance: Plane { width: w, height: h, data: pixels.iter().map(|p| p.variance).collect() },
        albedo: plane(|p| p.albedo),
        normal: plane(|p| p.normal),
        depth: Plane { width: w, height: h, data: pixels.iter().map(|p| p.depth).collect() },
        label: Plane { width: w, height: h, data: pixels.iter().map(|p| p.label).collect() },
        class_albedo: plane(|p| p.class_albedo),
        class_roughness: Plane { width: w, height: h, data: pixels.iter().map(|p| p.class_roughness).collect() },
    }
}

/// The pixels of `among` whose block has a relative standard error above the target.
fn noisy_pixels(frame: &Frame, among: &[usize], target: f32) -> Vec<usize> {
    let (w, h) = (frame.emission.width, frame.emission.height);
    let columns = w.div_ceil(BLOCK);
    let mut blocks = vec![(0.0f64, 0.0f64, 0u32); columns * h.div_ceil(BLOCK)];
    let block_of = |p: usize| (p / w / BLOCK) * columns + p % w / BLOCK;
    let mut mean = 0.0;
    for p in 0..w * h {
        let reflected = luminance(frame.diffuse.data[p] + frame.specular.data[p]);
        let b = &mut blocks[block_of(p)];
        *b = (b.0 + f64::from(reflected), b.1 + f64::from(frame.variance.data[p][0] + frame.variance.data[p][1]), b.2 + 1);
        mean += f64::from(reflected) / (w * h) as f64;
    }
    // what is much darker than the picture as a whole need not be as exact as itself asks
    let noisy = |b: &(f64, f64, u32)| {
        let n = f64::from(b.2.max(1));
        (b.1 / n).sqrt() > f64::from(target) * (b.0 / n + 0.1 * mean)
    };
    let noisy: Vec<bool> = blocks.iter().map(noisy).collect();
    among.iter().copied().filter(|&p| noisy[block_of(p)]).collect()
}

/// Sums over a pixel's samples, in f64 where differences of squares are taken.
#[derive(Clone)]
struct PixelAccumulator {
    samples: u32,
    centre: Option<(u16, Material)>,
    sums: Sums,
    moments: [[f64; 2]; 2],
    geometry: f32,
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    class: f32,
    class_albedo: Vec3,
    class_roughness: f32,
}

impl PixelAccumulator {
    fn new(centre: Option<(u16, Material)>) -> Self {
        Self {
            samples: 0,
            centre,
            sums: Sums::default(),
            moments: [[0.0; 2]; 2],
            geometry: 0.0,
            albedo: Vec3::ZERO,
            normal: Vec3::ZERO,
            depth: 0.0,
            class: 0.0,
            class_albedo: Vec3::ZERO,
            class_roughness: 0.0,
        }
    }

    fn add(&mut self, s: &Sums, feature: Option<&Feature>) {
        self.samples += 1;
        self.sums.emission += s.emission;
        self.sums.diffuse += s.diffuse;
        self.sums.specular += s.specular;
        for (m, x) in self.moments.iter_mut().zip([s.diffuse, s.specular]) {
            let y = f64::from(luminance(x));
            *m = [m[0] + y, m[1] + y * y];
        }
        if let Some(f) = feature {
            self.geometry += 1.0;
            self.albedo += f.albedo;
            self.normal += f.normal;
            self.depth += f.depth;
            if self.centre.is_some_and(|(label, _)| label == f.label) {
                self.class += 1.0;
                self.class_albedo += f.albedo;
                self.class_roughness += f.roughness;
            }
        }
    }

    fn finish(&self) -> PixelResult {
        let samples = self.samples.max(1);
        let n = f64::from(samples);
        let scale = 1.0 / samples as f32;
        let variance = self.moments.map(|[sum, square]| {
            let mean = sum / n;
            ((square / n - mean * mean).max(0.0) / (n - 1.0).max(1.0)) as f32
        });
        let seen = 1.0 / self.geometry.max(1.0);
        let centre = self.centre.map_or((Vec3::ZERO, 0.0), |(_, m)| (m.albedo, m.roughness));
        let (class_albedo, class_roughness) =
            if self.class > 0.0 { (self.class_albedo / self.class, self.class_roughness / self.class) } else { centre };
        PixelResult {
            emission: self.sums.emission * scale,
            diffuse: self.sums.diffuse * scale,
            specular: self.sums.specular * scale,
            variance,
            albedo: self.albedo * seen,
            normal: self.normal * scale,
            depth: self.depth * seen,
            label: self.centre.map_or(0, |(l, _)| l),
            class_albedo,
            class_roughness,
        }
    }
}

#[cfg(test)]
#[path = "path_tracer_tests.rs"]
mod tests;
