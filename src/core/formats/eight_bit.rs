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
/// Levels that the lower quarter must show in RGBE, where its steps are finer than the levels and
/// most other values would lie between them. Derived: with a chance of 3 in 8 that a value at 1/4
/// is taken for a level, 16 are so by chance once in six million images.
const DARK_LEVELS: usize = 16;

/// The stored value that stands for white, 1 or 255, if all values are levels of an 8-bit picture.
#[must_use]
pub fn white_of_levels(pixels: &RgbPlane, rounding: Rounding) -> Option<f32> {
    [1.0, 255.0]
        .into_iter()
        .find(|white| are_levels(pixels, *white, rounding))
}

fn are_levels(pixels: &RgbPlane, white: f32, rounding: Rounding) -> bool {
    let mut met = [false; 256];
    let mut meet = |v: f32| {
        let level = match rounding {
            Rounding::Float => float_level(v, white),
            Rounding::Rgbe => rgbe_level(v, white),
        };
        level.is_some_and(|k| {
            met[k] = true;
            true
        })
    };
    let all = pixels.data.iter().all(|p| match rounding {
        Rounding::Float => p.to_array().into_iter().all(&mut meet),
        // of the other channels less than eight bits are kept
        Rounding::Rgbe => p.is_finite() && meet(p.max_element()),
    });
    let count = |met: &[bool]| met.iter().filter(|m| **m).count();
    let enough = rounding == Rounding::Float || count(&met[..64]) >= DARK_LEVELS;
    all && enough && count(&met) >= LEVELS
}

/// The level that a value of a file in half or single precision is.
fn float_level(v: f32, white: f32) -> Option<usize> {
    // half precision rounds values below 1 by 2⁻¹² at most: 0.062 of a level, which an eighth of all
    // numbers keep by chance; whole numbers it keeps
    let rounded = if white == 1.0 { 255.0 / 4096.0 } else { 0.0 } + 1e-3;
    let scaled = v * (255.0 / white);
    let level = scaled.round();
    ((0.0..=255.0).contains(&level) && (scaled - level).abs() <= rounded).then_some(level as usize)
}

/// A level that RGBE may store as this value of a pixel's brightest channel.
fn rgbe_level(v: f32, white: f32) -> Option<usize> {
    if v == 0.0 {
        return Some(0);
    }
    if !(v > 0.0 && v <= white * 1.01) {
        return None;
    }
    // whole numbers of eight bits are stored as they are
    let step = if white == 1.0 {
        (v.log2().floor() - 7.0).exp2()
    } else {
        0.0
    };
    let level = |v: f32| v * (255.0 / white);
    let first = (level(v - 0.5 * step) - 1e-3).ceil();
    (first <= level(v + step) + 1e-3 && first <= 255.0).then_some(first.max(0.0) as usize)
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
