//! `mpirun -n N unbake solve`: one scene solved by the ranks of an MPI run; rank 0 writes the result.

use super::shards::refuse_budget;
use super::solve::say;
use crate::cli::config::Config;
use crate::cli::context::Context;
use crate::core::blocks::Ranks;
use crate::core::formats::AsideFolder;
use crate::core::lock::OutputLock;
use crate::error::{Result, printable_lines};
use crate::programs::run::Job;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

/// Solves with the other ranks if a launcher started several; whether there were several.
///
/// # Errors
/// MPI cannot be started. What goes wrong later ends all ranks.
pub(super) fn solve_with_ranks(scene: &Path, out: &Path, context: &Context) -> Result<bool> {
    let Some((universe, ranks)) = Ranks::launched()? else {
        return Ok(false);
    };
    if ranks.size < 2 {
        return Ok(false);
    }
    let ranks = Arc::new(ranks);
    // whatever goes wrong here, the others would wait for this rank for ever
    match catch_unwind(AssertUnwindSafe(|| solve(scene, out, &ranks, context))) {
        Ok(Ok(())) => {}
        Ok(Err(e)) => {
            let said = printable_lines(&e.to_string());
            let _ = writeln!(std::io::stderr(), "error: rank {}: {said}", ranks.rank);
            ranks.abort(e.exit_code());
        }
        Err(_) => ranks.abort(1),
    }
    drop(universe);
    Ok(true)
}

fn solve(scene: &Path, out: &Path, ranks: &Arc<Ranks>, context: &Context) -> Result<()> {
    let quiet = Context::new(
        Config {
            quiet: true,
            ..context.config.clone()
        },
        context.run.command.clone(),
        Vec::new(),
    );
    let first = ranks.rank == 0;
    let context = if first { context } else { &quiet };
    let job = Job::read(scene, out, &context.run)?;
    refuse_budget(&job)?;
    ranks.expect_same(&job.key(&context.run)?)?;
    let _lock = first.then(|| OutputLock::acquire(out, &[])).transpose()?;
    if first {
        drop(AsideFolder::new(out)?);
    }
    let solved = job.solve(&context.progress.shared(ranks.clone()))?;
    match first {
        true => say(&solved.write(out, &context.run)?, out, context),
        false => Ok(()),
    }
}
