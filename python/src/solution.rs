//! Results: textures, lamps and verdict of an output folder, and pictures of it.

use crate::buffer;
use crate::camera::{Camera, Cameras};
use crate::options::Keywords;
use crate::said::{Raised, dictionary, usage};
use crate::watch::Watch;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use unbake::programs::edit::load_edited;
use unbake::programs::report::RunRecord;
use unbake::render::{
    FrameOptions, Lighting, PathTracedScene, RelightOptions, RenderOptions, read_cameras,
};
use unbake::{Progress, RgbPlane};

/// Options of frames that say which pictures are made; the others say how they are stored.
const FRAMES: [&str; 4] = ["width", "height", "fov", "path"];

/// A result of `solve`: textures, lamps, stated errors, verdict.
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
        let inner = watch.run(py, |observer| load_edited(&path, &Progress::new(observer)))?;
        Ok(Self::new(path, inner))
    }

    /// Its folder.
    #[getter(path)]
    fn shown_path(&self) -> PathBuf {
        self.path.clone()
    }
    /// What `positions` are relative to: a point in the coordinates of the scene's file.
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.inner.origin.into()
    }
    /// The reflection model that albedo and roughness belong to.
    #[getter]
    fn reflectance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.reflectance)
    }
    /// Luminous surfaces, most powerful first.
    #[getter]
    fn lamps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.lamps)
    }
    /// Openings to the environment, numbered on from the lamps.
    #[getter]
    fn portals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.inner.portals)
    }

    /// What `manifest.json` says of the run (docs/outputs.md).
    #[getter]
    fn manifest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let record = RunRecord::of_result(&self.path).raised(py)?;
        dictionary(py, &record)
    }

    /// How far the result is to be trusted; None of a folder without a manifest. Raises InputError for a manifest of another run.
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

    /// (rows, columns): relative standard error of the irradiance's luminance; None where nothing states it.
    #[getter]
    fn irradiance_error<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        buffer::optional_plane(py, &self.inner, |s| s.irradiance_error.as_ref())
    }
    /// (rows, columns): share of metal in [0, 1], of the albedo's shape; None where the scene has none.
    #[getter]
    fn metallic<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        buffer::optional_plane(py, &self.inner, |s| s.metallic.as_ref())
    }
    /// (rows, columns): share of light that goes straight through, in [0, 1], of the albedo's shape; None where the scene has
    /// no panes.
    #[getter]
    fn transmission<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        buffer::optional_plane(py, &self.inner, |s| s.transmission.as_ref())
    }
    /// (rows, columns, 3), linear RGB in [0, 1]; where there is metal, what it reflects at normal incidence.
    #[getter]
    fn albedo<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.albedo)
    }
    /// (rows, columns), R in [0, 1]; alpha = R².
    #[getter]
    fn roughness<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.roughness)
    }
    /// (rows, columns, 3), radiance unit times steradian.
    #[getter]
    fn irradiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.irradiance)
    }
    /// (rows, columns, 3): what leaves the surface, as observed.
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.radiance)
    }
    /// (rows, columns, 3): emitted radiance, 0 where none.
    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.emission)
    }
    /// (rows, columns, 2): standard errors of albedo and of roughness; 10000 = unobserved.
    #[getter]
    fn confidence<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.confidence)
    }
    /// (rows, columns): class ids, 0 = unlabelled.
    #[getter]
    fn labels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.labels)
    }
    /// (rows, columns): room ids, 0 = outside.
    #[getter]
    fn rooms<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.rooms)
    }
    /// (rows, columns, 3): radiance from directions without geometry, an equirectangular map in world axes.
    #[getter]
    fn environment<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::plane(py, &self.inner, |s| &s.environment)
    }
    /// (vertices, 3), metres relative to `origin`.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.positions)
    }
    /// (vertices, 3), unit vectors.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.normals)
    }
    /// (vertices, 2), places in the atlas in [0, 1], v down the rows.
    #[getter]
    fn uvs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.uvs)
    }
    /// (triangles, 3), rows of `positions`.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        buffer::list(py, &self.inner, |s| &s.mesh.triangles)
    }

    /// The cameras of a file in the form of transforms.json. Raises InputError for all that is wrong with it.
    #[pyo3(signature = (path))]
    fn read_cameras(&self, py: Python<'_>, path: PathBuf) -> PyResult<Vec<Camera>> {
        let origin = self.inner.origin;
        let read = read_cameras(&path, origin, None).raised(py)?;
        let camera = |c| Camera::of(c, origin);
        Ok(read.cameras.into_iter().map(camera).collect())
    }

    /// Pictures in the photographed light, (height, width, 3) radiance each: an array for one camera, a list for several.
    ///
    /// Options are flags of `unbake render`: renderer ("hybrid", "path"), show ("light", "albedo", "roughness"), supersampling (1 to
    /// 16), samples, no_denoise, diffuse_only, flat, and width, height, fov, path, which change the cameras; with `path` the result is
    /// a list. Raises UsageError for an option or camera out of range.
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
            options.render(&self.inner, &placed, seed, &progress, |_, image, _| {
                images.push(image.clone());
                Ok(())
            })?;
            Ok(images)
        })?;
        Self::pictures(py, images, cameras.is_one() && frames.path == 0)
    }

    /// Pictures in changed light, as `render` gives them, by the path tracer.
    ///
    /// `lamps`, `add` and `environment` are the tables of a lighting file of `unbake relight` (docs/outputs.md): changes of lamps
    /// (group or near; off, scale, colour, move), new lamps (kind = quad, sphere, point, spot, ies), the light from outside (off,
    /// file, constant, scale, colour). Files are relative to the current folder. Options: samples, max_samples, error (relative
    /// standard error at which a part of the picture is done), no_denoise, width, height, fov, path. Raises UsageError for what does
    /// not exist or is no light, InputError for a file that cannot be read.
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
