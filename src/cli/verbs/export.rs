//! `unbake export`.

use super::super::Context;
use super::super::frames::Places;
use super::super::inputs::read_solution;
use crate::error::Result;
use crate::export::ExportOptions;
use crate::render::FrameOptions;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

/// Options of `unbake export`: the formats, and the cameras that go with them.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExportVerb {
    /// Formats.
    #[command(flatten)]
    pub formats: ExportOptions,
    /// Cameras.
    #[command(flatten)]
    pub frames: FrameOptions,
}

/// `unbake export`.
pub(in crate::cli) fn export(out: &Path, places: &Places, context: &Context) -> Result<()> {
    let options = &context.config.export;
    let solution = read_solution(out, &context.progress)?;
    let cameras = places.frames(&options.frames, &solution, context)?;
    let folder = places.to.clone().unwrap_or_else(|| out.join("export"));
    let files = context.progress.stage("exporting", 1, |_| {
        crate::export::export(&folder, &solution, &cameras, &options.formats)
    })?;
    let text = format!("{}: {}\n", folder.display(), files.join(" "));
    context.result(&text, &json!({"folder": folder, "files": files}))
}
