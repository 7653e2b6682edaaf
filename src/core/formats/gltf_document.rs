//! The JSON of a glTF 2.0 file, as far as surfaces, their materials and pictures go. Called by `gltf`
//! and `gltf_scene`.

use super::gltf_compressed::{DracoPrimitive, PackedView};
use super::gltf_material::MaterialJson;
use super::gltf_texture::Sampler;
use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    #[serde(default)]
    pub(super) scene: Option<usize>,
    #[serde(default)]
    pub(super) scenes: Vec<SceneRoot>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<MeshEntry>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    pub(super) materials: Vec<MaterialJson>,
    #[serde(default)]
    pub(super) textures: Vec<TextureJson>,
    #[serde(default)]
    pub(super) samplers: Vec<Sampler>,
    #[serde(default)]
    pub(super) images: Vec<Image>,
    #[serde(default)]
    pub(super) extensions_required: Vec<String>,
}

impl Document {
    /// The nodes at the top of the default scene; without scenes those that nobody lists as a child.
    pub(super) fn top_nodes(&self) -> Vec<usize> {
        if let Some(scene) = self.scenes.get(self.scene.unwrap_or(0)) {
            return scene.nodes.clone();
        }
        let children = self.nodes.iter().flat_map(|n| n.children.iter().copied());
        let children: BTreeSet<usize> = children.collect();
        (0..self.nodes.len())
            .filter(|i| !children.contains(i))
            .collect()
    }
}

#[derive(Deserialize)]
pub(super) struct SceneRoot {
    #[serde(default)]
    pub(super) nodes: Vec<usize>,
}

#[derive(Deserialize)]
pub(super) struct Node {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) extensions: NodeExtensions,
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

/// Extensions of a node that change where its mesh is.
#[derive(Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) copies: Option<Copies>,
}

/// Copies of a node's mesh: accessors of as many vectors by `TRANSLATION`, `ROTATION` and `SCALE`
/// (`EXT_mesh_gpu_instancing`).
#[derive(Deserialize)]
pub(super) struct Copies {
    pub(super) attributes: BTreeMap<String, usize>,
}

#[derive(Deserialize)]
pub(super) struct MeshEntry {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    /// Accessors by the attribute's name.
    pub(super) attributes: BTreeMap<String, usize>,
    pub(super) indices: Option<usize>,
    pub(super) material: Option<usize>,
    pub(super) mode: Option<u32>,
    #[serde(default)]
    pub(super) extensions: PrimitiveExtensions,
}

#[derive(Default, Deserialize)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(super) draco: Option<DracoPrimitive>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) shape: String,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    #[serde(default)]
    pub(super) extensions: ViewExtensions,
}

#[derive(Default, Deserialize)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression")]
    pub(super) packed: Option<PackedView>,
}

#[derive(Deserialize)]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    #[serde(default)]
    pub(super) extensions: BufferExtensions,
}

#[derive(Default, Deserialize)]
pub(super) struct BufferExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression")]
    pub(super) packed: Option<Fallback>,
}

/// Marks a buffer whose views are all packed: what it holds itself is for others.
#[derive(Deserialize)]
pub(super) struct Fallback {
    #[serde(default)]
    pub(super) fallback: bool,
}

/// A texture: a picture and how it goes on.
#[derive(Deserialize)]
pub(super) struct TextureJson {
    pub(super) source: Option<usize>,
    pub(super) sampler: Option<usize>,
    #[serde(default)]
    pub(super) extensions: TextureExtensions,
}

#[derive(Default, Deserialize)]
pub(super) struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    pub(super) webp: Option<WebpSource>,
}

#[derive(Deserialize)]
pub(super) struct WebpSource {
    pub(super) source: Option<usize>,
}

/// A picture, within the file or beside it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image {
    pub(super) uri: Option<String>,
    pub(super) buffer_view: Option<usize>,
}

impl Node {
    /// From its own coordinates to its parent's.
    pub(super) fn transform(&self) -> DMat4 {
        match self.matrix {
            Some(m) => DMat4::from_cols_array(&m),
            None => composed(self.translation, self.rotation, self.scale),
        }
    }
}

/// The transform that scales, turns and moves; a rotation of length zero turns nothing.
pub(super) fn composed(
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
) -> DMat4 {
    let rotation = rotation.map_or(DQuat::IDENTITY, |r| {
        let q = DQuat::from_array(r);
        if q.length_squared() > 0.0 {
            q.normalize()
        } else {
            DQuat::IDENTITY
        }
    });
    DMat4::from_scale_rotation_translation(
        scale.map_or(DVec3::ONE, DVec3::from_array),
        rotation,
        translation.map_or(DVec3::ZERO, DVec3::from_array),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_scenes_the_top_is_what_nobody_lists() {
        let top = |text: &str| {
            let document: Document = serde_json::from_str(text).expect("reads");
            document.top_nodes()
        };
        let nodes = r#""nodes":[{"children":[1]},{"mesh":0},{}]"#;
        assert_eq!(top(&format!("{{{nodes}}}")), [0, 2]);
        assert_eq!(
            top(&format!(
                r#"{{"scenes":[{{"nodes":[2]}},{{"nodes":[0]}}],"scene":1,{nodes}}}"#
            )),
            [0]
        );
    }
}
