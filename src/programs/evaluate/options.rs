//! What `unbake eval` can be told.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What `unbake eval` can be told.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct EvalOptions {
    /// Score the training views as well as the held-out ones.
    #[arg(long)]
    pub train: bool,
    /// Score only so many of the held-out views, spread evenly over them.
    #[arg(long, value_name = "N")]
    pub views: Option<usize>,
    /// Primary rays per pixel along each axis [default: 2].
    #[arg(long, value_name = "N")]
    pub supersampling: Option<u32>,
    /// Write no report.html and report.json.
    #[arg(long)]
    pub no_report: bool,
    /// Quantise albedo and roughness to 8 bits in the FIPT protocol, as its authors' files do.
    #[arg(long)]
    pub quantise: bool,
    /// Exposure in stops applied to radiance before tone mapping for the image scores.
    #[arg(
        long,
        value_name = "EV",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub exposure: f32,
}

/// Stops beyond which any photograph is black or white.
const MOST_STOPS: f32 = 32.0;
/// Primary rays along an axis of a pixel beyond which nothing is gained.
const MOST_RAYS: u32 = 16;

impl EvalOptions {
    /// # Errors
    /// The exposure is no number or out of range.
    pub(super) fn validate(&self) -> Result<()> {
        if self.views == Some(0) {
            return Err(Error::Usage("--views 0: must be at least 1".to_owned()));
        }
        if let Some(n) = self.supersampling.filter(|n| !(1..=MOST_RAYS).contains(n)) {
            return Err(Error::Usage(format!(
                "--supersampling {n}: must be from 1 to {MOST_RAYS}"
            )));
        }
        match self.exposure.abs() <= MOST_STOPS {
            true => Ok(()),
            false => Err(Error::Usage(format!(
                "--exposure {}: expected stops from -{MOST_STOPS} to {MOST_STOPS}",
                self.exposure
            ))),
        }
    }
}
