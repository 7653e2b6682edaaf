//! What verbs read: scenes and solutions, with their warnings on the way.

use super::context::Context;
use crate::Result;
use crate::core::progress::Progress;
use crate::programs::edit::load_edited;
use crate::programs::report::RunRecord;
use crate::programs::run;
use crate::scene::Scene;
use crate::solution::Solution;
use std::path::Path;

/// Reads a scene and shows its warnings.
pub(super) fn read_scene(path: &Path, context: &Context) -> Result<Scene> {
    run::read_scene(path, &context.config.scene, &context.progress)
}

/// Reads the scene a solution was made from, with its poses as they were corrected then.
pub(super) fn read_solved_scene(path: &Path, out: &Path, context: &Context) -> Result<Scene> {
    let mut scene = read_scene(path, context)?;
    if let Some(alignment) = RunRecord::of_result(out)?.and_then(|m| m.alignment) {
        alignment.reapply(&mut scene);
    }
    Ok(scene)
}

/// A solution with its edits applied, if it has any.
pub(super) fn read_solution(out: &Path, progress: &Progress) -> Result<Solution> {
    progress.note(format!("reading {}", out.display()));
    load_edited(out, progress)
}
