//! The verbs, a file each: each reads its input, calls the library and prints the result.

mod bake;
mod batch;
pub(super) mod bench;
mod check;
mod delight;
mod edit;
mod eval;
pub(super) mod export;
mod prepare;
#[cfg(feature = "mpi")]
mod ranks;
mod relight;
mod render;
mod shards;
mod shell;
mod solve;
mod synth;
mod view;

use super::args::Verb;
use super::context::Context;
use crate::error::{Error, Result};
use std::path::Path;

/// Runs one verb and returns the exit code of a run that did not fail.
///
/// # Errors
/// Those of the verb: wrong usage, unusable input, or a failed run.
pub fn run(verb: &Verb, context: &Context) -> Result<u8> {
    match verb {
        Verb::Synth { out, .. } => synth::synthesise(required(out)?, context),
        Verb::Bake { scene, out, .. } => bake::bake(required(scene)?, required(out)?, context),
        Verb::Prepare { what, out, .. } => prepare::run(what, out.as_deref(), context),
        Verb::Check { scene, .. } => return check::check_scene(required(scene)?, context),
        Verb::Solve {
            scene,
            out,
            shard: Some(shard),
            ..
        } => shards::solve_shard(required(scene)?, required(out)?, *shard, context),
        Verb::Solve { scene, out, .. } => solve_here(required(scene)?, required(out)?, context),
        Verb::Merge { out, complete } => shards::merge(required(out)?, *complete, context),
        Verb::Delight { mesh, out, .. } => {
            delight::delight(required(mesh)?, required(out)?, context)
        }
        Verb::Batch {
            list, out, index, ..
        } => return batch::batch(required(list)?, *index, required(out)?, context),
        Verb::Render { out, places, .. } => render::render(required(out)?, places, context),
        Verb::Edit {
            out,
            edits,
            scene,
            clear,
            ..
        } => edit::edit(
            required(out)?,
            edits.as_deref(),
            scene.as_deref(),
            *clear,
            context,
        ),
        Verb::Export {
            out,
            places,
            lightings,
            ..
        } => export::export(required(out)?, places, lightings.as_deref(), context),
        Verb::Relight {
            out,
            places,
            lights,
            against,
            list_lamps,
            ..
        } => relight::relight(
            required(out)?,
            places,
            lights.as_deref(),
            against.as_deref(),
            *list_lamps,
            context,
        ),
        Verb::Eval { out, scene, .. } => eval::eval(required(out)?, required(scene)?, context),
        Verb::Bench { what } => bench::run(what, context),
        Verb::View { out, scene, .. } => {
            view::view_in_browser(required(out)?, scene.as_deref(), context)
        }
        Verb::Completions { shell } => shell::completions(*shell),
        Verb::Man { to } => shell::manual(to.as_deref(), context),
    }?;
    Ok(0)
}

/// Solves in this process, or with the ranks of an MPI run.
fn solve_here(scene: &Path, out: &Path, context: &Context) -> Result<()> {
    #[cfg(feature = "mpi")]
    if ranks::solve_with_ranks(scene, out, context)? {
        return Ok(());
    }
    solve::solve(scene, out, context)
}

/// clap guarantees presence unless `--print-config` was given, which never gets here.
fn required<T>(value: &Option<T>) -> Result<&T> {
    value
        .as_ref()
        .ok_or_else(|| Error::Usage("an argument is missing; see --help".into()))
}
