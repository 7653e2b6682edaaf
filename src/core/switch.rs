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

impl Switch {
    /// The choice, `otherwise` if it is left to the program.
    #[must_use]
    pub fn or(self, otherwise: bool) -> bool {
        match self {
            Self::Auto => otherwise,
            Self::On => true,
            Self::Off => false,
        }
    }

    /// The choice, that of a preset if it is left to the program.
    #[must_use]
    pub fn or_preset(self, preset: Self) -> Self {
        match self {
            Self::Auto => preset,
            told => told,
        }
    }
}
