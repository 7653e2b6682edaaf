//! Display-referred photographs: PNG and JPEG.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::with_file;

fuzz_target!(|bytes: &[u8]| {
    with_file(bytes, "png", |path| {
        let _ = unbake::core::formats::read_ldr(path);
    });
});
