//! The poses of all views at once, by what the photographs show of the same surface.
//!
//! A pixel of one view is followed to the mesh and looked up in another view that sees the place;
//! the two differ by a gain per pair and by errors of both poses. Moving the first camera slides the
//! point along its surface, moving the second moves where it is seen, so that every residual
//! depends on twelve parameters; the normal equations of all views are solved together (direct image
//! alignment as Engel, Koltun and Cremers 2018; camera poses over a fixed mesh as Zhou and Koltun
//! 2014, whose alternation between texture and poses this replaces: alternating forgets that the
//! texture moves with the poses). Weights are Geman–McClure's.

use super::evidence::ViewEvidence;
use super::score::{Ground, Lookup, lookups};
use crate::core::geometry::Camera;
use crate::core::image::Wrap;
use crate::core::parallel::prelude::*;
use crate::core::stats::{MAD_SCALE, SURELY, median};
use crate::gbuffer::wrap_of;
use glam::{DQuat, DVec3, Mat3, Quat, Vec2, Vec3, Vec4};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Steps of Gauss–Newton while what sees what is kept.
const STEPS: usize = 4;
/// Residuals a view needs, in both directions.
const FEWEST: usize = 120;
/// Residuals that lie together and count as one where errors are estimated.
const CLUSTER: usize = 8;
/// Residuals below this differ by rounding, ln radiance.
const LEAST_NOISE: f32 = 1e-3;
/// Standard deviation of the pose before anything is seen, degrees at the median distance of what
/// the view sees: wide enough to say nothing where there is anything to see.
pub(super) const WIDE: f64 = 12.0;

/// Change of a pose: rotation vector in the camera's axes, radians, and shift in the world, metres.
pub(super) type Pose = SVector<f64, 6>;
type Both = SVector<f64, 12>;
type Information = SMatrix<f64, 12, 12>;

/// The vector of a turn and a shift.
pub(super) fn pose_vector(turn: DVec3, shift: DVec3) -> Pose {
    Pose::from_column_slice(&[turn.x, turn.y, turn.z, shift.x, shift.y, shift.z])
}

/// A camera after a change of its pose.
pub(super) fn moved(camera: &Camera, x: &Pose) -> Camera {
    let by = DQuat::from_scaled_axis(DVec3::new(x[0], x[1], x[2]));
    let quat = Quat::from_xyzw(by.x as f32, by.y as f32, by.z as f32, by.w as f32);
    Camera {
        world_from_camera: camera.world_from_camera * Mat3::from_quat(quat),
        position: camera.position + Vec3::new(x[3] as f32, x[4] as f32, x[5] as f32),
        ..*camera
    }
}

/// A pixel of one view on the surface that it meets.
pub(super) struct Target {
    /// Direction to it in that view's axes.
    ray: Vec3,
    /// Point of the surface.
    pub point: Vec3,
    /// The surface's normal.
    normal: Vec3,
    /// What the view shows of it.
    feature: Vec4,
}

/// What one view shows and another sees too.
pub(super) struct Pair {
    /// The view that shows it.
    pub from: usize,
    /// The view it is looked up in.
    pub into: usize,
    /// The places.
    pub targets: Vec<Target>,
}

/// All pairs of views with something in common, under these cameras.
pub(super) fn pairs(ground: &Ground<'_>, views: &[ViewEvidence], cameras: &[Camera]) -> Vec<Pair> {
    let mut out: Vec<Pair> = Vec::new();
    for Lookup {
        from,
        into,
        point,
        normal,
        feature,
    } in lookups(ground, views, cameras)
    {
        let camera = &cameras[from];
        let target = Target {
            ray: camera.world_from_camera.transpose() * (point - camera.position).normalize(),
            point,
            normal,
            feature,
        };
        match out.last_mut() {
            Some(p) if p.from == from && p.into == into => p.targets.push(target),
            _ => out.push(Pair {
                from,
                into,
                targets: vec![target],
            }),
        }
    }
    out
}

/// The poses that fit, and how sure they are.
pub(super) struct JointFit {
    /// Change of each view's pose.
    pub poses: Vec<Pose>,
    /// Variances of its six numbers.
    pub variances: Vec<Pose>,
}

/// Whether target `i` of a pair takes part in a fit.
pub(super) type Used<'a> = dyn Fn(usize) -> bool + Sync + 'a;

/// The poses under which the pairs agree best, from `start` on. Views of which too little is seen
/// stay where `start` has them. `None` if the equations cannot be solved.
pub(super) fn joint_fit(
    views: &[ViewEvidence],
    pairs: &[Pair],
    start: &[Pose],
    used: &Used<'_>,
) -> Option<JointFit> {
    let mut seen = vec![0usize; views.len()];
    for p in pairs {
        let n = (0..p.targets.len()).filter(|&i| used(i)).count();
        seen[p.from] += n;
        seen[p.into] += n;
    }
    // the column of a view's first unknown
    let mut unknowns = 0;
    let column: Vec<Option<usize>> = (0..views.len())
        .map(|v| {
            (seen[v] >= FEWEST).then(|| {
                unknowns += 6;
                unknowns - 6
            })
        })
        .collect();
    let mut fit = JointFit {
        poses: start.to_vec(),
        variances: vec![Pose::zeros(); views.len()],
    };
    if unknowns == 0 {
        return Some(fit);
    }
    let distances = distances(views, pairs);
    for step in 0..STEPS {
        let cameras = cameras_of(views, &fit.poses);
        let residuals = residuals(views, pairs, &cameras);
        let scales = scales(views, pairs, &residuals);
        let terms: Vec<Terms> = (pairs.par_iter().zip(&residuals))
            .map(|(p, r)| {
                let scaled = Scaled {
                    residuals: r,
                    scale: scales[p.into],
                };
                p.terms(&views[p.into], &cameras, &scaled, used)
            })
            .collect();
        let mut normal = Normal::prior(&distances, &fit.poses, &column, unknowns);
        for (p, t) in pairs.iter().zip(&terms) {
            normal.add([column[p.from], column[p.into]], t);
        }
        let factor = normal.information.clone().cholesky()?;
        let change = factor.solve(&normal.gradient);
        for (pose, at) in fit.poses.iter_mut().zip(&column) {
            if let Some(at) = at {
                *pose -= change.fixed_rows::<6>(*at);
            }
        }
        let finite = fit.poses.iter().flatten().all(|x| x.is_finite());
        if !finite {
            return None;
        }
        if step + 1 == STEPS {
            // heteroscedastic ("sandwich") errors: weights and noise need not be right
            let inverse = factor.inverse();
            let covariance = &inverse * normal.scatter * &inverse;
            for (variance, at) in fit.variances.iter_mut().zip(&column) {
                if let Some(at) = at {
                    *variance = Pose::from_fn(|k, _| covariance[(at + k, at + k)].max(0.0));
                }
            }
        }
    }
    Some(fit)
}

/// The cameras as loaded, each with the change of its pose.
pub(super) fn cameras_of(views: &[ViewEvidence], poses: &[Pose]) -> Vec<Camera> {
    let both = views.iter().zip(poses);
    both.map(|(v, x)| moved(&v.camera, x)).collect()
}

/// What each of a pair's targets differs by; `None` where it is not seen.
pub(super) type Residuals = Vec<Option<Vec4>>;

/// The residuals of each pair under these cameras.
pub(super) fn residuals(
    views: &[ViewEvidence],
    pairs: &[Pair],
    cameras: &[Camera],
) -> Vec<Residuals> {
    let of = |p: &Pair| p.residuals(&views[p.into], cameras);
    pairs.par_iter().map(of).collect()
}

/// Median distance of each view, as loaded, to what is looked up in it, metres; `None` if that is
/// nothing.
pub(super) fn distances(views: &[ViewEvidence], pairs: &[Pair]) -> Vec<Option<f32>> {
    let mut of_view: Vec<Vec<f32>> = vec![Vec::new(); views.len()];
    for p in pairs {
        let eye = views[p.into].camera.position;
        of_view[p.into].extend(p.targets.iter().map(|t| t.point.distance(eye)));
    }
    of_view.into_iter().map(median).collect()
}

/// Size of the residuals that counts half, per view and feature: what noise reaches at most. (A third
/// of it leaves poses that are two degrees off at half a degree: docs/lab/alignment.md.)
pub(super) fn scales(views: &[ViewEvidence], pairs: &[Pair], residuals: &[Residuals]) -> Vec<Vec4> {
    let mut of_view: Vec<Vec<Vec4>> = vec![Vec::new(); views.len()];
    for (p, r) in pairs.iter().zip(residuals) {
        of_view[p.into].extend(r.iter().flatten());
    }
    let scale = |all: &Vec<Vec4>| {
        let feature = |c: usize| median(all.iter().map(|r| r[c].abs()).collect()).unwrap_or(0.0);
        let noise = Vec4::from_array(std::array::from_fn(feature)) * (SURELY * MAD_SCALE);
        noise.max(Vec4::splat(LEAST_NOISE))
    };
    of_view.par_iter().map(scale).collect()
}

/// The equations of all unknowns.
struct Normal {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Sum of the squares of the gradient's parts.
    scatter: DMatrix<f64>,
}

impl Normal {
    fn prior(
        distances: &[Option<f32>],
        poses: &[Pose],
        column: &[Option<usize>],
        unknowns: usize,
    ) -> Self {
        let mut out = Self {
            information: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
            scatter: DMatrix::zeros(unknowns, unknowns),
        };
        for (v, at) in column.iter().enumerate() {
            let Some(at) = at else { continue };
            let distance = distances[v].unwrap_or(1.0);
            let metres = f64::from(distance.max(f32::MIN_POSITIVE));
            for (k, change) in poses[v].iter().enumerate() {
                let unit = if k < 3 { 1.0 } else { metres };
                let weight = (WIDE.to_radians() * unit).powi(-2);
                out.information[(at + k, at + k)] += weight;
                out.gradient[at + k] += weight * change;
            }
        }
        out
    }

    fn add(&mut self, column: [Option<usize>; 2], terms: &Terms) {
        for (a, row) in column.iter().enumerate() {
            let Some(row) = *row else { continue };
            let part = terms.gradient.fixed_rows::<6>(6 * a);
            let mut gradient = self.gradient.fixed_rows_mut::<6>(row);
            gradient += part;
            for (b, at) in column.iter().enumerate() {
                let Some(at) = *at else { continue };
                let mut block = self.information.fixed_view_mut::<6, 6>(row, at);
                block += terms.information.fixed_view::<6, 6>(6 * a, 6 * b);
                let mut block = self.scatter.fixed_view_mut::<6, 6>(row, at);
                block += terms.scatter.fixed_view::<6, 6>(6 * a, 6 * b);
            }
        }
    }
}

/// The residuals of a pair, and the size of them that counts half.
struct Scaled<'a> {
    residuals: &'a [Option<Vec4>],
    scale: Vec4,
}

/// What one pair adds to the equations, for the six numbers of `from` and the six of `into`.
struct Terms {
    information: Information,
    gradient: Both,
    scatter: Information,
}

impl Pair {
    /// Where `into` sees a target, and the point that `from`'s ray meets.
    fn place(&self, target: &Target, cameras: &[Camera]) -> Option<(Vec2, Vec3)> {
        let camera = &cameras[self.from];
        let direction = camera.world_from_camera * target.ray;
        let slope = target.normal.dot(direction);
        let along = target.normal.dot(target.point - camera.position) / slope;
        if !(along > 0.0 && along.is_finite()) {
            return None;
        }
        let point = camera.position + along * direction;
        Some((cameras[self.into].project(point)?, point))
    }

    /// What `view`, which is `into`, shows of each target less what `from` does, less the pair's
    /// gain.
    pub(super) fn residuals(&self, view: &ViewEvidence, cameras: &[Camera]) -> Residuals {
        let wrap = wrap_of(&view.camera);
        let mut all: Residuals = (self.targets.iter())
            .map(|t| {
                let (pixel, _) = self.place(t, cameras)?;
                let seen = *view.valid.nearest(pixel);
                seen.then(|| view.features.bilinear(pixel, wrap) - t.feature)
            })
            .collect();
        let gain = Vec4::from_array(std::array::from_fn(|c| {
            median(all.iter().flatten().map(|r| r[c]).collect()).unwrap_or(0.0)
        }));
        for r in all.iter_mut().flatten() {
            *r -= gain;
        }
        all
    }

    fn terms(
        &self,
        view: &ViewEvidence,
        cameras: &[Camera],
        scaled: &Scaled<'_>,
        used: &Used<'_>,
    ) -> Terms {
        let Scaled { residuals, scale } = *scaled;
        let mut out = Terms {
            information: Information::zeros(),
            gradient: Both::zeros(),
            scatter: Information::zeros(),
        };
        let chosen: Vec<usize> = (0..self.targets.len()).filter(|&i| used(i)).collect();
        for cluster in chosen.chunks(CLUSTER) {
            let mut g = Both::zeros();
            for &i in cluster {
                let Some(r) = residuals[i].map(|r| r / scale) else {
                    continue;
                };
                let Some(rows) = self.derivatives(view, cameras, &self.targets[i]) else {
                    continue;
                };
                for (c, row) in rows.iter().enumerate() {
                    let row = row / f64::from(scale[c]);
                    let value = r[c];
                    let weight = f64::from(1.0 / (1.0 + value * value).powi(2));
                    out.information.ger(weight, &row, &row, 1.0);
                    g += row * (weight * f64::from(value));
                }
            }
            out.gradient += g;
            out.scatter.ger(1.0, &g, &g, 1.0);
        }
        out
    }

    /// Derivatives of a target's four features by the twelve parameters.
    fn derivatives(
        &self,
        view: &ViewEvidence,
        cameras: &[Camera],
        target: &Target,
    ) -> Option<[Both; 4]> {
        let (at, point) = self.place(target, cameras)?;
        let wrap = wrap_of(&view.camera);
        let gradient = |d: Vec2| -> Vec4 {
            (view.features.bilinear(at + d, wrap) - view.features.bilinear(at - d, wrap)) * 0.5
        };
        let (gx, gy) = (gradient(Vec2::X), gradient(Vec2::Y));
        let steps = self.pixel_by_poses(cameras, target, point)?;
        Some(std::array::from_fn(|c| {
            Both::from_fn(|k, _| f64::from(gx[c] * steps[k].x + gy[c] * steps[k].y))
        }))
    }

    /// Derivatives of where `into` sees a target, which `from`'s ray meets at `point`, by the turn and
    /// shift of `from` and of `into`, pixels.
    fn pixel_by_poses(
        &self,
        cameras: &[Camera],
        target: &Target,
        point: Vec3,
    ) -> Option<[Vec2; 12]> {
        let (from, into) = (&cameras[self.from], &cameras[self.into]);
        let by_point = pixel_by_point(into, point)?;
        let ray = from.world_from_camera * target.ray;
        let along = (point - from.position).length();
        // a step of the ray that leaves the surface slides back along the ray
        let on_surface =
            |step: Vec3| step - ray * (target.normal.dot(step) / target.normal.dot(ray));
        let local = into.world_from_camera.transpose() * (point - into.position);
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let step = |k: usize| -> Vec3 {
            let e = axes[k % 3];
            match k / 3 {
                0 => on_surface(along * (from.world_from_camera * e.cross(target.ray))),
                1 => on_surface(e),
                2 => into.world_from_camera * local.cross(e),
                _ => -e,
            }
        };
        Some(std::array::from_fn(|k| {
            let s = step(k);
            by_point[0] * s.x + by_point[1] * s.y + by_point[2] * s.z
        }))
    }
}

/// Derivatives of a point's pixel by the point's three coordinates, by central differences.
fn pixel_by_point(camera: &Camera, point: Vec3) -> Option<[Vec2; 3]> {
    // a thousandth of the distance: rounding of single precision is a ten-thousandth of that
    let h = 1e-3 * (point - camera.position).length();
    let width = camera.width as f32;
    let difference = |e: Vec3| -> Option<Vec2> {
        let mut d = camera.project(point + h * e)? - camera.project(point - h * e)?;
        if wrap_of(camera) == Wrap::Repeat {
            d.x -= width * (d.x / width).round();
        }
        Some(d / (2.0 * h))
    };
    Some([
        difference(Vec3::X)?,
        difference(Vec3::Y)?,
        difference(Vec3::Z)?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Lens, Projection};

    fn camera(projection: Projection, turn: DVec3, position: Vec3) -> Camera {
        let camera = Camera {
            projection,
            width: 256,
            height: 128,
            world_from_camera: Mat3::IDENTITY,
            position,
        };
        moved(&camera, &pose_vector(turn, DVec3::ZERO))
    }

    /// The derivatives of where a target is seen, against the poses moved a little, for both
    /// projections and a slanting surface.
    #[test]
    fn derivatives_are_those_of_moving_either_camera() {
        let lens = Projection::Pinhole(Lens {
            fl_x: 120.0,
            fl_y: 110.0,
            cx: 128.0,
            cy: 64.0,
            ..Lens::default()
        });
        let normal = Vec3::new(0.3, -0.2, 1.0).normalize();
        let point = Vec3::new(0.4, 0.2, -3.0);
        for projection in [Projection::Equirectangular, lens] {
            let from = camera(
                projection,
                DVec3::new(0.1, -0.2, 0.05),
                Vec3::new(0.5, 0.1, 0.3),
            );
            let into = camera(
                projection,
                DVec3::new(-0.1, 0.1, 0.2),
                Vec3::new(-0.6, 0.0, 0.1),
            );
            let target = Target {
                ray: from.world_from_camera.transpose() * (point - from.position).normalize(),
                point,
                normal,
                feature: Vec4::ZERO,
            };
            let pair = Pair {
                from: 0,
                into: 1,
                targets: Vec::new(),
            };
            let cameras = [from, into];
            let found = pair
                .pixel_by_poses(&cameras, &target, point)
                .expect("is seen");
            for (k, d) in found.iter().enumerate() {
                let at = |step: f64| {
                    let mut x = Pose::zeros();
                    x[k % 6] = step;
                    let mut cameras = cameras;
                    cameras[k / 6] = moved(&cameras[k / 6], &x);
                    pair.place(&target, &cameras).expect("is seen").0
                };
                let expected = (at(5e-3) - at(-5e-3)) / 1e-2;
                assert!(
                    (*d - expected).length() < 0.01 * (1.0 + expected.length()),
                    "{k}: {d} for {expected}"
                );
            }
        }
    }
}
