//! `unbake check`.

use crate::cli::context::Context;
use crate::error::{Error, Result};
use crate::programs::run;
use std::path::Path;

pub(crate) fn check_scene(path: &Path, context: &Context) -> Result<u8> {
    let (load, alignment) = (&context.config.scene, &context.config.alignment);
    let checked = run::check_scene(path, load, alignment, &context.progress);
    let json = serde_json::to_value(&checked).map_err(|e| Error::Failed(format!("check: {e}")))?;
    context.result(&checked.to_string(), &json)?;
    Ok(checked.report.exit_code())
}
