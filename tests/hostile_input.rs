//! Damaged and hostile scenes: each gives an error of exit code 2 that names the file, and none a
//! panic.

mod common;

use common::{HEIGHT, SceneDir, WIDTH, raw_exr};
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use unbake::Error;
use unbake::core::formats;
use unbake::core::image::Plane;
use unbake::scene::{LdrImages, LoadOptions, Mirror, Scene, check};

/// A change to `transforms.json` and what the refusal must say.
type Edit = (fn(&mut Value), &'static str);

/// Loads the scene and reads every pixel of it, as a solve would.
fn read_all(scene: &SceneDir, options: &LoadOptions) -> Result<Scene, Error> {
    let loaded = Scene::load(scene.folder(), options)?;
    for v in &loaded.views {
        loaded.load_radiance(v)?;
        loaded.load_labels(v)?;
        loaded.load_mask(v)?;
    }
    Ok(loaded)
}

/// Asserts that the scene is refused with all of `expected` in the message, by the loader and by
/// `check`.
#[track_caller]
fn refused(scene: &SceneDir, expected: &[&str]) {
    let error = read_all(scene, &LoadOptions::default()).expect_err("refused");
    assert_eq!(error.exit_code(), 2, "{error}");
    let text = error.to_string();
    for e in expected {
        assert!(text.contains(e), "\"{e}\" in:\n{text}");
    }
    let report = check(scene.folder(), &LoadOptions::default());
    assert!(!report.is_usable() && report.exit_code() == 2);
    for e in expected {
        assert!(report.to_string().contains(e), "\"{e}\" in:\n{report}");
    }
}

#[test]
fn the_intact_scene_is_accepted_and_understood() {
    let scene = SceneDir::box_room();
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    assert_eq!(loaded.origin, DVec3::new(2.0, 1.5, 2.5));
    assert!((loaded.views[0].camera.position - Vec3::new(-0.5, 0.0, 0.0)).length() < 1e-6);
    let report = check(scene.folder(), &LoadOptions::default());
    let s = report.summary.as_ref().expect("understood");
    assert!(report.is_usable(), "{report}");
    assert_eq!(
        (s.train_views, s.test_views, s.mesh.triangles, s.rooms.len()),
        (1, 1, 12, 1)
    );
    assert!(
        (s.mesh.area - 94.0).abs() < 1e-3 && s.hole_share == 0.0 && s.unseen_area_share < 1e-3,
        "{report}"
    );
    assert!((s.radiance.median - 0.5).abs() < 1e-5 && s.classes[0].pixel_share == 1.0);
    assert!(serde_json::to_value(&report).is_ok());
}

#[test]
fn missing_files_are_all_named_at_once() {
    let scene = SceneDir::box_room();
    for name in ["a.exr", "b.png", "mesh.obj"] {
        std::fs::remove_file(scene.path(name)).expect("removed");
    }
    refused(&scene, &["a.exr", "b.png", "mesh.obj"]);
    std::fs::remove_file(scene.path("transforms.json")).expect("removed");
    refused(&scene, &["transforms.json"]);
}

#[test]
fn pixels_that_are_not_finite_are_counted_and_can_be_ignored() {
    let scene = SceneDir::box_room();
    let bad = |x, y| {
        if (x, y) == (5, 3) {
            f32::NAN
        } else if (x, y) == (6, 9) {
            f32::INFINITY
        } else {
            0.5
        }
    };
    scene.write("a.exr", &raw_exr(WIDTH as u32, HEIGHT as u32, bad));
    refused(
        &scene,
        &["a.exr", "2 of 512 pixels", "column 5, row 3", "--clamp-nan"],
    );
    let options = LoadOptions {
        clamp_nan: true,
        ..LoadOptions::default()
    };
    let loaded = read_all(&scene, &options).expect("ignored");
    let (image, stats) = loaded
        .load_radiance_with_stats(&loaded.views[0])
        .expect("pixels");
    assert!(stats.not_finite == 2 && image.data.iter().all(|p| p.is_finite()));
    // infinite is a lower bound: as bright as the middle pixel, and known to be more
    assert!(stats.infinite == 1 && (image[(6, 9)] - Vec3::splat(0.5)).length() < 1e-6);
    let bits = loaded.ceiling_bits(&loaded.views[0], (&image, &stats));
    let bits = bits.expect("read").expect("a ceiling");
    assert!(bits[(6, 9)] == 7 && bits.data.iter().filter(|b| **b != 0).count() == 1);
    let mask = loaded
        .load_mask(&loaded.views[0])
        .expect("mask")
        .expect("some pixels are out");
    assert!(!mask[(5, 3)] && mask.data.iter().filter(|m| !**m).count() == 1);
    assert!(loaded.load_mask(&loaded.views[1]).expect("mask").is_none());
    // masked by the user: no error either
    let mut mask = Plane::filled(WIDTH, HEIGHT, 255u16);
    (mask[(5, 3)], mask[(6, 9)]) = (0, 0);
    formats::write_png16(scene.path("mask.png"), &mask).expect("mask");
    scene.edit(|t| t["frames"][0]["mask_path"] = json!("mask.png"));
    read_all(&scene, &LoadOptions::default()).expect("masked pixels may be anything");
}

#[test]
fn negative_pixels_become_black_and_are_counted() {
    let scene = SceneDir::box_room();
    scene.write(
        "a.exr",
        &raw_exr(
            WIDTH as u32,
            HEIGHT as u32,
            |x, _| if x == 0 { -0.1 } else { 0.5 },
        ),
    );
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    let (image, stats) = loaded
        .load_radiance_with_stats(&loaded.views[0])
        .expect("pixels");
    assert_eq!((stats.negative, image.data[0]), (HEIGHT, Vec3::ZERO));
}

#[test]
fn a_scene_without_any_light_is_refused() {
    let scene = SceneDir::box_room();
    let black = Plane::filled(WIDTH, HEIGHT, Vec3::ZERO);
    formats::write_rgb_float(scene.path("a.exr"), &black).expect("image");
    let report = check(scene.folder(), &LoadOptions::default());
    let said = report.problems.join("\n");
    assert!(said.contains("every training image is black"), "{report}");
    assert_eq!(report.exit_code(), 2);
}

/// Photographs that show one value, and one that two frames have, are told of by name.
#[test]
fn photographs_that_tell_nothing_new_are_named() {
    let scene = SceneDir::box_room();
    let said = || {
        check(scene.folder(), &LoadOptions::default())
            .warnings
            .join("\n")
    };
    for stem in ["a", "b"] {
        assert!(said().contains(&format!("{stem}: the image has one value everywhere")));
    }
    let ramp = |scale: f32| Plane {
        width: WIDTH,
        height: HEIGHT,
        data: (0..WIDTH * HEIGHT)
            .map(|i| Vec3::splat(scale * (i + 1) as f32))
            .collect(),
    };
    let write = |stem: &str, scale: f32| {
        formats::write_rgb_float(scene.path(&format!("{stem}.exr")), &ramp(scale)).expect("image");
    };
    write("a", 0.01);
    write("b", 0.01);
    let twice = said();
    assert!(
        twice.contains("views a and b have the same photograph"),
        "{twice}"
    );
    assert!(!twice.contains("one value everywhere"), "{twice}");
    write("b", 0.02);
    assert!(!said().contains("same photograph"));
}

/// Values that end at exactly 1 are clipped or made for a screen, and `color_space` says which.
#[test]
fn images_that_end_at_one_are_named() {
    let scene = SceneDir::box_room();
    let warned = || {
        let report = check(scene.folder(), &LoadOptions::default());
        assert!(report.is_usable(), "{report}");
        report.warnings.join("\n").contains("end at exactly 1")
    };
    assert!(!warned());
    // a lamp that falls off, cut off at 1
    let image = |most: f32| {
        let mut plane = Plane::filled(WIDTH, HEIGHT, Vec3::splat(0.5));
        for (i, p) in plane.data[..40].iter_mut().enumerate() {
            *p = (Vec3::new(1.0, 0.8, 0.5) * (40 - i) as f32 * 0.1).min(Vec3::splat(most));
        }
        plane
    };
    formats::write_rgb_float(scene.path("a.exr"), &image(1.0)).expect("image");
    assert!(warned());
    let report = check(scene.folder(), &LoadOptions::default());
    let light = report.summary.and_then(|s| s.recorded_light);
    assert_eq!(light.map(|l| (l.clipped_views, l.views)), Some((1, 1)));
    scene.edit(|t| t["color_space"] = json!("rec709"));
    assert!(!warned(), "the scene says that they are linear");
    scene.edit(|t| {
        t.as_object_mut().expect("an object").remove("color_space");
    });
    formats::write_rgb_float(scene.path("a.exr"), &image(1.5)).expect("image");
    assert!(!warned(), "a ceiling elsewhere is a sensor's");
}

/// What is missing stands there under a misspelt name: said before what follows from it.
#[test]
fn misspelt_keys_are_named_where_something_is_missing() {
    let scene = SceneDir::box_room();
    scene.edit(|t| {
        let map = t.as_object_mut().expect("an object");
        let train = map.remove("train_filenames").expect("a split");
        map.insert("train_filename".into(), train);
        map.insert("somebody_elses".into(), json!(1));
    });
    let report = check(scene.folder(), &LoadOptions::default());
    assert_eq!(report.exit_code(), 2);
    assert!(
        report.problems[0].contains("train_filename: no key known here; did you mean"),
        "{report}"
    );
    let said = report.problems.join("\n");
    assert!(!said.contains("somebody_elses"), "{report}");
}

#[test]
fn exposure_scales_radiance() {
    let scene = SceneDir::box_room();
    scene.edit(|t| t["frames"][0]["exposure_ev"] = json!(-2.0));
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    assert!(
        (loaded.load_radiance(&loaded.views[0]).expect("pixels").data[7] - Vec3::splat(0.125))
            .length()
            < 1e-6
    );
    scene.edit(|t| t["frames"][0]["exposure_ev"] = json!(1e9));
    refused(&scene, &["transforms.json", "exposure_ev"]);
}

#[test]
fn sizes_that_disagree_are_errors() {
    let scene = SceneDir::box_room();
    scene.edit(|t| t["w"] = json!(64));
    refused(&scene, &["a.exr", "32x16", "64x16"]);
    let scene = SceneDir::box_room();
    formats::write_png16(scene.path("a.png"), &Plane::filled(30, 30, 1u16)).expect("labels");
    refused(&scene, &["a.png", "30x30", "aspect"]);
    let scene = SceneDir::box_room();
    formats::write_rgb_float(scene.path("a.exr"), &Plane::filled(20, 16, Vec3::ONE))
        .expect("image");
    scene.edit(|t| {
        let t = t.as_object_mut().expect("object");
        t.remove("w");
        t.remove("h");
    });
    refused(&scene, &["a.exr", "no full panorama"]);
    let scene = SceneDir::box_room();
    let loaded = Scene::load(scene.folder(), &LoadOptions::default()).expect("usable");
    formats::write_rgb_float(scene.path("a.exr"), &Plane::filled(64, 32, Vec3::ONE))
        .expect("image");
    let e = loaded
        .load_radiance(&loaded.views[0])
        .expect_err("changed behind our back");
    assert!(e.exit_code() == 2 && e.to_string().contains("a.exr"), "{e}");
}

#[test]
fn labels_of_another_resolution_are_fine() {
    let scene = SceneDir::box_room();
    formats::write_png16(scene.path("a.png"), &Plane::filled(8, 4, 1u16)).expect("labels");
    read_all(&scene, &LoadOptions::default()).expect("same aspect");
}

#[test]
fn undeclared_ids_are_errors_unless_no_class_is_declared() {
    let scene = SceneDir::box_room();
    let mut labels = Plane::filled(WIDTH, HEIGHT, 1u16);
    labels[(7, 2)] = 65_535;
    formats::write_png16(scene.path("a.png"), &labels).expect("labels");
    refused(
        &scene,
        &["a.png", "65535", "column 7, row 2", "transforms.json"],
    );
    scene.edit(|t| drop(t.as_object_mut().expect("object").remove("classes")));
    let loaded = read_all(&scene, &LoadOptions::default()).expect("derived");
    assert_eq!(
        loaded.classes.iter().map(|c| c.id).collect::<Vec<_>>(),
        [1, 65_535]
    );
}

#[test]
fn bad_poses_and_splits_name_the_frame_and_the_key() {
    let cases: [Edit; 7] = [
        (
            |t| t["frames"][1]["transform_matrix"][0][0] = json!(0),
            "frames[1] (b.exr).transform_matrix: the pose is singular",
        ),
        (
            |t| t["frames"][1]["transform_matrix"][0][0] = json!(-1),
            "mirrored",
        ),
        (
            |t| {
                t["frames"][0]["transform_matrix"] =
                    json!([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])
            },
            "scaled by 2",
        ),
        (
            |t| t["train_filenames"] = json!([]),
            "train_filenames: empty",
        ),
        (
            |t| drop(t.as_object_mut().expect("object").remove("train_filenames")),
            "test_filenames without train_filenames",
        ),
        (
            |t| t["train_filenames"] = json!(["a.exr", "z.exr"]),
            "\"z.exr\" is no frame",
        ),
        (
            |t| t["test_filenames"] = json!(["a.exr", "b.exr"]),
            "\"a.exr\" is in train_filenames and test_filenames",
        ),
    ];
    for (change, expected) in cases {
        let scene = SceneDir::box_room();
        scene.edit(change);
        refused(&scene, &["transforms.json", expected]);
    }
}

#[test]
fn a_damaged_frame_does_not_hide_the_problems_of_others() {
    let scene = SceneDir::box_room();
    scene.edit(|t| t["frames"][0]["transform_matrix"] = json!(7));
    std::fs::remove_file(scene.path("b.exr")).expect("removed");
    scene.write("mesh.obj", b"f 1 2 3");
    refused(
        &scene,
        &["frames[0] (a.exr).transform_matrix", "b.exr", "mesh.obj"],
    );
    let text = Scene::load(scene.folder(), &LoadOptions::default())
        .expect_err("refused")
        .to_string();
    assert!(!text.contains("is no frame"), "{text}");
}

#[test]
fn duplicate_stems_are_errors() {
    let scene = SceneDir::box_room();
    std::fs::create_dir(scene.path("other")).expect("folder");
    std::fs::copy(scene.path("a.exr"), scene.path("other/a.exr")).expect("copy");
    scene.edit(|t| {
        t["frames"][1]["file_path"] = json!("other/a.exr");
        t["test_filenames"] = json!(["other/a.exr"]);
    });
    refused(&scene, &["transforms.json", "share the file stem \"a\""]);
}

#[test]
fn paths_out_of_the_folder_only_ever_read_and_fail_like_others() {
    let scene = SceneDir::box_room();
    scene.edit(|t| t["frames"][0]["label_path"] = json!("../../../../../../../../etc/passwd"));
    refused(&scene, &["passwd"]);
    for path in ["..", "/", "a.exr/..", "."] {
        let scene = SceneDir::box_room();
        scene.edit(|t| {
            t["frames"][0]["file_path"] = json!(path);
            t["train_filenames"] = json!([path]);
        });
        refused(&scene, &[]);
    }
}

#[test]
fn truncated_images_are_errors_at_every_length() {
    for name in ["a.exr", "a.png"] {
        let scene = SceneDir::box_room();
        let whole = std::fs::read(scene.path(name)).expect("file");
        for n in [0, 1, 4, 8, 30, whole.len() / 2, whole.len() - 5] {
            scene.write(name, &whole[..n]);
            refused(&scene, &[name]);
        }
    }
}

#[test]
fn display_referred_images_are_ordinary_input_unless_refused() {
    let scene = SceneDir::box_room();
    formats::write_png_rgb8(
        scene.path("c.png"),
        WIDTH,
        HEIGHT,
        &vec![255u8; 3 * WIDTH * HEIGHT],
    )
    .expect("image");
    scene.edit(|t| {
        t["frames"][0]["file_path"] = json!("c.png");
        t["train_filenames"] = json!(["c.png"]);
    });
    let strict = LoadOptions {
        ldr: LdrImages::Off,
        ..LoadOptions::default()
    };
    let refusal = read_all(&scene, &strict).expect_err("refused").to_string();
    assert!(
        refusal.contains("c.png") && refusal.contains("--ldr"),
        "{refusal}"
    );
    let loaded = read_all(&scene, &LoadOptions::default()).expect("ordinary");
    assert!(
        loaded
            .warnings
            .iter()
            .any(|w| w.contains("display-referred")),
        "{:?}",
        loaded.warnings
    );
    assert!(
        (loaded.load_radiance(&loaded.views[0]).expect("pixels").data[0] - Vec3::ONE).length()
            < 1e-5
    );
}

#[test]
fn hostile_meshes_are_errors() {
    let huge = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000000\nproperty float x\nproperty float y\nproperty float z\n\
                element face 4000000000000\nproperty list uint uint vertex_indices\nend_header\n";
    let accessor = r#"{"asset":{"version":"2.0"},"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":4000000000000,"type":"VEC3"}],
        "bufferViews":[{"buffer":0,"byteLength":48000000000000}],"buffers":[{"byteLength":48000000000000,"uri":"data:;base64,AAAA"}]}"#;
    let cases = [
        (
            "m.obj",
            "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
            "has an area",
        ),
        ("m.obj", "", "no faces"),
        ("m.obj", "v 0 0 0\nf 1 2 3\n", "m.obj"),
        ("m.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "m.obj"),
        ("m.ply", huge, "claims"),
        ("m.gltf", accessor, "claims"),
        ("m.glb", "glTF\u{2}\0\0\0", "truncated"),
        ("m.glb", "not a mesh", "malformed"),
        ("m.fbx", "x", ".glb"),
    ];
    for (name, text, expected) in cases {
        let scene = SceneDir::box_room();
        scene.write(name, text.as_bytes());
        scene.edit(|t| t["mesh_path"] = json!(name));
        refused(&scene, &[name, expected]);
    }
}

#[test]
fn a_file_that_is_no_scene_is_an_error() {
    for text in [
        "",
        "hello",
        "[1, 2]",
        "{\"frames\": 3}",
        "{\"frames\": [{\"file_path\": 1}], \"mesh_path\": 2}",
        "\u{feff}{",
    ] {
        let scene = SceneDir::box_room();
        scene.write("transforms.json", text.as_bytes());
        refused(&scene, &["transforms.json"]);
    }
    let scene = SceneDir::box_room();
    scene.write("transforms.json", &[0xff, 0xfe, 0x00, 0x80]);
    refused(&scene, &["transforms.json", "UTF-8"]);
}

#[test]
fn rooms_are_read_and_their_absence_or_damage_is_an_error() {
    let scene = SceneDir::box_room();
    scene.edit(|t| t["rooms_path"] = json!("rooms.png"));
    refused(&scene, &["rooms.png"]);
    let mut cells = Plane::filled(4, 5, 2u16);
    cells[(0, 0)] = 1;
    formats::write_png16(scene.path("rooms.png"), &cells).expect("grid");
    refused(&scene, &["rooms.json"]);
    scene.write("rooms.json", br#"{"cell": 0, "x_min": 0, "z_min": 0}"#);
    refused(&scene, &["rooms.json", "cell"]);
    scene.write("rooms.json", br#"{"cell": 1.0, "x_min": 0, "z_min": 0}"#);
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    let grid = loaded.rooms.as_ref().expect("rooms");
    let at = |x: f64, z: f64| grid.room_at((DVec3::new(x, 1.0, z) - loaded.origin).as_vec3());
    assert_eq!(
        (
            at(0.5, 0.5),
            at(1.5, 0.5),
            at(0.5, 4.5),
            at(-0.5, 1.0),
            at(4.5, 1.0)
        ),
        (1, 2, 2, 0, 0)
    );
}

#[test]
fn many_problems_are_shown_up_to_a_limit() {
    let scene = SceneDir::box_room();
    scene.edit(|t| {
        t["frames"] = (0..500)
            .map(|i| json!({"file_path": format!("{i}.exr")}))
            .collect()
    });
    let e = Scene::load(
        scene.folder(),
        &LoadOptions {
            max_issues: 10,
            ..LoadOptions::default()
        },
    )
    .expect_err("refused");
    let text = e.to_string();
    assert!(
        text.lines().count() < 15 && text.contains("more problems"),
        "{text}"
    );
}

/// Photographs that were stored upside down are turned as they are read; label images are right.
#[test]
fn photographs_upside_down_are_turned_and_labels_are_not() {
    let scene = SceneDir::box_room();
    let image = Plane {
        width: WIDTH,
        height: HEIGHT,
        data: (0..WIDTH * HEIGHT)
            .map(|i| Vec3::splat(1.0 + i as f32))
            .collect(),
    };
    formats::write_rgb_float(scene.path("a.exr"), &image).expect("image");
    let mut labels = Plane::filled(WIDTH, HEIGHT, 1u16);
    labels.data[0] = 0;
    formats::write_png16(scene.path("a.png"), &labels).expect("labels");
    let mut loaded = Scene::load(scene.folder(), &LoadOptions::default()).expect("usable");
    loaded.mirror = Mirror::UpsideDown;
    let mut turned = loaded.load_radiance(&loaded.views[0]).expect("radiance");
    turned.data.reverse();
    assert_eq!(turned.data, image.data);
    let read = loaded.load_labels(&loaded.views[0]).expect("labels");
    assert_eq!(read.expect("labels").data, labels.data);
}

/// Chroma that only every other pixel has is refused by name whatever the library makes of it.
#[test]
fn subsampled_channels_are_refused_by_the_header() {
    let scene = SceneDir::box_room();
    let mut image = raw_exr(WIDTH as u32, HEIGHT as u32, |_, _| 0.5);
    let blue = image
        .windows(3)
        .position(|w| w == b"B\0\x02")
        .expect("blue");
    image[blue + 10] = 2;
    image[blue + 14] = 2;
    scene.write("a.exr", &image);
    refused(&scene, &["channels of which B are subsampled", "R, G, B"]);
}

/// A plane of kilometres takes the atlas: said, with the way out.
#[test]
fn a_mesh_that_is_mostly_ground_is_named() {
    let scene = SceneDir::box_room();
    let room = std::fs::read_to_string(scene.path("mesh.obj")).expect("mesh");
    // without texture coordinates
    let bare = |line: &str| match line.strip_prefix("f ") {
        Some(corners) => {
            let of = |c: &str| c.split('/').next().unwrap_or("").to_owned();
            let corners: Vec<String> = corners.split(' ').map(of).collect();
            format!("f {}\n", corners.join(" "))
        }
        None if line.starts_with("v ") => format!("{line}\n"),
        None => String::new(),
    };
    let mut mesh: String = room.lines().map(bare).collect();
    for (x, z) in [(-1, -1), (1, -1), (1, 1), (-1, 1)] {
        mesh += &format!("v {} -0.2 {}\n", 5000 * x, 5000 * z);
    }
    mesh += "f -4 -2 -3\nf -4 -1 -2\n";
    scene.write("mesh.obj", mesh.as_bytes());
    let report = check(scene.folder(), &LoadOptions::default());
    let said = report.warnings.join("\n");
    assert!(report.is_usable(), "{report}");
    assert!(said.contains("remove ground planes"), "{report}");
    assert!(said.contains("texels per metre of surface"), "{report}");
}

/// An 8-bit picture saved as OpenEXR without undoing its curve is known by its levels.
#[test]
fn eight_bit_pictures_saved_as_openexr_are_taken_as_encoded() {
    let scene = SceneDir::box_room();
    let level = |i: usize| ((7 * i) % 200 + 40) as f32 / 255.0;
    let picture = |off: f32| {
        let mut plane = Plane::filled(WIDTH, HEIGHT, Vec3::ZERO);
        for (i, p) in plane.data.iter_mut().enumerate() {
            *p = Vec3::splat(level(i) + off);
        }
        plane
    };
    let read = || {
        let report = check(scene.folder(), &LoadOptions::default());
        assert!(report.is_usable(), "{report}");
        let said = report.warnings.join("\n").contains("8-bit picture");
        let loaded =
            unbake::scene::Scene::load(scene.folder(), &LoadOptions::default()).expect("scene");
        let view = loaded.train_views().next().expect("view");
        (said, loaded.load_radiance(view).expect("image").data[3].x)
    };
    let raw = level(3);
    let linear = ((raw + 0.055) / 1.055).powf(2.4);
    for half in [true, false] {
        let write = |plane: &Plane<Vec3>| match half {
            true => formats::write_rgb_half(scene.path("a.exr"), plane).map(drop),
            false => formats::write_rgb_float(scene.path("a.exr"), plane),
        };
        write(&picture(0.0)).expect("image");
        let (said, value) = read();
        assert!(said && (value - linear).abs() < 1e-3, "{value} {linear}");
        write(&picture(0.3 / 255.0)).expect("image");
        let (said, value) = read();
        assert!(!said && (value - raw).abs() < 2e-3, "{value} {raw}");
    }
    formats::write_rgb_float(scene.path("a.exr"), &picture(0.0)).expect("image");
    scene.edit(|t| t["color_space"] = json!("rec709"));
    let (said, value) = read();
    assert!(!said && value == raw, "the scene says that they are linear");
}

/// A PNG of the box room's size whose upper half is transparent.
fn half_transparent(path: &std::path::Path) {
    let alpha = |i: usize| if i < WIDTH * HEIGHT / 2 { 0 } else { 255 };
    let bytes: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|i| [188, 188, 188, alpha(i)])
        .collect();
    let file = std::fs::File::create(path).expect("file");
    let mut encoder = png::Encoder::new(file, WIDTH as u32, HEIGHT as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().expect("header");
    writer.write_image_data(&bytes).expect("pixels");
}

/// As OpenEXR's, and found by a name without its ending, as NeRF's scenes have it.
#[test]
fn transparent_pixels_of_png_are_left_out_and_counted() {
    let scene = SceneDir::box_room();
    half_transparent(&scene.path("photo.png"));
    scene.edit(|t| {
        t["frames"][0]["file_path"] = json!("photo");
        t["train_filenames"] = json!(["photo"]);
    });
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    let view = loaded.train_views().next().expect("view");
    let mask = loaded.load_mask(view).expect("read").expect("a mask");
    assert_eq!(mask.data.iter().filter(|m| **m).count(), WIDTH * HEIGHT / 2);
    assert!(!mask.data[0] && mask.data[WIDTH * HEIGHT - 1]);
    let report = check(scene.folder(), &LoadOptions::default());
    let said = report.warnings.join("\n");
    assert!(said.contains("alpha does not cover"), "{said}");
    assert!(said.contains("has no ending"), "{said}");
    let frame = &report.summary.as_ref().expect("understood").frames[0];
    assert!(frame.image.has_alpha && (frame.masked_share - 0.5).abs() < 1e-9);
    // two files of that name: which one is meant is not clear
    std::fs::copy(scene.path("a.exr"), scene.path("photo.exr")).expect("copy");
    refused(&scene, &["no such file", "photo"]);
}

/// A grey JPEG whose EXIF data state an exposure time of 1 / `under` s, and this orientation.
fn jpeg_with_exif(path: &std::path::Path, under: u32, orientation: u16) {
    // TIFF: IFD0 at 8 with orientation and a link to the EXIF IFD at 38, whose one entry is the
    // time, stored at 56
    let entry = |tag: u16, kind: u16, value: u32| {
        let mut bytes = Vec::new();
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(value.to_le_bytes());
        bytes
    };
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0".to_vec();
    exif.extend(entry(0x0112, 3, orientation.into()));
    exif.extend(entry(0x8769, 4, 38));
    exif.extend([0; 4]);
    exif.extend([1, 0]);
    exif.extend(entry(0x829a, 5, 56));
    exif.extend([0; 4]);
    exif.extend(1u32.to_le_bytes());
    exif.extend(under.to_le_bytes());
    let mut encoder = jpeg_encoder::Encoder::new_file(path, 95).expect("file");
    encoder.add_app_segment(1, exif).expect("EXIF");
    let (w, h) = (WIDTH as u16, HEIGHT as u16);
    let grey = vec![128; WIDTH * HEIGHT];
    encoder
        .encode(&grey, w, h, jpeg_encoder::ColorType::Luma)
        .expect("encoded");
}

#[test]
fn exposures_that_only_exif_states_are_levelled() {
    let scene = SceneDir::box_room();
    jpeg_with_exif(&scene.path("a.jpg"), 50, 1);
    jpeg_with_exif(&scene.path("b.jpg"), 200, 1);
    scene.edit(|t| {
        t["frames"][0]["file_path"] = json!("a.jpg");
        t["frames"][1]["file_path"] = json!("b.jpg");
        t["train_filenames"] = json!(["a.jpg", "b.jpg"]);
        t["test_filenames"] = json!([]);
        for i in 0..2 {
            t["frames"][i]
                .as_object_mut()
                .map(|f| f.remove("exposure_ev"));
        }
    });
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    let evs: Vec<f32> = loaded.views.iter().map(|v| v.exposure_ev).collect();
    assert!(evs[0] == 0.0 && (evs[1] - 2.0).abs() < 1e-5, "{evs:?}");
    let said = loaded.warnings.join("\n");
    assert!(said.contains("differ by up to 2.0 stops"), "{said}");
    // the scene says it: EXIF is not asked
    scene.edit(|t| t["frames"][0]["exposure_ev"] = json!(0.0));
    let loaded = read_all(&scene, &LoadOptions::default()).expect("usable");
    assert!(loaded.views.iter().all(|v| v.exposure_ev == 0.0));
}

#[test]
fn a_size_as_viewers_show_it_is_told_by_its_reason() {
    let scene = SceneDir::box_room();
    jpeg_with_exif(&scene.path("a.jpg"), 50, 6);
    scene.edit(|t| {
        t["frames"][0]["file_path"] = json!("a.jpg");
        t["frames"][0]["w"] = json!(HEIGHT);
        t["frames"][0]["h"] = json!(WIDTH);
        t["train_filenames"] = json!(["a.jpg"]);
    });
    refused(&scene, &["a.jpg", "EXIF orientation", "auto-orient"]);
}
