//! Synthetic brackets with known truth: a scene over four decades, a camera with its own curve.

use super::*;
use crate::core::progress::Progress;
use glam::Vec3;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

/// Radiance from 0.003 to 30: a ramp with blobs, a lamp, and things of brightnesses of their own:
/// a median threshold bitmap shows a ramp alone the same wherever it is moved, as no room is.
fn truth(x: i64, y: i64) -> Vec3 {
    let (u, v) = (x as f32 / WIDTH as f32, y as f32 / HEIGHT as f32);
    let tile = (x as f32 / 13.0).floor() * 12.9898 + (y as f32 / 11.0).floor() * 78.233;
    let thing = 0.7 + 0.6 * (tile.sin() * 43_758.547).rem_euclid(1.0);
    let base = 10f32.powf(-2.5 + 3.5 * u) * (1.0 + 0.3 * (9.0 * v).sin()) * thing;
    let lamp = ((u - 0.8).hypot(v - 0.3) < 0.08) as u8 as f32 * 20.0;
    Vec3::new(
        base + lamp,
        0.8 * base + lamp,
        0.6 * base * (1.0 + v) + lamp,
    )
}

/// A camera that is not sRGB: gamma 1/1.8 with a shoulder.
fn encode(x: f32) -> u8 {
    let y = (x.clamp(0.0, 1.0)).powf(1.0 / 1.8);
    ((y + 0.15 * (std::f32::consts::PI * y).sin() * y).clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn expose(path: &Path, time: f32, dx: i64, person: bool) {
    let rgb: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|i| {
            let (x, y) = ((i % WIDTH) as i64 - dx, (i / WIDTH) as i64);
            let moved = person && (30..50).contains(&x) && (40..90).contains(&y);
            let light = if moved { Vec3::splat(1.0) } else { truth(x, y) };
            (light * time).to_array().map(encode)
        })
        .collect();
    formats::write_png_rgb8(path, WIDTH, HEIGHT, &rgb).expect("photograph");
}

const TIMES: [f32; 5] = [0.02, 0.1, 0.5, 2.5, 12.5];

fn merged(dir: &Path, stem: &str) -> RgbPlane {
    let out = dir.join("out");
    let options = PrepareOptions {
        exposure_times: Some("0.02,0.1,0.5,2.5,12.5".into()),
        ..PrepareOptions::default()
    };
    let made = run(&dir.join("in"), &out, &options, &Progress::silent()).expect("merged");
    assert_eq!(made.kind, "brackets");
    formats::read_rgb(out.join(format!("images/{stem}.exr"))).expect("image")
}

/// Median and 95 % of |ln(image / truth)| after one gain, over pixels not near the border.
fn errors(image: &RgbPlane, dx: i64, skip: fn(i64, i64) -> bool) -> [f64; 2] {
    let mut ratios: Vec<f64> = Vec::new();
    for y in 4..HEIGHT as i64 - 4 {
        for x in 24..WIDTH as i64 - 24 {
            let t = truth(x - dx, y);
            if !skip(x, y) {
                ratios.push(f64::from(image[(x as usize, y as usize)].y / t.y).ln());
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    let middle = ratios[ratios.len() / 2];
    let mut off: Vec<f64> = ratios.iter().map(|r| (r - middle).abs()).collect();
    off.sort_by(f64::total_cmp);
    [off[off.len() / 2], off[off.len() * 95 / 100]]
}

#[test]
fn a_bracket_gives_back_the_light() {
    let dir = tempfile::tempdir().expect("folder");
    std::fs::create_dir(dir.path().join("in")).expect("folder");
    for (i, t) in TIMES.iter().enumerate() {
        expose(&dir.path().join(format!("in/a{i}.png")), *t, 0, false);
    }
    let image = merged(dir.path(), "a2");
    let [median, most] = errors(&image, 0, |_, _| false);
    assert!(median < 0.03 && most < 0.12, "{median} {most}");
}

#[test]
fn hand_held_frames_are_aligned_and_a_person_disappears() {
    let dir = tempfile::tempdir().expect("folder");
    std::fs::create_dir(dir.path().join("in")).expect("folder");
    for (i, t) in TIMES.iter().enumerate() {
        let dx = [5, -3, 0, 2, 7][i];
        expose(&dir.path().join(format!("in/a{i}.png")), *t, dx, i == 3);
    }
    let image = merged(dir.path(), "a2");
    let [median, most] = errors(&image, 0, |_, _| false);
    assert!(median < 0.04 && most < 0.2, "{median} {most}");
    // the person stood at x 30 to 50 in the fourth exposure alone, at 0.1 to 0.5 of its light
    let there = f64::from(image[(42, 65)].y / image[(42, 20)].y).ln();
    let should = f64::from(truth(42, 65).y / truth(42, 20).y).ln();
    assert!((there - should).abs() < 0.15, "{there} {should}");
}

#[test]
fn folders_without_brackets_are_refused_with_the_way_out() {
    let dir = tempfile::tempdir().expect("folder");
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    std::fs::create_dir(&input).expect("folder");
    let plain = PrepareOptions::default();
    let fails = |options: &PrepareOptions, expected: &str| {
        let e = run(&input, &out, options, &Progress::silent()).expect_err(expected);
        assert!(
            e.to_string().contains(expected) && e.exit_code() == 2,
            "{e}"
        );
    };
    fails(&plain, "no JPEG or PNG");
    expose(&input.join("a.png"), 0.1, 0, false);
    expose(&input.join("b.png"), 0.1, 0, false);
    fails(&plain, "--exposure-times");
    let times = |t: &str| PrepareOptions {
        exposure_times: Some(t.into()),
        ..PrepareOptions::default()
    };
    fails(&times("1"), "no bracket");
    fails(&times("1,2,3"), "3 times for 2 photographs");
    fails(&times("1,x"), "\"x\"");
    assert!(!recognises(&input) && !out.exists());
}
