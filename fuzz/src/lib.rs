//! What the fuzz targets share.

use std::path::{Path, PathBuf};

/// Calls `read` with a file of these bytes, for readers that take a path: one file per process,
/// rewritten for every input.
pub fn with_file(bytes: &[u8], extension: &str, read: impl FnOnce(&Path)) {
    let path = std::env::temp_dir().join(format!("unbake-fuzz-{}.{extension}", std::process::id()));
    if std::fs::write(&path, bytes).is_ok() {
        read(&path);
    }
}

/// A folder whose files are the seeds of a target, of which one at a time is replaced.
pub struct Folder {
    path: PathBuf,
    /// Names and contents.
    files: Vec<(String, Vec<u8>)>,
}

impl Folder {
    /// The process's copy of `corpus/NAME`, made at the first call.
    pub fn copy_of(name: &str) -> &'static Self {
        static COPY: std::sync::OnceLock<Folder> = std::sync::OnceLock::new();
        COPY.get_or_init(|| {
            let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
            let path = std::env::temp_dir().join(format!("unbake-fuzz-{}", std::process::id()));
            let mut files = Vec::new();
            std::fs::create_dir_all(&path).expect("a temporary folder");
            for entry in std::fs::read_dir(&seeds).expect("the seeds").flatten() {
                let name = entry.file_name().to_string_lossy().into_owned();
                let bytes = std::fs::read(entry.path()).expect("a seed");
                std::fs::write(path.join(&name), &bytes).expect("a copy");
                files.push((name, bytes));
            }
            files.sort();
            Folder { path, files }
        })
    }

    /// Names of the files that begin with the same four bytes as the input; all if none does.
    pub fn alike(&self, bytes: &[u8]) -> Vec<String> {
        let names = |all: bool| -> Vec<String> {
            let chosen = self.files.iter().filter(|f| all || f.1.get(..4) == bytes.get(..4));
            chosen.map(|f| f.0.clone()).collect()
        };
        Some(names(false)).filter(|n| !n.is_empty()).unwrap_or_else(|| names(true))
    }

    /// Calls `read` with the folder while one file has other bytes.
    pub fn with(&self, name: &str, bytes: &[u8], read: impl FnOnce(&Path)) {
        let path = self.path.join(name);
        if std::fs::write(&path, bytes).is_ok() {
            read(&self.path);
        }
        if let Some((_, own)) = self.files.iter().find(|f| f.0 == name) {
            let _ = std::fs::write(&path, own);
        }
    }
}
