//! `unbake view`.

use crate::cli::context::Context;
use crate::cli::inputs::read_solved_scene;
use crate::error::{Error, Result};
use crate::programs::report::RunRecord;
use crate::programs::view;
use crate::solution::Solution;
use serde_json::json;
use std::path::Path;

pub(crate) fn view_in_browser(
    out: &Path,
    scene_path: Option<&Path>,
    context: &Context,
) -> Result<()> {
    let solution = context
        .progress
        .stage("reading the solution", 1, |_| Solution::load(out))?;
    let scene = scene_path
        .map(|path| read_solved_scene(path, out, context))
        .transpose()?;
    let manifest = RunRecord::of_result(out)?;
    let content = context.progress.stage("preparing the page", 1, |_| {
        view::Content::new(solution, scene, manifest.as_ref()).map(|c| c.kept_in(out))
    })?;
    let options = &context.config.view;
    let server = view::server(content, options)?;
    if !options.bind.is_loopback() {
        context.progress.note(format!(
            "listening on {}: other machines can read this scene",
            options.bind
        ));
    }
    let (url, stopper) = (server.url(), server.stopper());
    ctrlc::set_handler(move || {
        // asked twice: do not wait for what is still running
        if stopper.stop() {
            std::process::exit(130);
        }
    })
    .map_err(|e| Error::Failed(format!("cannot listen for Ctrl-C: {e}")))?;
    context.result(&format!("{url}\nCtrl-C ends it.\n"), &json!({"url": url}))?;
    if !options.no_open {
        view::open_in_browser(&url);
    }
    server.run();
    Ok(())
}
