//! `unbake prepare` on the real captures beside the repository (`../shared/captures`, or
//! `$UNBAKE_SHARED/captures`); skipped with a message where they are absent.

mod shared;

use shared::shared;
use unbake::core::progress::Progress;
use unbake::programs::prepare::{PrepareOptions, Prepared, prepare};
use unbake::scene::{LdrImages, LoadOptions, Scene};

fn prepared(path: &std::path::Path, out: &std::path::Path) -> Prepared {
    let options = PrepareOptions {
        link: true,
        ..PrepareOptions::default()
    };
    prepare(None, path, out, &options, &Progress::silent()).expect("prepared")
}

fn load(path: &std::path::Path) -> Scene {
    let options = LoadOptions {
        ldr: LdrImages::On,
        ..LoadOptions::default()
    };
    Scene::load(path, &options).expect("a scene that loads")
}

#[test]
fn the_zind_tour_equals_the_scene_made_by_hand() {
    let (Some(tour), Some(by_hand)) = (
        shared("captures/zind-sample-tour"),
        shared("captures/zind-scene"),
    ) else {
        return;
    };
    let dir = tempfile::tempdir().expect("folder");
    let out = dir.path().join("scene");
    let made = prepared(&tour, &out);
    assert_eq!((made.kind, made.frames, made.rooms), ("zind", 32, 15));
    let (ours, theirs) = (load(&out), load(&by_hand));
    assert_eq!(ours.views.len(), theirs.views.len());
    for (a, b) in ours.views.iter().zip(&theirs.views) {
        assert_eq!((&a.stem, a.split), (&b.stem, b.split));
        let place = |s: &Scene, p: glam::Vec3| s.origin + p.as_dvec3();
        let apart = place(&ours, a.camera.position) - place(&theirs, b.camera.position);
        assert!(apart.length() < 1e-3, "{}: {apart}", a.stem);
        let turned = a.camera.world_from_camera - b.camera.world_from_camera;
        let largest = turned
            .to_cols_array()
            .iter()
            .fold(0.0f32, |m, x| m.max(x.abs()));
        assert!(largest < 1e-5, "{}: {largest}", a.stem);
        let labels = |v: &unbake::scene::View| {
            unbake::core::formats::read_labels(v.label_path.as_ref().expect("labels")).expect("ids")
        };
        let (p, q) = (labels(a), labels(b));
        let other = p.data.iter().zip(&q.data).filter(|(x, y)| x != y).count();
        // rays that graze an edge may fall to either side
        assert!(other * 10_000 < p.data.len(), "{}: {other} pixels", a.stem);
    }
    let area = |s: &Scene| {
        (0..s.mesh.triangles.len())
            .map(|t| s.mesh.area(t))
            .sum::<f32>()
    };
    assert!((area(&ours) / area(&theirs) - 1.0).abs() < 1e-4);
}

#[test]
fn the_texir_export_equals_the_scene_it_was_made_from() {
    let (Some(export), Some(original)) =
        (shared("scenes/aws-house-texir"), shared("scenes/aws-house"))
    else {
        return;
    };
    let dir = tempfile::tempdir().expect("folder");
    let out = dir.path().join("scene");
    let made = prepared(&export, &out);
    assert_eq!((made.kind, made.frames, made.rooms), ("texir", 13, 5));
    let hdr = LoadOptions::default();
    let ours = Scene::load(&out, &hdr).expect("loads");
    let theirs = Scene::load(&original, &hdr).expect("loads");
    for a in &ours.views {
        let b = theirs
            .views
            .iter()
            .find(|v| v.stem == a.stem)
            .expect("view");
        let place = |s: &Scene, p: glam::Vec3| s.origin + p.as_dvec3();
        let apart = place(&ours, a.camera.position) - place(&theirs, b.camera.position);
        assert!(apart.length() < 1e-4, "{}: {apart}", a.stem);
        let turned = a.camera.world_from_camera - b.camera.world_from_camera;
        let off = turned
            .to_cols_array()
            .iter()
            .fold(0.0f32, |m, x| m.max(x.abs()));
        assert!(off < 1e-5, "{}: {off}", a.stem);
        assert_eq!(a.exposure_ev, 5.0);
    }
    let (p, q) = (
        unbake::core::formats::read_rgb(&ours.views[0].image_path).expect("image"),
        unbake::core::formats::read_rgb(&theirs.views[0].image_path).expect("image"),
    );
    // (the export's panoramas are a half as wide and high)
    let mean = |i: &unbake::core::image::RgbPlane| {
        i.data.iter().map(|v| f64::from(v.y)).sum::<f64>() / i.data.len() as f64
    };
    let ratio: f64 = 32.0 * mean(&p) / mean(&q);
    assert!((ratio - 1.0).abs() < 0.02, "radiance {ratio}");
}

#[test]
fn roomplan_is_a_labelled_mesh() {
    let Some(room) = shared("captures/roomplan") else {
        return;
    };
    let dir = tempfile::tempdir().expect("folder");
    let made = prepared(&room, &dir.path().join("scene"));
    assert_eq!((made.kind, made.frames), ("roomplan", 0));
    // 26 walls, 3 doors, a window and furniture as boxes of 12, and the floor
    assert!(made.triangles > 40 * 12, "{}", made.triangles);
    let text = made.notes.join("\n");
    for class in ["wall", "door", "window", "floor", "sofa", "television"] {
        assert!(text.contains(class), "{class} in {text}");
    }
}

#[test]
fn real_brackets_agree_among_themselves() {
    for (name, stops) in [("brackets-room", 13.0), ("brackets-handheld", 4.0)] {
        let Some(folder) = shared(format!("captures/{name}")) else {
            return;
        };
        let dir = tempfile::tempdir().expect("folder");
        let out = dir.path().join("scene");
        let made = prepared(&folder, &out);
        assert_eq!((made.kind, made.frames), ("brackets", 1));
        let text = made.notes.join("\n");
        assert!(text.contains(&format!("over {stops:.1} stops")), "{text}");
        let image = std::fs::read_dir(out.join("images"))
            .expect("images")
            .flatten()
            .next()
            .expect("one image");
        let hdr = unbake::core::formats::read_rgb(image.path()).expect("image");
        assert!(
            hdr.data
                .iter()
                .all(|v| v.is_finite() && v.min_element() >= 0.0)
        );
    }
}
