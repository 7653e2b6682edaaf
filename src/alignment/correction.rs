//! Corrections of poses: what a hypothesis of misalignment does to every camera, relative to the
//! mesh.

use crate::core::geometry::{Camera, Projection};
use crate::scene::Mirror;
use glam::{DMat3, DQuat, DVec3, Mat3};
use serde::{Deserialize, Serialize};

/// A change of all poses relative to the mesh, in the file's coordinates (y up, metres):
/// `world_from_camera' = turn · world_from_camera · camera_turn`, `position' = scale · turn ·
/// position + shift`, after an inversion of the pose if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// The pose matrices are world-to-camera and are inverted first.
    pub invert: bool,
    /// Scale of the positions.
    pub scale: f64,
    /// Orthogonal matrix of the world (a reflection if the mesh is mirrored).
    pub turn: DMat3,
    /// Shift, metres of the mesh.
    pub shift: DVec3,
    /// Rotation within the camera's axes.
    pub camera_turn: DMat3,
    /// Factor of the focal lengths of pinhole cameras.
    pub focal_scale: f32,
    /// Principal points lie in the middle of the image.
    pub centred: bool,
    /// Which pixels are mirrored or upside down.
    pub mirror: Mirror,
}

impl Default for Correction {
    fn default() -> Self {
        Self {
            invert: false,
            scale: 1.0,
            turn: DMat3::IDENTITY,
            shift: DVec3::ZERO,
            camera_turn: DMat3::IDENTITY,
            focal_scale: 1.0,
            centred: false,
            mirror: Mirror::None,
        }
    }
}

impl Correction {
    /// This correction and `next` after it; `next` must not invert.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            invert: self.invert || next.invert,
            scale: self.scale * next.scale,
            turn: next.turn * self.turn,
            shift: next.turn * self.shift * next.scale + next.shift,
            camera_turn: self.camera_turn * next.camera_turn,
            focal_scale: self.focal_scale * next.focal_scale,
            centred: self.centred || next.centred,
            mirror: if self.mirror == Mirror::None {
                next.mirror
            } else {
                self.mirror
            },
        }
    }

    /// A rotation by an axis and degrees about a fixed `centre`.
    #[must_use]
    pub fn about(centre: DVec3, axis: DVec3, degrees: f64) -> Self {
        let turn = DMat3::from_quat(DQuat::from_axis_angle(axis, degrees.to_radians()));
        Self {
            turn,
            shift: centre - turn * centre,
            ..Self::default()
        }
    }

    /// A scale about a fixed `centre`.
    #[must_use]
    pub fn scaled(centre: DVec3, scale: f64) -> Self {
        Self {
            scale,
            shift: centre * (1.0 - scale),
            ..Self::default()
        }
    }

    /// The corrected camera. `origin` is the file's place of the coordinates' origin; `z_up` says
    /// that the file's poses were turned from z up on loading. Mirrored photographs are expressed
    /// as a reflection of the camera's x axis, half a turn as one about its z axis.
    #[must_use]
    pub fn camera(&self, camera: &Camera, origin: DVec3, z_up: bool) -> Camera {
        let mut rotation = camera.world_from_camera.as_dmat3();
        let mut position = origin + camera.position.as_dvec3();
        if self.invert {
            let up = if z_up {
                crate::scene::transforms::y_up_from_z_up()
            } else {
                DMat3::IDENTITY
            };
            let stored = up.transpose() * rotation;
            position = -(up * (stored.transpose() * (up.transpose() * position)));
            rotation = up * stored.transpose();
        }
        rotation = self.turn * rotation * self.camera_turn;
        rotation *= DMat3::from_diagonal(match self.mirror {
            Mirror::None => DVec3::ONE,
            Mirror::Images | Mirror::All => DVec3::new(-1.0, 1.0, 1.0),
            Mirror::UpsideDown => DVec3::new(-1.0, -1.0, 1.0),
        });
        position = self.turn * position * self.scale + self.shift;
        Camera {
            projection: self.projection(camera),
            world_from_camera: Mat3::from_cols(
                rotation.x_axis.as_vec3(),
                rotation.y_axis.as_vec3(),
                rotation.z_axis.as_vec3(),
            ),
            position: (position - origin).as_vec3(),
            ..*camera
        }
    }

    fn projection(&self, camera: &Camera) -> Projection {
        let Projection::Pinhole(mut lens) = camera.projection else {
            return camera.projection;
        };
        if self.focal_scale != 1.0 {
            lens.fl_x *= self.focal_scale;
            lens.fl_y *= self.focal_scale;
        }
        if self.centred {
            lens.cx = 0.5 * camera.width as f32;
            lens.cy = 0.5 * camera.height as f32;
        }
        Projection::Pinhole(lens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn the_inverse_of_a_world_to_camera_pose_is_the_camera() {
        let rotation = DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(0.2);
        let position = DVec3::new(1.0, 2.0, -3.0);
        let origin = DVec3::new(0.5, 0.25, 1.0);
        let stored = Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: rotation.transpose().as_mat3(),
            position: (-(rotation.transpose() * position) - origin).as_vec3(),
        };
        let invert = Correction {
            invert: true,
            ..Correction::default()
        };
        let right = invert.camera(&stored, origin, false);
        assert!((right.position - (position - origin).as_vec3()).length() < 1e-5);
        assert!(
            right
                .world_from_camera
                .abs_diff_eq(rotation.as_mat3(), 1e-6)
        );
    }

    #[test]
    fn corrections_follow_one_another() {
        let a = Correction::scaled(DVec3::new(1.0, 2.0, 3.0), 0.3);
        let b = Correction::about(DVec3::new(-1.0, 0.0, 2.0), DVec3::Y, 40.0);
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: Mat3::from_rotation_y(0.7),
            position: Vec3::new(2.0, 1.0, -1.0),
        };
        let origin = DVec3::new(3.0, 0.0, 1.0);
        let twice = b.camera(&a.camera(&camera, origin, false), origin, false);
        let once = a.then(&b).camera(&camera, origin, false);
        assert!((twice.position - once.position).length() < 1e-5);
        assert!(
            twice
                .world_from_camera
                .abs_diff_eq(once.world_from_camera, 1e-5)
        );
        let same = Correction::default().camera(&camera, origin, false);
        assert!((same.position - camera.position).length() < 1e-6);
    }
}
