//! Small errors of single poses: all cameras are turned and moved together until their photographs
//! agree on what the surface shows ([`super::joint_fit`]), from coarse images to fine ones.
//!
//! A pose is changed only if residuals of points that took no part in the estimate become smaller by
//! its own change, in both halves of a two-fold split, the change is larger than what the photographs
//! resolve, and edges of the mesh and class ids agree to it.

use super::evidence::ViewEvidence;
use super::joint_fit::{
    JointFit, Pair, Pose, Used, WIDE, cameras_of, distances, joint_fit, moved, pairs, pose_vector,
    residuals, scales,
};
use super::score::{Ground, score_views};
use crate::Result;
use crate::core::geometry::Camera;
use crate::core::parallel::prelude::*;
use crate::core::stats::{SURELY, median};
use crate::scene::Mirror;
use glam::{DQuat, DVec3, Vec2, Vec4};
use serde::{Deserialize, Serialize};

/// Rounds per size of the images at most: after each, what sees what is looked up again.
const ROUNDS: usize = 4;
/// Rounds end where no pose moves by more than this share of what counts as a change.
const SETTLED: f64 = 0.2;
/// Parts of a view's score that the fit does not use: edges, and labels where there are any.
const OTHER_PARTS: [usize; 3] = [2, 3, 4];
/// Held-out improvement in standard errors.
const SIGNIFICANT: f64 = 3.5;
/// What fits of right poses are off by, degrees as seen by the camera. Measured: root mean squares of
/// 0.04 to 0.17° in the four shared scenes, no view beyond 0.32° (docs/lab/alignment.md).
const MODEL_ERROR: f64 = 0.13;
/// Changes below this, as seen by the camera, may be errors of the fit: degrees. So may those below half a
/// pixel.
const LEAST: f64 = SURELY as f64 * MODEL_ERROR;
/// By what fits of right poses drift together, degrees as the cameras see it. Measured: 0.1 to 0.2° in the
/// four shared scenes (docs/lab/alignment.md).
const DRIFT: f64 = 0.15;
/// Points of one half of the split lie together in runs of this many, so that neighbours do not
/// vouch for one another.
const RUN: usize = 16;

/// What was changed of one view's pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RefinedPose {
    /// The view.
    pub stem: String,
    /// Rotation vector in the camera's axes, radians.
    pub turn: DVec3,
    /// Shift in the world, metres.
    pub shift: DVec3,
    /// Size of the turn, degrees.
    pub degrees: f64,
    /// Its standard error.
    pub degrees_error: f64,
    /// Size of the shift, metres.
    pub metres: f64,
    /// Its standard error.
    pub metres_error: f64,
    /// Held-out improvement in standard errors.
    pub significance: f64,
}

impl RefinedPose {
    /// The refined camera.
    #[must_use]
    pub fn camera(&self, camera: &Camera) -> Camera {
        moved(camera, &pose_vector(self.turn, self.shift))
    }
}

/// Refines the poses of all views, seen coarsely; `finer` gives the same views at growing image sizes.
/// If `hasty`, a size at which no pose is wrong ends it. Views that stay as they are do not occur in the
/// answer.
///
/// # Errors
/// Those of `finer`.
pub fn refine(
    ground: &Ground<'_>,
    coarse: &[ViewEvidence],
    finer: impl FnOnce() -> Result<Vec<Vec<ViewEvidence>>>,
    hasty: bool,
) -> Result<Vec<RefinedPose>> {
    let mut poses = vec![Pose::zeros(); coarse.len()];
    // none where that is the end: poses that cannot be fitted, or none that is wrong
    let mut at_size = |views: &[ViewEvidence], judged: bool| -> Option<Vec<RefinedPose>> {
        let found = settled(ground, views, &mut poses)?;
        if !judged {
            return Some(Vec::new());
        }
        let changes = vouched(ground, views, found.changes(&poses));
        (!changes.is_empty()).then_some(changes)
    };
    let Some(mut changes) = at_size(coarse, hasty) else {
        return Ok(Vec::new());
    };
    let sizes = finer()?;
    for (k, views) in sizes.iter().enumerate() {
        match at_size(views, hasty || k + 1 == sizes.len()) {
            Some(found) => changes = found,
            None => return Ok(Vec::new()),
        }
    }
    Ok(changes)
}

/// Of some changes those that the mesh's edges and the class ids do not speak against, which took no part
/// in the fit. Where they do so with most, photographs agree better on a surface that is not the
/// room's (furniture that the mesh lacks, walls out of place), and no pose is changed.
fn vouched(
    ground: &Ground<'_>,
    views: &[ViewEvidence],
    mut changes: Vec<RefinedPose>,
) -> Vec<RefinedPose> {
    let given: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let change_of = |v: &ViewEvidence| changes.iter().find(|c| c.stem == v.stem);
    let refined = (views.iter())
        .map(|v| change_of(v).map_or(v.camera, |c| c.camera(&v.camera)))
        .collect();
    let [before, after] = [given, refined].map(|c| score_views(ground, views, &c, Mirror::None, 1));
    let speaks_against = |v: usize| {
        let [old, new] = [&before, &after].map(|s| s[v].parts);
        let part = |k: usize| Some(new[k]? - old[k]?);
        let gains: Vec<f32> = OTHER_PARTS.into_iter().filter_map(part).collect();
        // the mean rank of n independent edges has a standard error of 1/√(12 n), and counts twice
        let edges = before[v].edges.min(after[v].edges).max(1);
        let error = (gains.len() as f32 / (3.0 * edges as f32)).sqrt();
        gains.iter().sum::<f32>() < -SURELY * error
    };
    let found = changes.len();
    changes.retain(|c| (0..views.len()).any(|v| views[v].stem == c.stem && !speaks_against(v)));
    if 2 * changes.len() < found {
        changes.clear();
    }
    changes
}

/// Moves poses until they fit, and what the views share then; `None` if they cannot be fitted.
fn settled<'a>(
    ground: &Ground<'_>,
    views: &'a [ViewEvidence],
    poses: &mut Vec<Pose>,
) -> Option<Found<'a>> {
    for _ in 0..ROUNDS {
        let found = Found::at(ground, views, poses);
        let fit = joint_fit(views, &found.pairs, poses, &|_| true)?;
        let before = std::mem::replace(poses, fit.poses);
        let steps = (0..views.len()).map(|v| found.seen_change(&(poses[v] - before[v]), v));
        if steps.fold(0.0, f64::max) < SETTLED * LEAST {
            break;
        }
    }
    Some(Found::at(ground, views, poses))
}

/// Turn and shift of a pose.
fn halves(x: &Pose) -> [DVec3; 2] {
    [DVec3::new(x[0], x[1], x[2]), DVec3::new(x[3], x[4], x[5])]
}

/// The views and what they share once their poses fit.
struct Found<'a> {
    views: &'a [ViewEvidence],
    pairs: Vec<Pair>,
}

impl<'a> Found<'a> {
    fn at(ground: &Ground<'_>, views: &'a [ViewEvidence], poses: &[Pose]) -> Self {
        Self {
            views,
            pairs: pairs(ground, views, &cameras_of(views, poses)),
        }
    }

    /// The poses that are wrong, `start` being near those that fit.
    fn changes(&self, start: &[Pose]) -> Vec<RefinedPose> {
        let Some(fit) = self.fit(start, &|_| true) else {
            return Vec::new();
        };
        let gains = self.held_out_gains(start);
        let distances = distances(self.views, &self.pairs);
        (0..self.views.len())
            .filter(|&v| gains[v] > SIGNIFICANT && self.is_small(&fit, v))
            .map(|v| RefinedPose {
                stem: self.views[v].stem.clone(),
                significance: gains[v],
                ..change(&fit, v, f64::from(distances[v].unwrap_or(0.0)))
            })
            .collect()
    }

    /// The poses that fit, less what all cameras have in common.
    fn fit(&self, start: &[Pose], used: &Used<'_>) -> Option<JointFit> {
        let mut fit = joint_fit(self.views, &self.pairs, start, used)?;
        fit.poses = self.anchored(fit.poses);
        Some(fit)
    }

    /// Photographs of walls say little of a motion that all cameras share: their mean drifts by
    /// [`DRIFT`] while each is right to 0.1° against the others. Independent errors of n poses have a
    /// mean √n times smaller than they are themselves, so that of the shared motion as much is kept
    /// as these two variances say. (Middle and size are those of most, which one wrong pose does not move.)
    fn anchored(&self, poses: Vec<Pose>) -> Vec<Pose> {
        let cameras = || self.views.iter().map(|v| &v.camera);
        let turns: Vec<DVec3> = (cameras().zip(&poses))
            .map(|(c, x)| c.world_from_camera.as_dmat3() * halves(x)[0])
            .collect();
        let n = poses.len().max(1) as f64;
        let centre = cameras().map(|c| c.position.as_dvec3()).sum::<DVec3>() / n;
        let turn = middle(&turns);
        let lever = |c: &Camera| turn.cross(c.position.as_dvec3() - centre);
        let shifts: Vec<DVec3> = (cameras().zip(&poses))
            .map(|(c, x)| halves(x)[1] - lever(c))
            .collect();
        let shift = middle(&shifts);
        let common = |c: &Camera| {
            let local = c.world_from_camera.as_dmat3().transpose() * turn;
            pose_vector(local, shift + lever(c))
        };
        let own = (0..poses.len())
            .map(|v| self.seen_change(&(poses[v] - common(&self.views[v].camera)), v) as f32);
        let own = f64::from(median(own.collect()).unwrap_or(0.0));
        let drift = n * DRIFT * DRIFT;
        let share = drift / (drift + own * own);
        let (turn, shift) = (share * turn, share * shift);
        let lever = |c: &Camera| turn.cross(c.position.as_dvec3() - centre);
        let back = DQuat::from_scaled_axis(-turn);
        (cameras().zip(&poses))
            .map(|(c, x)| {
                let given = DQuat::from_mat3(&c.world_from_camera.as_dmat3());
                let [own, moved] = halves(x);
                let world = back * given * DQuat::from_scaled_axis(own);
                let own = (given.inverse() * world).to_scaled_axis();
                pose_vector(own, moved - shift - lever(c))
            })
            .collect()
    }

    /// Whether a change is visible, and little enough to be believed.
    fn is_small(&self, fit: &JointFit, v: usize) -> bool {
        let seen = self.seen_change(&fit.poses[v], v);
        let camera = &self.views[v].camera;
        let centre = 0.5 * Vec2::new(camera.width as f32, camera.height as f32);
        let pixel = f64::from(camera.pixel_angle(centre)).to_degrees();
        seen > LEAST.max(0.5 * pixel) && seen < WIDE
    }

    /// Median angle by which what a view sees moves in it, degrees.
    fn seen_change(&self, pose: &Pose, v: usize) -> f64 {
        let given = &self.views[v].camera;
        let after = moved(given, pose);
        let of_view = self.pairs.iter().filter(|p| p.into == v);
        let angles = of_view.flat_map(|p| &p.targets).map(|t| {
            let local = |c: &Camera| c.world_from_camera.transpose() * (t.point - c.position);
            local(given).angle_between(local(&after))
        });
        f64::from(median(angles.collect()).unwrap_or(0.0)).to_degrees()
    }

    /// For each view, by how many standard errors the change of its pose, estimated with all others
    /// from one half of the points, makes the residuals of the other half smaller: the smaller of
    /// both halves.
    fn held_out_gains(&self, start: &[Pose]) -> Vec<f64> {
        let gains = [0usize, 1].map(|fold| {
            let in_fold = move |i: usize| (i / RUN) % 2 == fold;
            let fit = self.fit(start, &in_fold);
            fit.map(|fit| self.gains(&fit.poses, &|i| !in_fold(i)))
        });
        (0..self.views.len())
            .map(|v| {
                let of_fold = gains.iter().map(|g| g.as_ref().map_or(0.0, |g| g[v]));
                of_fold.fold(f64::INFINITY, f64::min)
            })
            .collect()
    }

    /// The same of one half, `tested` being the other.
    fn gains(&self, poses: &[Pose], tested: &Used<'_>) -> Vec<f64> {
        let after = cameras_of(self.views, poses);
        let fitted = residuals(self.views, &self.pairs, &after);
        let scales = scales(self.views, &self.pairs, &fitted);
        (0..self.views.len())
            .into_par_iter()
            .map(|v| {
                // the others as fitted, the view as it was given
                let mut before = after.clone();
                before[v] = self.views[v].camera;
                let mut means = Vec::new();
                for (p, new) in
                    (self.pairs.iter().zip(&fitted)).filter(|(p, _)| p.from == v || p.into == v)
                {
                    let scale = scales[p.into];
                    let loss = |r: Vec4| {
                        let s2 = (r / scale) * (r / scale);
                        f64::from((s2 / (s2 + 1.0)).element_sum())
                    };
                    let old = p.residuals(&self.views[p.into], &before);
                    let gains: Vec<f64> = (0..p.targets.len())
                        .filter(|&i| tested(i))
                        .filter_map(|i| Some(loss(old[i]?) - loss(new[i]?)))
                        .collect();
                    // means of runs are nearly independent, single points are not
                    let runs = gains.chunks(RUN / 2);
                    means.extend(runs.map(|r| r.iter().sum::<f64>() / r.len() as f64));
                }
                significance(&means)
            })
            .collect()
    }
}

/// How view `v`'s pose differs from the given one, what it sees being `distance` metres away. Its
/// error holds, beside noise, what fits of right poses are off by.
fn change(fit: &JointFit, v: usize, distance: f64) -> RefinedPose {
    let [turn, shift] = halves(&fit.poses[v]);
    let [turn_noise, shift_noise] = halves(&fit.variances[v].map(f64::sqrt)).map(DVec3::length);
    RefinedPose {
        turn,
        shift,
        degrees: turn.length().to_degrees(),
        degrees_error: turn_noise.to_degrees().hypot(MODEL_ERROR),
        metres: shift.length(),
        metres_error: shift_noise.hypot(MODEL_ERROR.to_radians() * distance),
        ..RefinedPose::default()
    }
}

/// Mean of what lies around the median of each coordinate, within three times the usual distance.
fn middle(of: &[DVec3]) -> DVec3 {
    let coordinate = |k: usize| {
        let all = of.iter().map(|x| x[k] as f32).collect();
        f64::from(median(all).unwrap_or(0.0))
    };
    let centre = DVec3::from_array(std::array::from_fn(coordinate));
    let distances = of.iter().map(|x| x.distance(centre) as f32);
    let reach = f64::from(SURELY * median(distances.collect()).unwrap_or(0.0));
    let near = || of.iter().filter(|x| x.distance(centre) <= reach);
    near().sum::<DVec3>() / near().count().max(1) as f64
}

/// Mean of independent numbers over its standard error.
fn significance(of: &[f64]) -> f64 {
    let n = of.len() as f64;
    let mean = of.iter().sum::<f64>() / n.max(1.0);
    let spread = of.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    mean / (spread / n.max(1.0)).sqrt().max(1e-9)
}
