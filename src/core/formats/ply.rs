//! Stanford PLY geometry, ASCII and binary of either byte order, with texture coordinates per
//! vertex and numbers of classes or objects per face or vertex where present.
//!
//! The header's counts are checked against the size of the file before anything is read: every
//! element takes at least one byte, so a larger count is damage.

use super::ply_ascii::AsciiLines;
use super::polygon;
use super::raw_mesh::{NameKind, Part, RawMesh, SurfaceNames};
use super::surface_look::{Look, TextureSource, of_display, picture_file, white_of};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType,
    ScalarType,
};
use std::borrow::Cow;
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
    /// RGB as written.
    colour: [f64; 3],
    /// Number of its picture.
    picture: f64,
}

/// Names of the properties that hold a colour's channels, a face's list of vertices, and texture
/// coordinates of a vertex.
const COLOURS: [[&str; 3]; 3] = [
    ["red", "green", "blue"],
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["r", "g", "b"],
];
const LISTS: [&str; 3] = ["vertex_indices", "vertex_index", "indices"];
const US: [&str; 4] = ["s", "u", "texture_u", "texture_s"];
const VS: [&str; 4] = ["t", "v", "texture_v", "texture_t"];
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
        if LISTS.contains(&name) {
            self.set_indices(&property);
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
        let slot = match name {
            "red" | "diffuse_red" | "r" => &mut self.colour[0],
            "green" | "diffuse_green" | "g" => &mut self.colour[1],
            "blue" | "diffuse_blue" | "b" => &mut self.colour[2],
            "x" => &mut self.position[0],
            "y" => &mut self.position[1],
            "z" => &mut self.position[2],
            "nx" => &mut self.normal[0],
            "ny" => &mut self.normal[1],
            "nz" => &mut self.normal[2],
            n if US.contains(&n) => &mut self.uv[0],
            n if VS.contains(&n) => &mut self.uv[1],
            "texnumber" => &mut self.picture,
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

impl Element {
    /// Takes a list of vertices, of whichever type; whole numbers may be written with a point.
    fn set_indices(&mut self, property: &Property) {
        if let Some(indices) = property.to_u32_list() {
            self.indices = indices;
            return;
        }
        let list: Vec<f64> = match property {
            Property::ListFloat(list) => list.iter().map(|v| f64::from(*v)).collect(),
            Property::ListDouble(list) => list.clone(),
            Property::ListInt(list) => list.iter().map(|v| f64::from(*v)).collect(),
            _ => vec![f64::NAN],
        };
        let whole = list.iter().all(|v| v.fract() == 0.0);
        self.bad_index = !whole || list.iter().any(|v| *v < 0.0);
        match self.bad_index {
            true if whole => self.signed = list.into_iter().map(|v| v as i32).collect(),
            true => {}
            false => self.indices = list.into_iter().map(|v| v as u32).collect(),
        }
    }
}

/// The bytes of a file: its header as text, and what follows.
struct Pieces<'a> {
    header: String,
    /// Lines of the header.
    lines: usize,
    payload: &'a [u8],
}

/// Most bytes of a header. Derived: a thousand times what scanners write.
const MOST_HEADER: usize = 1 << 20;

/// Takes the header off: without blanks around its lines, names and comments in whatever encoding.
fn split(bytes: &[u8]) -> Pieces<'_> {
    let mut out = Pieces {
        header: String::new(),
        lines: 0,
        payload: &[],
    };
    let mut end = 0;
    for line in bytes[..bytes.len().min(MOST_HEADER)].split_inclusive(|b| *b == b'\n') {
        end += line.len();
        out.lines += 1;
        let text: Cow<'_, str> = String::from_utf8_lossy(line.trim_ascii());
        if !text.is_empty() {
            out.header.push_str(&text);
            out.header.push('\n');
        }
        if text == "end_header" {
            out.payload = &bytes[end..];
            break;
        }
    }
    out
}

/// Reads a file's elements in their order.
struct Payload<'a> {
    header: &'a Header,
    parser: Parser<Element>,
    binary: Reader<Cursor<&'a [u8]>>,
    ascii: AsciiLines<'a>,
}

impl Payload<'_> {
    /// All elements of the next kind.
    fn next(&mut self, kind: &ElementDef) -> std::result::Result<Vec<Element>, String> {
        match self.header.encoding {
            Encoding::Ascii => self.ascii.elements(kind),
            _ => (self.parser)
                .read_payload_for_element(&mut self.binary, kind, self.header)
                .map_err(|e| e.to_string()),
        }
    }
}

/// Geometry of a PLY file from its bytes.
///
/// # Errors
/// If the header or the data are damaged, an index has no vertex, or there are no triangles.
pub fn mesh_from_ply(bytes: &[u8], path: &Path) -> Result<RawMesh> {
    let fail = |m: String| Error::input(path, format!("{m}; export the mesh again"));
    let pieces = split(bytes);
    let parser = Parser::<Element>::new();
    let header = parser
        .read_header(&mut Reader::new(Cursor::new(pieces.header.as_bytes())))
        .map_err(|e| fail(format!("the PLY header is malformed: {e}")))?;
    let mut payload = Payload {
        header: &header,
        parser,
        binary: Reader::new(Cursor::new(pieces.payload)),
        ascii: AsciiLines::new(pieces.payload, pieces.lines),
    };
    let mut notes = Vec::new();
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
        let elements = payload
            .next(element)
            .map_err(|e| fail(format!("the PLY elements \"{name}\" are damaged: {e}")))?;
        let has = |names: &[&str]| names.iter().any(|n| element.properties.contains_key(*n));
        match name.as_str() {
            "vertex" => {
                if !(has(&["x"]) && has(&["y"]) && has(&["z"])) {
                    return Err(fail("the PLY vertices have no x, y, z".into()));
                }
                found_vertices = true;
                add_vertices(&mut part, &elements, has);
                part.colours = colours(&elements, element, &mut notes);
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
                part.triangles.extend(elements.iter().flat_map(of_strips));
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
    let pictures = pictures(&header, path, &mut notes);
    let face_of = add_faces(&mut part, &faces).map_err(fail)?;
    let names = names(&faces, &face_of, &vertex_labels);
    let mut mesh = RawMesh::from_parts(vec![part], path)?;
    if face_of.len() == mesh.triangles.len() {
        mesh.names = names;
    }
    paint(&mut mesh, pictures, &faces, &face_of);
    mesh.oddities.look_notes = notes;
    Ok(mesh)
}

/// The triangles of an element of strips, which negative indices part.
fn of_strips(e: &Element) -> Vec<[u32; 3]> {
    let whole: Vec<i32> = match e.bad_index {
        true => e.signed.clone(),
        false => (e.indices.iter())
            .filter_map(|i| i32::try_from(*i).ok())
            .collect(),
    };
    let strips = whole.split(|i| *i < 0);
    strips.flat_map(of_strip).collect()
}

/// The pictures of a file.
struct Pictures {
    sources: Vec<TextureSource>,
    /// Whether faces say which is theirs (`texnumber`).
    numbered: bool,
}

/// The pictures that comments name, as MeshLab and OpenMVS write them.
fn pictures(header: &Header, path: &Path, notes: &mut Vec<String>) -> Pictures {
    let named = |c: &String| Some(c.trim().strip_prefix("TextureFile")?.trim().to_owned());
    let named = header.comments.iter().filter_map(named);
    let faces = header.elements.get("face");
    Pictures {
        sources: named
            .filter_map(|name| picture_file(path, &name, notes))
            .collect(),
        numbered: faces.is_some_and(|f| f.properties.contains_key("texnumber")),
    }
}

/// Gives every triangle the picture that its face's number counts to, or the only one.
fn paint(mesh: &mut RawMesh, pictures: Pictures, faces: &[Element], face_of: &[u32]) {
    let count = pictures.sources.len();
    let all = mesh.triangles.len();
    let numbered = pictures.numbered && face_of.len() == all;
    let sources = match count {
        0 => return,
        2.. if !numbered => vec![TextureSource::Unusable(format!(
            "it names {count} pictures, but its faces do not say whose they are (property texnumber); export it as glTF or OBJ"
        ))],
        _ => pictures.sources,
    };
    mesh.look_of_triangle = match count {
        2.. if numbered => {
            let number = |f: &u32| faces[*f as usize].picture;
            let known = |n: &f64| (0.0..count as f64).contains(n);
            (face_of.iter().map(number))
                .map(|n| {
                    Some(n)
                        .filter(known)
                        .map_or(SurfaceNames::NONE, |n| n as u32)
                })
                .collect()
        }
        _ => vec![0; all],
    };
    let look = |source| Look {
        factor: Vec3::ONE,
        texture: Some(source),
    };
    mesh.looks = sources.into_iter().map(look).collect();
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

/// Linear colours of the vertices, if they have any: of display where whole numbers stand for them,
/// up to 255 or, where the type is wider and so are the numbers, 65535; else light as it is.
fn colours(elements: &[Element], kind: &ElementDef, notes: &mut Vec<String>) -> Option<Vec<Vec3>> {
    let has = |name: &&str| kind.properties.contains_key(*name);
    let names = COLOURS.iter().find(|names| names.iter().all(has))?;
    let PropertyType::Scalar(scalar) = &kind.properties.get(names[0])?.data_type else {
        return None;
    };
    let values = || elements.iter().map(|e| e.colour);
    let white = match scalar {
        ScalarType::Float | ScalarType::Double => white_of(values(), notes),
        ScalarType::UChar => 255.0,
        _ if values().flatten().all(|v| v <= 255.0) => 255.0,
        _ => 65535.0,
    };
    let linear = |c: [f64; 3]| match white > 1.0 {
        true => of_display(c.map(|v| v * (255.0 / white))),
        false => DVec3::from_array(c).as_vec3(),
    };
    Some(values().map(linear).collect())
}

/// Places, and normals and texture coordinates where the element has them.
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
    // like OBJ, PLY counts v from the bottom of the image
    part.uvs = (has(&US) && has(&VS)).then(|| {
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

    fn read(text: &str) -> Result<RawMesh> {
        mesh_from_ply(text.as_bytes(), Path::new("m.ply"))
    }

    #[test]
    fn what_programs_write_besides_the_standard_is_read() {
        let plain = read(ASCII).expect("readable");
        let lists = |name: &str| ASCII.replace("vertex_indices", name);
        for text in [
            ASCII.replace("4 0 1 2 3", "4.0 0 1.0 2 3.0"),
            ASCII.replace("list uchar int", "list uchar double"),
            ASCII
                .replace("end_header\n", "end_header\n\n")
                .replace("\n1 1", "\n\n 1 1"),
            ASCII.replace(
                "\nproperty float s\nproperty float t",
                "\nproperty float texture_s\nproperty float texture_t",
            ),
            lists("vertex_index"),
            lists("indices"),
            ASCII.replace('\n', "\r\n"),
        ] {
            assert_eq!(read(&text).expect(&text), plain, "{text}");
        }
        let quality = ASCII.replace("property float s", "property float q\nproperty float s");
        let quality = quality.replace(" 0 0 0 0\n", " 0 0 -nan(ind) 0 0\n");
        let quality = quality.replace("1 0 0 1 0", "1 0 0 nan 1 0");
        let quality = quality.replace("1 1 0 1 1", "1 1 0 inf 1 1");
        let quality = quality.replace("0 1 0 0 0.75", "0 1 0 2 0 0.75");
        assert_eq!(read(&quality).expect("readable"), plain);
        let mut latin = b"ply\ncomment TextureFile R\xe4m.png\n".to_vec();
        latin.extend(&ASCII.as_bytes()[4..]);
        let named = mesh_from_ply(&latin, Path::new("m.ply")).expect("readable");
        assert_eq!((named.positions, named.looks.len()), (plain.positions, 1));
        for (text, said) in [
            (
                ASCII.replace("1 1 0 1 1", "1 1 0 1"),
                "line 14: it ends before",
            ),
            (
                ASCII.replace("1 1 0 1 1", "1 1 x 1 1"),
                "line 14: 'x' is no number",
            ),
            (
                ASCII.replace("4 0 1 2 3", "4 0 1 2.5 3"),
                "no whole numbers",
            ),
            (
                ASCII.replace("4 0 1 2 3", "4 0 1 nan 3"),
                "no whole numbers",
            ),
            (ASCII.replace("4 0 1 2 3", "4e9 0 1 2 3"), "no length"),
            (
                ASCII.replace("4 0 1 2 3\n", ""),
                "the file ends after 0 of 1",
            ),
        ] {
            let e = read(&text).expect_err(said).to_string();
            assert!(e.contains(said), "{e}");
        }
    }

    #[test]
    fn float_lists_of_binary_files_are_indices() {
        let whole = binary(3, 1, 3);
        let at = whole.len() - 12;
        let text = String::from_utf8_lossy(&whole[..whole.len() - 49]).replace("uint", "float");
        let mut bytes = text.into_bytes();
        bytes.extend(&whole[whole.len() - 49..at]);
        bytes.extend([0.0f32, 1.0, 2.0].iter().flat_map(|f| f.to_le_bytes()));
        let mesh = mesh_from_ply(&bytes, Path::new("m.ply")).expect("readable");
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
    }

    #[test]
    fn every_face_has_the_picture_of_its_number() {
        let text = ASCII
            .replace(
                "format ascii 1.0\n",
                "format ascii 1.0\ncomment TextureFile a.png\ncomment TextureFile b.png\n",
            )
            .replace("element face 1", "element face 3")
            .replace("end_header", "property int texnumber\nend_header")
            .replace("4 0 1 2 3\n", "3 0 1 2 1\n3 0 2 3 0\n3 0 1 3 -1\n");
        let mesh = read(&text).expect("readable");
        let b = TextureSource::File("b.png".into());
        assert_eq!(mesh.looks[1].texture, Some(b));
        assert_eq!(mesh.look_of_triangle, [1, 0, SurfaceNames::NONE]);
        let mesh = read(&text.replace("texnumber", "something")).expect("readable");
        let [
            Look {
                texture: Some(TextureSource::Unusable(why)),
                ..
            },
        ] = &mesh.looks[..]
        else {
            panic!("nobody knows whose pictures these are: {:?}", mesh.looks);
        };
        assert!(why.contains("texnumber"), "{why}");
    }

    #[test]
    fn colours_are_the_same_in_every_type() {
        let coloured = |kind: &str, colour: &str| {
            let properties = ["red", "green", "blue"].map(|c| format!("property {kind} {c}\n"));
            let vertex = |p: &str| format!("{p} {colour}\n");
            let vertices = ["0 0 0", "1 0 0", "0 1 0"].map(vertex).concat();
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{}element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}3 0 1 2\n",
                properties.concat()
            );
            read(&text).expect("readable")
        };
        let bytes = coloured("uchar", "51 102 255.0").colours;
        for (kind, colour) in [
            ("ushort", "13107 26214 65535"),
            ("ushort", "51 102 255"),
            ("int", "51 102 255"),
            ("float", "51 102 255"),
        ] {
            let off = (coloured(kind, colour).colours[0] - bytes[0]).length();
            assert!(off < 1e-6, "{kind} {colour}: {off}");
        }
        let light = coloured("float", "0.5 0.25 3").colours;
        assert_eq!(light[0], Vec3::new(0.5, 0.25, 3.0), "light as it is");
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
