//! `unbake prepare --depth-model`, `--semantic-model`: networks of one layer whose answers are closed forms, written here
//! byte by byte; without the feature `onnx`, the refusal.

use serde_json::json;
use std::path::{Path, PathBuf};
use unbake::core::formats;
use unbake::core::progress::Progress;
use unbake::programs::prepare::{NetworkOptions, PrepareOptions, Prepared, prepare};

/// Bytes of a protobuf message, field after field.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut n: u64) {
        while n > 127 {
            self.0.push((n & 127) as u8 | 128);
            n >>= 7;
        }
        self.0.push(n as u8);
    }

    fn number(mut self, field: u64, n: u64) -> Self {
        self.varint(field << 3);
        self.varint(n);
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn text(self, field: u64, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }

    fn message(self, field: u64, of: Message) -> Self {
        self.bytes(field, &of.0)
    }
}

/// A network `y = operator(x, weights, bias)` with a 1×1 kernel.
struct Network<'a> {
    operator: &'a str,
    /// Sides of the input; 0 = any.
    input: &'a [u64],
    /// Rows of three.
    weights: &'a [f32],
    bias: &'a [f32],
    properties: &'a [(&'a str, &'a str)],
}

impl Network<'_> {
    fn write(&self, path: &Path) -> PathBuf {
        let value = |name: &str, sides: &[u64]| {
            let dimension = |s: &u64| match s {
                0 => Message::default().text(2, "free"),
                n => Message::default().number(1, *n),
            };
            let shape = (sides.iter()).fold(Message::default(), |m, s| m.message(1, dimension(s)));
            let tensor = Message::default().number(1, 1).message(2, shape);
            let kind = Message::default().message(1, tensor);
            Message::default().text(1, name).message(2, kind)
        };
        let tensor = |name: &str, sides: &[u64], data: &[f32]| {
            let raw: Vec<u8> = data.iter().flat_map(|v| v.to_le_bytes()).collect();
            let start = Message::default();
            let sides = sides.iter().fold(start, |m, s| m.number(1, *s));
            sides.number(2, 1).text(8, name).bytes(9, &raw)
        };
        let node = ["x", "w", "b"].into_iter();
        let node = node.fold(Message::default(), |m, i| m.text(1, i));
        let node = node.text(2, "y").text(3, "only").text(4, self.operator);
        let channels = self.bias.len() as u64;
        let graph = Message::default()
            .message(1, node)
            .text(2, "graph")
            .message(5, tensor("w", &[channels, 3, 1, 1], self.weights))
            .message(5, tensor("b", &[channels], self.bias))
            .message(11, value("x", self.input))
            .message(12, value("y", &[1, channels, 0, 0]));
        let opset = Message::default().text(1, "").number(2, 13);
        let mut model = Message::default()
            .number(1, 8)
            .message(7, graph)
            .message(8, opset);
        for (key, text) in self.properties {
            model = model.message(14, Message::default().text(1, key).text(2, text));
        }
        std::fs::write(path, model.0).expect("network");
        path.to_path_buf()
    }
}

/// Pixels as they are.
const PLAIN: [(&str, &str); 2] = [("mean", "[0, 0, 0]"), ("std", "[1, 1, 1]")];

/// A frame of a capture: its camera's keys, its place, and its sRGB pixels.
struct Frame<'a> {
    name: &'a str,
    size: [usize; 2],
    place: [f64; 3],
    model: &'a str,
}

/// A capture in nerfstudio's layout.
fn capture(dir: &Path, frames: &[Frame<'_>], pixel: impl Fn(&Frame<'_>, usize, usize) -> [u8; 3]) {
    std::fs::create_dir_all(dir).expect("folder");
    let entry = |f: &Frame<'_>| {
        let [w, h] = f.size;
        let rgb: Vec<u8> = (0..w * h).flat_map(|i| pixel(f, i % w, i / w)).collect();
        formats::write_png_rgb8(dir.join(f.name), w, h, &rgb).expect("photograph");
        let [x, y, z] = f.place;
        json!({
            "file_path": f.name, "w": w, "h": h, "camera_model": f.model,
            "fl_x": w, "fl_y": w, "cx": w as f64 / 2.0, "cy": h as f64 / 2.0,
            "transform_matrix": [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]],
        })
    };
    let frames: Vec<_> = frames.iter().map(entry).collect();
    let scene = json!({"up_axis": "y", "frames": frames});
    std::fs::write(dir.join("transforms.json"), scene.to_string()).expect("scene");
}

fn run(dir: &Path, out: &Path, networks: NetworkOptions) -> unbake::Result<Prepared> {
    let options = PrepareOptions {
        networks,
        link: true,
        ..PrepareOptions::default()
    };
    prepare(Some("nerfstudio"), dir, out, &options, &Progress::silent())
}

fn semantic(path: PathBuf) -> NetworkOptions {
    NetworkOptions {
        semantic_model: Some(path),
        ..NetworkOptions::default()
    }
}

#[cfg(not(feature = "onnx"))]
#[test]
fn a_program_without_networks_says_how_to_get_one() {
    let dir = tempfile::tempdir().expect("folder");
    let frame = Frame {
        name: "a.png",
        size: [8, 4],
        place: [0.0; 3],
        model: "EQUIRECTANGULAR",
    };
    capture(dir.path(), &[frame], |_, _, _| [1, 2, 3]);
    let network = Network {
        operator: "Conv",
        input: &[1, 3, 4, 8],
        weights: &[1.0; 6],
        bias: &[0.0; 2],
        properties: &PLAIN,
    };
    let path = network.write(&dir.path().join("n.onnx"));
    let e = run(dir.path(), &dir.path().join("out"), semantic(path));
    let e = e.expect_err("no engine").to_string();
    assert!(e.contains("--features onnx") && e.contains("n.onnx"), "{e}");
    assert!(!dir.path().join("out").exists());
}

#[cfg(feature = "onnx")]
mod with {
    use super::*;
    use glam::Vec3;
    use unbake::core::image::Plane;
    use unbake::programs::prepare::{DepthFit, DepthValues};
    use unbake::scene::{LdrImages, LoadOptions, Scene};

    const NAMES: (&str, &str) = (
        "names",
        r#"["ceiling lamp", "wall", "floor", "background"]"#,
    );

    /// Channels say how red, green and blue a pixel is; the last one is best where all are dark.
    fn colours<'a>(input: &'a [u64], properties: &'a [(&'a str, &'a str)]) -> Network<'a> {
        Network {
            operator: "Conv",
            input,
            weights: &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            bias: &[0.0, 0.0, 0.0, 0.5],
            properties,
        }
    }

    #[test]
    fn labels_are_the_strongest_channel_however_a_photograph_is_tiled() {
        let properties = [PLAIN[0], PLAIN[1], NAMES];
        // sixteen columns wide stripes: red, green, blue, black
        let stripe = |_: &Frame<'_>, x: usize, _: usize| match x / 16 % 4 {
            3 => [40; 3],
            k => std::array::from_fn(|c| if c == k { 230 } else { 60 }),
        };
        let frame = |model| Frame {
            name: "a.png",
            size: [128, 64],
            place: [0.0; 3],
            model,
        };
        for (model, input) in [
            ("EQUIRECTANGULAR", [1, 3, 64, 64]),
            ("EQUIRECTANGULAR", [1, 3, 64, 128]),
            ("EQUIRECTANGULAR", [1, 3, 0, 0]),
            ("PINHOLE", [1, 3, 64, 64]),
            ("PINHOLE", [1, 3, 0, 0]),
        ] {
            let dir = tempfile::tempdir().expect("folder");
            capture(dir.path(), &[frame(model)], stripe);
            let path = colours(&input, &properties).write(&dir.path().join("n.onnx"));
            let out = dir.path().join("out");
            let made = run(dir.path(), &out, semantic(path)).expect("prepared");
            assert!(
                made.notes.iter().any(|n| n.contains("3 of its 4 classes")),
                "{:?}",
                made.notes
            );
            let file = out.join("labels/a.png");
            assert!(!file.is_symlink(), "what --link links goes away");
            let ids = formats::read_labels(file).expect("ids");
            assert_eq!((ids.width, ids.height), (128, 64));
            let clear = |x: &usize| (4..12).contains(&(x % 16));
            for y in 20..44 {
                for x in (0..128).filter(clear) {
                    let expected = [1, 2, 3, 0][x / 16 % 4];
                    assert_eq!(ids[(x, y)], expected, "{model} {input:?} {x} {y}");
                }
            }
            let text = std::fs::read_to_string(out.join("transforms.json")).expect("scene");
            let scene: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            assert_eq!(
                scene["classes"][0],
                json!({"id": 1, "name": "ceiling lamp", "kind": "light"})
            );
            assert_eq!(scene["classes"].as_array().map(Vec::len), Some(3));
        }
    }

    /// A box of 5 × 2.6 × 4 m.
    const ROOM: Vec3 = Vec3::new(5.0, 2.6, 4.0);
    /// Metres that the brightest pixel means.
    const MOST: f32 = 6.0;

    /// Distance to the wall from a place in the box through a pixel of its panorama.
    fn wall(frame: &Frame<'_>, x: usize, y: usize) -> f32 {
        let lambda = std::f32::consts::TAU * ((x as f32 + 0.5) / frame.size[0] as f32 - 0.5);
        let theta = std::f32::consts::PI * (y as f32 + 0.5) / frame.size[1] as f32;
        let d = Vec3::new(
            lambda.sin() * theta.sin(),
            theta.cos(),
            -lambda.cos() * theta.sin(),
        );
        let place = Vec3::from_array(frame.place.map(|p| p as f32));
        let side = |k: usize| match d[k] {
            v if v > 0.0 => (ROOM[k] - place[k]) / v,
            v => -place[k] / v,
        };
        (0..3).map(side).fold(f32::INFINITY, f32::min)
    }

    fn panoramas() -> Vec<Frame<'static>> {
        let places = [
            [1.0, 1.4, 1.0],
            [3.6, 1.5, 1.2],
            [2.5, 1.2, 2.9],
            [1.2, 1.6, 2.6],
        ];
        let names = ["a.png", "b.png", "c.png", "d.png"];
        let frame = |(name, place)| Frame {
            name,
            size: [256, 128],
            place,
            model: "EQUIRECTANGULAR",
        };
        names.into_iter().zip(places).map(frame).collect()
    }

    /// Photographs that are as bright as their surfaces are far, in each view by another unit.
    fn depth_room(dir: &Path) {
        capture(dir, &panoramas(), |f, x, y| {
            let unit = if f.name < "c.png" { 0.7 } else { 1.0 };
            [(255.0 * unit * wall(f, x, y) / MOST).round() as u8; 3]
        });
    }

    #[test]
    fn depth_of_unknown_scale_becomes_the_room() {
        let dir = tempfile::tempdir().expect("folder");
        depth_room(dir.path());
        for (input, properties, fit) in [
            ([1, 3, 128, 256], vec![PLAIN[0], PLAIN[1]], None),
            (
                [1, 3, 128, 256],
                vec![PLAIN[0], PLAIN[1]],
                Some(DepthFit::Affine),
            ),
        ] {
            let network = Network {
                operator: "Conv",
                input: &input,
                weights: &[0.5, 0.2, 0.3],
                bias: &[if fit.is_some() { 0.2 } else { 0.0 }],
                properties: &properties,
            };
            let options = NetworkOptions {
                depth_model: Some(network.write(&dir.path().join("n.onnx"))),
                depth_fit: fit,
                ..NetworkOptions::default()
            };
            let out = dir.path().join("out");
            let made = run(dir.path(), &out, options).expect("prepared");
            let mut errors = Vec::new();
            for f in panoramas() {
                let name = f.name.replace("png", "exr");
                let found: Plane<f32> =
                    formats::read_plane(out.join("depth").join(name)).expect("depth");
                for y in (2..126).step_by(4) {
                    for x in (0..256).step_by(4) {
                        errors.push((found[(x, y)] / wall(&f, x, y) - 1.0).abs());
                    }
                }
            }
            errors.sort_by(f32::total_cmp);
            let at = |share: f32| errors[(share * (errors.len() - 1) as f32) as usize];
            assert!(
                at(0.5) < 0.02 && at(0.95) < 0.06,
                "{} {} {:?}",
                at(0.5),
                at(0.95),
                made.notes
            );
            assert!(
                made.notes.iter().any(|n| n.contains("standard error")),
                "{:?}",
                made.notes
            );
            let load = LoadOptions {
                ldr: LdrImages::On,
                ..LoadOptions::default()
            };
            let (low, high) = Scene::load(&out, &load).expect("a scene").mesh.bounds();
            assert!(
                (high - low - ROOM).abs().max_element() < 0.2,
                "{low} {high}"
            );
        }
    }

    #[test]
    fn numbers_stated_as_inverse_are_inverted() {
        let dir = tempfile::tempdir().expect("folder");
        let nearest = 0.8;
        capture(dir.path(), &panoramas(), |f, x, y| {
            [(255.0 * nearest / wall(f, x, y)).round() as u8; 3]
        });
        let properties = [
            PLAIN[0],
            PLAIN[1],
            ("depth_values", "z"),
            ("depth_fit", "none"),
        ];
        let network = Network {
            operator: "Conv",
            input: &[1, 3, 128, 256],
            weights: &[0.0, 1.0 / nearest, 0.0],
            bias: &[0.0],
            properties: &properties,
        };
        let options = NetworkOptions {
            depth_model: Some(network.write(&dir.path().join("n.onnx"))),
            depth_values: Some(DepthValues::InverseRay),
            ..NetworkOptions::default()
        };
        let out = dir.path().join("out");
        run(dir.path(), &out, options).expect("prepared");
        let found: Plane<f32> = formats::read_plane(out.join("depth/a.exr")).expect("depth");
        for (x, y) in [(10, 64), (100, 30), (200, 90)] {
            let truth = wall(&panoramas()[0], x, y);
            assert!(
                (found[(x, y)] / truth - 1.0).abs() < 0.02,
                "{} {truth}",
                found[(x, y)]
            );
        }
    }

    #[test]
    fn a_mesh_is_better_than_a_network() {
        let dir = tempfile::tempdir().expect("folder");
        depth_room(dir.path());
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n5 0 0\n0 0 4\n3 0 1 2\n";
        std::fs::write(dir.path().join("mesh.ply"), ply).expect("mesh");
        let options = NetworkOptions {
            depth_model: Some(dir.path().join("none.onnx")),
            ..NetworkOptions::default()
        };
        let made = run(dir.path(), &dir.path().join("out"), options).expect("prepared");
        assert_eq!(made.triangles, 1);
        assert!(
            made.notes.iter().any(|n| n.contains("--depth-model")),
            "{:?}",
            made.notes
        );
    }

    #[test]
    fn what_is_no_usable_network_says_why() {
        let dir = tempfile::tempdir().expect("folder");
        let frame = |name| Frame {
            name,
            size: [32, 16],
            place: [0.0; 3],
            model: "EQUIRECTANGULAR",
        };
        capture(dir.path(), &[frame("a.png")], |_, x, _| [x as u8 + 90; 3]);
        let path = dir.path().join("n.onnx");
        let out = dir.path().join("out");
        let refused = |options: NetworkOptions, words: &[&str]| {
            let e = run(dir.path(), &out, options).expect_err("refused");
            assert_eq!(e.exit_code(), 2, "{e}");
            let e = e.to_string();
            assert!(words.iter().all(|w| e.contains(w)), "{words:?}: {e}");
            assert!(!out.exists());
        };
        std::fs::write(&path, "# not a network\n").expect("file");
        refused(semantic(path.clone()), &["n.onnx", "no ONNX file"]);
        let write = |network: Network<'_>| semantic(network.write(&path));
        let usual: &[u64] = &[1, 3, 16, 32];
        let properties = [PLAIN[0], PLAIN[1], NAMES];
        refused(
            write(colours(&[3, 16, 32], &properties)),
            &["3 x 16 x 32", "1 x 3 x rows"],
        );
        refused(
            write(colours(&[1, 16, 32, 3], &properties)),
            &["channels come last"],
        );
        refused(
            write(colours(&[8, 3, 16, 32], &properties)),
            &["8 x 3 x 16 x 32"],
        );
        let strange = Network {
            operator: "Frobnicate",
            ..colours(usual, &properties)
        };
        refused(write(strange), &["Frobnicate", "opset"]);
        let two = [PLAIN[0], PLAIN[1], ("names", r#"["wall", "floor"]"#)];
        refused(write(colours(usual, &two)), &["4 classes", "2 names"]);
        let broken = [("names", "wall, floor")];
        refused(write(colours(usual, &broken)), &["--semantic-names"]);
        let depth = |o: NetworkOptions| NetworkOptions {
            depth_model: o.semantic_model,
            ..NetworkOptions::default()
        };
        refused(
            depth(write(colours(usual, &properties))),
            &["4 maps", "--semantic-model"],
        );
        let single = Network {
            operator: "Conv",
            input: usual,
            weights: &[1.0, 0.0, 0.0],
            bias: &[0.0],
            properties: &PLAIN,
        };
        refused(
            depth(write(single)),
            &["nothing tells the scale", "--depth-fit none"],
        );
        // a network that is cut off anywhere is refused, or is still one; nothing panics its way out
        colours(usual, &properties).write(&path);
        let whole = std::fs::read(&path).expect("network");
        for n in (0..whole.len()).step_by(7) {
            std::fs::write(&path, &whole[..n]).expect("file");
            let _ = run(dir.path(), &out, semantic(path.clone()));
        }
    }
}
