//! Error against time of every estimator, and of the pipeline's own bake with all that belongs to
//! it.
//!
//! Errors are taken at a fixed random subset of the texels that some view sees, against 16,384
//! hemisphere rays per texel (and a quarter as many emitter samples) with another seed. Times of
//! the plain estimators are scaled up from runs of neighbouring texels; the pipeline's bake is run
//! whole, because its filter looks at neighbours.

use super::fixture::relative_errors;
use super::{BenchScene, timed};
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::irradiance::{Estimator, IrradianceOptions};
use crate::pipeline::{SolveOptions, reconstruct_light};
use glam::Vec3;
use serde::Serialize;

/// Samples per texel of the reference.
const REFERENCE: u32 = 16_384;

/// One point of a curve.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorPoint {
    /// Curve: `uniform`, `cosine`, `mis`, `pipeline`, `unfiltered`, `oidn`, `nirf` or `target
    /// RATIO`.
    pub curve: String,
    /// Hemisphere rays per texel asked for; 0 where a target chose them.
    pub rays: u32,
    /// Emitter samples per texel asked for; 0 where a target chose them.
    pub emitter_samples: u32,
    /// Rays per texel really traced, on average.
    pub rays_per_texel: f64,
    /// Seconds for the whole texture.
    pub seconds: f64,
    /// Whether `seconds` was measured on the whole texture (false: scaled up from a part).
    pub measured_whole: bool,
    /// √(Σ‖E−E'‖²/Σ‖E'‖²).
    pub relative_rmse: f64,
    /// Median over texels of ‖E−E'‖/‖E'‖.
    pub median_relative_error: f64,
}

/// A bake of the whole texture.
pub(super) struct WholeBake {
    /// Curve that it belongs to.
    pub curve: String,
    /// Hemisphere rays and emitter samples per texel asked for; 0 where a target chose them.
    pub samples: [u32; 2],
    /// Rays traced.
    pub rays: u64,
    /// Texels they were traced for.
    pub texels: usize,
    /// Seconds it took.
    pub seconds: f64,
}

impl WholeBake {
    /// Its point, from the irradiance that it gives the reference's texels.
    pub(super) fn point(self, value: &[Vec3], reference: &Reference) -> ErrorPoint {
        let (relative_rmse, median_relative_error) = relative_errors(value, &reference.value);
        ErrorPoint {
            curve: self.curve,
            rays: self.samples[0],
            emitter_samples: self.samples[1],
            rays_per_texel: self.rays as f64 / self.texels.max(1) as f64,
            seconds: self.seconds,
            measured_whole: true,
            relative_rmse,
            median_relative_error,
        }
    }
}

/// The reference irradiance.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Reference {
    /// Samples per texel.
    pub samples: u32,
    /// Texels.
    pub texels: usize,
    /// Seconds it took.
    pub seconds: f64,
    /// Relative RMSE of a uniform bake with as many rays against it: how far two unbiased
    /// references agree.
    pub uniform_relative_rmse: f64,
    /// Mean of that bake relative to the reference's, less one: a systematic difference between the
    /// estimators.
    pub uniform_mean_difference: f64,
    /// Texel indices.
    #[serde(skip)]
    pub ids: Vec<usize>,
    /// E per texel.
    #[serde(skip)]
    pub value: Vec<Vec3>,
}

impl Reference {
    /// The values of the reference's texels among those of all texels.
    pub(super) fn at_ids(&self, values: &[Vec3]) -> Vec<Vec3> {
        self.ids.iter().map(|&i| values[i]).collect()
    }

    /// The values of the reference's texels among those of all cells of the texture.
    pub(super) fn at_cells(&self, texels: &Texels, values: &[Vec3]) -> Vec<Vec3> {
        let cell = |&i: &usize| values[texels.cell[i] as usize];
        self.ids.iter().map(cell).collect()
    }
}

/// Bakes the reference at `count` texels that some view sees.
#[must_use]
pub(super) fn reference(
    ground: &BenchScene,
    texels: &Texels,
    count: usize,
    progress: &Progress,
) -> Reference {
    let seen = ground.surface.seen(texels);
    let ids = ground.sample(texels, |i| seen[i] && texels.interior[i], count);
    let options = IrradianceOptions {
        estimator: Estimator::Mis,
        rays: REFERENCE,
        emitter_samples: REFERENCE / 4,
        seed: ground.options.seed ^ 0x4e_fe4e,
        drawn: [0, 0],
    };
    let (baked, seconds) = timed(|| ground.bake_some(texels, &ids, &options, progress));
    let uniform = IrradianceOptions {
        estimator: Estimator::Uniform,
        emitter_samples: 0,
        ..options
    };
    let check = ground.bake_some(texels, &ids, &uniform, progress).value;
    let sum = |v: &[Vec3]| {
        v.iter()
            .map(|e| f64::from(crate::core::math::luminance(*e)))
            .sum::<f64>()
    };
    Reference {
        samples: REFERENCE,
        texels: ids.len(),
        seconds,
        uniform_relative_rmse: relative_errors(&check, &baked.value).0,
        uniform_mean_difference: sum(&check) / sum(&baked.value).max(f64::MIN_POSITIVE) - 1.0,
        ids,
        value: baked.value,
    }
}

/// One estimator at one sample count: error at the reference's texels, time from `runs`.
fn plain_point(
    ground: &BenchScene,
    texels: &Texels,
    reference: &Reference,
    runs: &[usize],
    options: &IrradianceOptions,
) -> ErrorPoint {
    let value = ground
        .bake_some(texels, &reference.ids, options, &Progress::silent())
        .value;
    let (baked, seconds) = timed(|| ground.bake_some(texels, runs, options, &Progress::silent()));
    let (relative_rmse, median_relative_error) = relative_errors(&value, &reference.value);
    let curve = match options.estimator {
        Estimator::Uniform => "uniform",
        Estimator::Cosine => "cosine",
        Estimator::Mis => "mis",
    };
    ErrorPoint {
        curve: curve.to_owned(),
        rays: options.rays,
        emitter_samples: options.emitter_samples,
        rays_per_texel: baked.rays as f64 / runs.len().max(1) as f64,
        seconds: seconds * texels.len() as f64 / runs.len().max(1) as f64,
        measured_whole: false,
        relative_rmse,
        median_relative_error,
    }
}

/// The ladders of the three estimators; `runs` texels are timed per point.
#[must_use]
pub(super) fn ladders(
    ground: &BenchScene,
    texels: &Texels,
    reference: &Reference,
    runs: usize,
    full: bool,
    progress: &Progress,
) -> Vec<ErrorPoint> {
    let base = IrradianceOptions {
        seed: ground.options.seed,
        ..IrradianceOptions::default()
    };
    let uniform: &[u32] = if full {
        &[32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16_384]
    } else {
        &[64, 256, 1024, 2048, 8192, 16_384]
    };
    let cosine: &[u32] = if full {
        &[32, 64, 128, 256, 512, 1024, 2048, 4096]
    } else {
        &[64, 256, 1024, 2048]
    };
    let mis: &[u32] = if full {
        &[8, 16, 32, 64, 128, 256, 512, 1024, 2048]
    } else {
        &[16, 64, 256, 1024]
    };
    let mut all: Vec<IrradianceOptions> = Vec::new();
    for &rays in uniform {
        all.push(IrradianceOptions {
            estimator: Estimator::Uniform,
            rays,
            emitter_samples: 0,
            ..base.clone()
        });
    }
    for &rays in cosine {
        all.push(IrradianceOptions {
            estimator: Estimator::Cosine,
            rays,
            emitter_samples: 0,
            ..base.clone()
        });
    }
    for &rays in mis {
        all.push(IrradianceOptions {
            estimator: Estimator::Mis,
            rays,
            emitter_samples: rays / 4,
            ..base.clone()
        });
    }
    all.iter()
        .map(|options| {
            // many rays per texel need fewer texels for the same certainty of the time
            let ids = ground.runs(
                texels,
                (runs * 256 / options.rays as usize).clamp(512, texels.len()),
            );
            progress.advance(1);
            plain_point(ground, texels, reference, &ids, options)
        })
        .collect()
}

/// The pipeline's bake of the whole texture with first-round samples `rays` and `emitter_samples`.
#[must_use]
pub(super) fn pipeline_point(
    ground: &BenchScene,
    texels: &Texels,
    reference: &Reference,
    [rays, emitter_samples]: [u32; 2],
    progress: &Progress,
) -> ErrorPoint {
    // few samples in as few rounds as `--budget` would take them
    let most = ground.options.irradiance_rounds;
    let irradiance_rounds =
        crate::pipeline::rounds_worth(most, |_| f64::from(rays + emitter_samples));
    let options = SolveOptions {
        irradiance_rays: rays,
        emitter_samples,
        irradiance_rounds,
        ..ground.options.clone()
    };
    let (baked, seconds) = timed(|| {
        crate::pipeline::bake_irradiance_texels(
            &ground.surface,
            &ground.light.field,
            &ground.light.emitters,
            texels,
            &options,
            progress,
        )
    });
    let bake = WholeBake {
        curve: "pipeline".to_owned(),
        samples: [rays, emitter_samples],
        rays: baked.rays,
        texels: texels.len(),
        seconds,
    };
    bake.point(&reference.at_ids(&baked.value), reference)
}

/// The bake that `unbake solve --target-error` chooses: the error it reaches, and the time of all
/// of the light's stages.
#[must_use]
pub(super) fn target_point(
    ground: &BenchScene,
    reference: &Reference,
    target: f32,
    progress: &Progress,
) -> ErrorPoint {
    let options = SolveOptions {
        target_error: Some(target),
        ..ground.options.clone()
    };
    let (light, seconds) = timed(|| reconstruct_light(&ground.surface, &options, progress));
    let bake = WholeBake {
        curve: format!("target {target}"),
        samples: [0, 0],
        rays: light.rays,
        texels: light.texels.len(),
        seconds,
    };
    let value = reference.at_cells(&light.texels, &light.irradiance.data);
    bake.point(&value, reference)
}

/// Seconds at which a curve reaches `error`, by straight lines between its points in the logarithms
/// of both; with its first point's time if already that is good enough. `None` if the curve never
/// gets there.
#[must_use]
pub(super) fn seconds_to_reach(points: &[&ErrorPoint], error: f64) -> Option<f64> {
    let mut sorted: Vec<_> = points
        .iter()
        .filter(|p| p.relative_rmse > 0.0 && p.seconds > 0.0)
        .collect();
    sorted.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let first = sorted.iter().position(|p| p.relative_rmse <= error)?;
    let end = sorted[first];
    let Some(start) = first.checked_sub(1).map(|i| sorted[i]) else {
        return Some(end.seconds);
    };
    let t = (start.relative_rmse / error).ln() / (start.relative_rmse / end.relative_rmse).ln();
    Some((start.seconds.ln() + t * (end.seconds / start.seconds).ln()).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(seconds: f64, relative_rmse: f64) -> ErrorPoint {
        ErrorPoint {
            curve: "test".into(),
            rays: 1,
            emitter_samples: 0,
            rays_per_texel: 1.0,
            seconds,
            measured_whole: false,
            relative_rmse,
            median_relative_error: relative_rmse,
        }
    }

    #[test]
    fn time_to_an_error_follows_the_power_law_between_points() {
        let (a, b) = (point(1.0, 0.1), point(100.0, 0.01));
        let reach = |e| seconds_to_reach(&[&b, &a], e);
        assert!((reach(0.1f64 / 10f64.sqrt()).expect("between") - 10.0).abs() < 1e-9);
        assert_eq!(reach(0.5), Some(1.0));
        assert_eq!(reach(0.001), None);
    }
}
