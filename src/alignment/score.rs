//! The score of a set of cameras against the mesh: agreements that are 0 by chance and 1 when
//! perfect.
//!
//! 1. *Photo-consistency*: points of the surface, met by rays through a view's samples, are looked
//!    up in the nearest other views that see them. 1 − Σ|a − b| / Σ|a − b'| with b' the same view's
//!    value at another of the points: a robust correlation, blind to how contrasty a room is and,
//!    by medians, to each view's exposure and white balance. Once for log luminance and
//!    chromaticity, once for luminance less its surround.
//! 2. *Edges*: 2·AUC − 1 of the contrast of neighbouring pixels as a test for an edge of depth or
//!    normals between them (Mann and Whitney's statistic).
//! 3. *Labels*: the same two for class ids: Cohen's kappa over views, and the phi coefficient of
//!    edges of labels and edges of the mesh.
//!
//! Every part is multiplied by the share of the view's samples that meet the mesh.

use super::evidence::ViewEvidence;
use crate::core::geometry::{Camera, Mesh};
use crate::core::parallel::prelude::*;
use crate::core::sampling::KeyedRng;
use crate::core::stats::median;
use crate::core::trace::{Hit, Ray, Tracer};
use crate::gbuffer::wrap_of;
use crate::scene::Mirror;
use glam::{Vec2, Vec3, Vec4};
use serde::Serialize;

/// Other views in which a view's points are looked up: the nearest ones.
const PARTNERS: usize = 4;
/// Points that two views must share to be compared.
const FEWEST_SHARED: usize = 10;
/// Surfaces seen more slanting than this are left out.
const MIN_COSINE: f32 = 0.2;
/// Normals that differ by more than acos of this make an edge (30°).
const EDGE_COSINE: f32 = 0.87;
/// A step out of the neighbour's plane by this share of the distance makes an edge.
const EDGE_STEP: f32 = 0.04;
/// Distances around a sample that differ by more than this factor are those of two surfaces (a wall
/// at 45° changes by 1.1 over a pair).
const SMOOTH_RATIO: f32 = 1.2;
/// Parts of the score.
pub const PARTS: usize = 5;

/// Mesh and tracer that hypotheses are tested against.
pub struct Ground<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Rays against it.
    pub tracer: &'a dyn Tracer,
}

/// One view's score.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ViewScore {
    /// Agreement over views of luminance and chromaticity; of detail; edges; labels over views;
    /// edges of labels. `None` where the view has no such evidence.
    pub parts: [Option<f32>; PARTS],
    /// Share of the samples that meet the mesh.
    pub met: f32,
    /// Median distance of the hits, metres; 0 without any.
    pub distance: f32,
    /// Pairs of neighbouring pixels with an edge of the mesh between them.
    pub edges: usize,
}

impl ViewScore {
    /// Mean of the parts over those that `counted` names; parts without evidence count 0.
    #[must_use]
    pub fn mean(&self, counted: [bool; PARTS]) -> f64 {
        let n = counted.iter().filter(|c| **c).count().max(1);
        let sum: f64 = self
            .parts
            .iter()
            .zip(counted)
            .filter(|(_, c)| *c)
            .map(|(p, _)| f64::from(p.unwrap_or(0.0)))
            .sum();
        sum / n as f64
    }
}

/// The samples of one view, followed to the mesh.
struct Traced {
    camera: Camera,
    /// Numbers of the samples in use; the lists below run along.
    samples: Vec<usize>,
    hits: Vec<Hit>,
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    edges: Vec<[bool; 2]>,
    /// The surface is continuous around the sample.
    smooth: Vec<bool>,
}

/// Scores all views with their cameras replaced by `cameras`.
///
/// Photographs that are mirrored come as reflected cameras; with [`Mirror::Images`] class ids are
/// looked up at the mirrored pixel, which is the one the label image shows, with
/// [`Mirror::UpsideDown`] at the one half a turn away. Only every `stride`-th
/// sample is used.
#[must_use]
pub fn score_views(
    ground: &Ground<'_>,
    views: &[ViewEvidence],
    cameras: &[Camera],
    mirror: Mirror,
    stride: usize,
) -> Vec<ViewScore> {
    let traced: Vec<Traced> = views
        .par_iter()
        .zip(cameras)
        .map(|(v, c)| trace(ground, v, c, stride.max(1)))
        .collect();
    (0..views.len())
        .into_par_iter()
        .map(|i| score_view(ground, views, &traced, i, mirror))
        .collect()
}

fn trace(ground: &Ground<'_>, view: &ViewEvidence, camera: &Camera, stride: usize) -> Traced {
    let samples: Vec<usize> = (0..view.samples.len()).step_by(stride).collect();
    let mut rays = Vec::with_capacity(5 * samples.len());
    let ray = |p: Vec2| Ray::new(camera.position, camera.direction(p), f32::INFINITY);
    for s in samples.iter().map(|&k| &view.samples[k]) {
        rays.push(ray(s.pixel));
        for p in &s.pairs {
            rays.extend(p.ends.map(ray));
        }
    }
    let mut all = vec![Hit::miss(); rays.len()];
    ground.tracer.closest(&rays, &mut all);
    let at = |i: usize| -> Option<Surface> {
        let hit = &all[i];
        hit.is_hit().then(|| Surface {
            point: Vec3::from(rays[i].origin) + Vec3::from(rays[i].direction) * hit.t,
            normal: ground.mesh.face_normal(hit.triangle as usize),
            distance: hit.t,
        })
    };
    let n = samples.len();
    let mut out = Traced {
        camera: *camera,
        samples,
        hits: Vec::new(),
        points: Vec::new(),
        normals: Vec::new(),
        edges: Vec::new(),
        smooth: Vec::new(),
    };
    for k in 0..n {
        let centre = at(5 * k);
        out.hits.push(all[5 * k]);
        out.points
            .push(centre.as_ref().map_or(Vec3::ZERO, |s| s.point));
        out.normals
            .push(centre.as_ref().map_or(Vec3::ZERO, |s| s.normal));
        let edge = |i: usize| is_edge(at(i), at(i + 1));
        let near = |i: usize| all[5 * k].t / all[i].t;
        out.smooth.push(
            (5 * k + 1..5 * k + 5).all(|i| near(i) < SMOOTH_RATIO && near(i) > 1.0 / SMOOTH_RATIO),
        );
        out.edges.push([edge(5 * k + 1), edge(5 * k + 3)]);
    }
    out
}

struct Surface {
    point: Vec3,
    normal: Vec3,
    distance: f32,
}

fn is_edge(a: Option<Surface>, b: Option<Surface>) -> bool {
    match (a, b) {
        (None, None) => false,
        (Some(a), Some(b)) => {
            let step = b.point - a.point;
            let reach = EDGE_STEP * a.distance.min(b.distance);
            a.normal.dot(b.normal).abs() < EDGE_COSINE
                || a.normal.dot(step).abs() > reach
                || b.normal.dot(step).abs() > reach
        }
        _ => true,
    }
}

fn score_view(
    ground: &Ground<'_>,
    views: &[ViewEvidence],
    traced: &[Traced],
    i: usize,
    mirror: Mirror,
) -> ViewScore {
    let (view, own) = (&views[i], &traced[i]);
    let mut distances: Vec<f32> = own
        .hits
        .iter()
        .filter(|h| h.is_hit())
        .map(|h| h.t)
        .collect();
    let met = distances.len() as f32 / own.hits.len().max(1) as f32;
    distances.sort_by(f32::total_cmp);
    let distance = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let mut parts = [None; PARTS];
    parts[2] = edge_agreement(view, own);
    parts[4] = label_edge_agreement(view, own, mirror);
    let mut sums = [Sum::default(); 3];
    for j in partners(traced, i) {
        let shared = shared_samples(ground, views, traced, [i, j]);
        if shared.len() < FEWEST_SHARED {
            continue;
        }
        let labels = (view.labels.is_some() && views[j].labels.is_some())
            .then(|| label_agreement(view, &views[j], &shared, mirror))
            .flatten();
        let photo = photo_agreement(view, &shared, (i * views.len() + j) as u64);
        for (sum, value) in sums.iter_mut().zip([photo[0], photo[1], labels]) {
            sum.add(value, shared.len());
        }
    }
    parts[0] = sums[0].mean();
    parts[1] = sums[1].mean();
    parts[3] = sums[2].mean();
    ViewScore {
        parts: parts.map(|p| p.map(|x| x * met)),
        met,
        distance,
        edges: own.edges.iter().flatten().filter(|e| **e).count(),
    }
}

#[derive(Clone, Copy, Default)]
struct Sum {
    total: f64,
    weight: f64,
}

impl Sum {
    fn add(&mut self, value: Option<f32>, n: usize) {
        if let Some(v) = value {
            self.total += f64::from(v) * n as f64;
            self.weight += n as f64;
        }
    }

    fn mean(&self) -> Option<f32> {
        (self.weight > 0.0).then(|| (self.total / self.weight) as f32)
    }
}

/// The nearest other cameras, nearest first.
fn partners(traced: &[Traced], i: usize) -> Vec<usize> {
    let mut order: Vec<(f32, usize)> = (0..traced.len())
        .filter(|&j| j != i)
        .map(|j| {
            let step = traced[j].camera.position - traced[i].camera.position;
            (step.length_squared(), j)
        })
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order.into_iter().take(PARTNERS).map(|(_, j)| j).collect()
}

/// A sample of one view and where another view sees it.
struct Shared {
    sample: usize,
    /// Place of the sample in the view's [`Traced`] lists.
    place: usize,
    pixel: Vec2,
    feature: Vec4,
}

fn shared_samples(
    ground: &Ground<'_>,
    views: &[ViewEvidence],
    traced: &[Traced],
    [i, j]: [usize; 2],
) -> Vec<Shared> {
    let (own, other) = (&traced[i], &traced[j]);
    let wrap = wrap_of(&other.camera);
    let mut found = Vec::new();
    let mut rays = Vec::new();
    for (k, point) in own.points.iter().enumerate() {
        if !own.hits[k].is_hit() {
            continue;
        }
        let to = *point - other.camera.position;
        let (length, from) = (to.length(), *point - own.camera.position);
        let facing = |d: Vec3| own.normals[k].dot(d.normalize_or_zero()).abs() > MIN_COSINE;
        let Some(pixel) = other
            .camera
            .project(*point)
            .filter(|_| facing(to) && facing(from))
        else {
            continue;
        };
        if !*views[j].valid.nearest(pixel) {
            continue;
        }
        found.push(Shared {
            sample: own.samples[k],
            place: k,
            pixel,
            feature: views[j].features.bilinear(pixel, wrap),
        });
        // stops short of the surface by more than rounding and less than any step that matters
        rays.push(Ray::new(
            other.camera.position,
            to / length,
            length * (1.0 - 2e-3),
        ));
    }
    let mut hidden = vec![0u8; rays.len()];
    ground.tracer.occluded(&rays, &mut hidden);
    let mut k = 0;
    found.retain(|_| (hidden[k] == 0, k += 1).0);
    found
}

/// A surface point as one view shows it, to be looked up in another that sees it.
pub struct Lookup {
    /// The view that shows it.
    pub from: usize,
    /// The view it is looked up in.
    pub into: usize,
    /// The point, relative to the scene's origin.
    pub point: Vec3,
    /// Normal of the surface there.
    pub normal: Vec3,
    /// What `from` shows.
    pub feature: Vec4,
}

/// For each view the points that its nearest views show and it sees, ordered by view.
#[must_use]
pub fn lookups(ground: &Ground<'_>, views: &[ViewEvidence], cameras: &[Camera]) -> Vec<Lookup> {
    let traced: Vec<Traced> = views
        .par_iter()
        .zip(cameras)
        .map(|(v, c)| trace(ground, v, c, 1))
        .collect();
    let of_view = |into: usize| -> Vec<Lookup> {
        let mut out = Vec::new();
        for from in partners(&traced, into) {
            let shared = shared_samples(ground, views, &traced, [from, into]);
            out.extend(
                shared
                    .iter()
                    .filter(|s| traced[from].smooth[s.place])
                    .map(|s| Lookup {
                        from,
                        into,
                        point: traced[from].points[s.place],
                        normal: traced[from].normals[s.place],
                        feature: views[from].samples[s.sample].feature,
                    }),
            );
        }
        out
    };
    (0..views.len())
        .into_par_iter()
        .flat_map_iter(of_view)
        .collect()
}

/// Agreement of luminance and chromaticity, and of detail.
fn photo_agreement(view: &ViewEvidence, shared: &[Shared], key: u64) -> [Option<f32>; 2] {
    let own = |s: &Shared| view.samples[s.sample].feature;
    let gain = Vec4::from_array(std::array::from_fn(|c| {
        median(shared.iter().map(|s| s.feature[c] - own(s)[c]).collect()).unwrap_or(0.0)
    }));
    let mut rng = KeyedRng::new(0xa119, key);
    let (mut same, mut chance) = ([0.0f64; 2], [0.0f64; 2]);
    for s in shared {
        let add = |sums: &mut [f64; 2], d: Vec4| {
            sums[0] += f64::from(d.truncate().length());
            sums[1] += f64::from(d.w.abs());
        };
        add(&mut same, s.feature - own(s) - gain);
        for _ in 0..2 {
            let other = &shared[rng.below(shared.len())];
            add(&mut chance, 0.5 * (other.feature - own(s) - gain));
        }
    }
    std::array::from_fn(|c| (chance[c] > 0.0).then(|| (1.0 - same[c] / chance[c]) as f32))
}

/// Where a view's own label image shows what its photograph shows at `p`.
fn label_place(view: &ViewEvidence, p: Vec2, mirror: Mirror) -> Vec2 {
    match mirror {
        Mirror::Images => Vec2::new(view.features.width as f32 - p.x, p.y),
        Mirror::UpsideDown => Vec2::new(
            view.features.width as f32 - p.x,
            view.features.height as f32 - p.y,
        ),
        Mirror::None | Mirror::All => p,
    }
}

/// Cohen's kappa of the class ids of shared points.
fn label_agreement(
    view: &ViewEvidence,
    other: &ViewEvidence,
    shared: &[Shared],
    mirror: Mirror,
) -> Option<f32> {
    let ids: Vec<[u16; 2]> = shared
        .iter()
        .map(|s| {
            let own = label_place(view, view.samples[s.sample].pixel, mirror);
            [
                view.label(own),
                other.label(label_place(other, s.pixel, mirror)),
            ]
        })
        .filter(|[a, b]| *a != 0 && *b != 0)
        .collect();
    let n = ids.len() as f64;
    let mut counts: std::collections::BTreeMap<u16, [f64; 2]> = std::collections::BTreeMap::new();
    for [a, b] in &ids {
        counts.entry(*a).or_default()[0] += 1.0;
        counts.entry(*b).or_default()[1] += 1.0;
    }
    let chance: f64 = counts.values().map(|[a, b]| a * b).sum::<f64>() / (n * n).max(1.0);
    let same = ids.iter().filter(|[a, b]| a == b).count() as f64 / n.max(1.0);
    (ids.len() >= FEWEST_SHARED && chance < 0.98).then(|| ((same - chance) / (1.0 - chance)) as f32)
}

/// 2·AUC − 1 of contrast as a test for edges.
fn edge_agreement(view: &ViewEvidence, own: &Traced) -> Option<f32> {
    let (mut sum, mut edges, mut n) = (0.0f64, 0.0f64, 0.0f64);
    for (&k, e) in own.samples.iter().zip(&own.edges) {
        let s = &view.samples[k];
        for (pair, edge) in s.pairs.iter().zip(e) {
            n += 1.0;
            if *edge {
                edges += 1.0;
                sum += f64::from(pair.rank);
            }
        }
    }
    // the mean rank of the edges is ½ by chance; dividing by the share of the others makes 1
    // perfect
    let flat = n - edges;
    (edges >= 8.0 && flat >= 8.0).then(|| (2.0 * (sum / edges - 0.5) * n / flat) as f32)
}

/// Phi coefficient of edges of labels and edges of the mesh.
fn label_edge_agreement(view: &ViewEvidence, own: &Traced, mirror: Mirror) -> Option<f32> {
    view.labels.as_ref()?;
    let mut table = [[0.0f64; 2]; 2];
    for (&k, e) in own.samples.iter().zip(&own.edges) {
        let s = &view.samples[k];
        for (pair, edge) in s.pairs.iter().zip(e) {
            let [a, b] = match mirror {
                Mirror::Images | Mirror::UpsideDown => {
                    pair.ends.map(|p| view.label(label_place(view, p, mirror)))
                }
                Mirror::None | Mirror::All => pair.labels,
            };
            table[usize::from(a != b)][usize::from(*edge)] += 1.0;
        }
    }
    let [[a, b], [c, d]] = table;
    let spread = ((a + b) * (c + d) * (a + c) * (b + d)).sqrt();
    (spread > 0.0).then(|| ((a * d - b * c) / spread) as f32)
}
