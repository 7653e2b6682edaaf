//! Presets, and how the user's flags change them.
//!
//! The numbers are read off the curve that `unbake bench tradeoff` measures (docs/tradeoff.svg).

use super::quality::Quality;
use super::time_budget::parse_seconds;
use super::{Budget, Checkpoints, Fit, SolveOptions, Switch};
use crate::core::brdf::Reflectance;
use crate::highlight::LEVELS;
use crate::irradiance::Estimator;
use crate::published::{
    Correction, PublishedOptions, PublishedStage, PublishedStrategy, PublishedValues,
};
use serde::{Deserialize, Serialize};
use std::time::Instant;

impl SolveOptions {
    /// The numbers of a preset.
    #[must_use]
    pub fn preset(quality: Quality) -> Self {
        let standard = Self {
            quality,
            ..Self::standard()
        };
        match quality {
            Quality::Preview => Self {
                albedo_size: 512,
                roughness_size: 512,
                irradiance_size: 192,
                photo_reduction: 4,
                irradiance_rays: 30,
                emitter_samples: 15,
                irradiance_rounds: 2,
                evidence_points: 100,
                evidence_rays: 16,
                roughness_levels: 12,
                specular_rays: 1,
                metals: Switch::Off,
                edges: Switch::Off,
                ..standard
            },
            Quality::Draft => Self {
                albedo_size: 1024,
                roughness_size: 1024,
                irradiance_size: 512,
                irradiance_rays: 42,
                emitter_samples: 22,
                irradiance_rounds: 3,
                evidence_points: 400,
                evidence_rays: 16,
                specular_rays: 2,
                ..standard
            },
            Quality::Standard => standard,
            Quality::High => Self {
                albedo_size: 4096,
                irradiance_rays: 546,
                emitter_samples: 273,
                evidence_points: 2400,
                evidence_rays: 48,
                specular_rays: 16,
                ..standard
            },
            // supplement, Secs. A and C.1
            Quality::Paper => Self {
                irradiance_rays: 2048,
                fit: Fit::default(),
                published: Some(PublishedOptions::new(
                    PublishedStrategy::Texir,
                    PublishedValues::Text,
                )),
                ..standard
            },
        }
    }

    /// The preset that is the default.
    fn standard() -> Self {
        Self {
            quality: Quality::Standard,
            albedo_size: 2048,
            roughness_size: 4096,
            irradiance_size: 1024,
            fit: Fit::default(),
            photo_reduction: 1,
            irradiance_estimator: Estimator::Mis,
            nirf: None,
            irradiance_rays: 136,
            emitter_samples: 68,
            irradiance_rounds: 4,
            irradiance_error: 0.01,
            irradiance_filter: true,
            prefilter: true,
            evidence_points: 1200,
            evidence_rays: 32,
            roughness_levels: LEVELS.len(),
            specular_rays: 4,
            matte: Switch::Auto,
            divide: Switch::Auto,
            metals: Switch::Auto,
            panes: Switch::Auto,
            edges: Switch::Auto,
            missing_light: Switch::Auto,
            clipped_light: Switch::Auto,
            segments: Switch::Auto,
            painted: Switch::Auto,
            exposure: Switch::Auto,
            emission: Switch::Auto,
            environment: Switch::Auto,
            rooms: Switch::Auto,
            published: None,
            reflectance: None,
            target_error: None,
            budget: None,
            checkpoints: Checkpoints::default(),
            seed: 0,
        }
    }
}

/// What the user asks for: a preset and whatever differs from it. Every field is a flag of `unbake
/// solve` and a key of the TOML configuration; absent = as the preset says.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SolveRequest {
    /// Preset of samples, resolutions and refinement; every other option overrides it.
    #[arg(long, value_enum, default_value = "standard")]
    pub quality: Quality,
    /// Time for the whole run, such as 60s or 2min (in a file: seconds): texture sizes and samples are chosen to take
    /// it, up to the preset's sizes.
    #[arg(long, value_name = "TIME", value_parser = parse_seconds,
          conflicts_with_all = ["irradiance_rays", "emitter_samples", "evidence_points", "specular_rays", "target_error"])]
    pub budget: Option<f64>,
    /// Relative error of irradiance to reach (0.02 = 2 %): decides the samples per texel.
    #[arg(long, value_name = "RATIO", conflicts_with_all = ["irradiance_rays", "emitter_samples"])]
    pub target_error: Option<f32>,
    /// Side of the albedo, radiance and label textures, texels [default: what the photographs
    /// support, 2048 at most].
    #[arg(long, value_name = "TEXELS")]
    pub albedo_size: Option<usize>,
    /// Side of the roughness texture, texels [default: what the photographs support, 4096 at most].
    #[arg(long, value_name = "TEXELS")]
    pub roughness_size: Option<usize>,
    /// Side of the irradiance texture, texels [default: what the photographs support, 1024 at
    /// most].
    #[arg(long, value_name = "TEXELS")]
    pub irradiance_size: Option<usize>,
    /// Lower texture sizes to what the photographs resolve: auto = those not given, on = all, off =
    /// none.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub fit_textures: Switch,
    /// Reduce photographs by this factor before anything else [default: 1].
    #[arg(long, value_name = "FACTOR")]
    pub photo_reduction: Option<usize>,
    /// How irradiance is estimated: mis = hemisphere rays and emitter samples; the others take
    /// hemisphere rays for both, cosine in rounds, uniform (the paper's) all at once [default:
    /// mis].
    #[arg(long, value_enum, value_name = "ESTIMATOR")]
    pub irradiance_estimator: Option<Estimator>,
    /// Take irradiance from the paper's neural field instead, trained for so many epochs (the
    /// paper: 2000): its lighting ablation, less exact and slower.
    #[arg(long, value_name = "EPOCHS", conflicts_with_all = ["target_error", "budget"])]
    pub nirf: Option<u32>,
    /// Hemisphere rays per irradiance texel, on average [default: 136].
    #[arg(long, value_name = "N")]
    pub irradiance_rays: Option<u32>,
    /// Emitter samples per irradiance texel, on average [default: 68].
    #[arg(long, value_name = "N")]
    pub emitter_samples: Option<u32>,
    /// Rounds in which they are spent: after each, more go to those texels seen by some view whose
    /// errors are largest; 1 = all texels alike [default: 4].
    #[arg(long, value_name = "N")]
    pub irradiance_rounds: Option<u32>,
    /// Relative error of irradiance at which a texel is done [default: 0.01].
    #[arg(long, value_name = "RATIO")]
    pub irradiance_error: Option<f32>,
    /// Filter irradiance noise over the surface.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub irradiance_filter: Switch,
    /// Let a rough reflection's ray look up the mean radiance of the cone it stands for instead of
    /// one texel.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub prefilter: Switch,
    /// Points per class searched for roughness, evenly spread and as many again on virtual
    /// highlights [default: 1200].
    #[arg(long, value_name = "N")]
    pub evidence_points: Option<usize>,
    /// Rays per lobe and look at those points, over 16 places of the pixel: rounded up to a
    /// multiple of that [default: 32].
    #[arg(long, value_name = "N")]
    pub evidence_rays: Option<u32>,
    /// Roughness values at which the specular response of those points is tabulated [default: 18].
    #[arg(long, value_name = "N")]
    pub roughness_levels: Option<usize>,
    /// Rays per pixel along the specular lobe of its roughness [default: 4].
    #[arg(long, value_name = "N")]
    pub specular_rays: Option<u32>,
    /// Replace specular lobes too wide to show anything by the mean light around: on = all from R =
    /// 0.5, off = none.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub matte: Switch,
    /// Give a class several roughness values, by room, by colour or by place, where held-out views
    /// are explained better so: on = wherever they differ, off = one per class.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub divide_classes: Switch,
    /// Look for classes that are metal, without a diffuse part, where views are explained better
    /// so: off = everything is a dielectric.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub metals: Switch,
    /// Look for surfaces that photographs look through (glass, a door that the mesh has closed):
    /// off = all are opaque.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub panes: Switch,
    /// Solve for the albedo of texels that no view sees clean from how much of each pixel they
    /// cover: off = what those pixels show.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub edges: Switch,
    /// Add light that no camera looks along (specular reflections, far sides) once materials are
    /// known: off = as observed.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub missing_light: Switch,
    /// Restore the light of lamps and windows that the photographs clip, from the shading it
    /// throws: auto = where pixels are clipped, off = take the ceiling for the light
    #[arg(long, value_name = "WHEN", default_value_t, value_enum)]
    pub clipped_light: Switch,
    /// Tell surface apart by shape and look: auto = where no photograph has labels, off = take all
    /// that has no label for one class
    #[arg(long, value_name = "WHEN", default_value_t, value_enum)]
    pub segments: Switch,
    /// Give classes the few colours they are painted in: auto = where flat surface shows no
    /// texture, on = whatever it shows, off = every texel has what its own pixels show.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub painted: Switch,
    /// Take exposure and white balance that drift from view to view out of the photographs: auto =
    /// if the views ask for it, off = never.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub exposure: Switch,
    /// Let surfaces emit: auto = where more light leaves than can be reflected and classes of kind
    /// light, off = none.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub emission: Switch,
    /// Let light come from directions without geometry: auto = if any view looks out, off = never.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub environment: Switch,
    /// Divide the scene into rooms: auto = if there are several, off = one room.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto")]
    pub rooms: Switch,
    /// Whose numbers `--quality paper` takes where the supplement and the authors' code differ
    /// [default: text].
    #[arg(long, value_enum, value_name = "WHOSE")]
    pub published_values: Option<PublishedValues>,
    /// Who finds the materials in `--quality paper`: the paper's method, or a system that it is
    /// compared with, under the paper's light [default: texir].
    #[arg(long, value_enum, value_name = "WHO")]
    pub strategy: Option<PublishedStrategy>,
    /// Run a compared system with the faults of the paper's comparison (docs/method.md, 7.2).
    #[arg(long)]
    pub handicapped: bool,
    /// Set ceilings and lamps to the values that the paper gives them on synthetic scenes before it
    /// scores.
    #[arg(long)]
    pub post_process: bool,
    /// Pixels that a compared system looks at in each visit of a view [default: 8192].
    #[arg(long, value_name = "N")]
    pub visit_pixels: Option<usize>,
    /// Pixels along a side of the cubes' faces that `--quality paper` trains on [default: 128].
    #[arg(long, value_name = "N")]
    pub face_pixels: Option<usize>,
    /// Take a pixel's irradiance in each step of `--quality paper` from so many uniform rays to the
    /// light texture, in place of the irradiance texture: its lighting ablation.
    #[arg(long, value_name = "N")]
    pub light_samples: Option<u32>,
    /// Epochs of each stage of `--quality paper` [default: 40; of compared systems 101 or 51].
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// Weaknesses that `--quality paper` takes out, by their number in docs/method.md: w1, w3,…
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',')]
    pub correct: Vec<Correction>,
    /// Stages that `--quality paper` runs [default: i,ii,iii].
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',')]
    pub stages: Vec<PublishedStage>,
    /// Write no report.html and report.json.
    #[arg(long)]
    pub no_report: bool,
    /// Reflection model: the paper's, or one of the common alternatives; chosen from the evidence
    /// if not given.
    #[arg(long, value_enum, value_name = "MODEL")]
    pub reflectance: Option<Reflectance>,
}

impl SolveRequest {
    /// The numbers of the published method in effect.
    fn published(&self) -> PublishedOptions {
        let strategy = self.strategy.unwrap_or_default();
        let values = PublishedOptions::new(strategy, self.published_values.unwrap_or_default());
        PublishedOptions {
            strategy,
            handicapped: self.handicapped,
            post_process: self.post_process,
            visit_pixels: self.visit_pixels.unwrap_or(values.visit_pixels),
            face_pixels: self.face_pixels.unwrap_or(values.face_pixels),
            light_samples: self.light_samples.unwrap_or(values.light_samples),
            epochs: self.epochs.unwrap_or(values.epochs),
            corrections: self.correct.clone(),
            stages: match self.stages.as_slice() {
                [] => values.stages,
                asked => asked.to_vec(),
            },
            values: values.values,
        }
    }

    /// The numbers in effect. A budget runs from `start`.
    #[must_use]
    pub fn options(&self, seed: u64, start: Instant) -> SolveOptions {
        let preset = SolveOptions::preset(self.quality);
        // the published sizes are part of its method
        let fit = |given: bool| (self.fit_textures).or(!given && self.quality != Quality::Paper);
        SolveOptions {
            quality: self.quality,
            albedo_size: self.albedo_size.unwrap_or(preset.albedo_size),
            roughness_size: self.roughness_size.unwrap_or(preset.roughness_size),
            irradiance_size: self.irradiance_size.unwrap_or(preset.irradiance_size),
            fit: Fit {
                albedo: fit(self.albedo_size.is_some()),
                roughness: fit(self.roughness_size.is_some()),
                irradiance: fit(self.irradiance_size.is_some()),
                photographs: self.photo_reduction.is_none(),
            },
            photo_reduction: self.photo_reduction.unwrap_or(preset.photo_reduction),
            irradiance_estimator: self
                .irradiance_estimator
                .unwrap_or(preset.irradiance_estimator),
            nirf: self.nirf,
            irradiance_rays: self.irradiance_rays.unwrap_or(preset.irradiance_rays),
            emitter_samples: self.emitter_samples.unwrap_or(preset.emitter_samples),
            irradiance_rounds: self.irradiance_rounds.unwrap_or(preset.irradiance_rounds),
            irradiance_error: self.irradiance_error.unwrap_or(preset.irradiance_error),
            irradiance_filter: self.irradiance_filter.or(preset.irradiance_filter),
            prefilter: self.prefilter.or(preset.prefilter),
            evidence_points: self.evidence_points.unwrap_or(preset.evidence_points),
            evidence_rays: self.evidence_rays.unwrap_or(preset.evidence_rays),
            roughness_levels: self.roughness_levels.unwrap_or(preset.roughness_levels),
            specular_rays: self.specular_rays.unwrap_or(preset.specular_rays),
            matte: self.matte,
            divide: self.divide_classes,
            metals: self.metals.or_preset(preset.metals),
            panes: self.panes,
            edges: self.edges.or_preset(preset.edges),
            missing_light: self.missing_light,
            clipped_light: self.clipped_light,
            segments: self.segments,
            painted: self.painted,
            exposure: self.exposure,
            emission: self.emission,
            environment: self.environment,
            rooms: self.rooms,
            published: (self.quality == Quality::Paper).then(|| self.published()),
            reflectance: self.reflectance,
            target_error: self.target_error,
            budget: self.budget.map(|seconds| Budget::new(start, seconds)),
            checkpoints: Checkpoints::default(),
            seed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Our own presets, the cheapest first.
    const RISING: [Quality; 4] = [
        Quality::Preview,
        Quality::Draft,
        Quality::Standard,
        Quality::High,
    ];

    #[test]
    fn flags_override_the_preset_and_nothing_else_does() {
        for quality in RISING {
            let plain = SolveRequest {
                quality,
                ..SolveRequest::default()
            }
            .options(7, Instant::now());
            let all = Fit {
                albedo: true,
                roughness: true,
                irradiance: true,
                photographs: true,
            };
            assert_eq!(
                plain,
                SolveOptions {
                    seed: 7,
                    fit: all,
                    ..SolveOptions::preset(quality)
                }
            );
            plain.validate().expect("a preset is valid");
            let asked = SolveRequest {
                quality,
                albedo_size: Some(77),
                irradiance_rays: Some(5),
                irradiance_filter: Switch::Off,
                ..SolveRequest::default()
            };
            let o = asked.options(7, Instant::now());
            assert_eq!(
                (o.albedo_size, o.irradiance_rays, o.irradiance_filter),
                (77, 5, false)
            );
            assert_eq!(
                o.fit,
                Fit {
                    albedo: false,
                    ..all
                },
                "a given size is exact"
            );
            assert_eq!(o.specular_rays, plain.specular_rays);
        }
    }

    #[test]
    fn presets_differ_in_the_order_of_their_names() {
        let cost = |q: Quality| {
            let o = SolveOptions::preset(q);
            [
                o.albedo_size.pow(2) as u64,
                o.irradiance_size.pow(2) as u64 * u64::from(o.irradiance_rays),
                o.evidence_points as u64,
            ]
        };
        let costs = RISING.map(cost);
        assert!(costs.windows(2).all(|c| (0..3).all(|i| c[0][i] < c[1][i])));
    }
}
