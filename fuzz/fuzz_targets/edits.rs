//! Lists of edits.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::with_file;

fuzz_target!(|bytes: &[u8]| {
    with_file(bytes, "toml", |path| {
        let _ = unbake::programs::edit::EditList::read(path);
    });
});
