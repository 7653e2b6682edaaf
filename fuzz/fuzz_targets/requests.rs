//! Requests to `unbake view`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = unbake::programs::view::parse_request(bytes, &["localhost".to_owned()]);
});
