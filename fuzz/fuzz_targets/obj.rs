//! Wavefront objects.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = unbake::core::formats::obj::mesh_from_obj(bytes, std::path::Path::new("fuzz.obj"));
});
