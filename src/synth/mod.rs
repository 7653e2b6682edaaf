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

pub use model::{Sky, SurfaceIrradiance, Textured};
pub use options::{SynthOptions, SynthSummary};
pub use truth::true_solution;

use crate::error::{Error, Result};
use crate::geometry::Camera;
use crate::image::RgbPlane;
use crate::progress::Progress;
use crate::render::denoise::{Purpose, denoise};
use crate::render::{
    Adaptive, Frame, IndirectCache, KnownLight, Noise, PathTracer, PathTracerOptions,
};
use crate::trace::EmbreeTracer;
use glam::Vec3;
use lightmap::Lightmap;
use std::path::Path;

fn does_not_fit(apartment: &apartment::Apartment, options: &SynthOptions) -> Error {
    Error::Usage(format!(
        "synth: {} surfaces do not fit a texture of {}; pass a larger --texture",
        apartment.charts.len(),
        options.texture
    ))
}

/// The sky above every apartment.
fn sky(apartment: &apartment::Apartment) -> Sky {
    Sky {
        horizon: Vec3::new(4.6, 4.9, 5.2),
        zenith: Vec3::new(5.6, 6.6, 8.4),
        ground: Vec3::new(1.3, 1.4, 1.0),
        portals: apartment.portals.clone(),
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
    let writer = output::FolderWriter::new(out_folder)?;
    let mut apartment = apartment::Apartment::new(options.seed, options.rooms);
    if options.diffuse {
        apartment
            .paints
            .iter_mut()
            .for_each(pattern::Paint::make_matte);
    }
    let atlas = atlas::Atlas::pack(&apartment.charts, options.texture)
        .ok_or_else(|| does_not_fit(&apartment, options))?;
    let mesh = atlas.mesh(&apartment.charts);
    let texture = progress.stage("painting textures", 1, |_| {
        atlas.paint(&apartment.charts, &apartment.paints)
    });
    let views = views::place(&apartment, options)?;
    progress.note(format!(
        "{} rooms, {} triangles, {} charts at {:.0} texels per metre",
        options.rooms,
        mesh.triangles.len(),
        apartment.charts.len(),
        atlas.density
    ));
    let tracer = EmbreeTracer::new(&mesh)?;
    let surfaces = Textured::new(&mesh, &apartment.charts, &texture);
    let sky = sky(&apartment);
    let settings = PathTracerOptions {
        samples: options.spp,
        seed: options.seed,
        ..PathTracerOptions::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &surfaces, &sky, settings);
    // the cache is worth as much care as the pixels, up to what its nodes can resolve
    let effort = (options.spp as f32 / 8.0).clamp(0.2, 2.0);
    let cache = (!options.full_paths).then(|| {
        let cache = SurfaceIrradiance::new(&mesh);
        progress.stage("caching irradiance", cache.steps(), |p| {
            cache.bake(&mesh, &tracer, &renderer, effort, p)
        })
    });
    let shared = cache.as_ref().filter(|_| !options.no_denoise);
    let size = lightmap::side(&atlas, options.width);
    let lightmap = shared.map(|c| {
        Lightmap::bake(
            &mesh,
            &tracer,
            &renderer,
            c,
            (size, options.spp as f32 / 8.0),
            progress,
        )
    });
    let known = match &lightmap {
        Some(map) => KnownLight {
            first: Some(map),
            later: Some(map),
        },
        None => KnownLight {
            first: None,
            later: cache.as_ref().map(|c| c as &dyn IndirectCache),
        },
    };
    let pixels = views
        .iter()
        .map(|v| (v.camera.width * v.camera.height) as u64)
        .sum();
    let mut luminances = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    progress.stage("rendering panoramas", pixels, |p| -> Result<()> {
        for (i, view) in views.iter().enumerate() {
            let (frame, image) = photograph(&renderer, &view.camera, i as u64, known, options, p)?;
            luminances.extend(
                image
                    .data
                    .iter()
                    .step_by(61)
                    .map(|&c| crate::math::luminance(c)),
            );
            seen.extend(frame.label.data.iter().copied().filter(|&l| l != 0));
            writer.view(&view.stem, &frame, &image)?;
        }
        Ok(())
    })?;
    luminances.sort_by(f32::total_cmp);
    writer.scene(&output::Described {
        options,
        apartment: &apartment,
        mesh: &mesh,
        texture: &texture,
        views: &views,
    })?;
    if options.truth {
        true_solution(options)?.save(
            &writer.path("gt/solution"),
            &crate::solution::SaveOptions::default(),
        )?;
    }
    let summary = SynthSummary {
        triangles: mesh.triangles.len(),
        charts: apartment.charts.len(),
        texels_per_metre: atlas.density,
        train_views: views.iter().filter(|v| !v.held_out).count(),
        test_views: views.iter().filter(|v| v.held_out).count(),
        classes: seen.len(),
        median_radiance: luminances.get(luminances.len() / 2).copied().unwrap_or(0.0),
    };
    writer.finish(&summary)?;
    Ok(summary)
}
