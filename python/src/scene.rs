//! Scenes: what is read of one, and what is wrong with it.

use crate::buffer;
use crate::camera::Camera;
use crate::options::Keywords;
use crate::said::{Raised, dictionary, usage};
use crate::watch::Watch;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use unbake::core::progress::Progress;
use unbake::programs::run;
use unbake::render::{NamedCamera, Views};
use unbake::scene::Split;

/// A validated scene: mesh, cameras, classes. Photographs are read on demand.
#[pyclass(frozen)]
pub(crate) struct Scene {
    path: PathBuf,
    inner: Arc<unbake::Scene>,
}

impl Scene {
    /// The folder or file it was read from.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// How it was read.
    pub(crate) fn options(&self) -> &unbake::LoadOptions {
        &self.inner.options
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (path, **options))]
    fn read(py: Python<'_>, path: PathBuf, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut keywords = Keywords::new(py, "Scene", options)?;
        let load: unbake::LoadOptions = keywords.take()?;
        keywords.finish()?;
        let inner = Watch::default().run(py, |_| unbake::Scene::load(&path, &load))?;
        Ok(Self {
            path,
            inner: Arc::new(inner),
        })
    }

    /// Where it was read from.
    #[getter(path)]
    fn shown_path(&self) -> PathBuf {
        self.path.clone()
    }
    /// What should be known although the scene is usable.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings.clone()
    }
    /// What `positions` are relative to: a point in the coordinates of the scene's file.
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.inner.origin.into()
    }

    /// Names of the classes by the ids of label images.
    #[getter]
    fn classes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let classes = PyDict::new(py);
        for class in &self.inner.classes {
            classes.set_item(class.id, &class.name)?;
        }
        Ok(classes)
    }

    /// The cameras of the views, named after their images, in the order of the file.
    #[pyo3(signature = (views="all"))]
    fn cameras<'py>(&self, py: Python<'py>, views: &str) -> PyResult<Bound<'py, PyList>> {
        let wanted = match views {
            "all" => Views::All,
            "train" => Views::Train,
            "test" => Views::Test,
            other => {
                let message = format!("cameras: views={other:?}: expected all, train or test");
                return Err(usage(py, message));
            }
        };
        let scene = &self.inner;
        let listed = unbake::render::cameras_of_scene(scene, wanted.split(), scene.origin);
        let camera = |c: NamedCamera| Camera::of(c, scene.origin);
        let cameras: Result<Vec<_>, _> =
            listed.into_iter().map(|c| Py::new(py, camera(c))).collect();
        PyList::new(py, cameras?)
    }

    /// (height, width, 3): the radiance that a view's photograph shows. Raises UsageError for a name that no view has, InputError
    /// for an image that cannot be read.
    fn photograph<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let Some(view) = self.inner.views.iter().find(|v| v.stem == name) else {
            let message = format!("photograph: there is no view {name:?}; cameras() names them");
            return Err(usage(py, message));
        };
        let image = py.detach(|| self.inner.load_radiance(view)).raised(py)?;
        buffer::plane(py, &Arc::new(image), |image| image)
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

    fn __repr__(&self) -> String {
        let views = &self.inner.views;
        let held_out = views.iter().filter(|v| v.split == Split::Test).count();
        format!(
            "<unbake.Scene {:?}: {} views, {held_out} of them held out, {} triangles>",
            self.path,
            views.len(),
            self.inner.mesh.triangles.len()
        )
    }
}

/// What is understood of a scene and everything that is wrong with it, as `unbake check --json` says it: "problems" and "warnings"
/// (lists of sentences), "alignment", …; "text" is the same for people. A bad scene is a result and no exception.
///
/// Options are the flags of `unbake check`. Raises UsageError for an option.
#[pyfunction]
#[pyo3(signature = (scene, *, progress=None, note=None, threads=None, **options))]
pub(crate) fn check<'py>(
    py: Python<'py>,
    scene: PathBuf,
    progress: Option<Bound<'py, PyAny>>,
    note: Option<Bound<'py, PyAny>>,
    threads: Option<usize>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let mut keywords = Keywords::new(py, "check", options)?;
    let load: unbake::LoadOptions = keywords.take()?;
    let alignment = keywords.take()?;
    keywords.finish()?;
    let watch = Watch {
        progress,
        note,
        threads,
    };
    let checked = watch.run(py, |observer| {
        Ok(run::check_scene(
            &scene,
            &load,
            &alignment,
            &Progress::new(observer),
        ))
    })?;
    let found = dictionary(py, &checked)?;
    found.set_item("text", checked.to_string())?;
    Ok(found)
}
