//! A scene to solve, from its folder to the written result. The parts are apart because processes
//! that share a scene put other things between them (`solve --shard`, `merge`).

use super::guard::{keep_inputs, keep_other_results};
use super::record::run_key;
use super::result::{RunResult, SolvedRun};
use super::{Run, RunRequest};
use crate::alignment::{Alignment, align};
use crate::core::formats::AsideFolder;
use crate::core::lock::OutputLock;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::pipeline::{Checkpoints, SolveOptions, fitting_reduction, reconstruct};
use crate::programs::report::{InputFile, hash_inputs};
use crate::scene::{LoadOptions, Scene};
use crate::solution::Solution;
use crate::verdict::{AlignmentVerdict, Findings};
use std::path::Path;

impl Run {
    /// Solves the scene in `scene` and writes the result into `out`, all or nothing; a run that was
    /// stopped goes on where it was.
    ///
    /// # Errors
    /// Unusable options or input, photographs that do not fit the mesh, a folder that cannot be
    /// written to or that another process writes to, [`Error::Stopped`].
    pub fn solve(&self, scene: &Path, out: &Path) -> Result<SolvedRun> {
        let mut job = Job::read(scene, out, self)?;
        // before the long run: is there a place for the result, and is it ours alone?
        let _lock = OutputLock::acquire(out, &[])?;
        drop(AsideFolder::new(out)?);
        if job.options.budget.is_none() {
            job.options.checkpoints = Checkpoints::new(out, &job.key(self)?);
        }
        let checkpoints = job.options.checkpoints.clone();
        let run = job.solve(&self.progress)?.write(out, self)?;
        checkpoints.finish();
        Ok(run)
    }

    /// A hash of everything the result depends on but the input: options, seed, the very program.
    ///
    /// # Errors
    /// The program's own file cannot be read.
    pub fn key(&self) -> Result<String> {
        run_key(&[], &self.options(), self)
    }
}

/// A scene to solve, as read.
pub struct Job {
    scene: Scene,
    alignment: Alignment,
    inputs: Vec<InputFile>,
    /// The numbers in effect.
    pub options: SolveOptions,
}

/// A solved scene.
pub struct SolvedJob {
    scene: Scene,
    result: RunResult,
}

impl Job {
    /// Reads a scene whose result is to go into `out`.
    ///
    /// # Errors
    /// An output folder that holds input, an unusable scene, photographs that do not fit the mesh,
    /// a run that does not fit into the memory it may take.
    pub fn read(scene_path: &Path, out: &Path, run: &Run) -> Result<Self> {
        keep_inputs(out, scene_path, &[])?;
        let (scene, alignment) = aligned_scene(scene_path, &run.request, &run.progress)?;
        keep_inputs(out, &scene.folder, &scene.input_files())?;
        let mut options = run.options();
        options.photo_reduction = fitting_reduction(&scene, &options, &run.progress)?;
        let inputs = hash_inputs(&scene)?;
        keep_other_results(out, &inputs)?;
        Ok(Self {
            scene,
            alignment,
            inputs,
            options,
        })
    }

    /// A hash of everything that the result depends on.
    ///
    /// # Errors
    /// The program's own file cannot be read.
    pub fn key(&self, run: &Run) -> Result<String> {
        run_key(&self.inputs, &self.options, run)
    }

    /// Solves the scene.
    ///
    /// # Errors
    /// Those of [`reconstruct`].
    pub fn solve(self, progress: &Progress) -> Result<SolvedJob> {
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
                options,
            },
        })
    }
}

impl SolvedJob {
    /// Writes the result into `out`.
    ///
    /// # Errors
    /// Those of [`RunResult::write`].
    pub fn write(self, out: &Path, run: &Run) -> Result<SolvedRun> {
        self.result.write(&self.scene, out, run)
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

/// Reads a scene and notes its warnings.
///
/// # Errors
/// Those of [`Scene::load`].
pub fn read_scene(path: &Path, load: &LoadOptions, progress: &Progress) -> Result<Scene> {
    let scene = progress.stage("reading the scene", 1, |_| Scene::load(path, load))?;
    for warning in &scene.warnings {
        progress.note(warning);
    }
    Ok(scene)
}

/// The scene, corrected if it was asked for; a scene whose photographs and mesh do not fit is
/// refused.
fn aligned_scene(
    path: &Path,
    request: &RunRequest,
    progress: &Progress,
) -> Result<(Scene, Alignment)> {
    let mut scene = read_scene(path, &request.load, progress)?;
    let options = &request.alignment;
    let alignment = progress.stage("testing the alignment", 1, |_| align(&mut scene, options))?;
    progress.note(alignment.to_string());
    match alignment.problem() {
        Some(problem) if !options.force => Err(Error::input(path, problem)),
        _ => Ok((scene, alignment)),
    }
}
