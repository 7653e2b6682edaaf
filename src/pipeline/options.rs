//! Options of `unbake solve`.

use crate::brdf::Reflectance;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// A preset of samples, resolutions and refinement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Quality {
    /// A quick look: half the texture resolution, a quarter of the samples.
    Draft,
    /// The default.
    Standard,
    /// More samples where they still pay.
    High,
}

/// Options of the reconstruction. Every field is a command-line flag and a key of the TOML configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SolveOptions {
    /// Preset of samples, resolutions and refinement.
    #[arg(long, value_enum, default_value = "standard")]
    pub quality: Quality,
    /// Side of the albedo, radiance and label textures, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().albedo_size)]
    pub albedo_size: usize,
    /// Side of the roughness texture, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().roughness_size)]
    pub roughness_size: usize,
    /// Side of the irradiance texture, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().irradiance_size)]
    pub irradiance_size: usize,
    /// Hemisphere rays per irradiance texel in the first round.
    #[arg(long, value_name = "N", default_value_t = Self::default().irradiance_rays)]
    pub irradiance_rays: u32,
    /// Emitter samples per irradiance texel in the first round.
    #[arg(long, value_name = "N", default_value_t = Self::default().emitter_samples)]
    pub emitter_samples: u32,
    /// Relative standard error of irradiance at which a texel is done.
    #[arg(long, value_name = "RATIO", default_value_t = Self::default().irradiance_error)]
    pub irradiance_error: f32,
    /// Reflection model: the paper's, or one of the common alternatives; chosen from the evidence if not given.
    #[arg(long, value_enum, value_name = "MODEL")]
    pub reflectance: Option<Reflectance>,
    /// Seed of all random numbers: the command line's global `--seed`.
    #[arg(skip)]
    #[serde(skip)]
    pub seed: u64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            quality: Quality::Standard,
            albedo_size: 2048,
            roughness_size: 4096,
            irradiance_size: 1024,
            irradiance_rays: 64,
            emitter_samples: 64,
            irradiance_error: 0.01,
            reflectance: None,
            seed: 0,
        }
    }
}

impl SolveOptions {
    /// Refuses what cannot be computed before anything is read.
    ///
    /// # Errors
    /// An option out of its range, named with the range.
    pub fn validate(&self) -> Result<()> {
        let wrong = |message: String| Err(Error::Usage(format!("solve: {message}")));
        for (name, side) in
            [("albedo", self.albedo_size), ("roughness", self.roughness_size), ("irradiance", self.irradiance_size)]
        {
            if !(1..=16_384).contains(&side) {
                return wrong(format!("--{name}-size {side}: must be from 1 to 16384"));
            }
        }
        for (flag, samples) in [("irradiance-rays", self.irradiance_rays), ("emitter-samples", self.emitter_samples)] {
            if samples > 1 << 20 {
                return wrong(format!("--{flag} {samples}: must be at most 1048576"));
            }
        }
        if self.irradiance_error.is_nan() || self.irradiance_error < 0.0 {
            return wrong(format!("--irradiance-error {}: must be 0 or more", self.irradiance_error));
        }
        Ok(())
    }
}
