//! `unbake check` on small scenes whose photographs and mesh do not fit.

mod shared;

use serde_json::Value;
use shared::shared;
use std::path::Path;
use std::process::Command;
use unbake::core::progress::Progress;
use unbake::programs::synth::{SynthOptions, generate};

fn check(scene: &Path, more: &[&str]) -> (Option<i32>, Value) {
    let out = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(["check", "--json", "--quiet"])
        .args(more)
        .arg(scene)
        .output()
        .expect("unbake runs");
    let json = serde_json::from_slice(&out.stdout).expect("JSON on stdout");
    (out.status.code(), json)
}

#[test]
fn cases_of_misalignment_are_refused_and_can_be_corrected() {
    for (case, expected) in [
        ("fc26-mirrored-panoramas", "mirrored"),
        ("fc29-mesh-in-millimetres", "mesh in millimetres"),
    ] {
        let Some(scene) = shared(format!("cases/{case}")) else {
            return;
        };
        let (code, json) = check(&scene, &[]);
        assert_eq!(code, Some(2), "{case}: {json:#}");
        assert_eq!(
            json["alignment"]["verdict"], "misaligned",
            "{case}: {json:#}"
        );
        let winner = json["alignment"]["winner"].as_str().unwrap_or_default();
        assert!(winner.contains(expected), "{case}: {winner}");
        let (code, json) = check(&scene, &["--fix-alignment"]);
        assert_eq!(code, Some(0), "{case}: {json:#}");
        assert_eq!(json["summary"]["hole_share"], 0.0, "{case}: {json:#}");
        assert_eq!(
            json["summary"]["unseen_area_share"], 0.0,
            "{case}: {json:#}"
        );
    }
}

fn run(arguments: &[&str]) {
    let done = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(arguments)
        .arg("--quiet")
        .output()
        .expect("unbake runs");
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{arguments:?}: {said}");
}

fn matrices(path: &Path) -> Vec<[[f64; 4]; 3]> {
    let json: Value = serde_json::from_slice(&std::fs::read(path).expect("reads")).expect("JSON");
    let matrix = |f: &Value| -> [[f64; 4]; 3] {
        let at = |r: usize, c: usize| f["transform_matrix"][r][c].as_f64().expect("a number");
        std::array::from_fn(|r| std::array::from_fn(|c| at(r, c)))
    };
    json["frames"]
        .as_array()
        .expect("frames")
        .iter()
        .map(matrix)
        .collect()
}

/// What `solve --fix-alignment` corrected holds for `export --scene` (and `render`, `relight`, which
/// take their cameras alike): photographs with OpenCV's axes are looked out of as they were taken.
#[test]
fn cameras_of_a_corrected_scene_are_corrected() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (scene, out, to) = (
        dir.path().join("s"),
        dir.path().join("o"),
        dir.path().join("x"),
    );
    let options = SynthOptions {
        rooms: 1,
        views: 6,
        test_views: 0,
        width: 192,
        spp: 2,
        texture: 256,
        ..SynthOptions::default()
    };
    generate(&options, &scene, &Progress::silent()).expect("generates");
    let file = scene.join("transforms.json");
    let right = matrices(&file);
    let mut json: Value =
        serde_json::from_slice(&std::fs::read(&file).expect("reads")).expect("JSON");
    for frame in json["frames"].as_array_mut().expect("frames") {
        for row in 0..3 {
            for column in [1, 2] {
                let x = frame["transform_matrix"][row][column]
                    .as_f64()
                    .expect("a number");
                frame["transform_matrix"][row][column] = (-x).into();
            }
        }
    }
    std::fs::write(&file, json.to_string()).expect("writes");
    let text = |p: &Path| p.to_str().expect("text").to_owned();
    let (scene, out, to) = (text(&scene), text(&out), text(&to));
    let sizes = [
        "--albedo-size",
        "64",
        "--roughness-size",
        "64",
        "--irradiance-size",
        "32",
    ];
    let mut solve = vec![
        "solve",
        &scene,
        "-o",
        &out,
        "--fix-alignment",
        "--quality",
        "draft",
    ];
    solve.extend(sizes);
    run(&solve);
    run(&[
        "export", &out, "--scene", &scene, "--views", "train", "--format", "glb", "--to", &to,
    ]);
    let exported = matrices(&Path::new(&to).join("cameras.json"));
    assert!(exported.len() >= 6 && exported.len() <= right.len());
    for e in &exported {
        let same =
            |r: &[[f64; 4]; 3]| (0..12).all(|i| (r[i / 4][i % 4] - e[i / 4][i % 4]).abs() < 1e-3);
        assert!(right.iter().any(same), "{e:?} is none of {right:?}");
    }
    // a manifest of another run is refused
    let manifest = Path::new(&out).join("manifest.json");
    let mut json: Value =
        serde_json::from_slice(&std::fs::read(&manifest).expect("reads")).expect("JSON");
    assert!(
        json["generation"].as_str().is_some_and(|g| g.len() == 32),
        "{json:#}"
    );
    json["generation"] = "0123".into();
    std::fs::write(&manifest, json.to_string()).expect("writes");
    let refused = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(["export", &out, "--scene", &scene, "--to", &to])
        .output()
        .expect("unbake runs");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(2) && said.contains("of another run"),
        "{said}"
    );
}
