//! Small files that ask for much, and inputs that are no files: refused at once, by name.

mod common;

use common::SceneDir;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use unbake::core::formats;
use unbake::core::image::Plane;
use unbake::scene::{LoadOptions, check};

/// No refusal takes longer: nothing that is asked for is read or made first.
const AT_ONCE: Duration = Duration::from_secs(10);

#[track_caller]
fn refused_at_once(scene: &SceneDir, expected: &str) {
    let begin = Instant::now();
    let report = check(scene.folder(), &LoadOptions::default());
    assert!(
        begin.elapsed() < AT_ONCE,
        "{expected}: {:?}",
        begin.elapsed()
    );
    let said = report.problems.join("\n");
    assert!(
        report.exit_code() == 2 && said.contains(expected),
        "\"{expected}\" in:\n{report}"
    );
}

/// A glTF in a scene whose buffer holds `vertices` triangle corners, changed by `edit`.
fn with_gltf(vertices: usize, edit: impl FnOnce(&mut Value)) -> SceneDir {
    let scene = SceneDir::box_room();
    let corners: Vec<u8> = (0..vertices)
        .flat_map(|i| [(i % 97) as f32, (i * 7 % 89) as f32, (i * 13 % 83) as f32])
        .flat_map(f32::to_le_bytes)
        .collect();
    let mut doc = json!({
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": corners.len()}],
        "buffers": [{"byteLength": corners.len(), "uri": "mesh.bin"}]
    });
    edit(&mut doc);
    scene.write("mesh.bin", &corners);
    scene.write("mesh.gltf", doc.to_string().as_bytes());
    scene.edit(|t| t["mesh_path"] = json!("mesh.gltf"));
    scene
}

#[test]
fn gltf_that_names_the_same_data_many_times_is_counted_before_it_is_read() {
    let vertices = 300_000;
    let nodes = with_gltf(vertices, |d| {
        d["nodes"] = (0..2000).map(|_| json!({"mesh": 0})).collect();
    });
    refused_at_once(&nodes, "ask for more than");
    let primitives = with_gltf(vertices, |d| {
        let one = d["meshes"][0]["primitives"][0].clone();
        d["meshes"][0]["primitives"] = vec![one; 5000].into();
    });
    refused_at_once(&primitives, "ask for more than");
    let nested = with_gltf(3, |d| {
        let mut nodes: Vec<Value> = (0..60)
            .map(|i| json!({"children": [i + 1, i + 1]}))
            .collect();
        nodes.push(json!({"mesh": 0}));
        d["nodes"] = nodes.into();
        d["scenes"] = json!([{"nodes": [0]}]);
    });
    refused_at_once(&nested, "nested too deeply");
}

#[test]
fn buffers_lie_beside_the_mesh() {
    for uri in ["/dev/zero", "../../../../../../etc/passwd", "a/../../x.bin"] {
        let scene = with_gltf(3, |d| d["buffers"][0]["uri"] = json!(uri));
        refused_at_once(&scene, "only files beside the mesh or below are read");
    }
}

#[cfg(unix)]
#[test]
fn only_regular_files_are_read() {
    for name in ["transforms.json", "mesh.obj", "a.exr", "a.png"] {
        let scene = SceneDir::box_room();
        std::fs::remove_file(scene.path(name)).expect("removed");
        std::os::unix::fs::symlink("/dev/zero", scene.path(name)).expect("a link");
        refused_at_once(&scene, "expected a regular file");
    }
}

#[test]
fn labels_are_not_much_finer_than_their_photograph() {
    let scene = SceneDir::box_room();
    formats::write_png16(scene.path("a.png"), &Plane::filled(8192, 4096, 1u16)).expect("labels");
    refused_at_once(&scene, "expected at most 8 times as many columns");
    let scene = SceneDir::box_room();
    formats::write_png16(scene.path("a.png"), &Plane::filled(1024, 512, 1u16)).expect("labels");
    assert!(check(scene.folder(), &LoadOptions::default()).is_usable());
}
