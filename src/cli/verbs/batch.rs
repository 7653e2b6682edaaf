//! `unbake batch`: many scenes, each solved as `unbake solve` does, shared by all processes that
//! have the same output folder.

use crate::cli::args::Cli;
use crate::cli::config::{Config, tables_of};
use crate::cli::context::Context;
use crate::cli::verb_args::BatchIndex;
use crate::core::lock::Claim;
use crate::error::{Error, Result};
use crate::programs::batch::{Board, Item, SceneRecord, State, Table, read_list};
use crate::programs::report::restart_peak;
use crate::programs::run::{Run, keep_inputs};
use clap::parser::ValueSource;
use clap::{CommandFactory, FromArgMatches};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Instant, SystemTime};

/// Where schedulers say which element of a job array this process is.
const ARRAY_INDICES: [&str; 2] = ["SLURM_ARRAY_TASK_ID", "AWS_BATCH_JOB_ARRAY_INDEX"];

/// Arguments of `solve` that concern the whole process and cannot stand in a list.
const OF_THE_PROCESS: [&str; 7] = [
    "threads",
    "quiet",
    "json",
    "config",
    "print_config",
    "tape",
    "shard",
];

/// What this process knows of its batch.
struct Batch<'a> {
    board: Board,
    items: Vec<Item>,
    configs: Vec<Config>,
    /// Attempts of every scene when this process began.
    attempts: Vec<u32>,
    alone: bool,
    context: &'a Context,
}

/// What became of asking for a scene.
#[derive(PartialEq, Eq)]
enum Turn {
    /// This process solved it, or failed to.
    Done,
    /// Nothing to do.
    Settled,
    /// Another process is at it.
    Elsewhere,
}

pub(crate) fn batch(
    list: &Path,
    index: Option<BatchIndex>,
    out: &Path,
    context: &Context,
) -> Result<u8> {
    keep_input(out, list)?;
    let items = read_list(list, out)?;
    let index = chosen(index, items.len())?;
    for item in &items {
        keep_input(out, &item.scene)?;
    }
    let configs = configs_of(list, &items, context)?;
    let board = Board::open(out)?;
    let records: Vec<SceneRecord> = items.iter().map(|i| board.record(i)).collect();
    let batch = Batch {
        board,
        items,
        configs,
        attempts: records.iter().map(|r| r.attempts).collect(),
        alone: index.is_some(),
        context,
    };
    let order = index.map_or_else(|| order_of(&records), |i| vec![i]);
    let elsewhere = batch.work(list, order)?;
    let table = batch.board.merge(list, &batch.items)?;
    match index {
        Some(i) if !elsewhere.is_empty() => Err(Error::Failed(format!(
            "{}: another process is solving this scene",
            batch.board.result(&batch.items[i]).display()
        ))),
        _ => say(&table, out, context).map(|()| exit_code(&table, index)),
    }
}

/// Refuses an output folder that is `input`, or holds it if it is a file.
fn keep_input(out: &Path, input: &Path) -> Result<()> {
    let file = input.is_file().then(|| input.to_path_buf());
    keep_inputs(out, input, file.as_slice())
}

/// 1 if the scene of this process failed, or any where it did not have one of its own.
fn exit_code(table: &Table, index: Option<usize>) -> u8 {
    let failed = match index {
        Some(i) => table.state(i) == Some(State::Failed),
        None => table.count(State::Failed) > 0,
    };
    u8::from(failed)
}

fn say(table: &Table, out: &Path, context: &Context) -> Result<()> {
    let text = format!(
        "{}{}\ntable: {}\n",
        table.failures(),
        table.summary(),
        out.join("batch.md").display()
    );
    context.result(&text, &table.json())
}

/// The one scene to solve, if there is one.
fn chosen(index: Option<BatchIndex>, scenes: usize) -> Result<Option<usize>> {
    let (index, said_by) = match index {
        Some(index) => (index, "--index"),
        None => {
            let set = ARRAY_INDICES
                .iter()
                .find_map(|name| Some((std::env::var(name).ok()?, *name)));
            let Some((text, name)) = set else {
                return Ok(None);
            };
            let parsed = text.parse::<BatchIndex>();
            (
                parsed.map_err(|e| Error::Usage(format!("{name}: {e}")))?,
                name,
            )
        }
    };
    match index {
        BatchIndex::All => Ok(None),
        BatchIndex::One(i) if i < scenes => Ok(Some(i)),
        BatchIndex::One(i) => Err(Error::Usage(format!(
            "{said_by} {i}: the list has {scenes} scenes; expected 0 to {}, or `--index all`",
            scenes - 1
        ))),
    }
}

/// Scenes in the order of the list; those that somebody began and never ended last, most often
/// begun at the very end: one that kills its process keeps nobody from the others.
fn order_of(records: &[SceneRecord]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..records.len()).collect();
    order.sort_by_key(|&i| match records[i].state {
        State::Started => records[i].attempts,
        _ => 0,
    });
    order
}

/// The configuration of every scene: that of the batch, and the flags of its line.
fn configs_of(list: &Path, items: &[Item], context: &Context) -> Result<Vec<Config>> {
    let mut known: HashMap<&[String], Config> = HashMap::new();
    let mut configs = Vec::with_capacity(items.len());
    for item in items {
        if let Some(config) = known.get(item.flags.as_slice()) {
            configs.push(config.clone());
            continue;
        }
        let bad = |what: String| Error::input(list, format!("line {}: {what}", item.line));
        let config = config_of(&item.flags, &context.config).map_err(|e| match item.flags[..] {
            [] => e,
            _ => bad(e.to_string()),
        })?;
        known.insert(&item.flags, config.clone());
        configs.push(config);
    }
    Ok(configs)
}

/// A configuration with flags of `solve` on top, as if they had been typed.
fn config_of(flags: &[String], base: &Config) -> Result<Config> {
    let usage = |e: clap::Error| match e.use_stderr() {
        true => Error::Usage(e.to_string().trim_end().to_owned()),
        false => Error::Usage("asks for help; expected SCENE [FLAGS OF solve]".into()),
    };
    let solve = ["unbake", "solve", "SCENE", "--out", "OUT"].map(str::to_owned);
    let typed = solve.iter().chain(flags);
    let matches = Cli::command().try_get_matches_from(typed).map_err(usage)?;
    let cli = Cli::from_arg_matches(&matches).map_err(usage)?;
    let (_, typed) = matches.subcommand().unwrap_or(("", &matches));
    let of_process = |id: &&str| typed.value_source(id) == Some(ValueSource::CommandLine);
    if let Some(id) = OF_THE_PROCESS.iter().find(|id| of_process(id)) {
        return Err(Error::Usage(format!(
            "--{} concerns the whole process; give it to `unbake batch`",
            id.replace('_', "-")
        )));
    }
    let config = base.overlaid(&cli.flags(), tables_of("solve"), typed)?;
    config.solve.options(0, Instant::now()).validate()?;
    Ok(config)
}

impl Batch<'_> {
    /// Solves what there is to solve and returns what others are at. Whatever they leave behind
    /// meanwhile is taken up.
    fn work(&self, list: &Path, mut left: Vec<usize>) -> Result<Vec<usize>> {
        loop {
            let (mut worked, mut elsewhere) = (false, Vec::new());
            for i in left {
                match self.turn(i)? {
                    Turn::Done => {
                        self.board.merge(list, &self.items)?;
                        worked = true;
                    }
                    Turn::Settled => {}
                    Turn::Elsewhere => elsewhere.push(i),
                }
            }
            if !worked || elsewhere.is_empty() {
                return Ok(elsewhere);
            }
            left = elsewhere;
        }
    }

    /// Claims a scene and solves it, if it is free and there is need.
    fn turn(&self, i: usize) -> Result<Turn> {
        let (item, note) = (&self.items[i], |what: &str| {
            let name = &self.items[i].name;
            let of = self.items.len();
            let said = format!("scene {i} ({name}) of {of}: {what}");
            self.context.progress.note(said);
        });
        let _lock = match self.board.claim(item)? {
            Claim::Ours(lock) => Some(lock),
            Claim::Theirs => return Ok(Turn::Elsewhere),
            Claim::NoLocks if self.alone => None,
            Claim::NoLocks => {
                return Err(Error::Failed(format!(
                    "{}: the file system has no locks, so scenes cannot be shared out; give each \
                     process its own by --index",
                    self.board.result(item).display()
                )));
            }
        };
        let command = self.context.run.command.clone();
        let run = Context::new(self.configs[i].clone(), command, Vec::new()).run;
        let (before, key) = (self.board.record(item), run.key()?);
        let out = self.board.result(item);
        if before.still_holds(&key, &item.scene, &out) {
            note("finished already");
            return Ok(Turn::Settled);
        }
        let tried = before.state == State::Failed && before.attempts != self.attempts[i];
        if tried && before.key == key {
            note("failed in another process");
            return Ok(Turn::Settled);
        }
        note("begins");
        let begun = SceneRecord::begun(&before, &key);
        self.board.put(item, &begun)?;
        let ended = solve_item(item, &out, &run, begun);
        note(match ended.state {
            State::Failed => &ended.message,
            _ => "finished",
        });
        self.board.put(item, &ended)?;
        Ok(Turn::Done)
    }
}

/// Solves a scene; whatever goes wrong is put down.
fn solve_item(item: &Item, out: &Path, run: &Run, begun: SceneRecord) -> SceneRecord {
    restart_peak();
    let (start, began) = (Instant::now(), SystemTime::now());
    let outcome = catch_unwind(AssertUnwindSafe(|| run.solve(&item.scene, out)));
    let seconds = start.elapsed().as_secs_f64();
    match outcome {
        Ok(Ok(solved)) => begun.finished(&solved.record, &solved.verdict, &item.scene, began),
        Ok(Err(e)) => begun.failed(e.to_string(), seconds),
        Err(_) => {
            let message = "stopped by a defect of unbake, see what it wrote to stderr";
            begun.failed(message.into(), seconds)
        }
    }
}
