//! What the fuzz targets share.

use std::path::Path;

/// Calls `read` with a file of these bytes, for readers that take a path: one file per process,
/// rewritten for every input.
pub fn with_file(bytes: &[u8], extension: &str, read: impl FnOnce(&Path)) {
    let path = std::env::temp_dir().join(format!("unbake-fuzz-{}.{extension}", std::process::id()));
    if std::fs::write(&path, bytes).is_ok() {
        read(&path);
    }
}
