//! The specular response of evidence points in every view that sees them, traced once (method §12.3
//! point 6).
//!
//! A point seen from several views pins down roughness without knowing its albedo or irradiance:
//! its diffuse radiance is the same in all views, so whatever differs between them must be the
//! specular part.

use super::{Candidate, LOBES};
use crate::core::blocks::{Columns, Packed, column, values};
use crate::core::brdf::{DIELECTRIC, Reflectance, SpecularLobe};
use crate::core::image::bilinear_taps;
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::sampling::{SobolSequence, hash_u64};
use crate::core::stats::median;
use crate::core::trace::{Hit, Ray};
use crate::gbuffer::{Observation, Observer, ViewBuffer};
use crate::lights::LitScene;
use crate::observed::Surface;
use crate::specular::{Levels, Reflector, ShadingPoint};
use glam::{Vec2, Vec3};
use std::ops::Range;

/// A point and its range in [`Evidence::sights`].
#[derive(Clone, Copy, Debug)]
pub struct EvidencePoint {
    /// Class id.
    pub class: u16,
    /// Triangle.
    pub triangle: u32,
    /// Position.
    pub position: Vec3,
    /// First sight.
    pub first: u32,
    /// Number of sights, at least two.
    pub count: u32,
    /// Number of sights behind those that are lower bounds: photographs clip the brightest part of a
    /// highlight.
    pub bounds: u32,
}

/// One view's look at an evidence point.
#[derive(Clone, Copy, Debug)]
pub struct ViewSample {
    /// View index.
    pub view: u32,
    /// Observed radiance.
    pub radiance: Vec3,
    /// Cosine between shading normal and view direction.
    pub n_v: f32,
    /// Relative weight: sharp, frontal views count more.
    pub weight: f32,
}

/// Evidence points, their sights, and per sight the specular radiance at every level of a table.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Roughness levels of the table, ascending.
    pub levels: Vec<f32>,
    /// Lobes of the table.
    pub lobes: [SpecularLobe; 2],
    /// Points.
    pub points: Vec<EvidencePoint>,
    /// Sights of all points, point by point.
    pub sights: Vec<ViewSample>,
    /// `sights.len() × lobes.len() × levels.len()` specular radiances: means of two independent
    /// estimates.
    pub specular: Vec<Vec3>,
    /// Half the difference of the luminance of the two estimates: what the mean is off by, but for
    /// its sign.
    pub noise: Vec<f32>,
    /// Per sight Burley's diffuse radiance over Lambert's in the light that arrives, as a
    /// polynomial in the roughness.
    pub diffuse: Vec<[f32; 3]>,
    /// Rays traced.
    pub rays: u64,
}

impl Default for Evidence {
    fn default() -> Self {
        Self {
            levels: Vec::new(),
            lobes: DIELECTRICS,
            points: Vec::new(),
            sights: Vec::new(),
            specular: Vec::new(),
            noise: Vec::new(),
            diffuse: Vec::new(),
            rays: 0,
        }
    }
}

impl Evidence {
    /// Takes over the points of `more`, tabulated for the same lobes and levels, behind its own.
    pub fn append(&mut self, more: Self) {
        let base = self.sights.len() as u32;
        self.points
            .extend(more.points.into_iter().map(|q| EvidencePoint {
                first: q.first + base,
                ..q
            }));
        self.sights.extend(more.sights);
        self.specular.extend(more.specular);
        self.noise.extend(more.noise);
        self.diffuse.extend(more.diffuse);
        self.rays += more.rays;
    }

    /// Diffuse radiance of sight `s` over that of a Lambertian surface in the same light.
    #[must_use]
    pub fn diffuse_factor(&self, s: usize, model: Reflectance, roughness: f32) -> f32 {
        if model == Reflectance::Burley {
            Reflectance::diffuse_at(self.diffuse[s], roughness)
        } else {
            1.0
        }
    }

    /// The level nearest to a roughness.
    #[must_use]
    pub fn nearest_level(&self, roughness: f32) -> usize {
        let away = |k: &usize| (self.levels[*k] - roughness).abs();
        (0..self.levels.len())
            .min_by(|a, b| away(a).total_cmp(&away(b)))
            .unwrap_or(0)
    }

    /// Median luminance of some sights, above 0: what their errors are relative to.
    #[must_use]
    pub fn median_luminance(&self, sights: impl Iterator<Item = usize>) -> f32 {
        let bright = |j: usize| luminance(self.sights[j].radiance);
        median(sights.map(bright).collect())
            .unwrap_or(0.0)
            .max(1e-9)
    }

    /// Which of the lobes is that of a dielectric under a model (0 if none is: its answers would
    /// mean nothing).
    #[must_use]
    pub fn dielectric(&self, model: Reflectance) -> usize {
        let masking = |m: Reflectance| m == Reflectance::Paper;
        let is = |l: &SpecularLobe| l.f0 == DIELECTRIC && masking(l.model) == masking(model);
        self.lobes.iter().position(is).unwrap_or(0)
    }

    /// Specular radiance of sight `s` at all levels of its `m`-th lobe.
    #[must_use]
    pub fn response(&self, s: usize, m: usize) -> &[Vec3] {
        &self.specular[self.row(s, m)]
    }

    /// What the luminance of [`Self::response`] is off by, but for its sign.
    #[must_use]
    pub fn noise(&self, s: usize, m: usize) -> &[f32] {
        &self.noise[self.row(s, m)]
    }

    /// Takes the responses and diffuse factors of [`FOOTPRINT`] gazes per sight, `row` responses
    /// each.
    fn fill(&mut self, specular: &[Vec3], diffuse: &[[f32; 3]], row: usize) {
        for sight in specular.chunks_exact(FOOTPRINT * row) {
            for k in 0..row {
                let mean = |from: usize| {
                    (from..from + HALF)
                        .map(|g| sight[g * row + k])
                        .sum::<Vec3>()
                        / HALF as f32
                };
                let [a, b] = [mean(0), mean(HALF)];
                self.specular.push(0.5 * (a + b));
                self.noise.push(0.5 * luminance(a - b));
            }
        }
        let mean = |of: &[[f32; 3]]| {
            std::array::from_fn(|c| of.iter().map(|d| d[c]).sum::<f32>() / FOOTPRINT as f32)
        };
        self.diffuse
            .extend(diffuse.chunks_exact(FOOTPRINT).map(mean));
    }

    fn row(&self, s: usize, m: usize) -> Range<usize> {
        let n = self.levels.len();
        (s * self.lobes.len() + m) * n..(s * self.lobes.len() + m + 1) * n
    }
}

impl Packed for Evidence {
    fn columns(&self) -> Columns {
        let of_points =
            |f: fn(&EvidencePoint) -> u32| -> Vec<u32> { self.points.iter().map(f).collect() };
        let of_sights =
            |f: fn(&ViewSample) -> f32| -> Vec<f32> { self.sights.iter().map(f).collect() };
        let positions: Vec<Vec3> = self.points.iter().map(|p| p.position).collect();
        let views: Vec<u32> = self.sights.iter().map(|s| s.view).collect();
        let radiance: Vec<Vec3> = self.sights.iter().map(|s| s.radiance).collect();
        vec![
            column(&of_points(|p| p.class.into())),
            column(&of_points(|p| p.triangle)),
            column(&positions),
            column(&of_points(|p| p.first)),
            column(&of_points(|p| p.count)),
            column(&of_points(|p| p.bounds)),
            column(&views),
            column(&radiance),
            column(&of_sights(|s| s.n_v)),
            column(&of_sights(|s| s.weight)),
            column(&self.levels),
            column(&self.specular),
            column(&self.noise),
            column(&self.diffuse),
            column(&[self.rays]),
            column(&self.lobes.map(|l| l.model as u32)),
            column(&self.lobes.map(|l| l.f0)),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [class, triangle, position, spans @ ..] = columns else {
            return None;
        };
        let [first, count, bounds, sights @ ..] = spans else {
            return None;
        };
        let [view, radiance, n_v, weight, tables @ ..] = sights else {
            return None;
        };
        let [levels, specular, noise, diffuse, rays, models, f0] = tables else {
            return None;
        };
        let (models, f0): (Vec<u32>, Vec<Vec3>) = (values(models)?, values(f0)?);
        let lobe = |(m, f0): (&u32, &Vec3)| {
            let model = *Reflectance::ALL.get(*m as usize)?;
            Some(SpecularLobe { model, f0: *f0 })
        };
        let lobes: Option<Vec<SpecularLobe>> = models.iter().zip(&f0).map(lobe).collect();
        let (class, triangle): (Vec<u32>, Vec<u32>) = (values(class)?, values(triangle)?);
        let (first, count): (Vec<u32>, Vec<u32>) = (values(first)?, values(count)?);
        let bounds: Vec<u32> = values(bounds)?;
        let position: Vec<Vec3> = values(position)?;
        let point = |i: usize| {
            Some(EvidencePoint {
                class: u16::try_from(class[i]).ok()?,
                triangle: *triangle.get(i)?,
                position: *position.get(i)?,
                first: *first.get(i)?,
                count: *count.get(i)?,
                bounds: *bounds.get(i)?,
            })
        };
        let (view, radiance): (Vec<u32>, Vec<Vec3>) = (values(view)?, values(radiance)?);
        let (n_v, weight): (Vec<f32>, Vec<f32>) = (values(n_v)?, values(weight)?);
        let sight = |i: usize| {
            Some(ViewSample {
                view: view[i],
                radiance: *radiance.get(i)?,
                n_v: *n_v.get(i)?,
                weight: *weight.get(i)?,
            })
        };
        Some(Self {
            points: (0..class.len()).map(point).collect::<Option<_>>()?,
            sights: (0..view.len()).map(sight).collect::<Option<_>>()?,
            levels: values(levels)?,
            lobes: lobes?.try_into().ok()?,
            specular: values(specular)?,
            noise: values(noise)?,
            diffuse: values(diffuse)?,
            rays: *values(rays)?.first()?,
        })
    }
}

/// Lobes to choose the reflection model by: the masking terms. Diffuse parts need no rays.
pub const DIELECTRICS: [SpecularLobe; 2] = [
    SpecularLobe::dielectric(Reflectance::Paper),
    SpecularLobe::dielectric(Reflectance::Smith),
];

/// How finely responses are tabulated.
#[derive(Clone, Copy, Debug)]
pub struct Tabulation<'a> {
    /// Roughness levels, ascending.
    pub levels: &'a [f32],
    /// Lobes tabulated at each.
    pub lobes: [SpecularLobe; 2],
    /// Rays for each of [`LOBES`], spread over 16 places of the pixel: the next multiple of that.
    pub rays_per_lobe: u32,
}

/// Points of a pixel's footprint that a sight is traced from, an even number: a pixel on a curved
/// surface mirrors many directions.
const FOOTPRINT: usize = 16;
const HALF: usize = FOOTPRINT / 2;
/// Pixels' footprints beyond which a place of the image shows another surface.
const REACH: f32 = 2.5;

/// Observes every candidate in all views and traces its specular response as `tabulation` says;
/// candidates with fewer than two clean sights are dropped.
#[must_use]
pub fn gather_evidence(
    lit: &LitScene,
    surface: &Surface,
    candidates: &[Candidate],
    tabulation: Tabulation,
    seed: u64,
    progress: &Progress,
) -> Evidence {
    const CHUNK: usize = 64;
    // tasks per block that processes share. Derived: at 6 looks a point, 16 gazes and 6 lobes of 8 rays
    // each, some 10^5 rays: a tenth of a second
    const BLOCK: usize = 1;
    let observer = surface.observer();
    let rays_per_lobe = tabulation.rays_per_lobe.div_ceil(FOOTPRINT as u32);
    let reflector = Reflector {
        lit,
        rays_per_lobe,
        emitter_samples: rays_per_lobe * 12 / 5,
        model: Reflectance::Paper,
        seed,
    };
    let parts = progress.map_chunks(candidates.len(), CHUNK, BLOCK, |range| {
        let mut out = Observed::default();
        let mut seen: Vec<Observation> = Vec::new();
        for i in range.clone() {
            out.push(surface, &observer, (i, &candidates[i]), &mut seen);
        }
        let evidence = out.trace(surface, &reflector, tabulation);
        progress.advance(range.len() as u64);
        evidence
    });
    let mut all = Evidence {
        levels: tabulation.levels.to_vec(),
        lobes: tabulation.lobes,
        ..Evidence::default()
    };
    parts.into_iter().for_each(|p| all.append(p));
    all
}

/// Candidates that were observed, and the footprints of their sights.
#[derive(Default)]
struct Observed {
    evidence: Evidence,
    footprints: Footprints,
}

impl Observed {
    /// Adds candidate `c`, the `i`th of all, with the views that see it clean, if they are two at
    /// least, and those that bound it; `seen` is room for them.
    fn push(
        &mut self,
        surface: &Surface,
        observer: &Observer,
        (i, c): (usize, &Candidate),
        seen: &mut Vec<Observation>,
    ) {
        let (normal, face_normal) = surface.normals_at(c.triangle, c.position);
        observer.observe(c.position, face_normal, seen);
        seen.retain(|o| o.clean && o.n_v > 0.12);
        let count = seen.len();
        if count < 2 {
            return;
        }
        if !surface.bounds.is_empty() {
            let bound = |view, pixel| surface.is_clean_bound(view, pixel);
            observer.observe_at(bound, c.position, face_normal, seen);
            seen.retain(|o| o.n_v > 0.12);
        }
        self.evidence.points.push(EvidencePoint {
            class: c.class,
            triangle: c.triangle,
            position: c.position,
            first: self.evidence.sights.len() as u32,
            count: count as u32,
            bounds: (seen.len() - count) as u32,
        });
        for o in seen.iter() {
            let buffer = &observer.views[o.view as usize].buffer;
            let view = (buffer.camera.position - c.position).normalize_or(normal);
            self.evidence.sights.push(ViewSample {
                view: o.view,
                radiance: o.radiance,
                n_v: normal.dot(view),
                weight: (o.n_v / o.footprint).sqrt(),
            });
            let key = hash_u64(hash_u64(u64::from(o.view), u64::from(c.triangle)), i as u64);
            let centre = ShadingPoint {
                position: c.position,
                normal,
                face_normal,
                view,
                key,
                turn: 0,
            };
            self.footprints.push(buffer, o, centre);
        }
    }

    /// Traces the specular responses of all sights.
    fn trace(self, surface: &Surface, reflector: &Reflector, table: Tabulation) -> Evidence {
        let gazes = self.footprints.gazes(reflector.lit, surface);
        let row = table.lobes.len() * table.levels.len();
        let mut specular = vec![Vec3::ZERO; gazes.len() * row];
        let mut diffuse = vec![[0.0; 3]; gazes.len()];
        let levels = Levels::Shared {
            lobes: &LOBES,
            evaluate: table.levels,
            models: &table.lobes,
        };
        let traced = reflector.reflect_and_spread(&gazes, levels, &mut specular, &mut diffuse);
        let mut out = self.evidence;
        out.fill(&specular, &diffuse, row);
        out.rays = traced + gazes.len() as u64;
        out
    }
}

/// Rays through the places of the image that sights are interpolated from.
#[derive(Default)]
struct Footprints {
    rays: Vec<Ray>,
    /// Per sight the gaze at its point, and how far from it the footprint may reach.
    centres: Vec<(ShadingPoint, f32)>,
}

impl Footprints {
    /// Adds the sight `seen` in the view of `buffer`.
    fn push(&mut self, buffer: &ViewBuffer, seen: &Observation, centre: ShadingPoint) {
        let camera = &buffer.camera;
        let taps = bilinear_taps(camera.width, camera.height, seen.pixel, buffer.wrap());
        let total: f32 = taps.iter().map(|t| t.1).sum();
        let sequences = [0, 1].map(|half| SobolSequence::new(0xf007 + half, centre.key));
        for s in 0..FOOTPRINT {
            // the image is interpolated between pixels, and each is a mean over its square
            let [x, y, mut u, _] = sequences[s / HALF].point4((s % HALF) as u32);
            let tap = taps.iter().find(|t| {
                u -= t.1 / total;
                u < 0.0
            });
            let k = tap.unwrap_or(&taps[0]).0;
            let at = Vec2::new((k % camera.width) as f32 + x, (k / camera.width) as f32 + y);
            self.rays.push(Ray::new(
                camera.position,
                camera.direction(at),
                f32::INFINITY,
            ));
        }
        self.centres
            .push((centre, REACH * seen.footprint / seen.n_v.max(0.1).sqrt()));
    }

    /// [`FOOTPRINT`] gazes per sight; where another surface is met, the one at its point.
    fn gazes(&self, lit: &LitScene, surface: &Surface) -> Vec<ShadingPoint> {
        let mut hits = vec![Hit::miss(); self.rays.len()];
        lit.tracer.closest(&self.rays, &mut hits);
        let gaze = |(k, (ray, hit)): (usize, (&Ray, &Hit))| {
            let (centre, reach) = self.centres[k / FOOTPRINT];
            let (half, turn) = (k % FOOTPRINT / HALF, (k % HALF) as u32);
            let key = hash_u64(centre.key, half as u64);
            let direction = Vec3::from_array(ray.direction);
            let position = Vec3::from_array(ray.origin) + direction * hit.t;
            if !hit.is_hit() || position.distance(centre.position) > reach {
                return ShadingPoint {
                    key,
                    turn,
                    ..centre
                };
            }
            let (normal, face_normal) = surface.normals_at(hit.triangle, position);
            let turned = normal.dot(direction) >= 0.0 || face_normal.dot(direction) >= 0.0;
            if turned {
                ShadingPoint {
                    key,
                    turn,
                    ..centre
                }
            } else {
                ShadingPoint {
                    position,
                    normal,
                    face_normal,
                    view: -direction,
                    key,
                    turn,
                }
            }
        };
        self.rays.iter().zip(&hits).enumerate().map(gaze).collect()
    }
}

/// One view's look at a point of a test.
#[cfg(test)]
pub(crate) struct TestSight<'a> {
    /// Radiance.
    pub(crate) radiance: Vec3,
    /// Burley's diffuse radiance over Lambert's, as a polynomial in the roughness.
    pub(crate) diffuse: [f32; 3],
    /// Two estimates of what a lobe mirrors at a roughness.
    pub(crate) response: &'a dyn Fn(SpecularLobe, f32) -> [Vec3; 2],
}

#[cfg(test)]
impl Evidence {
    /// Adds a point a metre from the last one, whose last sights, `bounds` of them, are lower bounds.
    pub(crate) fn push_test(&mut self, class: u16, sights: &[TestSight], bounds: usize) {
        if self.levels.is_empty() {
            self.levels = super::LEVELS.to_vec();
        }
        let first = self.sights.len() as u32;
        for (view, sight) in sights.iter().enumerate() {
            self.sights.push(ViewSample {
                view: view as u32,
                radiance: sight.radiance,
                n_v: 0.8,
                weight: 1.0,
            });
            self.diffuse.push(sight.diffuse);
            for lobe in self.lobes {
                for level in &self.levels {
                    let [a, b] = (sight.response)(lobe, *level);
                    self.specular.push(0.5 * (a + b));
                    self.noise.push(0.5 * luminance(a - b));
                }
            }
        }
        self.points.push(EvidencePoint {
            class,
            triangle: 0,
            position: Vec3::X * self.points.len() as f32,
            first,
            count: (sights.len() - bounds) as u32,
            bounds: bounds as u32,
        });
    }
}
