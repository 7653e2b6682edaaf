//! Small scenes for tests, written to a temporary folder.
#![allow(dead_code)] // every test binary uses its own part of this

pub mod apartment;
pub mod lit;

use glam::Vec3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use unbake::core::formats;
use unbake::core::image::Plane;

/// Panorama size of the test scene.
pub const WIDTH: usize = 32;
/// Rows of the panorama.
pub const HEIGHT: usize = 16;

/// A scene folder that vanishes with the value.
pub struct SceneDir {
    dir: TempDir,
}

impl SceneDir {
    /// A closed room of 4 × 3 × 5 m with an atlas of six charts, one training and one held-out
    /// panorama of constant radiance 0.5, and labels: class 1 everywhere.
    pub fn box_room() -> Self {
        let scene = Self {
            dir: tempfile::tempdir().expect("temporary folder"),
        };
        scene.write("mesh.obj", box_obj(Vec3::new(4.0, 3.0, 5.0)).as_bytes());
        for stem in ["a", "b"] {
            let image = Plane::filled(WIDTH, HEIGHT, Vec3::splat(0.5));
            formats::write_rgb_float(scene.path(&format!("{stem}.exr")), &image).expect("image");
            formats::write_png16(
                scene.path(&format!("{stem}.png")),
                &Plane::filled(WIDTH, HEIGHT, 1u16),
            )
            .expect("labels");
        }
        let frame = |stem: &str, x: f64| {
            json!({"file_path": format!("{stem}.exr"), "label_path": format!("{stem}.png"),
                   "transform_matrix": [[1, 0, 0, x], [0, 1, 0, 1.5], [0, 0, 1, 2.5], [0, 0, 0, 1]]})
        };
        let transforms = json!({"camera_model": "EQUIRECTANGULAR", "w": WIDTH, "h": HEIGHT, "mesh_path": "mesh.obj",
            "classes": [{"id": 1, "name": "paint", "kind": "surface"}], "frames": [frame("a", 1.5), frame("b", 2.5)],
            "train_filenames": ["a.exr"], "test_filenames": ["b.exr"]});
        scene.write("transforms.json", transforms.to_string().as_bytes());
        scene
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.dir.path()
    }

    /// A file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Writes a file in the folder.
    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("test file");
    }

    /// Changes `transforms.json`.
    pub fn edit(&self, change: impl FnOnce(&mut Value)) {
        let mut value =
            serde_json::from_slice(&std::fs::read(self.path("transforms.json")).expect("file"))
                .expect("json");
        change(&mut value);
        self.write("transforms.json", value.to_string().as_bytes());
    }
}

/// A box from the origin to `size` seen from inside, each wall with its own third by half of the
/// atlas.
fn box_obj(size: Vec3) -> String {
    // corner indices by bits x, y, z; every quad winds so that it faces inwards
    let quads = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ];
    let mut text = String::new();
    for i in 0..8 {
        let bit = |k: usize| (i >> k & 1) as f32;
        text += &format!(
            "v {} {} {}\n",
            bit(0) * size.x,
            bit(1) * size.y,
            bit(2) * size.z
        );
    }
    for (q, quad) in quads.iter().enumerate() {
        let (u, v) = ((q % 3) as f32 / 3.0, (q / 3) as f32 / 2.0);
        for (du, dv) in [(0.01, 0.01), (0.32, 0.01), (0.32, 0.49), (0.01, 0.49)] {
            text += &format!("vt {} {}\n", u + du, v + dv);
        }
        let corner = |k: usize| format!("{}/{}", quad[k] + 1, 4 * q + k + 1);
        text += &format!(
            "f {} {} {} {}\n",
            corner(0),
            corner(1),
            corner(2),
            corner(3)
        );
    }
    text
}

/// An uncompressed single-precision OpenEXR of B, G, R, for pixels that writers refuse.
pub fn raw_exr(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> Vec<u8> {
    let mut b = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut attribute = |name: &str, kind: &str, data: &[u8]| {
        b.extend(name.bytes().chain([0]).chain(kind.bytes()).chain([0]));
        b.extend((data.len() as u32).to_le_bytes());
        b.extend(data);
    };
    let mut channels = Vec::new();
    for name in [b"B\0", b"G\0", b"R\0"] {
        channels.extend(name);
        channels.extend([2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]); // float, not linear-coded, sampling 1 × 1
    }
    channels.push(0);
    let window: Vec<u8> = [0, 0, width - 1, height - 1]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    attribute("channels", "chlist", &channels);
    attribute("compression", "compression", &[0]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1.0f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1.0f32.to_le_bytes());
    b.push(0);
    let line = 8 + 12 * u64::from(width);
    let first = b.len() as u64 + 8 * u64::from(height);
    (0..u64::from(height)).for_each(|y| b.extend((first + y * line).to_le_bytes()));
    for y in 0..height {
        b.extend(y.to_le_bytes());
        b.extend((12 * width).to_le_bytes());
        for _ in 0..3 {
            (0..width).for_each(|x| b.extend(value(x, y).to_le_bytes()));
        }
    }
    b
}
