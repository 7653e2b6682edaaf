//! Output folders: one file of a whole solution (the seed corpus) replaced by the input, in the
//! place of each file that begins alike.
#![no_main]

use libfuzzer_sys::fuzz_target;
use unbake_fuzz::Folder;

fuzz_target!(|bytes: &[u8]| {
    let folder = Folder::copy_of("solution");
    for name in folder.alike(bytes) {
        folder.with(&name, bytes, |path| {
            let _ = unbake::solution::Solution::load(path);
        });
    }
});
