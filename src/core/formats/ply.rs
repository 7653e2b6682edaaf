//! Stanford PLY geometry, ASCII and binary of either byte order, with texture coordinates per
//! vertex and numbers of classes or objects per face or vertex where present.
//!
//! The header's counts are checked against the size of the file before anything is read: every
//! element takes at least one byte, so a larger count is damage.

use super::polygon;
use super::raw_mesh::{NameKind, Part, RawMesh, SurfaceNames};
use super::surface_look::{Look, TextureSource, beside, of_display};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Header, Property, PropertyAccess, PropertyAccessResult};
use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;

/// One PLY element of any kind; the parser fills what it finds.
#[derive(Default)]
struct Element {
    position: [f64; 3],
    normal: [f64; 3],
    uv: [f64; 2],
    indices: Vec<u32>,
    bad_index: bool,
    /// Indices of a list that has negative ones: strips, ended by −1.
    signed: Vec<i32>,
    /// Texture coordinates by corner: u and v in turn.
    wedge: Vec<f32>,
    /// Number of its class and of its object; 0 = none.
    label: [f64; 2],
    /// Linear RGB, or of display where the property is a byte.
    colour: [f64; 3],
    /// Whether its colour is of display.
    encoded: bool,
}

/// Properties that number the class of a face or vertex, and its object (ScanNet's, Replica's and
/// MeshLab-like names).
const CLASSES: [&str; 7] = [
    "label",
    "class",
    "class_id",
    "category",
    "category_id",
    "semantic",
    "semantic_id",
];
const OBJECTS: [&str; 3] = ["object_id", "objectid", "instance_id"];

fn scalar(property: &Property) -> Option<f64> {
    Some(match *property {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => return None,
    })
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if matches!(name, "vertex_indices" | "vertex_index") {
            match property.to_u32_list() {
                Some(list) => self.indices = list,
                // negative or fractional
                None => {
                    self.bad_index = true;
                    if let Property::ListInt(list) = property {
                        self.signed = list;
                    }
                }
            }
            return PropertyAccessResult::Set;
        }
        if name == "texcoord" {
            match property {
                Property::ListFloat(list) => self.wedge = list,
                Property::ListDouble(list) => {
                    self.wedge = list.into_iter().map(|v| v as f32).collect();
                }
                _ => return PropertyAccessResult::Ignored,
            }
            return PropertyAccessResult::Set;
        }
        if name.ends_with("red") {
            self.encoded |= matches!(property, Property::UChar(_));
        }
        let slot = match name {
            "red" | "diffuse_red" => &mut self.colour[0],
            "green" | "diffuse_green" => &mut self.colour[1],
            "blue" | "diffuse_blue" => &mut self.colour[2],
            "x" => &mut self.position[0],
            "y" => &mut self.position[1],
            "z" => &mut self.position[2],
            "nx" => &mut self.normal[0],
            "ny" => &mut self.normal[1],
            "nz" => &mut self.normal[2],
            "s" | "u" | "texture_u" => &mut self.uv[0],
            "t" | "v" | "texture_v" => &mut self.uv[1],
            n if CLASSES.contains(&n) => &mut self.label[0],
            n if OBJECTS.contains(&n) => &mut self.label[1],
            _ => return PropertyAccessResult::Ignored,
        };
        match scalar(&property) {
            Some(v) => {
                *slot = v;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }
}

/// Geometry of a PLY file from its bytes.
///
/// # Errors
/// If the header or the data are damaged, an index has no vertex, or there are no triangles.
pub fn mesh_from_ply(bytes: &[u8], path: &Path) -> Result<RawMesh> {
    let fail = |m: String| Error::input(path, format!("{m}; export the mesh again"));
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = parser
        .read_header(&mut reader)
        .map_err(|e| fail(format!("the PLY header is malformed: {e}")))?;
    let (mut part, mut found_vertices, mut found_faces) = (Part::default(), false, false);
    let mut faces: Vec<Element> = Vec::new();
    let mut vertex_labels: Vec<[f64; 2]> = Vec::new();
    for (name, element) in &header.elements {
        if element.count > bytes.len() {
            return Err(fail(format!(
                "the header claims {} elements \"{name}\" in a file of {} bytes",
                element.count,
                bytes.len()
            )));
        }
        let elements = parser
            .read_payload_for_element(&mut reader, element, &header)
            .map_err(|e| fail(format!("the PLY elements \"{name}\" are damaged: {e}")))?;
        let has = |names: &[&str]| names.iter().any(|n| element.properties.contains_key(*n));
        match name.as_str() {
            "vertex" => {
                if !(has(&["x"]) && has(&["y"]) && has(&["z"])) {
                    return Err(fail("the PLY vertices have no x, y, z".into()));
                }
                found_vertices = true;
                add_vertices(&mut part, &elements, has);
                if has(&CLASSES) || has(&OBJECTS) {
                    vertex_labels = elements.iter().map(|e| e.label).collect();
                }
            }
            "face" => {
                found_faces = true;
                if let Some(i) = elements.iter().position(|e| e.bad_index) {
                    return Err(fail(format!(
                        "face {i} has vertex indices that are no whole numbers from 0 up"
                    )));
                }
                faces = elements;
            }
            "tristrips" => {
                found_faces = true;
                for e in &elements {
                    let whole: Vec<i32> = match e.bad_index {
                        true => e.signed.clone(),
                        false => e
                            .indices
                            .iter()
                            .filter_map(|i| i32::try_from(*i).ok())
                            .collect(),
                    };
                    whole
                        .split(|i| *i < 0)
                        .for_each(|strip| part.triangles.extend(of_strip(strip)));
                }
            }
            _ => {}
        }
    }
    if !found_vertices || !found_faces {
        return Err(Error::input(
            path,
            "no elements \"vertex\" and \"face\": a point cloud is no mesh; reconstruct a surface first",
        ));
    }
    part.look = picture(&header, path);
    let face_of = add_faces(&mut part, &faces).map_err(fail)?;
    let names = names(&faces, &face_of, &vertex_labels);
    let mut mesh = RawMesh::from_parts(vec![part], path)?;
    if face_of.len() == mesh.triangles.len() {
        mesh.names = names;
    }
    Ok(mesh)
}

/// The picture that a comment names, as MeshLab writes it.
fn picture(header: &Header, path: &Path) -> Option<Look> {
    let named = |c: &String| Some(c.trim().strip_prefix("TextureFile")?.trim().to_owned());
    let file = beside(path, &header.comments.iter().find_map(named)?)?;
    Some(Look {
        factor: Vec3::ONE,
        texture: Some(TextureSource::File(file)),
    })
}

/// The numbers of the triangles' classes and of their objects: those of their faces, else the one
/// that most of their face's vertices have. `face_of` tells a triangle's face; strips have none.
fn names(faces: &[Element], face_of: &[u32], of_vertex: &[[f64; 2]]) -> Vec<SurfaceNames> {
    let digits = |x: f64| (x >= 1.0 && x <= f64::from(u32::MAX)).then(|| (x as u32).to_string());
    let named = |(which, kind)| {
        let by_vertex = !faces.iter().any(|f| f.label[which] != 0.0);
        let number = |f: &Element| -> f64 {
            if !by_vertex {
                return f.label[which];
            }
            let at = |i: &u32| of_vertex.get(*i as usize).map_or(0.0, |l| l[which]);
            let votes = |x: f64| f.indices.iter().filter(|i| at(i) == x).count();
            let all = f.indices.iter().map(at);
            all.reduce(|a, b| if votes(b) > votes(a) { b } else { a })
                .unwrap_or(0.0)
        };
        let each = face_of.iter().map(|f| digits(number(&faces[*f as usize])));
        SurfaceNames::of(kind, each)
    };
    let kinds = [(0, NameKind::Class), (1, NameKind::Object)];
    kinds.into_iter().filter_map(named).collect()
}

/// Places, and normals, colours and texture coordinates where the element has them.
fn add_vertices(part: &mut Part, elements: &[Element], has: impl Fn(&[&str]) -> bool) {
    part.positions = elements
        .iter()
        .map(|e| DVec3::from_array(e.position))
        .collect();
    part.normals = (has(&["nx"]) && has(&["ny"]) && has(&["nz"])).then(|| {
        elements
            .iter()
            .map(|e| DVec3::from_array(e.normal).normalize_or_zero().as_vec3())
            .collect::<Vec<Vec3>>()
    });
    part.colours = (has(&["red", "diffuse_red"]) && has(&["green", "diffuse_green"])).then(|| {
        let linear = |e: &Element| match e.encoded {
            true => of_display(e.colour),
            false => DVec3::from_array(e.colour).as_vec3(),
        };
        elements.iter().map(linear).collect()
    });
    // like OBJ, PLY counts v from the bottom of the image
    part.uvs = (has(&["s", "u", "texture_u"]) && has(&["t", "v", "texture_v"])).then(|| {
        elements
            .iter()
            .map(|e| Vec2::new(e.uv[0] as f32, (1.0 - e.uv[1]) as f32))
            .collect()
    });
}

/// Triangles of a strip: every corner closes one with the two before it, windings in turn.
fn of_strip(strip: &[i32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    strip.windows(3).enumerate().map(|(i, w)| {
        let [a, b, c] = [w[0] as u32, w[1] as u32, w[2] as u32];
        if i % 2 == 0 { [a, b, c] } else { [b, a, c] }
    })
}

/// Triangulates faces into a part; texture coordinates by corner, where every face has them, become
/// vertices of their own. The face of every triangle that was added.
fn add_faces(part: &mut Part, faces: &[Element]) -> std::result::Result<Vec<u32>, String> {
    let count = part.positions.len();
    let wedges = !faces.is_empty() && faces.iter().all(|f| f.wedge.len() == 2 * f.indices.len());
    let mut made: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
    let mut corners: Vec<(u32, Vec2)> = Vec::new();
    let mut face_of = Vec::with_capacity(faces.len());
    for (f, face) in faces.iter().enumerate() {
        if let Some(bad) = face.indices.iter().find(|i| **i as usize >= count) {
            return Err(format!("face {f} uses vertex {bad} of {count}"));
        }
        let places: Vec<DVec3> = face
            .indices
            .iter()
            .map(|i| part.positions[*i as usize])
            .collect();
        let vertex = |k: usize| -> u32 {
            let v = face.indices[k];
            if !wedges {
                return v;
            }
            // like OBJ, PLY counts v from the bottom of the image
            let uv = Vec2::new(face.wedge[2 * k], 1.0 - face.wedge[2 * k + 1]);
            let next = corners.len() as u32;
            let index = *made
                .entry((v, uv.to_array().map(f32::to_bits)))
                .or_insert(next);
            if index == next {
                corners.push((v, uv));
            }
            index
        };
        let vertices: Vec<u32> = (0..places.len()).map(vertex).collect();
        let triangles = polygon::triangulate(&places);
        face_of.extend(std::iter::repeat_n(f as u32, triangles.len()));
        part.triangles
            .extend(triangles.into_iter().map(|t| t.map(|i| vertices[i])));
    }
    if wedges {
        part.uvs = Some(corners.iter().map(|c| c.1).collect());
        part.positions = corners
            .iter()
            .map(|c| part.positions[c.0 as usize])
            .collect();
        part.normals = part
            .normals
            .take()
            .map(|n| corners.iter().map(|c| n[c.0 as usize]).collect());
        part.colours = part
            .colours
            .take()
            .map(|n| corners.iter().map(|c| n[c.0 as usize]).collect());
    }
    Ok(face_of)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASCII: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nproperty float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n10000.001 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 0.75\n4 0 1 2 3\n";

    #[test]
    fn ascii_quads_with_uvs() {
        let mesh = mesh_from_ply(ASCII.as_bytes(), Path::new("m.ply")).expect("readable");
        assert_eq!(mesh.triangles, vec![[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[0].x, 10000.001);
        assert_eq!(mesh.uvs[3], Vec2::new(0.0, 0.25));
    }

    #[test]
    fn texture_coordinates_by_corner_make_vertices() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 0.5 0 0.5 0.25\n3 0 2 3 6 0 0 0.75 0.5 0 0.5\n";
        let mesh = mesh_from_ply(text.as_bytes(), Path::new("m.ply")).expect("readable");
        assert_eq!(
            (mesh.positions.len(), mesh.triangles.len()),
            (5, 2),
            "one corner is shared"
        );
        assert_eq!(
            mesh.uvs[mesh.triangles[0][2] as usize],
            Vec2::new(0.5, 0.75)
        );
        assert_eq!(
            mesh.positions[mesh.triangles[1][1] as usize],
            DVec3::new(1.0, 1.0, 0.0)
        );
    }

    #[test]
    fn strips_end_at_minus_one_and_turn_in_turn() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 3 2 1\n";
        let mesh = mesh_from_ply(text.as_bytes(), Path::new("m.ply")).expect("readable");
        assert_eq!(mesh.triangles, vec![[0, 1, 2], [2, 1, 3], [3, 2, 1]]);
        let beyond = text.replace("3 2 1\n", "9 2 1\n");
        assert!(mesh_from_ply(beyond.as_bytes(), Path::new("m.ply")).is_err());
    }

    fn binary(vertices: u64, faces: u64, list: u8) -> Vec<u8> {
        let mut b = format!("ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\nelement face {faces}\nproperty list uchar uint vertex_index\nend_header\n").into_bytes();
        b.extend(
            [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
                .iter()
                .flat_map(|f| f.to_le_bytes()),
        );
        b.push(list);
        b.extend([0u32, 1, 2].iter().flat_map(|i| i.to_le_bytes()));
        b
    }

    #[test]
    fn binary_triangles() {
        let mesh = mesh_from_ply(&binary(3, 1, 3), Path::new("m.ply")).expect("readable");
        assert_eq!(
            (mesh.positions.len(), mesh.triangles.as_slice()),
            (3, &[[0u32, 1, 2]][..])
        );
        assert!(mesh.uvs.is_empty());
    }

    #[test]
    fn hostile_counts_and_every_truncation_are_errors() {
        for (v, f, l) in [(1 << 40, 1, 3), (3, 1 << 40, 3), (3, 1, 255), (6, 1, 3)] {
            let e = mesh_from_ply(&binary(v, f, l), Path::new("m.ply"));
            assert!(
                e.is_err_and(|e| e.to_string().starts_with("m.ply:") && e.exit_code() == 2),
                "{v} {f} {l}"
            );
        }
        let whole = binary(3, 1, 3);
        for n in 0..whole.len() {
            assert!(
                mesh_from_ply(&whole[..n], Path::new("m.ply")).is_err(),
                "{n}"
            );
        }
        let empty = "ply\nformat binary_little_endian 1.0\nelement nothing 9000000000000000000\nend_header\n";
        assert!(mesh_from_ply(empty.as_bytes(), Path::new("m.ply")).is_err());
        let negative = ASCII.replace("4 0 1 2 3", "3 0 1 -2");
        assert!(mesh_from_ply(negative.as_bytes(), Path::new("m.ply")).is_err());
    }
}
