//! What every verb works with: configuration, progress, the record of the run, and where results go.

use super::config::Config;
use super::progress::{Bars, LogLines};
use crate::core::progress::{Observer, Progress};
use crate::error::{Error, Result, printable_lines};
use crate::programs::run::{Run, RunRequest};
use std::io::{IsTerminal, Write};
use std::sync::Arc;

/// What a verb works with besides its own arguments.
pub struct Context {
    /// The effective configuration.
    pub config: Config,
    /// Where long work reports to.
    pub progress: Progress,
    /// The run that this is, as far as it reconstructs: its request, command and record.
    pub run: Run,
}

impl Context {
    /// A run that begins now, watched by `others` besides its own recorder and the terminal.
    #[must_use]
    pub fn new(config: Config, command: Vec<String>, others: Vec<Arc<dyn Observer>>) -> Self {
        let mut observers = others;
        if !config.quiet {
            observers.push(if std::io::stderr().is_terminal() {
                Arc::new(Bars::new())
            } else {
                Arc::new(LogLines::new())
            });
        }
        let request = RunRequest {
            load: config.scene.clone(),
            alignment: config.alignment.clone(),
            solve: config.solve.clone(),
            seed: config.seed.unwrap_or(0),
        };
        let run = Run::new(request, command, observers);
        Self {
            config,
            progress: run.progress.clone(),
            run,
        }
    }

    /// The seed of a verb that has none of its own.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.run.request.seed
    }

    /// Prints a verb's result: `text` for people or `json` for machines.
    ///
    /// # Errors
    /// If stdout cannot be written to; a closed pipe is none.
    pub fn result(&self, text: &str, json: &serde_json::Value) -> Result<()> {
        if self.config.json {
            print(&format!("{json:#}\n"))
        } else {
            print(&printable_lines(text))
        }
    }
}

/// Writes to stdout; a closed pipe is the reader's choice and not an error.
pub(super) fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Error::io("stdout", e)),
        _ => Ok(()),
    }
}
