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

impl Correction {
    /// Whether it concerns the light and its samples, which compared systems share.
    fn is_of_light(self) -> bool {
        matches!(self, Self::W1 | Self::W2 | Self::W5 | Self::W6)
    }
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

/// Who finds the materials: the published method, or a system that it is compared with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum PublishedStrategy {
    /// TexIR: textures in three stages.
    #[default]
    Texir,
    /// InvRender: a sparse code of materials.
    Invrender,
    /// NVDIFFREC: a hash grid.
    Nvdiffrec,
    /// NeILF: a network of sines.
    Neilf,
    /// NeILF with its own light, learned instead of traced.
    NeilfStar,
    /// Texture-space differentiable path tracing.
    Tsdr,
}

impl PublishedStrategy {
    /// Epochs of the comparison (cited: method §7.2; TexIR's are those of its values).
    fn epochs(self, values: PublishedValues) -> u32 {
        match self {
            Self::Texir => match values {
                PublishedValues::Text => 40,
                PublishedValues::Code => 41,
            },
            Self::Invrender | Self::Nvdiffrec => 101,
            Self::Neilf | Self::NeilfStar => 51,
            // no number is at hand: TexIR's three stages
            Self::Tsdr => 120,
        }
    }
}

/// What the published method runs with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct PublishedOptions {
    /// Whose numbers.
    pub values: PublishedValues,
    /// Who finds the materials.
    pub strategy: PublishedStrategy,
    /// Whether a compared system has the faults that TexIR's authors gave it (method §7.2).
    pub handicapped: bool,
    /// Whether ceilings and lamps are set to the values of supplement, Sec. C.1.
    pub post_process: bool,
    /// Epochs, of each of the three stages where there are stages.
    pub epochs: u32,
    /// Pixels that a compared system looks at in each visit of a view.
    pub visit_pixels: usize,
    /// Pixels along a side of the cubes' faces that panoramas become.
    pub face_pixels: usize,
    /// Uniform rays to the light texture that give a pixel's irradiance anew in each step: the
    /// paper's lighting ablation. 0: the irradiance texture does.
    pub light_samples: u32,
    /// Weaknesses taken out.
    pub corrections: Vec<Correction>,
    /// Stages that are run: fewer are the paper's stage ablation.
    pub stages: Vec<PublishedStage>,
}

/// Pixels of a visit. Derived: 8,192 are a step of NeILF's authors (method §7.2).
const VISIT_PIXELS: usize = 8192;
/// Pixels along a face (cited: supplement, Sec. C.1).
const FACE_PIXELS: usize = 128;
/// Most epochs of a stage that may be asked for.
const MOST_EPOCHS: u32 = 10_000;
/// Most pixels along a face, and rays of a pixel's irradiance, that may be asked for.
const MOST_FACE_PIXELS: usize = 4096;
const MOST_LIGHT_SAMPLES: u32 = 65_536;

impl PublishedOptions {
    /// The numbers of text or code.
    #[must_use]
    pub fn new(strategy: PublishedStrategy, values: PublishedValues) -> Self {
        Self {
            values,
            strategy,
            handicapped: false,
            post_process: false,
            epochs: strategy.epochs(values),
            visit_pixels: VISIT_PIXELS,
            face_pixels: FACE_PIXELS,
            light_samples: 0,
            corrections: Vec::new(),
            stages: PublishedStage::ALL.to_vec(),
        }
    }

    /// Whether a weakness is taken out.
    #[must_use]
    pub fn corrects(&self, correction: Correction) -> bool {
        self.corrections.contains(&correction)
    }

    /// What of it cannot be run, as a sentence; `None` if all can.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        if !(1..=MOST_EPOCHS).contains(&self.epochs) {
            return Some(format!(
                "--epochs {}: must be from 1 to {MOST_EPOCHS} (the paper: 40)",
                self.epochs
            ));
        }
        if self.visit_pixels == 0 {
            return Some("--visit-pixels 0: must be at least 1".to_owned());
        }
        if !(1..=MOST_FACE_PIXELS).contains(&self.face_pixels) {
            return Some(format!(
                "--face-pixels {}: must be from 1 to {MOST_FACE_PIXELS} (the paper: {FACE_PIXELS})",
                self.face_pixels
            ));
        }
        let own_light = [PublishedStrategy::NeilfStar, PublishedStrategy::Tsdr];
        if self.light_samples > MOST_LIGHT_SAMPLES
            || (self.light_samples > 0 && own_light.contains(&self.strategy))
        {
            return Some(format!(
                "--light-samples {}: must be at most {MOST_LIGHT_SAMPLES}, and 0 for strategies with a light of \
                 their own (neilf-star, tsdr)",
                self.light_samples
            ));
        }
        let texir = self.strategy == PublishedStrategy::Texir;
        if (texir || self.strategy == PublishedStrategy::Tsdr) && self.handicapped {
            return Some(
                "--handicapped is for systems that the paper's authors ran: --strategy invrender, \
                 nvdiffrec, neilf or neilf-star"
                    .to_owned(),
            );
        }
        let stages = self.stages != PublishedStage::ALL;
        let own = self.corrections.iter().any(|c| !c.is_of_light());
        if !texir && (stages || own) {
            return Some(
                "--stages and all of --correct but w1, w2, w5 and w6 belong to --strategy texir"
                    .to_owned(),
            );
        }
        None
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_belong_together_is_refused() {
        let of = |strategy| PublishedOptions::new(strategy, PublishedValues::Text);
        let texir = of(PublishedStrategy::Texir);
        let neilf = of(PublishedStrategy::Neilf);
        assert_eq!((texir.epochs, neilf.epochs), (40, 51));
        assert_eq!((texir.fault(), neilf.fault()), (None, None));
        let handicapped = |o: &PublishedOptions| PublishedOptions {
            handicapped: true,
            ..o.clone()
        };
        assert_eq!(handicapped(&neilf).fault(), None);
        assert!(handicapped(&texir).fault().is_some());
        let corrected = |o: &PublishedOptions, c| PublishedOptions {
            corrections: vec![c],
            ..o.clone()
        };
        assert_eq!(corrected(&neilf, Correction::W1).fault(), None);
        assert!(corrected(&neilf, Correction::W3).fault().is_some());
        let no_faces = PublishedOptions {
            face_pixels: 0,
            ..texir.clone()
        };
        assert!(
            no_faces
                .fault()
                .is_some_and(|f| f.contains("--face-pixels"))
        );
        let sampled = |strategy| PublishedOptions {
            light_samples: 16,
            ..of(strategy)
        };
        assert_eq!(sampled(PublishedStrategy::Neilf).fault(), None);
        assert!(sampled(PublishedStrategy::NeilfStar).fault().is_some());
        let staged = PublishedOptions {
            stages: vec![PublishedStage::Joint],
            ..neilf
        };
        assert!(staged.fault().is_some_and(|f| f.contains("--stages")));
    }
}
