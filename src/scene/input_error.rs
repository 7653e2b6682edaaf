//! Errors of inputs: several in one, and where a file was named.

use crate::Error;
use std::path::Path;

/// One error for many, the first `max` of them in full.
pub(super) fn limited(mut issues: Vec<Error>, max: usize) -> Error {
    let max = max.max(1);
    if issues.len() > max {
        let more = issues.len() - max;
        issues.truncate(max);
        issues.push(Error::Usage(format!(
            "and {more} more problems of input; mend these first"
        )));
    }
    Error::Inputs(issues)
}

/// Reading input failed: exit code 2 and the place that named the file, whatever layer noticed.
pub(super) fn as_input(e: Error, path: &Path, place: &str) -> Error {
    match e {
        Error::Input { path, message } => Error::Input {
            path,
            message: format!("{message} (named by {place})"),
        },
        Error::Io { path, source } => Error::Input {
            path,
            message: format!("{source}; the file is named by {place}"),
        },
        e @ (Error::Native(_) | Error::Failed(_) | Error::Stopped) => {
            Error::input(path, format!("{e} (named by {place})"))
        }
        e => e,
    }
}
