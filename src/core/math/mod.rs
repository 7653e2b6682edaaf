//! Scalars, duals and frames: the small mathematics every other module is written in.

mod angle;
pub mod colour;
mod dual;
mod frame;
mod real;
mod sine;

pub use angle::atan2;
pub use dual::Dual;
pub use frame::Frame;
pub use real::Real;
pub use sine::fast_sin_cos;

/// Signs of the parts.
#[must_use]
pub fn signs(v: glam::Vec3) -> glam::Vec3 {
    glam::Vec3::from_array(v.to_array().map(sign))
}

/// Sign with sgn 0 = 0.
#[must_use]
pub fn sign(x: f32) -> f32 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

use glam::Vec3;

/// The coordinate axis that a normal is closest to, and its sign: 0 to 5.
#[must_use]
pub fn facing(normal: Vec3) -> u8 {
    let axis = normal.abs().max_position();
    (2 * axis + usize::from(normal[axis] < 0.0)) as u8
}

/// Relative luminance of linear Rec. 709 RGB (ITU-R BT.709 weights).
#[must_use]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Half a step of 8 bits, as a share of white: images do not show less. Derived: 0.5 / 255.
pub const HALF_STEP: f32 = 2e-3;

/// sRGB opto-electronic transfer (IEC 61966-2-1); input clamped to [0, 1].
#[must_use]
pub fn srgb_from_linear(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    }
}

/// Inverse of [`srgb_from_linear`]; input clamped to [0, 1].
#[must_use]
pub fn linear_from_srgb(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.040_45 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    }
}
