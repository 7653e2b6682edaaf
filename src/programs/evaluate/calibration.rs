//! Does the stated standard error explain the actual one? Pixels are binned by what the solution
//! states; in every bin the root mean square of the actual error is compared with it. A calibrated
//! estimate lies on the diagonal, with 68 % of the errors within one stated standard error and 95 %
//! within two (Gaussian errors).

use super::truth::GroundTruth;
use crate::core::image::Plane;
use crate::core::math::luminance;
use crate::render::RenderedView;
use serde::{Deserialize, Serialize};

/// Stated errors from here on count as "not observed": no albedo or roughness can be wrong by more
/// than 1.
const UNOBSERVED: f32 = 1.0;
/// Bins per factor of two, and the smallest stated error that has a bin of its own.
const BINS_PER_OCTAVE: f32 = 1.0;
const SMALLEST: f32 = 1.0 / 2048.0;
const BINS: usize = 11;

/// One bin of stated errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationBin {
    /// Pixels.
    pub pixels: u64,
    /// Root mean square of the stated standard error.
    pub stated: f64,
    /// Root mean square of the actual error.
    pub actual: f64,
    /// Share of the pixels whose error is at most one stated standard error.
    pub within_1: f64,
    /// The same for two.
    pub within_2: f64,
}

/// Stated against actual errors of one quantity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Bins by ascending stated error; empty ones are left out.
    pub bins: Vec<CalibrationBin>,
    /// All bins together.
    pub all: CalibrationBin,
    /// Root mean square of error / stated error: 1 is calibrated, above 1 is too sure.
    pub normalised: f64,
    /// Pixels stated as unobserved, which enter nothing else.
    pub unobserved: u64,
}

/// Calibration of both materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibrations {
    /// Luminance of the albedo.
    pub albedo: Calibration,
    /// Roughness R.
    pub roughness: Calibration,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    pixels: u64,
    stated: f64,
    actual: f64,
    ratio: f64,
    within_1: u64,
    within_2: u64,
}

impl Sums {
    fn add(&mut self, stated: f64, error: f64) {
        self.pixels += 1;
        self.stated += stated * stated;
        self.actual += error * error;
        self.ratio += (error / stated).powi(2);
        self.within_1 += u64::from(error <= stated);
        self.within_2 += u64::from(error <= 2.0 * stated);
    }

    fn join(self, o: &Self) -> Self {
        Self {
            pixels: self.pixels + o.pixels,
            stated: self.stated + o.stated,
            actual: self.actual + o.actual,
            ratio: self.ratio + o.ratio,
            within_1: self.within_1 + o.within_1,
            within_2: self.within_2 + o.within_2,
        }
    }

    fn finish(&self) -> CalibrationBin {
        let n = self.pixels.max(1) as f64;
        CalibrationBin {
            pixels: self.pixels,
            stated: (self.stated / n).sqrt(),
            actual: (self.actual / n).sqrt(),
            within_1: self.within_1 as f64 / n,
            within_2: self.within_2 as f64 / n,
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Quantity {
    bins: [Sums; BINS],
    unobserved: u64,
}

impl Quantity {
    fn add(&mut self, stated: f32, value: f32, truth: f32) {
        if stated.is_nan() || stated >= UNOBSERVED || !value.is_finite() {
            self.unobserved += 1;
            return;
        }
        // an error of exactly zero would be a claim no measurement can refute but by infinity
        let stated = stated.max(0.25 * SMALLEST);
        let bin =
            ((stated / SMALLEST).log2() * BINS_PER_OCTAVE).clamp(0.0, (BINS - 1) as f32) as usize;
        self.bins[bin].add(
            f64::from(stated),
            f64::from(value.clamp(0.0, 1.0) - truth.clamp(0.0, 1.0)).abs(),
        );
    }

    fn finish(&self) -> Calibration {
        let all = self.bins.iter().fold(Sums::default(), Sums::join);
        Calibration {
            bins: self
                .bins
                .iter()
                .filter(|b| b.pixels > 0)
                .map(Sums::finish)
                .collect(),
            all: all.finish(),
            normalised: (all.ratio / all.pixels.max(1) as f64).sqrt(),
            unobserved: self.unobserved,
        }
    }
}

/// Sums over the views of one split.
#[derive(Clone, Debug, Default)]
pub(super) struct CalibrationTally {
    albedo: Quantity,
    roughness: Quantity,
}

impl CalibrationTally {
    /// Adds the counted pixels of one view.
    pub(super) fn add(&mut self, mask: &Plane<bool>, rendered: &RenderedView, truth: &GroundTruth) {
        for i in (0..mask.data.len()).filter(|&i| mask.data[i]) {
            let stated = rendered.confidence.data[i];
            self.albedo.add(
                stated.x,
                luminance(rendered.albedo.data[i]),
                luminance(truth.albedo.data[i]),
            );
            self.roughness.add(
                stated.y,
                rendered.roughness.data[i],
                truth.roughness.data[i],
            );
        }
    }

    pub(super) fn finish(&self) -> Calibrations {
        Calibrations {
            albedo: self.albedo.finish(),
            roughness: self.roughness.finish(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    #[test]
    fn gaussian_errors_of_the_stated_size_lie_on_the_diagonal() {
        let mut q = Quantity::default();
        let mut rng = KeyedRng::new(3, 5);
        for i in 0..200_000 {
            let sigma = 0.004 * 4f32.powf((i % 5) as f32 / 2.0);
            // Box–Muller
            let (u, v) = (rng.next_f32().max(1e-9), rng.next_f32());
            let e = sigma * (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos();
            q.add(sigma, 0.5 + e, 0.5);
        }
        q.add(1e4, 0.0, 0.5);
        let c = q.finish();
        assert!((c.normalised - 1.0).abs() < 0.01 && c.unobserved == 1);
        assert!((c.all.within_1 - 0.683).abs() < 0.01 && (c.all.within_2 - 0.954).abs() < 0.01);
        assert_eq!(c.bins.iter().map(|b| b.pixels).sum::<u64>(), 200_000);
        for b in &c.bins {
            assert!((b.actual / b.stated - 1.0).abs() < 0.02, "{b:?}");
        }
    }

    #[test]
    fn a_claim_ten_times_too_small_is_seen() {
        let mut q = Quantity::default();
        (0..1000).for_each(|i| q.add(0.005, 0.5 + if i % 2 == 0 { 0.05 } else { -0.05 }, 0.5));
        let c = q.finish();
        assert!((c.normalised - 10.0).abs() < 1e-3 && c.all.within_2 == 0.0);
    }
}
