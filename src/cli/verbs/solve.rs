//! `unbake solve`.

use crate::cli::context::Context;
use crate::cli::progress::seconds;
use crate::core::memory::gibibytes;
use crate::error::Result;
use crate::programs::run::SolvedRun;
use serde_json::json;
use std::path::Path;
use std::time::Duration;

pub(crate) fn solve(scene: &Path, out: &Path, context: &Context) -> Result<()> {
    say(&context.run.solve(scene, out)?, out, context)
}

/// Prints what was solved.
pub(super) fn say(run: &SolvedRun, out: &Path, context: &Context) -> Result<()> {
    context.result(
        &summary(run, out),
        &json!({"out": out, "run": run.record, "verdict": run.verdict}),
    )
}

/// Sizes, time and verdict for people.
pub(super) fn summary(run: &SolvedRun, out: &Path) -> String {
    let (s, record) = (&run.solution, &run.record);
    let page = out.join("report.html");
    let report = match page.exists() {
        true => format!("report: {}\n", page.display()),
        false => String::new(),
    };
    format!(
        "albedo {}x{}, roughness {}x{}, irradiance {}x{} in {} ({:.2} GiB at most, {} threads)\n{} lights in lights.json\n{}{}\n",
        s.albedo.width,
        s.albedo.height,
        s.roughness.width,
        s.roughness.height,
        s.irradiance.width,
        s.irradiance.height,
        seconds(Duration::from_secs_f64(record.wall_seconds)),
        gibibytes(record.peak_bytes),
        record.machine.threads,
        s.lamps.len(),
        report,
        run.verdict
    )
}
