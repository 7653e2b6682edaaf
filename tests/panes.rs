//! A glass screen in a synthetic room that has one: found with what it lets through, and nothing
//! else is; a room without has none (`tests/solve_small.rs`).

mod common;

use common::apartment::{reconstructed, triangles_with};
use glam::{Vec2, Vec3};
use unbake::programs::synth::SynthOptions;

/// What a face of its glass lets through of what it does not reflect (`programs/synth/catalogue.rs`).
const TINT: f32 = 0.94;

#[test]
fn a_glass_screen_is_found_and_nothing_else() {
    let room = reconstructed(&SynthOptions {
        views: 12,
        spp: 4,
        panes: true,
        ..SynthOptions::small()
    });
    let s = &room.1;
    let transmission = s.transmission.as_ref().expect("a pane");
    let size = Vec2::new(transmission.width as f32, transmission.height as f32);
    let panes = triangles_with(&room, transmission);
    for (class, uv) in &panes {
        assert_eq!(*class, "glass screen");
        let tint = *s.albedo.nearest(*uv * size);
        assert!(
            (tint - Vec3::splat(TINT)).abs().max_element() < 0.08,
            "{tint}"
        );
    }
    assert!(panes.len() >= 2, "{} triangles", panes.len());
}
