//! Albedo of texels that no view sees clean: thin bars, leaves, fringes, everything at edges.
//!
//! A pixel at an edge shows several surfaces at once. How much of each is known from the mesh, so
//! such pixels are linear equations in the albedos of the texels they cover: I = Σ w E A / π + what
//! is known (specular parts, lamps, sky, texels seen clean elsewhere). The equations of all views
//! are solved together for the texels without a clean look, by conjugate gradients on the normal
//! equations, with the albedo of clean texels of the same class nearby as the prior. Residuals
//! beyond the noise lose weight (Cauchy), and where the equations as a whole fit badly (mesh or
//! poses are off) their noise is taken to be what they show, so that the prior decides.

use super::class_prior::{Expected, Ground, LEAST_SPREAD, NEAR, class_prior};
use super::robust_cg::{Pixel, RobustSystem};
use super::{AlbedoEstimate, TexelReflectance};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::{facing, luminance};
use crate::core::parallel;
use crate::core::texture::Texels;
use crate::core::trace::{Hit, Tracer};
use crate::gbuffer::{Observer, Orientation, PixelRays};
use crate::radiance::LightField;
use glam::{Vec2, Vec3};
use std::collections::HashMap;
use std::f32::consts::{FRAC_1_PI, PI};

/// Rays per pixel along each axis. Measured: 4 change albedo and views by 0.03 dB at most (docs/lab/albedo.md).
const GRID: usize = 3;
/// Terms kept in memory at most; beyond it pixels are skipped evenly. Derived: a GiB of 16 bytes each.
pub const MOST_TERMS: usize = 64 << 20;
/// Error of coverage from `GRID`² rays, as a share of the contrast within the pixel; a texel seen at edges alone is as
/// uncertain. Derived: the mean of √(p (1 − p)) / `GRID` over shares p.
pub(super) const COVERAGE_ERROR: f32 = PI / 8.0 / GRID as f32;

/// What the equations are made from.
pub struct MixedPixelSolver<'a> {
    /// The views.
    pub observer: Observer<'a>,
    /// Side of each triangle the cameras see.
    pub orientation: &'a Orientation,
    /// Visibility.
    pub tracer: &'a dyn Tracer,
    /// Lamps, sky and far sides.
    pub field: &'a LightField,
    /// Covered texels of the albedo atlas.
    pub texels: &'a Texels,
    /// Class per texel.
    pub labels: &'a [u16],
    /// Room per texel.
    pub rooms: &'a [u16],
    /// Irradiance per texel.
    pub irradiance: &'a [Vec3],
    /// Specular radiance at the pixel centres of every view.
    pub specular: &'a [RgbPlane],
    /// How texels reflect; where no pixel tells, their specular part is that in even light.
    pub reflectance: &'a TexelReflectance,
    /// Texels without a clean look whose albedo is known all the same, ascending.
    pub settled: &'a [u32],
    /// Pixels of every view that are no look at the material and show at least what they show: the
    /// sensor's ceiling. None where a view has none, or no view has.
    pub bounds: &'a [Option<Plane<bool>>],
}

/// How many equations and unknowns there were, and how well they fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MixedPixelReport {
    /// Pixels at edges that were used.
    pub pixels: usize,
    /// Texels solved for.
    pub texels: usize,
    /// Factor by which the residuals exceed the noise assumed, at least 1.
    pub misfit: f32,
    /// Rays traced.
    pub rays: u64,
}

const KNOWN: u32 = u32::MAX;
/// Rays per pixel.
const SAMPLES: usize = GRID * GRID;

/// What the equations are written with besides the scene.
struct State<'a> {
    albedo: &'a AlbedoEstimate,
    /// Unknown of every texel, or [`KNOWN`].
    unknown: &'a [u32],
    /// E/π per unknown.
    light: &'a [Vec3],
    /// First guess per unknown.
    start: &'a [Vec3],
    /// Covered texel of every cell of the atlas, or [`KNOWN`].
    cells: Plane<u32>,
    /// Rays through the pixels of every view.
    rays: Vec<PixelRays>,
    /// Of so many pixels one is used.
    stride: usize,
}

/// What a pixel shows.
struct Observed {
    radiance: Vec3,
    /// At least that.
    is_bound: bool,
}

/// A pixel of a view.
#[derive(Clone, Copy)]
struct ViewPixel {
    v: usize,
    at: (usize, usize),
}

impl MixedPixelSolver<'_> {
    /// Replaces the values of texels without a clean look in `albedo`.
    pub fn solve(&self, albedo: &mut AlbedoEstimate) -> MixedPixelReport {
        let texels = self.texels;
        let ids: Vec<u32> = (0..texels.len())
            .filter(|&i| {
                !albedo.clean[i]
                    && !self.field.is_emissive(texels.point[i].triangle as usize)
                    && self.settled.binary_search(&(i as u32)).is_err()
            })
            .map(|i| i as u32)
            .collect();
        if ids.is_empty() {
            return MixedPixelReport::default();
        }
        let (unknown, sizes) = self.patches(albedo, &ids);
        let mean_over = |of: &dyn Fn(usize, usize) -> Vec3| {
            let mut sum = vec![Vec3::ZERO; sizes.len()];
            for (k, &i) in ids.iter().enumerate() {
                sum[unknown[i as usize] as usize] += of(k, i as usize);
            }
            sum.into_iter()
                .zip(&sizes)
                .map(|(s, n)| s / *n as f32)
                .collect::<Vec<Vec3>>()
        };
        let ground = Ground {
            texels,
            mesh: self.observer.mesh,
            labels: self.labels,
            rooms: self.rooms,
        };
        let expected = class_prior(albedo, &ground, &ids, &|_| 1.0);
        let mean = mean_over(&|k, _| expected[k].mean);
        let variance = mean_over(&|k, _| Vec3::splat(expected[k].variance));
        let prior: Vec<Expected> = mean
            .into_iter()
            .zip(variance)
            .map(|(mean, v)| Expected {
                mean,
                variance: v.x,
            })
            .collect();
        let light = mean_over(&|_, i| self.irradiance[i] * FRAC_1_PI);
        let start = mean_over(&|k, i| {
            if albedo.error[i].is_finite() {
                albedo.value[i].clamp(Vec3::ZERO, Vec3::ONE)
            } else {
                expected[k].mean
            }
        });
        let (equations, rays) = self.equations(albedo, &unknown, &light, &start);
        let solved = equations.solve(&light, &prior, start);
        for &i in &ids {
            let (i, u) = (i as usize, unknown[i as usize] as usize);
            albedo.value[i] = solved.albedo[u];
            if albedo.error[i].is_finite() {
                albedo.error[i] = solved.precision[u].sqrt().recip();
            }
        }
        MixedPixelReport {
            pixels: equations.pixel.len(),
            texels: ids.len(),
            misfit: solved.misfit,
            rays,
        }
    }

    /// The unknowns: pieces of surface about as large as the sharpest pixel that sees them, of one
    /// class and one main direction, within what counts as near. Texels may be far smaller, and most of those would lie between
    /// the rays. Unknown of every texel, and the texels of every unknown.
    fn patches(&self, albedo: &AlbedoEstimate, ids: &[u32]) -> (Vec<u32>, Vec<u32>) {
        let (texels, mesh) = (self.texels, self.observer.mesh);
        let mut unknown = vec![KNOWN; texels.len()];
        let mut sizes = Vec::new();
        let mut known: HashMap<(u16, u8, u32, u32, u32), u32> = HashMap::new();
        for &i in ids {
            let i = i as usize;
            let t = texels.point[i].triangle as usize;
            let normal = mesh.face_normal(t) * self.orientation.sign(t);
            let side = facing(normal);
            let texel = texels.texel_area(mesh, t).sqrt().max(f32::MIN_POSITIVE);
            let level = ((albedo.footprint[i] / texel)
                .max(0.5)
                .log2()
                .ceil()
                .min(NEAR.log2() - 1.0) as i32
                + 1) as u32;
            let (x, y) = (
                texels.cell[i] % texels.width as u32,
                texels.cell[i] / texels.width as u32,
            );
            let next = sizes.len() as u32;
            let u = *known
                .entry((self.labels[i], side, level, x >> level, y >> level))
                .or_insert(next);
            if u == next {
                sizes.push(0);
            }
            sizes[u as usize] += 1;
            unknown[i] = u;
        }
        (unknown, sizes)
    }

    fn equations(
        &self,
        albedo: &AlbedoEstimate,
        unknown: &[u32],
        light: &[Vec3],
        start: &[Vec3],
    ) -> (RobustSystem, u64) {
        let edges: usize = self
            .observer
            .views
            .iter()
            .map(|v| v.clean.data.iter().filter(|c| !**c).count())
            .sum();
        let stride = edges * SAMPLES / MOST_TERMS + 1;
        let state = State {
            albedo,
            unknown,
            light,
            start,
            cells: self.texels.numbers(),
            rays: (self.observer.views.iter())
                .map(|v| PixelRays::new(&v.buffer.camera, GRID))
                .collect(),
            stride,
        };
        let rows: Vec<(usize, usize)> = self
            .observer
            .views
            .iter()
            .enumerate()
            .flat_map(|(v, view)| (0..view.clean.height).map(move |y| (v, y)))
            .collect();
        let parts = parallel::map_chunks(rows.len(), 4, |range| {
            let mut out = RobustSystem::default();
            let mut rays = 0;
            for &(v, y) in &rows[range] {
                rays += self.row(v, y, &state, &mut out);
            }
            (out, rays)
        });
        let (mut all, mut rays) = (RobustSystem::default(), 0);
        for (p, r) in parts {
            let base = all.term.len();
            all.pixel.extend(p.pixel);
            all.end.extend(p.end.iter().map(|e| base + e));
            all.term.extend(p.term);
            rays += r;
        }
        (all, rays)
    }

    /// Appends the equations of the edge pixels in row `y` of view `v`.
    fn row(&self, v: usize, y: usize, state: &State, out: &mut RobustSystem) -> u64 {
        let view = &self.observer.views[v];
        let is_valid = |x: usize| view.valid.as_ref().is_none_or(|m| m[(x, y)]);
        // a clean pixel tells of unknowns too where a texel's look was too far off its centre to be
        // clean
        let shows_unknown = |x: usize| {
            let t = view.buffer.triangle[(x, y)];
            if t == Hit::MISS {
                return false;
            }
            let (u, v) = self
                .observer
                .mesh
                .barycentrics(t as usize, view.buffer.position(x, y));
            let texel = self.texel(&state.cells, t, u, v);
            texel != KNOWN && state.unknown[texel as usize] != KNOWN
        };
        let bounds = self.bounds.get(v).and_then(Option::as_ref);
        let is_bound = |x: usize| bounds.is_some_and(|b| b[(x, y)]);
        let usable = |x: usize| {
            (!view.clean[(x, y)] || shows_unknown(x))
                && (is_valid(x) || is_bound(x))
                && view.radiance[(x, y)].is_finite()
                && (x + 7 * y).is_multiple_of(state.stride)
        };
        let columns: Vec<usize> = (0..view.clean.width).filter(|&x| usable(x)).collect();
        let rays = state.rays[v].of_row(y, columns.iter().copied());
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        for (k, &x) in columns.iter().enumerate() {
            let samples = k * SAMPLES..(k + 1) * SAMPLES;
            let shown = rays[samples.clone()]
                .iter()
                .zip(&hits[samples])
                .map(|(ray, hit)| {
                    let direction = Vec3::from_array(ray.direction);
                    self.shown(ViewPixel { v, at: (x, y) }, direction, hit, &state.cells)
                });
            let observed = Observed {
                radiance: view.radiance[(x, y)],
                is_bound: is_bound(x),
            };
            self.equation(shown, observed, state, out);
        }
        rays.len() as u64
    }

    /// Appends the equation of one pixel whose rays show `shown`: what is known moves to the right
    /// side, each unknown gets the sum of its weights.
    fn equation(
        &self,
        shown: impl Iterator<Item = Shown>,
        observed: Observed,
        state: &State,
        out: &mut RobustSystem,
    ) {
        let begin = out.term.len();
        let mut known = Vec3::ZERO;
        let (mut sum, mut square) = (0.0, 0.0);
        for shown in shown {
            let radiance = match shown {
                Shown::Radiance(l) => {
                    known += l / SAMPLES as f32;
                    l
                }
                Shown::Texel {
                    texel,
                    factor,
                    specular,
                } => {
                    let weight = factor / SAMPLES as f32;
                    known += specular / SAMPLES as f32;
                    match state.unknown[texel] {
                        KNOWN => {
                            let l = self.irradiance[texel]
                                * FRAC_1_PI
                                * state.albedo.value[texel]
                                * factor;
                            known += l / SAMPLES as f32;
                            l + specular
                        }
                        u => {
                            let mean = luminance(state.light[u as usize]).max(f32::MIN_POSITIVE);
                            let weight =
                                weight * luminance(self.irradiance[texel]) * FRAC_1_PI / mean;
                            match out.term[begin..].iter_mut().find(|t| t.0 == u) {
                                Some(t) => t.1 += weight,
                                None => out.term.push((u, weight)),
                            }
                            state.light[u as usize] * state.start[u as usize] * factor + specular
                        }
                    }
                }
            };
            sum += luminance(radiance);
            square += luminance(radiance).powi(2);
        }
        if out.term.len() == begin || !known.is_finite() {
            out.term.truncate(begin);
            return;
        }
        let mean = sum / SAMPLES as f32;
        let contrast2 = (square / SAMPLES as f32 - mean * mean).max(0.0);
        let level = luminance(observed.radiance).max(mean);
        let variance =
            (LEAST_SPREAD * level).powi(2) + COVERAGE_ERROR.powi(2) * contrast2 + f32::MIN_POSITIVE;
        out.pixel.push(Pixel {
            rest: observed.radiance - known,
            variance,
            is_bound: observed.is_bound,
        });
        out.end.push(out.term.len());
    }

    /// The covered texel at a surface point.
    fn texel(&self, cells: &Plane<u32>, triangle: u32, u: f32, v: f32) -> u32 {
        *cells.nearest(
            self.observer.mesh.uv(triangle as usize, u, v)
                * Vec2::new(cells.width as f32, cells.height as f32),
        )
    }

    /// What one ray through a pixel shows.
    fn shown(&self, pixel: ViewPixel, direction: Vec3, hit: &Hit, cells: &Plane<u32>) -> Shown {
        let (mesh, view) = (self.observer.mesh, &self.observer.views[pixel.v]);
        let t = hit.triangle as usize;
        if hit.triangle == Hit::MISS || self.field.is_emissive(t) {
            return Shown::Radiance(self.field.arriving(hit, direction, 0.0));
        }
        let normal = mesh.face_normal(t) * self.orientation.sign(t);
        let n_v = -normal.dot(direction);
        let texel = self.texel(cells, hit.triangle, hit.u, hit.v);
        if n_v <= 0.0 || texel == KNOWN {
            return Shown::Radiance(self.field.arriving(hit, direction, 0.0));
        }
        let texel = texel as usize;
        let position = view.buffer.camera.position + direction * hit.t;
        let specular = self
            .specular_near(pixel, position, normal)
            .unwrap_or_else(|| {
                self.reflectance
                    .even_specular(texel, n_v, self.irradiance[texel])
            });
        let factor = self.reflectance.diffuse_factor(texel, n_v);
        Shown::Texel {
            texel,
            factor,
            specular,
        }
    }

    /// Specular radiance at the pixel centre around `pixel` that sees the same surface nearest to
    /// `position`.
    fn specular_near(&self, pixel: ViewPixel, position: Vec3, normal: Vec3) -> Option<Vec3> {
        let ViewPixel { v, at } = pixel;
        let b = &self.observer.views[v].buffer;
        let (w, h) = (b.triangle.width as i64, b.triangle.height as i64);
        let mut best: Option<(f32, (usize, usize))> = None;
        for dy in -1..=1 {
            for dx in -1..=1 {
                let (x, y) = (at.0 as i64 + dx, at.1 as i64 + dy);
                let x = if b.wrap() == Wrap::Repeat {
                    x.rem_euclid(w)
                } else {
                    x
                };
                if x < 0 || x >= w || y < 0 || y >= h {
                    continue;
                }
                let x = x as usize;
                let t = b.triangle[(x, y as usize)];
                if t == Hit::MISS {
                    continue;
                }
                let other =
                    self.observer.mesh.face_normal(t as usize) * self.orientation.sign(t as usize);
                if other.dot(normal) < 0.9 {
                    continue;
                }
                let step = b.position(x, y as usize) - position;
                let d = step.length();
                if normal.dot(step).abs() < 0.2 * d + 1e-4 * b.distance[(x, y as usize)]
                    && best.is_none_or(|m| d < m.0)
                {
                    best = Some((d, (x, y as usize)));
                }
            }
        }
        best.map(|(_, p)| self.specular[v][p])
    }
}

/// What a ray shows: a radiance, or a texel's diffuse part `factor · E · A / π` and its specular
/// radiance.
enum Shown {
    Radiance(Vec3),
    Texel {
        texel: usize,
        factor: f32,
        specular: Vec3,
    },
}
