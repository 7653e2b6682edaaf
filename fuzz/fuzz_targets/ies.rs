//! Luminaire files of `unbake relight`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::with_file;

fuzz_target!(|bytes: &[u8]| {
    with_file(bytes, "ies", |path| {
        let _ = unbake::render::IesProfile::read(path);
    });
});
