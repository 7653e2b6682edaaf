//! `unbake bench robustness`: what damaged input costs. Every condition is a copy of the scene,
//! damaged in a known way, reconstructed in a process of its own and scored against ground truth on
//! the untouched held-out views.

use super::child::{Outcome, Workplace};
use super::damage::{CONDITIONS, Damage, write_damaged};
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::report::{Machine, SceneSummary, Versions, machine};
use crate::scene::Scene;
use serde::Serialize;
use std::fmt::Write as _;

/// What `unbake bench robustness` can be told.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct RobustnessBench {
    /// Conditions to run besides `clean`, separated by commas; a part of the name will do. All by
    /// default.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Write the damaged copies of the scene and stop: for looking at them, or solving them by
    /// hand.
    #[arg(long)]
    pub copies_only: bool,
    /// Flags for every `unbake solve`, as one string: for instance "--quality draft".
    #[arg(
        long,
        value_name = "FLAGS",
        default_value = "",
        allow_hyphen_values = true
    )]
    pub solve_flags: String,
}

impl RobustnessBench {
    /// The conditions asked for: `clean`, and those whose names hold a part given by `--only`.
    fn conditions(&self) -> Result<Vec<&'static (&'static str, Damage)>> {
        for name in &self.only {
            if !CONDITIONS.iter().any(|c| c.0.contains(name.as_str())) {
                let known: Vec<&str> = CONDITIONS.iter().map(|c| c.0).collect();
                return Err(Error::Usage(format!(
                    "--only {name}: no such condition; there are {}",
                    known.join(", ")
                )));
            }
        }
        let asked = |name: &str| {
            self.only.is_empty() || self.only.iter().any(|o| name.contains(o.as_str()))
        };
        Ok(CONDITIONS
            .iter()
            .filter(|(name, _)| *name == "clean" || asked(name))
            .collect())
    }
}

/// One condition's result.
#[derive(Clone, Debug, Serialize)]
pub struct RobustnessPoint {
    /// Name of the condition.
    pub condition: String,
    /// Quality and cost.
    #[serde(flatten)]
    pub outcome: Outcome,
    /// What the reconstruction decided and noted: exposure, clipping and the like.
    pub notes: Vec<String>,
}

/// Everything `unbake bench robustness` measures.
#[derive(Clone, Debug, Serialize)]
pub struct RobustnessReport {
    /// Conditions in the order they were run; the first is `clean`.
    pub points: Vec<RobustnessPoint>,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
    /// The scene.
    pub scene: SceneSummary,
}

/// Runs the conditions, each with folders of its own in `work`; `each` sees the report after every
/// one.
///
/// # Errors
/// An unknown condition, a scene that cannot be copied, or a reconstruction that fails.
pub fn bench_robustness(
    scene: &Scene,
    bench: &RobustnessBench,
    seed: u64,
    work: &Workplace,
    progress: &Progress,
    each: &mut dyn FnMut(&RobustnessReport) -> Result<()>,
) -> Result<RobustnessReport> {
    let chosen = bench.conditions()?;
    let flags: Vec<String> = bench
        .solve_flags
        .split_whitespace()
        .map(String::from)
        .collect();
    let mut report = RobustnessReport {
        points: Vec::new(),
        versions: Versions::current(),
        machine: machine(),
        scene: SceneSummary::of(scene),
    };
    std::fs::create_dir_all(&work.folder).map_err(|e| Error::io(&work.folder, e))?;
    progress.stage("conditions", chosen.len() as u64, |p| {
        for (name, damage) in chosen {
            let folder = work.folder.join(format!("scene-{name}"));
            write_damaged(scene, *damage, seed, &folder)?;
            if bench.copies_only {
                p.note(format!("{name}: written to {}", folder.display()));
                continue;
            }
            let runner = work.within(&format!("run-{name}")).runner(&folder)?;
            let (outcome, notes) = runner.run("out", &flags, |out| {
                let record =
                    crate::programs::report::RunRecord::read_manifest(out).unwrap_or_default();
                Ok(record
                    .decisions
                    .iter()
                    .map(ToString::to_string)
                    .chain(record.notes)
                    .collect())
            })?;
            report.points.push(RobustnessPoint {
                condition: (*name).to_owned(),
                outcome,
                notes,
            });
            p.note(report.line(report.points.len() - 1));
            p.advance(1);
            each(&report)?;
        }
        Ok::<(), Error>(())
    })?;
    Ok(report)
}

impl RobustnessReport {
    fn line(&self, i: usize) -> String {
        let (clean, o) = (&self.points[0].outcome, &self.points[i].outcome);
        let cell = |value: Option<f64>, clean: Option<f64>| match (value, clean) {
            (Some(v), Some(c)) => format!("{v:6.2} dB ({:+.2})", v - c),
            _ => "        --       ".to_owned(),
        };
        let stated = o.albedo_calibration.map_or_else(String::new, |c| {
            format!(
                "  stated {:.3} actual {:.3} within 2: {:3.0} %",
                c.stated,
                c.actual,
                100.0 * c.within_2
            )
        });
        let verdict = o
            .verdict
            .as_ref()
            .map_or_else(String::new, |v| format!("  {}", v.level));
        format!(
            "{:<22} albedo {}  roughness {}  novel views {}{stated}{verdict}",
            self.points[i].condition,
            cell(o.albedo_psnr, clean.albedo_psnr),
            cell(o.roughness_psnr, clean.roughness_psnr),
            cell(o.novel_psnr, clean.novel_psnr)
        )
    }

    /// The table of the terminal: condition, three PSNRs and their change against `clean`.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        // writing to a string cannot fail
        let _ = writeln!(
            out,
            "{}: {} training views of {}x{}; PSNR over the held-out views (change against clean)",
            self.scene.name,
            self.scene.training_views,
            self.scene.image_size[0],
            self.scene.image_size[1]
        );
        for i in 0..self.points.len() {
            let _ = writeln!(out, "{}", self.line(i));
        }
        out
    }
}
