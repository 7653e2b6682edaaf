//! Path-traced frames of a world: the same for `render --renderer path` and `relight`.

use super::denoise::{self, Purpose};
use super::path_tracer::Frame;
use super::{
    Adaptive, EditableScene, FrameOptions, IndirectCache, KnownLight, NamedCamera, Noise,
    PathTracer, PathTracerOptions,
};
use crate::Result;
use crate::core::geometry::{Camera, Mesh};
use crate::core::image::{RgbPlane, Wrap};
use crate::core::progress::Progress;
use crate::core::trace::EmbreeTracer;
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Options of `unbake relight`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct RelightOptions {
    /// Paths that every pixel gets at least.
    #[arg(long, value_name = "N", default_value_t = Self::default().samples)]
    pub samples: u32,
    /// Paths that no pixel exceeds.
    #[arg(long, value_name = "N", default_value_t = Self::default().max_samples)]
    pub max_samples: u32,
    /// Relative standard error, before denoising, at which a part of the picture is done.
    #[arg(long, value_name = "RATIO", default_value_t = Self::default().error)]
    pub error: f32,
    /// Leave the noise as it is.
    #[arg(long)]
    pub no_denoise: bool,
    /// First pictures of all views by the light operator of OUT, which is made if need be: diffuse
    /// light at once, few rays for reflections. Path tracing refines them. Not for lamps moved or
    /// added, other panoramas, --day.
    #[arg(long)]
    pub preview: bool,
    /// Lamps to switch off, as numbers of --list-lamps: "1,3" or "all".
    #[arg(long, value_name = "LIST", default_value_t = Self::default().off)]
    pub off: String,
    /// Factor on every lamp.
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().lamps)]
    pub lamps: f32,
    /// Light from outside: "keep", "off", a constant "R,G,B", or a panorama file (EXR, HDR).
    #[arg(long, value_name = "LIGHT", default_value_t = Self::default().environment)]
    pub environment: String,
    /// Frames of a day from midnight to midnight, from the first camera: sun and sky outside, lamps
    /// after dark; 0 = no sweep.
    #[arg(long, value_name = "FRAMES", default_value_t = Self::default().day)]
    pub day: usize,
    /// Frames.
    #[command(flatten)]
    pub frames: FrameOptions,
}

impl Default for RelightOptions {
    fn default() -> Self {
        Self {
            samples: 32,
            max_samples: 256,
            error: 0.1,
            no_denoise: false,
            preview: false,
            off: String::new(),
            lamps: 1.0,
            environment: "keep".into(),
            day: 0,
            frames: FrameOptions::default(),
        }
    }
}

/// How a world is traced.
#[derive(Clone, Copy, Debug)]
pub struct TraceSettings {
    /// Path tracer.
    pub tracer: PathTracerOptions,
    /// Samples.
    pub goal: Adaptive,
    /// Whether to filter the noise.
    pub denoise: bool,
}

impl TraceSettings {
    /// The picture of a frame.
    fn finished(&self, frame: &Frame, camera: &Camera) -> RgbPlane {
        if self.denoise {
            denoise::denoise(frame, camera, Purpose::Viewing)
        } else {
            frame.radiance()
        }
    }
}

/// Paths per pixel of a preview, which follow reflections alone. Derived: what the denoiser wants to
/// tell noise from detail.
const PREVIEW_PATHS: u32 = 8;

/// An irradiance texture as light known on surfaces.
struct IrradianceTexture<'a> {
    mesh: &'a Mesh,
    irradiance: &'a RgbPlane,
}

impl IndirectCache for IrradianceTexture<'_> {
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        let size = Vec2::new(self.irradiance.width as f32, self.irradiance.height as f32);
        let at = self.mesh.uv(triangle, u, v) * size;
        self.irradiance.bilinear(at, Wrap::Clamp)
    }
}

/// A world with its ray structure, ready for any number of frames.
pub struct PathTracedScene<'w, 's> {
    world: &'w EditableScene<'s>,
    embree: EmbreeTracer,
}

impl<'w, 's> PathTracedScene<'w, 's> {
    /// Builds the ray structure.
    ///
    /// # Errors
    /// Embree cannot be used.
    pub fn new(world: &'w EditableScene<'s>) -> Result<Self> {
        let embree = EmbreeTracer::new(world.mesh())?;
        Ok(Self { world, embree })
    }

    /// The path tracer of the world.
    fn renderer(&self, options: PathTracerOptions) -> PathTracer<'_> {
        PathTracer::new(
            self.world.mesh(),
            &self.embree,
            self.world,
            self.world,
            options,
        )
        .with_points(self.world.points().to_vec())
    }

    /// The ray structure.
    #[must_use]
    pub fn tracer(&self) -> &EmbreeTracer {
        &self.embree
    }

    /// Renders frames whose diffuse light is a known irradiance texture, by few paths for
    /// reflections; `done(i, image)` sees each.
    ///
    /// # Errors
    /// What the callback returns.
    pub fn preview(
        &self,
        cameras: &[NamedCamera],
        irradiance: &RgbPlane,
        settings: &TraceSettings,
        progress: &Progress,
        mut done: impl FnMut(usize, &RgbPlane) -> Result<()>,
    ) -> Result<()> {
        let renderer = self.renderer(settings.tracer);
        let light = IrradianceTexture {
            mesh: self.world.mesh(),
            irradiance,
        };
        let known = KnownLight {
            first: Some(&light),
            later: Some(&light),
        };
        let goal = Adaptive {
            first: PREVIEW_PATHS,
            most: PREVIEW_PATHS,
            error: 0.0,
            noise: Noise::Specular,
        };
        for (i, NamedCamera { camera, .. }) in cameras.iter().enumerate() {
            let pixels = (camera.width * camera.height) as u64;
            let frame = progress.stage("previewing", pixels, |p| {
                renderer.render_adaptive(camera, i as u64, &goal, known, p, |_, _| Ok(()))
            })?;
            done(i, &settings.finished(&frame, camera))?;
        }
        Ok(())
    }

    /// Renders frames one after another. `refined(i, image)` sees each after every pass, `done(i,
    /// image)` when it is finished.
    ///
    /// # Errors
    /// What the callbacks return.
    pub fn render(
        &self,
        cameras: &[NamedCamera],
        settings: &TraceSettings,
        progress: &Progress,
        mut refined: impl FnMut(usize, &RgbPlane) -> Result<()>,
        mut done: impl FnMut(usize, &RgbPlane) -> Result<()>,
    ) -> Result<()> {
        let renderer = self.renderer(settings.tracer);
        for (i, NamedCamera { name, camera }) in cameras.iter().enumerate() {
            let pixels = (camera.width * camera.height) as u64;
            let frame = progress.stage(&format!("tracing {name}"), pixels, |p| {
                renderer.render_adaptive(
                    camera,
                    i as u64,
                    &settings.goal,
                    KnownLight::default(),
                    p,
                    |pass, frame| {
                        if pass > 0 {
                            Ok(())
                        } else {
                            refined(i, &settings.finished(&frame(), camera))
                        }
                    },
                )
            })?;
            done(i, &settings.finished(&frame, camera))?;
        }
        Ok(())
    }
}
