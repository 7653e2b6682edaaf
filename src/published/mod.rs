//! The method of TexIR as published, for comparison: texture-based light of one view a texel, a
//! uniform bake of irradiance, and three stages of gradient descent on textures (supplement, Secs.
//! A to C; method §7). unbake's own method is elsewhere; nothing of it is used here but geometry
//! and rays.
//!
//! Not reproduced, since they are faults of a rasteriser and not of the method: positions read off
//! a panorama (W4), faces sampled at their edges (W9), the depth buffer's precision (W10).

mod learned_texture;
mod lobe;
mod options;
mod pixels;
mod reflection;
mod stages;
mod tbl;

pub use options::{Correction, PublishedOptions, PublishedStage, PublishedValues};
pub use stages::{Learned, Sides};
pub use tbl::one_view_per_texel;

use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::observed::Surface;
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use learned_texture::MipTexture;
use pixels::{PixelGrid, training_pixels};
use reflection::{Reflector, virtual_highlights};
use stages::{Training, optimise};

/// Median luminance to which the published scenes are exposed: ln(1 + x) of the losses depends on
/// it (derived: method §7.1 multiplies by 2⁵, which brings its rooms near this).
const MEDIAN: f32 = 0.5;

/// What the published method starts from.
pub struct PublishedInput<'a> {
    /// Geometry and photographs.
    pub surface: &'a Surface<'a>,
    /// The light texture.
    pub tbl: &'a RgbPlane,
    /// The light texture as rays meet it.
    pub field: &'a LightField,
    /// The irradiance texture.
    pub irradiance: &'a RgbPlane,
    /// Rooms on the atlas.
    pub rooms: &'a Plane<u16>,
    /// Key of all randomness.
    pub seed: u64,
}

/// Learns albedo and roughness textures from what the views show.
#[must_use]
pub fn learn(
    input: &PublishedInput,
    options: &PublishedOptions,
    sides: Sides,
    progress: &Progress,
) -> Learned {
    let surface = input.surface;
    let median = tbl::median_luminance(surface);
    // a power of two, as the published exposures are
    let exposure = (MEDIAN / median).log2().round().exp2();
    let mut views = progress.stage("training pixels", 1, |_| {
        training_pixels(surface, input.rooms)
    });
    let highlights = progress.stage("virtual highlights", views.len() as u64, |p| {
        all_highlights(input, &views, median, p)
    });
    let lit: usize = highlights.iter().flatten().filter(|l| **l).count();
    let all: usize = views.iter().map(|v| v.pixels.len()).sum();
    progress.note(format!(
        "{:.2} % of the training pixels are virtual highlights",
        100.0 * lit as f64 / all.max(1) as f64
    ));
    for pixel in views.iter_mut().flat_map(|v| &mut v.pixels) {
        pixel.radiance *= exposure;
    }
    let texels = &input.irradiance.data;
    let irradiance = MipTexture::new(
        input.irradiance.width,
        texels.iter().map(|e| (*e * exposure).to_array()).collect(),
    );
    let training = Training {
        views: &views,
        highlights: &highlights,
        irradiance: &irradiance,
        reflector: Reflector {
            tracer: &surface.tracer,
            field: input.field,
            corrected: options.corrects(Correction::W1),
        },
        exposure,
        ceilings: &classes_named(surface, "ceiling"),
        options,
        seed: input.seed,
    };
    optimise(&training, sides, progress)
}

/// Which pixels of every view are virtual highlights.
fn all_highlights(
    input: &PublishedInput,
    views: &[PixelGrid],
    median: f32,
    progress: &Progress,
) -> Vec<Vec<bool>> {
    let surface = input.surface;
    let lights = LightField::new(
        &surface.scene.mesh,
        &surface.orientation,
        SurfaceRadiance::reflected(tbl::lights_only(input.tbl, median)),
        Environment::black(),
    );
    let mirror = Reflector {
        tracer: &surface.tracer,
        field: &lights,
        corrected: false,
    };
    let eroded = classes_named(surface, "floor");
    let of = |grid: &PixelGrid| {
        let found = virtual_highlights(mirror, grid, &eroded);
        progress.advance(1);
        found
    };
    views.iter().map(of).collect()
}

/// Classes whose name contains a word.
fn classes_named(surface: &Surface, word: &str) -> Vec<u16> {
    let classes = surface.scene.classes.iter();
    classes
        .filter(|c| c.name.to_lowercase().contains(word))
        .map(|c| c.id)
        .collect()
}
