//! One radiance image from the exposures of a bracket.
//!
//! E = Σ w f(z)/x / Σ w over the exposures x, f the camera's response; w = x · window(z): photons
//! arrive in proportion to x (Robertson et al. 2003). A pixel with a saturated channel is left out
//! whole, because chroma of JPEG bleeds into its neighbours. What moved is left out where an
//! exposure contradicts the reference, the one of middle exposure.

use super::align::Shift;
use super::response::Response;
use crate::core::image::{Plane, RgbPlane};
use crate::core::parallel::prelude::*;
use glam::Vec3;

/// Codes between which a photograph is trusted (derived: JPEG's error of a few codes reaches the
/// plateau above and is as large as the signal below).
const TRUSTED: [f64; 2] = [4.0, 250.0];
/// Width of the window's slopes, codes.
const SLOPE: f64 = 16.0;
/// Two exposures of the same light differ by less than this factor (derived: JPEG's error of ±6
/// codes at both ends of the trusted range under a gamma of 2.2).
const GHOST: f64 = 0.5;
/// Half width of the square in which most pixels have to contradict before one is called moved.
const NEIGHBOURHOOD: usize = 2;

/// One exposure in memory.
#[derive(Clone, Debug)]
pub struct Exposed {
    /// Codes.
    pub codes: Plane<[u8; 3]>,
    /// Exposure.
    pub exposure: f64,
    /// Its place against the reference.
    pub shift: Shift,
}

/// What merging gave.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Radiance relative to the exposure of code 128.
    pub radiance: RgbPlane,
    /// Share of pixels every exposure of which is saturated: lower bounds.
    pub clipped: f64,
    /// Share of pixels of which some exposure was left out because something moved.
    pub moved: f64,
}

impl Exposed {
    /// Codes at a pixel of the reference; `None` beyond the border.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        let (x, y) = (x as i64 + self.shift.dx, y as i64 + self.shift.dy);
        let inside =
            x >= 0 && y >= 0 && x < self.codes.width as i64 && y < self.codes.height as i64;
        inside.then(|| self.codes[(x as usize, y as usize)])
    }
}

/// Trust in a code from below: 0 at the dark end.
fn rising(code: u8) -> f64 {
    ((f64::from(code) - TRUSTED[0]) / SLOPE).clamp(0.0, 1.0)
}

/// Trust in a pixel from above: 0 where any channel is saturated.
fn falling(codes: [u8; 3]) -> f64 {
    let top = codes.iter().copied().max().unwrap_or(0);
    ((TRUSTED[1] - f64::from(top)) / SLOPE).clamp(0.0, 1.0)
}

/// Merges a bracket; `reference` is the index its shifts refer to.
#[must_use]
pub fn merge(bracket: &[Exposed], responses: &[Response; 3], reference: usize) -> Merged {
    let base = &bracket[reference].codes;
    let (width, height) = (base.width, base.height);
    let moved: Vec<Plane<bool>> = bracket
        .iter()
        .enumerate()
        .map(|(j, e)| match j == reference {
            true => Plane::filled(width, height, false),
            false => contradictions(e, &bracket[reference], responses),
        })
        .collect();
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let seen: Vec<(f64, [u8; 3])> = bracket
            .iter()
            .zip(&moved)
            .filter(|(_, m)| !m[(x, y)])
            .filter_map(|(e, _)| Some((e.exposure, e.at(x, y)?)))
            .collect();
        pixel_radiance(&seen, responses)
    };
    let pixels: Vec<(Vec3, bool)> = (0..width * height).into_par_iter().map(pixel).collect();
    let any_moved = |i: &usize| moved.iter().any(|m| m.data[*i]);
    let count = pixels.len().max(1) as f64;
    Merged {
        clipped: pixels.iter().filter(|p| p.1).count() as f64 / count,
        moved: (0..pixels.len()).filter(any_moved).count() as f64 / count,
        radiance: Plane {
            width,
            height,
            data: pixels.into_iter().map(|p| p.0).collect(),
        },
    }
}

/// Weighted mean over the exposures, and whether it is a lower bound.
fn pixel_radiance(seen: &[(f64, [u8; 3])], responses: &[Response; 3]) -> (Vec3, bool) {
    let mut sum = [0.0f64; 3];
    let mut weight = [0.0f64; 3];
    for (exposure, codes) in seen {
        let above = falling(*codes);
        for c in 0..3 {
            let w = exposure * above * rising(codes[c]);
            sum[c] += w * responses[c].linear(codes[c]) / exposure;
            weight[c] += w;
        }
    }
    let saturated = seen.iter().all(|(_, c)| falling(*c) <= 0.0);
    let value = |c: usize| {
        if weight[c] > 0.0 {
            return sum[c] / weight[c];
        }
        // nothing in range: the shortest exposure bounds a bright pixel from below, the longest
        // that is not saturated says most of a dark one
        let order = |a: &&(f64, [u8; 3]), b: &&(f64, [u8; 3])| a.0.total_cmp(&b.0);
        let chosen = if saturated {
            seen.iter().min_by(order)
        } else {
            seen.iter().filter(|s| falling(s.1) > 0.0).max_by(order)
        };
        chosen.map_or(0.0, |(x, codes)| responses[c].linear(codes[c]) / x)
    };
    let rgb = [0, 1, 2].map(value);
    (Vec3::from(rgb.map(|v| v as f32)), saturated)
}

/// Where an exposure contradicts the reference beyond noise.
fn contradictions(e: &Exposed, reference: &Exposed, responses: &[Response; 3]) -> Plane<bool> {
    let (width, height) = (reference.codes.width, reference.codes.height);
    let ln = |codes: [u8; 3], x: f64| -> f64 {
        let sum: f64 = (0..3).map(|c| responses[c].linear(codes[c])).sum();
        (sum.max(1e-12) / x).ln()
    };
    let one = |i: usize| -> i8 {
        let (x, y) = (i % width, i / width);
        let (Some(a), b) = (e.at(x, y), reference.codes[(x, y)]) else {
            return 0;
        };
        let dark = |c: [u8; 3]| c.iter().all(|&z| rising(z) < 1.0);
        let (a_top, b_top) = (falling(a) <= 0.0, falling(b) <= 0.0);
        let difference = ln(a, e.exposure) - ln(b, reference.exposure);
        let contradicts = match (a_top, b_top) {
            (false, false) if dark(a) || dark(b) => false,
            (false, false) => difference.abs() > GHOST,
            // a plateau is a lower bound: less light than that is a contradiction
            (false, true) => difference < -GHOST,
            (true, false) => difference > GHOST,
            (true, true) => false,
        };
        i8::from(contradicts)
    };
    let votes = Plane {
        width,
        height,
        data: (0..width * height).into_par_iter().map(one).collect(),
    };
    let majority = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (mut yes, mut all) = (0, 0);
        for v in y.saturating_sub(NEIGHBOURHOOD)..(y + NEIGHBOURHOOD + 1).min(height) {
            for u in x.saturating_sub(NEIGHBOURHOOD)..(x + NEIGHBOURHOOD + 1).min(width) {
                yes += i32::from(votes[(u, v)]);
                all += 1;
            }
        }
        2 * yes > all
    };
    Plane {
        width,
        height,
        data: (0..width * height).into_par_iter().map(majority).collect(),
    }
}
