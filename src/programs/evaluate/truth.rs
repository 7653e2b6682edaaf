//! Ground truth of a view, from a scene's `gt/` folder; read by the scores.

use crate::core::formats::{read_plane, read_rgb};
use crate::core::geometry::Camera;
use crate::core::image::{Plane, RgbPlane};
use crate::error::{Error, Result};
use crate::scene::{Scene, View};
use std::path::{Path, PathBuf};

/// True materials of one view at the frame's size.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    /// Linear RGB albedo.
    pub albedo: RgbPlane,
    /// Roughness R.
    pub roughness: Plane<f32>,
    /// Share of metal, where the truth says it; the albedo holds what metal reflects at normal
    /// incidence.
    pub metallic: Option<Plane<f32>>,
    /// Share of transmitted light, where the truth says it; the albedo holds the tint of panes.
    pub transmission: Option<Plane<f32>>,
}

/// An image of ground truth must be as large as its frame.
pub(super) fn check_size(path: &Path, width: usize, height: usize, camera: &Camera) -> Result<()> {
    if (width, height) == (camera.width, camera.height) {
        return Ok(());
    }
    Err(Error::input(
        path,
        format!(
            "is {width}×{height}, but its frame is {}×{}; make them agree",
            camera.width, camera.height
        ),
    ))
}

/// Where the truth of a view lies.
fn file_of(scene: &Scene, view: &View, kind: &str) -> PathBuf {
    let folder = scene.folder.join("gt").join(kind);
    folder.join(format!("{}.exr", view.stem))
}

/// Whether the scene has the true materials of a view.
pub(super) fn has_true_materials(scene: &Scene, view: &View) -> bool {
    ["albedo", "roughness"]
        .iter()
        .all(|kind| file_of(scene, view, kind).is_file())
}

/// The true materials of a view, if the scene has them.
pub(crate) fn true_materials(scene: &Scene, view: &View) -> Result<Option<GroundTruth>> {
    let file = |kind: &str| file_of(scene, view, kind);
    let (albedo, roughness) = (file("albedo"), file("roughness"));
    let share = |path: &Path| -> Result<Option<Plane<f32>>> {
        let plane = path.is_file().then(|| read_plane(path)).transpose()?;
        if let Some(plane) = &plane {
            check_size(path, plane.width, plane.height, &view.camera)?;
        }
        Ok(plane)
    };
    if !has_true_materials(scene, view) {
        return Ok(None);
    }
    let truth = GroundTruth {
        albedo: read_rgb(&albedo)?,
        roughness: read_plane(&roughness)?,
        metallic: share(&file("metallic"))?,
        transmission: share(&file("transmission"))?,
    };
    check_size(
        &albedo,
        truth.albedo.width,
        truth.albedo.height,
        &view.camera,
    )?;
    check_size(
        &roughness,
        truth.roughness.width,
        truth.roughness.height,
        &view.camera,
    )?;
    Ok(Some(truth))
}
