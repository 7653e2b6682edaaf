//! What the library says, to Python: errors as exceptions of `unbake.errors` with the same text, records
//! as dictionaries.

use pyo3::prelude::*;
use serde::Serialize;
use unbake::Error;

/// The exception that says what `error` says.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let class = match error {
        Error::Input { .. } | Error::Inputs(_) => "InputError",
        Error::Usage(_) => "UsageError",
        Error::Io { .. } => "FileError",
        Error::Native(_) | Error::Failed(_) | Error::Stopped => "Error",
    };
    let made = py
        .import("unbake.errors")
        .and_then(|errors| errors.getattr(class)?.call1((error.to_string(),)));
    made.map_or_else(|failure| failure, PyErr::from_value)
}

/// Wrong arguments, in words.
pub(crate) fn usage(py: Python<'_>, message: impl Into<String>) -> PyErr {
    exception(py, &Error::Usage(message.into()))
}

/// Results of the library as results of Python.
pub(crate) trait Raised<T> {
    /// The value, or the exception.
    fn raised(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> Raised<T> for unbake::Result<T> {
    fn raised(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|e| exception(py, &e))
    }
}

/// A record as dictionaries and lists, as its JSON has them.
pub(crate) fn dictionary<'py>(
    py: Python<'py>,
    record: &impl Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    let json = serde_json::to_value(record)
        .map_err(|e| exception(py, &Error::Failed(format!("cannot be written down: {e}"))))?;
    Ok(pythonize::pythonize(py, &json)?)
}
