//! `unbake bench`: what can be measured, and where the figures go.

use crate::cli::config::Config;
use crate::cli::context::Context;
use crate::cli::inputs::read_scene;
use crate::cli::verb_args::{BenchVerb, Outputs, Work};
use crate::core::formats::{Aside, atomic_write};
use crate::error::{Error, Result};
use crate::pipeline::SolveRequest;
use crate::programs::bench::{
    AlignmentBench, IrtBench, LightBench, RobustnessBench, ScalingBench, TablesBench, TablesReport,
    TradeoffBench, TsdrBench, Workplace, bench_alignment, bench_irt, bench_kernel, bench_light,
    bench_robustness, bench_scaling, bench_tables, bench_tradeoff, bench_tsdr,
};
use crate::scene::{LdrImages, LoadOptions};
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

impl Work {
    fn workplace(&self, context: &Context) -> Result<Workplace> {
        self.workplace_of(&context.config)
    }

    /// Whose processes are configured so, but quiet.
    fn workplace_of(&self, config: &Config) -> Result<Workplace> {
        let folder = self.keep.clone().unwrap_or_else(|| {
            std::env::temp_dir().join(format!("unbake-bench-{}", std::process::id()))
        });
        let config = Config {
            quiet: true,
            json: false,
            ..config.clone()
        };
        let config =
            toml::to_string(&config).map_err(|e| Error::Failed(format!("options: {e}")))?;
        Ok(Workplace {
            folder,
            keep: self.keep.is_some(),
            config,
        })
    }
}

impl Outputs {
    /// The figures as JSON, without a plot.
    fn json_alone(file: &Option<PathBuf>) -> Self {
        Self {
            json_file: file.clone(),
            plot: None,
        }
    }

    /// Fails now rather than after the long run if a file cannot be written.
    fn check(&self) -> Result<()> {
        for path in [&self.json_file, &self.plot].into_iter().flatten() {
            drop(Aside::new(path)?);
        }
        Ok(())
    }

    fn write_files(
        &self,
        report: &impl Serialize,
        plot: impl FnOnce() -> Result<String>,
    ) -> Result<serde_json::Value> {
        let json =
            serde_json::to_value(report).map_err(|e| Error::Failed(format!("figures: {e}")))?;
        if let Some(path) = &self.json_file {
            atomic_write(path, format!("{json:#}\n").as_bytes())?;
        }
        if let Some(path) = &self.plot {
            atomic_write(path, plot()?.as_bytes())?;
        }
        Ok(json)
    }

    fn write(
        &self,
        context: &Context,
        text: &str,
        report: &impl Serialize,
        plot: impl FnOnce() -> Result<String>,
    ) -> Result<()> {
        let json = self.write_files(report, plot)?;
        context.result(text, &json)
    }
}

/// Runs one measurement.
pub(crate) fn run(what: &BenchVerb, context: &Context) -> Result<()> {
    match what {
        BenchVerb::Irt {
            scene,
            bench,
            outputs,
        } => irt(scene, bench, outputs, context),
        BenchVerb::Light {
            scene,
            bench,
            json_file,
        } => light(scene, bench, &Outputs::json_alone(json_file), context),
        BenchVerb::Tradeoff {
            scene,
            bench,
            work,
            outputs,
        } => tradeoff(scene, bench, work, outputs, context),
        BenchVerb::Tsdr {
            scene,
            bench,
            work,
            json_file,
        } => tsdr(scene, bench, work, &Outputs::json_alone(json_file), context),
        BenchVerb::Tables {
            scenes,
            bench,
            work,
            json_file,
        } => tables(
            scenes,
            bench,
            work,
            &Outputs::json_alone(json_file),
            context,
        ),
        BenchVerb::Robustness {
            scene,
            bench,
            work,
            json_file,
        } => robustness(scene, bench, work, &Outputs::json_alone(json_file), context),
        BenchVerb::Scaling {
            scene,
            bench,
            work,
            outputs,
        } => scaling(scene, bench, work, outputs, context),
        BenchVerb::Alignment {
            scenes,
            bench,
            json_file,
        } => alignment(scenes, bench, &Outputs::json_alone(json_file), context),
        BenchVerb::Kernel { bench, json_file } => {
            let outputs = Outputs::json_alone(json_file);
            outputs.check()?;
            let report = bench_kernel(bench)?;
            outputs.write(context, &report.text(), &report, no_plot)
        }
    }
}

fn no_plot() -> Result<String> {
    Ok(String::new())
}

fn irt(scene: &Path, bench: &IrtBench, outputs: &Outputs, context: &Context) -> Result<()> {
    outputs.check()?;
    let scene = read_scene(scene, context)?;
    let report = bench_irt(&scene, bench, &context.run.options(), &context.progress)?;
    outputs.write(context, &report.text(), &report, || report.plot())
}

fn light(path: &Path, bench: &LightBench, outputs: &Outputs, context: &Context) -> Result<()> {
    outputs.check()?;
    let scene = read_scene(path, context)?;
    let report = bench_light(&scene, bench, &context.run.options(), &context.progress)?;
    outputs.write(context, &report.text(), &report, no_plot)
}

fn tradeoff(
    path: &Path,
    bench: &TradeoffBench,
    work: &Work,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    let scene = read_scene(path, context)?;
    let runner = work.workplace(context)?.runner(path)?;
    let report = bench_tradeoff(
        &scene,
        &runner,
        bench,
        &context.run.options(),
        &context.progress,
        &mut |so_far| outputs.write_files(so_far, || so_far.plot()).map(drop),
    )?;
    outputs.write(context, &report.text(), &report, || report.plot())
}

fn tsdr(
    path: &Path,
    bench: &TsdrBench,
    work: &Work,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    let scene = read_scene(path, context)?;
    let runner = work.workplace(context)?.runner(path)?;
    let report = bench_tsdr(&scene, &runner, bench, &context.progress)?;
    outputs.write(context, &report.text(), &report, no_plot)
}

fn tables(
    scenes: &[PathBuf],
    bench: &TablesBench,
    work: &Work,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    let workplace = work.workplace_of(&Config {
        eval: bench.evaluation(&context.config.eval),
        solve: SolveRequest {
            no_report: bench.quick || context.config.solve.no_report,
            ..context.config.solve.clone()
        },
        ..context.config.clone()
    })?;
    let found = match &outputs.json_file {
        Some(path) if path.metadata().is_ok_and(|m| m.len() > 0) => TablesReport::read(path)?,
        _ => TablesReport::default(),
    };
    let mut loaded = Vec::new();
    for path in scenes {
        loaded.push(read_scene(path, context)?);
    }
    let report = bench_tables(
        &loaded,
        bench,
        &workplace,
        found,
        &context.progress,
        &mut |so_far| outputs.write_files(so_far, no_plot).map(drop),
    );
    workplace.clear();
    let report = report?;
    outputs.write(context, &report.text(), &report, no_plot)
}

fn robustness(
    path: &Path,
    bench: &RobustnessBench,
    work: &Work,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    let scene = read_scene(path, context)?;
    let workplace = work.workplace(context)?;
    let report = bench_robustness(
        &scene,
        bench,
        context.seed(),
        &workplace,
        &context.progress,
        &mut |so_far| outputs.write_files(so_far, no_plot).map(drop),
    );
    workplace.clear();
    let report = report?;
    outputs.write(context, &report.text(), &report, no_plot)
}

fn scaling(
    path: &Path,
    bench: &ScalingBench,
    work: &Work,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    let runner = work.workplace(context)?.runner(path)?;
    let report = bench_scaling(&runner, bench, &context.progress)?;
    outputs.write(context, &report.text(), &report, || report.plot())
}

fn alignment(
    scenes: &[PathBuf],
    bench: &AlignmentBench,
    outputs: &Outputs,
    context: &Context,
) -> Result<()> {
    outputs.check()?;
    // display-referred photographs will do: nothing is solved
    let load = LoadOptions {
        ldr: LdrImages::Auto,
        ..context.config.scene.clone()
    };
    let (mut all, mut text, mut sum) = (Vec::new(), String::new(), (0, 0));
    for scene in scenes {
        let figures = bench_alignment(scene, &load, bench)?;
        let (found, of) = figures.recognised();
        sum = (sum.0 + found, sum.1 + of);
        text += &figures.to_string();
        all.push(figures);
    }
    text += &format!("recognised in all: {} of {}\n", sum.0, sum.1);
    outputs.write(context, &text, &all, no_plot)
}

/// After the verb `bench`, turns `--json FILE` into `--json-file FILE`: everywhere else `--json` is
/// a switch that takes no value.
pub(crate) fn with_json_file(arguments: Vec<OsString>) -> Vec<OsString> {
    let verb = arguments.iter().position(|a| a == "bench");
    let Some(verb) = verb.filter(|&v| v <= 1 || arguments[1].to_string_lossy().starts_with('-'))
    else {
        return arguments;
    };
    let value_follows = |i: usize| {
        arguments
            .get(i + 1)
            .is_some_and(|next| !next.to_string_lossy().starts_with('-'))
    };
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
        with_json_file(arguments)
            .iter()
            .map(|a| a.to_string_lossy().into_owned())
            .collect::<Vec<_>>()
            .join(" ")
    }

    #[test]
    fn every_knob_of_the_trade_is_a_flag_of_solve() {
        use clap::CommandFactory;
        let command = crate::cli::Cli::command();
        let solve = command.find_subcommand("solve").expect("verb");
        for (knob, values) in crate::programs::bench::KNOBS {
            for value in *values {
                let line = [
                    "unbake",
                    "solve",
                    "S",
                    "-o",
                    "O",
                    &format!("--{knob}"),
                    value,
                ];
                assert!(
                    command.clone().try_get_matches_from(line).is_ok(),
                    "--{knob} {value}"
                );
            }
        }
        let left_out = crate::programs::bench::APPROXIMATIONS
            .iter()
            .chain(crate::programs::bench::NEEDS);
        for (flag, value) in left_out.flat_map(|a| a.1) {
            let line = [
                "unbake",
                "solve",
                "S",
                "-o",
                "O",
                &format!("--{flag}"),
                value,
            ];
            assert!(
                command.clone().try_get_matches_from(line).is_ok(),
                "--{flag} {value}"
            );
        }
        let quality = solve
            .get_arguments()
            .find(|a| a.get_long() == Some("quality"))
            .expect("flag");
        for preset in crate::programs::bench::PRESETS {
            assert!(
                quality
                    .get_possible_values()
                    .iter()
                    .any(|v| v.get_name() == preset)
            );
        }
    }

    #[test]
    fn json_takes_a_file_after_bench_only() {
        assert_eq!(
            rewritten("unbake bench irt S --json F"),
            "unbake bench irt S --json-file F"
        );
        assert_eq!(
            rewritten("unbake --quiet bench irt S --json=F"),
            "unbake --quiet bench irt S --json-file=F"
        );
        assert_eq!(
            rewritten("unbake bench irt S --json"),
            "unbake bench irt S --json"
        );
        assert_eq!(
            rewritten("unbake bench irt S --json --full"),
            "unbake bench irt S --json --full"
        );
        assert_eq!(
            rewritten("unbake eval bench --json"),
            "unbake eval bench --json"
        );
    }
}
