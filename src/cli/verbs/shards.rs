//! `unbake solve --shard I/N` and `unbake merge`: one scene solved by several processes that share
//! blocks over a folder beside the result.

use super::solve::summary;
use crate::cli::config::Config;
use crate::cli::context::Context;
use crate::core::blocks::Shard;
use crate::core::formats::AsideFolder;
use crate::core::lock::OutputLock;
use crate::error::{Error, Result};
use crate::programs::run::Job;
use crate::programs::shards::{Plan, ShardedRun};
use serde_json::json;
use std::path::Path;
use std::sync::Arc;

/// Computes what the other shards have not, and writes nothing but blocks.
pub(super) fn solve_shard(scene: &Path, out: &Path, shard: Shard, context: &Context) -> Result<()> {
    if out.is_file() {
        let message = "is a file where a folder is to be made; give another name";
        return Err(Error::input(out, message));
    }
    let job = Job::read(scene, out, &context.run)?;
    refuse_budget(&job)?;
    let plan = Plan {
        scene: std::path::absolute(scene).map_err(|e| Error::io(scene, e))?,
        config: serde_json::to_value(&context.config)
            .map_err(|e| Error::Failed(format!("options: {e}")))?,
    };
    let run = ShardedRun::begin(out, &job.key(&context.run)?, &plan)?;
    let _at_work = run.at_work()?;
    let blocks = Arc::new(run.blocks(shard)?);
    job.solve(&context.progress.shared(blocks.clone()))?;
    run.finish()?;
    let text = format!(
        "shard {}/{}: computed {} blocks here; all are there: `unbake merge {}` writes the result\n",
        shard.index,
        shard.of,
        blocks.computed(),
        out.display()
    );
    let said =
        json!({"out": out, "shard": shard.index, "of": shard.of, "blocks": blocks.computed()});
    context.result(&text, &said)
}

/// Decisions by the clock differ between processes.
pub(super) fn refuse_budget(job: &Job) -> Result<()> {
    match &job.options.budget {
        None => Ok(()),
        Some(_) => Err(Error::Usage(
            "solve: --budget decides by this process's clock, which others that share the work do not have; choose a --quality".into(),
        )),
    }
}

/// Writes the result of shards, and removes their blocks. What is missing is computed, if `complete`
/// says so; a merge on a small machine must not begin to compute for hours unasked.
pub(super) fn merge(out: &Path, complete: bool, context: &Context) -> Result<()> {
    let (run, plan) = ShardedRun::find(out)?;
    if !complete {
        run.expect_finished()?;
    }
    let config: Config = serde_json::from_value(plan.config).map_err(|e| {
        Error::input(
            out,
            format!("the options of its shards cannot be read: {e}"),
        )
    })?;
    let config = Config {
        threads: context.config.threads,
        quiet: context.config.quiet,
        json: context.config.json,
        ..config
    };
    let context = &Context::new(config, context.run.command.clone(), Vec::new());
    let job = Job::read(&plan.scene, out, &context.run)?;
    run.expect_key(&job.key(&context.run)?)?;
    let _lock = OutputLock::acquire(out, &[])?;
    drop(AsideFolder::new(out)?);
    let blocks = Arc::new(run.blocks(Shard { index: 1, of: 1 })?);
    let solved = job.solve(&context.progress.shared(blocks.clone()))?;
    let written = solved.write(out, &context.run)?;
    run.remove();
    let computed = match blocks.computed() {
        0 => String::new(),
        n => format!("{n} blocks were missing or damaged and were computed here\n"),
    };
    context.result(
        &format!("{computed}{}", summary(&written, out)),
        &json!({"out": out, "run": written.record, "verdict": written.verdict, "blocks": blocks.computed()}),
    )
}
