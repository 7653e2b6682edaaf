//! Baked light against closed forms, and files against what was put in.

use super::*;
use crate::core::brdf::Reflectance;
use crate::core::formats::read_rgb;
use crate::core::formats::{Picture8, decode_rgba8, encode_rgb8, glb_of};
use crate::core::image::Wrap;
use crate::core::math::linear_from_srgb;
use crate::core::texture::Texels;
use crate::render::SurfaceModel;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};
use std::f32::consts::PI;

/// A glTF file in the making.
struct Maker {
    bytes: Vec<u8>,
    root: Value,
}

/// Corners and triangles of a surface.
#[derive(Clone, Default)]
struct Shape {
    positions: Vec<Vec3>,
    indices: Vec<u32>,
}

impl Shape {
    /// A rectangle that faces along `u × v`.
    fn quad(corner: Vec3, u: Vec3, v: Vec3) -> Self {
        Self {
            positions: vec![corner, corner + u, corner + u + v, corner + v],
            indices: vec![0, 1, 2, 0, 2, 3],
        }
    }

    /// A box that faces outwards, or inwards.
    fn cuboid(low: Vec3, high: Vec3, inwards: bool) -> Self {
        let (size, mut all) = (high - low, Self::default());
        for axis in 0..3 {
            let u = Vec3::AXES[(axis + 1) % 3] * size;
            let v = Vec3::AXES[(axis + 2) % 3] * size;
            let across = Vec3::AXES[axis] * size;
            for (corner, out) in [(low + across, true), (low, false)] {
                let (u, v) = if out != inwards { (u, v) } else { (v, u) };
                all.add(&Self::quad(corner, u, v));
            }
        }
        all
    }

    fn add(&mut self, other: &Self) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.indices.extend(other.indices.iter().map(|i| first + i));
    }
}

impl Maker {
    fn new() -> Self {
        Self {
            bytes: Vec::new(),
            root: json!({
                "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}],
                "nodes": [], "meshes": [], "materials": [], "accessors": [], "bufferViews": [],
            }),
        }
    }

    fn push(&mut self, key: &str, value: Value) -> usize {
        let list = self.root[key].as_array_mut().expect("a list");
        list.push(value);
        list.len() - 1
    }

    fn accessor(&mut self, content: &[u8], kind: u32, count: usize, shape: &str) -> usize {
        let view = self.push(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": content.len()}),
        );
        self.bytes.extend_from_slice(content);
        let entry =
            json!({"bufferView": view, "componentType": kind, "count": count, "type": shape});
        self.push("accessors", entry)
    }

    fn material(&mut self, material: Value) -> usize {
        self.push("materials", material)
    }

    /// Paint of one grey, no metal.
    fn grey(&mut self, albedo: f32) -> usize {
        self.material(json!({"pbrMetallicRoughness": {
            "baseColorFactor": [albedo, albedo, albedo, 1.0], "metallicFactor": 0.0,
        }}))
    }

    /// Emits evenly and reflects nothing but a faint gloss.
    fn lamp(&mut self, radiance: f32) -> usize {
        self.material(json!({
            "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0.0},
            "emissiveFactor": [1.0, 1.0, 1.0],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": radiance}},
        }))
    }

    fn mesh(&mut self, shape: &Shape, material: usize) -> usize {
        let p: &[u8] = bytemuck::cast_slice(&shape.positions);
        let positions = self.accessor(p, 5126, shape.positions.len(), "VEC3");
        let low = shape
            .positions
            .iter()
            .copied()
            .reduce(Vec3::min)
            .expect("some");
        let high = shape
            .positions
            .iter()
            .copied()
            .reduce(Vec3::max)
            .expect("some");
        self.root["accessors"][positions]["min"] = json!(low.to_array());
        self.root["accessors"][positions]["max"] = json!(high.to_array());
        let i: &[u8] = bytemuck::cast_slice(&shape.indices);
        let indices = self.accessor(i, 5125, shape.indices.len(), "SCALAR");
        let primitive = json!({
            "attributes": {"POSITION": positions}, "indices": indices, "material": material,
        });
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    fn attribute(&mut self, mesh: usize, name: &str, numbers: &[f32], shape: &str, count: usize) {
        let accessor = self.accessor(bytemuck::cast_slice(numbers), 5126, count, shape);
        self.root["meshes"][mesh]["primitives"][0]["attributes"][name] = json!(accessor);
    }

    fn node(&mut self, node: Value) {
        let n = self.push("nodes", node);
        self.root["scenes"][0]["nodes"]
            .as_array_mut()
            .expect("a list")
            .push(json!(n));
    }

    /// A surface and the node it stands at.
    fn place(&mut self, shape: &Shape, material: usize) -> usize {
        let mesh = self.mesh(shape, material);
        self.node(json!({"mesh": mesh}));
        mesh
    }

    /// A light at a node; lights shine along −z.
    fn light(&mut self, light: Value, node: Value) {
        let lights = &mut self.root["extensions"]["KHR_lights_punctual"]["lights"];
        let n = lights.as_array().map_or(0, Vec::len);
        if n == 0 {
            *lights = json!([]);
        }
        lights.as_array_mut().expect("a list").push(light);
        let mut node = node;
        node["extensions"] = json!({"KHR_lights_punctual": {"light": n}});
        self.node(node);
    }

    fn texture(&mut self, picture: &[u8]) -> usize {
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        let view = self.push(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": picture.len()}),
        );
        self.bytes.extend_from_slice(picture);
        for key in ["images", "textures"] {
            if self.root[key].is_null() {
                self.root[key] = json!([]);
            }
        }
        let image = self.push(
            "images",
            json!({"bufferView": view, "mimeType": "image/png"}),
        );
        self.push("textures", json!({"source": image}))
    }

    fn glb(&self) -> Vec<u8> {
        let mut root = self.root.clone();
        root["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        glb_of(&root, &self.bytes).expect("writes")
    }

    fn lit(&self, options: &BakeOptions) -> Lit {
        let bytes = self.glb();
        let path = Path::new("test.glb");
        let job = BakeJob {
            scene: path,
            options,
            seed: 1,
        };
        let file = GltfFile::open(&bytes, path).expect("opens");
        light(&job, &file, &mut BTreeSet::new(), &Progress::silent()).expect("bakes")
    }
}

/// A bake of few texels and paths.
fn small(size: u32, samples: u32) -> BakeOptions {
    BakeOptions {
        size: Some(size),
        samples,
        ..BakeOptions::default()
    }
}

impl Lit {
    /// A map where a triangle has barycentrics (u, v).
    fn at(&self, map: usize, t: usize, u: f32, v: f32) -> Vec3 {
        let map = &self.baked.maps[map];
        let uv = self.scene.mesh.uv(t, u, v) * map.width as f32;
        map.bilinear(uv, Wrap::Clamp)
    }

    /// The triangle of a piece that holds a point, with its place in it; the scene's origin is the
    /// middle of its bounds.
    fn find(&self, piece: usize, p: Vec3) -> (usize, f32, f32) {
        let mesh = &self.scene.mesh;
        let of_piece = |t: &usize| self.scene.places[*t].piece == piece;
        let found = (0..mesh.triangles.len()).filter(of_piece).find_map(|t| {
            let (u, v) = mesh.barycentrics(t, p);
            let inside = u >= -1e-4 && v >= -1e-4 && u + v <= 1.0 + 1e-4;
            let near = (mesh.position(t, u, v) - p).length() < 1e-3;
            (inside && near).then_some((t, u, v))
        });
        found.expect("a triangle holds the point")
    }
}

const INSIDE: [[f32; 2]; 5] = [
    [0.3, 0.3],
    [0.02, 0.02],
    [0.96, 0.02],
    [0.02, 0.96],
    [0.49, 0.49],
];

/// Share of even light that a surface of roughness 1 reflects as gloss: 2 ∫ μ E(μ) dμ of its GGX lobe
/// with 4 % at normal incidence. Derived: summed over directions; beside edges, where walls are seen
/// at grazing angles, up to 0.025.
const GLOSS: f32 = 0.019;

/// Share of even light that the lobe over paint keeps from it: the mean of F(v·h) over viewers and
/// lights, each by cosine.
fn kept_from_paint() -> f32 {
    const SIDE: usize = 48;
    let middle = |i: usize| (i as f32 + 0.5) / SIDE as f32;
    let mut sum = 0.0;
    // squares of both cosines, which are even over [0, 1], and the angle between both sides
    for i in 0..SIDE * SIDE * SIDE {
        let (a, b) = (middle(i % SIDE), middle(i / SIDE % SIDE));
        let turn = PI * middle(i / SIDE / SIDE);
        let v_l = (a * b).sqrt() + ((1.0 - a) * (1.0 - b)).sqrt() * turn.cos();
        sum += f64::from(Reflectance::Smith.fresnel((0.5 * (1.0 + v_l)).sqrt()));
    }
    (sum / (SIDE * SIDE * SIDE) as f64) as f32
}

/// In a closed room whose walls all shine alike, every texel receives π times what they send out:
/// they emit L and reflect what arrives by gloss and paint, so that E = π L / (1 − ρ (1 − kept) − gloss).
/// Mirrored by a negative scale, the room is the same.
#[test]
fn white_furnace() {
    for (albedo, mirror) in [(0.0, 1.0), (0.5, -1.0)] {
        let mut maker = Maker::new();
        let paint = maker.grey(albedo);
        maker.root["materials"][paint]["emissiveFactor"] = json!([0.5, 0.5, 0.5]);
        let room = Shape::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), true);
        let mesh = maker.mesh(&room, paint);
        maker.node(json!({"mesh": mesh, "scale": [mirror, 1.0, 1.0]}));
        // (in corners, where texels have few neighbours, 64 paths are off by up to 7 %)
        let lit = maker.lit(&small(64, 512));
        let expected = PI * 0.5 / (1.0 - albedo * (1.0 - kept_from_paint()) - GLOSS);
        let mut all = Vec::new();
        for t in 0..lit.scene.mesh.triangles.len() {
            all.extend(INSIDE.map(|[u, v]| lit.at(0, t, u, v).x / expected));
        }
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        assert!((mean - 1.0).abs() < 0.01, "{albedo}: {mean}");
        for e in all {
            assert!((e - 1.0).abs() < 0.035, "{albedo}: {e}");
        }
        assert!(lit.baked.error < 0.012 && lit.baked.error_of_halves < 0.012);
    }
}

/// Form factor of a rectangle over a point of a parallel plane below its corner (Howell, C-3 of
/// the catalogue of configuration factors).
fn corner_factor(a: f32, b: f32) -> f32 {
    let part = |a: f32, b: f32| {
        let s = (1.0 + a * a).sqrt();
        a / s * (b / s).atan()
    };
    (part(a, b) + part(b, a)) / (2.0 * PI)
}

/// A square lamp over a black floor: π L times the form factor, below its middle and aside.
#[test]
fn square_lamp_over_a_floor() {
    let mut maker = Maker::new();
    let (black, lamp) = (maker.grey(0.0), maker.lamp(20.0));
    let floor = Shape::quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    maker.place(&floor, black);
    // faces down
    let square = Shape::quad(Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z);
    maker.place(&square, lamp);
    let lit = maker.lit(&small(128, 256));
    for (x, factor) in [
        (0.0, 4.0 * corner_factor(0.5, 0.5)),
        (0.5, 2.0 * corner_factor(1.0, 0.5)),
        (
            1.5,
            2.0 * (corner_factor(2.0, 0.5) - corner_factor(1.0, 0.5)),
        ),
    ] {
        let (t, u, v) = lit.find(0, Vec3::new(x, -0.5, 0.0));
        let (found, expected) = (lit.at(0, t, u, v), PI * 20.0 * factor);
        assert!(
            (found.x / expected - 1.0).abs() < 0.02,
            "{x}: {found} for {expected}"
        );
    }
    // what the filter says of its error is what it is
    assert!(lit.baked.error < 0.02, "{}", lit.baked.error);
}

/// A floor 4 m wide in the plane y = 0 under lights without extent.
fn floor_under(light: Value, node: Value, between: Option<Value>) -> Lit {
    let mut maker = Maker::new();
    let black = maker.grey(0.0);
    let floor = Shape::quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    maker.place(&floor, black);
    if let Some(material) = between {
        let material = maker.material(material);
        let pane = Shape::quad(Vec3::new(-3.0, 1.0, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0);
        maker.place(&pane, material);
    }
    maker.light(light, node);
    maker.lit(&small(64, 32))
}

/// Lux, candela per squared metre and cosine.
#[test]
fn lights_without_extent_have_their_units() {
    let (s, c) = (PI / 6.0).sin_cos();
    // −z turned by a half turn about (0, s, c)-ish axes: looks down, 60° off the vertical
    let down = json!({"rotation": [-(PI / 12.0).sin(), 0.0, 0.0, (PI / 12.0).cos()]});
    let sun = floor_under(
        json!({"type": "directional", "intensity": 100.0}),
        down,
        None,
    );
    let (t, u, v) = sun.find(0, Vec3::ZERO);
    let found = sun.at(0, t, u, v);
    // light goes along (0, −sin 30°, −cos 30°)
    assert!(
        (found.x / (100.0 * s) - 1.0).abs() < 1e-3 && c > s,
        "{found}"
    );

    let above = json!({"translation": [0.0, 2.0, 0.0]});
    let bulb = json!({"type": "point", "intensity": 50.0, "color": [1.0, 0.5, 0.0]});
    let bulb = floor_under(bulb, above, None);
    for x in [0.0f32, 1.5] {
        let (t, u, v) = bulb.find(0, Vec3::new(x, 0.0, 0.0));
        let d2 = 4.0 + x * x;
        let expected = 50.0 * 2.0 / d2.powf(1.5) * Vec3::new(1.0, 0.5, 0.0);
        let found = bulb.at(0, t, u, v);
        assert!(
            (found - expected).length() < 0.01 * expected.length(),
            "{x}: {found}"
        );
    }

    let straight_down = json!({
        "translation": [0.0, 2.0, 0.0],
        "rotation": [-(PI / 4.0).sin(), 0.0, 0.0, (PI / 4.0).cos()],
    });
    let cone = json!({"innerConeAngle": 0.3, "outerConeAngle": 0.5});
    let spot = json!({"type": "spot", "intensity": 50.0, "spot": cone});
    let spot = floor_under(spot, straight_down, None);
    let at = |x: f32| {
        let (t, u, v) = spot.find(0, Vec3::new(x, 0.0, 0.0));
        spot.at(0, t, u, v).x
    };
    assert!((at(0.0) / 12.5 - 1.0).abs() < 0.01, "{}", at(0.0));
    assert!(
        at(1.5) == 0.0,
        "beyond 2 m · tan 0.5 it is dark: {}",
        at(1.5)
    );
}

/// What lies between: cut out, half there, there; and glass.
#[test]
fn alpha_lets_its_share_through() {
    let down = || json!({"rotation": [-(PI / 4.0).sin(), 0.0, 0.0, (PI / 4.0).cos()]});
    let pane = |mode: &str, alpha: f32, glass: f32| {
        let tint = if glass > 0.0 { 1.0 } else { 0.0 };
        json!({
            "pbrMetallicRoughness": {"baseColorFactor": [tint, tint, 0.5 * tint, alpha], "metallicFactor": 0.0},
            "alphaMode": mode, "alphaCutoff": 0.4, "doubleSided": true,
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": glass}},
        })
    };
    for (material, share) in [
        (pane("MASK", 0.3, 0.0), 1.0),
        (pane("MASK", 0.5, 0.0), 0.0),
        (pane("BLEND", 0.25, 0.0), 0.75),
        (pane("OPAQUE", 0.25, 0.0), 0.0),
        // all but what it reflects at normal incidence
        (pane("OPAQUE", 1.0, 0.9), 0.9 * 0.96),
        // what is not there stops nothing; of the rest the pane lets its share through
        (pane("BLEND", 0.5, 0.6), 0.5 + 0.5 * 0.6 * 0.96),
    ] {
        let lit = floor_under(
            json!({"type": "directional", "intensity": 10.0}),
            down(),
            Some(material.clone()),
        );
        let found = lit.baked.maps[0].data.iter().map(|v| v.x);
        let (t, u, v) = lit.find(0, Vec3::new(0.0, -0.5, 0.0));
        let at = lit.at(0, t, u, v) / 10.0;
        assert!((at.x - share).abs() < 0.12, "{material}: {at} for {share}");
        // glass colours what falls through it: its blue is half of its red
        let glass =
            material["extensions"]["KHR_materials_transmission"]["transmissionFactor"].as_f64();
        if let (Some(1.0), Some(glass)) = (
            material["pbrMetallicRoughness"]["baseColorFactor"][3].as_f64(),
            glass.filter(|g| *g > 0.0),
        ) {
            let blue = 0.5 * 0.96 * glass as f32;
            assert!((at.z - blue).abs() < 0.06, "{material}: {at}, blue {blue}");
        }
        assert!(found.into_iter().all(f32::is_finite));
    }
}

/// No light comes through walls: a room closed by walls of 10 cm, or of a single sheet, under a
/// bright sky.
#[test]
fn a_closed_room_stays_black() {
    let folder = tempfile::tempdir().expect("temp");
    let sky = folder.path().join("sky.exr");
    let white = crate::core::image::Plane::filled(16, 8, Vec3::splat(1e4));
    write_rgb_float(&sky, &white).expect("writes");
    for thickness in [0.1, 0.0] {
        let mut maker = Maker::new();
        let paint = maker.grey(0.8);
        let high = Vec3::new(4.0, 3.0, 5.0);
        let wall = Vec3::splat(thickness);
        maker.place(&Shape::cuboid(Vec3::ZERO, high, true), paint);
        maker.place(&Shape::cuboid(-wall, high + wall, false), paint);
        let options = BakeOptions {
            environment: Some(sky.clone()),
            ..small(128, 64)
        };
        let lit = maker.lit(&options);
        let (mut inner, mut outer) = (0.0f32, f32::INFINITY);
        for (t, place) in lit.scene.places.iter().enumerate() {
            for [u, v] in INSIDE {
                let e = lit.at(0, t, u, v).max_element();
                match place.piece {
                    0 => inner = inner.max(e),
                    _ => outer = outer.min(e),
                }
            }
        }
        assert!(inner < 1e-3, "{thickness}: {inner} inside");
        assert!(
            (outer / (PI * 1e4) - 1.0).abs() < 0.03,
            "{thickness}: {outer} outside"
        );
    }
}

/// A smooth ball.
fn ball(maker: &mut Maker, material: usize) -> usize {
    let (rows, columns) = (12u32, 24u32);
    let mut shape = Shape::default();
    for r in 0..=rows {
        for c in 0..columns {
            let a = PI * r as f32 / rows as f32;
            let b = 2.0 * PI * c as f32 / columns as f32;
            let p = Vec3::new(a.sin() * b.cos(), a.cos(), a.sin() * b.sin());
            shape.positions.push(p);
        }
    }
    for r in 0..rows {
        for c in 0..columns {
            let (a, b) = (r * columns + c, r * columns + (c + 1) % columns);
            shape
                .indices
                .extend([a, b, b + columns, a, b + columns, a + columns]);
        }
    }
    let normals: Vec<f32> = shape.positions.iter().flat_map(|p| p.to_array()).collect();
    let mesh = maker.place(&shape, material);
    maker.attribute(mesh, "NORMAL", &normals, "VEC3", shape.positions.len());
    mesh
}

/// Most that a texel without a point of its own, which is filled from those beside it, can weigh in a
/// lookup. Derived: let its centre be 0, the lookup p with |p|∞ < 1 in a triangle whose point nearest to
/// 0 is q. It has no point because |q|∞ ≥ 1. The triangle is convex, so p·q ≥ |q|²; with q = (1, y) that
/// is p_y ≥ y + (1 − p_x)/y, and (1 − p_x)(1 − p_y) has its maximum y (1 − y)²/4 ≤ 1/27 at y = 1/3.
const FILLED: f32 = 1.0 / 27.0;

/// Both sides of every cut show the same light, and bilinear lookups meet only texels of the
/// surface they are on.
#[test]
fn seams_are_closed_and_nothing_bleeds() {
    let mut maker = Maker::new();
    let paint = maker.grey(0.5);
    ball(&mut maker, paint);
    let up = json!({"rotation": [0.5, 0.5, 0.0, 0.7]});
    maker.light(json!({"type": "directional", "intensity": 10.0}), up);
    let lit = maker.lit(&small(128, 64));
    let [before, after] = lit.seams;
    let mean = lit.baked.mean.x;
    let noise = lit.baked.error * mean;
    assert!(before > 0.0 && after < 0.3 * before, "{before} → {after}");
    assert!(
        after < 0.005 * mean && after < noise.max(0.002 * mean),
        "{after} of {mean}"
    );

    let (mesh, side) = (&lit.scene.mesh, lit.layout.size);
    let texels = Texels::rasterize(mesh, side, side);
    let mut point = vec![None; side * side];
    for (i, &cell) in texels.cell.iter().enumerate() {
        point[cell as usize] = Some(texels.position(mesh, i));
    }
    let reach = 4.0 / lit.layout.texels_per_metre;
    // (at its south pole the ball has slivers of a micrometre)
    for t in (0..mesh.triangles.len()).filter(|&t| mesh.area(t) > 1e-5) {
        for [u, v] in [
            [0.0, 0.0],
            [1.0, 0.0],
            [0.0, 1.0],
            [0.5, 0.5],
            [0.5, 0.0],
            [0.0, 0.5],
        ] {
            let uv = mesh.uv(t, u, v) * side as f32;
            for (cell, weight) in crate::core::image::bilinear_taps(side, side, uv, Wrap::Clamp) {
                let Some(p) = point[cell] else {
                    assert!(weight <= FILLED, "{weight} of a lookup beside the surface");
                    continue;
                };
                let away = (p - mesh.position(t, u, v)).length();
                assert!(weight <= 1e-4 || away < reach, "{away} m off");
            }
        }
    }
}

/// With directions, an even sky over a floor gives E(m) = π (1 + m·n)/2 for normals above it.
#[test]
fn directions_tell_the_light_of_other_normals() {
    let folder = tempfile::tempdir().expect("temp");
    let sky = folder.path().join("sky.exr");
    write_rgb_float(&sky, &crate::core::image::Plane::filled(16, 8, Vec3::ONE)).expect("writes");
    let mut maker = Maker::new();
    let black = maker.grey(0.0);
    let floor = Shape::quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    maker.place(&floor, black);
    let options = BakeOptions {
        environment: Some(sky),
        directional: true,
        ..small(32, 256)
    };
    let lit = maker.lit(&options);
    let (t, u, v) = lit.find(0, Vec3::ZERO);
    let [mean, x, y, z] = [1, 2, 3, 4].map(|k| lit.at(k, t, u, v).x);
    for m in [
        Vec3::Y,
        Vec3::new(0.5, 0.75f32.sqrt(), 0.0),
        Vec3::new(0.0, 0.8, -0.6),
    ] {
        let (found, expected) = (mean + m.dot(Vec3::new(x, y, z)), PI * (1.0 + m.y) / 2.0);
        assert!(
            (found / expected - 1.0).abs() < 0.03,
            "{m}: {found} for {expected}"
        );
    }
}

/// The file that is written: readable by others, every copy with a place of its own, everything
/// else as it was.
#[test]
fn the_scene_is_written_again_with_its_lightmap() {
    let folder = tempfile::tempdir().expect("temp");
    let mut maker = Maker::new();
    let (paint, lamp) = (maker.grey(0.5), maker.lamp(5.0));
    let crate_mesh = maker.mesh(&Shape::cuboid(Vec3::ZERO, Vec3::ONE, false), paint);
    maker.node(json!({"mesh": crate_mesh, "name": "left"}));
    maker.node(json!({"mesh": crate_mesh, "name": "right", "translation": [3.0, 0.0, 0.0]}));
    maker.place(
        &Shape::quad(Vec3::new(1.5, 4.0, 0.0), Vec3::X, Vec3::Z),
        lamp,
    );
    let colours: Vec<f32> = (0..24).flat_map(|i| [i as f32 / 24.0, 0.5, 1.0]).collect();
    maker.attribute(crate_mesh, "COLOR_0", &colours, "VEC3", 24);
    let picture = encode_rgb8(2, 2, &[255; 12]).expect("encodes");
    let texture = maker.texture(&picture);
    maker.root["materials"][paint]["pbrMetallicRoughness"]["baseColorTexture"] =
        json!({"index": texture, "texCoord": 1});
    maker.root["nodes"][0]["extras"] = json!({"kept": 7});
    let scene = folder.path().join("in.glb");
    std::fs::write(&scene, maker.glb()).expect("writes");
    let out = folder.path().join("out");
    let options = small(64, 16);
    let job = BakeJob {
        scene: &scene,
        options: &options,
        seed: 0,
    };
    let (record, files) = bake_file(&job, &out, &Progress::silent()).expect("bakes");
    assert_eq!(files, [SCENE, MAPS[0], BAKE]);
    let bytes = std::fs::read(out.join(SCENE)).expect("is there");
    gltf::Gltf::from_slice(&bytes).expect("valid for others");
    let path = Path::new("again.glb");
    let file = GltfFile::open(&bytes, path).expect("opens");
    let root = file.root();
    assert_eq!(root["nodes"][0]["extras"]["kept"], 7);
    assert_eq!(root["nodes"][1]["name"], "right");
    // materials use set 1: the lightmap takes the next
    let (lightmap, set) = (&root["materials"][paint]["extensions"]["MOZ_lightmap"], 2);
    assert_eq!(
        (lightmap["texCoord"].as_u64(), record.picture.tex_coord),
        (Some(2), 2)
    );
    let pieces = file.pieces().expect("pieces");
    assert_eq!(pieces.len(), 3);
    let bounds = |uvs: &[[f64; 2]]| {
        let low = uvs
            .iter()
            .fold([1.0f64; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])]);
        let high = uvs
            .iter()
            .fold([0.0f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
        (low, high)
    };
    for piece in &pieces {
        let (low, high) = bounds(&piece.uvs[&set]);
        assert!(low[0] >= 0.0 && low[1] >= 0.0 && high[0] <= 1.0 && high[1] <= 1.0);
        assert!(piece.uvs[&set].len() == piece.positions.len());
    }
    assert!(pieces[0].colours.is_some() && pieces[2].colours.is_none());
    let first = |p: &crate::core::formats::Piece| p.uvs[&set].clone();
    assert_ne!(
        first(&pieces[0]),
        first(&pieces[1]),
        "copies have places of their own"
    );
    // the picture times its intensity is the map
    let index = lightmap["index"].as_u64().expect("a texture") as usize;
    let image = file.texture(index).expect("there").image;
    let Picture8 { width, rgba, .. } =
        decode_rgba8(&file.image_bytes(image).expect("there")).expect("decodes");
    let map = read_rgb(out.join(MAPS[0])).expect("there");
    assert_eq!(width, map.width);
    let shown = |p: &[u8; 4]| linear_from_srgb(f32::from(p[0]) / 255.0) * record.picture.intensity;
    for (value, pixel) in map.data.iter().zip(&rgba) {
        let expected = value.x.min(record.picture.intensity);
        let off = (shown(pixel) - expected).abs();
        assert!(
            off <= 0.02 * record.picture.intensity,
            "{value} as {pixel:?}"
        );
    }
    // baked again, the file's own layout serves where it is on set 1
    let mut again = Maker::new();
    let paint = again.grey(0.5);
    let quad = again.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), paint);
    again.attribute(
        quad,
        "TEXCOORD_1",
        &[0.1, 0.1, 0.9, 0.1, 0.9, 0.9, 0.1, 0.9],
        "VEC2",
        4,
    );
    again.light(
        json!({"type": "point"}),
        json!({"translation": [0.5, 0.5, 1.0]}),
    );
    let lit = again.lit(&small(32, 8));
    assert_eq!(lit.layout.coordinates, "file");
    assert!((lit.scene.mesh.corner_uvs(0)[0] - Vec2::splat(0.1)).length() < 1e-6);
    let anew = BakeOptions {
        unwrap: true,
        ..small(32, 8)
    };
    assert_eq!(again.lit(&anew).layout.coordinates, "own");
}

/// Base colour is factor × texture × vertex colour; metal has no diffuse part and its own colour as
/// gloss.
/// What scripts/check_godot lets Godot 3 draw; here without it, and for Godot 4.
#[test]
fn godot_is_told_where_the_light_belongs() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut maker = Maker::new();
    let shape = Shape::quad(Vec3::ZERO, Vec3::Z, Vec3::X);
    let paint = maker.grey(0.5);
    let mesh = maker.mesh(&shape, paint);
    maker.node(json!({"mesh": mesh, "name": "floor/1"}));
    maker.node(json!({"mesh": mesh, "name": "floor/1", "translation": [3, 0, 0]}));
    let lamp = json!({"type": "point", "intensity": 2.0});
    maker.light(lamp, json!({"translation": [0.5, 1, 0.5]}));
    let path = folder.path().join("floor.glb");
    std::fs::write(&path, maker.glb()).expect("writes");
    for (version, kind, user) in [
        (
            GodotVersion::Three,
            "BakedLightmapData",
            "NodePath(\"../Scene/floor_1 2\"), ExtResource( 1 ), -1",
        ),
        (
            GodotVersion::Four,
            "LightmapGIData",
            "NodePath(\"../Scene/floor_1 2\"), Rect2(0, 0, 1, 1), 0, -1",
        ),
    ] {
        let options = BakeOptions {
            godot: Some(version),
            ..small(64, 16)
        };
        let job = BakeJob {
            scene: &path,
            options: &options,
            seed: 1,
        };
        let out = folder.path().join(kind);
        let (record, files) = bake_file(&job, &out, &Progress::silent()).expect("bakes");
        assert!(record.notes.is_empty() && files.contains(&"godot"));
        let own = out.join("godot");
        let text = |name: &str| std::fs::read_to_string(own.join(name)).expect(name);
        let data = text("lightmap.tres");
        assert!(data.contains(kind) && data.contains(user), "{data}");
        assert!(
            text("lit.tscn").contains(kind) && text("lightmap.exr.import").contains("importer=")
        );
        let [map, shown] = [out.join("lightmap.exr"), own.join("lightmap.exr")]
            .map(|p| read_rgb(p).expect("reads"));
        let off = |(e, l): (&Vec3, &Vec3)| (*e / PI - *l).abs().max_element();
        assert!(map.data.iter().zip(&shown.data).all(|t| off(t) < 1e-6));
        let bytes = std::fs::read(own.join("scene.glb")).expect("reads");
        let file = GltfFile::open(&bytes, &path).expect("opens");
        let root = file.root();
        assert_eq!(root["nodes"][1]["name"], "floor_1 2");
        assert!(root["extensions"].is_null() && root["nodes"][2]["extensions"].is_null());
        assert!(!root["meshes"][1]["primitives"][0]["attributes"]["TEXCOORD_1"].is_null());
    }
}

#[test]
fn materials_are_what_the_file_says() {
    let mut maker = Maker::new();
    let texture = maker.texture(&encode_rgb8(1, 1, &[188, 188, 188]).expect("encodes"));
    let paint = maker.material(json!({"pbrMetallicRoughness": {
        "baseColorFactor": [0.5, 1.0, 1.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.3,
        "baseColorTexture": {"index": texture},
    }}));
    let metal = maker.material(json!({"pbrMetallicRoughness": {
        "baseColorFactor": [0.9, 0.6, 0.3, 1.0],
    }}));
    let quad = Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    let mesh = maker.place(&quad, paint);
    maker.attribute(mesh, "COLOR_0", &[0.5; 16], "VEC4", 4);
    maker.attribute(
        mesh,
        "TEXCOORD_0",
        &[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0],
        "VEC2",
        4,
    );
    maker.place(&quad, metal);
    let bytes = maker.glb();
    let file = GltfFile::open(&bytes, Path::new("m.glb")).expect("opens");
    let scene = BakeScene::read(&file, Path::new("m.glb"), &mut BTreeSet::new()).expect("reads");
    let grey = linear_from_srgb(188.0 / 255.0);
    let painted = scene.looks.surface(0, 0.2, 0.3);
    let expected = Vec3::new(0.25, 0.5, 0.5) * grey;
    assert!(
        (painted.base.diffuse() - expected).length() < 1e-5,
        "{painted:?}"
    );
    assert!((painted.roughness - 0.3).abs() < 1e-6);
    let metal = scene.looks.surface(2, 0.2, 0.3);
    assert_eq!(metal.material().albedo, Vec3::ZERO);
    assert!((metal.base.f0() - Vec3::new(0.9, 0.6, 0.3)).length() < 1e-6);
}

/// A texture of two texels, black and white: between them lies grey, unless the sampler wants the
/// nearest one.
#[test]
fn a_sampler_may_want_the_nearest_texel() {
    let seen = |sampler: Value| {
        let mut maker = Maker::new();
        let picture = encode_rgb8(2, 1, &[0, 0, 0, 255, 255, 255]).expect("encodes");
        let texture = maker.texture(&picture);
        maker.root["samplers"] = json!([sampler]);
        maker.root["textures"][texture]["sampler"] = json!(0);
        let paint = maker.material(json!({"pbrMetallicRoughness": {
            "metallicFactor": 0.0, "baseColorTexture": {"index": texture},
        }}));
        let mesh = maker.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), paint);
        let corners = [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0];
        maker.attribute(mesh, "TEXCOORD_0", &corners, "VEC2", 4);
        let bytes = maker.glb();
        let file = GltfFile::open(&bytes, Path::new("m.glb")).expect("opens");
        let scene = BakeScene::read(&file, Path::new("m.glb"), &mut BTreeSet::new());
        let looks = scene.expect("reads").looks;
        // along the quad's lower edge
        [0.1, 0.45, 0.55, 0.9].map(|x| looks.surface(0, x, 0.0).base.colour.x)
    };
    assert_eq!(seen(json!({"magFilter": 9728})), [0.0, 0.0, 1.0, 1.0]);
    // (two texels' middles lie at 1/4 and 3/4; beyond them the texture repeats)
    let smooth = seen(json!({"magFilter": 9729}));
    for (found, expected) in smooth.iter().zip([0.3, 0.4, 0.6, 0.7]) {
        assert!((found - expected).abs() < 1e-5, "{smooth:?}");
    }
}

/// Light beyond 32-bit numbers is refused, not written as darkness; extensions that are not read
/// are named.
#[test]
fn light_that_no_number_holds_is_refused() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = folder.path().join("s.glb");
    let mut maker = Maker::new();
    let paint = maker.material(json!({"extensions": {"KHR_materials_unlit": {}}}));
    maker.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), paint);
    maker.light(
        json!({"type": "point", "intensity": 1e38}),
        json!({"translation": [0.5, 0.5, 0.01]}),
    );
    std::fs::write(&scene, maker.glb()).expect("writes");
    let options = small(32, 8);
    let job = BakeJob {
        scene: &scene,
        options: &options,
        seed: 0,
    };
    let out = folder.path().join("out");
    let refused = bake_file(&job, &out, &Progress::silent()).expect_err("refused");
    assert!(refused.to_string().contains("32-bit"), "{refused}");
    assert!(!out.join(SCENE).exists());
    maker.root["extensions"]["KHR_lights_punctual"]["lights"][0]["intensity"] = json!(10.0);
    std::fs::write(&scene, maker.glb()).expect("writes");
    // an earlier bake's maps
    std::fs::create_dir_all(&out).expect("folder");
    std::fs::write(out.join(MAPS[1]), b"old").expect("writes");
    let (record, _) = bake_file(&job, &out, &Progress::silent()).expect("bakes");
    let unread = |n: &String| n.contains("KHR_materials_unlit is not read");
    assert!(record.notes.iter().any(unread), "{:?}", record.notes);
    assert!(out.join(SCENE).exists() && !out.join(MAPS[1]).exists());
}

/// What cannot be used is refused, with the way out.
#[test]
fn unusable_files_are_refused() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = folder.path().join("s.glb");
    let said = |bytes: &[u8], options: &BakeOptions| {
        std::fs::write(&scene, bytes).expect("writes");
        let job = BakeJob {
            scene: &scene,
            options,
            seed: 0,
        };
        let out = folder.path().join("out");
        let e = bake_file(&job, &out, &Progress::silent()).expect_err("refused");
        assert_eq!(e.exit_code(), 2, "{e}");
        assert!(!out.join(SCENE).exists());
        e.to_string()
    };
    let mut maker = Maker::new();
    let paint = maker.grey(0.5);
    maker.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), paint);
    let fine = small(32, 8);
    assert!(said(&maker.glb(), &fine).contains("--environment"));
    maker.light(
        json!({"type": "point"}),
        json!({"translation": [0.5, 0.5, 1.0]}),
    );
    let whole = maker.glb();
    for n in [0, 11, 40, whole.len() / 2, whole.len() - 9] {
        said(&whole[..n], &fine);
    }
    let mut broken = Maker::new();
    broken.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), 0);
    broken.material(json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 3}}));
    assert!(said(&broken.glb(), &fine).contains("texture 3"));
    broken.texture(b"no picture");
    broken.root["materials"][0]["emissiveTexture"]["index"] = json!(0);
    assert!(said(&broken.glb(), &fine).contains("PNG, JPEG or WebP"));
    broken.root["materials"][0] = json!({"emissiveFactor": [-1, 1, 1]});
    assert!(said(&broken.glb(), &fine).contains("emissiveFactor"));
    let mut light = Maker::new();
    let paint = light.grey(0.5);
    light.place(&Shape::quad(Vec3::ZERO, Vec3::X, Vec3::Y), paint);
    light.light(json!({"type": "laser"}), json!({}));
    assert!(said(&light.glb(), &fine).contains("laser"));
    let wrong = BakeOptions {
        size: Some(3),
        ..small(32, 8)
    };
    assert!(said(&whole, &wrong).contains("--size"));
}
