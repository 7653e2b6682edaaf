//! `unbake prepare`: which source, and the account of what was made.

use crate::cli::context::Context;
use crate::error::{Error, Result};
use crate::programs::prepare;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Runs the verb: `what` is `[SOURCE] DIR`, or `rooms SCENE`.
pub(crate) fn run(what: &[PathBuf], out: Option<&Path>, context: &Context) -> Result<()> {
    if let [source, scene] = what
        && source.as_os_str() == prepare::ROOMS
    {
        let made = prepare::write_floor_plan(scene, out.unwrap_or(scene), &context.progress)?;
        return report(&made, out.unwrap_or(scene), context);
    }
    let out = out.ok_or_else(|| {
        Error::Usage("-o SCENE: missing; name the folder that the scene becomes".into())
    })?;
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
    report(&made, out, context)
}

fn report(made: &prepare::Prepared, out: &Path, context: &Context) -> Result<()> {
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
    let mut json = serde_json::to_value(made).map_err(|e| Error::Failed(e.to_string()))?;
    json["out"] = json!(out);
    context.result(&text, &json)
}
