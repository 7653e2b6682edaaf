//! `unbake check`.

use crate::cli::context::Context;
use crate::error::{Error, Result};
use crate::scene::check;
use std::path::Path;

pub(crate) fn check_scene(path: &Path, context: &Context) -> Result<u8> {
    let report = context.progress.stage("checking the scene", 1, |_| {
        check(path, &context.config.scene)
    });
    let json = serde_json::to_value(&report).map_err(|e| Error::Failed(format!("check: {e}")))?;
    context.result(&report.to_string(), &json)?;
    Ok(report.exit_code())
}
