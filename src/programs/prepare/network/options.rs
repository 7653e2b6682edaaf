//! Options of the networks, and what an ONNX file's own `metadata_props` say in their place. A flag
//! stands above the file, the file above the defaults.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Depth and labels by networks that the user brings.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Networks")]
pub struct NetworkOptions {
    /// Network (.onnx) that sees depth in a photograph: a capture without a mesh gets one from its
    /// depth (docs/bring-your-own.md).
    #[arg(long, value_name = "FILE")]
    pub depth_model: Option<PathBuf>,
    /// What the depth network's numbers are; absent = the file's `depth_values`, else ray for
    /// panoramas and z for perspective images.
    #[arg(long, value_enum)]
    pub depth_values: Option<DepthValues>,
    /// What is free in the depth of a photograph and solved from where photographs overlap; absent =
    /// the file's `depth_fit`, else affine for inverse depth and scale for depth.
    #[arg(long, value_enum)]
    pub depth_fit: Option<DepthFit>,
    /// Network (.onnx) that says of a photograph's pixels what they are: its classes become the
    /// labels of the scene.
    #[arg(long, value_name = "FILE")]
    pub semantic_model: Option<PathBuf>,
    /// Names of the semantic network's classes, one a line in the order of its channels; absent = the
    /// file's `names` or `classes`.
    #[arg(long, value_name = "FILE")]
    pub semantic_names: Option<PathBuf>,
    /// How panoramas are shown to a network; absent = the file's `tiles`, else whole to networks
    /// whose input is twice as wide as high and in perspective tiles to others.
    #[arg(long, value_enum)]
    pub network_tiles: Option<PanoramaTiles>,
    /// Mean that is taken from red, green and blue, of pixels from 0 to 1 (or 0 to 255), "R,G,B";
    /// absent = the file's `mean`, else ImageNet's.
    #[arg(long, value_name = "R,G,B")]
    pub network_mean: Option<String>,
    /// What red, green and blue are divided by afterwards, "R,G,B"; absent = the file's `std`, else
    /// ImageNet's.
    #[arg(long, value_name = "R,G,B")]
    pub network_std: Option<String>,
}

/// What a depth network gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DepthValues {
    /// Distance along the ray.
    Ray,
    /// Distance along the optical axis.
    Z,
    /// One over the distance along the ray.
    InverseRay,
    /// One over the distance along the optical axis (disparity).
    InverseZ,
}

impl DepthValues {
    /// Whether far is small.
    pub(super) fn is_inverse(self) -> bool {
        matches!(self, Self::InverseRay | Self::InverseZ)
    }

    /// Whether measured along the optical axis.
    pub(super) fn is_along_axis(self) -> bool {
        matches!(self, Self::Z | Self::InverseZ)
    }
}

/// What of a photograph's depth is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DepthFit {
    /// Nothing: the network gives metres.
    None,
    /// A factor.
    Scale,
    /// A factor and a constant.
    Affine,
}

/// How a panorama is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum PanoramaTiles {
    /// Whole, to a network that was trained on panoramas.
    Whole,
    /// In perspective images that overlap, to a network that was trained on ordinary photographs.
    Perspective,
}

/// What is taken from pixels before a network sees them: (p − mean) / std, p from 0 to 1, sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Normalisation {
    pub mean: [f32; 3],
    pub std: [f32; 3],
    /// Channels are blue, green, red.
    pub bgr: bool,
}

/// Cited: mean and standard deviation of ImageNet's pixels, with which backbones are published
/// (Paszke et al. 2019, torchvision).
const IMAGENET: Normalisation = Normalisation {
    mean: [0.485, 0.456, 0.406],
    std: [0.229, 0.224, 0.225],
    bgr: false,
};

/// The file's `metadata_props` with its name, for messages.
pub(super) struct Properties<'a> {
    pub path: &'a Path,
    pub of: &'a BTreeMap<String, String>,
}

impl Properties<'_> {
    /// A choice: the flag's, else the file's.
    pub fn choice<T: clap::ValueEnum>(&self, flag: Option<T>, key: &str) -> Result<Option<T>> {
        let (None, Some(text)) = (&flag, self.of.get(key)) else {
            return Ok(flag);
        };
        T::from_str(text.trim(), true).map(Some).map_err(|_| {
            let known = T::value_variants().iter().filter_map(T::to_possible_value);
            let known: Vec<String> = known.map(|v| v.get_name().to_owned()).collect();
            let flag = match key {
                "tiles" => "network-tiles".to_owned(),
                _ => key.replace('_', "-"),
            };
            Error::input(
                self.path,
                format!(
                    "metadata_props {key}: \"{text}\"; expected one of {}. --{flag} overrides it",
                    known.join(", ")
                ),
            )
        })
    }

    /// The normalisation: flags, else the file's `mean`, `std` and `channels` (`rgb` or `bgr`), else
    /// ImageNet's.
    pub fn normalisation(&self, options: &NetworkOptions) -> Result<Normalisation> {
        let three = |flag: &Option<String>, key: &str| {
            match (flag, self.of.get(key)) {
            (Some(text), _) => numbers(text).map(Some).ok_or_else(|| {
                Error::Usage(format!(
                    "--network-{key} {text}: expected three numbers \"R,G,B\""
                ))
            }),
            (None, Some(text)) => numbers(text).map(Some).ok_or_else(|| {
                let message = format!(
                    "metadata_props {key}: \"{text}\"; expected three numbers. --network-{key} R,G,B overrides it"
                );
                Error::input(self.path, message)
            }),
            (None, None) => Ok(None),
        }
        };
        let bgr = self.of.get("channels").map(|c| c.trim().to_lowercase());
        let bgr = match bgr.as_deref() {
            None | Some("rgb") => false,
            Some("bgr") => true,
            Some(other) => {
                let message = format!("metadata_props channels: \"{other}\"; expected rgb or bgr");
                return Err(Error::input(self.path, message));
            }
        };
        let mean = three(&options.network_mean, "mean")?;
        let std = three(&options.network_std, "std")?;
        // numbers of pixels from 0 to 255: both shrink alike, and the quotient is the same
        let unit = |n: [f32; 3]| match n.iter().any(|v| *v > 1.0) {
            true => n.map(|v| v / 255.0),
            false => n,
        };
        let of = Normalisation {
            mean: mean.map_or(IMAGENET.mean, unit),
            std: std.map_or(IMAGENET.std, unit),
            bgr,
        };
        if of.std.iter().any(|s| *s <= 0.0) {
            return Err(Error::input(
                self.path,
                format!(
                    "std {:?}: expected positive numbers; --network-std R,G,B overrides the file's",
                    of.std
                ),
            ));
        }
        Ok(of)
    }
}

/// Three finite numbers of "a,b,c" or "[a, b, c]".
fn numbers(text: &str) -> Option<[f32; 3]> {
    let plain = text.trim().trim_start_matches('[').trim_end_matches(']');
    let all: Option<Vec<f32>> = (plain.split(','))
        .map(|n| n.trim().parse().ok().filter(|v: &f32| v.is_finite()))
        .collect();
    <[f32; 3]>::try_from(all?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        (pairs.iter())
            .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()))
            .collect()
    }

    #[test]
    fn a_flag_stands_above_the_file_and_the_file_above_the_default() {
        let path = Path::new("net.onnx");
        let none = NetworkOptions::default();
        let file = of(&[
            ("mean", "[127.5, 127.5, 127.5]"),
            ("std", "255, 255, 255"),
            ("depth_values", "inverse-z"),
        ]);
        let properties = Properties { path, of: &file };
        let n = properties.normalisation(&none).expect("numbers");
        assert_eq!((n.mean, n.std), ([0.5; 3], [1.0; 3]));
        let flags = NetworkOptions {
            network_mean: Some("0,0,0".into()),
            ..none.clone()
        };
        let n = properties.normalisation(&flags).expect("numbers");
        assert_eq!((n.mean, n.std), ([0.0; 3], [1.0; 3]));
        let kind = properties.choice(None, "depth_values").expect("known");
        assert_eq!(kind, Some(DepthValues::InverseZ));
        let kind = properties.choice(Some(DepthValues::Ray), "depth_values");
        assert_eq!(kind.expect("flag"), Some(DepthValues::Ray));
        let empty = of(&[]);
        let properties = Properties { path, of: &empty };
        assert_eq!(properties.normalisation(&none).expect("default"), IMAGENET);
    }

    #[test]
    fn what_a_file_says_wrongly_is_named() {
        let path = Path::new("net.onnx");
        let file = of(&[("mean", "1,2"), ("depth_values", "metres")]);
        let properties = Properties { path, of: &file };
        let e = properties.normalisation(&NetworkOptions::default());
        let e = e.expect_err("two numbers").to_string();
        assert!(
            e.contains("net.onnx") && e.contains("--network-mean"),
            "{e}"
        );
        let e = properties.choice::<DepthValues>(None, "depth_values");
        let e = e.expect_err("no such kind").to_string();
        assert!(
            e.contains("inverse-z") && e.contains("--depth-values"),
            "{e}"
        );
    }
}
