//! Axes of cameras. Programs that reconstruct have y down and z forward (OpenCV); a scene's cameras have
//! y up and z backward (OpenGL).

use glam::{DMat4, DVec3};

/// What turns the ones into the others, and back: x stays.
pub(super) const HALF_TURN: DVec3 = DVec3::new(1.0, -1.0, -1.0);

/// OpenGL camera-to-world of an OpenCV camera-to-world.
pub(super) fn gl_from_cv(world_from_camera: DMat4) -> DMat4 {
    world_from_camera * DMat4::from_scale(HALF_TURN)
}
