//! Small errors of single poses: each camera is turned and moved until its photograph agrees with
//! what the other photographs show of the same surface points.
//!
//! Gauss–Newton on log radiance with Geman–McClure weights (Engel, Koltun, Cremers 2018 align
//! photographs alike): the residual of a point is the difference of two photographs less the
//! pair's median, its derivative the image's gradient times the projection's. A pose is changed
//! only if the residuals of points that took no part in the estimate become smaller, in both halves
//! of a two-fold split, and the change is larger than three of its standard errors and than what
//! the photographs resolve.

use super::evidence::ViewEvidence;
use super::score::{Ground, Lookup, lookups};
use crate::core::geometry::{Camera, Projection};
use crate::core::image::Wrap;
use crate::core::parallel::prelude::*;
use crate::core::stats::median;
use glam::{DQuat, DVec3, Mat3, Quat, Vec2, Vec3, Vec4};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// Steps of Gauss–Newton per round.
const STEPS: usize = 4;
/// Points a view needs.
const FEWEST: usize = 120;
/// Held-out improvement in standard errors.
const SIGNIFICANT: f64 = 3.5;
/// Changes below this, as seen by the camera, are below half a pixel of a panorama 700 wide: no
/// texture shows them. Degrees.
const LEAST: f64 = 0.25;
/// Changes beyond this are no small errors, degrees.
const MOST: f64 = 12.0;

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

type Pose = SVector<f64, 6>;
type Information = SMatrix<f64, 6, 6>;

fn pose_vector(turn: DVec3, shift: DVec3) -> Pose {
    Pose::from_column_slice(&[turn.x, turn.y, turn.z, shift.x, shift.y, shift.z])
}

fn moved(camera: &Camera, x: &Pose) -> Camera {
    let turn = DVec3::new(x[0], x[1], x[2]);
    let by = DQuat::from_scaled_axis(turn);
    let quat = Quat::from_xyzw(by.x as f32, by.y as f32, by.z as f32, by.w as f32);
    Camera {
        world_from_camera: camera.world_from_camera * Mat3::from_quat(quat),
        position: camera.position + Vec3::new(x[3] as f32, x[4] as f32, x[5] as f32),
        ..*camera
    }
}

/// A point of the surface as another view shows it.
struct Target {
    point: Vec3,
    feature: Vec4,
    /// Which other view: its gain is eliminated.
    pair: usize,
}

/// Refines the poses of all views, in some rounds over all of them: in each a view moves towards
/// what the others showed in the round before. Views that stay as they are do not occur in the
/// answer.
#[must_use]
pub fn refine(ground: &Ground<'_>, views: &[ViewEvidence], rounds: usize) -> Vec<RefinedPose> {
    let given: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let mut poses = vec![Pose::zeros(); views.len()];
    for round in 0..rounds {
        let cameras: Vec<Camera> = given.iter().zip(&poses).map(|(c, x)| moved(c, x)).collect();
        let targets = targets_of(ground, views, &cameras);
        // all views move at once: half steps keep two that look at one another from changing places
        let damping = if round + 1 < rounds { 0.6 } else { 1.0 };
        poses = (0..views.len())
            .into_par_iter()
            .map(|v| {
                let fit = fit(&views[v], &given[v], &targets[v], poses[v], |_| true);
                fit.map_or(poses[v], |f| poses[v] + (f.pose - poses[v]) * damping)
            })
            .collect();
    }
    let cameras: Vec<Camera> = given.iter().zip(&poses).map(|(c, x)| moved(c, x)).collect();
    let targets = targets_of(ground, views, &cameras);
    (0..views.len())
        .into_par_iter()
        .filter_map(|v| accepted(&views[v], &given[v], &targets[v], poses[v]))
        .collect()
}

fn targets_of(ground: &Ground<'_>, views: &[ViewEvidence], cameras: &[Camera]) -> Vec<Vec<Target>> {
    let mut out: Vec<Vec<Target>> = views.iter().map(|_| Vec::new()).collect();
    for Lookup {
        from,
        into,
        point,
        feature,
    } in lookups(ground, views, cameras)
    {
        out[into].push(Target {
            point,
            feature,
            pair: from,
        });
    }
    out
}

struct Fit {
    pose: Pose,
    covariance: Information,
}

/// Residual of a target under a camera, and the derivative of its pixel.
fn residuals(view: &ViewEvidence, camera: &Camera, targets: &[Target]) -> Vec<Option<Vec4>> {
    let wrap = wrap_of(camera);
    let mut raw: Vec<Option<Vec4>> = targets
        .iter()
        .map(|t| {
            let p = camera.project(t.point)?;
            (*view.valid.nearest(p)).then(|| view.features.bilinear(p, wrap) - t.feature)
        })
        .collect();
    let pairs = targets.iter().map(|t| t.pair).max().map_or(0, |m| m + 1);
    for pair in 0..pairs {
        let of_pair = |c: usize| -> Vec<f32> {
            let all = targets.iter().zip(&raw);
            all.filter(|(t, _)| t.pair == pair)
                .filter_map(|(_, r)| r.map(|r| r[c]))
                .collect()
        };
        let gain = Vec4::from_array(std::array::from_fn(|c| median(of_pair(c)).unwrap_or(0.0)));
        for (t, r) in targets.iter().zip(&mut raw) {
            if let (true, Some(r)) = (t.pair == pair, r) {
                *r -= gain;
            }
        }
    }
    raw
}

fn wrap_of(camera: &Camera) -> Wrap {
    match camera.projection {
        Projection::Equirectangular => Wrap::Repeat,
        Projection::Pinhole(_) => Wrap::Clamp,
    }
}

/// Median length of the residuals.
fn spread(residuals: &[Option<Vec4>]) -> f32 {
    let all = residuals.iter().flatten().map(|r| r.truncate().length());
    median(all.collect()).unwrap_or(0.0).max(1e-3)
}

fn fit(
    view: &ViewEvidence,
    given: &Camera,
    targets: &[Target],
    start: Pose,
    used: impl Fn(usize) -> bool,
) -> Option<Fit> {
    let chosen: Vec<usize> = (0..targets.len()).filter(|&i| used(i)).collect();
    if chosen.len() < FEWEST {
        return None;
    }
    let mut pose = start;
    let mut covariance = Information::identity();
    for _ in 0..STEPS {
        let camera = moved(given, &pose);
        let all = residuals(view, &camera, targets);
        let scale = spread(&all);
        let mut a = Information::zeros();
        let mut b = Pose::zeros();
        let mut scatter = Information::zeros();
        for &i in &chosen {
            let Some(r) = all[i] else { continue };
            let Some(j) = jacobian(view, given, &pose, targets[i].point) else {
                continue;
            };
            let s = r.truncate().length() / scale;
            let weight = f64::from(1.0 / (1.0 + s * s).powi(2));
            let mut g = Pose::zeros();
            for (row, value) in j.iter().zip(r.to_array()) {
                a += row * row.transpose() * weight;
                g += row * (weight * f64::from(value));
            }
            b += g;
            scatter += g * g.transpose();
        }
        let trace = a.trace();
        if !(trace > 0.0 && trace.is_finite()) {
            return None;
        }
        for k in 0..6 {
            a[(k, k)] += 1e-6 * trace;
        }
        let inverse = a.try_inverse()?;
        pose -= inverse * b;
        // heteroscedastic ("sandwich") errors: weights and noise need not be right
        covariance = inverse * scatter * inverse;
        if !pose.iter().all(|x| x.is_finite()) || pose.norm() > 2.0 {
            return None;
        }
    }
    Some(Fit { pose, covariance })
}

/// Derivatives of the three features of a point by the six parameters.
fn jacobian(view: &ViewEvidence, given: &Camera, pose: &Pose, point: Vec3) -> Option<[Pose; 3]> {
    const STEP: f64 = 2e-3;
    let camera = moved(given, pose);
    let at = camera.project(point)?;
    let wrap = wrap_of(&camera);
    let gradient = |d: Vec2| -> Vec4 {
        (view.features.bilinear(at + d, wrap) - view.features.bilinear(at - d, wrap)) * 0.5
    };
    let (gx, gy) = (gradient(Vec2::X), gradient(Vec2::Y));
    let mut out = [Pose::zeros(); 3];
    let width = camera.width as f32;
    for k in 0..6 {
        let mut tried = *pose;
        tried[k] += STEP;
        let mut d = moved(given, &tried).project(point)? - at;
        if wrap == Wrap::Repeat {
            d.x -= width * (d.x / width).round();
        }
        let d = d / STEP as f32;
        for (c, row) in out.iter_mut().enumerate() {
            row[k] = f64::from(gx[c] * d.x + gy[c] * d.y);
        }
    }
    Some(out)
}

/// The change of a pose if it is significant, larger than its error, and visible.
fn accepted(
    view: &ViewEvidence,
    given: &Camera,
    targets: &[Target],
    start: Pose,
) -> Option<RefinedPose> {
    let best = fit(view, given, targets, start, |_| true)?;
    let significance = [0usize, 1]
        .iter()
        .map(|fold| held_out_gain(view, given, targets, start, *fold))
        .fold(f64::INFINITY, f64::min);
    let turn = DVec3::new(best.pose[0], best.pose[1], best.pose[2]);
    let shift = DVec3::new(best.pose[3], best.pose[4], best.pose[5]);
    let sigma = |k: usize| best.covariance[(k, k)].max(0.0);
    let turn_error = (sigma(0) + sigma(1) + sigma(2)).sqrt();
    let shift_error = (sigma(3) + sigma(4) + sigma(5)).sqrt();
    let seen = seen_change(given, &best.pose, targets);
    let larger = turn.length() > 3.0 * turn_error || shift.length() > 3.0 * shift_error;
    let fine = significance > SIGNIFICANT && larger && seen > LEAST && seen < MOST;
    fine.then(|| RefinedPose {
        stem: view.stem.clone(),
        turn,
        shift,
        degrees: turn.length().to_degrees(),
        degrees_error: turn_error.to_degrees(),
        metres: shift.length(),
        metres_error: shift_error,
        significance,
    })
}

/// Median angle by which the targets move as the camera sees them, degrees.
fn seen_change(given: &Camera, pose: &Pose, targets: &[Target]) -> f64 {
    let after = moved(given, pose);
    let angles = targets.iter().map(|t| {
        let local = |c: &Camera| c.world_from_camera.transpose() * (t.point - c.position);
        local(given).angle_between(local(&after))
    });
    f64::from(median(angles.collect()).unwrap_or(0.0)).to_degrees()
}

/// By how many standard errors a pose estimated from one half of the points makes the residuals of
/// the other half smaller.
fn held_out_gain(
    view: &ViewEvidence,
    given: &Camera,
    targets: &[Target],
    start: Pose,
    fold: usize,
) -> f64 {
    // blocks of points lie together on the sphere, so that neighbours do not vouch for one another
    let in_fold = |i: usize| (i / 16) % 2 == fold;
    let Some(fit) = fit(view, given, targets, start, in_fold) else {
        return f64::NEG_INFINITY;
    };
    let before = residuals(view, given, targets);
    let after = residuals(view, &moved(given, &fit.pose), targets);
    let scale = f64::from(spread(&before));
    let loss = |r: Vec4| {
        let s = f64::from(r.truncate().length()) / scale;
        s * s / (1.0 + s * s)
    };
    let gains: Vec<f64> = (0..targets.len())
        .filter(|i| !in_fold(*i))
        .filter_map(|i| Some(loss(before[i]?) - loss(after[i]?)))
        .collect();
    // means of blocks are nearly independent, single points are not
    let blocks: Vec<f64> = gains
        .chunks(8)
        .map(|b| b.iter().sum::<f64>() / b.len() as f64)
        .collect();
    let n = blocks.len() as f64;
    let mean = blocks.iter().sum::<f64>() / n.max(1.0);
    let spread = blocks.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    mean / (spread / n.max(1.0)).sqrt().max(1e-9)
}
