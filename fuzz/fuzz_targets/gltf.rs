//! glTF, text and binary.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = unbake::core::formats::gltf::mesh_from_gltf(bytes, std::path::Path::new("fuzz.glb"));
});
