//! Pictures of a solution from cameras, in the photographed light (by either renderer) or in changed
//! light (by the path tracer). Called by `unbake render`, `relight` and the Python module.

use super::{
    Adaptive, EditableScene, HybridOptions, HybridRenderer, Lighting, NamedCamera, Noise,
    PathTracedScene, PathTracerOptions, RelightOptions, RenderOptions, Renderer, Show,
    TraceSettings, ViewRenderer,
};
use crate::core::image::RgbPlane;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::solution::Solution;
use std::time::Instant;

impl RenderOptions {
    /// Whether numbers are in range, and the renderer can do what is asked.
    ///
    /// # Errors
    /// Numbers that are not, with the range; what only the other renderer does.
    pub fn validate(&self) -> Result<()> {
        if self.supersampling == 0 || self.supersampling > 16 || self.samples == 0 {
            return Err(Error::Usage(
                "--supersampling must be from 1 to 16, and --samples at least 1".into(),
            ));
        }
        let other = |option: &str, is: &str| {
            let message = format!("{option} is of --renderer {is}; leave out one of them");
            Err(Error::Usage(message))
        };
        match self.renderer {
            Renderer::Path if self.show != Show::Light => other("--show", "hybrid"),
            Renderer::Hybrid if self.diffuse_only => other("--diffuse-only", "path"),
            Renderer::Hybrid if self.flat => other("--flat", "path"),
            _ => Ok(()),
        }
    }

    /// What is given and has no effect with this renderer, in words.
    #[must_use]
    pub fn without_effect(&self) -> Option<&'static str> {
        let usual = Self::default();
        match self.renderer {
            Renderer::Path if self.supersampling != usual.supersampling => {
                Some("--supersampling is of --renderer hybrid: the path renderer takes --samples")
            }
            Renderer::Hybrid if self.samples != usual.samples => {
                Some("--samples is of --renderer path: the hybrid renderer takes --supersampling")
            }
            _ => None,
        }
    }

    /// Renders frames one after another; `done(i, image, seconds)` takes each, linear RGB in the unit of
    /// the photographs (or what `show` says), with the time it took after all preparation.
    ///
    /// # Errors
    /// Numbers out of range, Embree cannot be used, what `done` returns.
    pub fn render(
        &self,
        solution: &Solution,
        cameras: &[NamedCamera],
        seed: u64,
        progress: &Progress,
        mut done: impl FnMut(usize, &RgbPlane, f64) -> Result<()>,
    ) -> Result<()> {
        self.validate()?;
        if self.renderer == Renderer::Path {
            let world = EditableScene::new(solution);
            let stage = progress.stage("preparing", 1, |_| PathTracedScene::new(&world))?;
            let settings = self.tracing(seed);
            let mut clock = Instant::now();
            let timed = |i, image: &RgbPlane| {
                done(i, image, clock.elapsed().as_secs_f64())?;
                clock = Instant::now();
                Ok(())
            };
            return stage.render(cameras, &settings, progress, |_, _| Ok(()), timed);
        }
        let options = HybridOptions {
            supersampling: self.supersampling,
            denoise: !self.no_denoise,
            seed,
            ..HybridOptions::default()
        };
        let renderer =
            progress.stage("preparing", 1, |_| HybridRenderer::new(solution, options))?;
        progress.stage("rendering", cameras.len() as u64, |p| {
            cameras.iter().enumerate().try_for_each(|(i, c)| {
                let clock = Instant::now();
                let view = renderer.render(&c.camera)?;
                let seconds = clock.elapsed().as_secs_f64();
                done(i, &self.show.of(view), seconds)?;
                p.advance(1);
                Ok(())
            })
        })
    }

    /// How the path renderer traces.
    fn tracing(&self, seed: u64) -> TraceSettings {
        TraceSettings {
            tracer: PathTracerOptions {
                seed,
                lambertian: self.diffuse_only,
                flat: self.flat,
                ..PathTracerOptions::default()
            },
            goal: Adaptive {
                first: self.samples,
                most: self.samples,
                error: 0.0,
                noise: Noise::Reflected,
            },
            denoise: !self.no_denoise,
        }
    }
}

impl RelightOptions {
    /// How a relit world is traced.
    ///
    /// # Errors
    /// Numbers out of range.
    pub fn tracing(&self, seed: u64) -> Result<TraceSettings> {
        if self.samples < 2
            || self.max_samples < self.samples
            || self.error.is_nan()
            || self.error < 0.0
        {
            return Err(Error::Usage(
                "--samples must be at least 2, --max-samples not less, --error not negative".into(),
            ));
        }
        Ok(TraceSettings {
            tracer: PathTracerOptions {
                seed,
                ..PathTracerOptions::default()
            },
            goal: Adaptive {
                first: self.samples,
                most: self.max_samples,
                error: self.error,
                noise: Noise::Reflected,
            },
            denoise: !self.no_denoise,
        })
    }
}

impl Lighting {
    /// The solution in this light.
    ///
    /// # Errors
    /// A lamp is named that does not exist; the panorama cannot be read.
    pub fn world<'s>(&self, solution: &'s Solution) -> Result<EditableScene<'s>> {
        let mut world = EditableScene::new(solution);
        self.apply(&mut world, &solution.lamps)?;
        Ok(world)
    }
}
