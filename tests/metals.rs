//! Metals in a synthetic room that has some: found with their reflectance, and nothing else is.

mod common;

use common::apartment::{reconstructed, triangles_with};
use glam::{Vec2, Vec3};
use unbake::programs::synth::SynthOptions;

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
    let room = reconstructed(&SynthOptions {
        views: 8,
        spp: 4,
        fittings: true,
        ..SynthOptions::small()
    });
    let s = &room.1;
    let metallic = s.metallic.as_ref().expect("metal");
    let size = Vec2::new(metallic.width as f32, metallic.height as f32);
    let mut found = [0usize; METALS.len()];
    let metals = triangles_with(&room, metallic);
    for (class, uv) in metals.into_iter().filter(|m| !SMALL.contains(&m.0)) {
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
