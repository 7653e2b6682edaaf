//! From radiance to pictures: exposure and the sRGB curve.

use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How radiance is brought into the range of a screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Exposure {
    /// The brightest tenth of the first picture's pixels clips; the others follow it.
    #[default]
    Auto,
    /// Factor 2^ev.
    Stops(f32),
}

impl FromStr for Exposure {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        if s == "auto" {
            return Ok(Self::Auto);
        }
        match s.parse::<f32>() {
            Ok(ev) if ev.abs() <= 60.0 => Ok(Self::Stops(ev)),
            _ => Err(format!(
                "\"{s}\" is no exposure; expected \"auto\" or stops between -60 and 60, such as -1.5"
            )),
        }
    }
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Stops(ev) => write!(f, "{ev}"),
        }
    }
}

impl TryFrom<String> for Exposure {
    type Error = String;
    fn try_from(s: String) -> Result<Self, String> {
        s.parse()
    }
}

impl From<Exposure> for String {
    fn from(e: Exposure) -> Self {
        e.to_string()
    }
}

impl Exposure {
    /// The factor on radiance; `image` decides where that is left to the program.
    #[must_use]
    pub fn factor(self, image: &RgbPlane) -> f32 {
        match self {
            Self::Stops(ev) => ev.exp2(),
            Self::Auto => {
                let mut l: Vec<f32> = image
                    .data
                    .iter()
                    .map(|&c| luminance(c))
                    .filter(|l| l.is_finite())
                    .collect();
                l.sort_by(f32::total_cmp);
                let bright = l.get(l.len() * 9 / 10).copied().unwrap_or(0.0);
                if bright > 0.0 { 0.8 / bright } else { 1.0 }
            }
        }
    }
}

/// 8-bit sRGB of `image · factor`, row-major RGB.
#[must_use]
pub fn tone_map(image: &RgbPlane, factor: f32, encode: impl Fn(f32) -> u8) -> Vec<u8> {
    image
        .data
        .iter()
        .flat_map(|c| (*c * factor).to_array().map(&encode))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use glam::Vec3;

    #[test]
    fn exposures_read_back_what_they_print() {
        for e in [Exposure::Auto, Exposure::Stops(-1.5), Exposure::Stops(0.0)] {
            assert_eq!(e.to_string().parse::<Exposure>(), Ok(e));
        }
        assert!("bright".parse::<Exposure>().is_err() && "nan".parse::<Exposure>().is_err());
    }

    #[test]
    fn automatic_exposure_is_scale_free() {
        let image = |s: f32| Plane {
            width: 10,
            height: 10,
            data: (0..100).map(|i| Vec3::splat(s * i as f32)).collect(),
        };
        let (a, b) = (
            Exposure::Auto.factor(&image(1.0)),
            Exposure::Auto.factor(&image(1000.0)),
        );
        assert!((a / b - 1000.0).abs() < 0.1);
        assert_eq!(Exposure::Auto.factor(&image(0.0)), 1.0);
        assert_eq!(Exposure::Stops(1.0).factor(&image(3.0)), 2.0);
    }
}
