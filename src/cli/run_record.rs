//! What is written down of a run: its inputs, options and versions.

use super::context::Context;
use crate::error::{Error, Result};
use crate::programs::report::{InputFile, RunRecord, SceneSummary, Versions};
use crate::scene::Scene;
use serde_json::json;
use std::sync::OnceLock;

/// A hash of everything the result depends on: inputs, options, seed and this very program.
pub(super) fn run_key(inputs: &[InputFile], context: &Context) -> Result<String> {
    let program = program_hash()?;
    let all = json!([
        inputs,
        options_of(context)?,
        context.seed(),
        Versions::current(),
        program
    ]);
    Ok(blake3::hash(all.to_string().as_bytes())
        .to_hex()
        .to_string())
}

/// A hash of this very program, computed once.
fn program_hash() -> Result<&'static str> {
    static HASH: OnceLock<String> = OnceLock::new();
    if let Some(hash) = HASH.get() {
        return Ok(hash);
    }
    let program = std::env::current_exe()
        .and_then(std::fs::read)
        .map_err(|e| Error::Failed(format!("reading this program: {e}")))?;
    let mut hash = blake3::Hasher::new();
    let hash = hash.update_rayon(&program).finalize().to_hex().to_string();
    Ok(HASH.get_or_init(|| hash))
}

/// The options as asked for and in effect.
fn options_of(context: &Context) -> Result<serde_json::Value> {
    let config = serde_json::to_value(&context.config)
        .map_err(|e| Error::Failed(format!("options: {e}")))?;
    let effective = context
        .config
        .solve
        .options(context.seed(), context.recorder.started());
    Ok(json!({
        "scene": config["scene"],
        "alignment": config["alignment"],
        "solve": config["solve"],
        "effective": effective,
    }))
}

/// What has been measured so far, with what is known about the run besides.
pub(super) fn record(
    scene: &Scene,
    inputs: Vec<InputFile>,
    context: &Context,
) -> Result<RunRecord> {
    let options = options_of(context)?;
    Ok(RunRecord {
        command: context.command.clone(),
        versions: Versions::current(),
        scene: SceneSummary::of(scene),
        options,
        seed: context.seed(),
        inputs,
        ..context.recorder.record()
    })
}
