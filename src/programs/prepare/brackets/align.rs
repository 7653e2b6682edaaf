//! Alignment of hand-held exposures by median threshold bitmaps (Ward, Journal of Graphics Tools
//! 2003): an image cut at its own median is nearly the same bitmap at every exposure; the shift that
//! makes two of them agree is found from coarse to fine.

use crate::core::image::Plane;

/// Levels of the pyramid at most: shifts up to 2⁶ = 64 pixels (cited: Ward's choice).
const LEVELS: usize = 6;
/// Smallest side of a level.
const SMALLEST: usize = 12;
/// Values this near to the threshold are noise and do not vote (cited: Ward).
const TOLERANCE: u8 = 4;
/// Shares of darker pixels tried for the threshold; the median first.
const QUANTILES: [f64; 5] = [0.5, 0.3, 0.7, 0.15, 0.85];
/// A threshold in this range parts something.
const USABLE: std::ops::RangeInclusive<u8> = 12..=243;
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

/// Bits and which of them count.
struct Bitmap {
    bits: Plane<bool>,
    counts: Plane<bool>,
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
        let Some((p, q)) = bitmaps(a, b) else {
            continue;
        };
        let stay = disagreement(&p, &q, Shift::default());
        let mut best = (disagreement(&p, &q, found), found);
        for (dx, dy) in [
            (0, 1),
            (0, -1),
            (1, 0),
            (-1, 0),
            (1, 1),
            (1, -1),
            (-1, 1),
            (-1, -1),
        ] {
            let s = Shift {
                dx: found.dx + dx,
                dy: found.dy + dy,
            };
            let d = disagreement(&p, &q, s);
            if d < best.0 {
                best = (d, s);
            }
        }
        // coarse levels only propose: whether to move at all is decided on the pixels themselves
        let moved = level > 0 || best.0 < (1.0 - GAIN) * stay;
        found = if moved { best.1 } else { Shift::default() };
    }
    found
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

/// Both images cut at the same quantile; `None` where no quantile parts both.
fn bitmaps(a: &Plane<u8>, b: &Plane<u8>) -> Option<(Bitmap, Bitmap)> {
    let sorted = |p: &Plane<u8>| {
        let mut v = p.data.clone();
        v.sort_unstable();
        v
    };
    let (sa, sb) = (sorted(a), sorted(b));
    let at = |s: &[u8], q: f64| s[((s.len() - 1) as f64 * q) as usize];
    let (ta, tb) = QUANTILES
        .iter()
        .map(|&q| (at(&sa, q), at(&sb, q)))
        .find(|(x, y)| USABLE.contains(x) && USABLE.contains(y))?;
    Some((bitmap(a, ta), bitmap(b, tb)))
}

fn bitmap(p: &Plane<u8>, threshold: u8) -> Bitmap {
    Bitmap {
        bits: p.map(|&v| v > threshold),
        counts: p.map(|&v| v.abs_diff(threshold) > TOLERANCE),
    }
}

/// Share of the counting pixels of the overlap that differ; 1 without any.
fn disagreement(a: &Bitmap, b: &Bitmap, s: Shift) -> f64 {
    let (width, height) = (a.bits.width as i64, a.bits.height as i64);
    let (mut differ, mut counted) = (0u64, 0u64);
    for y in 0.max(-s.dy)..height.min(height - s.dy) {
        for x in 0.max(-s.dx)..width.min(width - s.dx) {
            let here = (x as usize, y as usize);
            let there = ((x + s.dx) as usize, (y + s.dy) as usize);
            if a.counts[here] && b.counts[there] {
                counted += 1;
                differ += u64::from(a.bits[here] != b.bits[there]);
            }
        }
    }
    // an overlap of a few pixels says nothing
    if counted * 8 < (width * height) as u64 {
        return 1.0;
    }
    differ as f64 / counted as f64
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
