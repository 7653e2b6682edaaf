//! Sampling a lightmap until it is good enough, and what of its error is known.
//!
//! Of the ways to bake that exist here the path tracer is taken: it knows bulbs, spots and the sun,
//! follows metal and gloss, and is unbiased before the filter. (The irradiance bake of `solve`
//! gathers from a texture of observed radiance, which a file without photographs does not have.)

use super::options::BakeOptions;
use crate::core::image::RgbPlane;
use crate::core::math::{Frame, luminance};
use crate::core::progress::Progress;
use crate::irradiance::{Irradiance, SUB_ESTIMATES, SurfaceFilter};
use crate::render::{LightmapTexels, Parts, PathTracer, Receiving};
use glam::Vec3;
use std::f32::consts::TAU;
use std::time::Instant;

/// A sampled lightmap.
pub(super) struct Baked {
    /// Irradiance of the surface's own normal; with directions the mean and the slopes along x, y
    /// and z follow: E(m) = mean + slopes · m.
    pub(super) maps: Vec<RgbPlane>,
    /// Paths per texel.
    pub(super) samples: u32,
    /// Root mean square error over the mean, by area, as the filter expects it.
    pub(super) error: f32,
    /// The same as two halves of the samples, filtered alike, differ from their mean.
    pub(super) error_of_halves: f32,
    /// Mean irradiance by area.
    pub(super) mean: Vec3,
}

/// Paths per texel in each part of the first pass, where there are passes.
const FIRST: u32 = 4;
/// Cosine of the angle between the surface's normal and the others, which are at right angles to
/// each other: 1/√3.
const TILT: f32 = 0.577_350_26;

/// Samples `texels` as the options ask.
pub(super) fn bake(
    texels: &LightmapTexels<'_>,
    renderer: &PathTracer<'_>,
    options: &BakeOptions,
    progress: &Progress,
) -> Baked {
    let clock = Instant::now();
    let filter = progress.stage("finding neighbours", 1, |_| texels.filter(renderer));
    let normals = normals_of(texels, options.directional);
    let areas = texels.areas();
    let parts_of = SUB_ESTIMATES as u32;
    let most = (options.samples / parts_of).max(1);
    let in_passes = options.budget.is_some() || options.target_error.is_some();
    let mut done = 0;
    let mut sums: Vec<Vec<Parts>> = Vec::new();
    let mut judged = None;
    for pass in 0.. {
        let started = clock.elapsed().as_secs_f64();
        let paths = match in_passes {
            true => done.max(FIRST).min(most - done),
            false => most,
        };
        for (k, normals) in normals.iter().enumerate() {
            let receiving = Receiving {
                renderer,
                cache: None,
                normals,
            };
            let key = 4 * pass + k as u64;
            let drawn = texels.sample(&receiving, paths, key, progress);
            add(&mut sums, k, drawn, [done, paths]);
        }
        done += paths;
        let spent = clock.elapsed().as_secs_f64();
        // the next pass takes as long as all so far at least
        let late = options
            .budget
            .is_some_and(|b| spent + (spent - started) > b);
        judged = (options.target_error).map(|_| Judged::new(&filter, &sums[0], &areas));
        let good = (judged.as_ref().zip(options.target_error)).is_some_and(|(j, e)| j.error <= e);
        if done >= most || late || good {
            break;
        }
    }
    let judged = progress.stage("filtering", 1, |_| {
        judged.unwrap_or_else(|| Judged::new(&filter, &sums[0], &areas))
    });
    let mut maps = vec![texels.spread(&judged.value)];
    if options.directional {
        let tilted = sums[1..].iter().map(|parts| smoothed(&filter, parts).value);
        let affine = affine(
            &judged.value,
            &tilted.collect::<Vec<_>>(),
            &texels.normals(),
        );
        maps.extend(affine.iter().map(|values| texels.spread(values)));
    }
    Baked {
        maps,
        samples: done * parts_of,
        error: judged.error,
        error_of_halves: judged.error_of_halves,
        mean: judged.mean,
    }
}

/// Adds what a pass drew: `[before, new]` paths.
fn add(sums: &mut Vec<Vec<Parts>>, k: usize, drawn: Vec<Parts>, [before, new]: [u32; 2]) {
    if sums.len() <= k {
        sums.push(drawn);
        return;
    }
    let share = new as f32 / (before + new) as f32;
    for (sum, drawn) in sums[k].iter_mut().zip(&drawn) {
        for (s, d) in sum.iter_mut().zip(drawn) {
            *s = s.lerp(*d, share);
        }
    }
}

fn smoothed(filter: &SurfaceFilter, parts: &[Parts]) -> Irradiance {
    filter.filter(&Irradiance::of_parts(parts.to_vec()), |_| 1.0)
}

/// A filtered lightmap and its errors.
struct Judged {
    value: Vec<Vec3>,
    mean: Vec3,
    error: f32,
    error_of_halves: f32,
}

impl Judged {
    fn new(filter: &SurfaceFilter, parts: &[Parts], areas: &[f32]) -> Self {
        let filtered = smoothed(filter, parts);
        let whole: f64 = areas.iter().map(|a| f64::from(*a)).sum();
        let (mut mean, mut expected, mut halves) = (Vec3::ZERO, 0.0f64, 0.0f64);
        for (i, &area) in areas.iter().enumerate() {
            let value = filtered.value[i];
            let (first, second) = filtered.parts[i].split_at(SUB_ESTIMATES / 2);
            let half = |p: &[Vec3]| luminance(p.iter().sum::<Vec3>()) / p.len() as f32;
            let error = filtered.error[i] * luminance(value);
            expected += f64::from(area * error * error);
            halves += f64::from(area * (0.5 * (half(first) - half(second))).powi(2));
            mean += value * (f64::from(area) / whole) as f32;
        }
        let level = f64::from(luminance(mean)).max(f64::MIN_POSITIVE);
        let relative = |sum: f64| ((sum / whole).sqrt() / level) as f32;
        Self {
            error: relative(expected),
            error_of_halves: relative(halves),
            value: filtered.value,
            mean,
        }
    }
}

/// The normals whose irradiance is sampled: the texels' own; with directions three more.
fn normals_of(texels: &LightmapTexels<'_>, directional: bool) -> Vec<Vec<Vec3>> {
    let own = texels.normals();
    let tilted = |k: usize| own.iter().map(|&n| tilted_normals(n)[k]).collect();
    let mut all: Vec<Vec<Vec3>> = Vec::new();
    if directional {
        all.extend((0..3).map(tilted));
    }
    all.insert(0, own);
    all
}

/// Three unit vectors at right angles to each other around a normal (the basis of radiosity normal
/// maps: McTaggart, "Half-Life 2 / Valve Source Shading", 2004).
fn tilted_normals(n: Vec3) -> [Vec3; 3] {
    let frame = Frame::from_normal(n);
    std::array::from_fn(|k| {
        let (s, c) = (TAU * k as f32 / 3.0).sin_cos();
        let side = (1.0 - TILT * TILT).sqrt();
        frame.world_from_local(Vec3::new(side * c, side * s, TILT))
    })
}

/// The affine function of the normal that is exact for the four normals of each texel: its mean and
/// its slopes along x, y and z. That is irradiance in spherical harmonics up to the first order.
fn affine(own: &[Vec3], tilted: &[Vec<Vec3>], normals: &[Vec3]) -> [Vec<Vec3>; 4] {
    let mut out: [Vec<Vec3>; 4] = std::array::from_fn(|_| Vec::with_capacity(own.len()));
    for (i, &n) in normals.iter().enumerate() {
        let along = tilted_normals(n);
        let e: [Vec3; 3] = std::array::from_fn(|k| tilted[k][i]);
        // the three are a basis: mean + slopes · m_k = e_k and mean + slopes · n = own,
        // with n = (m_0 + m_1 + m_2) · TILT
        let sum: Vec3 = e.iter().sum();
        let mean = (own[i] - TILT * sum) / (1.0 - 3.0 * TILT);
        out[0].push(mean);
        for (axis, values) in out[1..].iter_mut().enumerate() {
            let slope = (0..3).map(|k| along[k][axis] * (e[k] - mean)).sum();
            values.push(slope);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An affine function of the normal comes back as it was, for any normal.
    #[test]
    fn four_normals_tell_mean_and_slopes() {
        let normals = [Vec3::Y, Vec3::new(0.6, 0.0, -0.8), -Vec3::Z];
        let (mean, slope) = (Vec3::new(1.0, 2.0, 3.0), [0.3, -0.5, 0.7]);
        let at = |m: Vec3| mean + Vec3::splat(m.dot(Vec3::from_array(slope)));
        let own: Vec<Vec3> = normals.iter().map(|n| at(*n)).collect();
        let tilted: Vec<Vec<Vec3>> = (0..3)
            .map(|k| normals.iter().map(|n| at(tilted_normals(*n)[k])).collect())
            .collect();
        let found = affine(&own, &tilted, &normals);
        let near = |plane: &[Vec3], value: Vec3| {
            plane.len() == normals.len() && plane.iter().all(|x| (*x - value).length() < 1e-5)
        };
        assert!(near(&found[0], mean));
        for (plane, slope) in found[1..].iter().zip(slope) {
            assert!(near(plane, Vec3::splat(slope)), "{plane:?} {slope}");
        }
    }
}
