//! The value of an option that decides by itself unless told otherwise.

use serde::{Deserialize, Serialize};

/// A choice that the program makes from the evidence unless it is forced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// As the evidence (or the preset) says.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}
