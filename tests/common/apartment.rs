//! A small synthetic apartment, and textures of its resolution.

use glam::Vec2;
use std::path::Path;
use unbake::core::image::Plane;
use unbake::core::progress::Progress;
use unbake::pipeline::{SolveOptions, reconstruct};
use unbake::programs::synth::{SynthOptions, generate};
use unbake::scene::{LoadOptions, Scene};
use unbake::solution::Solution;

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

/// A synthetic scene, reconstructed with small textures.
pub fn reconstructed(options: &SynthOptions) -> (Scene, Solution) {
    let folder = tempfile::tempdir().expect("temporary folder");
    generate(options, folder.path(), &Progress::silent()).expect("generates");
    let scene = Scene::load(folder.path(), &LoadOptions::default()).expect("usable");
    let options = SolveOptions {
        albedo_size: 512,
        roughness_size: 512,
        irradiance_size: 128,
        ..SolveOptions::default()
    };
    let solved = reconstruct(&scene, &options, &Progress::silent()).expect("reconstructs");
    (scene, solved.solution)
}

/// The triangles in whose middle a share is not 0, as their class and their place on the atlas.
pub fn triangles_with<'a>(
    (scene, solution): &'a (Scene, Solution),
    share: &Plane<f32>,
) -> Vec<(&'a str, Vec2)> {
    let size = Vec2::new(share.width as f32, share.height as f32);
    (0..solution.mesh.triangles.len())
        .map(|t| solution.mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0))
        .filter(|uv| *share.nearest(*uv * size) != 0.0)
        .map(|uv| {
            let class = scene.class(solution.class_at(uv));
            (class.map_or("", |c| c.name.as_str()), uv)
        })
        .collect()
}
