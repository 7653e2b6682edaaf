//! Memory of the library lent to numpy, without a copy.
//!
//! numpy's array interface, version 3 (numpy manual, "The array interface protocol"): an object whose
//! `__array_interface__` gives address, shape and type is viewed, not copied, and kept alive by the
//! view. The memory here is shared and never written again, which the interface states.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::any::Any;
use std::sync::Arc;
use unbake::Plane;

/// What a texel consists of.
pub(crate) trait Texel: bytemuck::NoUninit {
    /// numpy's name of a component's type.
    const TYPE: &'static str;
    /// Components of a texel; none for a plain number.
    const COMPONENTS: Option<usize>;
}

macro_rules! texel {
    ($($texel:ty: $name:literal, $components:expr;)*) => {$(
        impl Texel for $texel {
            const TYPE: &'static str = $name;
            const COMPONENTS: Option<usize> = $components;
        }
    )*};
}

// a program of this byte order runs on machines of this byte order: "=" is the native one
texel! {
    f32: "f4", None;
    u16: "u2", None;
    glam::Vec2: "f4", Some(2);
    glam::Vec3: "f4", Some(3);
    [u32; 3]: "u4", Some(3);
}

/// Memory that numpy may look at.
#[pyclass(frozen)]
pub(crate) struct Buffer {
    /// Keeps the memory where it is.
    _owner: Arc<dyn Any + Send + Sync>,
    address: usize,
    shape: Vec<usize>,
    kind: &'static str,
}

#[pymethods]
impl Buffer {
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let order = if cfg!(target_endian = "little") {
            '<'
        } else {
            '>'
        };
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", pyo3::types::PyTuple::new(py, &self.shape)?)?;
        interface.set_item("typestr", format!("{order}{}", self.kind))?;
        let read_only = true;
        interface.set_item("data", (self.address, read_only))?;
        Ok(interface)
    }
}

/// A read-only array of what `view` finds in `owner`: rows, columns, components.
pub(crate) fn plane<'py, O: Send + Sync + 'static, T: Texel>(
    py: Python<'py>,
    owner: &Arc<O>,
    view: impl Fn(&O) -> &Plane<T>,
) -> PyResult<Bound<'py, PyAny>> {
    let plane = view(owner);
    lend(py, owner, &plane.data, &[plane.height, plane.width])
}

/// The same of a plane that may be missing.
pub(crate) fn optional_plane<'py, O: Send + Sync + 'static, T: Texel>(
    py: Python<'py>,
    owner: &Arc<O>,
    view: impl Fn(&O) -> Option<&Plane<T>>,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    let lent = view(owner).map(|p| lend(py, owner, &p.data, &[p.height, p.width]));
    lent.transpose()
}

/// The same of a list: elements, components.
pub(crate) fn list<'py, O: Send + Sync + 'static, T: Texel>(
    py: Python<'py>,
    owner: &Arc<O>,
    view: impl Fn(&O) -> &[T],
) -> PyResult<Bound<'py, PyAny>> {
    let values = view(owner);
    lend(py, owner, values, &[values.len()])
}

fn lend<'py, O: Send + Sync + 'static, T: Texel>(
    py: Python<'py>,
    owner: &Arc<O>,
    values: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let buffer = Buffer {
        _owner: owner.clone(),
        address: values.as_ptr() as usize,
        shape: shape.iter().copied().chain(T::COMPONENTS).collect(),
        kind: T::TYPE,
    };
    py.import("numpy")?.call_method1("asarray", (buffer,))
}
