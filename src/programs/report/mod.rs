//! What a run leaves for people to read: `manifest.json`, `report.json` and `report.html`.

mod calibration;
mod html;
mod jpeg;
mod pictures;
mod record;

pub use html::head;
pub use jpeg::{Picture, QUALITY, encode_jpeg};
pub use pictures::{
    Captioned, Photographer, ViewPictures, colour, display_gain, exposed, grey, report_camera,
    shrunk, spread,
};
pub use record::{
    InputFile, Machine, Recorder, RunRecord, SceneSummary, StageRecord, Versions, class_names,
    cpu_seconds, hash_inputs, machine, peak_bytes, restart_peak,
};

use crate::core::formats::atomic_write;
use crate::core::parallel::prelude::*;
use crate::error::{Error, Result};
use crate::programs::evaluate::Evaluation;
use crate::render::ViewRenderer;
use crate::scene::{Scene, Split, View};
use crate::solution::Solution;
use serde_json::json;
use std::path::Path;

/// Views of each split that the report shows.
const VIEWS_SHOWN: usize = 3;

impl Versions {
    /// The versions in use.
    #[must_use]
    pub fn current() -> Self {
        Self {
            unbake: env!("CARGO_PKG_VERSION").into(),
            embree: crate::core::trace::embree_version(),
            openimageio: crate::core::formats::version(),
        }
    }
}

/// The views that a report shows: a few of each split, evenly spread.
#[must_use]
pub fn shown_views(scene: &Scene) -> Vec<&View> {
    [Split::Test, Split::Train]
        .into_iter()
        .flat_map(|split| spread(scene, split, VIEWS_SHOWN))
        .collect()
}

/// What a report tells of.
#[derive(Clone, Copy)]
pub struct Reported<'a> {
    /// The scene that was solved.
    pub scene: &'a Scene,
    /// Its solution.
    pub solution: &'a Solution,
    /// How the run went.
    pub record: &'a RunRecord,
    /// Its scores, if there is a truth to score against.
    pub evaluation: Option<&'a Evaluation>,
}

/// Writes `report.json` and `report.html` into `folder`.
///
/// `views` are pictures already taken (an evaluation takes them on its way, with ground truth);
/// views that should be shown and are not among them are rendered here.
///
/// # Errors
/// If a view cannot be read or rendered, or `folder` cannot be written to.
pub fn write_report(
    folder: &Path,
    reported: Reported<'_>,
    renderer: &dyn ViewRenderer,
    mut views: Vec<ViewPictures>,
) -> Result<()> {
    let Reported {
        scene,
        solution,
        record,
        evaluation,
    } = reported;
    let photographer = Photographer::new(scene, solution)?;
    let mut missing = shown_views(scene);
    missing.retain(|view| !views.iter().any(|v| v.stem == view.stem));
    let rendered = missing.par_iter().map(|view| {
        let rendered = renderer.render(&report_camera(view, solution))?;
        photographer.view(view, &rendered, None)
    });
    views.extend(rendered.collect::<Result<Vec<_>>>()?);
    let shown: Vec<_> = views
        .iter()
        .map(|v| json!({"stem": v.stem, "held_out": v.split == Split::Test, "psnr": v.psnr, "ssim": v.ssim}))
        .collect();
    let mut report = json!({"run": record, "evaluation": evaluation, "views": shown});
    if let Some(f) = &record.findings {
        report["verdict"] = json!(f.verdict());
        report["albedo_at_bound_share"] = json!(f.albedo_at_bound.share);
        // other stages may have written more of these by hand
        if let Some(missing) = &f.light_missing {
            report["light_missing"] = json!(missing);
        }
    }
    report["alignment"] = json!(record.alignment);
    let bytes = serde_json::to_vec_pretty(&report)
        .map_err(|e| Error::Failed(format!("report.json: {e}")))?;
    atomic_write(folder.join("report.json"), &bytes)?;
    let mut atlas = photographer.atlas();
    atlas.extend(photographer.camera_masks()?);
    let page = html::Page {
        record,
        evaluation,
        views: &views,
        atlas: &atlas,
        lights: &solution.lamps,
        exposure: photographer.exposure(),
    };
    atomic_write(folder.join("report.html"), html::page(&page)?.as_bytes())
}
