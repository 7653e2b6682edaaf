//! A glass screen in a synthetic room that has one: found with what it lets through, and nothing
//! else is; a room without has none (`tests/solve_small.rs`).

use glam::{Vec2, Vec3};
use unbake::core::progress::Progress;
use unbake::pipeline::{SolveOptions, reconstruct};
use unbake::programs::synth::{SynthOptions, generate};
use unbake::scene::{LoadOptions, Scene};

/// What a face of its glass lets through of what it does not reflect (`programs/synth/catalogue.rs`).
const TINT: f32 = 0.94;

#[test]
fn a_glass_screen_is_found_and_nothing_else() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let options = SynthOptions {
        views: 12,
        spp: 4,
        panes: true,
        ..SynthOptions::small()
    };
    generate(&options, dir.path(), &Progress::silent()).expect("generates");
    let scene = Scene::load(dir.path(), &LoadOptions::default()).expect("usable");
    let options = SolveOptions {
        albedo_size: 512,
        roughness_size: 512,
        irradiance_size: 128,
        ..SolveOptions::default()
    };
    let solved = reconstruct(&scene, &options, &Progress::silent()).expect("reconstructs");
    let s = &solved.solution;
    let transmission = s.transmission.as_ref().expect("a pane");
    let size = Vec2::new(transmission.width as f32, transmission.height as f32);
    let mut found = 0;
    for t in 0..s.mesh.triangles.len() {
        let uv = s.mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0);
        if *transmission.nearest(uv * size) == 0.0 {
            continue;
        }
        let class = scene.class(s.class_at(uv)).map_or("", |c| c.name.as_str());
        assert_eq!(class, "glass screen");
        let tint = *s.albedo.nearest(uv * size);
        assert!(
            (tint - Vec3::splat(TINT)).abs().max_element() < 0.08,
            "{tint}"
        );
        found += 1;
    }
    assert!(found >= 2, "{found} triangles");
}
