//! Linear files that hold an 8-bit picture: its 256 levels, saved as OpenEXR or Radiance HDR without
//! undoing the curve. Linear light would show bands in steps of that size, and nobody stores it so.
//! Called by the readers of photographs.

use crate::core::image::RgbPlane;

/// How a file rounds what is stored in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rounding {
    /// Half or single precision.
    Float,
    /// Eight bits of mantissa, shared by the channels, rounded or cut off.
    Rgbe,
}

/// A few levels are a drawing (a mask, a test card), which says nothing.
const LEVELS: usize = 32;
/// Bits of evidence that RGBE must give: how improbable it is that all values are levels by chance.
/// Derived: once in 16 million images.
const EVIDENCE: f32 = 24.0;

/// Octaves below white that are told apart; darker values count as the last.
const OCTAVES: usize = 16;

/// The stored value that stands for white, 1 or 255, if all values are levels of an 8-bit picture.
#[must_use]
pub fn white_of_levels(pixels: &RgbPlane, rounding: Rounding) -> Option<f32> {
    [1.0, 255.0].into_iter().find(|white| match rounding {
        Rounding::Float => are_float_levels(pixels, *white),
        // steps that a level may lie below and above what is stored: cut off, or rounded
        Rounding::Rgbe => [[0.0, 1.0], [0.5, 0.5]]
            .into_iter()
            .any(|slack| are_rgbe_levels(pixels, *white, slack)),
    })
}

fn are_float_levels(pixels: &RgbPlane, white: f32) -> bool {
    // half precision rounds values below 1 by 2⁻¹² at most: 0.062 of a level, which an eighth of all
    // numbers keep by chance; whole numbers it keeps
    let rounded = if white == 1.0 { 255.0 / 4096.0 } else { 0.0 } + 1e-3;
    let mut met = [false; 256];
    for v in pixels.data.iter().flat_map(|p| p.to_array()) {
        let scaled = v * (255.0 / white);
        let level = scaled.round();
        if !(0.0..=255.0).contains(&level) || (scaled - level).abs() > rounded {
            return false;
        }
        met[level as usize] = true;
    }
    met.iter().filter(|m| **m).count() >= LEVELS
}

fn are_rgbe_levels(pixels: &RgbPlane, white: f32, slack: [f32; 2]) -> bool {
    let top = white.log2().floor();
    let step_of = |octave: usize| (top - 7.0 - octave as f32).exp2();
    // by octave of the brightest channel, whose step the others share
    let mut met = [[false; 256]; OCTAVES];
    for p in &pixels.data {
        let most = p.max_element();
        if !p.is_finite() || p.min_element() < 0.0 || most > white * 1.01 {
            return false;
        }
        let below = (top - most.log2().floor()).clamp(0.0, OCTAVES as f32 - 1.0);
        let step = step_of(below as usize);
        for v in p.to_array() {
            let Some(k) = rgbe_level(v, white, slack.map(|s| s * step)) else {
                return false;
            };
            met[below as usize][k] = true;
        }
    }
    let levels = (0..256).filter(|k| met.iter().any(|octave| octave[*k]));
    let evidence = |octave: usize| {
        // how many steps there are to a level: one of them is taken for it
        let bits = (white / 255.0 / step_of(octave)).log2().max(0.0);
        met[octave][1..].iter().filter(|m| **m).count() as f32 * bits
    };
    levels.count() >= LEVELS && (0..OCTAVES).map(evidence).sum::<f32>() >= EVIDENCE
}

/// The level within `slack` below and above a stored value; whole numbers are stored as they are.
fn rgbe_level(v: f32, white: f32, slack: [f32; 2]) -> Option<usize> {
    let [below, above] = if white == 1.0 { slack } else { [0.0; 2] };
    let level = |v: f32| v * (255.0 / white);
    let first = (level(v - below) - 1e-3).ceil().max(0.0);
    (first <= level(v + above) + 1e-3 && first <= 255.0).then_some(first as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use glam::Vec3;

    /// All levels, as grey pixels, through `store`.
    fn picture(store: impl Fn(f32) -> f32) -> RgbPlane {
        Plane {
            width: 256,
            height: 1,
            data: (0..256).map(|k| Vec3::splat(store(k as f32))).collect(),
        }
    }

    /// Eight bits of mantissa, the rest cut off (OpenCV) or rounded (Radiance).
    fn rgbe(v: f32, half: f32) -> f32 {
        let step = (v.log2().floor() - 7.0).exp2();
        if v > 0.0 {
            (v / step + half).floor() * step
        } else {
            0.0
        }
    }

    #[test]
    fn levels_are_found_in_every_file_that_holds_them() {
        let half = |v: f32| half::f16::from_f32(v).to_f32();
        let white = |store: &dyn Fn(f32) -> f32, r| white_of_levels(&picture(store), r);
        assert_eq!(white(&|k| half(k / 255.0), Rounding::Float), Some(1.0));
        assert_eq!(white(&|k| half(k), Rounding::Float), Some(255.0));
        for rest in [0.0, 0.5] {
            assert_eq!(white(&|k| rgbe(k / 255.0, rest), Rounding::Rgbe), Some(1.0));
            assert_eq!(white(&|k| rgbe(k, rest), Rounding::Rgbe), Some(255.0));
        }
    }

    #[test]
    fn bright_pictures_are_known_too() {
        let mut bright = picture(|k| k.max(60.0));
        assert_eq!(white_of_levels(&bright, Rounding::Rgbe), Some(255.0));
        // where whole numbers are all that can be stored they say nothing
        bright = picture(|k| 128.0 + k / 2.0).map(|p| p.floor());
        assert_eq!(white_of_levels(&bright, Rounding::Rgbe), None);
    }

    #[test]
    fn light_is_not_taken_for_levels() {
        for top in [0.7, 1.0, 13.0, 255.0, 400.0] {
            let light = |k: f32| top * (k / 255.0).powf(2.2);
            for (rounding, image) in [
                (Rounding::Float, picture(light)),
                (Rounding::Rgbe, picture(|k| rgbe(light(k), 0.0))),
            ] {
                assert_eq!(white_of_levels(&image, rounding), None, "{top}");
            }
        }
        let card = picture(|k| (k / 16.0).floor() / 255.0);
        assert_eq!(white_of_levels(&card, Rounding::Float), None, "16 levels");
        let bad = picture(|k| if k == 9.0 { f32::NAN } else { k });
        assert_eq!(white_of_levels(&bad, Rounding::Float), None);
        assert_eq!(white_of_levels(&bad, Rounding::Rgbe), None);
    }
}
