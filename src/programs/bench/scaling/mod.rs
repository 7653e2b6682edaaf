//! `unbake bench scaling`: what a reconstruction takes on more cores than are at hand.
//!
//! Measured: whole runs on 1, 2, … threads of this machine. Simulated: one run on one thread whose
//! pieces of work are recorded (`core::parallel::tape`), scheduled on more threads. The method, and
//! what it leaves out, is in docs/scale.md.

mod report;
mod simulate;

use super::child::Runner;
use super::median;
use crate::core::parallel::prelude::*;
use crate::core::parallel::tape::Tape;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::report::RunRecord;
use report::{Measured, ScalingReport, StageScaling, THREADS};
use simulate::Work;
use std::time::Instant;

/// What `unbake bench scaling` can be told.
#[derive(clap::Args, Clone, Debug)]
pub struct ScalingBench {
    /// Preset of the reconstruction.
    #[arg(long, value_enum, default_value = "standard")]
    pub quality: crate::pipeline::Quality,
    /// Further flags of `unbake solve`, in one string.
    #[arg(
        long,
        value_name = "FLAGS",
        default_value = "",
        allow_hyphen_values = true
    )]
    pub flags: String,
    /// Record and simulate alone: no measured runs on several threads.
    #[arg(long)]
    pub simulate_only: bool,
}

/// Records a reconstruction, runs others on every number of threads of this machine, and works out
/// the curve.
///
/// # Errors
/// A reconstruction that fails.
pub fn bench_scaling(
    runner: &Runner,
    bench: &ScalingBench,
    progress: &Progress,
) -> Result<ScalingReport> {
    let most = rayon::current_num_threads();
    let counts = (1..=most).filter(|n| n.is_power_of_two() || *n == most);
    let counts: Vec<usize> = counts.filter(|_| !bench.simulate_only).collect();
    progress.stage("scaling", 1 + counts.len() as u64, |p| {
        let path = runner.folder("tape");
        let tape_flag = ["--tape".to_owned(), path.to_string_lossy().into_owned()];
        let recorded = solve(runner, bench, 1, &tape_flag)?;
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
        let tape = Tape::from_bytes(&bytes)
            .ok_or_else(|| Error::Failed(format!("{}: not a tape", path.display())))?;
        let stages = simulate::stages(&tape);
        p.advance(1);
        let mut measured = Vec::new();
        for threads in counts {
            let record = solve(runner, bench, threads, &[])?;
            measured.push(Measured::of(threads, &record));
            p.advance(1);
        }
        Ok(curve(&stages, measured, &recorded))
    })
}

/// A reconstruction on so many threads, and the record of it.
fn solve(
    runner: &Runner,
    bench: &ScalingBench,
    threads: usize,
    more: &[String],
) -> Result<RunRecord> {
    let quality = clap::ValueEnum::to_possible_value(&bench.quality);
    let quality = quality.map_or_else(String::new, |v| v.get_name().to_owned());
    let mut flags = vec!["--quality".to_owned(), quality];
    flags.extend(["--threads".to_owned(), threads.to_string()]);
    flags.extend(bench.flags.split_whitespace().map(str::to_owned));
    flags.extend(more.iter().cloned());
    runner.solve(&format!("threads-{threads}"), &flags)
}

/// The curve of all stages, and which of them bend it.
fn curve(
    stages: &[(String, Work)],
    measured: Vec<Measured>,
    recorded: &RunRecord,
) -> ScalingReport {
    let loss = loop_seconds();
    let on = |work: &Work, threads: usize| work.on(threads, loss * (threads as f64).log2());
    let stages: Vec<StageScaling> = stages
        .iter()
        .map(|(name, work)| StageScaling {
            name: name.clone(),
            work_seconds: work.total(),
            serial_seconds: work.alone(),
            loops: work.loops(),
            seconds: THREADS.iter().map(|n| (*n, on(work, *n))).collect(),
            measured: measured.iter().filter_map(|m| m.stage(name)).collect(),
        })
        .collect();
    ScalingReport::new(stages, measured, loss, recorded)
}

/// Seconds lost at the beginning and end of a parallel loop of this machine, per doubling of the
/// threads: an empty loop on all of them, over the depth of its tree.
fn loop_seconds() -> f64 {
    let threads = rayon::current_num_threads();
    if threads < 2 {
        return 0.0;
    }
    let mut seconds: Vec<f64> = (0..201)
        .map(|_| {
            let start = Instant::now();
            (0..threads).into_par_iter().with_max_len(1).for_each(|i| {
                std::hint::black_box(i);
            });
            start.elapsed().as_secs_f64()
        })
        .collect();
    median(&mut seconds) / (threads as f64).log2()
}
