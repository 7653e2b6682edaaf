//! What a reconstruction computes with: every number in effect, after presets, measurements and the
//! user's wishes are settled.

use super::quality::Quality;
use super::{Budget, Checkpoints};
use crate::core::brdf::Reflectance;
use crate::core::switch::Switch;
use crate::irradiance::Estimator;
use crate::published::PublishedOptions;
use crate::{Error, Result};
use serde::Serialize;

/// Sizes that are bounds: of textures, which the photographs' resolution may lower, and of the
/// photographs; otherwise a size is exact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Fit {
    /// Albedo, radiance, emission, labels.
    pub albedo: bool,
    /// Roughness.
    pub roughness: bool,
    /// Irradiance.
    pub irradiance: bool,
    /// The photographs: they may be reduced further, to what memory holds.
    pub photographs: bool,
}

/// Numbers of a reconstruction. [`super::SolveRequest`] makes them from a preset and the user's
/// flags of the same names.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct SolveOptions {
    /// The preset they come from.
    pub quality: Quality,
    /// Side of the albedo, radiance and label textures, texels.
    pub albedo_size: usize,
    /// Side of the roughness texture, texels.
    pub roughness_size: usize,
    /// Side of the irradiance texture, texels.
    pub irradiance_size: usize,
    /// Which sizes are only upper bounds.
    #[serde(skip)]
    pub fit: Fit,
    /// Photographs are reduced by this factor, 1 or more.
    pub photo_reduction: usize,
    /// How irradiance is estimated.
    pub irradiance_estimator: Estimator,
    /// Epochs for which the paper's neural irradiance field is trained, which then takes the place
    /// of the rays of irradiance texels.
    pub nirf: Option<u32>,
    /// Hemisphere rays per irradiance texel, on average.
    pub irradiance_rays: u32,
    /// Emitter samples per irradiance texel, on average.
    pub emitter_samples: u32,
    /// Rounds in which they are spent; after each, the texels with the largest errors are chosen. 1
    /// = all texels alike.
    pub irradiance_rounds: u32,
    /// Relative error of irradiance at which a texel is done.
    pub irradiance_error: f32,
    /// Whether irradiance noise is filtered over the surface.
    pub irradiance_filter: bool,
    /// Whether a rough reflection's ray looks up the mean radiance of the cone it stands for
    /// instead of one texel.
    pub prefilter: bool,
    /// Points per class that are searched for roughness: as many evenly spread, as many on virtual
    /// highlights.
    pub evidence_points: usize,
    /// Rays per lobe and look at those points; a multiple of 16, or the next one is taken.
    pub evidence_rays: u32,
    /// Roughness values at which the specular response of those points is tabulated.
    pub roughness_levels: usize,
    /// Rays per pixel along the specular lobe of its roughness.
    pub specular_rays: u32,
    /// Whether lobes too wide to show anything are replaced by the mean light around: `Auto` =
    /// where the evidence says so.
    pub matte: Switch,
    /// Whether a class may have several roughness values, by room, by colour or by place: `Auto` =
    /// where held-out views ask for them.
    pub divide: Switch,
    /// Whether classes may be metal: where views are explained better so.
    pub metals: Switch,
    /// Whether surfaces may be panes: where the photographs show what lies behind them.
    pub panes: Switch,
    /// Whether texels that no view sees clean are solved for from how much of each pixel they
    /// cover.
    pub edges: Switch,
    /// Whether light that no camera looks along is added once materials are known.
    pub missing_light: Switch,
    /// Radiance of lights beyond the sensor's ceiling from the shading they throw; nothing happens
    /// where no pixel is clipped.
    pub clipped_light: Switch,
    /// Whether surface is told apart by shape and look where no photograph has labels.
    pub segments: Switch,
    /// Whether classes take the colours they are painted in: `Auto` = where they have no texture.
    pub painted: Switch,
    /// Whether exposure and white balance of the views are solved for and taken out.
    pub exposure: Switch,
    /// Whether surfaces may emit.
    pub emission: Switch,
    /// Whether light may come from directions without geometry.
    pub environment: Switch,
    /// Whether the scene is divided into rooms.
    pub rooms: Switch,
    /// Runs the published method instead of unbake's own.
    pub published: Option<PublishedOptions>,
    /// Reflection model; chosen from the evidence if `None`.
    pub reflectance: Option<Reflectance>,
    /// Relative error of irradiance that decides its samples.
    pub target_error: Option<f32>,
    /// Time to spend; then it decides sizes and samples.
    #[serde(skip)]
    pub budget: Option<Budget>,
    /// Where results of long stages are kept for a run that stops.
    #[serde(skip)]
    pub checkpoints: Checkpoints,
    /// Seed of all random numbers.
    #[serde(skip)]
    pub seed: u64,
}

impl Default for SolveOptions {
    /// The preset `standard` with sizes taken at their word.
    fn default() -> Self {
        Self::preset(Quality::Standard)
    }
}

impl SolveOptions {
    /// Refuses what cannot be computed before anything is read.
    ///
    /// # Errors
    /// An option out of its range, named with the range.
    pub fn validate(&self) -> Result<()> {
        let wrong = |message: String| Err(Error::Usage(format!("solve: {message}")));
        for (name, side) in [
            ("albedo", self.albedo_size),
            ("roughness", self.roughness_size),
            ("irradiance", self.irradiance_size),
        ] {
            if !(1..=16_384).contains(&side) {
                return wrong(format!("--{name}-size {side}: must be from 1 to 16384"));
            }
        }
        for (flag, samples) in [
            ("irradiance-rays", self.irradiance_rays),
            ("emitter-samples", self.emitter_samples),
            ("evidence-rays", self.evidence_rays),
            ("specular-rays", self.specular_rays),
        ] {
            if samples > 1 << 20 {
                return wrong(format!("--{flag} {samples}: must be at most 1048576"));
            }
        }
        let seconds = self.budget.as_ref().map(Budget::seconds);
        if let Some(s) = seconds.filter(|s| !(s.is_finite() && *s > 0.0)) {
            return wrong(format!(
                "--budget {s}: must be a time above 0, in a file as seconds"
            ));
        }
        if self.irradiance_rays + self.emitter_samples == 0 {
            return wrong(
                "--irradiance-rays and --emitter-samples are both 0: nothing would be lit".into(),
            );
        }
        if let Some(epochs) = self.nirf.filter(|e| !(1..=1_000_000).contains(e)) {
            return wrong(format!(
                "--nirf {epochs}: must be from 1 to 1000000 epochs (the paper: 2000)"
            ));
        }
        if !(1..=16).contains(&self.irradiance_rounds) {
            return wrong(format!(
                "--irradiance-rounds {}: must be from 1 to 16",
                self.irradiance_rounds
            ));
        }
        if !(3..=1024).contains(&self.roughness_levels) {
            return wrong(format!(
                "--roughness-levels {}: must be from 3 to 1024",
                self.roughness_levels
            ));
        }
        if !(1..=64).contains(&self.photo_reduction) {
            return wrong(format!(
                "--photo-reduction {}: must be from 1 to 64",
                self.photo_reduction
            ));
        }
        if let Some(target) = self.target_error.filter(|t| !(1e-4..=1.0).contains(t)) {
            return wrong(format!(
                "--target-error {target}: must be from 0.0001 to 1 (0.02 = 2 %)"
            ));
        }
        if let Some(fault) = self.published.as_ref().and_then(|p| p.fault()) {
            return wrong(fault);
        }
        if self.irradiance_error.is_nan() || self.irradiance_error < 0.0 {
            return wrong(format!(
                "--irradiance-error {}: must be 0 or more",
                self.irradiance_error
            ));
        }
        Ok(())
    }
}
