//! Scores of hypotheses: quickly by geometry alone, then by photographs, then with parameters
//! adjusted.

use super::correction::Correction;
use super::evidence::ViewEvidence;
use super::hypotheses::{self as usual, Hypothesis};
use super::score::{Ground, PARTS, ViewScore, score_views};
use crate::core::geometry::{Camera, Projection};
use crate::core::trace::{Hit, Ray};
use crate::scene::Scene;
use glam::{DVec3, Vec2};

/// Rays per view of the geometric filter.
const FILTER_RAYS: usize = 32;
/// A hypothesis whose cameras see this share of what the best one's see is tried on photographs.
const PLAUSIBLE: f64 = 0.6;
/// Every n-th sample takes part in the search.
pub const COARSE: usize = 3;
/// … and every n-th in the first pass over hundreds of hypotheses, the best of which are scored
/// again.
pub const ROUGH: usize = 9;
const RETRIED: usize = 30;
/// Shift of the coarse search in units of the median distance to surfaces (11°), and how many
/// steps to each side.
const SHIFT_STEP: f64 = 0.2;
const SHIFT_REACH: i32 = 6;
/// Steps of yaw, degrees, and of the logarithm of scale.
const YAW_STEP: usize = 10;
const SCALE_STEP: f64 = 0.06;
const SCALE_REACH: i32 = 14;
/// Candidates whose parameters are adjusted.
const ADJUSTED: usize = 4;

/// Everything that scores a correction.
pub struct Judge<'a> {
    /// Mesh and rays.
    pub ground: Ground<'a>,
    /// Photographs.
    pub views: &'a [ViewEvidence],
    /// File coordinates of the scene's origin.
    pub origin: DVec3,
    /// The poses were turned from z up on loading.
    pub z_up: bool,
    /// Parts of the score for which there is evidence.
    pub counted: [bool; PARTS],
}

/// A hypothesis with its score.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// Mean score over the views.
    pub score: f64,
}

impl Judge<'_> {
    /// Cameras under a correction, at the size of the evidence.
    #[must_use]
    pub fn cameras(&self, c: &Correction) -> Vec<Camera> {
        self.views
            .iter()
            .map(|v| c.camera(&v.camera, self.origin, self.z_up))
            .collect()
    }

    /// Full scores of all views.
    #[must_use]
    pub fn view_scores(&self, c: &Correction, stride: usize) -> Vec<ViewScore> {
        score_views(&self.ground, self.views, &self.cameras(c), c.mirror, stride)
    }

    /// One number per view.
    #[must_use]
    pub fn scores(&self, c: &Correction, stride: usize) -> Vec<f64> {
        self.view_scores(c, stride)
            .iter()
            .map(|s| s.mean(self.counted))
            .collect()
    }

    fn mean(&self, c: &Correction, stride: usize) -> f64 {
        let scores = self.scores(c, stride);
        scores.iter().sum::<f64>() / scores.len().max(1) as f64
    }

    fn candidate(&self, hypothesis: Hypothesis, stride: usize) -> Candidate {
        Candidate {
            score: self.mean(&hypothesis.correction, stride),
            hypothesis,
        }
    }

    /// How well the cameras stand in the mesh, from a few rays: share of rays that meet it, over
    /// cameras that lie within its bounds and not inside a surface; 0 … 1.
    fn stands(&self, c: &Correction) -> f64 {
        let (lo, hi) = self.ground.mesh.bounds();
        let near = 1e-3 * (hi - lo).length();
        let mut sum = 0.0;
        for camera in self.cameras(c) {
            if camera.position.cmplt(lo).any() || camera.position.cmpgt(hi).any() {
                continue;
            }
            let rays: Vec<Ray> = (0..FILTER_RAYS)
                .map(|i| {
                    let u = Vec2::new(
                        (i as f32 * 0.618_034).fract(),
                        (i as f32 + 0.5) / FILTER_RAYS as f32,
                    );
                    let size = Vec2::new(camera.width as f32, camera.height as f32);
                    Ray::new(camera.position, camera.direction(u * size), f32::INFINITY)
                })
                .collect();
            let mut hits = vec![Hit::miss(); rays.len()];
            self.ground.tracer.closest(&rays, &mut hits);
            let free = hits.iter().filter(|h| h.is_hit() && h.t > near).count();
            sum += free as f64 / FILTER_RAYS as f64;
        }
        sum / self.views.len().max(1) as f64
    }

    /// Keeps the hypotheses whose cameras stand about as well as the best one's.
    fn plausible(&self, all: Vec<Hypothesis>) -> Vec<Hypothesis> {
        let stands: Vec<f64> = all.iter().map(|h| self.stands(&h.correction)).collect();
        let best = stands.iter().copied().fold(0.0, f64::max);
        all.into_iter()
            .zip(stands)
            .filter(|(_, s)| *s > 0.0 && *s >= PLAUSIBLE * best)
            .map(|(h, _)| h)
            .collect()
    }

    /// Single usual mistakes, scored with every `stride`-th sample.
    #[must_use]
    pub fn usual(&self, scene: &Scene, stride: usize) -> Vec<Candidate> {
        let mut all = vec![Hypothesis::as_given()];
        all.extend(usual::inversions());
        all.extend(usual::world_axes(self.z_up));
        all.extend(usual::units());
        all.extend(usual::camera_axes());
        all.extend(self.pictures());
        all.extend(usual::right_angles());
        all.extend(usual::other_axes());
        all.extend(usual::lenses(scene));
        self.plausible(all)
            .into_iter()
            .map(|h| self.candidate(h, stride))
            .collect()
    }

    fn pictures(&self) -> Vec<Hypothesis> {
        let panoramas = self
            .views
            .iter()
            .all(|v| v.camera.projection == Projection::Equirectangular);
        let labelled = self.views.iter().any(|v| v.labels.is_some());
        usual::pictures(panoramas, labelled)
    }

    /// Combinations of order, world axes, units and camera axes, and one-parameter families.
    #[must_use]
    pub fn unusual(&self) -> Vec<Candidate> {
        let given = [Hypothesis::as_given()];
        let with = |more: Vec<Hypothesis>| given.iter().cloned().chain(more).collect::<Vec<_>>();
        let mut places = Vec::new();
        for a in with(usual::inversions()) {
            for b in with(usual::world_axes(self.z_up)) {
                for c in with(usual::units()) {
                    places.push(a.then(&b).then(&c));
                }
            }
        }
        let mut all = Vec::new();
        for place in self.plausible(places) {
            all.extend(
                with(usual::camera_axes())
                    .iter()
                    .map(|axes| place.then(axes)),
            );
        }
        all.retain(|h| h.steps >= 2);
        all.extend(self.plausible(self.families()));
        let mut rough: Vec<(f64, Hypothesis)> = all
            .into_iter()
            .map(|h| (self.mean(&h.correction, ROUGH), h))
            .collect();
        rough.sort_by(|a, b| b.0.total_cmp(&a.0));
        rough.truncate(RETRIED);
        rough
            .into_iter()
            .map(|(_, h)| self.candidate(h, COARSE))
            .collect()
    }

    /// Yaw of all poses and of each camera, scale, shift.
    fn families(&self) -> Vec<Hypothesis> {
        let mut out = Vec::new();
        let middle = self.middle();
        for degrees in (YAW_STEP..360).step_by(YAW_STEP).map(|d| d as f64) {
            out.push(usual::yaw(DVec3::ZERO, degrees));
            out.push(usual::yaw(middle, degrees));
            out.push(usual::camera_yaw(degrees));
        }
        for k in (-SCALE_REACH..=SCALE_REACH).filter(|k| *k != 0) {
            let factor = (f64::from(k) * SCALE_STEP).exp();
            out.push(usual::scale(DVec3::ZERO, factor));
            out.push(usual::scale(middle, factor));
        }
        let step = SHIFT_STEP * self.distance();
        for x in -SHIFT_REACH..=SHIFT_REACH {
            for z in -SHIFT_REACH..=SHIFT_REACH {
                let by = DVec3::new(f64::from(x), 0.0, f64::from(z)) * step;
                out.push(usual::shift(by));
            }
            out.push(usual::shift(DVec3::Y * f64::from(x) * step));
        }
        out.push(usual::shift(self.origin - middle));
        out
    }

    /// Mean of the cameras' places, file coordinates.
    #[must_use]
    pub fn middle(&self) -> DVec3 {
        let sum: DVec3 = self
            .views
            .iter()
            .map(|v| v.camera.position.as_dvec3())
            .sum();
        self.origin + sum / self.views.len().max(1) as f64
    }

    /// Median distance from the cameras as given to surfaces; a fifth of the mesh's diagonal if
    /// they see none.
    #[must_use]
    pub fn distance(&self) -> f64 {
        let (lo, hi) = self.ground.mesh.bounds();
        let seen = self.distance_under(&Correction::default());
        if seen > 0.0 {
            seen
        } else {
            0.2 * f64::from((hi - lo).length())
        }
    }

    /// Median distance from the corrected cameras to surfaces; 0 if they see none.
    #[must_use]
    pub fn distance_under(&self, c: &Correction) -> f64 {
        let mut all: Vec<f32> = self
            .view_scores(c, 8 * COARSE)
            .iter()
            .filter(|s| s.met > 0.0)
            .map(|s| s.distance)
            .collect();
        all.sort_by(f32::total_cmp);
        all.get(all.len() / 2).map_or(0.0, |d| f64::from(*d))
    }

    /// The best candidates with yaw, scale and shift adjusted, best first.
    #[must_use]
    pub fn adjusted(&self, mut all: Vec<Candidate>) -> Vec<Candidate> {
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        all.truncate(ADJUSTED);
        let mut out: Vec<Candidate> = all.iter().map(|c| self.adjust(c)).collect();
        out.sort_by(|a, b| b.score.total_cmp(&a.score));
        out
    }

    /// Coordinate search over yaw, scale and shift about the cameras' middle and the cameras' own
    /// yaw, with halving steps.
    #[must_use]
    pub fn adjust(&self, start: &Candidate) -> Candidate {
        let distance = match self.distance_under(&start.hypothesis.correction) {
            d if d > 0.0 => d,
            _ => self.distance(),
        };
        let mut best = start.clone();
        let mut size = 1.0;
        while size > 0.1 {
            let before = best.score;
            for k in 0..6 {
                for sign in [1.0, -1.0] {
                    let tried = self.moved(&best.hypothesis.correction, k, sign * size, distance);
                    let score = self.mean(&tried, COARSE);
                    if score > best.score {
                        best.score = score;
                        best.hypothesis = start.hypothesis.with(tried);
                        break;
                    }
                }
            }
            if best.score <= before + 1e-3 {
                size *= 0.5;
            }
        }
        best
    }

    /// A correction followed by one small change: 0 yaw, 1 scale, 2 … 4 shift, 5 yaw of each
    /// camera, 6 pitch and 7 roll of the world; `size` 1 is about 6° of what the cameras see.
    #[must_use]
    pub fn moved(&self, c: &Correction, which: usize, size: f64, distance: f64) -> Correction {
        let cameras = self.cameras(c);
        let sum: DVec3 = cameras.iter().map(|v| v.position.as_dvec3()).sum();
        let middle = self.origin + sum / cameras.len().max(1) as f64;
        let angle = 6.0 * size;
        let next = match which {
            0 => Correction::about(middle, DVec3::Y, angle),
            1 => Correction::scaled(middle, (angle.to_radians() * 0.7).exp()),
            2..=4 => Correction {
                shift: DVec3::AXES[which - 2] * (angle.to_radians() * distance),
                ..Correction::default()
            },
            5 => Correction {
                camera_turn: glam::DMat3::from_rotation_y(angle.to_radians()),
                ..Correction::default()
            },
            6 => Correction::about(middle, DVec3::X, angle),
            _ => Correction::about(middle, DVec3::Z, angle),
        };
        c.then(&next)
    }
}
