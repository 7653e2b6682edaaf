//! The JSON of a glTF 2.0 file, as far as surfaces, their materials and pictures go. Called by `gltf`
//! and `gltf_scene`.

use super::gltf_compressed::{DracoPrimitive, PackedView};
use super::gltf_material::MaterialJson;
use super::gltf_texture::Sampler;
use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// What is said of files of glTF 1.0.
pub(super) const OLD_STANDARD: &str = "a file of glTF 1.0; only 2.0 is read: convert it \
    (`gltf-pipeline -i old.gltf -o new.glb`) or export it again";

fn malformed(e: &serde_json::Error) -> String {
    format!("the glTF JSON is malformed: {e}; export the mesh again")
}

/// The same with numbers such as 24.0 as whole ones.
fn with_whole_numbers(value: Value) -> Value {
    match value {
        Value::Number(n) => match n.as_f64() {
            // beyond 2⁵³ a float is no count
            Some(x) if n.is_f64() && x.fract() == 0.0 && x.abs() < 9e15 => Value::from(x as i64),
            _ => Value::Number(n),
        },
        Value::Array(list) => list.into_iter().map(with_whole_numbers).collect(),
        Value::Object(map) => (map.into_iter())
            .map(|(key, value)| (key, with_whole_numbers(value)))
            .collect(),
        other => other,
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    #[serde(default)]
    asset: Value,
    #[serde(default)]
    pub(super) scene: Option<usize>,
    #[serde(default)]
    pub(super) scenes: Vec<SceneRoot>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) skins: Vec<Skin>,
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
    /// Reads the JSON of a file.
    ///
    /// # Errors
    /// It is malformed, or of glTF 1.0.
    pub(super) fn read(json: &[u8]) -> Result<Self, String> {
        let old = |asset: &Value| {
            let version = asset["version"].as_str();
            version.is_some_and(|v| v.starts_with("1."))
        };
        let document: Self = match serde_json::from_slice(json) {
            Ok(document) => document,
            Err(e) => {
                let value: Value = serde_json::from_slice(json).map_err(|_| malformed(&e))?;
                if old(&value["asset"]) {
                    return Err(OLD_STANDARD.into());
                }
                // some writers give counts a point: 24.0
                Self::deserialize(with_whole_numbers(value)).map_err(|_| malformed(&e))?
            }
        };
        match old(&document.asset) {
            true => Err(OLD_STANDARD.into()),
            false => Ok(document),
        }
    }

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
    /// Its mesh is bent by other nodes, which say where it is: its own transform does not count.
    pub(super) skin: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

/// The nodes that bend a mesh, and from the mesh's coordinates to theirs.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    #[serde(default)]
    pub(super) joints: Vec<usize>,
    pub(super) inverse_bind_matrices: Option<usize>,
}

/// Extensions of a node that change where its mesh is.
#[derive(Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) copies: Option<Copies>,
    #[serde(rename = "KHR_node_visibility")]
    visibility: Option<Visibility>,
}

/// Whether a node and those below it are there (`KHR_node_visibility`).
#[derive(Deserialize)]
struct Visibility {
    #[serde(default = "visible")]
    visible: bool,
}

fn visible() -> bool {
    true
}

impl NodeExtensions {
    /// Whether the node and those below it are left out.
    pub(super) fn hidden(&self) -> bool {
        self.visibility.as_ref().is_some_and(|v| !v.visible)
    }
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
    pub(super) sparse: Option<Sparse>,
}

/// Elements of an accessor that stand elsewhere.
#[derive(Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    pub(super) indices: SparseList,
    pub(super) values: SparseList,
}

/// Their numbers, or their values.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseList {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    /// That of the numbers; values have their accessor's.
    pub(super) component_type: Option<u32>,
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
    pub(super) webp: Option<OtherSource>,
    #[serde(rename = "KHR_texture_basisu")]
    basisu: Option<OtherSource>,
    #[serde(rename = "EXT_texture_avif")]
    avif: Option<OtherSource>,
    #[serde(rename = "MSFT_texture_dds")]
    dds: Option<OtherSource>,
}

/// The same picture in another format.
#[derive(Deserialize)]
pub(super) struct OtherSource {
    pub(super) source: Option<usize>,
}

impl TextureExtensions {
    /// A format of the picture that is not read.
    pub(super) fn unread(&self) -> Option<&'static str> {
        let formats = [
            (&self.basisu, "KTX2"),
            (&self.avif, "AVIF"),
            (&self.dds, "DDS"),
        ];
        let found = formats.into_iter().find(|(source, _)| source.is_some());
        found.map(|(_, name)| name)
    }
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
    fn whole_numbers_may_have_a_point_and_old_files_say_that_they_are() {
        let read = |text: &str| Document::read(text.as_bytes());
        let accessor = |count: &str| {
            format!(r#"{{"accessors":[{{"componentType":5126.0,"count":{count},"type":"VEC3"}}]}}"#)
        };
        let found = read(&accessor("24.0")).map(|d| d.accessors[0].count);
        assert_eq!(found, Ok(24));
        let said = |text: &str| read(text).map(|_| ()).expect_err(text);
        assert!(said(&accessor("24.5")).contains("malformed"));
        assert!(said("{").contains("malformed"));
        for text in [
            r#"{"asset":{"version":"1.0"},"meshes":{}}"#,
            r#"{"asset":{"version":"1.1"}}"#,
        ] {
            assert!(said(text).contains("glTF 1.0"), "{text}");
        }
        assert!(read(r#"{"asset":{"version":"2.0"}}"#).is_ok() && read("{}").is_ok());
    }

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
