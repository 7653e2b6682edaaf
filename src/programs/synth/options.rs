//! What an apartment is made with, and what came of it.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

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
    /// Paper the walls: a pale pattern that covers a tenth of them.
    #[arg(long, help_heading = "Synthetic scene")]
    pub wallpaper: bool,
    /// Add fittings of metal, classes of their own: tap and hood in the kitchen, mirrors in living
    /// room and bedroom, brass handles, planters and table tops. Their truth is `gt/metallic`; `gt/albedo` has there what
    /// they reflect at normal incidence.
    #[arg(long, help_heading = "Synthetic scene")]
    pub fittings: bool,
    /// Add panes of clear glass, classes of their own: a closed glass door in every doorway, a screen on
    /// feet in the living room. Their truth is `gt/transmission`; `gt/albedo` has there their tint.
    #[arg(long, help_heading = "Synthetic scene")]
    pub panes: bool,
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
            wallpaper: false,
            fittings: false,
            panes: false,
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

    pub(super) fn validate(&self) -> Result<()> {
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
        if self.fittings && self.diffuse {
            return wrong(
                "--fittings and --diffuse exclude each other: metal is all highlight; leave one out",
            );
        }
        if self.panes && self.diffuse {
            return wrong(
                "--panes and --diffuse exclude each other: a pane without its reflection is no pane; leave one out",
            );
        }
        if !(64..=16_384).contains(&self.texture) {
            return wrong("--texture must be from 64 to 16384");
        }
        Ok(())
    }
}

/// What [`super::generate`] made.
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
