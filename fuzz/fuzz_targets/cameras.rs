//! Camera files of `unbake render`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::with_file;

fuzz_target!(|bytes: &[u8]| {
    with_file(bytes, "json", |path| {
        let _ = unbake::render::read_cameras(path, Default::default(), Some([64, 32]));
    });
});
