//! A plain binary glTF 2.0 of a mesh: positions, normals, one atlas, indices. No materials: the
//! scene's are what is sought.

use crate::core::formats::GlbWriter;
use crate::core::geometry::Mesh;
use crate::error::Result;
use serde_json::json;

/// The bytes of a `.glb`; the mesh must not be empty.
///
/// # Errors
/// If the file would exceed 4 GiB.
pub fn glb(mesh: &Mesh) -> Result<Vec<u8>> {
    let mut glb = GlbWriter::default();
    let position = glb.positions(&mesh.positions, mesh.bounds());
    let normal = glb.vectors(&mesh.normals);
    let uv = glb.uvs(&mesh.uvs);
    let indices = glb.triangles(&mesh.triangles);
    glb.finish(json!({
        "asset": {"version": "2.0", "generator": "unbake synth"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "apartment"}],
        "meshes": [{"primitives": [{
            "attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
            "indices": indices,
        }]}],
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    #[test]
    fn the_gltf_crate_reads_back_the_same_bits() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(0.1, 1.0, 1.0 / 3.0)],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::new(0.3, 0.7)],
            triangles: vec![[0, 1, 2], [2, 1, 0]],
        };
        let document = gltf::Gltf::from_slice(&glb(&mesh).expect("writes")).expect("valid");
        let primitive = document
            .meshes()
            .next()
            .and_then(|m| m.primitives().next())
            .expect("one primitive");
        let reader = primitive.reader(|_| document.blob.as_deref());
        let positions: Vec<Vec3> = reader
            .read_positions()
            .expect("positions")
            .map(Vec3::from_array)
            .collect();
        let uvs: Vec<Vec2> = reader
            .read_tex_coords(0)
            .expect("uvs")
            .into_f32()
            .map(Vec2::from_array)
            .collect();
        let indices: Vec<u32> = reader.read_indices().expect("indices").into_u32().collect();
        assert_eq!((positions, uvs), (mesh.positions, mesh.uvs));
        assert_eq!(indices, vec![0, 1, 2, 2, 1, 0]);
    }
}
