//! `unbake prepare`: which source, and the account of what was made.

use crate::cli::context::Context;
use crate::error::{Error, Result};
use crate::programs::prepare;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Runs the verb: `what` is `[SOURCE] DIR`.
pub(crate) fn run(what: &[PathBuf], out: &Path, context: &Context) -> Result<()> {
    let (source, dir) = match what {
        [dir] => (None, dir),
        [source, dir] => (Some(source.to_string_lossy().into_owned()), dir),
        _ => {
            return Err(Error::Usage(
                "name the capture's folder: `unbake prepare [SOURCE] DIR -o SCENE`".into(),
            ));
        }
    };
    let options = &context.config.prepare;
    let made = prepare::prepare(source.as_deref(), dir, out, options, &context.progress)?;
    let mut text = format!(
        "{}: {} frames, {} triangles, {} rooms from {}\n",
        out.display(),
        made.frames,
        made.triangles,
        made.rooms,
        made.kind
    );
    for note in &made.notes {
        text += &format!("  {note}\n");
    }
    let mut json = serde_json::to_value(&made).map_err(|e| Error::Failed(e.to_string()))?;
    json["out"] = json!(out);
    context.result(&text, &json)
}
