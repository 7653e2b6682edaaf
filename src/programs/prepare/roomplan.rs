//! Apple RoomPlan's parametric export: a USDZ of boxes and meshes whose prims are named after what
//! they are (`Wall3`, `Door0`, `Sofa1`): a mesh with a class per triangle.
//!
//! USDZ is a zip archive without compression; layers refer to one another by path. Row vectors times
//! matrices, as USD writes them; `xformOpOrder` lists the outermost operation first.

use super::account::Account;
use super::capture::{Capture, LabelledMesh, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions};
use super::usd_layer::{Prim, Value};
use super::{usda, usdc};
use crate::core::formats::read_input;
use crate::core::geometry::BOX_SIDES;
use crate::error::{Error, Result};
use crate::scene::Class;
use glam::{DMat4, DQuat, DVec3};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// References within references beyond this are a circle.
const DEEPEST: usize = 32;
/// A layer larger than this is no room.
const LARGEST_LAYER: u64 = 1 << 28;

/// The importer.
pub struct RoomPlan;

impl Importer for RoomPlan {
    fn kind(&self) -> &'static str {
        "roomplan"
    }

    fn looks_like(&self) -> &'static str {
        "RoomPlan: a .usdz (or .usda, .usdc) of walls, doors, windows and furniture"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no .usdz, .usda or .usdc here, or several; name the file";
        Located::new(path, usd_file(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let file = &located.start;
        let stage = Stage::open(file)?;
        let mut builder = Builder {
            stage: &stage,
            file,
            mesh: LabelledMesh::default(),
            classes: BTreeMap::new(),
            skipped: BTreeMap::new(),
        };
        let root = stage.layer(&stage.root)?;
        let metres = root
            .metadata
            .get("metersPerUnit")
            .and_then(Value::number)
            .filter(|m| m.is_finite() && *m > 0.0)
            .unwrap_or(0.01);
        let world = DMat4::from_scale(DVec3::splat(metres));
        for prim in &root.children {
            builder.add(prim, world, &stage.root, 0)?;
        }
        if builder.mesh.mesh.triangles.is_empty() {
            return Err(Error::input(
                file,
                "holds no Mesh and no Cube; export the room again",
            ));
        }
        let z_up = root.metadata.get("upAxis").and_then(Value::text) == Some("Z");
        let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
        for class in &builder.mesh.classes {
            *counts.entry(*class).or_default() += 1;
        }
        account.read(format!(
            "{}: {} triangles of {}",
            file.display(),
            builder.mesh.mesh.triangles.len(),
            builder
                .classes
                .iter()
                .map(|(name, id)| format!("{name} ({})", counts.get(id).unwrap_or(&0)))
                .collect::<Vec<_>>()
                .join(", ")
        ));
        account.converted("classes from the names of prims; boxes to twelve triangles each");
        for (kind, count) in &builder.skipped {
            account.ignored(format!("{count} prims of type {kind}"));
        }
        account.ignored("colours of the drawing; RoomPlan draws no ceiling");
        let mut classes: Vec<Class> = builder
            .classes
            .iter()
            .map(|(name, id)| Class {
                id: *id,
                name: name.clone(),
                is_light: false,
            })
            .collect();
        classes.sort_by_key(|c| c.id);
        Ok(Capture {
            surface: Some(Surface::Built(builder.mesh)),
            classes,
            up: if z_up { Up::Z } else { Up::Y },
            ..Capture::default()
        })
    }
}

/// The file itself, or the only one of its kind in a folder.
fn usd_file(path: &Path) -> Option<PathBuf> {
    let is_usd = |p: &Path| {
        let e = p.extension().and_then(|e| e.to_str()).unwrap_or("");
        ["usdz", "usda", "usdc", "usd"].contains(&e.to_ascii_lowercase().as_str())
    };
    if path.is_file() {
        return is_usd(path).then(|| path.to_path_buf());
    }
    let found: Vec<PathBuf> = std::fs::read_dir(path)
        .ok()?
        .flatten()
        .map(|e| e.path())
        .filter(|p| is_usd(p))
        .collect();
    match found.as_slice() {
        [only] => Some(only.clone()),
        _ => None,
    }
}

/// Layers by their path in the archive, or beside the file.
struct Stage {
    file: PathBuf,
    /// Layers of an archive; empty for a plain file.
    layers: BTreeMap<String, Vec<u8>>,
    /// Path of the first layer.
    root: String,
}

impl Stage {
    fn open(file: &Path) -> Result<Self> {
        let fail = |e: &dyn std::fmt::Display| {
            Error::input(file, format!("cannot be read: {e}; export the room again"))
        };
        let name = file
            .file_name()
            .map(|n| n.to_string_lossy().into_owned())
            .unwrap_or_default();
        if !name.to_ascii_lowercase().ends_with(".usdz") {
            return Ok(Self {
                file: file.to_path_buf(),
                layers: BTreeMap::new(),
                root: name,
            });
        }
        let handle = std::fs::File::open(file).map_err(|e| fail(&e))?;
        let mut archive =
            zip::ZipArchive::new(std::io::BufReader::new(handle)).map_err(|e| fail(&e))?;
        let (mut layers, mut root) = (BTreeMap::new(), None);
        for i in 0..archive.len() {
            let mut entry = archive.by_index(i).map_err(|e| fail(&e))?;
            let name = normal(&entry.name().map_err(|e| fail(&e))?);
            if [".usda", ".usd", ".usdc"].iter().any(|e| name.ends_with(e)) {
                let mut bytes = Vec::new();
                entry
                    .by_ref()
                    .take(LARGEST_LAYER)
                    .read_to_end(&mut bytes)
                    .map_err(|e| fail(&e))?;
                // the first layer of the archive is its root (USDZ specification)
                root.get_or_insert_with(|| name.clone());
                layers.insert(name, bytes);
            }
        }
        Ok(Self {
            file: file.to_path_buf(),
            layers,
            root: root.ok_or_else(|| fail(&"the archive holds no layer"))?,
        })
    }

    fn layer(&self, path: &str) -> Result<Prim> {
        let bytes = match self.layers.get(path) {
            Some(bytes) => Cow::Borrowed(bytes),
            None if self.layers.is_empty() => {
                Cow::Owned(read_input(&self.file.with_file_name(path), LARGEST_LAYER)?)
            }
            None => {
                return Err(Error::input(
                    &self.file,
                    format!("the archive has no layer {path}; export the room again"),
                ));
            }
        };
        match bytes.starts_with(usdc::MAGIC) {
            true => usdc::parse(&bytes),
            false => usda::parse(&String::from_utf8_lossy(&bytes)),
        }
        .map_err(|m| Error::input(&self.file, format!("{path}: {m}")))
    }
}

/// A path without `.` and `..`.
fn normal(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// Where a reference from a layer leads.
fn relative(from: &str, to: &str) -> String {
    let folder = from.rsplit_once('/').map_or("", |f| f.0);
    normal(&format!("{folder}/{to}"))
}

struct Builder<'a> {
    stage: &'a Stage,
    file: &'a Path,
    mesh: LabelledMesh,
    classes: BTreeMap<String, u16>,
    skipped: BTreeMap<String, usize>,
}

impl Builder<'_> {
    fn add(&mut self, prim: &Prim, parent: DMat4, layer: &str, depth: usize) -> Result<()> {
        if depth > DEEPEST {
            return Err(Error::input(
                self.file,
                format!("{layer}: references run in a circle"),
            ));
        }
        let file = self.file;
        let fail = |m: String| Error::input(file, format!("{layer}, prim {}: {m}", prim.name));
        let world = parent * local(prim).map_err(fail)?;
        let references = prim
            .metadata
            .get("references")
            .or_else(|| prim.metadata.get("payload"));
        for reference in references.map_or(&[][..], Value::list) {
            let Some(path) = reference.text().filter(|p| !p.is_empty()) else {
                continue;
            };
            let path = relative(layer, path);
            let target = self.stage.layer(&path)?;
            let default = target.metadata.get("defaultPrim").and_then(Value::text);
            let inner = target
                .children
                .iter()
                .find(|c| default.is_none_or(|d| c.name == d));
            if let Some(inner) = inner {
                self.add(inner, world, &path, depth + 1)?;
            }
        }
        match prim.kind.as_str() {
            "Cube" => self.cube(prim, world),
            "Mesh" => self.polygons(prim, world).map_err(fail)?,
            "" | "Xform" | "Scope" | "Material" | "Shader" => {}
            other => *self.skipped.entry(other.into()).or_default() += 1,
        }
        for child in &prim.children {
            self.add(child, world, layer, depth + 1)?;
        }
        Ok(())
    }

    /// The class of a prim by its name: letters before the first digit.
    fn class(&mut self, prim: &Prim) -> u16 {
        let name: String = prim
            .name
            .chars()
            .take_while(|c| c.is_alphabetic())
            .collect::<String>()
            .to_lowercase();
        let name = if name.is_empty() {
            "object".into()
        } else {
            name
        };
        let next = self.classes.len() as u16 + 1;
        *self.classes.entry(name).or_insert(next)
    }

    fn cube(&mut self, prim: &Prim, world: DMat4) {
        let size = prim
            .properties
            .get("size")
            .and_then(Value::number)
            .unwrap_or(2.0);
        let corner = |i: u32| {
            let side = |bit: u32| {
                if i >> bit & 1 == 1 {
                    0.5 * size
                } else {
                    -0.5 * size
                }
            };
            world.transform_point3(DVec3::new(side(0), side(1), side(2)))
        };
        let class = self.class(prim);
        for side in BOX_SIDES {
            let first = self.mesh.mesh.positions.len() as u32;
            self.mesh.mesh.positions.extend(side.map(corner));
            for t in [[0, 1, 2], [0, 2, 3]] {
                self.mesh.mesh.triangles.push(t.map(|i| i + first));
                self.mesh.classes.push(class);
            }
        }
    }

    fn polygons(&mut self, prim: &Prim, world: DMat4) -> std::result::Result<(), String> {
        let numbers = |key: &str| {
            let mut list = Vec::new();
            if let Some(v) = prim.properties.get(key) {
                v.numbers(&mut list);
            }
            list
        };
        let points: Vec<DVec3> = numbers("points")
            .chunks_exact(3)
            .map(|p| world.transform_point3(DVec3::new(p[0], p[1], p[2])))
            .collect();
        let whole = |n: &f64| (*n >= 0.0 && n.fract() == 0.0).then_some(*n as usize);
        let whole_list =
            |key: &str| -> Option<Vec<usize>> { numbers(key).iter().map(whole).collect() };
        let counts =
            whole_list("faceVertexCounts").ok_or("faceVertexCounts: expected whole numbers")?;
        let indices =
            whole_list("faceVertexIndices").ok_or("faceVertexIndices: expected whole numbers")?;
        if let Some(bad) = indices.iter().find(|&&i| i >= points.len()) {
            return Err(format!("a face uses point {bad} of {}", points.len()));
        }
        let class = self.class(prim);
        let first = self.mesh.mesh.positions.len();
        self.mesh.mesh.positions.extend(&points);
        let mut at = 0usize;
        for count in counts {
            let end = at.checked_add(count).filter(|&e| e <= indices.len());
            let end = end.ok_or("faceVertexCounts: more corners than faceVertexIndices holds")?;
            let face = &indices[at..end];
            at = end;
            for pair in face.get(1..).unwrap_or_default().windows(2) {
                let corner = |i: usize| (first + i) as u32;
                self.mesh
                    .mesh
                    .triangles
                    .push([corner(face[0]), corner(pair[0]), corner(pair[1])]);
                self.mesh.classes.push(class);
            }
        }
        Ok(())
    }
}

/// A prim's own transform.
fn local(prim: &Prim) -> std::result::Result<DMat4, String> {
    let Some(order) = prim.properties.get("xformOpOrder") else {
        return Ok(DMat4::IDENTITY);
    };
    let mut all = DMat4::IDENTITY;
    for op in order.list() {
        let name = op.text().ok_or("xformOpOrder: expected names")?;
        if name == "!resetXformStack!" {
            all = DMat4::IDENTITY;
            continue;
        }
        let mut n = Vec::new();
        if let Some(v) = prim.properties.get(name) {
            v.numbers(&mut n);
        }
        all *= operation(name, &n)?;
    }
    Ok(all)
}

fn operation(name: &str, n: &[f64]) -> std::result::Result<DMat4, String> {
    let kind = name.split(':').nth(1).unwrap_or("");
    let turn = |axis: DVec3, degrees: f64| DMat4::from_axis_angle(axis, degrees.to_radians());
    Ok(match (kind, n) {
        // row vectors times rows are column vectors times columns
        ("transform", n) if n.len() == 16 => {
            let mut m = [0.0; 16];
            m.copy_from_slice(n);
            DMat4::from_cols_array(&m)
        }
        ("scale", &[x, y, z]) => DMat4::from_scale(DVec3::new(x, y, z)),
        ("translate", &[x, y, z]) => DMat4::from_translation(DVec3::new(x, y, z)),
        ("rotateX", &[a]) => turn(DVec3::X, a),
        ("rotateY", &[a]) => turn(DVec3::Y, a),
        ("rotateZ", &[a]) => turn(DVec3::Z, a),
        // x is applied first
        ("rotateXYZ", &[x, y, z]) => turn(DVec3::Z, z) * turn(DVec3::Y, y) * turn(DVec3::X, x),
        // (w, x, y, z)
        ("orient", &[w, x, y, z]) => DMat4::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()),
        _ => {
            return Err(format!(
                "{name} with {} numbers is not known here; export with one matrix",
                n.len()
            ));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_layer_that_names_them() {
        assert_eq!(relative("a/b/c.usda", "../d/./e.usda"), "a/d/e.usda");
        assert_eq!(relative("Room.usda", "./assets/x.usda"), "assets/x.usda");
    }

    #[test]
    fn boxes_face_outwards_under_their_transforms() {
        let dir = tempfile::tempdir().expect("folder");
        let at = |n: &str| dir.path().join(n);
        std::fs::write(
            at("Room.usda"),
            "#usda 1.0\n(\n metersPerUnit = 1\n upAxis = \"Y\"\n)\ndef Xform \"Room\" {\n def Xform \"g\" ( references = @./Wall.usda@ ) {\n double3 xformOp:translate = (10, 0, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]\n }\n}\n",
        )
        .expect("file");
        std::fs::write(
            at("Wall.usda"),
            "#usda 1.0\n(\n defaultPrim = \"Wall7\"\n)\ndef Xform \"Wall7\" {\n def Cube \"Wall7\" {\n double size = 1\n double3 xformOp:scale = (2, 3, 0.5)\n uniform token[] xformOpOrder = [\"xformOp:scale\"]\n }\n}\n",
        )
        .expect("file");
        let mut account = Account::default();
        let capture = RoomPlan
            .import(&at("Room.usda"), &PrepareOptions::default(), &mut account)
            .expect("read");
        assert_eq!(capture.classes[0].name, "wall");
        let Some(Surface::Built(m)) = capture.surface else {
            panic!("a surface")
        };
        let volume: f64 = m
            .mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| m.mesh.positions[i as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!((volume - 3.0).abs() < 1e-9, "{volume}");
        let middle = m.mesh.positions.iter().sum::<DVec3>() / m.mesh.positions.len() as f64;
        assert!((middle - DVec3::new(10.0, 0.0, 0.0)).length() < 1e-9);
    }

    fn room(form: &str) -> LabelledMesh {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd");
        let mut account = Account::default();
        let capture = RoomPlan
            .import(
                &folder.join(format!("room.{form}")),
                &PrepareOptions::default(),
                &mut account,
            )
            .expect(form);
        let names: Vec<&str> = capture.classes.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["wall", "door", "floor", "sofa"], "{form}");
        match capture.surface {
            Some(Surface::Built(mesh)) => mesh,
            other => panic!("{form}: {other:?}"),
        }
    }

    #[test]
    fn text_binary_and_archive_hold_the_same_room() {
        let text = room("usda");
        assert_eq!(text.mesh.triangles.len(), 12 + 12 + 50 + 12);
        for form in ["usdc", "usdz"] {
            let other = room(form);
            assert_eq!(text.mesh.triangles, other.mesh.triangles, "{form}");
            assert_eq!(text.classes, other.classes, "{form}");
            for (a, b) in text.mesh.positions.iter().zip(&other.mesh.positions) {
                assert!((*a - *b).length() < 1e-6, "{form}: {a} {b}");
            }
        }
    }

    #[test]
    fn damaged_binary_layers_are_survived() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd/room.usdc");
        let whole = std::fs::read(file).expect("file");
        for at in 0..whole.len() {
            let _ = usdc::parse(&whole[..at]);
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[at] ^= flip;
                let _ = usdc::parse(&damaged);
            }
        }
        assert!(usdc::parse(&whole[..whole.len() - 1]).is_err_and(|e| e.contains("damaged")));
    }
}
