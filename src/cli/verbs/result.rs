//! What `solve` and `delight` leave behind: the textures, the report and the manifest, and what is
//! said of them.

use crate::alignment::Alignment;
use crate::cli::context::Context;
use crate::cli::run_record::record;
use crate::error::Result;
use crate::programs::report::{InputFile, Reported, RunRecord, write_report};
use crate::render::{HybridOptions, HybridRenderer};
use crate::scene::Scene;
use crate::solution::{SaveOptions, Solution};
use crate::verdict::{Findings, Verdict};
use std::path::Path;
use std::time::Duration;

/// A reconstruction that is to be written.
pub(super) struct RunResult<'a> {
    /// What was reconstructed, and what of.
    pub scene: &'a Scene,
    pub solution: Solution,
    pub findings: Findings,
    /// Whether photographs and mesh fitted, where there are photographs.
    pub alignment: Option<Alignment>,
    pub inputs: Vec<InputFile>,
}

/// A run that wrote its result.
pub(super) struct SolvedRun {
    /// What `manifest.json` says.
    pub record: RunRecord,
    /// What to think of it.
    pub verdict: Verdict,
    /// Sizes, time and verdict for people.
    pub text: String,
}

impl RunResult<'_> {
    /// Writes everything into `out`.
    pub(super) fn write(self, out: &Path, context: &Context) -> Result<SolvedRun> {
        let (progress, solution) = (&context.progress, &self.solution);
        let generation = progress.stage("writing the textures", 1, |_| {
            solution.save(out, &SaveOptions::default())
        })?;
        let verdict = self.findings.verdict();
        let mut record = record(self.scene, self.inputs, context)?;
        record.generation = generation;
        record.findings = Some(self.findings);
        record.alignment = self.alignment;
        progress.stage("report", 1, |_| {
            // one sample per pixel is enough for pictures of this size; `unbake eval` renders at
            // full quality
            let renderer = HybridRenderer::new(
                solution,
                HybridOptions {
                    supersampling: 1,
                    ..HybridOptions::default()
                },
            )?;
            let reported = Reported {
                scene: self.scene,
                solution,
                record: &record,
                evaluation: None,
            };
            write_report(out, reported, &renderer, Vec::new())
        })?;
        record.measure(&context.recorder);
        record.write_manifest(out)?;
        let s = solution;
        let text = format!(
            "albedo {}x{}, roughness {}x{}, irradiance {}x{} in {} ({:.2} GiB at most, {} threads)\n{} lights in lights.json\nreport: {}\n{verdict}\n",
            s.albedo.width,
            s.albedo.height,
            s.roughness.width,
            s.roughness.height,
            s.irradiance.width,
            s.irradiance.height,
            crate::cli::progress::seconds(Duration::from_secs_f64(record.wall_seconds)),
            record.peak_bytes as f64 / (1u64 << 30) as f64,
            record.machine.threads,
            s.lamps.len(),
            out.join("report.html").display()
        );
        Ok(SolvedRun {
            record,
            verdict,
            text,
        })
    }
}
