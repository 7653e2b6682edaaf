//! Metals in a synthetic room that has some: found with their reflectance, and nothing else is.

use glam::{Vec2, Vec3};
use unbake::core::progress::Progress;
use unbake::pipeline::{SolveOptions, reconstruct};
use unbake::programs::synth::{SynthOptions, generate};
use unbake::scene::{LoadOptions, Scene};

/// Classes of metal in a room with fittings, and what they reflect at normal incidence
/// (`programs/synth/catalogue.rs`).
const METALS: [(&str, Vec3); 2] = [
    ("mirror", Vec3::splat(0.9)),
    ("table top", Vec3::new(0.91, 0.78, 0.42)),
];
/// Metal too, but of few pixels.
const SMALL: [&str; 2] = ["handle", "planter"];

#[test]
fn mirror_and_brass_are_found_and_nothing_else() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let options = SynthOptions {
        views: 8,
        spp: 4,
        fittings: true,
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
    let metallic = s.metallic.as_ref().expect("metal");
    let size = Vec2::new(metallic.width as f32, metallic.height as f32);
    let mut found = [0usize; METALS.len()];
    for t in 0..s.mesh.triangles.len() {
        let uv = s.mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0);
        let class = scene.class(s.class_at(uv)).map_or("", |c| c.name.as_str());
        if *metallic.nearest(uv * size) == 0.0 || SMALL.contains(&class) {
            continue;
        }
        let known = METALS.iter().position(|(name, _)| *name == class);
        let i = known.unwrap_or_else(|| panic!("{class} is no metal"));
        let f0 = *s.albedo.nearest(uv * size);
        assert!(
            (f0 - METALS[i].1).abs().max_element() < 0.05,
            "{class}: {f0}"
        );
        found[i] += 1;
    }
    assert!(found.iter().all(|n| *n > 0), "{found:?}");
}
