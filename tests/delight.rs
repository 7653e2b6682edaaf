//! A scan without photographs: the radiance of a synthetic room laid on its mesh as a texture, and
//! what `delight` makes of it beside the truth.

mod common;

use common::apartment::{SIDE, small_textures, write_apartment};
use glam::Vec3;
use std::path::Path;
use unbake::core::formats;
use unbake::core::image::RgbPlane;
use unbake::core::progress::Progress;
use unbake::pipeline::{Solved, delight, reconstruct};
use unbake::scene::{LoadOptions, Scan, ScanOptions, Scene};
use unbake::verdict::Level;

fn room(folder: &Path) -> Scene {
    write_apartment(folder);
    Scene::load(folder, &LoadOptions::default()).expect("usable")
}

fn delighted(mesh: &Path, texture: &Path) -> Solved {
    let scan = ScanOptions {
        texture: Some(texture.to_path_buf()),
        up: None,
    };
    let scan = Scan::load(mesh, &scan, &LoadOptions::default()).expect("usable");
    delight(&scan, &small_textures(), &Progress::silent()).expect("light taken out")
}

/// Median error of the albedo over the texels that photographs see, and the share of them within two
/// stated errors. What nobody sees, cushions' undersides, is dark to its last rays.
fn against(truth: &RgbPlane, seen: &Solved, solved: &Solved) -> (f32, f32) {
    let s = &solved.solution;
    let seen = &seen.solution.confidence.data;
    let known = |i: &usize| {
        truth.data[*i] != Vec3::ZERO
            && seen[*i].x < 1.0
            && s.confidence.data[*i].x < 1.0
            && s.emission.data[*i] == Vec3::ZERO
    };
    let ids: Vec<usize> = (0..truth.data.len()).filter(known).collect();
    assert!(ids.len() > 10_000, "{}", ids.len());
    let off = |i: &usize| unbake::core::math::luminance(s.albedo.data[*i] - truth.data[*i]).abs();
    let mut errors: Vec<f32> = ids.iter().map(off).collect();
    errors.sort_by(f32::total_cmp);
    let within = ids
        .iter()
        .filter(|i| off(i) <= 2.0 * s.confidence.data[**i].x)
        .count();
    (errors[errors.len() / 2], within as f32 / ids.len() as f32)
}

#[test]
fn albedo_comes_out_of_the_radiance_texture_and_is_less_sure_than_from_photographs() {
    let dir = tempfile::tempdir().expect("folder");
    let folder = dir.path().join("scene");
    let scene = room(&folder);
    let solved = reconstruct(&scene, &small_textures(), &Progress::silent()).expect("solved");
    let truth = formats::read_rgb(folder.join("gt/albedo_texture.exr")).expect("truth");
    let (linear, mesh) = (dir.path().join("radiance.exr"), folder.join("mesh.glb"));
    formats::write_rgb_half(&linear, &solved.solution.radiance).expect("texture");
    let from_linear = delighted(&mesh, &linear);
    let (error, within) = against(&truth, &solved, &from_linear);
    println!("linear texture: median error {error:.3}, {within:.2} within two stated errors");
    // guessing the mean would be off by 0.2
    assert!(error < 0.15, "{error}");
    assert!(within > 0.8, "{within}");
    let verdict = from_linear.findings.verdict();
    println!("{verdict}");
    assert_ne!(verdict.level, Level::Good, "nothing confirms it");
    assert!(verdict.expected_error > solved.findings.verdict().expected_error);
    // the prior's roughness, said to be unknown; lamps found by their brightness
    let confidence = &from_linear.solution.confidence.data;
    assert!(confidence.iter().all(|c| c.y >= 1e3));
    assert!(!from_linear.solution.lamps.is_empty());

    // the same room as a phone would store it: sRGB, exposed for the walls
    let mut luminances: Vec<f32> = (solved.solution.radiance.data.iter())
        .map(|c| unbake::core::math::luminance(*c))
        .collect();
    luminances.sort_by(f32::total_cmp);
    let white = luminances[luminances.len() * 97 / 100];
    let bytes: Vec<u8> = (solved.solution.radiance.data.iter())
        .flat_map(|c| (*c / white).to_array().map(formats::srgb8_from_linear))
        .collect();
    let encoded = dir.path().join("phone.png");
    formats::write_png_rgb8(&encoded, SIDE, SIDE, &bytes).expect("texture");
    let from_encoded = delighted(&mesh, &encoded);
    let (error, within) = against(&truth, &solved, &from_encoded);
    println!("clipped sRGB texture: median error {error:.3}, {within:.2} within two stated errors");
    let doubted = from_encoded.findings.verdict();
    println!("{doubted}");
    let unsure = |s: &Solved| s.findings.model_error();
    assert!(unsure(&from_encoded) > unsure(&from_linear));
    assert!(doubted.reasons.iter().any(|r| r.what.contains("ceiling")));
    assert!(within > 0.7, "{within}");
}
