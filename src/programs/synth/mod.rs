//! Synthetic apartments with ground truth: the paper's synthetic data set in kind, made on the
//! spot.
//!
//! Rooms in a row with doorways, windows, furniture and lamps; every surface has a known albedo and
//! roughness texture under the paper's reflection model, so that a reconstruction is limited by
//! evidence and noise and not by the model. Panoramas are rendered by
//! [`crate::render::PathTracer`]: diffuse light is sampled and filtered once on the surfaces and
//! shown by all views (`lightmap.rs`); reflections are sampled per pixel, more where they are
//! noisy, and filtered only where the surface's roughness blurs them anyway, since roughness is
//! measured from them. The same seed gives the same bits for any number of threads.

mod apartment;
mod atlas;
mod catalogue;
mod charts;
mod furniture;
mod glb;
mod lightmap;
mod model;
mod options;
mod output;
mod pattern;
mod plan;
mod truth;
mod views;

pub use glb::glb as mesh_glb;
pub use model::{Sky, SurfaceIrradiance, Textured};
pub use options::{SynthOptions, SynthSummary};
pub use truth::true_solution;

use crate::core::geometry::{Camera, Mesh};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::trace::EmbreeTracer;
use crate::error::{Error, Result};
use crate::render::denoise::{Purpose, denoise};
use crate::render::{
    Adaptive, Frame, IndirectCache, KnownLight, Noise, PathTracer, PathTracerOptions,
};
use glam::{Vec3, Vec4};
use lightmap::{Lightmap, LightmapQuality};
use std::collections::BTreeSet;
use std::path::Path;

fn does_not_fit(apartment: &apartment::Apartment, options: &SynthOptions) -> Error {
    Error::Usage(format!(
        "synth: {} surfaces do not fit a texture of {}; pass a larger --texture",
        apartment.charts.len(),
        options.texture
    ))
}

/// The sky above every apartment.
fn sky() -> Sky {
    Sky {
        horizon: Vec3::new(4.6, 4.9, 5.2),
        zenith: Vec3::new(5.6, 6.6, 8.4),
        ground: Vec3::new(1.3, 1.4, 1.0),
    }
}

/// Largest factor on `--spp` where highlights are noisy.
const MOST: u32 = 8;
/// Standard error of the specular part, relative to the brightness around, at which a block of
/// pixels has samples enough.
const HIGHLIGHT_NOISE: f32 = 0.03;

/// What the path tracer knows of a view, and the picture made of it.
fn photograph(
    renderer: &PathTracer<'_>,
    camera: &Camera,
    key: u64,
    known: KnownLight<'_>,
    options: &SynthOptions,
    progress: &Progress,
) -> Result<(Frame, RgbPlane)> {
    if options.no_denoise {
        let frame = renderer.render_with(camera, key, known, progress);
        let image = frame.radiance();
        return Ok((frame, image));
    }
    let goal = Adaptive {
        first: options.spp,
        most: options.spp.saturating_mul(MOST),
        error: HIGHLIGHT_NOISE,
        noise: Noise::Specular,
    };
    let frame = renderer.render_adaptive(camera, key, &goal, known, progress, |_, _| Ok(()))?;
    let image = denoise(&frame, camera, Purpose::Measuring);
    Ok((frame, image))
}

/// An apartment packed into its atlas, meshed and painted: what is photographed.
struct Built {
    apartment: apartment::Apartment,
    atlas: atlas::Atlas,
    mesh: Mesh,
    /// Albedo (x, y, z) and roughness (w).
    texture: Plane<Vec4>,
    /// Share of metal, where there is any.
    metallic: Option<Plane<f32>>,
    /// Share of transmitted light, where there are panes.
    transmission: Option<Plane<f32>>,
}

impl Built {
    fn new(options: &SynthOptions, progress: &Progress) -> Result<Self> {
        let apartment = apartment::Apartment::new(options);
        let atlas = atlas::Atlas::pack(&apartment.charts, options.texture)
            .ok_or_else(|| does_not_fit(&apartment, options))?;
        let mesh = atlas.mesh(&apartment.charts);
        let texture = progress.stage("painting textures", 1, |_| {
            atlas.paint(&apartment.charts, &apartment.paints)
        });
        let metallic = options.fittings.then(|| atlas.metal(&apartment.charts));
        let transmission = options.panes.then(|| atlas.transmission(&apartment.charts));
        Ok(Self {
            apartment,
            atlas,
            mesh,
            texture,
            metallic,
            transmission,
        })
    }

    fn note(&self) -> String {
        format!(
            "{} rooms, {} triangles, {} charts at {:.0} texels per metre",
            self.apartment.rooms.len(),
            self.mesh.triangles.len(),
            self.apartment.charts.len(),
            self.atlas.density
        )
    }
}

/// Diffuse light computed once for all views, as far as the options allow.
struct SharedLight<'a> {
    cache: Option<SurfaceIrradiance>,
    lightmap: Option<Lightmap<'a>>,
}

impl<'a> SharedLight<'a> {
    fn bake(
        renderer: &PathTracer<'a>,
        atlas: &atlas::Atlas,
        options: &SynthOptions,
        progress: &Progress,
    ) -> Self {
        // the cache is worth as much care as the pixels, up to what its nodes can resolve
        let effort = (options.spp as f32 / 8.0).clamp(0.2, 2.0);
        let cache = (!options.full_paths).then(|| {
            let cache = SurfaceIrradiance::new(renderer.mesh());
            progress.stage("caching irradiance", cache.steps(), |p| {
                cache.bake(renderer.mesh(), renderer.tracer(), renderer, effort, p)
            })
        });
        let quality = LightmapQuality {
            side: lightmap::side(atlas, options.width),
            effort: options.spp as f32 / 8.0,
        };
        let lightmap = cache
            .as_ref()
            .filter(|_| !options.no_denoise)
            .map(|c| Lightmap::bake(renderer, c, quality, progress));
        Self { cache, lightmap }
    }

    fn known(&self) -> KnownLight<'_> {
        match &self.lightmap {
            Some(map) => KnownLight {
                first: Some(map),
                later: Some(map),
            },
            None => KnownLight {
                first: None,
                later: self.cache.as_ref().map(|c| c as &dyn IndirectCache),
            },
        }
    }
}

/// What the photographs show.
struct Photographed {
    /// Labels that occur in them, without 0.
    classes: BTreeSet<u16>,
    /// Median luminance of a subset of their pixels.
    median_radiance: f32,
}

/// Renders all views and writes them.
fn photograph_all(
    built: &Built,
    views: &[views::SynthView],
    options: &SynthOptions,
    writer: &output::FolderWriter,
    progress: &Progress,
) -> Result<Photographed> {
    let tracer = EmbreeTracer::new(&built.mesh)?;
    let surfaces = Textured::new(&built.mesh, &built.apartment.charts, &built.texture);
    let sky = sky();
    let settings = PathTracerOptions {
        samples: options.spp,
        seed: options.seed,
        ..PathTracerOptions::default()
    };
    let renderer = PathTracer::new(&built.mesh, &tracer, &surfaces, &sky, settings);
    let light = SharedLight::bake(&renderer, &built.atlas, options, progress);
    let pixels = views
        .iter()
        .map(|v| (v.camera.width * v.camera.height) as u64)
        .sum();
    let mut luminances = Vec::new();
    let mut classes = BTreeSet::new();
    progress.stage("rendering panoramas", pixels, |p| -> Result<()> {
        for (i, view) in views.iter().enumerate() {
            let known = light.known();
            let (frame, image) = photograph(&renderer, &view.camera, i as u64, known, options, p)?;
            luminances.extend(image.data.iter().step_by(61).map(|&c| luminance(c)));
            classes.extend(frame.label.data.iter().copied().filter(|&l| l != 0));
            writer.view(&view.stem, &frame, &image)?;
        }
        Ok(())
    })?;
    luminances.sort_by(f32::total_cmp);
    Ok(Photographed {
        classes,
        median_radiance: luminances.get(luminances.len() / 2).copied().unwrap_or(0.0),
    })
}

/// Makes an apartment and writes its scene folder (docs/scene-format.md), whole or not at all.
///
/// # Errors
/// If an option is out of range, or the folder cannot be written to.
pub fn generate(
    options: &SynthOptions,
    out_folder: &Path,
    progress: &Progress,
) -> Result<SynthSummary> {
    options.validate()?;
    let writer = output::FolderWriter::new(out_folder, options)?;
    let built = Built::new(options, progress)?;
    let views = views::place(&built.apartment, options)?;
    progress.note(built.note());
    let photographed = photograph_all(&built, &views, options, &writer, progress)?;
    writer.scene(&output::Described {
        options,
        apartment: &built.apartment,
        mesh: &built.mesh,
        texture: &built.texture,
        metallic: built.metallic.as_ref(),
        transmission: built.transmission.as_ref(),
        views: &views,
    })?;
    if options.truth {
        built.solution().save(
            &writer.path("gt/solution"),
            &crate::solution::SaveOptions::default(),
        )?;
    }
    let summary = SynthSummary {
        triangles: built.mesh.triangles.len(),
        charts: built.apartment.charts.len(),
        texels_per_metre: built.atlas.density,
        train_views: views.iter().filter(|v| !v.held_out).count(),
        test_views: views.iter().filter(|v| v.held_out).count(),
        classes: photographed.classes.len(),
        median_radiance: photographed.median_radiance,
    };
    writer.finish(&summary)?;
    Ok(summary)
}
