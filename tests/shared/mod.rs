//! Scenes, captures and cases beside the repository: `../shared`, or the folder that
//! `UNBAKE_SHARED` names.

use std::path::{Path, PathBuf};

/// A file or folder of the shared ones; `None`, with a word about it, where it is absent.
pub fn shared(what: impl AsRef<Path>) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let root = std::env::var_os("UNBAKE_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(what);
    if path.exists() {
        return Some(path);
    }
    eprintln!(
        "skipped: {} is not here (UNBAKE_SHARED names its folder)",
        path.display()
    );
    None
}
