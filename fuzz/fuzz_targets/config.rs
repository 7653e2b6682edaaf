//! Configuration files.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    // the reader takes a path: one file per process, rewritten for every input
    let path = std::env::temp_dir().join(format!("unbake-fuzz-{}.toml", std::process::id()));
    if std::fs::write(&path, bytes).is_ok() {
        let _ = unbake::cli::Config::read(&path);
    }
});
