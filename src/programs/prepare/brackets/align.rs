//! Alignment of hand-held exposures: the shift at which two of them tell the same story, found from
//! coarse to fine. What is compared is ln radiance up to a constant, where both are in range: cut at
//! its own median (Ward, Journal of Graphics Tools 2003), a picture that is bright at one side
//! looks the same wherever it is moved.

use crate::core::image::Plane;
use crate::core::math::linear_from_srgb;

/// Levels of the pyramid at most: shifts up to 2⁶ = 64 pixels (cited: Ward's choice).
const LEVELS: usize = 6;
/// Smallest side of a level.
const SMALLEST: usize = 12;
/// Codes that are neither noise nor saturated.
const USABLE: std::ops::RangeInclusive<u8> = 8..=245;
/// Differences of ln radiance beyond this are something else, not a worse fit (derived: a stop).
const MOST: f32 = 0.7;
/// Pixels that are compared at most: 300 tell a mean apart by 6 %, a hundred times as many are
/// enough at every level.
const COMPARED: usize = 40_000;
/// A shift must lower the disagreement by this share against none (derived: below it, random
/// disagreement of √n pixels decides).
const GAIN: f64 = 0.02;

/// How far `b` is displaced: b(x + dx, y + dy) shows what a(x, y) shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shift {
    /// Columns.
    pub dx: i64,
    /// Rows.
    pub dy: i64,
}

/// Finds the shift between two grey images of equal size.
#[must_use]
pub fn shift(a: &Plane<u8>, b: &Plane<u8>) -> Shift {
    let mut pyramid = vec![(a.clone(), b.clone())];
    while let Some((a, b)) = pyramid.last() {
        if pyramid.len() > LEVELS || a.width.min(a.height) < 2 * SMALLEST {
            break;
        }
        let next = (half(a), half(b));
        pyramid.push(next);
    }
    let mut found = Shift::default();
    for (level, (a, b)) in pyramid.iter().enumerate().rev() {
        found = Shift {
            dx: 2 * found.dx,
            dy: 2 * found.dy,
        };
        let (p, q) = (logarithms(a), logarithms(b));
        let stay = disagreement(&p, &q, Shift::default());
        let best = best_around(&p, &q, found);
        // coarse levels only propose: whether to move at all is decided on the pixels themselves
        let moved = level > 0 || best.0 < (1.0 - GAIN) * stay;
        found = if moved { best.1 } else { Shift::default() };
    }
    found
}

/// The best of the places around the coarser level's answer and around none.
fn best_around(a: &Plane<f32>, b: &Plane<f32>, from: Shift) -> (f64, Shift) {
    let mut best = (disagreement(a, b, from), from);
    for at in [from, Shift::default()] {
        for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
            let s = Shift {
                dx: at.dx + dx,
                dy: at.dy + dy,
            };
            let d = disagreement(a, b, s);
            if d < best.0 {
                best = (d, s);
            }
        }
    }
    best
}

fn half(p: &Plane<u8>) -> Plane<u8> {
    let (width, height) = (p.width / 2, p.height / 2);
    let mean = |i: usize| {
        let (x, y) = (2 * (i % width), 2 * (i / width));
        let sum = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .iter()
            .map(|(dx, dy)| u16::from(p[(x + dx, y + dy)]))
            .sum::<u16>();
        (sum / 4) as u8
    };
    Plane {
        width,
        height,
        data: (0..width * height).map(mean).collect(),
    }
}

/// ln radiance of codes as an sRGB camera would have made them; NaN where out of range. Another
/// response bends it alike in both images.
fn logarithms(p: &Plane<u8>) -> Plane<f32> {
    p.map(|v| {
        if USABLE.contains(v) {
            linear_from_srgb(f32::from(*v) / 255.0).ln()
        } else {
            f32::NAN
        }
    })
}

/// Mean deviation of the difference of both from its own median, over what the overlap shows of
/// both; infinite where that is next to nothing.
fn disagreement(a: &Plane<f32>, b: &Plane<f32>, s: Shift) -> f64 {
    let (width, height) = (a.width as i64, a.height as i64);
    let stride = ((a.data.len() as f64 / COMPARED as f64).sqrt() as usize).max(1);
    let ys = 0.max(-s.dy)..height.min(height - s.dy);
    let xs = 0.max(-s.dx)..width.min(width - s.dx);
    let mut differences: Vec<f32> = Vec::new();
    for y in ys.step_by(stride) {
        for x in xs.clone().step_by(stride) {
            let there = ((x + s.dx) as usize, (y + s.dy) as usize);
            let d = a[(x as usize, y as usize)] - b[there];
            if !d.is_nan() {
                differences.push(d);
            }
        }
    }
    // an overlap of a few pixels says nothing
    if differences.len() * 16 * stride * stride < (width * height) as usize {
        return f64::INFINITY;
    }
    let middle = differences.len() / 2;
    let median = *differences.select_nth_unstable_by(middle, f32::total_cmp).1;
    let off = |d: &f32| f64::from((d - median).abs().min(MOST));
    differences.iter().map(off).sum::<f64>() / differences.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pattern without period, exposed by `gain`, displaced by `s`.
    fn picture(gain: f64, s: Shift) -> Plane<u8> {
        let (width, height) = (240, 160);
        let value = |i: usize| {
            let x = (i % width) as f64 - s.dx as f64;
            let y = (i / width) as f64 - s.dy as f64;
            // tiles of pseudo-random brightness in two sizes: furniture and what lies on it
            let tile = |size: f64| {
                let n = (x / size + 0.2 * y / size).floor() * 12.9898 + (y / size).floor() * 78.233;
                (n.sin() * 43_758.545).rem_euclid(1.0)
            };
            let v = 0.1 + 0.6 * tile(41.0) + 0.3 * tile(9.0);
            ((v * gain).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0) as u8
        };
        Plane {
            width,
            height,
            data: (0..width * height).map(value).collect(),
        }
    }

    #[test]
    fn shifts_are_found_across_exposures() {
        let still = picture(0.4, Shift::default());
        for s in [(0, 0), (3, -2), (-11, 7)] {
            let s = Shift { dx: s.0, dy: s.1 };
            for gain in [0.1, 0.4, 1.2] {
                assert_eq!(shift(&still, &picture(gain, s)), s, "gain {gain}");
            }
        }
    }

    #[test]
    fn images_without_structure_are_left_where_they_are() {
        let flat = Plane::filled(100, 80, 90u8);
        let black = Plane::filled(100, 80, 0u8);
        assert_eq!(shift(&flat, &flat), Shift::default());
        assert_eq!(shift(&flat, &black), Shift::default());
        assert_eq!(
            shift(&Plane::filled(1, 1, 9u8), &Plane::filled(1, 1, 9u8)),
            Shift::default()
        );
    }
}
