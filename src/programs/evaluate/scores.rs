//! The figures an evaluation consists of, and how they are collected view by view.

use super::calibration::{CalibrationTally, Calibrations};
use super::emission::{EmissionScores, EmissionTally};
use super::gains::{GainScores, GainTally};
use super::image_scores::ImageScores;
use super::metals::{MetalScores, MetalTally};
use super::panes::{PaneScores, PaneTally};
use super::truth::GroundTruth;
use crate::core::image::Plane;
use crate::core::metrics::{psnr, squared_error};
use crate::render::RenderedView;
use crate::scene::{Scene, unnamed_class};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// One quantity under the three protocols.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Protocols<T> {
    /// No alignment, values clipped to [0, 1].
    pub linear: T,
    /// FIPT's.
    pub fipt: T,
    /// TexIR's.
    pub texir: T,
}

/// Material scores over all pixels and per class.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaterialScores {
    /// Albedo.
    pub albedo: Protocols<ImageScores>,
    /// Roughness R.
    pub roughness: Protocols<ImageScores>,
    /// Median over all counted pixels of |R − truth|, to 1e-4.
    pub roughness_median_absolute_error: f64,
    /// Classes by ascending id; those never seen are left out.
    pub classes: Vec<ClassScores>,
    /// Stated against actual errors.
    #[serde(default)]
    pub calibration: Calibrations,
}

/// Scores of one class, pooled over all its pixels in all views, under the linear protocol.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClassScores {
    /// Class id.
    pub id: u16,
    /// Class name.
    pub name: String,
    /// Number of pixels.
    pub pixels: u64,
    /// PSNR of the albedo, dB.
    pub albedo_psnr: f64,
    /// Mean of albedo − truth per channel.
    pub albedo_bias: [f64; 3],
    /// Mean true albedo per channel.
    pub albedo_truth: [f64; 3],
    /// PSNR of the roughness, dB.
    pub roughness_psnr: f64,
    /// Median of |R − truth|, to 1e-4.
    pub roughness_median_absolute_error: f64,
    /// Mean of R − truth.
    pub roughness_bias: f64,
    /// Mean true roughness.
    pub roughness_truth: f64,
}

/// Scores of one view.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// The view's file stem.
    pub stem: String,
    /// PSNR of the re-rendering, dB.
    pub psnr: f64,
    /// SSIM of the re-rendering.
    pub ssim: f64,
    /// MSE of the re-rendering.
    pub mse: f64,
    /// Gain on linear radiance with which the re-rendering comes closest to the photograph.
    #[serde(default)]
    pub gain: f64,
    /// PSNR of the re-rendering with that gain, dB.
    #[serde(default)]
    pub psnr_gain: f64,
    /// PSNR of the re-projected fused radiance with a gain of its own, dB.
    #[serde(default)]
    pub ceiling_psnr_gain: Option<f64>,
    /// Pixels of the re-rendering that are not finite: must be 0.
    pub nonfinite_pixels: usize,
    /// PSNR of the albedo, linear protocol, dB.
    pub albedo_psnr: Option<f64>,
    /// PSNR of the albedo, TexIR's protocol, dB.
    pub albedo_psnr_texir: Option<f64>,
    /// The least-squares scale of TexIR's protocol.
    pub albedo_scale: Option<f64>,
    /// PSNR of the roughness, linear protocol, dB.
    pub roughness_psnr: Option<f64>,
    /// PSNR of the roughness, FIPT's protocol, dB.
    pub roughness_psnr_fipt: Option<f64>,
}

/// Scores of the held-out or of the training views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SplitScores {
    /// Novel views (held out) or re-rendering (training).
    pub rendering: ImageScores,
    /// The same with fitted gains, and its ceiling.
    #[serde(default)]
    pub gains: GainScores,
    /// Albedo and roughness, where the scene has ground truth.
    pub materials: Option<MaterialScores>,
    /// Which pixels are metal, where the scene's truth says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metals: Option<MetalScores>,
    /// Which pixels show a pane, where the scene's truth says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panes: Option<PaneScores>,
    /// Which pixels emit and how much, where the scene says so.
    #[serde(default)]
    pub emission: Option<EmissionScores>,
    /// Every view.
    pub views: Vec<ViewScores>,
}

/// The content of `eval/metrics.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// What the figures mean.
    pub protocols: Vec<String>,
    /// The figures of the held-out views in short, for scripts.
    #[serde(default)]
    pub novel_views: Option<GainScores>,
    /// Held-out views.
    pub test: Option<SplitScores>,
    /// Training views.
    pub train: Option<SplitScores>,
}

/// Sums of per-image scores.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    mse: f64,
    psnr: f64,
    ssim: f64,
    images: usize,
    with_ssim: usize,
}

impl Tally {
    /// Adds one image; an image without a complete window inside its mask has no SSIM.
    pub(super) fn add(&mut self, mse: f64, ssim: Option<f64>) {
        self.mse += mse;
        self.psnr += psnr(mse);
        self.images += 1;
        if let Some(ssim) = ssim {
            self.ssim += ssim;
            self.with_ssim += 1;
        }
    }

    fn finish(&self) -> ImageScores {
        let n = self.images.max(1) as f64;
        ImageScores {
            psnr_of_mean_mse: psnr(self.mse / n),
            mean_psnr: self.psnr / n,
            ssim: self.ssim / self.with_ssim.max(1) as f64,
            mse: self.mse / n,
            images: self.images,
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct MaterialTally {
    pub(super) albedo: Protocols<Tally>,
    /// `texir` stays unused: roughness is not scaled there, so that it equals `linear`.
    pub(super) roughness: Protocols<Tally>,
}

/// Everything collected over the views of one split.
#[derive(Clone, Debug)]
pub(super) struct Accumulator {
    pub(super) lights: BTreeSet<u16>,
    pub(super) rendering: Tally,
    pub(super) gains: GainTally,
    pub(super) materials: Option<MaterialTally>,
    pub(super) classes: ClassTally,
    pub(super) calibration: CalibrationTally,
    pub(super) metals: MetalTally,
    pub(super) panes: PaneTally,
    pub(super) emission: EmissionTally,
    pub(super) views: Vec<ViewScores>,
}

impl Accumulator {
    pub(super) fn new(scene: &Scene) -> Self {
        Self {
            lights: scene
                .classes
                .iter()
                .filter(|c| c.is_light)
                .map(|c| c.id)
                .collect(),
            rendering: Tally::default(),
            gains: GainTally::default(),
            materials: None,
            classes: ClassTally::new(scene),
            calibration: CalibrationTally::default(),
            metals: MetalTally::default(),
            panes: PaneTally::default(),
            emission: EmissionTally::default(),
            views: Vec::new(),
        }
    }

    pub(super) fn finish(self) -> Option<SplitScores> {
        if self.views.is_empty() {
            return None;
        }
        let materials = self.materials.map(|m| {
            let roughness = m.roughness.linear.finish();
            MaterialScores {
                albedo: Protocols {
                    linear: m.albedo.linear.finish(),
                    fipt: m.albedo.fipt.finish(),
                    texir: m.albedo.texir.finish(),
                },
                roughness: Protocols {
                    linear: roughness.clone(),
                    fipt: m.roughness.fipt.finish(),
                    texir: roughness,
                },
                roughness_median_absolute_error: self.classes.median_of_all(),
                classes: self.classes.finish(),
                calibration: self.calibration.finish(),
            }
        });
        let rendering = self.rendering.finish();
        Some(SplitScores {
            gains: self.gains.finish(&rendering),
            rendering,
            materials,
            metals: self.metals.finish(),
            panes: self.panes.finish(),
            emission: self.emission.finish(),
            views: self.views,
        })
    }
}

/// Bins of the error histogram: |R − truth| in [0, 1] to 1e-4, which is finer than an 8-bit
/// texture.
const BINS: usize = 10_000;

#[derive(Clone, Debug)]
struct ClassSums {
    pixels: u64,
    albedo_squared: f64,
    albedo_error: [f64; 3],
    albedo_truth: [f64; 3],
    roughness_squared: f64,
    roughness_error: f64,
    roughness_truth: f64,
    histogram: Vec<u64>,
}

/// Sums per class id.
#[derive(Clone, Debug)]
pub(super) struct ClassTally {
    names: BTreeMap<u16, String>,
    sums: BTreeMap<u16, ClassSums>,
}

impl ClassTally {
    fn new(scene: &Scene) -> Self {
        Self {
            names: scene
                .classes
                .iter()
                .map(|c| (c.id, c.name.clone()))
                .collect(),
            sums: BTreeMap::new(),
        }
    }

    /// Adds the counted pixels of one view.
    pub(super) fn add(
        &mut self,
        labels: &Plane<u16>,
        mask: &Plane<bool>,
        rendered: &RenderedView,
        truth: &GroundTruth,
    ) {
        for i in (0..labels.data.len()).filter(|&i| mask.data[i]) {
            let sums = self
                .sums
                .entry(labels.data[i])
                .or_insert_with(|| ClassSums {
                    pixels: 0,
                    albedo_squared: 0.0,
                    albedo_error: [0.0; 3],
                    albedo_truth: [0.0; 3],
                    roughness_squared: 0.0,
                    roughness_error: 0.0,
                    roughness_truth: 0.0,
                    histogram: vec![0; BINS + 1],
                });
            sums.pixels += 1;
            for c in 0..3 {
                let (a, t) = (rendered.albedo.data[i][c], truth.albedo.data[i][c]);
                sums.albedo_squared += squared_error(a, t);
                sums.albedo_error[c] += signed_error(a, t);
                sums.albedo_truth[c] += f64::from(t);
            }
            let (r, t) = (rendered.roughness.data[i], truth.roughness.data[i]);
            sums.roughness_squared += squared_error(r, t);
            sums.roughness_error += signed_error(r, t);
            sums.roughness_truth += f64::from(t);
            let bin = squared_error(r, t).sqrt() * BINS as f64;
            sums.histogram[(bin.round() as usize).min(BINS)] += 1;
        }
    }

    fn median_of_all(&self) -> f64 {
        let mut total = vec![0u64; BINS + 1];
        for sums in self.sums.values() {
            for (t, n) in total.iter_mut().zip(&sums.histogram) {
                *t += n;
            }
        }
        median(&total)
    }

    fn finish(&self) -> Vec<ClassScores> {
        self.sums
            .iter()
            .map(|(id, s)| {
                let n = s.pixels as f64;
                ClassScores {
                    id: *id,
                    name: self
                        .names
                        .get(id)
                        .cloned()
                        .unwrap_or_else(|| unnamed_class(*id)),
                    pixels: s.pixels,
                    albedo_psnr: psnr(s.albedo_squared / (3.0 * n)),
                    albedo_bias: s.albedo_error.map(|e| e / n),
                    albedo_truth: s.albedo_truth.map(|t| t / n),
                    roughness_psnr: psnr(s.roughness_squared / n),
                    roughness_median_absolute_error: median(&s.histogram),
                    roughness_bias: s.roughness_error / n,
                    roughness_truth: s.roughness_truth / n,
                }
            })
            .collect()
    }
}

fn signed_error(a: f32, truth: f32) -> f64 {
    if a.is_finite() {
        f64::from(a.clamp(0.0, 1.0)) - f64::from(truth.clamp(0.0, 1.0))
    } else {
        0.0
    }
}

/// Lower median of a histogram over [0, 1].
fn median(histogram: &[u64]) -> f64 {
    let total: u64 = histogram.iter().sum();
    let mut below = 0;
    for (bin, n) in histogram.iter().enumerate() {
        below += n;
        if 2 * below >= total {
            return bin as f64 / BINS as f64;
        }
    }
    0.0
}
