//! `unbake solve`.

use super::result::{RunResult, SolvedRun};
use crate::alignment::{Alignment, align};
use crate::cli::context::Context;
use crate::cli::guard::keep_inputs;
use crate::cli::inputs::read_scene;
use crate::cli::run_record::run_key;
use crate::core::lock::OutputLock;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::pipeline::{Checkpoints, SolveOptions, reconstruct};
use crate::programs::report::{InputFile, hash_inputs};
use crate::scene::Scene;
use crate::solution::{AsideFolder, Solution};
use crate::verdict::{AlignmentVerdict, Findings};
use serde_json::json;
use std::path::Path;

pub(crate) fn solve(scene_path: &Path, out: &Path, context: &Context) -> Result<()> {
    say(&solve_into(scene_path, out, context)?, out, context)
}

/// Prints what was solved.
pub(super) fn say(run: &SolvedRun, out: &Path, context: &Context) -> Result<()> {
    context.result(
        &run.text,
        &json!({"out": out, "run": run.record, "verdict": run.verdict}),
    )
}

/// Solves a scene, writes the result and prints nothing.
pub(super) fn solve_into(scene_path: &Path, out: &Path, context: &Context) -> Result<SolvedRun> {
    let mut job = Job::read(scene_path, out, context)?;
    // before the long run: is there a place for the result, and is it ours alone?
    let _lock = OutputLock::acquire(out, &[])?;
    drop(AsideFolder::new(out)?);
    if job.options.budget.is_none() {
        job.options.checkpoints = Checkpoints::new(out, &job.key(context)?);
    }
    let checkpoints = job.options.checkpoints.clone();
    let run = job.solve(&context.progress)?.write(out, context)?;
    checkpoints.finish();
    Ok(run)
}

/// A scene to solve, as read.
pub(super) struct Job {
    scene: Scene,
    alignment: Alignment,
    inputs: Vec<InputFile>,
    /// The numbers in effect.
    pub(super) options: SolveOptions,
}

/// A solved scene.
pub(super) struct SolvedJob {
    scene: Scene,
    result: RunResult,
}

impl Job {
    /// Reads a scene whose result is to go into `out`.
    pub(super) fn read(scene_path: &Path, out: &Path, context: &Context) -> Result<Self> {
        keep_inputs(out, scene_path, &[])?;
        let (scene, alignment) = aligned_scene(scene_path, context)?;
        keep_inputs(out, &scene.folder, &scene.input_files())?;
        let (seed, started) = (context.seed(), context.recorder.started());
        Ok(Self {
            options: context.config.solve.options(seed, started),
            inputs: hash_inputs(&scene)?,
            scene,
            alignment,
        })
    }

    /// A hash of everything that the result depends on.
    pub(super) fn key(&self, context: &Context) -> Result<String> {
        run_key(&self.inputs, context)
    }

    /// Solves the scene.
    pub(super) fn solve(self, progress: &Progress) -> Result<SolvedJob> {
        let Self {
            mut scene,
            alignment,
            inputs,
            options,
        } = self;
        let solved = reconstruct(&scene, &options, progress)?;
        let (mut solution, mut findings) = (solved.solution, solved.findings);
        take_in(alignment.verdict, &mut findings, &mut solution);
        scene.camera_masks.clone_from(&solution.camera_masks);
        Ok(SolvedJob {
            scene,
            result: RunResult {
                solution,
                findings,
                alignment: Some(alignment),
                inputs,
            },
        })
    }
}

impl SolvedJob {
    /// Writes the result into `out`.
    pub(super) fn write(self, out: &Path, context: &Context) -> Result<SolvedRun> {
        self.result.write(&self.scene, out, context)
    }
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
