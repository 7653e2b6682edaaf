//! A correction applied to a scene in memory.

use super::correction::Correction;
use super::refine::RefinedPose;
use super::verdict::Alignment;
use crate::scene::{Mirror, Scene};
use glam::{DMat3, DVec3};

/// Distance from cameras to surfaces in the rooms people live in, metres: the geometric middle of
/// 1 and 6 m. It only decides between two scales that are a unit apart.
const USUAL_DISTANCE: f64 = 2.5;
/// Scales nearer to 1 than this are no units (the nearest is 3.28, feet).
const LEAST_UNIT: f64 = 2.0;

/// How mesh and poses change together: `x' = scale · turn · x`, so that metres and "up" are right.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Common {
    scale: f64,
    turn: DMat3,
}

/// Changes the scene by a correction.
///
/// A correction says where cameras stand relative to the mesh; which of the two was wrong is taken
/// from the other's plausibility: the mesh is turned where the poses' "up" was right, and scaled
/// where the distances in metres (`distance`, from corrected cameras to the mesh, in units of the
/// mesh) are unusual for rooms. A reflection always changes the mesh.
pub fn apply(scene: &mut Scene, correction: &Correction, distance: f64) {
    let common = common(scene, correction, distance);
    let (origin, z_up) = (scene.origin, scene.z_up);
    let moved = |x: DVec3| common.turn * x * common.scale;
    let new_origin = moved(origin);
    for view in &mut scene.views {
        // mirrored photographs are turned back when they are read, so that cameras stay proper
        let pose = Correction {
            mirror: Mirror::None,
            ..*correction
        };
        let camera = pose.camera(&view.camera, origin, z_up);
        let position = moved(origin + camera.position.as_dvec3());
        view.camera = camera;
        view.camera.world_from_camera =
            (common.turn * camera.world_from_camera.as_dmat3()).as_mat3();
        view.camera.position = (position - new_origin).as_vec3();
    }
    // mirrored twice is right again
    scene.mirror = match (scene.mirror, correction.mirror) {
        (before, Mirror::None) => before,
        (before, now) if before == now => Mirror::None,
        (_, now) => now,
    };
    if common.scale == 1.0 && common.turn == DMat3::IDENTITY {
        return;
    }
    let turn = common.turn.as_mat3();
    for p in &mut scene.mesh.positions {
        *p = (common.turn * p.as_dvec3() * common.scale).as_vec3();
    }
    for n in &mut scene.mesh.normals {
        *n = turn * *n;
    }
    if common.turn.determinant() < 0.0 {
        for t in &mut scene.mesh.triangles {
            t.swap(1, 2);
        }
    }
    scene.origin = new_origin;
    scene.rooms = None;
}

/// Changes the cameras whose poses were refined.
pub fn refine_poses(scene: &mut Scene, refined: &[RefinedPose]) {
    for pose in refined {
        for view in scene.views.iter_mut().filter(|v| v.stem == pose.stem) {
            view.camera = pose.camera(&view.camera);
        }
    }
}

impl Alignment {
    /// Applies what was corrected and refined in an earlier run to the scene as it is read again.
    pub fn reapply(&self, scene: &mut Scene) {
        if let (true, Some(c)) = (self.fixed, &self.correction) {
            apply(scene, c, self.corrected_distance);
        }
        refine_poses(scene, &self.refined);
    }
}

fn common(scene: &Scene, c: &Correction, distance: f64) -> Common {
    let log = |d: f64| (d.max(f64::MIN_POSITIVE) / USUAL_DISTANCE).ln().abs();
    // the mesh takes up the scale if that makes its rooms more usual
    let is_unit = c.scale.ln().abs() > LEAST_UNIT.ln();
    let scale = if is_unit && log(distance / c.scale) < log(distance) {
        1.0 / c.scale
    } else {
        1.0
    };
    let up = |turn: DMat3| -> f64 {
        scene
            .views
            .iter()
            .map(|v| {
                let camera = c.camera(&v.camera, scene.origin, scene.z_up);
                (turn * camera.world_from_camera.y_axis.as_dvec3()).y
            })
            .sum()
    };
    let inverse = c.turn.transpose();
    let turn = if c.turn.determinant() < 0.0 || up(inverse) > up(DMat3::IDENTITY) + 1e-3 {
        inverse
    } else {
        DMat3::IDENTITY
    };
    Common { scale, turn }
}
