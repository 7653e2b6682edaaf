//! The scene as the irradiance bake meets it: surface, light field and emitters made by the
//! pipeline's own stages.

use crate::Result;
use crate::core::progress::Progress;
use crate::core::sampling::KeyedRng;
use crate::core::texture::Texels;
use crate::core::trace::Tracer;
use crate::irradiance::Bake;
use crate::irradiance::{Irradiance, IrradianceOptions, bake_irradiance};
use crate::lights::LitScene;
use crate::observed::Surface;
use crate::pipeline::{Light, SolveOptions, reconstruct_light};
use crate::scene::Scene;
use glam::Vec3;

/// Texels per run: the bake's own chunk, so that a sample of runs costs what the same texels cost
/// in a whole bake.
const RUN: usize = 256;

/// Everything the benchmarks of lighting need.
pub struct BenchScene<'a> {
    /// Mesh, views and tracer.
    pub surface: Surface<'a>,
    /// Radiance field and emitters; its own irradiance is not used.
    pub light: Light,
    /// The options the pipeline would run with.
    pub options: SolveOptions,
}

impl<'a> BenchScene<'a> {
    /// Observes the scene and finds its light. The irradiance that comes with it is baked with two
    /// rays per texel and thrown away: emitters and radiance depend on the coarse bake alone.
    ///
    /// # Errors
    /// Unreadable or unusable images and labels.
    pub fn prepare(scene: &'a Scene, options: &SolveOptions, progress: &Progress) -> Result<Self> {
        let surface = crate::pipeline::observe(scene, options, progress)?;
        let cheap = SolveOptions {
            irradiance_rays: 2,
            emitter_samples: 0,
            irradiance_filter: false,
            ..options.clone()
        };
        let light = reconstruct_light(&surface, &cheap, progress);
        Ok(Self {
            surface,
            light,
            options: options.clone(),
        })
    }

    /// The bake's inputs, with rays going through `tracer`.
    #[must_use]
    pub fn bake<'b>(&'b self, tracer: &'b dyn Tracer) -> Bake<'b> {
        let lit = self.surface.lit(&self.light.field, &self.light.emitters);
        LitScene { tracer, ..lit }.into()
    }

    /// Bakes the texels `ids`.
    #[must_use]
    pub fn bake_some(
        &self,
        texels: &Texels,
        ids: &[usize],
        options: &IrradianceOptions,
        progress: &Progress,
    ) -> Irradiance {
        let receiver = |k: usize| self.surface.receiver(texels, ids[k]);
        bake_irradiance(
            &self.bake(&self.surface.tracer),
            ids.len(),
            receiver,
            options,
            progress,
        )
    }

    /// Runs of neighbouring texels spread at random over the texture, about `count` texels in all.
    #[must_use]
    pub fn runs(&self, texels: &Texels, count: usize) -> Vec<usize> {
        let all = texels.len().div_ceil(RUN).max(1);
        let wanted = count.div_ceil(RUN).clamp(1, all);
        let mut rng = KeyedRng::new(self.options.seed, 0xb0b5);
        let mut order: Vec<usize> = (0..all).collect();
        for k in 0..wanted {
            let j = k + rng.below(all - k);
            order.swap(k, j);
        }
        order[..wanted]
            .iter()
            .flat_map(|r| r * RUN..((r + 1) * RUN).min(texels.len()))
            .collect()
    }

    /// At most `count` different texels drawn at random from those that `admissible` allows, in
    /// ascending order.
    #[must_use]
    pub fn sample(
        &self,
        texels: &Texels,
        admissible: impl Fn(usize) -> bool,
        count: usize,
    ) -> Vec<usize> {
        let mut all: Vec<usize> = (0..texels.len()).filter(|&i| admissible(i)).collect();
        let n = count.min(all.len());
        let mut rng = KeyedRng::new(self.options.seed, 0x5a3b1e);
        for k in 0..n {
            let j = k + rng.below(all.len() - k);
            all.swap(k, j);
        }
        all.truncate(n);
        all.sort_unstable();
        all
    }
}

/// Relative error of energy √(Σ‖E−E'‖²/Σ‖E'‖²), and the median over texels of ‖E−E'‖/‖E'‖ (texels
/// without light left out).
#[must_use]
pub(super) fn relative_errors(value: &[Vec3], reference: &[Vec3]) -> (f64, f64) {
    let (mut error, mut energy) = (0.0f64, 0.0f64);
    let mut each = Vec::with_capacity(value.len());
    for (v, r) in value.iter().zip(reference) {
        let (d, e) = (
            f64::from((*v - *r).length_squared()),
            f64::from(r.length_squared()),
        );
        error += d;
        energy += e;
        if e > 0.0 {
            each.push((d / e).sqrt());
        }
    }
    (
        (error / energy.max(f64::MIN_POSITIVE)).sqrt(),
        super::median(&mut each),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_known_values() {
        let reference = [
            Vec3::new(3.0, 4.0, 0.0),
            Vec3::new(0.0, 0.0, 1.0),
            Vec3::ZERO,
        ];
        let value = [
            Vec3::new(3.0, 4.0, 0.5),
            Vec3::new(0.0, 0.0, 1.2),
            Vec3::ZERO,
        ];
        let (rmse, middle) = relative_errors(&value, &reference);
        assert!((rmse - ((0.25 + 0.04) / 26.0f64).sqrt()).abs() < 1e-7);
        assert!(
            (middle - 0.15).abs() < 1e-7,
            "between 0.1 and 0.2: {middle}"
        );
    }
}
