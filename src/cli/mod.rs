//! The command line: arguments, configuration, progress and exit codes. Everything else is the
//! library's work.
//!
//! Results go to stdout, as text or, with `--json`, as one JSON object; progress and errors go to
//! stderr. Exit codes: 0 done, 1 failed, 2 wrong usage or unusable input. A reader that closes the
//! pipe early is not a failure.

mod args;
mod camera_files;
mod config;
mod context;
mod frames;
mod inputs;
mod progress;
mod tape;
mod verb_args;
mod verbs;

pub use args::{Cli, Global, Verb};
pub use config::Config;
pub use context::Context;
use context::print;
pub use frames::FrameSource;
pub use progress::{Bars, LogLines};
pub use verb_args::BenchVerb;

use crate::core::progress::Observer;
use crate::error::{Error, Result, printable_lines};
use clap::{CommandFactory, FromArgMatches};
use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;

/// Runs the program with the given arguments (the first is its name) and returns its exit code.
#[must_use]
pub fn run(arguments: Vec<OsString>) -> ExitCode {
    let arguments = verbs::bench::with_json_file(arguments);
    let command: Vec<String> = arguments
        .iter()
        .skip(1)
        .map(|a| a.to_string_lossy().into_owned())
        .collect();
    let matches = match Cli::command().try_get_matches_from(arguments) {
        Ok(matches) => matches,
        Err(e) => {
            // help asked for is a result; anything else is wrong usage
            let _ = e.print();
            if e.use_stderr() && wants_json(&command) {
                print_error(&e.to_string(), 2);
            }
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    let mut as_json = wants_json(&command);
    let outcome = Cli::from_arg_matches(&matches)
        .map_err(|e| Error::Usage(e.to_string()))
        .and_then(|cli| {
            if cli.global.version {
                return print(&version()).map(|()| 0);
            }
            let config = configured(&cli, &matches)?;
            as_json |= config.json;
            dispatch(&cli, &matches, config, command)
        });
    match outcome {
        Ok(code) => ExitCode::from(code),
        Err(e) => {
            let said = printable_lines(&e.to_string());
            let _ = writeln!(std::io::stderr(), "error: {said}");
            if as_json {
                print_error(&e.to_string(), e.exit_code());
            }
            ExitCode::from(e.exit_code())
        }
    }
}

fn wants_json(command: &[String]) -> bool {
    command.iter().any(|a| a == "--json")
}

/// An error as the one JSON object on stdout.
fn print_error(message: &str, exit_code: u8) {
    let object = serde_json::json!({"error": message, "exit_code": exit_code});
    let _ = print(&format!("{object:#}\n"));
}

/// The options of a configuration file, if one was given, and the flags over them.
fn configured(cli: &Cli, matches: &clap::ArgMatches) -> Result<Config> {
    let file = cli
        .global
        .config
        .as_deref()
        .map_or_else(|| Ok(Config::default()), Config::read)?;
    let (verb, verb_matches) = matches.subcommand().unwrap_or(("", matches));
    file.overlaid(&cli.flags(), config::tables_of(verb), verb_matches)
}

fn dispatch(
    cli: &Cli,
    matches: &clap::ArgMatches,
    config: Config,
    command: Vec<String>,
) -> Result<u8> {
    if cli.global.print_config {
        let verb = matches.subcommand_name().unwrap_or("");
        let only = (!verb.is_empty()).then_some(verb);
        return print(&config.documented(&Cli::command(), only)?).map(|()| 0);
    }
    let Some(verb) = &cli.verb else {
        let _ = writeln!(std::io::stderr(), "{}", Cli::command().render_help());
        return Err(Error::Usage(
            "a verb is missing: say what to do, for example `unbake solve SCENE -o OUT`".into(),
        ));
    };
    let tape = match verb {
        Verb::Solve { tape, .. } => tape.as_deref(),
        _ => None,
    };
    match tape {
        Some(file) => tape::start(file, config.threads)?,
        None => start_threads(config.threads)?,
    }
    let mut observers: Vec<Arc<dyn Observer>> = Vec::new();
    if tape.is_some() {
        observers.push(Arc::new(tape::StageMarks::default()));
    }
    let context = Context::new(config, command, observers);
    let code = verbs::run(verb, &context)?;
    tape.map_or(Ok(()), tape::write)?;
    Ok(code)
}

fn start_threads(threads: Option<usize>) -> Result<()> {
    let Some(threads) = threads else {
        return Ok(());
    };
    if threads == 0 || threads > 4096 {
        return Err(Error::Usage(format!(
            "--threads {threads}: expected 1 to 4096; leave it out to use every core"
        )));
    }
    // (beyond that they only wait for each other, and the result is the same)
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.min(4 * cores.max(16)))
        .build_global()
        .map_err(|e| Error::Failed(format!("cannot start {threads} threads: {e}")))
}

/// The text of `--version`.
fn version() -> String {
    format!(
        "unbake {}\nEmbree {}\nOpenImageIO {}\n",
        env!("CARGO_PKG_VERSION"),
        crate::core::trace::embree_version(),
        crate::core::formats::version()
    )
}

#[cfg(test)]
mod tests;
