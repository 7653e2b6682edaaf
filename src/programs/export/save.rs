//! Writing a file of an export.

use crate::error::{Error, Result};
use std::path::Path;

/// Writes `bytes` to the file `name` of `folder`.
///
/// # Errors
/// The file system refuses.
pub(super) fn save(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).map_err(|e| Error::io(&path, e))
}
