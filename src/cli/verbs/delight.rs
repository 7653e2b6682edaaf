//! `unbake delight`.

use super::solve::say;
use crate::cli::context::Context;
use crate::core::formats::AsideFolder;
use crate::core::lock::OutputLock;
use crate::error::{Error, Result};
use crate::programs::report::hash_inputs;
use crate::programs::run::{RunResult, keep_inputs};
use crate::scene::Scan;
use std::path::Path;

pub(super) fn delight(mesh: &Path, out: &Path, context: &Context) -> Result<()> {
    let config = &context.config;
    let options = context.run.options();
    if options.budget.is_some() || config.scene.memory.is_some() || options.published.is_some() {
        return Err(Error::Usage(
            "delight: --budget, --memory and --quality paper are for photographs; choose --quality draft, standard or high".into(),
        ));
    }
    let scan = context.progress.stage("reading the scan", 1, |_| {
        Scan::load(mesh, &config.scan, &config.scene)
    })?;
    for warning in &scan.scene.warnings {
        context.progress.note(warning);
    }
    keep_inputs(out, mesh, &scan.scene.input_files())?;
    // before the long run: is there a place for the result, and is it ours alone?
    let _lock = OutputLock::acquire(out, &[])?;
    drop(AsideFolder::new(out)?);
    let inputs = hash_inputs(&scan.scene)?;
    let solved = crate::pipeline::delight(&scan, &options, &context.progress)?;
    let result = RunResult {
        solution: solved.solution,
        findings: solved.findings,
        alignment: None,
        inputs,
        options,
    };
    say(&result.write(&scan.scene, out, &context.run)?, out, context)
}
