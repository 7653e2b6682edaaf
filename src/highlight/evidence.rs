//! The specular response of evidence points in every view that sees them, traced once (method §12.3 point 6).
//!
//! A point seen from several views pins down roughness without knowing its albedo or irradiance: its diffuse radiance is the same in
//! all views, so whatever differs between them must be the specular part.

use super::{Candidate, LOBES};
use crate::brdf::Reflectance;
use crate::gbuffer::{Observation, Observer};
use crate::lighting::{Bake, Gaze, Levels, Reflector};
use crate::parallel;
use crate::progress::Progress;
use crate::sampling::hash_u64;
use glam::Vec3;
use std::sync::atomic::{AtomicU64, Ordering};

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
}

/// One view's look at an evidence point.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
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
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// Roughness levels of the table, ascending.
    pub levels: Vec<f32>,
    /// Points.
    pub points: Vec<EvidencePoint>,
    /// Sights of all points, point by point.
    pub sights: Vec<Sight>,
    /// `sights.len() × MODELS.len() × levels.len()` specular radiances.
    pub specular: Vec<Vec3>,
    /// Per sight Burley's diffuse radiance over Lambert's in the light that arrives, as a polynomial in the roughness.
    pub diffuse: Vec<[f32; 3]>,
    /// Rays traced.
    pub rays: u64,
}

impl Evidence {
    /// Takes over the points of `more`, tabulated at the same levels, behind its own.
    pub fn append(&mut self, more: Self) {
        if self.levels.is_empty() {
            self.levels = more.levels;
        }
        let base = self.sights.len() as u32;
        self.points.extend(more.points.into_iter().map(|q| EvidencePoint { first: q.first + base, ..q }));
        self.sights.extend(more.sights);
        self.specular.extend(more.specular);
        self.diffuse.extend(more.diffuse);
        self.rays += more.rays;
    }

    /// Diffuse radiance of sight `s` over that of a Lambertian surface in the same light.
    #[must_use]
    pub fn diffuse_factor(&self, s: usize, model: Reflectance, roughness: f32) -> f32 {
        if model == Reflectance::Burley { Reflectance::diffuse_at(self.diffuse[s], roughness) } else { 1.0 }
    }

    /// Specular radiance of sight `s` at all levels under [`MODELS`]`[m]`.
    #[must_use]
    pub fn response(&self, s: usize, m: usize) -> &[Vec3] {
        let n = self.levels.len();
        &self.specular[(s * MODELS.len() + m) * n..][..n]
    }
}

/// Specular models tabulated: the masking terms to choose from. Diffuse parts need no rays.
pub const MODELS: [Reflectance; 2] = [Reflectance::Paper, Reflectance::Smith];

/// How finely responses are tabulated.
#[derive(Clone, Copy, Debug)]
pub struct Tabulation<'a> {
    /// Roughness levels, ascending.
    pub levels: &'a [f32],
    /// Rays for each of [`LOBES`].
    pub rays_per_lobe: u32,
}

/// Observes every candidate in all views and traces its specular response as `tabulation` says; candidates with fewer than two clean
/// sights are dropped.
#[must_use]
pub fn gather_evidence(
    bake: &Bake,
    observer: &Observer,
    candidates: &[Candidate],
    normals: &(dyn Fn(u32, Vec3) -> (Vec3, Vec3) + Sync),
    tabulation: Tabulation,
    seed: u64,
    progress: &Progress,
) -> Evidence {
    const CHUNK: usize = 64;
    let Tabulation { levels, rays_per_lobe } = tabulation;
    let rays = AtomicU64::new(0);
    let reflector = Reflector { bake, rays_per_lobe, emitter_samples: rays_per_lobe * 12 / 5, model: Reflectance::Paper, seed };
    let parts = parallel::map_chunks(candidates.len(), CHUNK, |range| {
        let mut out = Evidence { levels: levels.to_vec(), ..Evidence::default() };
        let mut gazes = Vec::new();
        let mut seen: Vec<Observation> = Vec::new();
        for i in range.clone() {
            let c = &candidates[i];
            let (normal, face_normal) = normals(c.triangle, c.position);
            observer.observe(c.position, face_normal, &mut seen);
            seen.retain(|o| o.clean && o.n_v > 0.12);
            if seen.len() < 2 {
                continue;
            }
            let first = out.sights.len() as u32;
            for o in &seen {
                let camera = &observer.views[o.view as usize].buffer.camera;
                let view = (camera.position - c.position).normalize_or(normal);
                out.sights.push(Sight {
                    view: o.view,
                    radiance: o.radiance,
                    n_v: normal.dot(view),
                    weight: (o.n_v / o.footprint).sqrt(),
                });
                let key = hash_u64(hash_u64(u64::from(o.view), u64::from(c.triangle)), i as u64);
                gazes.push(Gaze { position: c.position, normal, face_normal, view, key });
            }
            out.points.push(EvidencePoint {
                class: c.class,
                triangle: c.triangle,
                position: c.position,
                first,
                count: seen.len() as u32,
            });
        }
        out.specular = vec![Vec3::ZERO; out.sights.len() * MODELS.len() * levels.len()];
        out.diffuse = vec![[0.0; 3]; out.sights.len()];
        let table = Levels::Shared { lobes: &LOBES, evaluate: levels, models: &MODELS };
        let traced = reflector.reflect_and_spread(&gazes, table, &mut out.specular, &mut out.diffuse);
        rays.fetch_add(traced, Ordering::Relaxed);
        progress.advance(range.len() as u64);
        out
    });
    let mut all = Evidence { levels: levels.to_vec(), rays: rays.into_inner(), ..Evidence::default() };
    parts.into_iter().for_each(|p| all.append(p));
    all
}
