//! Stage "specular images": what every pixel's surface mirrors, to be taken out of the photographs.

use super::{Highlights, Light, Roughness, SolveOptions};
use crate::core::image::RgbPlane;
use crate::core::progress::Progress;
use crate::observed::{ClassMap, Surface, filled};
use crate::specular::{Reflector, SpecularImages, WideRule};

/// The specular part of every view.
pub struct Reflections {
    /// Specular radiance at the pixels of each view.
    pub images: Vec<RgbPlane>,
    /// Rays traced.
    pub rays: u64,
}

/// Traces the specular part of every view.
#[must_use]
pub fn trace_reflections(
    surface: &Surface,
    light: &Light,
    highlights: &Highlights,
    roughness: &Roughness,
    options: &SolveOptions,
    progress: &Progress,
) -> Reflections {
    let lit = surface.lit(&light.field, &light.emitters);
    let classes = ClassMap::new(surface, &light.emissive);
    let reflectance = &roughness.reflectance;
    let plane = filled(&surface.texels, &reflectance.roughness);
    let images = SpecularImages {
        surface,
        classes: &classes,
        roughness: &plane,
        irradiance: &light.irradiance,
        lobes: &reflectance.lobes,
        wide: WideRule {
            switch: options.matte,
            matte: &highlights.matte,
        },
    };
    let specular_rays = match &options.budget {
        Some(budget) => budget.specular_rays(images.traced_pixels(), progress),
        None => options.specular_rays,
    };
    let reflector = Reflector {
        lit: &lit,
        rays_per_lobe: specular_rays,
        emitter_samples: specular_rays.div_ceil(2),
        model: reflectance.model,
        seed: options.seed ^ 0x51ec,
    };
    progress.stage("specular images", surface.views.len() as u64, |p| {
        let trace = |view: usize| {
            let traced = images.trace(&reflector, view);
            p.advance(1);
            traced
        };
        let traced = p.share(surface.views.len(), 1, |views| {
            views.map(trace).collect::<Vec<_>>()
        });
        let traced = traced.into_iter().flatten();
        let mut out = Reflections {
            images: Vec::with_capacity(surface.views.len()),
            rays: 0,
        };
        for view in traced {
            out.images.push(view.image);
            out.rays += view.rays;
        }
        out
    })
}
