//! Everything that is wrong with a scene, its alignment included. Called by `unbake check` and the
//! Python module.

use crate::alignment::{Alignment, AlignmentOptions, align};
use crate::core::progress::Progress;
use crate::error::Result;
use crate::scene::{CheckReport, LoadOptions, check_scene as check_pixels, load_for_check};
use serde::Serialize;
use std::fmt;
use std::path::Path;

/// What is understood of a scene, and what is wrong with it.
#[derive(Serialize)]
pub struct CheckedScene {
    /// Files, keys, pixels.
    #[serde(flatten)]
    pub report: CheckReport,
    /// Whether photographs and mesh fit; `None` where that could not be tested.
    pub alignment: Option<Alignment>,
}

/// Reads a scene and tests it; what is wrong with it is the result and no error.
#[must_use]
pub fn check_scene(
    path: &Path,
    load: &LoadOptions,
    options: &AlignmentOptions,
    progress: &Progress,
) -> CheckedScene {
    let (mut report, scene) =
        progress.stage("reading the scene", 1, |_| load_for_check(path, load));
    let mut alignment = None;
    if let Some(mut scene) = scene {
        let tested = progress.stage("testing the alignment", 1, |_| align(&mut scene, options));
        progress.stage("checking the scene", 1, |_| {
            check_pixels(&scene, &mut report);
        });
        alignment = judged(tested, &mut report);
    }
    CheckedScene { report, alignment }
}

impl fmt::Display for CheckedScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(alignment) = &self.alignment {
            writeln!(f, "{alignment}")?;
        }
        self.report.fmt(f)
    }
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
