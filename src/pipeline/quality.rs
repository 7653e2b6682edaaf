//! The presets by name; their numbers stand in `presets`.

use serde::{Deserialize, Serialize};

/// A preset of samples, resolutions and refinement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Quality {
    /// A first relightable result: a quarter of the texture resolution and of the photographs'; no
    /// metals, and edges as their pixels show them.
    Preview,
    /// A quick look: half the texture resolution, a quarter of the samples.
    Draft,
    /// The default.
    #[default]
    Standard,
    /// Four times the samples of the default.
    High,
    /// The method of TexIR as published, for comparison: slower and less exact.
    Paper,
}
