//! A mesh from depth images: those of a synthetic room's own views, with and without the noise and
//! the steps of a sensor, beside the room's true surface.

use glam::{Mat3, Vec2, Vec3};
use serde_json::{Value, json};
use std::f32::consts::PI;
use std::path::Path;
use unbake::core::formats;
use unbake::core::geometry::{Camera, Lens, Projection};
use unbake::core::image::Plane;
use unbake::core::progress::Progress;
use unbake::core::sampling::KeyedRng;
use unbake::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use unbake::gbuffer::ViewBuffer;
use unbake::programs::prepare::{PrepareOptions, prepare};
use unbake::programs::synth::{SynthOptions, generate};
use unbake::scene::{LoadOptions, Scene};

fn room(folder: &Path) -> Scene {
    let options = SynthOptions {
        rooms: 1,
        views: 8,
        test_views: 1,
        width: 256,
        spp: 1,
        texture: 128,
        ..SynthOptions::default()
    };
    generate(&options, folder, &Progress::silent()).expect("generates");
    Scene::load(folder, &LoadOptions::default()).expect("usable")
}

/// The room's folder without its mesh and labels, with a depth image per frame.
fn with_depth(scene: &Scene, out: &Path, write: impl Fn(usize, &Plane<f32>) -> String) {
    let text = std::fs::read_to_string(scene.folder.join("transforms.json")).expect("scene");
    let mut json: Value = serde_json::from_str(&text).expect("JSON");
    let tracer = EmbreeTracer::new(&scene.mesh).expect("Embree");
    for (i, view) in scene.views.iter().enumerate() {
        let mut depth = ViewBuffer::trace(&view.camera, &tracer).distance;
        let none = |d: &mut f32| *d = if d.is_finite() { *d } else { 0.0 };
        depth.data.iter_mut().for_each(none);
        let frame = json["frames"][i].as_object_mut().expect("frame");
        frame.remove("label_path");
        frame.insert("depth_file_path".into(), json!(write(i, &depth)));
    }
    let root = json.as_object_mut().expect("scene");
    for key in ["mesh_path", "classes", "rooms_path"] {
        root.remove(key);
    }
    std::fs::write(out.join("transforms.json"), json.to_string()).expect("scene");
    std::os::unix::fs::symlink(scene.folder.join("images"), out.join("images")).expect("link");
}

/// How far a surface is from another.
struct Distance {
    /// Median and 95 % quantile of the distance along the normal, metres.
    median: f32,
    most: f32,
    /// Share of the points near which the other has no surface.
    missed: f32,
}

/// From points spread over `from` to `to`, along the face's normal, up to 10 cm.
fn distance(from: &Scene, to: &Scene, seen: impl Fn(Vec3, Vec3) -> bool) -> Distance {
    let tracer = EmbreeTracer::new(&to.mesh).expect("Embree");
    let shift = (from.origin - to.origin).as_vec3();
    let mut found = Vec::new();
    let (mut missed, mut asked) = (0, 0);
    let areas: Vec<f32> = (0..from.mesh.triangles.len())
        .map(|t| from.mesh.area(t))
        .collect();
    let table = unbake::core::sampling::Discrete::new(
        &areas.iter().map(|a| f64::from(*a)).collect::<Vec<_>>(),
    );
    let table = table.expect("surface");
    for i in 0..20_000u64 {
        let mut rng = KeyedRng::new(7, i);
        let t = table.sample(rng.next_f32()).0;
        let [u, v] = unbake::core::sampling::square_to_triangle([rng.next_f32(), rng.next_f32()]);
        let (p, n) = (
            from.mesh.position(t, u, v) + shift,
            from.mesh.face_normal(t),
        );
        if !seen(p - shift, n) {
            continue;
        }
        asked += 1;
        let rays = [n, -n].map(|d| Ray::new(p, d, 0.1));
        let mut hits = [Hit::miss(); 2];
        tracer.closest(&rays, &mut hits);
        let near = hits
            .iter()
            .filter(|h| h.is_hit())
            .map(|h| h.t)
            .reduce(f32::min);
        match near {
            Some(d) => found.push(d),
            None => missed += 1,
        }
    }
    found.sort_by(f32::total_cmp);
    Distance {
        median: found[found.len() / 2],
        most: found[found.len() * 95 / 100],
        missed: missed as f32 / asked as f32,
    }
}

fn prepared(capture: &Path, out: &Path) -> (Scene, Vec<String>) {
    let options = PrepareOptions {
        hold_out: 0,
        ..PrepareOptions::default()
    };
    let done = prepare(None, capture, out, &options, &Progress::silent()).expect("prepared");
    let scene = Scene::load(out, &LoadOptions::default()).expect("usable");
    (scene, done.notes)
}

fn check(truth: &Scene, fused: &Scene, within: f32, astray: f32) {
    let tracer = EmbreeTracer::new(&truth.mesh).expect("Embree");
    // what at least one view sees at less than 70°
    let seen = |p: Vec3, n: Vec3| {
        truth.views.iter().any(|v| {
            let to = v.camera.position - p;
            let cosine = to.normalize().dot(n).abs();
            let start = p + n * (1e-3 * to.dot(n).signum());
            let ray = Ray::new(
                start,
                (v.camera.position - start).normalize(),
                to.length() - 2e-3,
            );
            let mut hit = [Hit::miss()];
            tracer.closest(&[ray], &mut hit);
            cosine > 0.34 && !hit[0].is_hit()
        })
    };
    // (sides that nobody sees are closed by surface of no room)
    let shift = (fused.origin - truth.origin).as_vec3();
    let accuracy = distance(fused, truth, |p, n| seen(p + shift, n));
    let coverage = distance(truth, fused, seen);
    println!(
        "{} triangles; to the truth: median {:.1} mm, 95 % {:.1} mm, {:.1} % beyond 10 cm; of the seen truth {:.1} % is missing",
        fused.mesh.triangles.len(),
        1e3 * accuracy.median,
        1e3 * accuracy.most,
        100.0 * accuracy.missed,
        100.0 * coverage.missed
    );
    assert!(accuracy.median < within, "{}", accuracy.median);
    assert!(accuracy.missed < astray, "{}", accuracy.missed);
    assert!(coverage.missed < 0.1, "{}", coverage.missed);
}

#[test]
fn the_surface_of_exact_depth_is_the_room() {
    let dir = tempfile::tempdir().expect("folder");
    let truth = room(&dir.path().join("room"));
    let capture = dir.path().join("capture");
    std::fs::create_dir(&capture).expect("folder");
    with_depth(&truth, &capture, |i, depth| {
        let name = format!("depth{i}.exr");
        formats::write_plane_float(capture.join(&name), depth).expect("depth");
        name
    });
    let (fused, notes) = prepared(&capture, &dir.path().join("fused"));
    println!("{notes:?}");
    assert!(notes.iter().any(|n| n.contains("depth images")));
    check(&truth, &fused, 0.009, 0.03);
    // decimated: far fewer triangles than the voxels give
    assert!(fused.mesh.triangles.len() < 400_000);
}

/// The mesh, checked, of a room's depth as a sensor gives it: millimetres in 16 bits, off by 1 % at random, and
/// in a `gaps` share of the pixels nothing.
fn sensed(gaps: f32) -> Scene {
    let dir = tempfile::tempdir().expect("folder");
    let truth = room(&dir.path().join("room"));
    let capture = dir.path().join("capture");
    std::fs::create_dir(&capture).expect("folder");
    with_depth(&truth, &capture, |i, depth| {
        let name = format!("depth{i}.png");
        let noisy = |(k, d): (usize, &f32)| {
            let mut rng = KeyedRng::new(i as u64, k as u64);
            let noise: f32 = (0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0;
            let seen = f32::from(rng.next_f32() >= gaps);
            (seen * d * (1.0 + 0.01 * noise) * 1000.0).round() as u16
        };
        let steps = Plane {
            width: depth.width,
            height: depth.height,
            data: depth.data.iter().enumerate().map(noisy).collect(),
        };
        formats::write_png16(capture.join(&name), &steps).expect("depth");
        name
    });
    let (fused, _) = prepared(&capture, &dir.path().join("fused"));
    check(&truth, &fused, 0.02, 0.05);
    fused
}

#[test]
fn noise_of_a_sensor_averages_out() {
    sensed(0.0);
}

/// A pixel in ten without depth is a gap of the measurements, not a window in the wall.
#[test]
fn gaps_of_a_sensor_are_no_openings() {
    let fused = sensed(0.1);
    // (taken for openings, gaps ask for five times as many)
    assert!(fused.mesh.triangles.len() < 150_000);
}

/// A camera that is turned about: six pinhole images of a right angle from each place, their depth along the
/// axis as phones give it.
#[test]
fn the_surface_of_pinhole_depth_is_the_room() {
    const SIDE: usize = 128;
    let dir = tempfile::tempdir().expect("folder");
    let truth = room(&dir.path().join("room"));
    let capture = dir.path().join("capture");
    std::fs::create_dir(&capture).expect("folder");
    let tracer = EmbreeTracer::new(&truth.mesh).expect("Embree");
    let grey = Plane::filled(SIDE, SIDE, Vec3::splat(0.5));
    formats::write_rgb_half(capture.join("grey.exr"), &grey).expect("image");
    let turns = [0.0, 0.5, 1.0, 1.5].map(|k| Mat3::from_rotation_y(k * PI));
    let up_and_down = [0.5, -0.5].map(|k| Mat3::from_rotation_x(k * PI));
    let mut frames = Vec::new();
    for (i, view) in truth.views.iter().enumerate() {
        for (k, turn) in turns.iter().chain(&up_and_down).enumerate() {
            let camera = Camera {
                position: view.camera.position,
                world_from_camera: *turn,
                width: SIDE,
                height: SIDE,
                projection: Projection::Pinhole(Lens::centred(SIDE, SIDE, 90.0)),
            };
            let along = ViewBuffer::trace(&camera, &tracer).distance;
            let axis = -turn.z_axis;
            let steps = |(p, d): (usize, &f32)| {
                let pixel = Vec2::new((p % SIDE) as f32 + 0.5, (p / SIDE) as f32 + 0.5);
                let deep = d * camera.direction(pixel).dot(axis) * 1000.0;
                if deep.is_finite() {
                    deep.round() as u16
                } else {
                    0
                }
            };
            let deep = Plane {
                width: SIDE,
                height: SIDE,
                data: along.data.iter().enumerate().map(steps).collect(),
            };
            let (image, depth) = (format!("image{i}_{k}.exr"), format!("depth{i}_{k}.png"));
            formats::write_png16(capture.join(&depth), &deep).expect("depth");
            std::fs::hard_link(capture.join("grey.exr"), capture.join(&image)).expect("link");
            let place = camera.position.as_dvec3() + truth.origin;
            let row = |r: usize| json!([turn.x_axis[r], turn.y_axis[r], turn.z_axis[r], place[r]]);
            frames.push(json!({"file_path": image, "depth_file_path": depth,
                "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]]}));
        }
    }
    let focal = SIDE as f32 / 2.0;
    let json = json!({"camera_model": "PINHOLE", "w": SIDE, "h": SIDE, "fl_x": focal, "fl_y": focal,
        "cx": focal, "cy": focal, "frames": frames});
    std::fs::write(capture.join("transforms.json"), json.to_string()).expect("scene");
    let (fused, _) = prepared(&capture, &dir.path().join("fused"));
    check(&truth, &fused, 0.009, 0.03);
}

/// Depth that says nothing is refused with a way out.
#[test]
fn empty_depth_is_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let capture = dir.path().join("capture");
    std::fs::create_dir(&capture).expect("folder");
    let image = Plane::filled(8, 4, Vec3::ONE);
    formats::write_rgb_half(capture.join("a.exr"), &image).expect("image");
    formats::write_png16(capture.join("d.png"), &Plane::filled(8, 4, 0u16)).expect("depth");
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    let json = json!({"camera_model": "EQUIRECTANGULAR", "frames": [
        {"file_path": "a.exr", "depth_file_path": "d.png", "transform_matrix": pose}]});
    std::fs::write(capture.join("transforms.json"), json.to_string()).expect("scene");
    let out = dir.path().join("out");
    let e = prepare(
        None,
        &capture,
        &out,
        &PrepareOptions::default(),
        &Progress::silent(),
    );
    let e = e.map(|_| ()).expect_err("no surface");
    assert!(
        e.exit_code() == 2 && e.to_string().contains("--mesh"),
        "{e}"
    );
    assert!(!out.exists(), "whole or not at all");
}
