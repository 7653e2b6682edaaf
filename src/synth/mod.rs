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
mod output;
mod pattern;
mod plan;
mod truth;
mod views;

pub use model::{Sky, SurfaceIrradiance, Textured};
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
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Options of `unbake synth`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SynthOptions {
    /// Seed of the floor plan, the colours, the cameras and the noise: the command line's global
    /// `--seed`.
    #[arg(skip = Self::default().seed)]
    #[serde(skip)]
    pub seed: u64,
    /// Rooms in the apartment: living room, bedroom, kitchen, and so on in turn.
    #[arg(long, value_name = "N", default_value_t = Self::default().rooms, help_heading = "Synthetic scene")]
    pub rooms: usize,
    /// Panoramas in all, training and held out.
    #[arg(long, value_name = "N", default_value_t = Self::default().views, help_heading = "Synthetic scene")]
    pub views: usize,
    /// How many of the panoramas are held out.
    #[arg(long, value_name = "N", default_value_t = Self::default().test_views, help_heading = "Synthetic scene")]
    pub test_views: usize,
    /// Width of a panorama in pixels; its height is half of it.
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().width, help_heading = "Synthetic scene")]
    pub width: usize,
    /// Samples per pixel; up to 8 times as many where reflections are noisy. Diffuse light, shared
    /// by all views, takes 3 times as many per texel.
    #[arg(long, value_name = "N", default_value_t = Self::default().spp, help_heading = "Synthetic scene")]
    pub spp: u32,
    /// Side of the ground-truth textures in texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().texture, help_heading = "Synthetic scene")]
    pub texture: usize,
    /// Leave the images as rendered, with their noise: every pixel samples its own light.
    #[arg(long, help_heading = "Synthetic scene")]
    pub no_denoise: bool,
    /// Follow every path to its end instead of taking diffuse light from irradiance known on the
    /// surfaces: slower, unbiased but for the denoising.
    #[arg(long, help_heading = "Synthetic scene")]
    pub full_paths: bool,
    /// Give every surface roughness 1: a room without any highlight.
    #[arg(long, help_heading = "Synthetic scene")]
    pub diffuse: bool,
    /// Also write the truth as a solution, gt/solution, for `unbake relight OUT --against`.
    #[arg(long, help_heading = "Synthetic scene")]
    pub truth: bool,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            rooms: 3,
            views: 40,
            test_views: 16,
            width: 1024,
            spp: 8,
            texture: 2048,
            no_denoise: false,
            full_paths: false,
            diffuse: false,
            truth: false,
        }
    }
}

impl SynthOptions {
    /// A setting for tests and quick looks: one small room's worth of pictures in about ten
    /// seconds.
    #[must_use]
    pub fn small() -> Self {
        Self {
            rooms: 1,
            views: 6,
            test_views: 2,
            width: 256,
            spp: 8,
            texture: 512,
            ..Self::default()
        }
    }

    fn validate(&self) -> Result<()> {
        let wrong = |what: &str| Err(Error::Usage(format!("synth: {what}")));
        if !(1..=64).contains(&self.rooms) {
            return wrong("--rooms must be from 1 to 64");
        }
        if self.views == 0 || self.views > 10_000 {
            return wrong("--views must be from 1 to 10000");
        }
        if self.test_views >= self.views {
            return wrong(
                "--test-views must be smaller than --views: at least one view is needed for training",
            );
        }
        if !(16..=16_384).contains(&self.width) || !self.width.is_multiple_of(2) {
            return wrong("--width must be an even number from 16 to 16384");
        }
        if self.spp == 0 || self.spp > 1 << 20 {
            return wrong("--spp must be from 1 to 1048576");
        }
        if !(64..=16_384).contains(&self.texture) {
            return wrong("--texture must be from 64 to 16384");
        }
        Ok(())
    }
}

/// What [`generate`] made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SynthSummary {
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Charts of its atlas.
    pub charts: usize,
    /// Texels of the ground-truth texture per metre.
    pub texels_per_metre: f32,
    /// Training views.
    pub train_views: usize,
    /// Held-out views.
    pub test_views: usize,
    /// Classes that occur.
    pub classes: usize,
    /// Median over all pixels of the luminance.
    pub median_radiance: f32,
}

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

/// Makes an apartment and writes its scene folder (design §1.1), whole or not at all.
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
