//! Two-dimensional arrays of pixels or texels and the few filters the pipeline needs.

mod camera_mask;
mod plane;

pub use camera_mask::CameraMask;
pub use plane::{BilinearTaps, Plane, Wrap, bilinear_taps};

use glam::Vec3;

/// Linear RGB image or texture.
pub type RgbPlane = Plane<Vec3>;
