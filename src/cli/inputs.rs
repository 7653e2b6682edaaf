//! What verbs read: scenes and solutions, with their warnings on the way.

use super::context::Context;
use crate::Result;
use crate::core::progress::Progress;
use crate::programs::edit::load_edited;
use crate::programs::report::RunRecord;
use crate::scene::Scene;
use crate::solution::{Solution, check_generation};
use std::path::Path;

/// Reads a scene and shows its warnings.
pub(super) fn read_scene(path: &Path, context: &Context) -> Result<Scene> {
    let scene = context.progress.stage("reading the scene", 1, |_| {
        Scene::load(path, &context.config.scene)
    })?;
    for warning in &scene.warnings {
        context.progress.note(warning);
    }
    Ok(scene)
}

/// Reads the scene a solution was made from, with its poses as they were corrected then.
pub(super) fn read_solved_scene(path: &Path, out: &Path, context: &Context) -> Result<Scene> {
    let mut scene = read_scene(path, context)?;
    if let Some(alignment) = manifest_of(out)?.and_then(|m| m.alignment) {
        alignment.reapply(&mut scene);
    }
    Ok(scene)
}

/// The manifest beside a solution, if there is one.
///
/// # Errors
/// A manifest of another run than the solution's files.
pub(super) fn manifest_of(out: &Path) -> Result<Option<RunRecord>> {
    let manifest = RunRecord::read_manifest(out);
    if let Some(m) = &manifest {
        check_generation(out, "manifest.json", &m.generation)?;
    }
    Ok(manifest)
}

/// A solution with its edits applied, if it has any.
pub(super) fn read_solution(out: &Path, progress: &Progress) -> Result<Solution> {
    progress.note(format!("reading {}", out.display()));
    load_edited(out, progress)
}
