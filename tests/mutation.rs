//! A few thousand damaged files per parser, the same ones in every run: each is read or refused,
//! none brings the program down. `fuzz/` holds the open-ended form for `cargo fuzz`.

mod common;

use glam::{Vec2, Vec3};
use std::path::Path;
use unbake::core::brdf::Reflectance;
use unbake::core::formats::{self, gltf::mesh_from_gltf, obj::mesh_from_obj, ply::mesh_from_ply};
use unbake::core::geometry::Mesh;
use unbake::core::image::{CameraMask, Plane};
use unbake::core::sampling::KeyedRng;
use unbake::scene::transforms::parse_transforms;
use unbake::solution::{FILES, SaveOptions, Solution, find_lamps};

/// Numbers that break careless code, in the bytes of the file's own kind.
const NASTY: [u32; 8] = [
    0,
    1,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fc0_0000,
    0x7f80_0000,
    0xff7f_ffff,
];

/// Damages `bytes` in one to four places: bits, bytes, words, cuts, repeats, and for texts other
/// tokens.
fn mutate(bytes: &[u8], rng: &mut KeyedRng) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..1 + rng.below(4) {
        if out.is_empty() {
            break;
        }
        let at = rng.below(out.len());
        match rng.below(8) {
            0 => out[at] ^= 1 << rng.below(8),
            1 => out[at] = rng.next_u32() as u8,
            2 => out.truncate(at),
            3 => {
                let word = NASTY[rng.below(NASTY.len())].to_le_bytes();
                for (o, w) in out[at..].iter_mut().zip(word) {
                    *o = w;
                }
            }
            4 => {
                let end = (at + 1 + rng.below(32)).min(out.len());
                let piece = out[at..end].to_vec();
                out.splice(at..at, piece);
            }
            5 => {
                let end = (at + 1 + rng.below(16)).min(out.len());
                out.drain(at..end);
            }
            6 => {
                let tokens: [&[u8]; 8] = [
                    b"-1",
                    b"1e999",
                    b"nan",
                    b"99999999999999999999",
                    b"\"",
                    b"{",
                    b"\n",
                    b"0",
                ];
                out.splice(at..at, tokens[rng.below(8)].iter().copied());
            }
            _ => {
                let middle = out.len() / 2;
                out.swap(at, middle);
            }
        }
    }
    out
}

/// Runs `read` on the intact bytes (must succeed), on every prefix up to a bound and on `count`
/// damaged copies.
fn hammer(bytes: &[u8], count: u64, mut read: impl FnMut(&[u8]) -> bool) {
    assert!(read(bytes), "the intact file is read");
    for cut in (0..bytes.len()).step_by((bytes.len() / 200).max(1)) {
        read(&bytes[..cut]);
    }
    let mut refused = 0;
    for key in 0..count {
        refused += u64::from(!read(&mutate(bytes, &mut KeyedRng::new(0xbad, key))));
    }
    assert!(
        refused > count / 20,
        "only {refused} of {count} were refused: is anything checked?"
    );
}

fn usable(e: &unbake::Error) -> bool {
    assert!(!e.to_string().is_empty());
    false
}

#[test]
fn wavefront_objects() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\nf -1 -2 -3\n";
    hammer(text.as_bytes(), 4_000, |b| {
        mesh_from_obj(b, Path::new("x.obj")).map_or_else(|e| usable(&e), |_| true)
    });
}

#[test]
fn polygon_files() {
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float s\n\
             property float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let read =
        |b: &[u8]| mesh_from_ply(b, Path::new("x.ply")).map_or_else(|e| usable(&e), |_| true);
    let text = head("ascii") + "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n";
    hammer(text.as_bytes(), 3_000, read);
    let mut binary = head("binary_little_endian").into_bytes();
    for v in [
        [0.0f32, 0.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 1.0],
    ] {
        v.iter().for_each(|x| binary.extend(x.to_le_bytes()));
    }
    binary.push(3);
    [0i32, 1, 2]
        .iter()
        .for_each(|i| binary.extend(i.to_le_bytes()));
    hammer(&binary, 3_000, read);
}

#[test]
fn binary_gltf() {
    let mut buffer = Vec::new();
    for v in [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        v.iter().for_each(|x| buffer.extend(x.to_le_bytes()));
    }
    [0u32, 1, 2]
        .iter()
        .for_each(|i| buffer.extend(i.to_le_bytes()));
    let mut json = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": buffer.len()}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}]
    })
    .to_string()
    .into_bytes();
    while !json.len().is_multiple_of(4) {
        json.push(b' ');
    }
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend(((28 + json.len() + buffer.len()) as u32).to_le_bytes());
    glb.extend((json.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(&json);
    glb.extend((buffer.len() as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(&buffer);
    hammer(&glb, 6_000, |b| {
        mesh_from_gltf(b, Path::new("x.glb")).map_or_else(|e| usable(&e), |_| true)
    });
}

#[test]
fn scene_descriptions() {
    let text = r#"{"camera_model": "OPENCV", "fl_x": 300, "fl_y": 300, "cx": 160, "cy": 120, "w": 320, "h": 240, "k1": 0.01,
        "mesh_path": "m.obj", "up_axis": "z", "classes": [{"id": 1, "name": "wall", "kind": "surface"}, {"id": 2, "name": "lamp",
        "kind": "light"}], "train_filenames": ["a.exr"], "test_filenames": ["b.exr"], "frames": [{"file_path": "a.exr", "label_path":
        "a.png", "exposure_ev": 1.5, "transform_matrix": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]}, {"file_path": "b.exr",
        "transform_matrix": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]}]}"#;
    hammer(text.as_bytes(), 5_000, |b| {
        match std::str::from_utf8(b).map(parse_transforms) {
            Ok(Ok(_)) => true,
            Ok(Err(issues)) => {
                assert!(
                    !issues.is_empty() && issues.iter().all(|i| !i.is_empty()),
                    "a refusal says why"
                );
                false
            }
            Err(_) => false,
        }
    });
}

#[test]
fn images_through_files() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let ramp = Plane {
        width: 9,
        height: 5,
        data: (0..45).map(|i| Vec3::new(i as f32, 1.0, 0.5)).collect(),
    };
    let two = ramp.map(|v| Vec2::new(v.x, v.y));
    let at = |name: &str| dir.path().join(name);
    formats::write_rgb_half(at("half.exr"), &ramp).expect("writes");
    formats::write_two_channels_half(at("two.exr"), &two).expect("writes");
    formats::write_png16(at("labels.png"), &ramp.map(|v| v.x as u16 * 1000)).expect("writes");
    std::fs::write(
        at("float.exr"),
        common::raw_exr(9, 5, |x, y| (x + y) as f32),
    )
    .expect("writes");
    let mut hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 5 +X 9\n".to_vec();
    hdr.extend((0..180u32).map(|i| (i * 37 % 251) as u8));
    std::fs::write(at("sky.hdr"), hdr).expect("writes");
    type Read = fn(&Path) -> unbake::Result<()>;
    let readers: [(&str, Read); 5] = [
        ("half.exr", |p| formats::read_rgb(p).map(drop)),
        ("two.exr", |p| formats::read_two_channels(p).map(drop)),
        ("float.exr", |p| formats::read_plane(p).map(drop)),
        ("labels.png", |p| formats::read_labels(p).map(drop)),
        ("sky.hdr", |p| formats::read_rgb(p).map(drop)),
    ];
    for (name, read) in readers {
        let bytes = std::fs::read(at(name)).expect("intact");
        let damaged = at(&format!("x-{name}"));
        let run = |b: &[u8]| {
            std::fs::write(&damaged, b).expect("writes");
            let info = formats::image_info(&damaged);
            read(&damaged).map_or_else(|e| usable(&e), |()| info.is_ok())
        };
        assert!(run(&bytes), "{name}");
        for key in 0..600 {
            run(&mutate(&bytes, &mut KeyedRng::new(0xfeed, key)));
        }
    }
}

/// A complete little solution: two triangles, textures of 4².
fn solution() -> Solution {
    let rgb = |scale: f32| Plane {
        width: 4,
        height: 4,
        data: (0..16)
            .map(|i| Vec3::new(i as f32, 1.0, 2.0) * scale)
            .collect(),
    };
    let mut solution = Solution {
        portals: Vec::new(),
        mesh: Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::Z],
            normals: vec![Vec3::Y; 4],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
        },
        origin: glam::DVec3::new(1.0, 2.0, 3.0),
        albedo: rgb(0.05),
        roughness: Plane::filled(4, 4, 0.5),
        irradiance: rgb(1.0),
        radiance: rgb(0.3),
        emission: rgb(0.1),
        confidence: Plane::filled(4, 4, Vec2::new(0.1, 0.2)),
        metallic: Some(Plane::filled(4, 4, 0.5)),
        transmission: None,
        irradiance_error: Some(Plane::filled(4, 4, 0.1)),
        labels: Plane::filled(4, 4, 3),
        rooms: Plane::filled(4, 4, 1),
        environment: rgb(0.2),
        reflectance: Reflectance::Burley,
        lamps: Vec::new(),
        camera_masks: vec![CameraMask {
            panorama: true,
            visible: Plane::filled(4, 2, true),
        }],
    };
    solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
    solution
}

/// One damaged file in a folder that is whole besides; the same folder is the seed corpus of
/// `fuzz/fuzz_targets/solution.rs`.
#[test]
fn solutions_on_disk() {
    let dir = tempfile::tempdir().expect("temporary folder");
    solution()
        .save(dir.path(), &SaveOptions::default())
        .expect("saves");
    Solution::load(dir.path()).expect("intact");
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/solution");
    if let Some(to) = std::env::var_os("UNBAKE_WRITE_SEEDS") {
        for entry in std::fs::read_dir(dir.path()).expect("lists").flatten() {
            std::fs::copy(entry.path(), Path::new(&to).join(entry.file_name())).expect("copies");
        }
    }
    let mut names: Vec<_> = std::fs::read_dir(dir.path())
        .expect("lists")
        .map(|e| e.expect("entry").file_name())
        .collect();
    names.sort();
    assert!(names.len() > FILES.len());
    for name in &names {
        let path = dir.path().join(name);
        let bytes = std::fs::read(&path).expect("reads");
        for key in 0..60 {
            let damaged = mutate(&bytes, &mut KeyedRng::new(0x50_1ed, key));
            std::fs::write(&path, damaged).expect("writes");
            if let Err(e) = Solution::load(dir.path()) {
                assert!(!e.to_string().is_empty());
            }
        }
        std::fs::write(&path, &bytes).expect("writes");
        let seed = seeds.join(name);
        assert!(seed.is_file(), "no seed {}", seed.display());
    }
    Solution::load(dir.path()).expect("intact again");
    Solution::load(&seeds).expect("the seeds are a solution");
}
