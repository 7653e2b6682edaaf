//! Importers end to end on tiny captures written here.

use super::*;
use crate::core::formats;
use crate::core::image::Plane;
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

/// Three photographs of a COLMAP model: a panorama, a pinhole camera, a wide fisheye.
fn colmap_model(dir: &Path) {
    fs::create_dir_all(dir.join("sparse/0")).expect("folder");
    fs::create_dir_all(dir.join("images")).expect("folder");
    panorama(&dir.join("images/a.png"), 64);
    panorama(&dir.join("images/b.png"), 64);
    panorama(&dir.join("images/c.png"), 64);
    fs::write(
        dir.join("sparse/0/cameras.txt"),
        "1 EQUIRECTANGULAR 64 32 64 32\n2 RADIAL 64 32 50 32 16 0.1 0.02\n3 OPENCV_FISHEYE 64 32 16 16 32 16 0.01 0 0 0\n",
    )
    .expect("cameras");
    fs::write(
        dir.join("sparse/0/images.txt"),
        "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -1 0 0 2 b.png\n\n3 1 0 0 0 0 0 -2 3 c.png\n\n",
    )
    .expect("images");
    fs::write(
        dir.join("room.obj"),
        "v -5 -5 -5\nv 5 -5 -5\nv 5 3 -5\nv -5 3 9\nf 1 2 3\nf 1 3 4\nf 2 3 4\nf 1 2 4\n",
    )
    .expect("mesh");
}

#[test]
fn a_colmap_model_of_three_lenses_becomes_an_upright_scene() {
    let dir = tempfile::tempdir().expect("folder");
    colmap_model(dir.path());
    let out = dir.path().join("scene");
    let options = PrepareOptions {
        mesh: Some(dir.path().join("room.obj")),
        scale: Some(2.0),
        ..PrepareOptions::default()
    };
    let made = run(None, dir.path(), &out, &options).expect("prepared");
    assert_eq!((made.kind, made.frames, made.triangles), ("colmap", 3, 4));
    let scene = load(&out);
    let place = |i: usize| scene.origin + scene.views[i].camera.position.as_dvec3();
    // COLMAP's y-down world stands on its feet: half a turn about x
    assert!((place(1) - glam::DVec3::new(2.0, 0.0, 0.0)).length() < 1e-5);
    assert!((place(2) - glam::DVec3::new(0.0, 0.0, -4.0)).length() < 1e-5);
    let up = scene.views[0].camera.world_from_camera.y_axis;
    assert!((up - Vec3::Y).length() < 1e-6);
    let size = |i: usize| [scene.views[i].camera.width, scene.views[i].camera.height];
    assert_eq!((size(0), size(1)), ([64, 32], [64, 32]));
    assert!(
        scene.views[2].mask_path.is_some(),
        "the fisheye became a masked panorama"
    );
    assert_eq!(size(2)[0], 2 * size(2)[1]);
    // the mesh went along: its lowest point was at y = 3 of a world that hung upside down
    let low = scene.origin.y + f64::from(scene.mesh.bounds().0.y);
    assert!((low + 6.0).abs() < 1e-5, "{low}");
}

#[test]
fn colmap_says_what_is_missing() {
    let dir = tempfile::tempdir().expect("folder");
    colmap_model(dir.path());
    fs::remove_file(dir.path().join("images/b.png")).expect("removed");
    let out = dir.path().join("scene");
    let error = run(None, dir.path(), &out, &PrepareOptions::default()).expect_err("missing");
    assert!(error.to_string().contains("b.png"), "{error}");
    panorama(&dir.path().join("images/b.png"), 32);
    let error = run(None, dir.path(), &out, &PrepareOptions::default()).expect_err("size");
    assert!(error.to_string().contains("64x32"), "{error}");
    fs::write(dir.path().join("sparse/0/cameras.txt"), "1 MEI 64 32 5\n").expect("file");
    let error = run(None, dir.path(), &out, &PrepareOptions::default()).expect_err("model");
    assert!(
        error.to_string().contains("MEI") || error.to_string().contains("camera 2"),
        "{error}"
    );
}

#[test]
fn nerfstudio_poses_return_to_where_the_mesh_is() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |n: &str| dir.path().join(n);
    panorama(&at("a.png"), 64);
    let depth = Plane::filled(64, 32, 2000u16);
    formats::write_png16(at("depth.png"), &depth).expect("depth");
    formats::write_png8(at("mask.png"), &Plane::filled(64, 32, 255u8)).expect("mask");
    fs::write(
        at("mesh.obj"),
        "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 4\nf 1 2 3\nf 1 3 4\n",
    )
    .expect("mesh");
    // the pose was turned by (x, y, z) → (x, −z, y) and scaled by a half
    fs::write(
        at("transforms.json"),
        r#"{"camera_model": "OPENCV", "fl_x": 64, "fl_y": 64, "cx": 32, "cy": 16, "k1": 0.1, "w": 64, "h": 32,
        "applied_transform": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]], "applied_scale": 0.5, "mood": "good", "up_axis": "y",
        "frames": [{"file_path": "./a", "mask_path": "mask.png", "depth_file_path": "depth.png", "k1": 0.0,
        "transform_matrix": [[1, 0, 0, 0.5], [0, 0, -1, -1.5], [0, 1, 0, 1], [0, 0, 0, 1]]}]}"#,
    )
    .expect("file");
    let out = at("scene");
    let made = run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
    assert_eq!(
        (made.kind, made.frames, made.triangles),
        ("nerfstudio", 1, 2)
    );
    assert!(
        made.notes.iter().any(|n| n.contains("mood")),
        "{:?}",
        made.notes
    );
    let scene = load(&out);
    let view = &scene.views[0];
    let place = scene.origin + view.camera.position.as_dvec3();
    assert!(
        (place - glam::DVec3::new(1.0, 2.0, 3.0)).length() < 1e-6,
        "{place}"
    );
    let turned = view.camera.world_from_camera - glam::Mat3::IDENTITY;
    assert!(turned.to_cols_array().iter().all(|x| x.abs() < 1e-6));
    assert!(view.mask_path.is_some());
    // 2 m along the axis are 2·√(1 + 0.5²) m along the ray at the left edge's middle
    let metres = formats::read_plane(out.join("depth/a.exr")).expect("depth");
    let expected = 2.0 * (1.0f32 + (31.5f32 / 64.0).powi(2) + (0.5f32 / 64.0).powi(2)).sqrt();
    assert!(
        (metres[(0, 16)] - expected).abs() < 1e-4,
        "{}",
        metres[(0, 16)]
    );
    fs::write(at("transforms.json"), r#"{"camera_model": "FISHEYE624", "fl_x": 9, "frames": [{"file_path": "a.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#).expect("file");
    let error = run(None, dir.path(), &out, &PrepareOptions::default()).expect_err("refused");
    assert!(error.to_string().contains("FISHEYE624"), "{error}");
}

#[test]
fn what_nearly_is_a_capture_is_told_what_it_lacks() {
    let dir = tempfile::tempdir().expect("temp");
    let refused = || {
        run(
            None,
            dir.path(),
            &dir.path().join("o"),
            &PrepareOptions::default(),
        )
        .expect_err("no capture")
        .to_string()
    };
    fs::write(dir.path().join("a.JPG"), "").expect("file");
    assert!(refused().contains("1 images without poses"));
    for name in ["a.ply", "b.obj"] {
        fs::write(dir.path().join(name), "").expect("file");
    }
    assert!(refused().contains("2 meshes: name the file"));
}

/// A frame of nerfstudio's at the origin.
fn frame_of(image: &str) -> String {
    format!(
        r#"{{"file_path": "{image}", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
    )
}

#[test]
fn what_a_scene_says_beyond_nerfstudio_goes_through() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |n: &str| dir.path().join(n);
    panorama(&at("a.png"), 64);
    fs::write(at("mesh.obj"), "v 0 0 0\nv 4 0 0\nv 4 0 3\nf 1 2 3\n").expect("mesh");
    formats::write_png16(at("plan.png"), &Plane::filled(4, 2, 3u16)).expect("rooms");
    fs::write(at("plan.json"), r#"{"cell": 0.5, "x_min": -1, "z_min": 2}"#).expect("rooms");
    let text = format!(
        r#"{{"camera_model": "equirectangular", "mesh_path": "mesh.obj", "mesh_up_axis": "z", "color_space": "rec709",
        "rooms_path": "plan.png", "frames": [{}]}}"#,
        frame_of("a.png")
    );
    fs::write(at("transforms.json"), format!("\u{feff}{text}")).expect("file");
    let out = at("scene");
    run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
    let scene = load(&out);
    let high = scene.origin.y + f64::from(scene.mesh.bounds().1.y);
    assert!((high - 3.0).abs() < 1e-6, "the mesh's z is up: {high}");
    let rooms = scene.rooms.as_ref().expect("rooms");
    assert_eq!((rooms.cells.width, rooms.cells[(0, 0)]), (4, 3));
    assert!((f64::from(rooms.x_min) + scene.origin.x + 1.0).abs() < 1e-6);
    let written = fs::read_to_string(out.join("transforms.json")).expect("text");
    assert!(written.contains(r#""color_space": "rec709""#), "{written}");

    let scaled = text.replace(
        "[[1,0,0,0],[0,1,0,0],[0,0,1,0]",
        "[[2,0,0,0],[0,2,0,0],[0,0,2,0]",
    );
    fs::write(at("transforms.json"), scaled).expect("file");
    let error = run(None, dir.path(), &out, &PrepareOptions::default()).expect_err("scaled");
    assert!(error.to_string().contains("scaled by 2"), "{error}");
}

#[test]
fn files_of_training_and_test_frames_are_one_scene() {
    let dir = tempfile::tempdir().expect("folder");
    for part in ["train", "test"] {
        fs::create_dir(dir.path().join(part)).expect("folder");
        panorama(&dir.path().join(part).join("r_0.png"), 64);
        let text = format!(
            r#"{{"camera_angle_x": 1.2, "frames": [{}]}}"#,
            frame_of(&format!("./{part}/r_0"))
        );
        fs::write(dir.path().join(format!("transforms_{part}.json")), text).expect("file");
    }
    let out = dir.path().join("scene");
    let made = run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
    assert_eq!((made.kind, made.frames), ("nerfstudio", 2));
    let text = fs::read_to_string(out.join("transforms.json")).expect("text");
    let scene: serde_json::Value = serde_json::from_str(&text).expect("json");
    assert_eq!(
        scene["train_filenames"],
        serde_json::json!(["images/r_0.png"])
    );
    assert_eq!(
        scene["test_filenames"],
        serde_json::json!(["images/r_0_2.png"])
    );
}

/// Lists name frames by place, however either is spelled; lists that hold out everything are told and
/// not followed.
#[test]
fn frames_are_held_out_by_place_and_never_all() {
    let dir = tempfile::tempdir().expect("folder");
    panorama(&dir.path().join("a.png"), 64);
    panorama(&dir.path().join("b.png"), 64);
    let b = dir.path().join("b.png");
    let frames = [frame_of("./a.png"), frame_of(&b.display().to_string())].join(", ");
    let split = |train: &str, test: &str| {
        let text = format!(
            r#"{{"camera_model": "equirectangular", "frames": [{frames}], "train_filenames": ["{train}"], "test_filenames": ["{test}"]}}"#
        );
        fs::write(dir.path().join("transforms.json"), text).expect("file");
        let out = dir.path().join("scene");
        let made = run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
        let text = fs::read_to_string(out.join("transforms.json")).expect("text");
        let scene: serde_json::Value = serde_json::from_str(&text).expect("json");
        let told = made.notes.iter().any(|n| n.contains("train_filenames"));
        (
            scene["train_filenames"].clone(),
            scene["test_filenames"].clone(),
            told,
        )
    };
    let list = |name: &str| serde_json::json!([format!("images/{name}.png")]);
    assert_eq!(split("a.png", "b.png"), (list("a"), list("b"), false));
    assert_eq!(split("./b.png", "a.png"), (list("b"), list("a"), false));
    let nothing = serde_json::Value::Null;
    assert_eq!(split("c.png", "a.png"), (nothing.clone(), nothing, true));
}

#[test]
fn a_folder_of_two_kinds_is_read_by_its_own_file_and_says_so() {
    let dir = tempfile::tempdir().expect("folder");
    colmap_model(&dir.path().join("colmap"));
    panorama(&dir.path().join("a.png"), 64);
    let text = format!(
        r#"{{"camera_model": "EQUIRECTANGULAR", "frames": [{}]}}"#,
        frame_of("a.png")
    );
    fs::write(dir.path().join("transforms.json"), text).expect("file");
    let out = dir.path().join("scene");
    let made = run(None, dir.path(), &out, &PrepareOptions::default()).expect("prepared");
    assert_eq!((made.kind, made.frames), ("nerfstudio", 1));
    let told = made.notes.iter().any(|n| n.contains("\"colmap\""));
    assert!(told, "{:?}", made.notes);
}
