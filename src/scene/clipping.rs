//! Pixels at the sensor's ceiling: what they show is a lower bound.
//!
//! Clipping leaves a plateau at a channel's maximum. A lamp or a sky of constant radiance does too,
//! but its plateau has one colour, while around clipped light there are pixels with one channel at
//! its ceiling and the others on their way there. In an 8-bit file the ceiling is known: it is that
//! of the encoding.

use crate::core::image::{Plane, RgbPlane};
use crate::core::stats::median;
use glam::Vec3;

/// A value this close below the maximum is at the ceiling: one step of half precision.
const STEP: f32 = 1.0 / 2048.0;
/// A plateau has this many pixels at least, and this share of the image at least and at most.
const FEWEST: usize = 16;
const SHARES: (f32, f32) = (2e-5, 0.5);
/// Share of the plateau's pixels that are clearly of another colour than most of them.
const PARTIAL: f32 = 0.02;
/// A channel is clearly another by this share: what is left of the noise of a denoised constant sky
/// is smaller (measured: dining-room, whose sky differs by steps of half precision alone), and light
/// that falls off around a clipped core crosses the last hundredth in few pixels.
const CLEARLY: f32 = 0.01;

/// Channels at their ceiling, a bit for each, per pixel; `None` where the image has no ceiling.
/// `encoded` is the value from which an 8-bit file is at its ceiling (in the units of `image`),
/// whatever the neighbourhood looks like.
#[must_use]
pub fn clipped_channels(image: &RgbPlane, encoded: Option<f32>) -> Option<Plane<u8>> {
    let ceiling = match encoded {
        Some(level) => [level; 3],
        None => plateau(image)?,
    };
    let bits = image.map(|p| {
        (0..3)
            .map(|c| u8::from(p[c] >= ceiling[c]) << c)
            .sum::<u8>()
    });
    bits.data.iter().any(|b| *b != 0).then_some(bits)
}

/// The value from which each channel is at its ceiling, infinite where it has none.
fn plateau(image: &RgbPlane) -> Option<[f32; 3]> {
    let n = image.data.len();
    let mut ceiling = [f32::INFINITY; 3];
    for (c, level) in ceiling.iter_mut().enumerate() {
        let most = image.data.iter().map(|p| p[c]).fold(0.0f32, f32::max);
        let from = most * (1.0 - STEP);
        let count = image.data.iter().filter(|p| p[c] >= from).count();
        if most > 0.0 && count >= FEWEST && count as f32 >= SHARES.0 * n as f32 {
            *level = from;
        }
    }
    let clipped: Vec<Vec3> = (image.data.iter())
        .filter(|p| (0..3).any(|c| p[c] >= ceiling[c]))
        .copied()
        .collect();
    if clipped.is_empty() || clipped.len() as f32 > SHARES.1 * n as f32 {
        return None;
    }
    let usual = Vec3::from_array([0, 1, 2].map(|c| {
        let values = clipped.iter().map(|p| p[c]).collect();
        median(values).unwrap_or(0.0)
    }));
    let other = |p: &Vec3| (*p - usual).abs().cmpgt(usual * CLEARLY).any();
    let others = clipped.iter().filter(|p| other(p)).count();
    (others as f32 >= PARTIAL * clipped.len() as f32).then_some(ceiling)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clipped_pixels(image: &RgbPlane) -> Option<Plane<bool>> {
        clipped_channels(image, None).map(|bits| bits.map(|b| *b != 0))
    }

    /// Light falling off from the middle of the image, of the given colour.
    fn glow(colour: Vec3) -> RgbPlane {
        let data = (0..128 * 64)
            .map(|i| {
                let (x, y) = ((i % 128) as f32 - 63.5, (i / 128) as f32 - 31.5);
                colour * (400.0 / (x * x + y * y + 1.0))
            })
            .collect();
        Plane {
            width: 128,
            height: 64,
            data,
        }
    }

    #[test]
    fn clipped_light_is_found_exactly() {
        let image = glow(Vec3::new(1.0, 0.8, 0.5));
        let clipped = image.map(|p| p.min(Vec3::splat(4.0)));
        let found = clipped_pixels(&clipped).expect("a plateau");
        for (f, p) in found.data.iter().zip(&image.data) {
            assert!(*f == (p.max_element() >= 4.0) || (p.max_element() - 4.0).abs() < 0.01);
        }
        // white balance after clipping: a ceiling per channel
        let balanced = clipped.map(|p| *p * Vec3::new(1.0, 1.3, 2.0));
        assert_eq!(clipped_pixels(&balanced).map(|p| p.data), Some(found.data));
    }

    #[test]
    fn neither_a_peak_nor_a_lamp_nor_a_grey_world_is_clipped() {
        assert!(clipped_pixels(&glow(Vec3::new(1.0, 0.8, 0.5))).is_none());
        let mut lamp = glow(Vec3::new(0.1, 0.08, 0.05));
        lamp.data[..60].fill(Vec3::new(90.0, 80.0, 60.0));
        assert!(
            clipped_pixels(&lamp).is_none(),
            "a lamp of constant radiance"
        );
        // a denoised sky: every channel at its maximum but for steps of half precision
        let mut sky = glow(Vec3::new(0.1, 0.08, 0.05));
        for (i, p) in sky.data[..600].iter_mut().enumerate() {
            let steps = Vec3::new((i % 3) as f32, (i / 3 % 3) as f32, (i / 9 % 3) as f32);
            *p = Vec3::splat(10.0) * (1.0 - steps / 1024.0);
        }
        assert!(clipped_pixels(&sky).is_none(), "a constant sky");
        // the same with a glint before it that is brighter in one channel: two keep their plateau
        for p in &mut sky.data[..600] {
            *p = Vec3::new(10.0, 11.5, 13.0);
        }
        sky.data[700] = Vec3::new(9.0, 9.0, 14.3);
        assert!(
            clipped_pixels(&sky).is_none(),
            "a constant sky beside a glint"
        );
        assert!(clipped_pixels(&Plane::filled(64, 32, Vec3::splat(0.5))).is_none());
        assert!(clipped_pixels(&Plane::filled(64, 32, Vec3::ZERO)).is_none());
        assert!(clipped_pixels(&Plane::filled(0, 0, Vec3::ZERO)).is_none());
    }
}
