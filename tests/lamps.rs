//! One list of lamps: `lights.json`, `relight --list-lamps`, the viewer, the exported point lights
//! and the report name the same lamps by the same numbers.

mod shared;

use serde_json::Value;
use shared::shared;
use std::path::Path;
use std::process::Command;
use unbake::programs::export::punctual_lights;
use unbake::programs::synth::{SynthOptions, generate};
use unbake::programs::view::Content;
use unbake::{Progress, Solution};

fn unbake(arguments: &[&str]) -> Vec<u8> {
    let out = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(arguments)
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(0), "{arguments:?}: {said}");
    out.stdout
}

/// (id, centre) of each lamp of a JSON list.
fn named(list: &Value) -> Vec<(u64, Vec<f64>)> {
    let of = |lamp: &Value| {
        let centre = lamp["centre"].as_array().expect("a centre");
        (
            lamp["id"].as_u64().expect("an id"),
            centre.iter().filter_map(Value::as_f64).collect(),
        )
    };
    list.as_array().expect("a list").iter().map(of).collect()
}

/// Solves coarsely and compares what every program lists.
fn all_list_the_same(scene: &Path) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let out = dir.path().join("out");
    let (scene, out) = (scene.to_str().expect("UTF-8"), out.to_str().expect("UTF-8"));
    let side = |name| [name, "256"];
    let mut arguments = vec!["solve", scene, "-o", out, "--quality", "draft"];
    arguments.extend(side("--albedo-size"));
    arguments.extend(side("--roughness-size"));
    arguments.extend(side("--irradiance-size"));
    arguments.extend(["--photo-reduction", "2", "--quiet"]);
    unbake(&arguments);

    let folder = Path::new(out);
    let bytes = std::fs::read(folder.join("lights.json")).expect("lights.json");
    let file: Value = serde_json::from_slice(&bytes).expect("JSON");
    // portals follow the lamps and windows: the environment shines through them, not they
    let is_portal = |light: &&Value| light["kind"] == "portal";
    let lights = file["lights"].as_array().expect("lights");
    let portals: Vec<&Value> = lights.iter().filter(is_portal).collect();
    let (stored, last) = lights.split_at(lights.len() - portals.len());
    assert!(last.iter().all(|l| is_portal(&l)), "portals come last");
    let stored = named(&Value::from(stored.to_vec()));
    assert!(!stored.is_empty(), "the scene has lamps");
    let ids: Vec<u64> = named(&file["lights"]).iter().map(|l| l.0).collect();
    assert!(ids.iter().copied().eq(1..=ids.len() as u64), "{ids:?}");
    let ids = ids[..stored.len()].to_vec();

    let listed = unbake(&["relight", out, "--list-lamps", "--json"]);
    let listed: Value = serde_json::from_slice(&listed).expect("JSON");
    assert_eq!(named(&listed["lamps"]), stored, "relight --list-lamps");

    let solution = Solution::load(folder).expect("loads");
    let points: Vec<String> = punctual_lights(&solution)
        .into_iter()
        .map(|l| l.name)
        .collect();
    let expected: Vec<String> = ids.iter().map(|id| format!("lamp {id}")).collect();
    assert_eq!(points, expected, "the exported point lights");

    let to = dir.path().join("usd");
    let usd = to.to_str().expect("UTF-8");
    unbake(&[
        "export", out, "-o", usd, "--format", "usd", "--lights", "--split", "objects", "--quiet",
    ]);
    let usd = std::fs::read_to_string(to.join("scene.usda")).expect("scene.usda");
    let prims: Vec<u64> = usd
        .lines()
        .filter(|l| {
            ["def RectLight", "def DiskLight", "def SphereLight"]
                .iter()
                .any(|d| l.contains(d))
        })
        .filter_map(|l| l.trim_end_matches('"').rsplit('_').next()?.parse().ok())
        .collect();
    assert_eq!(prims, ids, "the lights of USD");
    assert!(
        usd.contains("string name = \"wall"),
        "objects have their class's name"
    );

    let to = dir.path().join("lit");
    let lit = to.to_str().expect("UTF-8");
    let file = dir.path().join("lightings.toml");
    std::fs::write(
        &file,
        "[[lighting]]\nname = \"off\"\n[[lighting.lamp]]\noff = true\n",
    )
    .expect("writes");
    let file = file.to_str().expect("UTF-8");
    let small = ["--lightmap-size", "32", "--lightmap-paths", "8", "--quiet"];
    unbake(&[&["export", out, "-o", lit, "--lightings", file], &small[..]].concat());
    let bytes = std::fs::read(to.join("manifest.json")).expect("manifest.json");
    let manifest: Value = serde_json::from_slice(&bytes).expect("JSON");
    let variant = &manifest["variants"][0];
    let listed = variant["lamps"].as_array().expect("lamps");
    assert!(
        listed
            .iter()
            .all(|l| l["factor"] == serde_json::json!([0.0, 0.0, 0.0]))
    );
    let listed: Vec<u64> = listed.iter().filter_map(|l| l["id"].as_u64()).collect();
    assert_eq!(listed, ids, "the lit variants");

    let page = Content::new(solution, None, None)
        .expect("content")
        .description();
    assert_eq!(named(&page["lights"]), stored, "the viewer");
    let mut in_sliders: Vec<u64> = page["lamps"]
        .as_array()
        .expect("sliders")
        .iter()
        .flat_map(|slider| slider["ids"].as_array().cloned().unwrap_or_default())
        .filter_map(|id| id.as_u64())
        .collect();
    in_sliders.sort_unstable();
    assert_eq!(in_sliders, ids, "every lamp has its place in one slider");

    let report = std::fs::read_to_string(folder.join("report.html")).expect("report.html");
    assert!(report.contains("id=\"lights\""), "the report lists lights");
}

#[test]
fn every_program_lists_the_lamps_of_the_synthetic_apartment() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let scene = dir.path().join("scene");
    let options = SynthOptions {
        rooms: 2,
        views: 8,
        test_views: 1,
        width: 192,
        spp: 4,
        texture: 256,
        ..SynthOptions::default()
    };
    generate(&options, &scene, &Progress::silent()).expect("generates");
    all_list_the_same(&scene);
}

#[test]
fn every_program_lists_the_lamps_of_a_house_of_five_rooms() {
    if let Some(scene) = shared("scenes/aws-house") {
        all_list_the_same(&scene);
    }
}
