//! `unbake synth`.

use crate::cli::context::Context;
use crate::error::Result;
use crate::programs::synth::generate;
use serde_json::json;
use std::path::Path;
use std::time::Duration;

pub(crate) fn synthesise(out: &Path, context: &Context) -> Result<()> {
    let mut options = context.config.synth.clone();
    options.seed = context.config.seed.unwrap_or(options.seed);
    let made = generate(&options, out, &context.progress)?;
    let run = context.run.recorder.record();
    let text = format!(
        "{}: {} triangles, {} classes, {} training and {} held-out panoramas of {}x{}, {:.0} true texels per metre, in {}\n",
        out.display(),
        made.triangles,
        made.classes,
        made.train_views,
        made.test_views,
        options.width,
        options.width / 2,
        made.texels_per_metre,
        crate::cli::progress::seconds(Duration::from_secs_f64(run.wall_seconds)),
    );
    context.result(&text, &json!({"out": out, "scene": made, "run": run}))
}
