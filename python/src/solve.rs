//! `unbake.solve`: a scene to its result.

use crate::options::Keywords;
use crate::scene::Scene;
use crate::solution::Solution;
use crate::watch::Watch;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use unbake::programs::run::{Run, RunRequest};

/// A scene, or where one lies.
#[derive(FromPyObject)]
pub(crate) enum SceneOrPath {
    Read(Py<Scene>),
    Path(PathBuf),
}

/// Reconstructs a scene, writes what `unbake solve` writes into the folder `out`, the same bits, and reads it back.
///
/// Options are the flags of `unbake solve` with underscores: quality ("preview", "draft", "standard", "high"; default "standard"), albedo_size,
/// roughness_size, irradiance_size (texels), budget (seconds), edges ("auto", "on", "off", or True and False), fix_alignment, force, …
/// A `Scene` keeps the options that it was read with; of a path, they may be given here.
///
/// Raises InputError for a scene that cannot be used or whose photographs do not fit its mesh, UsageError for an option, FileError if
/// `out` cannot be written to.
#[pyfunction]
#[pyo3(signature = (scene, out, *, progress=None, note=None, seed=0, threads=None, **options))]
#[expect(
    clippy::too_many_arguments,
    reason = "keywords of a function of Python"
)]
pub(crate) fn solve<'py>(
    py: Python<'py>,
    scene: SceneOrPath,
    out: PathBuf,
    progress: Option<Bound<'py, PyAny>>,
    note: Option<Bound<'py, PyAny>>,
    seed: u64,
    threads: Option<usize>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Solution> {
    let mut keywords = Keywords::new(py, "solve", options)?;
    let (path, load) = match scene {
        SceneOrPath::Read(scene) => {
            let scene = scene.get();
            (scene.path().to_path_buf(), scene.options().clone())
        }
        SceneOrPath::Path(path) => (path, keywords.take()?),
    };
    let request = RunRequest {
        load,
        alignment: keywords.take()?,
        solve: keywords.take()?,
        seed,
    };
    keywords.finish()?;
    let command = vec![
        "unbake.solve".to_owned(),
        path.display().to_string(),
        out.display().to_string(),
    ];
    let watch = Watch {
        progress,
        note,
        threads,
    };
    let inner = watch.run(py, |observer| {
        Run::new(request, command, vec![observer]).solve(&path, &out)?;
        unbake::Solution::load(&out)
    })?;
    Ok(Solution::new(out, inner))
}
