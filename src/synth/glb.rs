//! A plain binary glTF 2.0 of a mesh: positions, normals, one atlas, indices. No materials: the
//! scene's are what is sought.

use crate::geometry::Mesh;
use glam::Vec3;
use serde_json::json;

/// The bytes of a `.glb`; the mesh must not be empty.
#[must_use]
pub fn glb(mesh: &Mesh) -> Vec<u8> {
    let (low, high) = mesh.bounds();
    let exact = |v: Vec3| v.as_dvec3().to_array();
    let parts: [(&[u8], u32); 4] = [
        (bytemuck::cast_slice(&mesh.positions), 34962),
        (bytemuck::cast_slice(&mesh.normals), 34962),
        (bytemuck::cast_slice(&mesh.uvs), 34962),
        (bytemuck::cast_slice(&mesh.triangles), 34963),
    ];
    let mut binary = Vec::new();
    let mut views = Vec::new();
    for (bytes, target) in parts {
        views.push(json!({"buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len(), "target": target}));
        // every element is a multiple of four bytes, so offsets stay aligned
        binary.extend_from_slice(bytes);
    }
    let count = mesh.positions.len();
    let document = json!({
        "asset": {"version": "2.0", "generator": "unbake synth"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "apartment"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3", "min": exact(low), "max": exact(high)},
            {"bufferView": 1, "componentType": 5126, "count": count, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": count, "type": "VEC2"},
            {"bufferView": 3, "componentType": 5125, "count": mesh.triangles.len() * 3, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": binary.len()}],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    for word in [2, total as u32, text.len() as u32, 0x4E4F_534A] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    out.extend_from_slice(&text);
    for word in [binary.len() as u32, 0x004E_4942] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    out.extend_from_slice(&binary);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    #[test]
    fn the_gltf_crate_reads_back_the_same_bits() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(0.1, 1.0, 1.0 / 3.0)],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::new(0.3, 0.7)],
            triangles: vec![[0, 1, 2], [2, 1, 0]],
        };
        let document = gltf::Gltf::from_slice(&glb(&mesh)).expect("valid");
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
