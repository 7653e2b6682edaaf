//! Wavefront OBJ geometry. Polygons are triangulated; v is flipped, because OBJ counts it from the
//! bottom of the image.

use super::raw_mesh::{Part, RawMesh};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::path::Path;

/// Geometry of an OBJ file from its bytes; materials are ignored.
///
/// # Errors
/// If the text is damaged, an index has no vertex, or there are no triangles.
pub fn mesh_from_obj(bytes: &[u8], path: &Path) -> Result<RawMesh> {
    let options = tobj::LoadOptions {
        triangulate: true,
        single_index: true,
        ignore_points: true,
        ignore_lines: true,
    };
    let mut cursor = std::io::Cursor::new(bytes);
    let (models, _) = tobj::load_obj_buf(&mut cursor, &options, |_| Ok(Default::default()))
        .map_err(|e| {
            Error::input(
                path,
                format!("the OBJ file is malformed: {e}; export the mesh again"),
            )
        })?;
    let parts: Vec<Part> = models
        .into_iter()
        .filter(|m| !m.mesh.indices.is_empty())
        .map(|m| part(m.mesh))
        .collect();
    if parts.is_empty() {
        return Err(Error::input(
            path,
            "no faces; export the mesh with its triangles",
        ));
    }
    RawMesh::from_parts(parts, path)
}

fn part(mesh: tobj::Mesh) -> Part {
    let positions: Vec<DVec3> = mesh
        .positions
        .chunks_exact(3)
        .map(|p| DVec3::new(p[0], p[1], p[2]))
        .collect();
    // attributes some faces lack come out shorter than the positions: then the part counts as
    // having none
    let normals = (mesh.normals.len() == mesh.positions.len()).then(|| {
        let unit = |n: &[f64]| DVec3::new(n[0], n[1], n[2]).normalize_or_zero().as_vec3();
        mesh.normals
            .chunks_exact(3)
            .map(unit)
            .collect::<Vec<Vec3>>()
    });
    let uvs = (mesh.texcoords.len() == 2 * positions.len()).then(|| {
        mesh.texcoords
            .chunks_exact(2)
            .map(|t| Vec2::new(t[0] as f32, (1.0 - t[1]) as f32))
            .collect()
    });
    let triangles = mesh
        .indices
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    Part {
        positions,
        normals,
        uvs,
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quad_with_uvs_is_triangulated_and_v_flipped() {
        let text = "v 10000.001 0 0\nv 10001 0 0\nv 10001 1 0\nv 10000 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 0.75\nf 1/1 2/2 3/3 4/4\n";
        let mesh = mesh_from_obj(text.as_bytes(), Path::new("q.obj")).expect("readable");
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(mesh.positions[0].x, 10000.001, "positions keep f64");
        assert_eq!(mesh.uvs[3], Vec2::new(0.0, 0.25));
        assert!(mesh.normals.is_empty());
    }

    #[test]
    fn damage_is_an_error_and_never_a_panic() {
        for text in [
            "",
            "f 1 2 3\n",
            "v 0 0\nf 1 1 1\n",
            "v 0 0 0\nf 1 2 99999999999\n",
            "v 0 0 0\nf -5 -6 -7\n",
            "v a b c\n",
            "f\n",
            "v 0 0 0\nf 1/ 1/ 1/\nf 1//9 1 1",
        ] {
            match mesh_from_obj(text.as_bytes(), Path::new("q.obj")) {
                Ok(m) => assert!(
                    m.triangles
                        .iter()
                        .flatten()
                        .all(|&i| (i as usize) < m.positions.len()),
                    "{text:?}"
                ),
                Err(e) => assert!(
                    e.to_string().contains("q.obj") && e.exit_code() == 2,
                    "{text:?}: {e}"
                ),
            }
        }
    }

    #[test]
    fn faces_with_and_without_uvs_count_as_without() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 1 2 3\n";
        if let Ok(mesh) = mesh_from_obj(text.as_bytes(), Path::new("q.obj")) {
            assert!(mesh.uvs.is_empty() || mesh.uvs.len() == mesh.positions.len());
        }
    }
}
