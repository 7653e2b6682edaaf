//! A small synthetic apartment, and textures of its resolution.

use std::path::Path;
use unbake::core::progress::Progress;
use unbake::pipeline::SolveOptions;
use unbake::programs::synth::{SynthOptions, generate};

/// Side of its true textures, and of what is reconstructed.
pub const SIDE: usize = 256;

/// Writes one room with five training views and one held out.
pub fn write_apartment(folder: &Path) {
    let options = SynthOptions {
        rooms: 1,
        views: 6,
        test_views: 1,
        width: 192,
        spp: 6,
        texture: SIDE,
        ..SynthOptions::default()
    };
    generate(&options, folder, &Progress::silent()).expect("generates");
}

/// Textures of the apartment's resolution.
pub fn small_textures() -> SolveOptions {
    SolveOptions {
        albedo_size: SIDE,
        roughness_size: SIDE,
        irradiance_size: 128,
        ..SolveOptions::default()
    }
}
