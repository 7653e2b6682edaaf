//! The scene's file again, with its lightmap: `MOZ_lightmap` on every material, coordinates on a
//! second texture set.
//!
//! What the file says stays (names, nodes, cameras, lights, animations, materials, pictures); its
//! meshes are written anew, one per node, for every copy has its own place on the lightmap. All
//! data lie in the one buffer of a `.glb`, unpacked.

use super::document::{array, forget_extensions, list, push, remove, remove_extensions};
use super::layout::Layout;
use super::lightmap::Baked;
use super::scene::BakeScene;
use crate::core::formats::{GltfFile, LIGHTMAP, RawAttribute, encode_rgb8, srgb8_from_linear};
use crate::core::geometry::Mesh;
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use glam::Vec2;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A scene with its light.
pub(super) struct Lit {
    pub(super) scene: BakeScene,
    pub(super) layout: Layout,
    pub(super) baked: Baked,
    pub(super) seams: [f32; 2],
}

/// Share of the texels that the picture may clip: one lamp on a wall must not take all steps of
/// eight bits.
const CLIPPED: f64 = 1e-3;
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
/// Extensions of packed data, which is written unpacked.
const PACKINGS: [&str; 3] = [
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
];

/// The lightmap as a picture of eight bits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Shown {
    /// Irradiance = linear value of the picture × this.
    pub intensity: f32,
    /// Set of texture coordinates.
    pub tex_coord: u32,
    /// Share of the texels that are brighter than the picture can show.
    pub clipped: f64,
}

/// The scene's file with its lightmap.
pub(super) struct LitDocument {
    /// The document.
    pub(super) root: Value,
    /// Its buffer.
    pub(super) bytes: Vec<u8>,
    /// The nodes at the top of its scene.
    pub(super) top_nodes: Vec<usize>,
    /// The lightmap in it.
    pub(super) shown: Shown,
}

/// The document and the buffer while they grow.
struct Rewriter<'f> {
    file: &'f GltfFile<'f>,
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    /// New numbers of what is taken over.
    taken_views: BTreeMap<usize, usize>,
    taken_accessors: BTreeMap<usize, usize>,
}

/// The file with its lightmap.
///
/// # Errors
/// Data of the file that is damaged or cannot be taken over.
pub(super) fn lit_document(file: &GltfFile<'_>, path: &Path, lit: &Lit) -> Result<LitDocument> {
    let mut root = file.root().clone();
    if let Some(name) = data_of_extensions(&root) {
        return Err(Error::input(
            path,
            format!("{name} has data of its own, which is not written again; export without it"),
        ));
    }
    let mut out = Rewriter {
        file,
        bytes: Vec::new(),
        views: Vec::new(),
        accessors: Vec::new(),
        taken_views: BTreeMap::new(),
        taken_accessors: BTreeMap::new(),
    };
    let set = lightmap_set(&root);
    let materials = out.write_meshes(&mut root, lit, set)?;
    out.take_motion(&mut root)?;
    out.take_images(&mut root)?;
    let (picture, mut shown) = picture(&lit.baked.maps[0], &lit.scene.mesh)?;
    shown.tex_coord = set;
    out.add_lightmap(&mut root, &picture, &materials, &shown);
    forget_extensions(&mut root, &PACKINGS);
    push(&mut root, "extensionsUsed", json!(LIGHTMAP));
    root["asset"]["generator"] = json!(concat!("unbake ", env!("CARGO_PKG_VERSION")));
    root["accessors"] = json!(out.accessors);
    root["bufferViews"] = json!(out.views);
    root["buffers"] = json!([{"byteLength": out.bytes.len()}]);
    Ok(LitDocument {
        root,
        bytes: out.bytes,
        top_nodes: file.top_nodes(),
        shown,
    })
}

/// An extension with data that nobody here knows of, if there is one.
fn data_of_extensions(root: &Value) -> Option<String> {
    fn has_view(v: &Value) -> bool {
        match v {
            Value::Object(o) => o.iter().any(|(k, v)| k == "bufferView" || has_view(v)),
            Value::Array(a) => a.iter().any(has_view),
            _ => false,
        }
    }
    let nodes = root["nodes"].as_array().into_iter().flatten();
    let all = nodes.chain(std::iter::once(root));
    let extensions = all.filter_map(|v| v["extensions"].as_object()).flatten();
    extensions
        .filter(|(_, v)| has_view(v))
        .map(|(name, _)| name.clone())
        .next()
}

/// The first set of texture coordinates from 1 on that no material uses.
fn lightmap_set(root: &Value) -> u32 {
    fn sets(v: &Value, into: &mut BTreeSet<u64>) {
        match v {
            Value::Object(o) => {
                into.extend(o.get("texCoord").and_then(Value::as_u64));
                o.values().for_each(|v| sets(v, into));
            }
            Value::Array(a) => a.iter().for_each(|v| sets(v, into)),
            _ => {}
        }
    }
    let mut used = BTreeSet::new();
    sets(&root["materials"], &mut used);
    (1..).find(|s| !used.contains(&u64::from(*s))).unwrap_or(1)
}

impl Rewriter<'_> {
    fn view(&mut self, content: &[u8], more: Value) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = more;
        view["buffer"] = json!(0);
        view["byteOffset"] = json!(self.bytes.len());
        view["byteLength"] = json!(content.len());
        self.views.push(view);
        self.bytes.extend_from_slice(content);
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Writes the meshes of all nodes anew; returns the materials they have.
    fn write_meshes(&mut self, root: &mut Value, lit: &Lit, set: u32) -> Result<BTreeSet<usize>> {
        let scene = &lit.scene;
        let mut triangles: Vec<Vec<usize>> = vec![Vec::new(); scene.pieces.len()];
        for (t, place) in scene.places.iter().enumerate() {
            triangles[place.piece].push(t);
        }
        let default = root["materials"].as_array().map_or(0, Vec::len);
        let (mut materials, mut meshes) = (BTreeSet::new(), Vec::new());
        let old = std::mem::take(&mut root["meshes"]);
        let mut of_node: BTreeMap<usize, usize> = BTreeMap::new();
        for (number, piece) in scene.pieces.iter().enumerate() {
            if triangles[number].is_empty() {
                continue;
            }
            let index = *of_node.entry(piece.node).or_insert_with(|| {
                let mut mesh = old[piece.mesh].clone();
                mesh["primitives"] = json!([]);
                remove(&mut mesh, "weights");
                meshes.push(mesh);
                meshes.len() - 1
            });
            let mut primitive = old[piece.mesh]["primitives"][piece.primitive].clone();
            for key in ["mode", "targets"] {
                remove(&mut primitive, key);
            }
            remove_extensions(&mut primitive, &PACKINGS);
            let material = piece.material.filter(|m| *m < default).unwrap_or(default);
            materials.insert(material);
            primitive["material"] = json!(material);
            self.write_primitive(&mut primitive, lit, &triangles[number], set)?;
            push(&mut meshes[index], "primitives", primitive);
        }
        for (node, value) in list(root, "nodes").enumerate() {
            remove(value, "mesh");
            remove(value, "weights");
            match of_node.get(&node) {
                Some(mesh) => value["mesh"] = json!(mesh),
                None => remove(value, "skin"),
            }
        }
        root["meshes"] = json!(meshes);
        Ok(materials)
    }

    /// The vertices and indices of some triangles of one piece.
    fn write_primitive(
        &mut self,
        primitive: &mut Value,
        lit: &Lit,
        triangles: &[usize],
        set: u32,
    ) -> Result<()> {
        let (scene, mesh) = (&lit.scene, &lit.scene.mesh);
        let piece = &scene.pieces[scene.places[triangles[0]].piece];
        let mut numbers: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
        let (mut vertices, mut uvs, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for &t in triangles {
            let own = piece.triangles[scene.places[t].triangle];
            for (vertex, uv) in own.into_iter().zip(mesh.corner_uvs(t)) {
                let next = vertices.len() as u32;
                let key = (vertex, uv.to_array().map(f32::to_bits));
                let index = *numbers.entry(key).or_insert(next);
                if index == next {
                    vertices.push(vertex);
                    uvs.push(uv);
                }
                indices.push(index);
            }
        }
        let mut attributes = serde_json::Map::new();
        let lightmap = format!("TEXCOORD_{set}");
        for raw in self.file.attributes(piece.mesh, piece.primitive)? {
            if raw.name != lightmap {
                let accessor = self.attribute(&raw, &vertices);
                attributes.insert(raw.name, json!(accessor));
            }
        }
        let view = self.view(
            bytemuck::cast_slice::<Vec2, u8>(&uvs),
            json!({"target": 34962}),
        );
        let uv = self.accessor(json!({
            "bufferView": view, "componentType": FLOAT, "count": uvs.len(), "type": "VEC2",
        }));
        // (sets are numbered without gaps)
        for below in 0..set {
            let name = format!("TEXCOORD_{below}");
            attributes.entry(name).or_insert_with(|| json!(uv));
        }
        attributes.insert(lightmap, json!(uv));
        let view = self.view(bytemuck::cast_slice(&indices), json!({"target": 34963}));
        let indices = self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR",
        }));
        primitive["attributes"] = Value::Object(attributes);
        primitive["indices"] = json!(indices);
        Ok(())
    }

    fn attribute(&mut self, raw: &RawAttribute, vertices: &[u32]) -> usize {
        let content = raw.gathered(vertices);
        let mut view = json!({"target": 34962});
        if raw.stride() != raw.size {
            view["byteStride"] = json!(raw.stride());
        }
        let view = self.view(&content, view);
        let mut accessor = json!({
            "bufferView": view,
            "componentType": raw.component_type,
            "count": vertices.len(),
            "type": raw.shape,
        });
        if raw.normalized {
            accessor["normalized"] = json!(true);
        }
        if raw.name == "POSITION" {
            let [low, high] = raw.bounds(vertices);
            (accessor["min"], accessor["max"]) = (json!(low), json!(high));
        }
        self.accessor(accessor)
    }

    /// Takes over what moves the scene: keyframes and the bind poses of skins.
    fn take_motion(&mut self, root: &mut Value) -> Result<()> {
        for animation in list(root, "animations") {
            // weights of morph targets have nothing to move any more
            if let Some(channels) = array(animation, "channels") {
                channels.retain(|c| c["target"]["path"] != "weights");
            }
            for sampler in list(animation, "samplers") {
                for key in ["input", "output"] {
                    self.take_accessor(&mut sampler[key])?;
                }
            }
        }
        if let Some(animations) = array(root, "animations") {
            let moves = |a: &Value| a["channels"].as_array().is_some_and(|c| !c.is_empty());
            animations.retain(moves);
        }
        if root["animations"].as_array().is_some_and(Vec::is_empty) {
            remove(root, "animations");
        }
        for skin in list(root, "skins") {
            if !skin["inverseBindMatrices"].is_null() {
                self.take_accessor(&mut skin["inverseBindMatrices"])?;
            }
        }
        Ok(())
    }

    /// Takes an accessor over and puts its new number in place of the old.
    fn take_accessor(&mut self, number: &mut Value) -> Result<()> {
        let Some(old) = number.as_u64().map(|n| n as usize) else {
            return Ok(());
        };
        let new = match self.taken_accessors.get(&old) {
            Some(new) => *new,
            None => {
                let mut accessor = self.file.root()["accessors"][old].clone();
                for key in [
                    "/bufferView",
                    "/sparse/indices/bufferView",
                    "/sparse/values/bufferView",
                ] {
                    if let Some(view) = accessor.pointer_mut(key) {
                        self.take_view(view)?;
                    }
                }
                let new = self.accessor(accessor);
                self.taken_accessors.insert(old, new);
                new
            }
        };
        *number = json!(new);
        Ok(())
    }

    /// Takes a view over and puts its new number in place of the old.
    fn take_view(&mut self, number: &mut Value) -> Result<()> {
        let Some(old) = number.as_u64().map(|n| n as usize) else {
            return Ok(());
        };
        let new = match self.taken_views.get(&old) {
            Some(new) => *new,
            None => {
                let bytes = self.file.view_bytes(old)?;
                let mut more = json!({});
                let stride = &self.file.root()["bufferViews"][old]["byteStride"];
                if !stride.is_null() {
                    more["byteStride"] = stride.clone();
                }
                let new = self.view(bytes, more);
                self.taken_views.insert(old, new);
                new
            }
        };
        *number = json!(new);
        Ok(())
    }

    /// Takes the pictures over, those in other files too.
    fn take_images(&mut self, root: &mut Value) -> Result<()> {
        for (i, image) in list(root, "images").enumerate() {
            if image["uri"].is_null() {
                self.take_view(&mut image["bufferView"])?;
                continue;
            }
            let bytes = self.file.image_bytes(i)?;
            let mime = match &*bytes {
                [0xff, 0xd8, ..] => "image/jpeg",
                b if b.starts_with(b"RIFF") => "image/webp",
                b if b.starts_with(b"\xabKTX") => "image/ktx2",
                _ => "image/png",
            };
            let view = self.view(&bytes, json!({}));
            remove(image, "uri");
            image["bufferView"] = json!(view);
            image["mimeType"] = json!(mime);
        }
        Ok(())
    }

    /// Adds the picture and names it in the materials.
    fn add_lightmap(
        &mut self,
        root: &mut Value,
        picture: &[u8],
        materials: &BTreeSet<usize>,
        shown: &Shown,
    ) {
        let view = self.view(picture, json!({}));
        let image = json!({"name": "Lightmap", "mimeType": "image/png", "bufferView": view});
        let image = push(root, "images", image);
        let sampler = json!({"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071});
        let sampler = push(root, "samplers", sampler);
        let texture = push(
            root,
            "textures",
            json!({"source": image, "sampler": sampler}),
        );
        let count = root["materials"].as_array().map_or(0, Vec::len);
        if materials.contains(&count) {
            // the standard's default, in words
            push(root, "materials", json!({"name": "default"}));
        }
        for &material in materials {
            root["materials"][material]["extensions"][LIGHTMAP] = json!({
                "index": texture,
                "texCoord": shown.tex_coord,
                "intensity": shown.intensity,
            });
        }
    }
}

/// The lightmap as an sRGB picture: a share of what all but few texels stay below.
fn picture(map: &RgbPlane, mesh: &Mesh) -> Result<(Vec<u8>, Shown)> {
    let texels = crate::core::texture::Texels::rasterize(mesh, map.width, map.height);
    let value = |&c: &u32| map.data[c as usize].max_element();
    let mut peaks: Vec<f32> = texels.cell.iter().map(value).collect();
    peaks.sort_by(f32::total_cmp);
    let at = (peaks.len() as f64 * (1.0 - CLIPPED)) as usize;
    let ceiling = peaks.get(at.min(peaks.len().saturating_sub(1))).copied();
    let intensity = ceiling.filter(|c| *c > 0.0).or(peaks.last().copied());
    let intensity = intensity.unwrap_or(1.0).max(f32::MIN_POSITIVE);
    let above = peaks.iter().filter(|p| **p > intensity).count();
    let rgb: Vec<u8> = map
        .data
        .iter()
        .flat_map(|v| (*v / intensity).to_array().map(srgb8_from_linear))
        .collect();
    let shown = Shown {
        intensity,
        tex_coord: 1,
        clipped: above as f64 / peaks.len().max(1) as f64,
    };
    Ok((encode_rgb8(map.width, map.height, &rgb)?, shown))
}
