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
    let levels: Vec<usize> = (0..256).filter(|k| met[*k]).collect();
    let certain = match rounding {
        Rounding::Float => true,
        Rounding::Rgbe => {
            let bits = levels.iter().map(|k| rgbe_evidence(*k, white));
            bits.sum::<f32>() >= EVIDENCE
        }
    };
    all && certain && levels.len() >= LEVELS
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

/// A step of a value of a pixel's brightest channel in RGBE.
fn rgbe_step(v: f32) -> f32 {
    (v.log2().floor() - 7.0).exp2()
}

/// How far below and above a stored value the level may lie, in steps. Whole numbers of eight bits
/// are stored as they are; others are rounded or cut off.
fn rgbe_slack(white: f32) -> [f32; 2] {
    if white == 1.0 { [0.5, 1.0] } else { [0.0; 2] }
}

/// A level that RGBE may store as this value of a pixel's brightest channel.
fn rgbe_level(v: f32, white: f32) -> Option<usize> {
    if v == 0.0 {
        return Some(0);
    }
    if !(v > 0.0 && v <= white * 1.01) {
        return None;
    }
    let [below, above] = rgbe_slack(white).map(|s| s * rgbe_step(v));
    let level = |v: f32| v * (255.0 / white);
    let first = (level(v - below) - 1e-3).ceil();
    (first <= level(v + above) + 1e-3 && first <= 255.0).then_some(first.max(0.0) as usize)
}

/// Bits that tell how improbable it is that another value there is taken for level `k`: dark ones
/// have many steps between them, bright ones none.
fn rgbe_evidence(k: usize, white: f32) -> f32 {
    if k == 0 {
        return 0.0;
    }
    let steps = white / 255.0 / rgbe_step(k as f32 * white / 255.0);
    let taken = rgbe_slack(white).iter().sum::<f32>().max(1.0);
    (steps / taken).log2().max(0.0)
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
