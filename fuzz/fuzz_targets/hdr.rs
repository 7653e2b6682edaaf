//! Radiance pictures, through OpenImageIO.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::with_file;

fuzz_target!(|bytes: &[u8]| {
    with_file(bytes, "hdr", |path| {
        let _ = unbake::core::formats::image_info(path);
        let _ = unbake::core::formats::read_rgb(path);
    });
});
