//! Lamps that a lighting adds to a scene.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A lamp that the scene does not have. Positions in the coordinates of the scene's file, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Added {
    /// A luminous rectangle that shines along `direction`.
    Quad {
        /// Centre.
        position: [f64; 3],
        /// Where it shines.
        direction: [f32; 3],
        /// Width and height.
        size: [f32; 2],
        /// Emitted radiance.
        radiance: [f32; 3],
    },
    /// A luminous sphere.
    Sphere {
        /// Centre.
        position: [f64; 3],
        /// Radius.
        radius: f32,
        /// Emitted radiance.
        radiance: [f32; 3],
    },
    /// A bulb without extent.
    Point {
        /// Place.
        position: [f64; 3],
        /// Radiant intensity per steradian.
        intensity: [f32; 3],
    },
    /// A spotlight without extent.
    Spot {
        /// Place.
        position: [f64; 3],
        /// Axis of the cone.
        direction: [f32; 3],
        /// Angle between axis and edge of the cone, degrees, above 0 to 90.
        angle: f32,
        /// Share of the angle over which the light fades, 0 to 1.
        #[serde(default)]
        blend: f32,
        /// Radiant intensity on the axis, per steradian.
        intensity: [f32; 3],
    },
    /// A measured luminaire without extent.
    Ies {
        /// Place.
        position: [f64; 3],
        /// Where its axis points (vertical angle 0 of the file); down if not given.
        #[serde(default = "down")]
        direction: [f32; 3],
        /// IES file (LM-63, type C), relative to the lighting file.
        file: PathBuf,
        /// Turn about the axis, degrees.
        #[serde(default)]
        turn: f32,
        /// Radiant intensity where the luminaire is brightest, per steradian.
        intensity: [f32; 3],
    },
}

impl Added {
    /// Whether it is a lamp, and somewhere.
    ///
    /// # Errors
    /// What is out of range, in words that begin with its key.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        let (Self::Quad { position, .. }
        | Self::Sphere { position, .. }
        | Self::Point { position, .. }
        | Self::Spot { position, .. }
        | Self::Ies { position, .. }) = self;
        finite(position, ".position")?;
        match self {
            Self::Quad {
                direction,
                size,
                radiance,
                ..
            } => {
                points_somewhere(direction)?;
                size.iter().try_for_each(|s| extent(*s, ".size"))?;
                light(radiance, ".radiance")
            }
            Self::Sphere {
                radius, radiance, ..
            } => {
                extent(*radius, ".radius")?;
                light(radiance, ".radiance")
            }
            Self::Point { intensity, .. } => light(intensity, ".intensity"),
            Self::Spot {
                direction,
                angle,
                blend,
                intensity,
                ..
            } => {
                points_somewhere(direction)?;
                if !(*angle > 0.0 && *angle <= 90.0) {
                    return Err(format!(
                        ".angle: {angle}; expected above 0 to 90 degrees from the axis (what shines wider is a point)"
                    ));
                }
                if !(0.0..=1.0).contains(blend) {
                    return Err(format!(".blend: {blend}; expected 0 to 1"));
                }
                light(intensity, ".intensity")
            }
            Self::Ies {
                direction,
                turn,
                intensity,
                ..
            } => {
                points_somewhere(direction)?;
                finite(&[f64::from(*turn)], ".turn")?;
                light(intensity, ".intensity")
            }
        }
    }
}

fn points_somewhere(direction: &[f32; 3]) -> std::result::Result<(), String> {
    match Vec3::from_array(*direction).try_normalize() {
        Some(_) => Ok(()),
        None => Err(format!(
            ".direction: {direction:?}; expected finite numbers, not all 0"
        )),
    }
}

fn extent(length: f32, key: &str) -> std::result::Result<(), String> {
    match length.is_finite() && length > 0.0 {
        true => Ok(()),
        false => Err(format!("{key}: {length}; expected metres above 0")),
    }
}

fn down() -> [f32; 3] {
    [0.0, -1.0, 0.0]
}

/// Whether values are light.
pub(super) fn light(values: &[f32], what: &str) -> std::result::Result<(), String> {
    match values.iter().all(|v| v.is_finite() && *v >= 0.0) {
        true => Ok(()),
        false => Err(format!(
            "{what}: {values:?}; light is finite and not negative"
        )),
    }
}

/// Whether values are those of a place or a direction.
pub(super) fn finite(values: &[f64], what: &str) -> std::result::Result<(), String> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(format!("{what}: {values:?}; expected finite numbers")),
    }
}
