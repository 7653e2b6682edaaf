//! What `unbake bake` is told.

use crate::error::{Error, Result};
use crate::pipeline::parse_seconds;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Options of `unbake bake`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct BakeOptions {
    /// Paths per texel; with --budget or --target-error the most that are taken.
    #[arg(long, value_name = "N", default_value_t = Self::default().samples)]
    pub samples: u32,
    /// Time for sampling, such as 60s or 2min: samples double until it is spent.
    #[arg(long, value_name = "TIME", value_parser = parse_seconds)]
    pub budget: Option<f64>,
    /// Relative error of the lightmap to reach (0.02 = 2 %): samples double until then.
    #[arg(long, value_name = "RATIO")]
    pub target_error: Option<f32>,
    /// Side of the lightmap in texels [default: as --texels-per-metre asks].
    #[arg(long, value_name = "TEXELS", conflicts_with = "texels_per_metre")]
    pub size: Option<u32>,
    /// Texels per metre of surface; a lightmap that would exceed 4096 texels has fewer.
    #[arg(long, value_name = "N", default_value_t = Self::default().texels_per_metre)]
    pub texels_per_metre: f32,
    /// Lay the surface out anew even if the file has usable coordinates for a lightmap
    /// (TEXCOORD_1).
    #[arg(long)]
    pub unwrap: bool,
    /// Texels kept free around every chart of an own layout.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().unwrap_padding)]
    pub unwrap_padding: u32,
    /// Light from outside: an equirectangular panorama (EXR or HDR), its middle in direction -z.
    #[arg(long, value_name = "FILE")]
    pub environment: Option<PathBuf>,
    /// Turn of the panorama about the vertical axis, counter-clockwise seen from above.
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().environment_turn, allow_negative_numbers = true)]
    pub environment_turn: f32,
    /// Factor on the panorama, such as what brings it to the unit of the file's lamps.
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().environment_scale)]
    pub environment_scale: f32,
    /// Also write the irradiance of other normals than the surface's own, for normal maps: its
    /// mean and three slopes (spherical harmonics up to the first order).
    #[arg(long)]
    pub directional: bool,
    /// Also write a folder `godot` for a project of that version: the scene with its lightmap as
    /// Godot's resource.
    #[arg(long, value_name = "VERSION")]
    pub godot: Option<GodotVersion>,
}

/// A major version of Godot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
pub enum GodotVersion {
    /// 3.x.
    #[value(name = "3")]
    #[serde(rename = "3")]
    Three,
    /// 4.x.
    #[value(name = "4")]
    #[serde(rename = "4")]
    Four,
}

/// Largest side of a lightmap: what every graphics card of the last ten years takes.
pub(super) const MOST_SIDE: u32 = 4096;

impl Default for BakeOptions {
    fn default() -> Self {
        Self {
            samples: 256,
            budget: None,
            target_error: None,
            size: None,
            // Unity's default Lightmap Resolution
            texels_per_metre: 40.0,
            unwrap: false,
            unwrap_padding: 4,
            environment: None,
            environment_turn: 0.0,
            environment_scale: 1.0,
            directional: false,
            godot: None,
        }
    }
}

impl BakeOptions {
    /// # Errors
    /// An option out of range.
    pub(super) fn validate(&self) -> Result<()> {
        let wrong = |what: &str| Err(Error::Usage(format!("bake: {what}")));
        if !(8..=1 << 20).contains(&self.samples) {
            return wrong("--samples must be from 8 to 1048576");
        }
        if self.target_error.is_some_and(|e| !(e > 0.0 && e < 1.0)) {
            return wrong("--target-error must be between 0 and 1");
        }
        if self.size.is_some_and(|s| !(16..=16_384).contains(&s)) {
            return wrong("--size must be from 16 to 16384");
        }
        if !(self.texels_per_metre > 0.0 && self.texels_per_metre.is_finite()) {
            return wrong("--texels-per-metre must be positive");
        }
        if !(2..=64).contains(&self.unwrap_padding) {
            return wrong(
                "--unwrap-padding must be from 2 to 64: a texel for the filter of each chart",
            );
        }
        if !self.environment_turn.is_finite() {
            return wrong("--environment-turn must be a number of degrees");
        }
        if !(self.environment_scale >= 0.0 && self.environment_scale.is_finite()) {
            return wrong("--environment-scale must not be negative");
        }
        Ok(())
    }
}
