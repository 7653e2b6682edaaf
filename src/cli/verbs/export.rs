//! `unbake export`.

use crate::cli::context::Context;
use crate::cli::frames::FrameSource;
use crate::cli::inputs::read_solution;
use crate::error::Result;
use serde_json::json;
use std::path::Path;

/// `unbake export`.
pub(crate) fn export(out: &Path, places: &FrameSource, context: &Context) -> Result<()> {
    let options = &context.config.export;
    let solution = read_solution(out, &context.progress)?;
    let cameras = places.frames(out, &options.frames, &solution, context)?;
    let (folder, _lock) = places.folder(out, "export")?;
    let files = context.progress.stage("exporting", 1, |_| {
        crate::programs::export::export(&folder, &solution, &cameras, &options.formats)
    })?;
    let text = format!("{}: {}\n", folder.display(), files.join(" "));
    context.result(&text, &json!({"folder": folder, "files": files}))
}
