//! What `solve` and `delight` leave behind: the textures, the report and the manifest, and what is
//! to be said of them.

use super::Run;
use crate::alignment::Alignment;
use crate::core::progress::Progress;
use crate::error::Result;
use crate::pipeline::SolveOptions;
use crate::programs::report::{InputFile, Reported, RunRecord, write_report};
use crate::render::{HybridOptions, HybridRenderer};
use crate::scene::Scene;
use crate::solution::{SaveOptions, Solution};
use crate::verdict::{Findings, Verdict};
use std::path::Path;

/// A reconstruction that is to be written.
pub struct RunResult {
    /// What was reconstructed.
    pub solution: Solution,
    /// What was found of its faults.
    pub findings: Findings,
    /// Whether photographs and mesh fitted, where there are photographs.
    pub alignment: Option<Alignment>,
    /// The files it was made from.
    pub inputs: Vec<InputFile>,
    /// The numbers it was made with.
    pub options: SolveOptions,
}

/// A run that wrote its result.
pub struct SolvedRun {
    /// What was reconstructed, at the precision of the computation; files hold less.
    pub solution: Solution,
    /// What `manifest.json` says.
    pub record: RunRecord,
    /// What to think of it.
    pub verdict: Verdict,
}

impl RunResult {
    /// Writes everything into `out`; `scene` is what it was reconstructed from.
    ///
    /// # Errors
    /// Textures that are not finite, views that cannot be read for the report, a folder that cannot
    /// be written to.
    pub fn write(self, scene: &Scene, out: &Path, run: &Run) -> Result<SolvedRun> {
        let (progress, solution) = (&run.progress, &self.solution);
        let generation = progress.stage("writing the textures", 1, |_| {
            solution.save(out, &SaveOptions::default())
        })?;
        let verdict = self.findings.verdict();
        let mut record = run.record(scene, self.inputs, &self.options)?;
        record.generation = generation;
        record.findings = Some(self.findings);
        record.alignment = self.alignment;
        let report = |_: &Progress| {
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
                scene,
                solution,
                record: &record,
                evaluation: None,
            };
            write_report(out, reported, &renderer, Vec::new())
        };
        if !run.request.solve.no_report {
            progress.stage("report", 1, report)?;
        }
        record.measure(&run.recorder);
        record.write_manifest(out)?;
        Ok(SolvedRun {
            solution: self.solution,
            record,
            verdict,
        })
    }
}
