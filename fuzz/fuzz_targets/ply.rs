//! Polygon files, text and binary.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = unbake::core::formats::ply::mesh_from_ply(bytes, std::path::Path::new("fuzz.ply"));
});
