//! Importers end to end on tiny captures written here.

use super::*;
use crate::formats;
use crate::image::Plane;
use crate::scene::{LdrImages, LoadOptions, Scene};
use glam::Vec3;
use std::fs;

/// A panorama of a smooth gradient as PNG.
fn panorama(path: &Path, width: usize) {
    let rgb: Vec<u8> = (0..width * width / 2 * 3)
        .map(|i| (i % 251) as u8)
        .collect();
    formats::write_png_rgb8(path, width, width / 2, &rgb).expect("image");
}

fn run(source: Option<&str>, dir: &Path, out: &Path, options: &PrepareOptions) -> Result<Prepared> {
    prepare(source, dir, out, options, &Progress::silent())
}

fn load(out: &Path) -> Scene {
    let options = LoadOptions {
        ldr: LdrImages::On,
        ..LoadOptions::default()
    };
    Scene::load(out, &options).expect("a scene that loads")
}

/// Two rooms beside each other, a door between them drawn from both sides, a window in the first.
fn zind_tour(dir: &Path) {
    fs::create_dir_all(dir.join("panos")).expect("folder");
    let pano = |room: &str, x: f64, door: &str, windows: &str| {
        let file = format!("floor_01_partial_room_{room}_pano_{room}.png");
        panorama(&dir.join("panos").join(&file), 64);
        format!(
            r#""complete_room_{room}": {{"partial_room_{room}": {{"pano_{room}": {{
            "label": "room {room}", "is_primary": true, "is_inside": true, "ceiling_height": 2.0, "camera_height": 1,
            "image_path": "panos/{file}",
            "layout_complete": {{"vertices": [[-1, -1], [1, -1], [1, 1], [-1, 1]], "doors": [{door}], "windows": [{windows}], "openings": []}},
            "floor_plan_transformation": {{"translation": [{x}, 0], "rotation": 0, "scale": 0.5}}}}}}}}"#
        )
    };
    // the second room lies 1.1 coordinates further along x: a gap of 0.1 coordinates
    let first = pano(
        "01",
        0.0,
        "[1, -0.5], [1, 0.5], [-1, 0.5]",
        "[-1, -0.5], [-1, 0.5], [-0.2, 0.4]",
    );
    let second = pano("02", 1.1, "[-1, -0.5], [-1, 0.5], [-1, 0.5]", "");
    fs::write(
        dir.join("zind_data.json"),
        format!(
            r#"{{"scale_meters_per_coordinate": {{"floor_01": 3.0}}, "merger": {{"floor_01": {{{first}, {second}}}}}}}"#
        ),
    )
    .expect("annotation");
}

#[test]
fn a_zind_tour_becomes_a_scene_with_a_doorway_and_a_window() {
    let dir = tempfile::tempdir().expect("folder");
    zind_tour(dir.path());
    let out = dir.path().join("scene");
    let made = run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
    assert_eq!((made.kind, made.frames, made.rooms), ("zind", 2, 2));
    let scene = load(&out);
    assert_eq!(scene.views[0].stem, "partial_room_01_pano_01");
    let rooms = scene.rooms.as_ref().expect("rooms");
    let place = |i: usize| scene.views[i].camera.position;
    assert_eq!((rooms.room_at(place(0)), rooms.room_at(place(1))), (1, 2));
    // the camera stands 1 × 0.5 × 3 m high; the second one 1.1 × 3 m along the mirrored x
    assert!((place(1) - place(0) - Vec3::new(-3.3, 0.0, 0.0)).length() < 1e-5);
    let low = scene.mesh.bounds().0.y;
    assert!((place(0).y - low - 1.5).abs() < 1e-5);
    // through the door the first panorama sees the far wall of the second room; its window is
    // labelled. Layout +x is to the left of a camera that looks along +y, so the door is at 1/4.
    let labels = formats::read_labels(out.join("labels/partial_room_01_pano_01.png")).expect("ids");
    let row = |elevation: f64| ((0.5 - elevation / std::f64::consts::PI) * 32.0) as usize;
    assert_eq!(labels[(16, row(0.0))], 3, "ahead: wall");
    assert_eq!(labels[(48, row(0.1))], 5, "right: window");
    assert_eq!(labels[(16, 31)], 1, "below: floor");
    let text = fs::read_to_string(out.join("prepare.json")).expect("account");
    assert!(text.contains("1 doors drawn from both sides"), "{text}");
}

#[test]
fn damaged_tours_name_the_place_and_nothing_is_written() {
    let dir = tempfile::tempdir().expect("folder");
    zind_tour(dir.path());
    let file = dir.path().join("zind_data.json");
    let whole = fs::read_to_string(&file).expect("text");
    let out = dir.path().join("scene");
    for (text, expected) in [
        (&whole[..whole.len() / 2], "line"),
        ("{}", "merger"),
        (&whole.replace("3.0", "null"), "--scale"),
        (
            &whole.replace("[[-1, -1], [1, -1], [1, 1], [-1, 1]]", "[]"),
            "no room has a layout",
        ),
        (&whole.replace("pano_01.png", "pano_77.png"), "no such file"),
    ] {
        fs::write(&file, text).expect("damage");
        let error =
            run(Some("zind"), dir.path(), &out, &PrepareOptions::default()).expect_err(expected);
        assert!(error.to_string().contains(expected), "{expected}: {error}");
        assert_eq!(error.exit_code(), 2);
        assert!(!out.exists());
    }
    let error = run(
        None,
        &dir.path().join("panos"),
        &out,
        &PrepareOptions::default(),
    );
    assert!(error.is_err_and(|e| e.to_string().contains("zind")));
}

#[test]
fn folders_of_others_are_not_replaced() {
    let dir = tempfile::tempdir().expect("folder");
    zind_tour(dir.path());
    let out = dir.path().join("mine");
    fs::create_dir_all(&out).expect("folder");
    fs::write(out.join("notes.txt"), "precious").expect("file");
    assert!(run(None, dir.path(), &out, &PrepareOptions::default()).is_err());
    assert!(out.join("notes.txt").is_file());
    let own = dir.path().join("own");
    for _ in 0..2 {
        run(None, dir.path(), &own, &PrepareOptions::default()).expect("may be written again");
    }
    let empty: Plane<u16> = formats::read_labels(own.join("rooms.png")).expect("grid");
    assert!(empty.data.contains(&2));
}
