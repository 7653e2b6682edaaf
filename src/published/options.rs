//! The numbers of the published method (method §7, §14), and the corrections that can be
//! switched on alone.

use serde::{Deserialize, Serialize};

/// Whose numbers hold where the supplement and the authors' code differ (method §7.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum PublishedValues {
    /// The supplement's.
    #[default]
    Text,
    /// The released code's.
    Code,
}

/// A known weakness of the published method that can be taken out, by its number in method §12.2.
/// W4, W9 and W10 (positions read from a panorama, faces without pixel centres, a depth buffer) have
/// no counterpart here: geometry is exact in every mode.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Correction {
    /// The gradient of roughness knows how the lobe moves over the light.
    W1,
    /// Residual and gradient come from samples that are independent of each other.
    W2,
    /// Virtual highlights are no evidence of albedo.
    W3,
    /// Irradiance by samples on emitters and cosine-distributed rays.
    W5,
    /// Light texels are fused from all views instead of taken from one.
    W6,
    /// Highlights are fitted through the mip levels that everything else is fetched through.
    W7,
    /// Class means and targets are those of all views, not of one.
    W8,
}

/// A stage of the published optimisation.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum PublishedStage {
    /// Albedo without reflections.
    #[value(name = "i")]
    #[serde(rename = "i")]
    Albedo,
    /// Roughness on virtual highlights.
    #[value(name = "ii")]
    #[serde(rename = "ii")]
    Roughness,
    /// Both together.
    #[value(name = "iii")]
    #[serde(rename = "iii")]
    Joint,
}

impl PublishedStage {
    /// All, in their order.
    pub const ALL: [Self; 3] = [Self::Albedo, Self::Roughness, Self::Joint];

    /// What a progress bar calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Albedo => "stage I: albedo",
            Self::Roughness => "stage II: roughness",
            Self::Joint => "stage III: both",
        }
    }
}

/// What the published method runs with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct PublishedOptions {
    /// Whose numbers.
    pub values: PublishedValues,
    /// Epochs of each of the three stages.
    pub epochs: u32,
    /// Weaknesses taken out.
    pub corrections: Vec<Correction>,
    /// Stages that are run: fewer are the paper's stage ablation.
    pub stages: Vec<PublishedStage>,
}

/// Most epochs of a stage that may be asked for.
const MOST_EPOCHS: u32 = 10_000;

impl PublishedOptions {
    /// The numbers of text or code.
    #[must_use]
    pub fn new(values: PublishedValues) -> Self {
        Self {
            values,
            epochs: match values {
                PublishedValues::Text => 40,
                PublishedValues::Code => 41,
            },
            corrections: Vec::new(),
            stages: PublishedStage::ALL.to_vec(),
        }
    }

    /// Whether a weakness is taken out.
    #[must_use]
    pub fn corrects(&self, correction: Correction) -> bool {
        self.corrections.contains(&correction)
    }

    /// Whether the number of epochs can be run.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        (1..=MOST_EPOCHS).contains(&self.epochs)
    }

    /// Weights of the losses.
    pub(super) fn weights(&self) -> Weights {
        match self.values {
            PublishedValues::Text => Weights {
                albedo_smoothness: 10.0,
                highlights: 1.0,
                propagation: 1.0,
                roughness_smoothness: 0.1,
            },
            PublishedValues::Code => Weights {
                albedo_smoothness: 20.0,
                highlights: 16_384.0,
                propagation: 1.0,
                roughness_smoothness: 0.2,
            },
        }
    }
}

/// Weights of the losses (supplement, Sec. B; method §7).
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights {
    /// β_ssa of stage I.
    pub albedo_smoothness: f64,
    /// Factor of stage II's photometric term.
    pub highlights: f64,
    /// β_sp of stage II.
    pub propagation: f64,
    /// β_ssr of stage III.
    pub roughness_smoothness: f64,
}
