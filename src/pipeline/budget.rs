//! Spending a given time: `unbake solve --budget 60s` and `--target-error`.
//!
//! Each choice is made as late as possible, from what earlier stages of this very run cost: texture sizes from the time a surface point
//! takes to be looked up, irradiance samples from the coarse bake, roughness evidence from its own pilot. The rays of the specular
//! images come last and take up what is left before the tail (albedo, files, report), whose cost follows from stages already run.
//! The clock decides, so two runs may differ; the decisions name the flags that repeat a run exactly.

use super::decisions::Sizes;
use crate::progress::Progress;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Sides of textures that a budget can choose, in steps of √2.
const SIDES: [usize; 11] = [128, 192, 256, 384, 512, 704, 1024, 1472, 2048, 2944, 4096];
/// Shares of the time left after the texture sizes are settled.
const TEXTURES: f64 = 0.3;
const IRRADIANCE: f64 = 0.5;
const EVIDENCE: f64 = 0.35;
/// Cost of fusing a texel, and of its albedo, in lookups of a surface point in all views; measured on grey-white-room.
const FUSING: f64 = 1.5;
const ALBEDO: f64 = 1.12;
/// Cost of edges and missing light, in fusions of all texels; measured on grey-white-room.
const SECOND_LOOK: f64 = 1.7;
/// Cost of filtering an irradiance texel once, of a pixel of the report and of a written texel, in rays of the coarse bake.
const FILTER: f64 = 40.0;
const REPORT_PIXEL: f64 = 10.0;
const WRITTEN: f64 = 0.12;
/// Share of an irradiance texel's samples that go to emitters, in ninths; the hemisphere gets the others.
const TO_EMITTERS: u32 = 2;
/// Samples per irradiance texel and rays per pixel between which a budget chooses.
const SAMPLES: [f64; 2] = [4.0, 2048.0];
const SPECULAR: [f64; 2] = [1.0, 256.0];

/// A time to spend.
#[derive(Clone, Debug)]
pub struct Budget {
    start: Instant,
    seconds: f64,
    measured: Arc<Mutex<Measured>>,
}

impl PartialEq for Budget {
    fn eq(&self, other: &Self) -> bool {
        self.seconds == other.seconds
    }
}

/// Costs of this run, seconds.
#[derive(Clone, Copy, Debug, Default)]
struct Measured {
    /// Lookup of a surface point in all views.
    lookup: f64,
    /// Fusion of all texels.
    fusion: f64,
    /// A ray of the coarse bake.
    ray: f64,
    /// A ray of the specular evidence.
    specular_ray: f64,
    /// Pixels that the report will render.
    report_pixels: f64,
    /// Texels that will be written.
    written: f64,
}

impl Budget {
    /// `seconds` to spend from `start`.
    #[must_use]
    pub fn new(start: Instant, seconds: f64) -> Self {
        Self { start, seconds, measured: Arc::default() }
    }

    /// The time to spend, seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    fn left(&self) -> f64 {
        self.seconds - self.start.elapsed().as_secs_f64()
    }

    fn measured(&self) -> Measured {
        *self.measured.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, change: impl FnOnce(&mut Measured)) {
        change(&mut self.measured.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// What albedo, edges, missing light, files and report will take once the fusion and the coarse bake have been measured.
    fn tail(&self) -> f64 {
        let m = self.measured();
        (ALBEDO + SECOND_LOOK) * m.fusion + m.ray * (REPORT_PIXEL * m.report_pixels + WRITTEN * m.written)
    }

    /// Lowers texture sizes so that what runs over texels fits: `covered` is the share of the atlas that charts cover, `lookup` the
    /// seconds one surface point takes in all views.
    pub(super) fn sizes(&self, sizes: Sizes, covered: f64, lookup: f64, report_pixels: f64, progress: &Progress) -> Sizes {
        let left = self.left();
        let per_texel = lookup * FUSING * (1.0 + ALBEDO + SECOND_LOOK);
        // a ray costs about a thirtieth of a look into sixteen views; the coarse bake will tell
        let filtered = lookup * 2.0 * FILTER / 8.0;
        let largest = |most: usize, cost: f64, share: f64| {
            let fits = |side: usize| (side * side) as f64 * covered * cost <= share * left;
            SIDES.into_iter().rev().find(|&s| s <= most && fits(s)).unwrap_or(SIDES[0]).min(most)
        };
        let albedo = largest(sizes.albedo, per_texel, TEXTURES);
        let irradiance = largest(sizes.irradiance.min(albedo), filtered, 0.5 * TEXTURES);
        let out = Sizes { albedo, roughness: sizes.roughness.min(albedo), irradiance };
        self.note(|m| {
            m.lookup = lookup;
            m.report_pixels = report_pixels;
            m.written = (4 * out.albedo * out.albedo + out.roughness * out.roughness + out.irradiance * out.irradiance) as f64;
        });
        if out != sizes {
            progress.decide(
                "texture sizes",
                format!("--albedo-size {} --roughness-size {} --irradiance-size {}", out.albedo, out.roughness, out.irradiance),
                format!("{left:.1} s left, a look at a surface point takes {:.1} µs", 1e6 * lookup),
                true,
            );
        }
        out
    }

    /// Takes down what fusing all texels took.
    pub(super) fn fused(&self, seconds: f64) {
        self.note(|m| m.fusion = seconds);
    }

    /// Samples per irradiance texel, after the coarse bake traced `rays` in `seconds`; they will be filtered `filters` times.
    pub(super) fn irradiance_samples(&self, texels: usize, rays: u64, seconds: f64, filters: u32, progress: &Progress) -> u32 {
        self.note(|m| m.ray = seconds / rays.max(1) as f64);
        let m = self.measured();
        let left = self.left() - self.tail();
        let filtered = f64::from(filters) * FILTER * m.ray * texels as f64;
        let per_sample = m.ray * texels.max(1) as f64;
        let n = ((IRRADIANCE * left - filtered) / per_sample).clamp(SAMPLES[0], SAMPLES[1]) as u32;
        progress.decide(
            "irradiance samples",
            as_flags(n),
            format!("{left:.1} s left for light and materials at {:.2} million rays per second", 1e-6 / m.ray),
            true,
        );
        n
    }

    /// How many of `rest` further evidence points to trace after a pilot of `points` took `seconds` and `rays`.
    pub(super) fn evidence(&self, points: usize, seconds: f64, rays: u64, rest: usize, progress: &Progress) -> usize {
        self.note(|m| m.specular_ray = seconds / rays.max(1) as f64);
        let left = self.left() - self.tail();
        let n = ((EVIDENCE * left / (seconds / points.max(1) as f64).max(1e-9)).max(0.0) as usize).min(rest);
        progress.decide(
            "roughness evidence",
            format!("{n} of {rest} further points"),
            format!("{left:.1} s left for materials, {:.0} µs per point", 1e6 * seconds / points.max(1) as f64),
            true,
        );
        n
    }

    /// Rays per pixel for `pixels` pixels of the specular images.
    pub(super) fn specular_rays(&self, pixels: usize, progress: &Progress) -> u32 {
        let m = self.measured();
        let left = self.left() - self.tail();
        let ray = if m.specular_ray > 0.0 { m.specular_ray } else { m.ray };
        // half as many emitter samples as rays
        let n = (left / (1.5 * ray * pixels.max(1) as f64)).clamp(SPECULAR[0], SPECULAR[1]) as u32;
        let tail = self.tail();
        progress.decide(
            "specular images",
            format!("--specular-rays {n}"),
            format!("{left:.1} s left for {pixels} pixels; albedo, files and report will take {tail:.1} s"),
            true,
        );
        n
    }
}

/// Samples per irradiance texel that bring the filtered error to `target`, from the unfiltered relative error of `samples` samples.
///
/// The filter shares samples among neighbours: it halves the error at the least (measured: CHANGELOG, known limits).
pub(super) fn samples_for(target: f32, error: f32, samples: u32, progress: &Progress) -> u32 {
    const FILTER_GAIN: f32 = 2.0;
    let ratio = f64::from(error / (FILTER_GAIN * target.max(1e-4)));
    let n = (f64::from(samples) * ratio * ratio).clamp(SAMPLES[0], SAMPLES[1]).ceil() as u32;
    progress.decide(
        "irradiance samples",
        as_flags(n),
        format!(
            "--target-error {target}: {samples} samples of the coarse bake have a relative error of {:.1} % before filtering",
            100.0 * error
        ),
        true,
    );
    n
}

/// Hemisphere rays and emitter samples out of `samples`.
pub(super) fn split_samples(samples: u32) -> [u32; 2] {
    let emitters = (samples * TO_EMITTERS / 9).max(1);
    [samples.saturating_sub(emitters).max(1), emitters]
}

fn as_flags(samples: u32) -> String {
    let [rays, emitters] = split_samples(samples);
    format!("--irradiance-rays {rays} --emitter-samples {emitters}")
}

/// A time as typed: `90`, `90s`, `1.5min`, `2m`, `1h`.
///
/// # Errors
/// A text that is no positive time.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let unit = match text[split..].trim() {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        other => return Err(format!("unknown unit {other:?}; write 90s, 1.5min or 1h")),
    };
    match text[..split].trim().parse::<f64>() {
        Ok(n) if n > 0.0 && (n * unit).is_finite() => Ok(n * unit),
        _ => Err("expected a time above 0 such as 90s, 1.5min or 1h".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_their_unit() {
        assert_eq!(parse_seconds("90"), Ok(90.0));
        assert_eq!(parse_seconds("1.5 min"), Ok(90.0));
        assert_eq!(parse_seconds("2m"), Ok(120.0));
        assert_eq!(parse_seconds("1h"), Ok(3600.0));
        for wrong in ["", "s", "-3s", "0", "3 days", "NaN", "1e400"] {
            assert!(parse_seconds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn more_time_buys_more_and_no_time_the_least() {
        let p = Progress::silent();
        let at = |seconds: f64| Budget::new(Instant::now(), seconds);
        let most = Sizes { albedo: 2048, roughness: 4096, irradiance: 1024 };
        let sizes = |s: f64| at(s).sizes(most, 0.6, 4e-6, 1e6, &p);
        assert_eq!(sizes(1e4), Sizes { roughness: 2048, ..most });
        assert!(sizes(20.0).albedo < sizes(60.0).albedo);
        assert_eq!(sizes(-1.0).albedo, SIDES[0]);
        let samples = |s: f64| at(s).irradiance_samples(500_000, 5_000_000, 1.0, 3, &p);
        assert_eq!(samples(1.0), 4);
        assert!(samples(60.0) > 8 && samples(120.0) > samples(60.0));
        assert_eq!(samples_for(0.01, 0.08, 64, &p), 64 * 16);
        assert_eq!(at(10.0).evidence(100, 1.0, 1000, 50, &p), 50);
        assert_eq!(at(-10.0).evidence(100, 1.0, 1000, 50, &p), 0);
    }
}
