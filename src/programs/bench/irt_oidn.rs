//! Open Image Denoise beside our surface filter: the same bake left as traced, and filtered in the
//! texture by its lightmap filter.
//!
//! It sees what a filter of images can see: a texture, charts beside each other, the space between
//! them filled. Seconds are the bake's and the filter's; loading the library is not among them, as
//! loading Embree is not among ours.

use super::irt_error::WholeBake;
use super::{BenchScene, ErrorPoint, Reference, timed};
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::ffi::oidn::Denoiser;
use crate::pipeline::{SolveOptions, bake_irradiance_texels, texture_of};
use serde::Serialize;
use std::path::Path;

/// What became of the comparison.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OidnReport {
    /// The library was found.
    Used {
        /// Its version, such as `2.3.1`.
        version: String,
        /// Seconds that its filter took, one entry per point of its curve.
        filter_seconds: Vec<f64>,
    },
    /// No library could be used; the text says which were tried and how to give one.
    Missing(String),
}

impl OidnReport {
    /// The line of the terminal's table.
    pub(super) fn line(&self) -> String {
        match self {
            Self::Used {
                version,
                filter_seconds,
            } => {
                let seconds: Vec<String> =
                    filter_seconds.iter().map(|s| format!("{s:.2}")).collect();
                format!(
                    "oidn: the unfiltered bake through the lightmap filter of Open Image Denoise {version}, which took {} s of its seconds",
                    seconds.join(" and ")
                )
            }
            Self::Missing(why) => format!("oidn: not compared. {}", why.replace('\n', "\n  ")),
        }
    }
}

/// Opens the library that `file` names, or looks for one; the inner error says why there is none to
/// compare with.
///
/// # Errors
/// A library that was asked for by `file` and cannot be used.
pub(super) fn open(file: Option<&Path>) -> Result<std::result::Result<Denoiser, String>> {
    match (Denoiser::open(file, rayon::current_num_threads()), file) {
        (Err(why), Some(_)) => Err(Error::Native(why)),
        (opened, _) => Ok(opened),
    }
}

/// The curves `unfiltered` and `oidn` at each of `samples` (hemisphere rays and emitter samples per
/// texel).
///
/// # Errors
/// The library failing.
pub(super) fn measure(
    ground: &BenchScene,
    reference: &Reference,
    denoiser: &Denoiser,
    samples: &[[u32; 2]],
    progress: &Progress,
) -> Result<(Vec<ErrorPoint>, OidnReport)> {
    let texels = &ground.light.texels;
    let (mut unfiltered, mut denoised, mut filter_seconds) = (Vec::new(), Vec::new(), Vec::new());
    for &[irradiance_rays, emitter_samples] in samples {
        let options = SolveOptions {
            irradiance_rays,
            emitter_samples,
            irradiance_rounds: 1,
            irradiance_filter: false,
            ..ground.options.clone()
        };
        let (field, emitters) = (&ground.light.field, &ground.light.emitters);
        let (baked, seconds) = timed(|| {
            bake_irradiance_texels(&ground.surface, field, emitters, texels, &options, progress)
        });
        let (filtered, more) = timed(|| {
            let texture = texture_of(texels, &baked.value);
            denoiser.lightmap(texture.width, texture.height, &texture.data)
        });
        let filtered = filtered.map_err(Error::Native)?;
        let bake = |curve: &str, seconds| WholeBake {
            curve: curve.to_owned(),
            samples: [irradiance_rays, emitter_samples],
            rays: baked.rays,
            texels: texels.len(),
            seconds,
        };
        let value = reference.at_ids(&baked.value);
        unfiltered.push(bake("unfiltered", seconds).point(&value, reference));
        let value = reference.at_cells(texels, &filtered);
        denoised.push(bake("oidn", seconds + more).point(&value, reference));
        filter_seconds.push(more);
    }
    unfiltered.extend(denoised);
    Ok((
        unfiltered,
        OidnReport::Used {
            version: denoiser.version(),
            filter_seconds,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_that_was_asked_for_must_be_there() {
        let error = open(Some(Path::new("/nonexistent/libOpenImageDenoise.so.2")))
            .err()
            .expect("an error");
        assert_eq!(error.exit_code(), 1);
        assert!(
            error
                .to_string()
                .contains("/nonexistent/libOpenImageDenoise.so.2"),
            "{error}"
        );
    }

    #[test]
    fn the_table_says_which_version_or_how_to_give_one() {
        let used = OidnReport::Used {
            version: "2.3.1".into(),
            filter_seconds: vec![0.5, 0.25],
        };
        assert!(
            used.line().contains("Open Image Denoise 2.3.1")
                && used.line().contains("0.50 and 0.25 s"),
            "{}",
            used.line()
        );
        if let Ok(Err(why)) = open(None) {
            assert!(OidnReport::Missing(why).line().contains("--oidn FILE"));
        }
    }
}
