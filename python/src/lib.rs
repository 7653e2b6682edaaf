//! The Python module `unbake`: scenes, reconstruction, results and pictures, by the library and not
//! by running the program. `python/unbake/unbake_native.pyi` is its face with all descriptions; this crate
//! converts arguments, lets Python's threads run while it works, and lends textures to numpy.

mod buffer;
mod camera;
mod options;
mod said;
mod scene;
mod solution;
mod solve;
mod watch;

use pyo3::prelude::*;

/// The compiled part of the package `unbake`.
#[pymodule]
mod unbake_native {
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::scene::{Scene, check};
    #[pymodule_export]
    use super::solution::Solution;
    #[pymodule_export]
    use super::solve::solve;
    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
