//! `unbake check`.

use crate::alignment::{Alignment, align};
use crate::cli::context::Context;
use crate::error::{Error, Result};
use crate::scene::{CheckReport, check_scene as check_pixels, load_for_check};
use std::path::Path;

pub(crate) fn check_scene(path: &Path, context: &Context) -> Result<u8> {
    let (mut report, scene) = context.progress.stage("reading the scene", 1, |_| {
        load_for_check(path, &context.config.scene)
    });
    let mut alignment = None;
    if let Some(mut scene) = scene {
        let tested = context.progress.stage("testing the alignment", 1, |_| {
            align(&mut scene, &context.config.alignment)
        });
        context.progress.stage("checking the scene", 1, |_| {
            check_pixels(&scene, &mut report);
        });
        alignment = judged(tested, &mut report);
    }
    let mut json =
        serde_json::to_value(&report).map_err(|e| Error::Failed(format!("check: {e}")))?;
    json["alignment"] =
        serde_json::to_value(&alignment).map_err(|e| Error::Failed(format!("check: {e}")))?;
    let head = alignment.map_or(String::new(), |a| format!("{a}\n"));
    context.result(&format!("{head}{report}"), &json)?;
    Ok(report.exit_code())
}

/// Takes misalignment into the report's problems. Files that cannot be read are problems of the
/// report already.
fn judged(tested: Result<Alignment>, report: &mut CheckReport) -> Option<Alignment> {
    match tested {
        Ok(a) => {
            report.problems.extend(a.problem());
            report.warnings.extend(a.warning());
            Some(a)
        }
        Err(e) => {
            if report.problems.is_empty() {
                report.problems.push(e.to_string());
            }
            None
        }
    }
}
