//! Spending a given time: `unbake solve --budget 60s` and `--target-error`.
//!
//! Each choice is made as late as possible, from what earlier stages of this very run cost: texture
//! sizes from the time a surface point takes to be looked up, irradiance samples from the coarse
//! bake, roughness evidence from its own pilot. The rays of the specular images come last and take
//! up what is left before the tail (albedo, files, report), whose cost follows from stages already
//! run. The clock decides, so two runs may differ; the decisions name the flags that repeat a run
//! exactly.

use crate::core::formats::number_and_unit;
use crate::core::progress::Progress;
use crate::observed::TextureSizes;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Texture sides are multiples of this, and at least [`LEAST_SIDE`].
const STEP: usize = 64;
const LEAST_SIDE: usize = 128;
/// Shares of the time left besides edges, report and files: what `standard` spends where
/// (grey-white-room and aws-house agree).
const TEXTURES: f64 = 0.28;
const IRRADIANCE_TEXELS: f64 = 0.42;
/// Shares of the time left before the tail that go to irradiance and to evidence when their turn
/// comes.
const IRRADIANCE: f64 = 0.58;
const EVIDENCE: f64 = 0.35;
/// Costs in looks at a surface point in all views: fusing a texel, and its albedo. (All costs
/// below: measured on grey-white-room, checked on aws-house and the synthetic apartment.)
const FUSING: f64 = 0.25;
const ALBEDO: f64 = 1.28 * FUSING;
/// Rays of the coarse bake in the time of a look: what counts until that bake tells.
const RAYS_PER_LOOK: f64 = 52.0;
/// Costs in rays of the coarse bake: filtering an irradiance texel (screens and neighbours
/// included), judging it between two rounds, its missing light, an edge pixel of the views, a pixel
/// of the report, a written value.
const FILTER: f64 = 35.0;
const JUDGING: f64 = 3.0;
const MISSING_LIGHT: f64 = 60.0;
const EDGES: f64 = 66.0;
const REPORT_PIXEL: f64 = 28.0;
const WRITTEN: f64 = 0.25;
/// Cost of a pixel of the specular images, and of each of its rays with its share of emitter
/// samples, in rays of the evidence.
const SPECULAR_PIXEL: f64 = 4.0;
const SPECULAR_RAY: f64 = 0.75;
/// One in so many of an irradiance texel's samples goes to emitters; the hemisphere gets the
/// others.
const TO_EMITTERS: u32 = 3;
/// Samples per irradiance texel and rays per pixel between which a budget chooses, and the former
/// for which texture sizes are chosen.
const SAMPLES: [f64; 2] = [4.0, 2048.0];
const SPECULAR: [f64; 2] = [1.0, 4096.0];
const USUAL_SAMPLES: f64 = 160.0;

/// Samples per irradiance texel from which a second round pays, and for every further one
/// (docs/lab/irradiance.md).
const WORTH_SECOND: f64 = 18.0;
const WORTH_FURTHER: f64 = 24.0;

/// Cost of what a run does in any case, in rays per pixel of the views: highlights, pilots,
/// specular images of one ray.
const LEAST: f64 = 4.0;
/// Share of the time left that must remain besides that, edges, report and files; edges are left
/// out where it would not.
const LEAST_FREE: f64 = 0.35;
/// Share of the whole budget by which the solution at edges may exceed it.
const OVERDRAFT: f64 = 0.08;

/// The most rounds, of at most `most`, that are worth what judging the texels between them costs,
/// where `samples(rounds)` per texel are left to them.
pub(crate) fn rounds_worth(most: u32, samples: impl Fn(u32) -> f64) -> u32 {
    (2..=most)
        .rev()
        .find(|&r| samples(r) >= WORTH_SECOND + WORTH_FURTHER * f64::from(r - 2))
        .unwrap_or(most.min(1))
}

/// What there is to do, and how fast a look is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Workload {
    /// Share of the atlas that charts cover.
    pub covered: f64,
    /// Seconds that one surface point takes in all views.
    pub lookup: f64,
    /// Pixels of all views.
    pub pixels: f64,
    /// Pixels at edges among them; 0 if they are not solved for.
    pub edge_pixels: f64,
    /// Pixels that the report renders.
    pub report_pixels: f64,
}

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

/// Costs of this run, seconds, and what is still to do.
#[derive(Clone, Copy, Debug, Default)]
struct Measured {
    /// Fusion of all texels.
    fusion: f64,
    /// A ray of the coarse bake.
    ray: f64,
    /// A ray of the specular evidence.
    specular_ray: f64,
    /// Irradiance texels, edge pixels of the views, pixels of the report and values to write, in
    /// rays of the coarse bake.
    missing_light: f64,
    edges: f64,
    files: f64,
    /// Whether edges were given up for want of time.
    without_edges: bool,
}

impl Budget {
    /// `seconds` to spend from `start`.
    #[must_use]
    pub fn new(start: Instant, seconds: f64) -> Self {
        Self {
            start,
            seconds,
            measured: Arc::default(),
        }
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

    /// What albedo, edges, missing light, files and report will take once the fusion and the coarse
    /// bake have been measured.
    fn tail(&self) -> f64 {
        let m = self.measured();
        ALBEDO / FUSING * m.fusion + m.ray * (m.missing_light + m.edges + m.files)
    }

    /// Lowers texture sizes so that what runs over texels fits.
    pub(super) fn sizes(
        &self,
        sizes: TextureSizes,
        work: &Workload,
        progress: &Progress,
    ) -> TextureSizes {
        let left = self.left();
        let ray = work.lookup / RAYS_PER_LOOK;
        let fixed = |edges: f64| {
            ray * (EDGES * edges + LEAST * work.pixels + REPORT_PIXEL * work.report_pixels)
        };
        let edges = if left - fixed(work.edge_pixels) > LEAST_FREE * left {
            work.edge_pixels
        } else {
            0.0
        };
        let free = left - fixed(edges);
        let largest = |most: usize, cost: f64, share: f64| {
            let side = (share * free.max(0.0) / (work.covered * cost)).sqrt() as usize;
            (side / STEP * STEP).max(LEAST_SIDE).min(most)
        };
        let albedo = largest(sizes.albedo, work.lookup * (FUSING + ALBEDO), TEXTURES);
        let texel = USUAL_SAMPLES + FILTER + MISSING_LIGHT;
        let irradiance = largest(sizes.irradiance.min(albedo), ray * texel, IRRADIANCE_TEXELS);
        let out = TextureSizes {
            albedo,
            roughness: sizes.roughness.min(albedo),
            irradiance,
        };
        let values = (4 * out.albedo * out.albedo
            + out.roughness * out.roughness
            + out.irradiance * out.irradiance) as f64;
        self.note(|m| {
            m.missing_light =
                MISSING_LIGHT * work.covered * (out.irradiance * out.irradiance) as f64;
            m.edges = EDGES * edges;
            m.without_edges = edges < work.edge_pixels;
            m.files = REPORT_PIXEL * work.report_pixels + WRITTEN * values;
        });
        if out != sizes {
            progress.decide(
                "texture sizes",
                format!(
                    "--albedo-size {} --roughness-size {} --irradiance-size {}",
                    out.albedo, out.roughness, out.irradiance
                ),
                format!(
                    "{left:.1} s left, a look at a surface point takes {:.1} µs",
                    1e6 * work.lookup
                ),
                true,
            );
        }
        out
    }

    /// Takes down what fusing all texels took.
    pub(super) fn fused(&self, seconds: f64) {
        self.note(|m| m.fusion = seconds);
    }

    /// Samples per irradiance texel and the rounds to spend them in, after the coarse bake traced
    /// `rays` in `seconds`. There are at most `rounds`; with few samples ([`WORTH_SECOND`]) the
    /// time between them is better spent on rays.
    pub(super) fn irradiance_samples(
        &self,
        texels: usize,
        rays: u64,
        seconds: f64,
        rounds: u32,
        progress: &Progress,
    ) -> (u32, u32) {
        self.note(|m| m.ray = seconds / rays.max(1) as f64);
        let m = self.measured();
        let left = self.left() - self.tail();
        let per_sample = m.ray * texels.max(1) as f64;
        let filter = |rounds: u32| {
            rounds
                .checked_sub(1)
                .map_or(0.0, |between| FILTER + JUDGING * f64::from(between))
        };
        let affordable = |rounds: u32| IRRADIANCE * left / per_sample - filter(rounds);
        let rounds = rounds_worth(rounds, affordable);
        let n = affordable(rounds).clamp(SAMPLES[0], SAMPLES[1]) as u32;
        progress.decide(
            "irradiance samples",
            if rounds == 0 {
                as_flags(n)
            } else {
                format!("{} --irradiance-rounds {rounds}", as_flags(n))
            },
            format!(
                "{left:.1} s left for light and materials at {:.2} million rays per second",
                1e-6 / m.ray
            ),
            true,
        );
        (n, rounds)
    }

    /// How many of `rest` further evidence points to trace after a pilot of `points` took `seconds`
    /// and `rays`.
    pub(super) fn evidence(
        &self,
        points: usize,
        seconds: f64,
        rays: u64,
        rest: usize,
        progress: &Progress,
    ) -> usize {
        self.note(|m| m.specular_ray = seconds / rays.max(1) as f64);
        let left = self.left() - self.tail();
        let n = ((EVIDENCE * left / (seconds / points.max(1) as f64).max(1e-9)).max(0.0) as usize)
            .min(rest);
        progress.decide(
            "roughness evidence",
            format!("{n} of {rest} further points"),
            format!(
                "{left:.1} s left for materials, {:.0} µs per point",
                1e6 * seconds / points.max(1) as f64
            ),
            true,
        );
        n
    }

    /// Whether there is time to solve for the texels at edges, after the albedo.
    pub(super) fn allows_edges(&self, progress: &Progress) -> bool {
        let m = self.measured();
        let left = self.left();
        let [edges, others] = [m.edges, m.missing_light + m.files].map(|rays| rays * m.ray);
        let fits = !m.without_edges && edges + others < left + OVERDRAFT * self.seconds;
        if !fits {
            let why = format!(
                "{left:.1} s left; missing light, files and report will take {others:.1} s"
            );
            progress.decide("albedo at edges", "left out: --edges off", why, true);
        }
        fits
    }

    /// Rays per pixel for `pixels` pixels of the specular images.
    pub(super) fn specular_rays(&self, pixels: usize, progress: &Progress) -> u32 {
        let m = self.measured();
        let left = self.left() - self.tail();
        let ray = if m.specular_ray > 0.0 {
            m.specular_ray
        } else {
            m.ray
        };
        let per_pixel = left / (ray * pixels.max(1) as f64);
        let n =
            ((per_pixel - SPECULAR_PIXEL) / SPECULAR_RAY).clamp(SPECULAR[0], SPECULAR[1]) as u32;
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

/// Samples per irradiance texel that bring the filtered error to `target`, from the unfiltered
/// relative error of `samples` samples.
///
/// The filter shares samples among neighbours, and rounds spend them where they are wanted: the
/// error is divided by 2.4 at the least (`unbake bench irt SCENE --target-error RATIO`: 2.5 on
/// grey-white-room, 3.7 on aws-house, 7 in a small synthetic room), so that the target is met
/// rather than hit.
pub(super) fn samples_for(target: f32, error: f32, samples: u32, progress: &Progress) -> u32 {
    const FILTER_GAIN: f32 = 2.4;
    let ratio = f64::from(error / (FILTER_GAIN * target.max(1e-4)));
    let n = (f64::from(samples) * ratio * ratio)
        .clamp(SAMPLES[0], SAMPLES[1])
        .ceil() as u32;
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
    let emitters = (samples / TO_EMITTERS).max(1);
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
    let (number, unit) = number_and_unit(text);
    let unit = match unit {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        other => return Err(format!("unknown unit {other:?}; write 90s, 1.5min or 1h")),
    };
    match number.parse::<f64>() {
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
        let most = TextureSizes {
            albedo: 2048,
            roughness: 4096,
            irradiance: 1024,
        };
        let work = Workload {
            covered: 0.6,
            lookup: 8e-6,
            pixels: 8e6,
            edge_pixels: 1e6,
            report_pixels: 2e6,
        };
        let sizes = |s: f64| at(s).sizes(most, &work, &p);
        assert_eq!(
            sizes(1e4),
            TextureSizes {
                roughness: 2048,
                ..most
            }
        );
        assert!(sizes(30.0).albedo < sizes(50.0).albedo);
        assert_eq!(sizes(-1.0).albedo, LEAST_SIDE);
        let samples = |s: f64| at(s).irradiance_samples(500_000, 5_000_000, 1.0, 2, &p);
        assert_eq!(samples(1.0), (4, 1));
        let [(few, once), (many, twice)] = [samples(8.0), samples(120.0)];
        assert!(
            few > 8 && many > few && [once, twice] == [1, 2],
            "{few} in {once}, {many} in {twice}"
        );
        assert!(samples_for(0.02, 0.096, 64, &p).abs_diff(64 * 4) <= 1);
        assert_eq!(at(10.0).evidence(100, 1.0, 1000, 50, &p), 50);
        assert_eq!(at(-10.0).evidence(100, 1.0, 1000, 50, &p), 0);
    }
}
