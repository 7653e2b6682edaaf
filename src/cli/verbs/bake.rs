//! `unbake bake`.

use crate::cli::context::Context;
use crate::core::lock::OutputLock;
use crate::error::Result;
use crate::programs::bake::{BakeJob, bake_file};
use crate::programs::run::{keep_inputs, keep_results};
use serde_json::json;
use std::path::{Path, PathBuf};

/// `unbake bake`.
pub(crate) fn bake(scene: &Path, out: &Path, context: &Context) -> Result<()> {
    let options = &context.config.bake;
    let inputs: Vec<PathBuf> = std::iter::once(scene.to_path_buf())
        .chain(options.environment.clone())
        .collect();
    keep_inputs(out, scene, &inputs)?;
    keep_results(out)?;
    let _lock = OutputLock::acquire(out, &[])?;
    let job = BakeJob {
        scene,
        options,
        seed: context.seed(),
    };
    let (record, files) = bake_file(&job, out, &context.progress)?;
    for note in &record.notes {
        context.progress.note(note);
    }
    let text = format!(
        "{}: {} of {} x {} texels, {:.0} per metre ({}), {} paths per texel, error {:.2} % of the mean (halves {:.2} %)\n",
        out.display(),
        files.join(" "),
        record.layout.size,
        record.layout.size,
        record.layout.texels_per_metre,
        match record.layout.charts {
            Some(charts) => format!("own layout, {charts} charts"),
            None => "the file's layout".into(),
        },
        record.samples,
        100.0 * record.error,
        100.0 * record.error_of_halves,
    );
    context.result(&text, &json!({"out": out, "files": files, "bake": record}))
}
