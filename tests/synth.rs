//! A whole synthetic scene folder at the smallest useful size: complete, readable, reproducible,
//! and careful with what exists.

use std::path::Path;
use unbake::Error;
use unbake::core::formats;
use unbake::core::progress::Progress;
use unbake::programs::synth::{SynthOptions, SynthSummary, generate};

fn tiny() -> SynthOptions {
    SynthOptions {
        rooms: 1,
        views: 3,
        test_views: 1,
        width: 64,
        spp: 2,
        texture: 256,
        ..SynthOptions::default()
    }
}

fn make(options: &SynthOptions, folder: &Path, threads: usize) -> SynthSummary {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("pool");
    pool.install(|| generate(options, folder, &Progress::silent()))
        .expect("generates")
}

#[test]
fn a_scene_folder_is_complete_and_the_same_for_any_number_of_threads() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    let summary = make(&tiny(), &a, 1);
    assert_eq!((summary.train_views, summary.test_views), (2, 1));
    assert!(
        summary.triangles > 5_000 && summary.classes > 8,
        "{summary:?}"
    );
    assert!(
        summary.median_radiance > 0.05 && summary.median_radiance < 3.0,
        "{summary:?}"
    );
    assert_eq!(make(&tiny(), &b, 3), summary);
    let image = formats::read_rgb(a.join("images/000.exr")).expect("image");
    assert_eq!((image.width, image.height), (64, 32));
    assert_eq!(
        image,
        formats::read_rgb(b.join("images/000.exr")).expect("image"),
        "bits differ between thread counts"
    );
    assert!(
        image
            .data
            .iter()
            .all(|c| c.is_finite() && c.min_element() >= 0.0)
    );
    let labels = formats::read_labels(a.join("labels/000.png")).expect("labels");
    let albedo = formats::read_rgb(a.join("gt/albedo/000.exr")).expect("albedo");
    let roughness = formats::read_plane(a.join("gt/roughness/000.exr")).expect("roughness");
    for ((l, c), r) in labels.data.iter().zip(&albedo.data).zip(&roughness.data) {
        assert!(
            *l == 0 || (c.min_element() > 0.0 && c.max_element() < 0.9 && *r >= 0.05 && *r <= 1.0),
            "{l} {c} {r}"
        );
    }
    for file in [
        "transforms.json",
        "mesh.glb",
        "rooms.png",
        "rooms.json",
        "gt/materials.json",
        "gt/albedo_texture.exr",
        "synth.json",
    ] {
        assert!(a.join(file).is_file(), "{file} is missing");
    }
    let left: Vec<_> = std::fs::read_dir(dir.path())
        .expect("lists")
        .map(|e| e.expect("entry").file_name())
        .collect();
    assert_eq!(left.len(), 2, "temporary folders remain: {left:?}");
    // the program's own importer takes it
    let scene =
        unbake::scene::Scene::load(&a, &unbake::scene::LoadOptions::default()).expect("loads");
    assert_eq!(scene.views.len(), 3);
}

#[test]
fn refuses_what_it_cannot_do() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let strangers = dir.path().join("photos");
    std::fs::create_dir(&strangers).expect("folder");
    std::fs::write(strangers.join("a.txt"), "mine").expect("file");
    let error = generate(&tiny(), &strangers, &Progress::silent())
        .expect_err("must not replace a stranger's folder");
    assert_eq!(error.exit_code(), 2);
    assert!(strangers.join("a.txt").is_file());
    for wrong in [
        SynthOptions { rooms: 0, ..tiny() },
        SynthOptions { views: 0, ..tiny() },
        SynthOptions {
            test_views: 3,
            ..tiny()
        },
        SynthOptions { width: 7, ..tiny() },
        SynthOptions { spp: 0, ..tiny() },
        SynthOptions {
            texture: 1,
            ..tiny()
        },
    ] {
        let error = generate(&wrong, &dir.path().join("x"), &Progress::silent())
            .expect_err("unusable option");
        assert!(matches!(error, Error::Usage(_)), "{error}");
        assert!(!dir.path().join("x").exists());
    }
}
