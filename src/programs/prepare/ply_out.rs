//! Writes a surface as binary PLY: positions in f64, normals and texture coordinates where known,
//! and the class of every face (property `label`, which other readers skip).

use super::capture::LabelledMesh;
use crate::core::formats::atomic_write;
use crate::error::Result;
use std::path::Path;

/// Writes `surface` to `path`; v is counted from the bottom of the image, as PLY programs do.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_ply(path: &Path, surface: &LabelledMesh) -> Result<()> {
    let mesh = &surface.mesh;
    let normals = mesh.normals.len() == mesh.positions.len() && !mesh.normals.is_empty();
    let uvs = mesh.uvs.len() == mesh.positions.len() && !mesh.uvs.is_empty();
    let labels = surface.classes.len() == mesh.triangles.len() && !surface.classes.is_empty();
    let mut header = String::from("ply\nformat binary_little_endian 1.0\ncomment unbake prepare\n");
    header += &format!("element vertex {}\n", mesh.positions.len());
    header += "property double x\nproperty double y\nproperty double z\n";
    if normals {
        header += "property float nx\nproperty float ny\nproperty float nz\n";
    }
    if uvs {
        header += "property float s\nproperty float t\n";
    }
    header += &format!("element face {}\n", mesh.triangles.len());
    header += "property list uchar uint vertex_indices\n";
    if labels {
        header += "property ushort label\n";
    }
    header += "end_header\n";
    let mut bytes = header.into_bytes();
    for (i, p) in mesh.positions.iter().enumerate() {
        bytes.extend(p.to_array().iter().flat_map(|x| x.to_le_bytes()));
        if normals {
            bytes.extend(
                mesh.normals[i]
                    .to_array()
                    .iter()
                    .flat_map(|x| x.to_le_bytes()),
            );
        }
        if uvs {
            let uv = mesh.uvs[i];
            bytes.extend([uv.x, 1.0 - uv.y].iter().flat_map(|x| x.to_le_bytes()));
        }
    }
    for (t, corners) in mesh.triangles.iter().enumerate() {
        bytes.push(3);
        bytes.extend(corners.iter().flat_map(|i| i.to_le_bytes()));
        if labels {
            bytes.extend(surface.classes[t].to_le_bytes());
        }
    }
    atomic_write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::{NameKind, RawMesh, SurfaceNames, read_mesh};
    use glam::{DVec3, Vec2, Vec3};

    #[test]
    fn the_programs_own_reader_gets_back_what_was_written() {
        let mesh = RawMesh {
            positions: vec![DVec3::new(10_000.001, 0.0, 0.0), DVec3::X, DVec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::new(1.0, 0.25), Vec2::ONE],
            triangles: vec![[0, 1, 2]],
            names: vec![SurfaceNames {
                kind: NameKind::Class,
                names: vec!["7".into()],
                of_triangle: vec![0],
            }],
            ..RawMesh::default()
        };
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("m.ply");
        let surface = LabelledMesh {
            mesh: mesh.clone(),
            classes: vec![7],
        };
        write_ply(&path, &surface).expect("written");
        assert_eq!(read_mesh(&path).expect("readable"), mesh);
    }
}
