//! `unbake eval`.

use crate::cli::context::Context;
use crate::cli::inputs::read_solved_scene;
use crate::core::lock::OutputLock;
use crate::error::{Error, Result};
use crate::programs::evaluate::{evaluate, terminal_table};
use crate::programs::report::{self, Photographer, Reported, RunRecord, hash_inputs, write_report};
use crate::programs::run::keep_inputs;
use crate::render::{HybridOptions, HybridRenderer};
use crate::scene::Scene;
use crate::solution::Solution;
use std::path::Path;

pub(crate) fn eval(out: &Path, scene_path: &Path, context: &Context) -> Result<()> {
    let solution = context
        .progress
        .stage("reading the solution", 1, |_| Solution::load(out))?;
    let mut scene = read_solved_scene(scene_path, out, context)?;
    scene.camera_masks.clone_from(&solution.camera_masks);
    if (scene.origin - solution.origin).length() > 1e-6 {
        let message = format!(
            "was reconstructed from a scene centred at {}, but {} is centred at {}; give the scene it was made from",
            solution.origin,
            scene_path.display(),
            scene.origin
        );
        return Err(Error::input(out, message));
    }
    let run = RunRecord::of_result(out)?;
    if let Some(mesh) = run.as_ref().and_then(|run| other_mesh(&scene, run)) {
        context.progress.note(format!(
            "{} was solved with another {mesh} than lies in {}: the scores may compare it with what is not its truth",
            out.display(),
            scene_path.display()
        ));
    }
    keep_inputs(out, &scene.folder, &scene.input_files())?;
    let _lock = OutputLock::acquire(out, &["eval"])?;
    let renderer = HybridRenderer::new(
        &solution,
        HybridOptions {
            seed: context.seed(),
            supersampling: (context.config.eval.supersampling)
                .unwrap_or(HybridOptions::default().supersampling),
            ..HybridOptions::default()
        },
    )?;
    let photographer = Photographer::new(&scene, &solution)?;
    let shown: Vec<&str> = report::shown_views(&scene)
        .iter()
        .map(|v| v.stem.as_str())
        .collect();
    let mut pictures = Vec::new();
    let mut failed = None;
    let evaluation = evaluate(
        &scene,
        &renderer,
        &context.config.eval,
        Some(out),
        &context.progress,
        &mut |seen| {
            if !context.config.eval.no_report && shown.contains(&seen.view.stem.as_str()) {
                match photographer.view(seen.view, seen.rendered, seen.truth) {
                    Ok(view) => pictures.push(view),
                    Err(e) => failed = Some(e),
                }
            }
        },
    )?;
    failed.map_or(Ok(()), Err)?;
    if !context.config.eval.no_report {
        // the report tells of the run that made the solution; without its manifest, of this one
        let record = match run {
            Some(record) => record,
            None => context
                .run
                .record(&scene, hash_inputs(&scene)?, &context.run.options())?,
        };
        context.progress.stage("report", 1, |_| {
            let reported = Reported {
                scene: &scene,
                solution: &solution,
                record: &record,
                evaluation: Some(&evaluation),
            };
            write_report(out, reported, &renderer, pictures)
        })?;
    }
    let json =
        serde_json::to_value(&evaluation).map_err(|e| Error::Failed(format!("scores: {e}")))?;
    context.result(&terminal_table(&evaluation), &json)
}

/// The mesh that a run read, if the scene's file of that name is not the same.
fn other_mesh(scene: &Scene, run: &RunRecord) -> Option<String> {
    let is_mesh = |name: &str| {
        let ending = Path::new(name).extension().and_then(|e| e.to_str());
        ending.is_some_and(|e| ["glb", "gltf", "obj", "ply"].contains(&e))
    };
    let mesh = run.inputs.iter().find(|f| is_mesh(&f.path))?;
    let bytes = std::fs::read(scene.folder.join(&mesh.path)).unwrap_or_default();
    let same = blake3::hash(&bytes).to_hex().as_str() == mesh.blake3;
    (!same).then(|| mesh.path.clone())
}
