//! Options of the verbs that make pictures.

use super::{Exposure, NamedCamera};
use crate::scene::Split;
use serde::{Deserialize, Serialize};

/// Which renderer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Renderer {
    /// Irradiance texture plus traced specular reflection: fast, the photographed light.
    #[default]
    Hybrid,
    /// Every path followed: slower, consistent with what `relight` shows.
    Path,
}

/// What a frame shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Show {
    /// The lit scene.
    #[default]
    Light,
    /// The surfaces' albedo.
    Albedo,
    /// The surfaces' roughness, as grey.
    Roughness,
    /// The surfaces' share of metal, as grey.
    Metal,
    /// The share of light that panes let through, as grey.
    Transmission,
    /// What the surfaces emit.
    Emission,
}

impl Show {
    /// The wanted picture of a view.
    #[must_use]
    pub fn of(self, view: super::RenderedView) -> crate::core::image::RgbPlane {
        let grey = |p: &crate::core::image::Plane<f32>| p.map(|v| glam::Vec3::splat(*v));
        match self {
            Self::Light => view.radiance,
            Self::Albedo => view.albedo,
            Self::Roughness => grey(&view.roughness),
            Self::Metal => grey(&view.metallic),
            Self::Transmission => grey(&view.transmission),
            Self::Emission => view.emission,
        }
    }
}

/// Which of a scene's views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Views {
    /// Training views.
    Train,
    /// Held-out views.
    #[default]
    Test,
    /// All views.
    All,
}

impl Views {
    /// The split, if it is one.
    #[must_use]
    pub fn split(self) -> Option<Split> {
        match self {
            Self::Train => Some(Split::Train),
            Self::Test => Some(Split::Test),
            Self::All => None,
        }
    }
}

/// A film made of the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Video {
    /// Pictures only.
    #[default]
    None,
    /// H.264 in MP4, by ffmpeg.
    Mp4,
    /// VP9 in WebM, by ffmpeg.
    Webm,
}

/// Which frames, how large, how bright, how stored.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Frames")]
pub struct FrameOptions {
    /// Width in pixels; 0 keeps the cameras' own.
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().width)]
    pub width: usize,
    /// Height in pixels of pinhole frames made by --fov; 0 is 9/16 of the width.
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().height)]
    pub height: usize,
    /// Horizontal angle of view: turns every camera into a pinhole camera that looks where it does;
    /// 0 keeps its projection.
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().fov)]
    pub fov: f32,
    /// Which of the scene's views, where --scene gives the cameras.
    #[arg(long, value_enum, default_value = "test")]
    #[serde(alias = "split")]
    pub views: Views,
    /// Frames of a smooth path through the given cameras, in their order; 0 renders the cameras
    /// themselves.
    #[arg(long, value_name = "FRAMES", default_value_t = Self::default().path)]
    pub path: usize,
    /// Brightness of the PNG pictures: "auto" (one value for all frames, from the first) or stops.
    #[arg(long, value_name = "STOPS", default_value_t = Self::default().exposure, allow_negative_numbers = true)]
    pub exposure: Exposure,
    /// Also make a film, with ffmpeg if it is installed.
    #[arg(long, value_enum, default_value = "none")]
    pub video: Video,
    /// Frames per second of the film.
    #[arg(long, value_name = "N", default_value_t = Self::default().fps)]
    pub fps: u32,
    /// Leave out the EXR files: pictures only.
    #[arg(long)]
    pub no_exr: bool,
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            width: 0,
            height: 0,
            fov: 0.0,
            views: Views::Test,
            path: 0,
            exposure: Exposure::Auto,
            video: Video::None,
            fps: 24,
            no_exr: false,
        }
    }
}

/// Largest side of a frame.
const MOST_PIXELS: usize = 16_384;

impl FrameOptions {
    /// The cameras of the frames.
    ///
    /// # Errors
    /// Sizes and angles out of range; no camera.
    pub fn frames(&self, given: Vec<NamedCamera>) -> crate::Result<Vec<NamedCamera>> {
        let usage = |m: String| Err(crate::Error::Usage(m));
        if self.width > MOST_PIXELS || self.height > MOST_PIXELS {
            return usage(format!(
                "--width {} --height {}: at most {MOST_PIXELS} pixels",
                self.width, self.height
            ));
        }
        if self.fov != 0.0 && !(1.0..=170.0).contains(&self.fov) {
            return usage(format!(
                "--fov {}: expected 1 to 170 degrees, or 0 to keep the cameras' projection",
                self.fov
            ));
        }
        if self.fps == 0 || self.fps > 1000 {
            return usage(format!("--fps {}: expected 1 to 1000", self.fps));
        }
        let cameras = if self.path > 0 {
            super::smooth_path(&given, self.path)
        } else {
            given
        };
        if cameras.is_empty() {
            return usage(
                "there is no camera to render from: the file or the split of the scene is empty"
                    .into(),
            );
        }
        let sized = |c: NamedCamera| match (self.fov > 0.0, self.width) {
            (true, w) => {
                let w = if w > 0 { w } else { c.camera.width };
                c.pinhole(
                    w,
                    if self.height > 0 {
                        self.height
                    } else {
                        (w * 9 / 16).max(1)
                    },
                    self.fov,
                )
            }
            (false, 0) => c,
            (false, w) => c.with_width(w),
        };
        Ok(cameras.into_iter().map(sized).collect())
    }
}

/// Options of `unbake render`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct RenderOptions {
    /// How light is computed.
    #[arg(long, value_enum, default_value = "hybrid")]
    pub renderer: Renderer,
    /// What the frames show (hybrid renderer); of materials each pixel has those of the class that most of
    /// it shows.
    #[arg(long, value_enum, default_value = "light")]
    pub show: Show,
    /// Primary rays per pixel along each axis, and four times as many specular rays (hybrid
    /// renderer); 1 is the fast setting.
    #[arg(long, value_name = "N", default_value_t = Self::default().supersampling)]
    pub supersampling: u32,
    /// Paths per pixel (path renderer).
    #[arg(long, value_name = "N", default_value_t = Self::default().samples)]
    pub samples: u32,
    /// Leave the noise as it is: of every reflection (path renderer), of rough reflections (hybrid
    /// renderer).
    #[arg(long)]
    pub no_denoise: bool,
    /// Leave out specular reflection (path renderer).
    #[arg(long)]
    pub diffuse_only: bool,
    /// Shade with the triangles' own normals (path renderer): for comparison with other programs.
    #[arg(long)]
    pub flat: bool,
    /// Frames.
    #[command(flatten)]
    pub frames: FrameOptions,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            renderer: Renderer::Hybrid,
            show: Show::Light,
            supersampling: 1,
            samples: 64,
            no_denoise: false,
            diffuse_only: false,
            flat: false,
            frames: FrameOptions::default(),
        }
    }
}
