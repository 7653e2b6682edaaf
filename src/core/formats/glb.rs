//! Binary glTF 2.0 (GLB): the one buffer with its views and accessors while it grows, and the
//! container around it.
//!
//! Views start at multiples of four bytes, numbers are stored bit for bit. What a file says besides
//! (nodes, materials, extensions) is its writer's: `solution` for reconstructions, `synth` for
//! scenes.

use crate::error::{Error, Result};
use glam::{Vec2, Vec3, Vec4};
use gltf::json::accessor::{ComponentType, GenericComponentType, Type};
use gltf::json::buffer::{Target, View};
use gltf::json::validation::{Checked, USize64};
use gltf::json::{Accessor, Index};
use serde_json::{Value, json};

/// The extension that names a material's lightmap (Hubs).
pub const LIGHTMAP: &str = "MOZ_lightmap";

/// A GLB file in the making.
#[derive(Debug, Default)]
pub struct GlbWriter {
    bytes: Vec<u8>,
    views: Vec<View>,
    accessors: Vec<Accessor>,
}

impl GlbWriter {
    /// Adds the bytes of an image; returns the number of their view.
    pub fn image(&mut self, content: &[u8]) -> u32 {
        self.view(content, None)
    }

    /// Adds the vertex numbers of triangles; returns the number of their accessor.
    pub fn triangles(&mut self, triangles: &[[u32; 3]]) -> u32 {
        let content = bytemuck::cast_slice(triangles);
        let view = self.view(content, Some(Target::ElementArrayBuffer));
        let kind = (ComponentType::U32, Type::Scalar);
        self.accessor(view, 3 * triangles.len(), kind, None)
    }

    /// Adds positions with their bounds, lowest and highest corner; returns their accessor.
    pub fn positions(&mut self, positions: &[Vec3], bounds: (Vec3, Vec3)) -> u32 {
        let view = self.view(bytemuck::cast_slice(positions), Some(Target::ArrayBuffer));
        let kind = (ComponentType::F32, Type::Vec3);
        self.accessor(view, positions.len(), kind, Some(bounds))
    }

    /// Adds vectors, such as normals; returns their accessor.
    pub fn vectors(&mut self, vectors: &[Vec3]) -> u32 {
        let view = self.view(bytemuck::cast_slice(vectors), Some(Target::ArrayBuffer));
        let kind = (ComponentType::F32, Type::Vec3);
        self.accessor(view, vectors.len(), kind, None)
    }

    /// Adds tangents, w the bitangent's sign; returns their accessor.
    pub fn tangents(&mut self, tangents: &[Vec4]) -> u32 {
        let view = self.view(bytemuck::cast_slice(tangents), Some(Target::ArrayBuffer));
        let kind = (ComponentType::F32, Type::Vec4);
        self.accessor(view, tangents.len(), kind, None)
    }

    /// Adds texture coordinates; returns their accessor.
    pub fn uvs(&mut self, uvs: &[Vec2]) -> u32 {
        let view = self.view(bytemuck::cast_slice(uvs), Some(Target::ArrayBuffer));
        let kind = (ComponentType::F32, Type::Vec2);
        self.accessor(view, uvs.len(), kind, None)
    }

    fn view(&mut self, content: &[u8], target: Option<Target>) -> u32 {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(content.len()),
            byte_offset: Some(USize64::from(self.bytes.len())),
            byte_stride: None,
            name: None,
            target: target.map(Checked::Valid),
            extensions: None,
            extras: Default::default(),
        });
        self.bytes.extend_from_slice(content);
        self.views.len() as u32 - 1
    }

    fn accessor(
        &mut self,
        view: u32,
        count: usize,
        (component, shape): (ComponentType, Type),
        bounds: Option<(Vec3, Vec3)>,
    ) -> u32 {
        let exact = |v: Vec3| json!(v.as_dvec3().to_array());
        self.accessors.push(Accessor {
            buffer_view: Some(Index::new(view)),
            byte_offset: None,
            count: USize64::from(count),
            component_type: Checked::Valid(GenericComponentType(component)),
            extensions: None,
            extras: Default::default(),
            type_: Checked::Valid(shape),
            min: bounds.map(|b| exact(b.0)),
            max: bounds.map(|b| exact(b.1)),
            name: None,
            normalized: false,
            sparse: None,
        });
        self.accessors.len() as u32 - 1
    }

    /// The file: `root` is the document without buffers, views and accessors.
    ///
    /// # Errors
    /// If the file would exceed 4 GiB, the limit of the format.
    pub fn finish(self, mut root: Value) -> Result<Vec<u8>> {
        let value = |v: serde_json::Result<Value>| {
            v.map_err(|e| Error::Failed(format!("a .glb cannot be written: {e}")))
        };
        root["accessors"] = value(serde_json::to_value(&self.accessors))?;
        root["bufferViews"] = value(serde_json::to_value(&self.views))?;
        root["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        container(root.to_string().into_bytes(), &self.bytes)
    }
}

/// A file of a document that knows its buffer, views and accessors, and the buffer's bytes.
///
/// # Errors
/// If the file would exceed 4 GiB, the limit of the format.
pub fn glb_of(root: &Value, binary: &[u8]) -> Result<Vec<u8>> {
    container(root.to_string().into_bytes(), binary)
}

/// Wraps JSON and binary into the container: 12-byte header, two chunks padded to four bytes
/// (spaces, zeros).
fn container(mut json: Vec<u8>, binary: &[u8]) -> Result<Vec<u8>> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let padded = binary.len().next_multiple_of(4);
    let total = 12 + 8 + json.len() + 8 + padded;
    let word = |n: usize| {
        u32::try_from(n).map(u32::to_le_bytes).map_err(|_| {
            Error::Failed(
                "the .glb would exceed 4 GiB, the limit of the format; lower the texture size"
                    .into(),
            )
        })
    };
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&word(total)?);
    out.extend_from_slice(&word(json.len())?);
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&json);
    out.extend_from_slice(&word(padded)?);
    out.extend_from_slice(b"BIN\0");
    out.extend_from_slice(binary);
    out.resize(total, 0);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_reader_finds_what_was_written_at_aligned_places() {
        let mut glb = GlbWriter::default();
        let image = glb.image(b"odd"); // three bytes: what follows must be moved
        let corners = [Vec3::ZERO, Vec3::X, Vec3::new(0.1, 1.0, 1.0 / 3.0)];
        let positions = glb.positions(&corners, (Vec3::ZERO, Vec3::new(1.0, 1.0, 1.0 / 3.0)));
        let uvs = glb.uvs(&[Vec2::ZERO, Vec2::X, Vec2::Y]);
        let triangles = glb.triangles(&[[0, 1, 2]]);
        let root = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{
                "attributes": {"POSITION": positions, "TEXCOORD_0": uvs},
                "indices": triangles,
            }]}],
        });
        let bytes = glb.finish(root).expect("writes");
        let read = gltf::Gltf::from_slice(&bytes).expect("valid");
        assert!(read.views().all(|v| v.offset() % 4 == 0));
        assert_eq!(
            read.views().nth(image as usize).map(|v| v.length()),
            Some(3)
        );
        let primitive = read.meshes().next().and_then(|m| m.primitives().next());
        let primitive = primitive.expect("a primitive");
        let reader = primitive.reader(|_| read.blob.as_deref());
        let back: Vec<Vec3> = reader
            .read_positions()
            .expect("positions")
            .map(Vec3::from_array)
            .collect();
        assert_eq!(back, corners);
        let indices = reader.read_indices().expect("indices").into_u32();
        assert_eq!(indices.collect::<Vec<_>>(), [0, 1, 2]);
    }
}
