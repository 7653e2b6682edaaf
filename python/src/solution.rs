//! Results: textures, lamps and verdict of an output folder, and pictures of it.

use crate::buffer;
use crate::camera::{Camera, Cameras};
use crate::options::Keywords;
use crate::said::{Raised, dictionary, usage};
use crate::watch::Watch;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use unbake::programs::edit::load_edited;
use unbake::programs::report::RunRecord;
use unbake::render::{
    FrameOptions, Lighting, PathTracedScene, RelightOptions, RenderOptions, read_cameras,
};
use unbake::{Progress, Result, RgbPlane};

/// Options of frames that say which pictures are made; the others say how they are stored.
const FRAMES: [&str; 4] = ["width", "height", "fov", "path"];

/// A result, as read from its folder.
#[pyclass(frozen)]
pub(crate) struct Solution {
    path: PathBuf,
    inner: Arc<unbake::Solution>,
}

impl Solution {
    /// The result in `path`.
    pub(crate) fn new(path: PathBuf, inner: unbake::Solution) -> Self {
        Self {
            path,
            inner: Arc::new(inner),
        }
    }

    /// Reads a folder, with its edits if it has any.
    pub(crate) fn load(path: &Path, progress: &Progress) -> Result<unbake::Solution> {
        load_edited(path, progress)
    }

    fn pictures<'py>(
        py: Python<'py>,
        images: Vec<RgbPlane>,
        one: bool,
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut arrays = Vec::with_capacity(images.len());
        for image in images {
            arrays.push(buffer::plane(py, &Arc::new(image), |image| image)?);
        }
        match arrays.as_slice() {
            [array] if one => Ok(array.clone()),
            _ => Ok(PyList::new(py, arrays)?.into_any()),
        }
    }
}

#[pymethods]
impl Solution {
    #[new]
    #[pyo3(signature = (path, *, progress=None, note=None))]
    fn read<'py>(
        py: Python<'py>,
        path: PathBuf,
        progress: Option<Bound<'py, PyAny>>,
        note: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Self> {
        let watch = Watch {
            progress,
            note,
            threads: None,
        };
        let inner = watch.run(py, |observer| Self::load(&path, &Progress::new(observer)))?;
        Ok(Self::new(path, inner))
    }

    #[getter(path)]
    fn shown_path(&self) -> PathBuf {
        self.path.clone()
    }
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.inner.origin.into()
    }
    #[getter]
    fn reflectance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.reflectance)
    }
    #[getter]
    fn lamps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.lamps)
    }
    #[getter]
    fn portals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.portals)
    }

    /// What `manifest.json` says.
    #[getter]
    fn manifest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let record = RunRecord::of_result(&self.path).raised(py)?;
        dictionary(py, &record)
    }

    /// How far the result is to be trusted.
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let record = RunRecord::of_result(&self.path).raised(py)?;
        let Some(findings) = record.and_then(|r| r.findings) else {
            return Ok(None);
        };
        let verdict = findings.verdict();
        let said = dictionary(py, &verdict)?;
        said.set_item("text", verdict.to_string())?;
        Ok(Some(said))
    }

    #[getter]
    fn irradiance_error<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        buffer::optional_plane(py, &self.inner, |s| s.irradiance_error.as_ref())
    }
    #[getter]
    fn albedo<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.albedo)
    }
    #[getter]
    fn roughness<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.roughness)
    }
    #[getter]
    fn irradiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.irradiance)
    }
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.radiance)
    }
    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.emission)
    }
    #[getter]
    fn confidence<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.confidence)
    }
    #[getter]
    fn labels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.labels)
    }
    #[getter]
    fn rooms<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.rooms)
    }
    #[getter]
    fn environment<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.environment)
    }
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.positions)
    }
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.normals)
    }
    #[getter]
    fn uvs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.uvs)
    }
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.triangles)
    }

    /// The cameras of a file like `transforms.json`.
    #[pyo3(signature = (path))]
    fn read_cameras(&self, py: Python<'_>, path: PathBuf) -> PyResult<Vec<Camera>> {
        let origin = self.inner.origin;
        let read = read_cameras(&path, origin, None).raised(py)?;
        let camera = |c| Camera::of(c, origin);
        Ok(read.cameras.into_iter().map(camera).collect())
    }

    /// Pictures in the photographed light.
    #[pyo3(signature = (cameras, *, progress=None, note=None, seed=0, threads=None, **options))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a method of Python")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        cameras: Cameras,
        progress: Option<Bound<'py, PyAny>>,
        note: Option<Bound<'py, PyAny>>,
        seed: u64,
        threads: Option<usize>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut keywords = Keywords::new(py, "render", options)?;
        let frames: FrameOptions = keywords.take_only(&FRAMES)?;
        let options: RenderOptions = keywords.take_only(&[
            "renderer",
            "show",
            "supersampling",
            "samples",
            "no_denoise",
            "diffuse_only",
            "flat",
        ])?;
        keywords.finish()?;
        let placed = cameras.frames(py, &frames, self.inner.origin)?;
        let watch = Watch {
            progress,
            note,
            threads,
        };
        let images = watch.run(py, |observer| {
            let progress = Progress::new(observer);
            let mut images = Vec::with_capacity(placed.len());
            options.render(&self.inner, &placed, seed, &progress, |_, image| {
                images.push(image.clone());
                Ok(())
            })?;
            Ok(images)
        })?;
        Self::pictures(py, images, cameras.is_one() && frames.path == 0)
    }

    /// Pictures in changed light.
    #[pyo3(signature = (cameras, *, lamps=None, add=None, environment=None, progress=None, note=None, seed=0, threads=None, **options))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a method of Python")]
    fn relight<'py>(
        &self,
        py: Python<'py>,
        cameras: Cameras,
        lamps: Option<&Bound<'py, PyAny>>,
        add: Option<&Bound<'py, PyAny>>,
        environment: Option<&Bound<'py, PyAny>>,
        progress: Option<Bound<'py, PyAny>>,
        note: Option<Bound<'py, PyAny>>,
        seed: u64,
        threads: Option<usize>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let lighting = lighting(
            py,
            [("lamp", lamps), ("add", add), ("environment", environment)],
        )?;
        let mut keywords = Keywords::new(py, "relight", options)?;
        let frames: FrameOptions = keywords.take_only(&FRAMES)?;
        let names = ["samples", "max_samples", "error", "no_denoise"];
        let options: RelightOptions = keywords.take_only(&names)?;
        keywords.finish()?;
        let settings = options.tracing(seed).raised(py)?;
        let placed = cameras.frames(py, &frames, self.inner.origin)?;
        let watch = Watch {
            progress,
            note,
            threads,
        };
        let images = watch.run(py, |observer| {
            let world = lighting.world(&self.inner)?;
            let stage = PathTracedScene::new(&world)?;
            let mut images = Vec::with_capacity(placed.len());
            let keep = |_, image: &RgbPlane| {
                images.push(image.clone());
                Ok(())
            };
            let progress = Progress::new(observer);
            stage.render(&placed, &settings, &progress, |_, _| Ok(()), keep)?;
            Ok(images)
        })?;
        Self::pictures(py, images, cameras.is_one() && frames.path == 0)
    }

    fn __repr__(&self) -> String {
        let s = &self.inner;
        format!(
            "<unbake.Solution {:?}: albedo {}x{}, roughness {}x{}, irradiance {}x{}, {} lamps>",
            self.path,
            s.albedo.width,
            s.albedo.height,
            s.roughness.width,
            s.roughness.height,
            s.irradiance.width,
            s.irradiance.height,
            s.lamps.len()
        )
    }
}

/// A lighting from the tables of a lighting file.
fn lighting(py: Python<'_>, tables: [(&str, Option<&Bound<'_, PyAny>>); 3]) -> PyResult<Lighting> {
    let mut all = json!({});
    for (name, table) in tables {
        if let Some(table) = table {
            all[name] = pythonize::depythonize::<Value>(table)?;
        }
    }
    let wrong = |what: String| usage(py, format!("relight: {what}"));
    let lighting: Lighting = serde_json::from_value(all).map_err(|e| wrong(e.to_string()))?;
    lighting.check().map_err(wrong)?;
    Ok(lighting)
}
