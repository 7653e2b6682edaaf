//! Stanford PLY geometry, ASCII and binary of either byte order, with texture coordinates per
//! vertex where present.
//!
//! The header's counts are checked against the size of the file before anything is read: every
//! element takes at least one byte, so a larger count is damage.

use super::raw_mesh::{Part, RawMesh};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};
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
}

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
                None => self.bad_index = true, // negative or fractional
            }
            return PropertyAccessResult::Set;
        }
        let slot = match name {
            "x" => &mut self.position[0],
            "y" => &mut self.position[1],
            "z" => &mut self.position[2],
            "nx" => &mut self.normal[0],
            "ny" => &mut self.normal[1],
            "nz" => &mut self.normal[2],
            "s" | "u" | "texture_u" => &mut self.uv[0],
            "t" | "v" | "texture_v" => &mut self.uv[1],
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
                part.uvs =
                    (has(&["s", "u", "texture_u"]) && has(&["t", "v", "texture_v"])).then(|| {
                        elements
                            .iter()
                            .map(|e| Vec2::new(e.uv[0] as f32, (1.0 - e.uv[1]) as f32))
                            .collect()
                    });
            }
            "face" => {
                found_faces = true;
                for (i, e) in elements.iter().enumerate() {
                    if e.bad_index {
                        return Err(fail(format!(
                            "face {i} has vertex indices that are no whole numbers from 0 up"
                        )));
                    }
                    part.triangles.extend(
                        e.indices
                            .get(1..)
                            .unwrap_or_default()
                            .windows(2)
                            .map(|w| [e.indices[0], w[0], w[1]]),
                    );
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
    RawMesh::from_parts(vec![part], path)
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
