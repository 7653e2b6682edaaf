//! `unbake solve`.

use super::result::{RunResult, SolvedRun};
use crate::alignment::{Alignment, align};
use crate::cli::context::Context;
use crate::cli::guard::keep_inputs;
use crate::cli::inputs::read_scene;
use crate::cli::run_record::run_key;
use crate::error::{Error, Result};
use crate::pipeline::{Checkpoints, reconstruct};
use crate::programs::report::hash_inputs;
use crate::scene::Scene;
use crate::solution::{AsideFolder, OutputLock, Solution};
use crate::verdict::{AlignmentVerdict, Findings};
use serde_json::json;
use std::path::Path;

pub(crate) fn solve(scene_path: &Path, out: &Path, context: &Context) -> Result<()> {
    let run = solve_into(scene_path, out, context)?;
    context.result(
        &run.text,
        &json!({"out": out, "run": run.record, "verdict": run.verdict}),
    )
}

/// Solves a scene, writes the result and prints nothing.
pub(super) fn solve_into(scene_path: &Path, out: &Path, context: &Context) -> Result<SolvedRun> {
    keep_inputs(out, scene_path, &[])?;
    let (mut scene, alignment) = aligned_scene(scene_path, context)?;
    keep_inputs(out, &scene.folder, &scene.input_files())?;
    // before the long run: is there a place for the result, and is it ours alone?
    let _lock = OutputLock::acquire(out, &[])?;
    drop(AsideFolder::new(out)?);
    let options = context
        .config
        .solve
        .options(context.seed(), context.recorder.started());
    let progress = &context.progress;
    let inputs = hash_inputs(&scene)?;
    let mut options = options;
    if options.budget.is_none() {
        options.checkpoints = Checkpoints::new(out, &run_key(&inputs, context)?);
    }
    let solved = reconstruct(&scene, &options, progress)?;
    let (mut solution, mut findings) = (solved.solution, solved.findings);
    take_in(alignment.verdict, &mut findings, &mut solution);
    scene.camera_masks.clone_from(&solution.camera_masks);
    let result = RunResult {
        scene: &scene,
        solution,
        findings,
        alignment: Some(alignment),
        inputs,
    };
    let run = result.write(out, context)?;
    options.checkpoints.finish();
    Ok(run)
}

/// Adds what the alignment says to the findings and, if the scene was forced through although
/// nothing fits, to the stated errors of the albedo.
fn take_in(fits: AlignmentVerdict, findings: &mut Findings, solution: &mut Solution) {
    let stated = findings.model_error();
    findings.alignment = Some(fits);
    if fits == AlignmentVerdict::Misaligned {
        let more = findings.model_error().powi(2) - stated.powi(2);
        let more = more.max(0.0).sqrt() as f32;
        let observed = solution.confidence.data.iter_mut().filter(|c| c.x < 1e3);
        observed.for_each(|c| c.x = c.x.hypot(more));
    }
}

/// The scene, corrected if it was asked for; a scene whose photographs and mesh do not fit is
/// refused.
fn aligned_scene(path: &Path, context: &Context) -> Result<(Scene, Alignment)> {
    let mut scene = read_scene(path, context)?;
    let options = &context.config.alignment;
    let alignment = context
        .progress
        .stage("testing the alignment", 1, |_| align(&mut scene, options))?;
    context.progress.note(alignment.to_string());
    match alignment.problem() {
        Some(problem) if !options.force => Err(Error::input(path, problem)),
        _ => Ok((scene, alignment)),
    }
}
