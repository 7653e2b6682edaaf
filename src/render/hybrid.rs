//! The hybrid renderer: L = A·E/π + L_s(R), with irradiance from its texture and specular
//! reflection traced against the observed radiance (method §5). Fast, because all bounces are in
//! the textures; edits do not change the light. For changed light use the path tracer.

use super::denoise::{SpecularFeature, filter_specular};
use super::edges::pixels_at_edges;
use super::panes::SolutionPanes;
use crate::core::brdf::BaseColour;
use crate::core::geometry::Camera;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::sampling::hash_u64;
use crate::core::trace::{CutOut, EmbreeTracer, Hit, MOST_LAYERS, Ray, Tracer, beyond};
use crate::gbuffer::PixelRays;
use crate::lights::{Emitters, LitScene};
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use crate::solution::Solution;
use crate::specular::{Levels, Own, Reflector, ShadingPoint};
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// What a renderer shows from one camera, at the camera's image size.
#[derive(Clone, Debug)]
pub struct RenderedView {
    /// Outgoing radiance towards the camera.
    pub radiance: RgbPlane,
    /// Albedo of the surface seen, 0 where there is none.
    pub albedo: RgbPlane,
    /// Roughness R of the surface seen, 0 where there is none.
    pub roughness: Plane<f32>,
    /// Share of metal of the surface seen, 0 where there is none.
    pub metallic: Plane<f32>,
    /// Share of transmitted light of the surface seen, 0 where there is none.
    pub transmission: Plane<f32>,
    /// Class id of the surface seen, 0 where there is none.
    pub labels: Plane<u16>,
    /// Emitted part of the radiance, 0 where nothing emits.
    pub emission: RgbPlane,
    /// Stated standard error of albedo and roughness, 1e4 where unobserved, 0 where there is no
    /// surface.
    pub confidence: Plane<Vec2>,
}

/// Renders a solution from a camera. Implementations hold what they need prepared (ray structure,
/// textures).
pub trait ViewRenderer: Sync {
    /// The view from `camera`, at its image size.
    ///
    /// # Errors
    /// Whatever the implementation needs and cannot get.
    fn render(&self, camera: &Camera) -> Result<RenderedView>;

    /// The same, each pixel's materials being those of the surfaces of its class in `classes` (of
    /// the camera's image size) where it shows any: at an edge a pixel shows several, and a
    /// photograph's labels say which one it counts for.
    ///
    /// # Errors
    /// As [`Self::render`].
    fn render_classes(&self, camera: &Camera, _classes: &Plane<u16>) -> Result<RenderedView> {
        self.render(camera)
    }

    /// The radiance that the reconstruction fused from the photographs, seen from `camera` without
    /// any model of light and material: the ceiling of what [`Self::render`] can show. `None` if
    /// the implementation holds no such radiance.
    ///
    /// # Errors
    /// As [`Self::render`].
    fn reproject(&self, _camera: &Camera) -> Result<Option<RgbPlane>> {
        Ok(None)
    }
}

/// Samples of the hybrid renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HybridOptions {
    /// Primary rays per pixel along each axis; three times as many at edges if there are two or
    /// more.
    pub supersampling: u32,
    /// Specular rays per primary ray.
    pub specular_rays: u32,
    /// Emitter samples per primary ray.
    pub emitter_samples: u32,
    /// Filter the noise of specular reflection, guided by the surfaces seen.
    pub denoise: bool,
    /// Seed of the sample points.
    pub seed: u64,
}

impl Default for HybridOptions {
    fn default() -> Self {
        Self {
            supersampling: 2,
            specular_rays: 4,
            emitter_samples: 2,
            denoise: true,
            seed: 0,
        }
    }
}

/// A solution prepared for rendering.
pub struct HybridRenderer<'a> {
    solution: &'a Solution,
    tracer: EmbreeTracer,
    field: LightField,
    emitters: Emitters,
    offset: f32,
    options: HybridOptions,
}

impl<'a> HybridRenderer<'a> {
    /// Builds the ray structure and the light field of a solution.
    ///
    /// # Errors
    /// If Embree cannot be used.
    pub fn new(solution: &'a Solution, options: HybridOptions) -> Result<Self> {
        let mesh = &solution.mesh;
        let tracer = EmbreeTracer::new(mesh)?;
        let orientation = crate::gbuffer::Orientation::of_winding(mesh.triangles.len());
        let emission = &solution.emission;
        let size = Vec2::new(emission.width as f32, emission.height as f32);
        let emissive_triangles: Vec<bool> = (0..mesh.triangles.len())
            .map(|t| {
                [(0.34, 0.33), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)]
                    .iter()
                    .any(|&(u, v)| *emission.nearest(mesh.uv(t, u, v) * size) != Vec3::ZERO)
            })
            .collect();
        let emissive = if (emission.width, emission.height)
            == (solution.radiance.width, solution.radiance.height)
        {
            emission.map(|e| *e != Vec3::ZERO)
        } else {
            solution.radiance.map(|_| false)
        };
        let environment = Environment::from_map(solution.environment.clone());
        let field = LightField::new(
            mesh,
            &orientation,
            SurfaceRadiance {
                radiance: solution.radiance.clone(),
                emissive,
                emissive_triangles: &emissive_triangles,
                back: Vec::new(),
            },
            environment,
        );
        let probes: Vec<(Vec3, Vec3)> = (0..mesh.triangles.len())
            .step_by((mesh.triangles.len() / 50_000).max(1))
            .map(|t| (mesh.position(t, 1.0 / 3.0, 1.0 / 3.0), mesh.face_normal(t)))
            .collect();
        let emitters = Emitters::new(mesh, &field, &tracer, &probes);
        let (lo, hi) = mesh.bounds();
        Ok(Self {
            solution,
            tracer,
            field,
            emitters,
            offset: (hi - lo).length() * 1e-5,
            options,
        })
    }

    /// Rays along each side of a pixel.
    fn supersampling(&self) -> usize {
        self.options.supersampling.max(1) as usize
    }

    fn render_row(&self, raster: &Raster, known: &Known, y: usize) -> Row {
        let n = self.supersampling();
        let columns: Vec<usize> = (0..raster.even.camera.width).collect();
        let rays = [self.options.specular_rays, self.options.emitter_samples];
        let points = self.points(
            &raster.even,
            Strip {
                y,
                columns: &columns,
            },
            rays,
        );
        let pixel = |x: usize| &points[x * n * n..(x + 1) * n * n];
        let (edges, smooth): (Vec<usize>, Vec<usize>) = columns.iter().partition(|&&x| {
            known.at_edges.as_ref().is_some_and(|e| e[(x, y)]) || shows_edge(pixel(x))
        });
        let mut even: Vec<Point> = smooth
            .iter()
            .flat_map(|&x| pixel(x).iter().copied())
            .collect();
        let fewer = rays.map(|r| r.div_ceil((EDGE_FACTOR * EDGE_FACTOR) as u32));
        let mut fine = self.points(&raster.fine, Strip { y, columns: &edges }, fewer);
        self.add_specular(&mut even, rays);
        self.add_specular(&mut fine, fewer);
        let mut even = even.chunks_exact(n * n);
        let mut fine = fine.chunks_exact(n * n * EDGE_FACTOR * EDGE_FACTOR);
        let pixels = columns.iter().filter_map(|x| {
            if edges.binary_search(x).is_ok() {
                fine.next()
            } else {
                even.next()
            }
        });
        Row::resolve(pixels, |x| known.classes.map(|c| c[(x, y)]))
    }

    /// What a camera's rays through each of some pixels meet, without their specular
    /// part; what is seen through panes has its own, of as many rays as [`Self::add_specular`] is
    /// given.
    fn points(
        &self,
        through: &PixelRays,
        Strip { y, columns }: Strip,
        rays_per_point: [u32; 2],
    ) -> Vec<Point> {
        let camera = &through.camera;
        let samples = through.per_pixel();
        let rays = through.of_row(y, columns.iter().copied());
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        let point = |(i, (ray, hit)): (usize, (&Ray, &Hit))| {
            let sample = (y * camera.width + columns[i / samples]) * samples + i % samples;
            self.shade_point(
                ray,
                hit,
                hash_u64(sample as u64, camera.position.x.to_bits().into()),
            )
        };
        let mut points: Vec<Point> = rays.iter().zip(&hits).enumerate().map(point).collect();
        if self.solution.transmission.is_some() {
            let met = rays.into_iter().zip(hits).enumerate();
            let layer = met.map(|(of, (ray, hit))| Seen {
                of,
                ray,
                hit,
                weight: Vec3::ONE,
            });
            self.add_behind_panes(&mut points, layer.collect(), rays_per_point);
        }
        points
    }

    /// Adds to points on panes what is seen through them, pane after pane.
    fn add_behind_panes(&self, points: &mut [Point], mut layer: Vec<Seen>, rays: [u32; 2]) {
        let panes = SolutionPanes(self.solution);
        for depth in 1..=MOST_LAYERS {
            layer.retain_mut(|s| {
                if s.hit.is_hit() {
                    s.weight *= panes.transmittance(&s.ray, &s.hit);
                    s.ray = beyond(&s.ray, &s.hit);
                }
                s.hit.is_hit() && s.weight != Vec3::ZERO
            });
            if layer.is_empty() {
                return;
            }
            let further: Vec<Ray> = layer.iter().map(|s| s.ray).collect();
            let mut hits = vec![Hit::miss(); further.len()];
            self.tracer.closest(&further, &mut hits);
            let shaded = |(s, hit): (&mut Seen, Hit)| {
                s.hit = hit;
                let key = points[s.of].gaze.map_or(0, |g| g.key);
                self.shade_point(&s.ray, &hit, hash_u64(key, depth as u64))
            };
            let mut behind: Vec<Point> = layer.iter_mut().zip(hits).map(shaded).collect();
            self.add_specular(&mut behind, rays);
            for (s, p) in layer.iter().zip(&behind) {
                points[s.of].radiance += s.weight * (p.radiance + p.specular);
            }
        }
    }

    /// Traces the specular part of some points with that many rays along the lobe and emitter
    /// samples each.
    fn add_specular(&self, points: &mut [Point], [rays_per_lobe, emitter_samples]: [u32; 2]) {
        let seen = || points.iter().filter(|p| p.gaze.is_some());
        let gazes: Vec<ShadingPoint> = seen().filter_map(|p| p.gaze).collect();
        let roughness: Vec<f32> = seen().map(|p| p.roughness).collect();
        let f0: Vec<Vec3> = match &self.solution.metallic {
            Some(_) => seen().map(|p| p.base().f0()).collect(),
            None => Vec::new(),
        };
        let own = Own {
            roughness: &roughness,
            f0: &f0,
        };
        let mut specular = vec![Vec3::ZERO; gazes.len()];
        let panes = SolutionPanes(self.solution);
        let through = CutOut::new(&self.tracer, &panes);
        let tracer: &dyn Tracer = match self.solution.transmission {
            Some(_) => &through,
            None => &self.tracer,
        };
        let lit = LitScene {
            mesh: &self.solution.mesh,
            tracer,
            field: &self.field,
            emitters: &self.emitters,
            offset: self.offset,
        };
        let (model, seed) = (self.solution.reflectance, self.options.seed);
        Reflector {
            lit: &lit,
            rays_per_lobe,
            emitter_samples,
            model,
            seed,
        }
        .reflect(&gazes, Levels::Own(own), &mut specular);
        points
            .iter_mut()
            .filter(|p| p.gaze.is_some())
            .zip(specular)
            .for_each(|(p, s)| p.specular = s);
    }

    /// What a ray meets, without its specular part; `key` is that of its random numbers.
    fn shade_point(&self, ray: &Ray, hit: &Hit, key: u64) -> Point {
        let s = self.solution;
        let (direction, depth) = (Vec3::from_array(ray.direction), hit.t);
        if !hit.is_hit() {
            return Point {
                radiance: self.field.environment.radiance(direction),
                depth,
                ..Point::default()
            };
        }
        let t = hit.triangle as usize;
        let uv = s.mesh.uv(t, hit.u, hit.v);
        let at = |w: usize, h: usize| uv * Vec2::new(w as f32, h as f32);
        let label = *s.labels.nearest(at(s.labels.width, s.labels.height));
        let albedo = s
            .albedo
            .bilinear(at(s.albedo.width, s.albedo.height), Wrap::Clamp);
        let roughness = s
            .roughness
            .bilinear(at(s.roughness.width, s.roughness.height), Wrap::Clamp);
        let confidence = *s
            .confidence
            .nearest(at(s.confidence.width, s.confidence.height));
        let seen = Point {
            depth,
            albedo,
            metallic: s.metal_at(uv),
            transmission: s.transmission_at(uv),
            roughness,
            label,
            confidence,
            ..Point::default()
        };
        if self.field.is_emissive(t)
            && *s.emission.nearest(at(s.emission.width, s.emission.height)) != Vec3::ZERO
        {
            let radiance = self.field.emitted(t, hit.u, hit.v);
            return Point {
                radiance,
                emission: radiance,
                ..seen
            };
        }
        let irradiance = s
            .irradiance
            .bilinear(at(s.irradiance.width, s.irradiance.height), Wrap::Clamp);
        let (mut normal, mut face_normal) = (
            s.mesh.shading_normal(t, hit.u, hit.v),
            s.mesh.face_normal(t),
        );
        if face_normal.dot(direction) > 0.0 {
            (normal, face_normal) = (-normal, -face_normal);
        }
        let position = Vec3::from_array(ray.origin) + direction * depth;
        let view_factor = s
            .reflectance
            .diffuse_factor(-normal.dot(direction), roughness);
        let diffuse = seen.base().diffuse() * (1.0 - seen.transmission);
        Point {
            radiance: diffuse * irradiance * (FRAC_1_PI * view_factor),
            gaze: Some(ShadingPoint {
                position,
                normal,
                face_normal,
                view: -direction,
                key,
                turn: 0,
            }),
            ..seen
        }
    }
}

impl ViewRenderer for HybridRenderer<'_> {
    fn render(&self, camera: &Camera) -> Result<RenderedView> {
        Ok(self.render_rows(camera, None))
    }

    fn render_classes(&self, camera: &Camera, classes: &Plane<u16>) -> Result<RenderedView> {
        if (classes.width, classes.height) != (camera.width, camera.height) {
            return Err(Error::Usage(format!(
                "labels of {}x{} for a camera of {}x{}",
                classes.width, classes.height, camera.width, camera.height
            )));
        }
        Ok(self.render_rows(camera, Some(classes)))
    }

    fn reproject(&self, camera: &Camera) -> Result<Option<RgbPlane>> {
        let through = PixelRays::new(camera, self.supersampling());
        let samples = through.per_pixel();
        let share = 1.0 / samples as f32;
        let row = |y: usize| {
            let rays = through.of_row(y, 0..camera.width);
            let mut hits = vec![Hit::miss(); rays.len()];
            self.tracer.closest(&rays, &mut hits);
            let radiance = |(ray, hit): (&Ray, &Hit)| self.fused(ray, hit);
            let shown: Vec<Vec3> = rays.iter().zip(&hits).map(radiance).collect();
            let mean = |pixel: &[Vec3]| pixel.iter().sum::<Vec3>() * share;
            shown.chunks_exact(samples).map(mean).collect::<Vec<_>>()
        };
        let rows: Vec<Vec<Vec3>> = (0..camera.height).into_par_iter().map(row).collect();
        Ok(Some(Plane {
            width: camera.width,
            height: camera.height,
            data: rows.concat(),
        }))
    }
}

impl HybridRenderer<'_> {
    /// The fused radiance at a hit, interpolated as all textures are but at lamps, whose rims are
    /// sharp.
    fn fused(&self, ray: &Ray, hit: &Hit) -> Vec3 {
        if !hit.is_hit() {
            let direction = Vec3::from_array(ray.direction);
            return self.field.environment.radiance(direction);
        }
        let t = hit.triangle as usize;
        if self.field.is_emissive(t) {
            return self.field.emitted(t, hit.u, hit.v);
        }
        let plane = &self.solution.radiance;
        let size = Vec2::new(plane.width as f32, plane.height as f32);
        plane.bilinear(self.solution.mesh.uv(t, hit.u, hit.v) * size, Wrap::Clamp)
    }

    fn render_rows(&self, camera: &Camera, classes: Option<&Plane<u16>>) -> RenderedView {
        let (w, h) = (camera.width, camera.height);
        let at_edges = (self.options.supersampling > 1).then(|| {
            pixels_at_edges(
                camera,
                &self.tracer,
                &self.solution.mesh,
                &self.solution.labels,
            )
        });
        let known = Known { classes, at_edges };
        let n = self.supersampling();
        let raster = Raster {
            even: PixelRays::new(camera, n),
            fine: PixelRays::new(camera, n * EDGE_FACTOR),
        };
        let rows: Vec<Row> = (0..h)
            .into_par_iter()
            .map(|y| self.render_row(&raster, &known, y))
            .collect();
        let mut out = RenderedView {
            radiance: unfilled(w, h),
            albedo: unfilled(w, h),
            roughness: unfilled(w, h),
            metallic: unfilled(w, h),
            transmission: unfilled(w, h),
            labels: unfilled(w, h),
            emission: unfilled(w, h),
            confidence: unfilled(w, h),
        };
        let mut specular = unfilled(w, h);
        let mut features = Vec::with_capacity(w * h);
        for r in rows {
            specular.data.extend(r.specular);
            features.extend(r.features);
            out.radiance.data.extend(r.radiance);
            out.albedo.data.extend(r.albedo);
            out.roughness.data.extend(r.roughness);
            out.metallic.data.extend(r.metallic);
            out.transmission.data.extend(r.transmission);
            out.labels.data.extend(r.labels);
            out.emission.data.extend(r.emission);
            out.confidence.data.extend(r.confidence);
        }
        if self.options.denoise {
            filter_specular(&mut specular, &features, camera);
        }
        for (l, s) in out.radiance.data.iter_mut().zip(&specular.data) {
            *l += *s;
        }
        out
    }
}

/// A plane whose pixels are still to come.
fn unfilled<T>(width: usize, height: usize) -> Plane<T> {
    Plane {
        width,
        height,
        data: Vec::with_capacity(width * height),
    }
}

/// A shaded primary hit; a gaze where there is specular reflection.
#[derive(Clone, Copy, Default)]
struct Point {
    /// All but the specular part.
    radiance: Vec3,
    specular: Vec3,
    depth: f32,
    albedo: Vec3,
    metallic: f32,
    transmission: f32,
    roughness: f32,
    label: u16,
    emission: Vec3,
    confidence: Vec2,
    gaze: Option<ShadingPoint>,
}

/// What a ray through pixel sample `of` meets, and the share of it that the panes in between let
/// through.
struct Seen {
    of: usize,
    ray: Ray,
    hit: Hit,
    weight: Vec3,
}

impl Point {
    const fn base(&self) -> BaseColour {
        BaseColour {
            colour: self.albedo,
            metallic: self.metallic,
        }
    }
}

/// Rays through a camera's pixels.
struct Raster {
    even: PixelRays,
    /// Where a pixel shows an edge.
    fine: PixelRays,
}

/// Some pixels of a row.
#[derive(Clone, Copy)]
struct Strip<'a> {
    y: usize,
    columns: &'a [usize],
}

/// What is known of the pixels of a picture before they are shaded.
struct Known<'a> {
    /// The class that each counts for.
    classes: Option<&'a Plane<u16>>,
    /// Where samples must be finer; unknown for one sample per pixel.
    at_edges: Option<Plane<bool>>,
}

/// Samples of a pixel at an edge, along each axis, for every one of a pixel within a surface.
const EDGE_FACTOR: usize = 3;
/// Normals whose cosine is lower belong to two surfaces, and so do depths further apart than this
/// share of the nearer one.
const SMOOTH: f32 = 0.9;
const DEPTH_STEP: f32 = 0.05;
/// Ratio of the darkest to the brightest sample below which a pixel's mean hangs on where the
/// samples lie.
const EVEN: f32 = 0.7;

/// Whether samples of one pixel show more than one even, smooth surface. Beyond two samples along
/// each axis they find what the four of [`pixels_at_edges`] miss.
fn shows_edge(pixel: &[Point]) -> bool {
    let first = &pixel[0];
    let depths = pixel.iter().fold([f32::INFINITY, 0.0], |d, p| {
        [d[0].min(p.depth), f32::max(d[1], p.depth)]
    });
    let lights = pixel
        .iter()
        .map(|p| luminance(p.radiance))
        .fold([f32::INFINITY, 0.0], |l, x| {
            [l[0].min(x), f32::max(l[1], x)]
        });
    let apart = |p: &Point| match (first.gaze, p.gaze) {
        (Some(a), Some(b)) => a.normal.dot(b.normal) < SMOOTH,
        (None, None) => false,
        _ => true,
    };
    depths[1] > depths[0] * (1.0 + DEPTH_STEP)
        || lights[0] < EVEN * lights[1]
        || pixel.iter().any(|p| p.label != first.label || apart(p))
}

#[derive(Default)]
struct Row {
    radiance: Vec<Vec3>,
    specular: Vec<Vec3>,
    features: Vec<SpecularFeature>,
    albedo: Vec<Vec3>,
    roughness: Vec<f32>,
    metallic: Vec<f32>,
    transmission: Vec<f32>,
    labels: Vec<u16>,
    emission: Vec<Vec3>,
    confidence: Vec<Vec2>,
}

impl Row {
    /// Averages the samples of each pixel; materials only over the samples of the `wanted` class of
    /// its column, or of the most frequent class if there is none.
    fn resolve<'p>(
        pixels: impl Iterator<Item = &'p [Point]>,
        wanted: impl Fn(usize) -> Option<u16>,
    ) -> Self {
        let mut row = Self::default();
        for (x, pixel) in pixels.enumerate() {
            let samples = pixel.len();
            let counts = pixel
                .iter()
                .map(|p| (pixel.iter().filter(|q| q.label == p.label).count(), p.label));
            let frequent = counts.max().map_or(0, |best| best.1);
            let label = wanted(x)
                .filter(|w| pixel.iter().any(|p| p.label == *w))
                .unwrap_or(frequent);
            let same: Vec<&Point> = pixel.iter().filter(|p| p.label == label).collect();
            let share = 1.0 / same.len().max(1) as f32;
            row.radiance
                .push(pixel.iter().map(|p| p.radiance).sum::<Vec3>() / samples as f32);
            row.albedo
                .push(same.iter().map(|p| p.albedo).sum::<Vec3>() * share);
            row.roughness
                .push(same.iter().map(|p| p.roughness).sum::<f32>() * share);
            row.metallic
                .push(same.iter().map(|p| p.metallic).sum::<f32>() * share);
            row.transmission
                .push(same.iter().map(|p| p.transmission).sum::<f32>() * share);
            row.labels.push(label);
            row.specular
                .push(pixel.iter().map(|p| p.specular).sum::<Vec3>() / samples as f32);
            // only what reflects counts: a sample beside the geometry has no distance
            let seen: Vec<(Vec3, f32)> = same
                .iter()
                .filter_map(|p| p.gaze.map(|g| (g.normal, p.depth)))
                .collect();
            row.features.push(SpecularFeature {
                normal: seen.iter().map(|s| s.0).sum::<Vec3>().normalize_or_zero(),
                depth: seen.iter().map(|s| s.1).sum::<f32>() / seen.len().max(1) as f32,
                label,
                roughness: same.iter().map(|p| p.roughness).sum::<f32>() * share,
            });
            // a label must not tell which pixels emit
            let most: Vec<Vec3> = pixel
                .iter()
                .filter(|p| p.label == frequent)
                .map(|p| p.emission)
                .collect();
            row.emission
                .push(most.iter().sum::<Vec3>() / most.len().max(1) as f32);
            // errors of neighbouring texels go together: their root mean square, not that of
            // independent ones
            let square = same
                .iter()
                .map(|p| p.confidence * p.confidence)
                .sum::<Vec2>()
                * share;
            row.confidence
                .push(Vec2::new(square.x.sqrt(), square.y.sqrt()));
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_what_shows_two_surfaces_or_uneven_light() {
        let gaze = |n: Vec3| {
            Some(ShadingPoint {
                position: Vec3::ZERO,
                normal: n,
                face_normal: n,
                view: n,
                key: 0,
                turn: 0,
            })
        };
        let wall = Point {
            label: 1,
            depth: 2.0,
            radiance: Vec3::ONE,
            gaze: gaze(Vec3::Z),
            ..Point::default()
        };
        let sky = Point {
            depth: f32::INFINITY,
            ..Point::default()
        };
        assert!(!shows_edge(&[wall; 4]) && !shows_edge(&[sky; 4]));
        let others = [
            Point { label: 2, ..wall },
            Point { depth: 2.2, ..wall },
            Point {
                radiance: Vec3::splat(0.5),
                ..wall
            },
            Point {
                gaze: gaze(Vec3::X),
                ..wall
            },
            sky,
        ];
        assert!(others.iter().all(|o| shows_edge(&[wall, wall, *o, wall])));
    }

    /// A smooth floor under an even environment of 2, of an irradiance.
    fn lit_by_two(irradiance: f32) -> Solution {
        let mut solution = crate::solution::tests::small_solution();
        solution.emission.data.fill(Vec3::ZERO);
        solution.roughness.data.fill(0.1);
        solution.environment.data.fill(Vec3::splat(2.0));
        solution.irradiance.data.fill(Vec3::splat(irradiance));
        solution
    }

    /// What a camera sees straight below: mean radiance, and the share of transmitted light.
    fn seen_below(solution: &Solution, options: HybridOptions) -> (Vec3, f32) {
        let camera = Camera {
            projection: crate::core::geometry::Projection::Equirectangular,
            width: 8,
            height: 32,
            world_from_camera: glam::Mat3::IDENTITY,
            position: Vec3::new(0.0, 1.1, 0.7),
        };
        let view = HybridRenderer::new(solution, options)
            .expect("embree")
            .render(&camera)
            .expect("renders");
        let row = &view.radiance.data[31 * 8..];
        let mean = row.iter().sum::<Vec3>() / row.len() as f32;
        (mean, view.transmission.data[31 * 8])
    }

    /// Under an even environment L a smooth metal shows F0·L head-on, whatever irradiance the
    /// textures hold; half a metal, its share of both lobes.
    #[test]
    fn metal_mirrors_its_colour_and_has_no_diffuse_part() {
        let mut solution = lit_by_two(300.0);
        let f0 = Vec3::new(0.91, 0.78, 0.42);
        solution.albedo.data.fill(f0);
        let shown = |metallic: Option<f32>| {
            let mut solution = solution.clone();
            solution.metallic = metallic.map(|m| solution.albedo.map(|_| m));
            let options = HybridOptions {
                specular_rays: 64,
                ..HybridOptions::default()
            };
            seen_below(&solution, options).0
        };
        let close = |shown: Vec3, expected: Vec3| {
            let off = (shown / expected - 1.0).abs().max_element();
            assert!(off < 0.02, "{shown} instead of {expected}");
        };
        close(shown(Some(1.0)), 2.0 * f0);
        let diffuse = f0 * 300.0 * FRAC_1_PI * solution.reflectance.diffuse_factor(1.0, 0.1);
        close(shown(Some(0.5)), 0.5 * diffuse + (f0 + 0.04));
        assert_eq!(shown(None), shown(Some(0.0)), "no metal, to the bit");
    }

    /// Through a pane an even environment L shows t · tint · (1 − F) of itself beside what a black
    /// sheet reflects of it; the rest t leaves of the diffuse light is there too.
    #[test]
    fn a_pane_shows_what_is_behind_it() {
        let solution = lit_by_two(2.0);
        let tint = Vec3::new(0.9, 0.95, 0.8);
        let shown = |colour: Vec3, transmission: Option<f32>| {
            let mut solution = solution.clone();
            solution.albedo.data.fill(colour);
            solution.transmission = transmission.map(|t| solution.albedo.map(|_| t));
            let (shown, stated) = seen_below(&solution, HybridOptions::default());
            assert!(
                (stated - transmission.unwrap_or(0.0)).abs() < 1e-5,
                "{stated}"
            );
            shown
        };
        let close = |shown: Vec3, expected: Vec3| {
            let off = (shown / expected - 1.0).abs().max_element();
            assert!(off < 0.01, "{shown} instead of {expected}");
        };
        let reflected = shown(Vec3::ZERO, None);
        close(shown(tint, Some(1.0)), reflected + 2.0 * 0.96 * tint);
        let diffuse = tint * 2.0 * FRAC_1_PI * solution.reflectance.diffuse_factor(1.0, 0.1);
        close(
            shown(tint, Some(0.25)),
            reflected + 0.25 * 2.0 * 0.96 * tint + 0.75 * diffuse,
        );
        assert_eq!(
            shown(tint, None),
            shown(tint, Some(0.0)),
            "no pane, to the bit"
        );
    }

    #[test]
    fn a_pixel_shows_the_material_of_its_class_where_it_shows_any() {
        let point = |label, albedo: f32| Point {
            label,
            albedo: Vec3::splat(albedo),
            roughness: albedo,
            ..Point::default()
        };
        let lamp = Point {
            label: 3,
            emission: Vec3::ONE,
            ..Point::default()
        };
        // two samples of each class, a pixel of which a lamp has a quarter, and one without the
        // class asked for
        let pixels = [
            [point(1, 0.2), point(1, 0.4), point(2, 0.8), point(2, 0.9)],
            [point(1, 0.2), point(1, 0.4), point(1, 0.6), lamp],
            [point(2, 0.8); 4],
        ];
        let points: Vec<Point> = pixels.into_iter().flatten().collect();
        let row = Row::resolve(points.chunks(4), |x| Some([1, 3, 1][x]));
        assert_eq!(row.labels, [1, 3, 2]);
        for (got, want) in row.roughness.iter().zip([0.3, 0.0, 0.8]) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
        assert_eq!(
            row.emission,
            [Vec3::ZERO; 3],
            "its label must not make a pixel emit"
        );
        let row = Row::resolve(points.chunks(4), |_| None);
        assert_eq!(row.labels[1..], [1, 2]);
        assert!((row.albedo[1].x - 0.4).abs() < 1e-6);
    }
}
