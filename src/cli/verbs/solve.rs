//! `unbake solve`.

use crate::alignment::{Alignment, align};
use crate::cli::context::Context;
use crate::cli::guard::keep_inputs;
use crate::cli::inputs::read_scene;
use crate::cli::run_record::{record, run_key};
use crate::error::{Error, Result};
use crate::pipeline::{Checkpoints, reconstruct};
use crate::programs::report::{Reported, RunRecord, hash_inputs, write_report};
use crate::render::{HybridOptions, HybridRenderer};
use crate::scene::Scene;
use crate::solution::{AsideFolder, OutputLock, SaveOptions, Solution};
use crate::verdict::{AlignmentVerdict, Findings, Verdict};
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// A run that wrote its result.
pub(super) struct SolvedRun {
    /// What `manifest.json` says.
    pub record: RunRecord,
    /// What to think of it.
    pub verdict: Verdict,
    /// Sizes, time and verdict for people.
    text: String,
}

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
    let generation = progress.stage("writing the textures", 1, |_| {
        solution.save(out, &SaveOptions::default())
    })?;
    let verdict = findings.verdict();
    let mut record = record(&scene, inputs, context)?;
    record.generation = generation;
    record.findings = Some(findings);
    record.alignment = Some(alignment);
    progress.stage("report", 1, |_| {
        // one sample per pixel is enough for pictures of this size; `unbake eval` renders at full
        // quality
        let renderer = HybridRenderer::new(
            &solution,
            HybridOptions {
                supersampling: 1,
                ..HybridOptions::default()
            },
        )?;
        let reported = Reported {
            scene: &scene,
            solution: &solution,
            record: &record,
            evaluation: None,
        };
        write_report(out, reported, &renderer, Vec::new())
    })?;
    record.measure(&context.recorder);
    record.write_manifest(out)?;
    options.checkpoints.finish();
    let s = &solution;
    let text = format!(
        "albedo {}x{}, roughness {}x{}, irradiance {}x{} in {} ({:.2} GiB at most, {} threads)\n{} lights in lights.json\nreport: {}\n{verdict}\n",
        s.albedo.width,
        s.albedo.height,
        s.roughness.width,
        s.roughness.height,
        s.irradiance.width,
        s.irradiance.height,
        crate::cli::progress::seconds(Duration::from_secs_f64(record.wall_seconds)),
        record.peak_bytes as f64 / (1u64 << 30) as f64,
        record.machine.threads,
        s.lamps.len(),
        out.join("report.html").display()
    );
    Ok(SolvedRun {
        record,
        verdict,
        text,
    })
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
