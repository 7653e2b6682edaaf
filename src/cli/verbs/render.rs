//! `unbake render`.

use crate::Result;
use crate::cli::context::Context;
use crate::cli::frames::{FrameSource, report};
use crate::cli::inputs::read_solution;
use crate::core::image::RgbPlane;
use crate::programs::export::FrameWriter;
use std::path::Path;

/// `unbake render`.
pub(crate) fn render(out: &Path, places: &FrameSource, context: &Context) -> Result<()> {
    let options = &context.config.render;
    let progress = &context.progress;
    options.validate()?;
    if let Some(note) = options.without_effect() {
        progress.note(note);
    }
    let solution = read_solution(out, progress)?;
    let cameras = places.frames(out, &options.frames, &solution, context)?;
    let (folder, _lock) = places.folder(out, "render")?;
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let mut seconds = Vec::new();
    let keep = |i: usize, image: &RgbPlane, took| {
        seconds.push(took);
        writer.write(&cameras[i].name, image)
    };
    options.render(&solution, &cameras, context.seed(), progress, keep)?;
    report(&writer, &options.frames, &folder, &seconds, context)
}
