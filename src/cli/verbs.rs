//! The verbs: each reads its input, calls the library and prints the result.

use super::{Context, Verb, pictures};
use crate::error::{Error, Result};
use crate::evaluate::{evaluate, terminal_table};
use crate::pipeline::{Checkpoints, reconstruct};
use crate::render::{HybridOptions, HybridRenderer};
use crate::report::{
    self, InputFile, Photographer, RunRecord, SceneSummary, Versions, hash_inputs, write_report,
};
use crate::scene::{Scene, check};
use crate::solution::{AsideFolder, SaveOptions, Solution};
use crate::synth::generate;
use crate::view;
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// Runs one verb and returns the exit code of a run that did not fail.
pub fn run(verb: &Verb, context: &Context) -> Result<u8> {
    match verb {
        Verb::Synth { out, .. } => synthesise(required(out)?, context),
        Verb::Check { scene, .. } => return check_scene(required(scene)?, context),
        Verb::Solve { scene, out, .. } => solve(required(scene)?, required(out)?, context),
        Verb::Render { out, places, .. } => pictures::render(required(out)?, places, context),
        Verb::Edit {
            out,
            edits,
            scene,
            clear,
            ..
        } => pictures::edit(
            required(out)?,
            edits.as_deref(),
            scene.as_deref(),
            *clear,
            context,
        ),
        Verb::Export { out, places, .. } => pictures::export(required(out)?, places, context),
        Verb::Relight {
            out,
            places,
            lights,
            against,
            list_lamps,
            ..
        } => pictures::relight(
            required(out)?,
            places,
            lights.as_deref(),
            against.as_deref(),
            *list_lamps,
            context,
        ),
        Verb::Eval { out, scene, .. } => eval(required(out)?, required(scene)?, context),
        Verb::Bench { what } => super::bench::run(what, context),
        Verb::View { out, scene, .. } => view_in_browser(required(out)?, scene.as_deref(), context),
    }?;
    Ok(0)
}

fn synthesise(out: &Path, context: &Context) -> Result<()> {
    let mut options = context.config.synth.clone();
    options.seed = context.config.seed.unwrap_or(options.seed);
    let made = generate(&options, out, &context.progress)?;
    let run = context.recorder.record();
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
        super::progress::seconds(Duration::from_secs_f64(run.wall_seconds)),
    );
    context.result(&text, &json!({"out": out, "scene": made, "run": run}))
}

fn check_scene(path: &Path, context: &Context) -> Result<u8> {
    let report = context.progress.stage("checking the scene", 1, |_| {
        check(path, &context.config.scene)
    });
    let json = serde_json::to_value(&report).map_err(|e| Error::Failed(format!("check: {e}")))?;
    context.result(&report.to_string(), &json)?;
    Ok(report.exit_code())
}

/// clap guarantees presence unless `--print-config` was given, which never gets here.
fn required<T>(value: &Option<T>) -> Result<&T> {
    value
        .as_ref()
        .ok_or_else(|| Error::Usage("an argument is missing; see --help".into()))
}

pub(super) fn read_scene(path: &Path, context: &Context) -> Result<Scene> {
    let scene = context.progress.stage("reading the scene", 1, |_| {
        Scene::load(path, &context.config.scene)
    })?;
    for warning in &scene.warnings {
        context.progress.note(warning);
    }
    Ok(scene)
}

fn solve(scene_path: &Path, out: &Path, context: &Context) -> Result<()> {
    if out
        .canonicalize()
        .is_ok_and(|o| scene_path.canonicalize().is_ok_and(|s| o == s))
    {
        return Err(Error::Usage(format!(
            "{}: is the scene itself; give another folder to --out",
            out.display()
        )));
    }
    let scene = read_scene(scene_path, context)?;
    // before the long run: is there a place for the result?
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
    let solution = reconstruct(&scene, &options, progress)?.solution;
    progress.stage("writing the textures", 1, |_| {
        solution.save(out, &SaveOptions::default())
    })?;
    let mut record = record(&scene, inputs, context)?;
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
        write_report(out, &scene, &solution, &renderer, &record, None, Vec::new())
    })?;
    record.measure(&context.recorder);
    record.write_manifest(out)?;
    options.checkpoints.finish();
    let s = &solution;
    let text = format!(
        "albedo {}x{}, roughness {}x{}, irradiance {}x{} in {} ({:.2} GiB at most, {} threads)\nreport: {}\n",
        s.albedo.width,
        s.albedo.height,
        s.roughness.width,
        s.roughness.height,
        s.irradiance.width,
        s.irradiance.height,
        super::progress::seconds(Duration::from_secs_f64(record.wall_seconds)),
        record.peak_bytes as f64 / (1u64 << 30) as f64,
        record.machine.threads,
        out.join("report.html").display()
    );
    context.result(&text, &json!({"out": out, "run": record}))
}

/// A hash of everything the result depends on: inputs, options, seed and this very program.
fn run_key(inputs: &[InputFile], context: &Context) -> Result<String> {
    let program = std::env::current_exe()
        .and_then(std::fs::read)
        .map_err(|e| Error::Failed(format!("reading this program: {e}")))?;
    let program = blake3::hash(&program).to_hex().to_string();
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

/// The options as asked for and in effect.
fn options_of(context: &Context) -> Result<serde_json::Value> {
    let config = serde_json::to_value(&context.config)
        .map_err(|e| Error::Failed(format!("options: {e}")))?;
    let effective = context
        .config
        .solve
        .options(context.seed(), context.recorder.started());
    Ok(json!({"scene": config["scene"], "solve": config["solve"], "effective": effective}))
}

/// What has been measured so far, with what is known about the run besides.
fn record(scene: &Scene, inputs: Vec<InputFile>, context: &Context) -> Result<RunRecord> {
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

fn eval(out: &Path, scene_path: &Path, context: &Context) -> Result<()> {
    let solution = context
        .progress
        .stage("reading the solution", 1, |_| Solution::load(out))?;
    let scene = read_scene(scene_path, context)?;
    if (scene.origin - solution.origin).length() > 1e-6 {
        let message = format!(
            "was reconstructed from a scene centred at {}, but {} is centred at {}; give the scene it was made from",
            solution.origin,
            scene_path.display(),
            scene.origin
        );
        return Err(Error::input(out, message));
    }
    let renderer = HybridRenderer::new(
        &solution,
        HybridOptions {
            seed: context.seed(),
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
            if shown.contains(&seen.view.stem.as_str()) {
                match photographer.view(seen.view, seen.rendered, seen.truth) {
                    Ok(view) => pictures.push(view),
                    Err(e) => failed = Some(e),
                }
            }
        },
    )?;
    failed.map_or(Ok(()), Err)?;
    // the report tells of the run that made the solution; without its manifest, of this one
    let record = match RunRecord::read_manifest(out) {
        Some(record) => record,
        None => record(&scene, hash_inputs(&scene)?, context)?,
    };
    context.progress.stage("report", 1, |_| {
        write_report(
            out,
            &scene,
            &solution,
            &renderer,
            &record,
            Some(&evaluation),
            pictures,
        )
    })?;
    let json =
        serde_json::to_value(&evaluation).map_err(|e| Error::Failed(format!("scores: {e}")))?;
    context.result(&terminal_table(&evaluation), &json)
}

fn view_in_browser(out: &Path, scene_path: Option<&Path>, context: &Context) -> Result<()> {
    let solution = context
        .progress
        .stage("reading the solution", 1, |_| Solution::load(out))?;
    let scene = scene_path
        .map(|path| read_scene(path, context))
        .transpose()?;
    let manifest = RunRecord::read_manifest(out);
    let content = context.progress.stage("preparing the page", 1, |_| {
        view::Content::new(solution, scene, manifest.as_ref())
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
