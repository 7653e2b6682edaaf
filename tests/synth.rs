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

/// With fittings the truth says of every pixel whether it is metal, and the scene names its
/// classes; without, nothing of it is there.
#[test]
fn metals_have_their_truth() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (plain, fitted) = (dir.path().join("plain"), dir.path().join("fitted"));
    let options = SynthOptions {
        full_paths: true,
        no_denoise: true,
        ..tiny()
    };
    make(&options, &plain, 2);
    let fittings = SynthOptions {
        fittings: true,
        truth: true,
        ..options
    };
    make(&fittings, &fitted, 2);
    let classes = |folder: &Path| {
        let text = std::fs::read_to_string(folder.join("transforms.json")).expect("reads");
        let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let name = |c: &serde_json::Value| (c["id"].as_u64(), c["name"].to_string());
        let list = all["classes"].as_array().expect("list");
        list.iter().map(name).collect::<Vec<_>>()
    };
    let metals = ["tap", "hood", "mirror", "handle", "planter", "table top"];
    let is_metal = |name: &str| metals.contains(&name.trim_matches('"'));
    assert!(!plain.join("gt/metallic").exists());
    assert!(classes(&plain).iter().all(|c| !is_metal(&c.1)));
    let classes = classes(&fitted);
    assert_eq!(
        classes.iter().filter(|c| is_metal(&c.1)).count(),
        metals.len()
    );
    let mut pixels = 0;
    for stem in ["000", "001", "002"] {
        let labels = formats::read_labels(fitted.join(format!("labels/{stem}.png")));
        let metallic = formats::read_plane(fitted.join(format!("gt/metallic/{stem}.exr")));
        let (labels, metallic) = (labels.expect("labels"), metallic.expect("truth"));
        for (label, m) in labels.data.iter().zip(&metallic.data) {
            let class = classes.iter().find(|c| c.0 == Some(u64::from(*label)));
            assert_eq!(*m > 0.5, class.is_some_and(|c| is_metal(&c.1)), "{label}");
            pixels += usize::from(*m > 0.5);
        }
    }
    assert!(pixels > 10, "{pixels} pixels of metal");
    let truth = unbake::solution::Solution::load(&fitted.join("gt/solution")).expect("loads");
    assert!(truth.metallic.is_some());
}

/// With panes the truth says of every pixel whether it shows one, and what is behind it is seen.
#[test]
fn panes_have_their_truth() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let options = SynthOptions {
        panes: true,
        truth: true,
        ..tiny()
    };
    let scene = dir.path().join("panes");
    make(&options, &scene, 2);
    let text = std::fs::read_to_string(scene.join("transforms.json")).expect("reads");
    assert!(
        text.contains("glass door") && text.contains("glass screen") && !text.contains("mirror")
    );
    let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let classes = all["classes"].as_array().expect("list");
    let is_glass = |label: u16| {
        let class = classes.iter().find(|c| c["id"] == u64::from(label));
        class.is_some_and(|c| c["name"].as_str().is_some_and(|n| n.starts_with("glass")))
    };
    let mut pixels = 0;
    for stem in ["000", "001", "002"] {
        let labels = formats::read_labels(scene.join(format!("labels/{stem}.png")));
        let image = formats::read_rgb(scene.join(format!("images/{stem}.exr"))).expect("image");
        let transmission = formats::read_plane(scene.join(format!("gt/transmission/{stem}.exr")));
        let (labels, transmission) = (labels.expect("labels"), transmission.expect("truth"));
        for (i, (label, t)) in labels.data.iter().zip(&transmission.data).enumerate() {
            assert_eq!(*t > 0.5, is_glass(*label), "{label}");
            if *t > 0.5 {
                pixels += 1;
                assert!(image.data[i].min_element() > 0.0, "black glass");
            }
        }
    }
    assert!(pixels > 10, "{pixels} pixels of glass");
    let truth = unbake::solution::Solution::load(&scene.join("gt/solution")).expect("loads");
    assert!(truth.transmission.is_some());
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
        SynthOptions {
            fittings: true,
            diffuse: true,
            ..tiny()
        },
        SynthOptions {
            panes: true,
            diffuse: true,
            ..tiny()
        },
    ] {
        let error = generate(&wrong, &dir.path().join("x"), &Progress::silent())
            .expect_err("unusable option");
        assert!(matches!(error, Error::Usage(_)), "{error}");
        assert!(!dir.path().join("x").exists());
    }
}
