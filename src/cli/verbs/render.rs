//! `unbake render`.

use crate::Result;
use crate::cli::context::Context;
use crate::cli::frames::{FrameSource, report};
use crate::cli::inputs::read_solution;
use crate::programs::export::FrameWriter;
use std::path::Path;
use std::time::Instant;

/// `unbake render`.
pub(crate) fn render(out: &Path, places: &FrameSource, context: &Context) -> Result<()> {
    let options = &context.config.render;
    let progress = &context.progress;
    options.validate()?;
    let solution = read_solution(out, progress)?;
    let cameras = places.frames(out, &options.frames, &solution, context)?;
    let (folder, _lock) = places.folder(out, "render")?;
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let mut seconds = Vec::new();
    let mut clock = Instant::now();
    options.render(&solution, &cameras, context.seed(), progress, |i, image| {
        seconds.push(clock.elapsed().as_secs_f64());
        writer.write(&cameras[i].name, image)?;
        clock = Instant::now();
        Ok(())
    })?;
    report(&writer, &options.frames, &folder, &seconds, context)
}
