//! The figures of `unbake bench scaling` as JSON, a table and a plot.

use super::super::plot::{Chart, Series, svg};
use crate::Result;
use crate::programs::report::{Machine, RunRecord, SceneSummary, Versions, machine};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Numbers of threads of the curve.
pub(super) const THREADS: [usize; 8] = [1, 2, 4, 8, 16, 32, 64, 128];

/// Stages named as those that bend the curve.
const BENDING: usize = 3;

/// A run of this machine.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Threads.
    pub threads: usize,
    /// Elapsed time, seconds.
    pub wall_seconds: f64,
    /// Processor time, seconds.
    pub cpu_seconds: f64,
    /// Largest resident size, bytes.
    pub peak_bytes: u64,
    #[serde(skip)]
    stages: Vec<(String, f64, f64)>,
}

/// A stage of a run of this machine.
#[derive(Clone, Debug, Serialize)]
pub struct MeasuredStage {
    /// Threads.
    pub threads: usize,
    /// Elapsed time, seconds.
    pub wall_seconds: f64,
    /// Processor time of all threads, seconds.
    pub cpu_seconds: f64,
}

impl Measured {
    pub(super) fn of(threads: usize, record: &RunRecord) -> Self {
        let mut stages: Vec<(String, f64, f64)> = Vec::new();
        for s in record.stages.iter().filter(|s| s.depth == 0) {
            match stages.iter_mut().find(|(name, ..)| *name == s.name) {
                Some((_, wall, cpu)) => {
                    *wall += s.wall_seconds;
                    *cpu += s.cpu_seconds;
                }
                None => stages.push((s.name.clone(), s.wall_seconds, s.cpu_seconds)),
            }
        }
        Self {
            threads,
            wall_seconds: record.wall_seconds,
            cpu_seconds: record.cpu_seconds,
            peak_bytes: record.peak_bytes,
            stages,
        }
    }

    pub(super) fn stage(&self, name: &str) -> Option<MeasuredStage> {
        let (_, wall_seconds, cpu_seconds) = *self.stages.iter().find(|(n, ..)| n == name)?;
        Some(MeasuredStage {
            threads: self.threads,
            wall_seconds,
            cpu_seconds,
        })
    }
}

/// A stage on more and more threads.
#[derive(Clone, Debug, Serialize)]
pub struct StageScaling {
    /// The stage's name.
    pub name: String,
    /// Processor time on one thread, seconds.
    pub work_seconds: f64,
    /// The part outside of parallel loops, seconds.
    pub serial_seconds: f64,
    /// Parallel loops.
    pub loops: usize,
    /// Threads and simulated seconds.
    pub seconds: BTreeMap<usize, f64>,
    /// As measured on this machine.
    pub measured: Vec<MeasuredStage>,
}

impl StageScaling {
    /// Seconds beyond an even share of the work.
    fn lost(&self, threads: usize) -> f64 {
        let taken = self.seconds.get(&threads).copied().unwrap_or(0.0);
        taken - self.work_seconds / threads as f64
    }
}

/// Everything `unbake bench scaling` says.
#[derive(Clone, Debug, Serialize)]
pub struct ScalingReport {
    /// Share of the processor time outside of parallel loops.
    pub serial_share: f64,
    /// Threads, and the speed-up over their number, simulated.
    pub efficiency: BTreeMap<usize, f64>,
    /// Threads and simulated seconds of the whole run.
    pub seconds: BTreeMap<usize, f64>,
    /// The stages that lose most at 64 threads, worst first, with the seconds they lose.
    pub bending: Vec<(String, f64)>,
    /// The stages in order.
    pub stages: Vec<StageScaling>,
    /// Whole runs of this machine.
    pub measured: Vec<Measured>,
    /// Seconds that a loop was taken to cost per doubling of the threads.
    pub loop_seconds: f64,
    /// Processor time on the tape, and of the process that wrote it: the difference is work of
    /// other libraries' threads and the recorder's own.
    pub recorded_seconds: f64,
    /// Processor time of the recording process.
    pub process_seconds: f64,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
    /// The scene.
    pub scene: SceneSummary,
}

/// Threads at which the stages that bend the curve are told.
const AT: usize = 64;

impl ScalingReport {
    pub(super) fn new(
        stages: Vec<StageScaling>,
        measured: Vec<Measured>,
        loop_seconds: f64,
        recorded: &RunRecord,
    ) -> Self {
        let work: f64 = stages.iter().map(|s| s.work_seconds).sum();
        let serial: f64 = stages.iter().map(|s| s.serial_seconds).sum();
        let total = |n: usize| stages.iter().filter_map(|s| s.seconds.get(&n)).sum::<f64>();
        let seconds: BTreeMap<usize, f64> = THREADS.iter().map(|n| (*n, total(*n))).collect();
        let efficient = |(n, s): (&usize, &f64)| (*n, work / s.max(1e-12) / *n as f64);
        let mut bending: Vec<(String, f64)> = stages
            .iter()
            .map(|s| (s.name.clone(), s.lost(AT)))
            .collect();
        bending.sort_by(|a, b| b.1.total_cmp(&a.1));
        bending.truncate(BENDING);
        Self {
            serial_share: serial / work.max(1e-12),
            efficiency: seconds.iter().map(efficient).collect(),
            seconds,
            bending,
            stages,
            measured,
            loop_seconds,
            recorded_seconds: work,
            process_seconds: recorded.cpu_seconds,
            versions: Versions::current(),
            machine: machine(),
            scene: recorded.scene.clone(),
        }
    }

    /// A table for people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::from(
            "stage                           work    serial  loops  seconds on 16      64     128 \
             threads\n",
        );
        for s in &self.stages {
            let on = |n| s.seconds.get(&n).copied().unwrap_or(0.0);
            let _ = writeln!(
                out,
                "{:<28} {:>7.3} {:>9.4} {:>6} {:>14.3} {:>7.3} {:>7.3}",
                s.name,
                s.work_seconds,
                s.serial_seconds,
                s.loops,
                on(16),
                on(64),
                on(128)
            );
        }
        let _ = writeln!(
            out,
            "serial: {:.2} % of {:.1} s on the tape ({:.1} s of the process)",
            100.0 * self.serial_share,
            self.recorded_seconds,
            self.process_seconds
        );
        for (n, e) in &self.efficiency {
            let _ = writeln!(
                out,
                "{n:>4} threads: {:.2} s, x{:.1}, efficiency {:.0} %",
                self.seconds[n],
                e * *n as f64,
                100.0 * e
            );
        }
        for m in &self.measured {
            let _ = writeln!(
                out,
                "measured on {} threads: {:.2} s, {:.2} s of processor time",
                m.threads, m.wall_seconds, m.cpu_seconds
            );
        }
        for (name, lost) in &self.bending {
            let _ = writeln!(out, "bends the curve at {AT} threads: {name}, {lost:.3} s");
        }
        out
    }

    /// Speed-up over threads, and the seconds of the stages that bend it.
    ///
    /// # Errors
    /// The drawing library failing.
    pub fn plot(&self) -> Result<String> {
        let line = |name: &str, points: Vec<(f64, f64)>, line| Series {
            name: name.into(),
            points,
            line,
        };
        let faster = |(n, e): (&usize, &f64)| (*n as f64, e * *n as f64);
        let first = self.measured.first().map_or(0.0, |m| m.wall_seconds);
        let measured = |m: &Measured| (m.threads as f64, first / m.wall_seconds.max(1e-12));
        let even = THREADS.map(|n| (n as f64, n as f64)).to_vec();
        let speed = vec![
            line(
                "simulated",
                self.efficiency.iter().map(faster).collect(),
                true,
            ),
            line("even shares", even, true),
            line(
                "measured",
                self.measured.iter().map(measured).collect(),
                false,
            ),
        ];
        let of = |name: &String| self.stages.iter().find(|s| s.name == *name);
        let bending = self.bending.iter().filter_map(|(name, _)| of(name));
        let curve = |s: &StageScaling| s.seconds.iter().map(|(n, t)| (*n as f64, *t)).collect();
        let mut stages: Vec<Series> = bending.map(|s| line(&s.name, curve(s), true)).collect();
        let all = self.seconds.iter().map(|(n, t)| (*n as f64, *t)).collect();
        stages.push(line("whole run", all, true));
        let chart = |title: &str, y: &str, series| Chart {
            title: title.into(),
            x: "threads".into(),
            y: y.into(),
            log_x: true,
            log_y: true,
            series,
        };
        svg(&[
            chart("Speed-up", "times one thread", speed),
            chart("Stages that bend the curve", "seconds", stages),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stage_that_loses_most_bends_the_curve() {
        let stage = |name: &str, serial: f64, work: f64| StageScaling {
            name: name.into(),
            work_seconds: work,
            serial_seconds: serial,
            loops: 1,
            seconds: THREADS
                .map(|n| (n, serial + (work - serial) / n as f64))
                .into(),
            measured: Vec::new(),
        };
        let stages = vec![stage("even", 0.0, 60.0), stage("alone", 4.0, 4.0)];
        let report = ScalingReport::new(stages, Vec::new(), 0.0, &RunRecord::default());
        assert_eq!(report.serial_share, 4.0 / 64.0);
        assert_eq!(report.bending[0].0, "alone");
        // Amdahl: 64 / (4 + 60/64) on 64 threads
        let expected = 64.0 / (4.0 + 60.0 / 64.0) / 64.0;
        assert!((report.efficiency[&64] - expected).abs() < 1e-9);
        assert!(
            report
                .text()
                .contains("bends the curve at 64 threads: alone")
        );
        assert!(report.plot().expect("draws").contains("Speed-up"));
    }
}
