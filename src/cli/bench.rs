//! `unbake bench`: what can be measured, and where the figures go.

use super::Context;
use super::verbs::read_scene;
use crate::bench::{IrtBench, bench_irt};
use crate::error::{Error, Result};
use crate::formats::{Aside, atomic_write};
use crate::pipeline::SolveOptions;
use clap::{Args, Subcommand};
use serde::Serialize;
use std::ffi::OsString;
use std::path::PathBuf;

/// The measurements.
#[derive(Subcommand, Clone, Debug)]
pub enum BenchVerb {
    /// Irradiance: rays per second beside a bare Embree loop, error against time, growth with texels, triangles and threads.
    Irt {
        /// Scene folder (or its transforms.json).
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// What is measured.
        #[command(flatten)]
        bench: IrtBench,
        /// Where the figures go.
        #[command(flatten)]
        outputs: Outputs,
    },
}

/// Where the figures go besides the terminal.
#[derive(Args, Clone, Debug, Default)]
pub struct Outputs {
    /// Write all figures as JSON to a file; after `bench`, `--json FILE` means the same.
    #[arg(long, value_name = "FILE")]
    pub json_file: Option<PathBuf>,
    /// Draw the curves into an SVG file.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

impl Outputs {
    /// Fails now rather than after the long run if a file cannot be written.
    fn check(&self) -> Result<()> {
        for path in [&self.json_file, &self.plot].into_iter().flatten() {
            drop(Aside::new(path)?);
        }
        Ok(())
    }

    fn write(&self, context: &Context, text: &str, report: &impl Serialize, plot: impl FnOnce() -> Result<String>) -> Result<()> {
        let json = serde_json::to_value(report).map_err(|e| Error::Failed(format!("figures: {e}")))?;
        if let Some(path) = &self.json_file {
            atomic_write(path, format!("{json:#}\n").as_bytes())?;
        }
        if let Some(path) = &self.plot {
            atomic_write(path, plot()?.as_bytes())?;
        }
        context.result(text, &json)
    }
}

/// Runs one measurement.
pub(super) fn run(what: &BenchVerb, context: &Context) -> Result<()> {
    match what {
        BenchVerb::Irt { scene, bench, outputs } => {
            outputs.check()?;
            let report = bench_irt(&read_scene(scene, context)?, bench, &solve_options(context), &context.progress)?;
            outputs.write(context, &report.text(), &report, || report.plot())
        }
    }
}

/// The reconstruction's options: the configuration file's, or the defaults.
fn solve_options(context: &Context) -> SolveOptions {
    SolveOptions { seed: context.seed(), ..context.config.solve.clone() }
}

/// After the verb `bench`, turns `--json FILE` into `--json-file FILE`: everywhere else `--json` is a switch that takes no value.
pub(super) fn with_json_file(arguments: Vec<OsString>) -> Vec<OsString> {
    let verb = arguments.iter().position(|a| a == "bench");
    let Some(verb) = verb.filter(|&v| v <= 1 || arguments[1].to_string_lossy().starts_with('-')) else { return arguments };
    let value_follows = |i: usize| arguments.get(i + 1).is_some_and(|next| !next.to_string_lossy().starts_with('-'));
    (0..arguments.len())
        .map(|i| {
            let text = arguments[i].to_string_lossy();
            match text.strip_prefix("--json=") {
                Some(path) if i > verb => format!("--json-file={path}").into(),
                _ if i > verb && text == "--json" && value_follows(i) => "--json-file".into(),
                _ => arguments[i].clone(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rewritten(line: &str) -> String {
        let arguments = line.split(' ').map(OsString::from).collect();
        with_json_file(arguments).iter().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn json_takes_a_file_after_bench_only() {
        assert_eq!(rewritten("unbake bench irt S --json F"), "unbake bench irt S --json-file F");
        assert_eq!(rewritten("unbake --quiet bench irt S --json=F"), "unbake --quiet bench irt S --json-file=F");
        assert_eq!(rewritten("unbake bench irt S --json"), "unbake bench irt S --json");
        assert_eq!(rewritten("unbake bench irt S --json --full"), "unbake bench irt S --json --full");
        assert_eq!(rewritten("unbake eval bench --json"), "unbake eval bench --json");
    }
}
