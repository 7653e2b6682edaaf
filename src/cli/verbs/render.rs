//! `unbake render`.

use crate::cli::context::Context;
use crate::cli::frames::{FrameSource, report, traced};
use crate::cli::inputs::read_solution;
use crate::error::{Error, Result};
use crate::programs::export::FrameWriter;
use crate::render::{
    Adaptive, EditableScene, HybridOptions, HybridRenderer, Noise, PathTracedScene,
    PathTracerOptions, Renderer, TraceSettings, ViewRenderer,
};
use std::path::Path;
use std::time::Instant;

/// `unbake render`.
pub(crate) fn render(out: &Path, places: &FrameSource, context: &Context) -> Result<()> {
    let options = context.config.render.clone();
    let progress = &context.progress;
    if options.supersampling == 0 || options.supersampling > 16 || options.samples == 0 {
        return Err(Error::Usage(
            "--supersampling must be from 1 to 16, and --samples at least 1".into(),
        ));
    }
    let solution = read_solution(out, progress)?;
    let cameras = places.frames(out, &options.frames, &solution, context)?;
    let (folder, _lock) = places.folder(out, "render")?;
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let mut seconds = Vec::new();
    let mut clock = Instant::now();
    match options.renderer {
        Renderer::Hybrid => {
            let hybrid = HybridOptions {
                supersampling: options.supersampling,
                denoise: !options.no_denoise,
                seed: context.seed(),
                ..HybridOptions::default()
            };
            let renderer =
                progress.stage("preparing", 1, |_| HybridRenderer::new(&solution, hybrid))?;
            progress.stage("rendering", cameras.len() as u64, |p| -> Result<()> {
                for c in &cameras {
                    clock = Instant::now();
                    let view = renderer.render(&c.camera)?;
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&c.name, &options.show.of(view))?;
                    p.advance(1);
                }
                Ok(())
            })?;
        }
        Renderer::Path => {
            let world = EditableScene::new(&solution);
            let stage = progress.stage("preparing", 1, |_| PathTracedScene::new(&world))?;
            let tracer = PathTracerOptions {
                seed: context.seed(),
                lambertian: options.diffuse_only,
                flat: options.flat,
                ..PathTracerOptions::default()
            };
            let goal = Adaptive {
                first: options.samples,
                most: options.samples,
                error: 0.0,
                noise: Noise::Reflected,
            };
            let settings = TraceSettings {
                tracer,
                goal,
                denoise: !options.no_denoise,
            };
            clock = Instant::now();
            stage.render(
                &traced(&cameras),
                &settings,
                progress,
                |_, _| Ok(()),
                |i, image| {
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&cameras[i].name, image)?;
                    clock = Instant::now();
                    Ok(())
                },
            )?;
        }
    }
    report(&writer, &options.frames, &folder, &seconds, context)
}
