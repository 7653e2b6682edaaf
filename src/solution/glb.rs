//! `scene.glb`: the reconstruction as one file that glTF viewers and engines open.
//!
//! One mesh with its atlas; base colour in sRGB, a full occlusion-roughness-metallic texture (R =
//! 255, G = roughness, B = share of metal) and, where the scene emits, an emissive texture
//! normalised by its maximum, which `KHR_materials_emissive_strength` carries. Geometry is stored bit-exactly; the
//! scene's origin is the node's translation and, in f64, its extras, so that a solution can be
//! loaded back from this file without loss. An export may divide the mesh into objects: they are
//! nodes below the scene's, share its material, and are stored relative to where they stand; copies of an
//! object share its vertices and triangles and have their own places in the atlas.
//! Triangles that let light through are a primitive of their own, whose material has
//! `KHR_materials_transmission`; its extras say where they stand among all triangles.

use super::glb_geometry::{Panes, PartGeometry, luminous_entry};
use super::glb_lights::{LuminousPart, PunctualLight, add_lights};
use super::glb_textures::{
    NamedImage, Pictures, TextureFormat, TexturePacking, WantedTextures, encode_pictures,
};
use super::{MeshPart, Solution, copies_among};
use crate::core::brdf::Reflectance;
use crate::core::formats::{GlbWriter, LIGHTMAP, MOST_DATA, read_input};
use crate::core::geometry::{Mesh, Similarity};
use crate::error::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::path::Path;

/// Choices of the glTF export.
#[derive(Clone, Debug, PartialEq)]
pub struct GlbOptions {
    /// Largest side of an embedded texture in pixels; larger ones are halved until they fit.
    pub max_texture: usize,
    /// Lights of `KHR_lights_punctual`: for engines that do not light by emissive surfaces.
    pub lights: Vec<PunctualLight>,
    /// Irradiance as a lightmap on the second texture set.
    pub lightmap: bool,
    /// How textures are stored.
    pub textures: TextureFormat,
    /// Tangents at the vertices, for normal maps.
    pub tangents: bool,
    /// Objects, a node each; empty = all triangles in one node, stored to the bit.
    pub parts: Vec<MeshPart>,
    /// Surfaces that only shine and that the solution's mesh does not have.
    pub luminous: Vec<LuminousPart>,
    /// Textures that need not be encoded again: those of [`super::material_textures`] with the same
    /// options.
    pub encoded: Vec<NamedImage>,
}

impl Default for GlbOptions {
    fn default() -> Self {
        Self {
            max_texture: 4096,
            lights: Vec::new(),
            lightmap: false,
            textures: TextureFormat::Png,
            tangents: false,
            parts: Vec::new(),
            luminous: Vec::new(),
            encoded: Vec::new(),
        }
    }
}

impl GlbOptions {
    /// How its textures are packed.
    #[must_use]
    pub fn packing(&self) -> TexturePacking {
        TexturePacking {
            largest: self.max_texture,
            format: self.textures,
        }
    }
}

/// What a solution needs of its `scene.glb`.
pub(super) struct GlbContent {
    /// Geometry, relative to `origin`.
    pub mesh: Mesh,
    /// File coordinates of the internal origin.
    pub origin: DVec3,
    /// The reflection model of the textures.
    pub reflectance: Reflectance,
    /// The set of files it belongs to; `None` in files of older versions.
    pub generation: Option<String>,
}

const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// The bytes of `scene.glb`.
///
/// # Errors
/// If the mesh has no triangles, a texture cannot be encoded, or the file would exceed 4 GiB.
pub fn scene_glb(solution: &Solution, options: &GlbOptions) -> Result<Vec<u8>> {
    marked_glb(solution, options, "")
}

/// [`scene_glb`] with the generation of the set of files it belongs to.
pub(super) fn marked_glb(
    solution: &Solution,
    options: &GlbOptions,
    generation: &str,
) -> Result<Vec<u8>> {
    Content {
        solution,
        objects: &[],
        options,
        generation,
    }
    .file()
}

/// [`scene_glb`] of parts that have a mesh and textures of their own: `objects` has as many solutions
/// as `options` has parts, whose triangles are those of their solutions.
///
/// # Errors
/// As [`scene_glb`]; if there are more or fewer of the ones than of the others.
pub fn objects_glb(
    solution: &Solution,
    objects: &[Solution],
    options: &GlbOptions,
) -> Result<Vec<u8>> {
    if objects.len() != options.parts.len() {
        return Err(Error::Failed(format!(
            "scene.glb cannot be written: {} parts have {} sets of textures",
            options.parts.len(),
            objects.len()
        )));
    }
    Content {
        solution,
        objects,
        options,
        generation: "",
    }
    .file()
}

/// Textures, and the materials made of them.
struct TextureSet<'a> {
    /// Geometry and planes.
    solution: &'a Solution,
    /// The object that it belongs to, if not all.
    object: Option<&'a str>,
    pictures: Pictures,
    /// Number of its first texture.
    first: usize,
    /// Number of the material of its panes, if there are such pictures.
    panes: Option<usize>,
}

/// What a file holds.
struct Content<'a> {
    solution: &'a Solution,
    /// A solution for each part; empty = all share the whole's.
    objects: &'a [Solution],
    options: &'a GlbOptions,
    generation: &'a str,
}

impl<'a> Content<'a> {
    fn file(&self) -> Result<Vec<u8>> {
        let mesh = &self.solution.mesh;
        if mesh.triangles.is_empty() || mesh.positions.is_empty() {
            return Err(Error::Failed(
                "scene.glb cannot be written: the mesh has no triangles".into(),
            ));
        }
        let options = self.options;
        let sets = self.texture_sets()?;
        let mut glb = GlbWriter::default();
        let Meshes { entries, placed } = self.meshes(&mut glb, &sets);
        let mime = options.textures.mime();
        let mut images: Vec<Value> = Vec::new();
        for set in &sets {
            for image in &set.pictures.images {
                let name = set.object.map_or_else(
                    || image.name.to_owned(),
                    |object| format!("{object}_{}", image.name),
                );
                let view = glb.image(&image.bytes);
                images.push(json!({"name": name, "mimeType": mime, "bufferView": view}));
            }
        }
        let textures: Vec<Value> = (0..images.len())
            .map(|i| match options.textures.extension() {
                Some(name) => json!({"sampler": 0, "extensions": {name: {"source": i}}}),
                None => json!({"sampler": 0, "source": i}),
            })
            .collect();
        let mut root = json!({
            "asset": {"version": "2.0", "generator": concat!("unbake ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes(self.solution, options, &placed, self.generation),
            "meshes": entries,
            "images": images,
            "textures": textures,
            "samplers": [{
                "magFilter": LINEAR,
                "minFilter": LINEAR_MIPMAP_LINEAR,
                "wrapS": CLAMP_TO_EDGE,
                "wrapT": CLAMP_TO_EDGE,
            }],
            "materials": materials(&sets, options),
        });
        add_lights(&mut root, &options.lights);
        name_extensions(&mut root, &sets, options);
        glb.finish(root)
    }

    /// Encodes the textures of the whole, or of each object.
    fn texture_sets(&self) -> Result<Vec<TextureSet<'a>>> {
        let options = self.options;
        let solutions = match self.objects {
            [] => std::slice::from_ref(self.solution),
            objects => objects,
        };
        let wanted = WantedTextures {
            packing: options.packing(),
            lightmap: options.lightmap,
            encoded: &options.encoded,
        };
        let mut first = 0;
        let mut panes = solutions.len() + options.luminous.len();
        let mut sets = Vec::new();
        for (k, solution) in solutions.iter().enumerate() {
            let pictures = encode_pictures(solution, &wanted)?;
            let part = options.parts.get(k).filter(|_| !self.objects.is_empty());
            let count = pictures.images.len();
            let glass = pictures.transmission.map(|_| panes);
            panes += usize::from(glass.is_some());
            sets.push(TextureSet {
                solution,
                object: part.map(|p| p.name.as_str()),
                pictures,
                first,
                panes: glass,
            });
            first += count;
        }
        Ok(sets)
    }

    /// Stores the geometry: the parts', then of what only shines, then of the parts' levels.
    fn meshes(&self, glb: &mut GlbWriter, sets: &[TextureSet<'a>]) -> Meshes {
        let options = self.options;
        let whole = [MeshPart::whole("scene", &self.solution.mesh)];
        let parts = match options.parts.as_slice() {
            [] => whole.as_slice(),
            parts => parts,
        };
        let geometry = |(material, set): (usize, &TextureSet<'a>)| PartGeometry {
            whole: &set.solution.mesh,
            material,
            panes: set.panes.and_then(|material| {
                let triangles = set.solution.pane_triangles()?;
                Some(Panes {
                    triangles,
                    material,
                })
            }),
            lightmap: set.pictures.lightmap.is_some(),
            tangents: options.tangents,
        };
        let geometries: Vec<PartGeometry<'_>> = sets.iter().enumerate().map(geometry).collect();
        // all parts have one set, or each its own
        let geometry = |k: usize| &geometries[k.min(geometries.len() - 1)];
        let own: Vec<Cow<'_, Mesh>> = (parts.iter().enumerate())
            .map(|(k, part)| geometry(k).of_part(part))
            .collect();
        // tangents follow the atlas, in which copies lie at different places
        let copies = match options.tangents {
            true => vec![None; parts.len()],
            false => copies_among(&own, &self.solution.mesh),
        };
        let mut meshes: Vec<Value> = Vec::new();
        let mut placed = Vec::new();
        for (k, ((part, mesh), copy)) in parts.iter().zip(&own).zip(copies).enumerate() {
            let as_copy = copy.and_then(|c| {
                let entry = geometry(k).copy_entry(glb, part, mesh, &meshes[c.of])?;
                Some((entry, c.placed))
            });
            placed.push(as_copy.as_ref().map(|(_, placed)| *placed));
            meshes.push(match as_copy {
                Some((entry, _)) => entry,
                None => geometry(k).mesh_entry(glb, part, mesh),
            });
        }
        for (material, part) in (sets.len()..).zip(&options.luminous) {
            meshes.push(luminous_entry(glb, part, material));
        }
        for (i, part) in parts.iter().enumerate() {
            for (k, level) in part.levels.iter().enumerate() {
                meshes.push(geometry(i).level_entry(glb, &level_name(part, k), level));
            }
        }
        Meshes {
            entries: meshes,
            placed,
        }
    }
}

/// The meshes of a file.
struct Meshes {
    /// In the order of their numbers.
    entries: Vec<Value>,
    /// Of each part that is stored as a copy of another: what takes that one's vertices to its own.
    placed: Vec<Option<Similarity>>,
}

/// The scene's node, which has the mesh or, of several objects, a node for each below it; surfaces
/// that only shine follow there.
fn nodes(
    solution: &Solution,
    options: &GlbOptions,
    placed: &[Option<Similarity>],
    generation: &str,
) -> Value {
    let mut scene = node(solution.origin, solution.reflectance, generation);
    let mut below: Vec<Value> = Vec::new();
    for (part, placed) in options.parts.iter().zip(placed) {
        let place = part.pivot.as_dvec3();
        let at = placed.map_or(place, |p| place + p.translation.as_dvec3());
        let mut node =
            json!({"name": part.name, "mesh": below.len(), "translation": at.to_array()});
        if let Some(placed) = placed {
            node["rotation"] = json!(placed.rotation.to_array());
            node["scale"] = json!(Vec3::splat(placed.scale).to_array());
        }
        below.push(node);
    }
    let mut mesh = below.len();
    if options.parts.is_empty() {
        scene["mesh"] = json!(0);
        mesh = 1;
    }
    for part in &options.luminous {
        below.push(json!({"name": part.name, "mesh": mesh}));
        mesh += 1;
    }
    if !below.is_empty() {
        scene["children"] = json!((1..=below.len()).collect::<Vec<usize>>());
    }
    below.insert(0, scene);
    add_levels(&mut below, &options.parts, mesh);
    json!(below)
}

/// The levels of detail of all parts, as part and number from 0, in the order of their meshes and
/// nodes.
fn levels(parts: &[MeshPart]) -> impl Iterator<Item = (&MeshPart, usize)> {
    parts
        .iter()
        .flat_map(|part| (0..part.levels.len()).map(move |k| (part, k)))
}

/// What engines call a level: the object itself is level 0.
fn level_name(part: &MeshPart, k: usize) -> String {
    format!("{}_LOD{}", part.name, k + 1)
}

/// Adds the nodes of the parts' levels of detail (`MSFT_lod`) behind all others; no node has them
/// below it, the parts' nodes name them. Their meshes are numbered from `mesh` on.
fn add_levels(nodes: &mut Vec<Value>, parts: &[MeshPart], mesh: usize) {
    let first = nodes.len();
    for (i, (part, k)) in levels(parts).enumerate() {
        nodes.push(json!({
            "name": level_name(part, k),
            "mesh": mesh + i,
            "translation": part.pivot.as_dvec3().to_array(),
            "extras": {"error": part.levels[k].error},
        }));
    }
    let mut next = first;
    for (node, part) in nodes[1..].iter_mut().zip(parts) {
        let ids: Vec<usize> = (next..next + part.levels.len()).collect();
        next += ids.len();
        if !ids.is_empty() {
            node["extensions"] = json!({"MSFT_lod": {"ids": ids}});
            // the last is shown however small it gets
            let least = part.levels.iter().map(|l| l.coverage).chain([0.0]);
            node["extras"] = json!({"MSFT_screencoverage": least.collect::<Vec<f32>>()});
        }
    }
}

/// The materials: of each set of textures, of each surface that only shines, of panes.
fn materials(sets: &[TextureSet<'_>], options: &GlbOptions) -> Vec<Value> {
    let shining = options.luminous.iter().map(LuminousPart::material);
    let panes = sets.iter().filter_map(|set| {
        let texture = set.first + set.pictures.transmission?;
        let mut panes = material(set);
        panes["name"] = json!(named("panes", set.object));
        panes["extensions"]["KHR_materials_transmission"] =
            json!({"transmissionFactor": 1.0, "transmissionTexture": {"index": texture}});
        Some(panes)
    });
    sets.iter()
        .map(material)
        .chain(shining)
        .chain(panes)
        .collect()
}

/// The name of a material, which the object's goes before.
fn named(name: &str, object: Option<&str>) -> String {
    object.map_or_else(|| name.to_owned(), |o| format!("{o} {name}"))
}

fn material(set: &TextureSet<'_>) -> Value {
    let TextureSet {
        pictures, first, ..
    } = set;
    let mut material = json!({
        "name": named("reconstruction", set.object),
        "doubleSided": true,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": first},
            "metallicRoughnessTexture": {"index": first + 1},
        },
        "occlusionTexture": {"index": first + 1},
    });
    if let Some(peak) = pictures.lightmap {
        // irradiance = linear texel · intensity, as `bake` writes it
        material["extensions"][LIGHTMAP] = json!({
            "index": first + pictures.images.len() - 1,
            "texCoord": 1,
            "intensity": peak,
        });
    }
    if let Some(strength) = pictures.strength {
        material["emissiveTexture"] = json!({"index": first + 2});
        material["emissiveFactor"] = json!([1.0, 1.0, 1.0]);
        material["extensions"]["KHR_materials_emissive_strength"] =
            json!({"emissiveStrength": f64::from(strength)});
    }
    material
}

fn name_extensions(root: &mut Value, sets: &[TextureSet<'_>], options: &GlbOptions) {
    let any = |has: fn(&Pictures) -> bool| sets.iter().any(|set| has(&set.pictures));
    let used: Vec<&str> = [
        (
            any(|p| p.strength.is_some()) || !options.luminous.is_empty(),
            "KHR_materials_emissive_strength",
        ),
        (any(|p| p.lightmap.is_some()), LIGHTMAP),
        (!options.lights.is_empty(), "KHR_lights_punctual"),
        (
            any(|p| p.transmission.is_some()),
            "KHR_materials_transmission",
        ),
        (levels(&options.parts).next().is_some(), "MSFT_lod"),
    ]
    .into_iter()
    .filter_map(|(uses, name)| uses.then_some(name))
    .chain(options.textures.extension())
    .collect();
    if let Some(name) = options.textures.extension() {
        root["extensionsRequired"] = json!([name]);
    }
    if !used.is_empty() {
        root["extensionsUsed"] = json!(used);
    }
}

fn node(origin: DVec3, reflectance: Reflectance, generation: &str) -> Value {
    let mut node = json!({"name": "scene", "extras": {"origin": origin.to_array(), "reflectance": reflectance}});
    if !generation.is_empty() {
        node["extras"]["generation"] = json!(generation);
    }
    if origin != DVec3::ZERO {
        node["translation"] = json!(origin.to_array());
    }
    node
}

/// Mesh, origin and reflection model of a file that [`scene_glb`] wrote; positions come back bit
/// for bit.
pub(super) fn read_glb(path: &Path) -> Result<GlbContent> {
    let foreign = |what: &str| {
        Error::input(
            path,
            format!("{what}; expected the scene.glb that `unbake solve` wrote: run it again"),
        )
    };
    let bytes = read_input(path, MOST_DATA).map_err(|e| e.advise("run `unbake solve` first"))?;
    let gltf = gltf::Gltf::from_slice(&bytes)
        .map_err(|e| foreign(&format!("is not a valid GLB ({e})")))?;
    let blob = gltf
        .blob
        .as_deref()
        .ok_or_else(|| foreign("has no binary chunk"))?;
    let mut with_mesh = gltf.nodes().filter(|n| n.mesh().is_some());
    let node = with_mesh.next().ok_or_else(|| foreign("has no mesh"))?;
    if with_mesh.next().is_some() {
        return Err(foreign("has several meshes, as exports with objects have"));
    }
    let primitive = node
        .mesh()
        .and_then(|m| m.primitives().next())
        .ok_or_else(|| foreign("has no primitive"))?;
    let reader = primitive.reader(|buffer| (buffer.index() == 0).then_some(blob));

    let positions: Vec<Vec3> = reader
        .read_positions()
        .ok_or_else(|| foreign("has no positions"))?
        .map(Vec3::from)
        .collect();
    let normals: Vec<Vec3> = reader
        .read_normals()
        .ok_or_else(|| foreign("has no normals"))?
        .map(Vec3::from)
        .collect();
    let uvs: Vec<Vec2> = reader
        .read_tex_coords(0)
        .ok_or_else(|| foreign("has no TEXCOORD_0"))?
        .into_f32()
        .map(Vec2::from)
        .collect();
    let indexed = indexed(&node, blob).ok_or_else(|| foreign("has no indices"))?;
    if normals.len() != positions.len() || uvs.len() != positions.len() {
        return Err(foreign("has vertex attributes of different lengths"));
    }
    let json = json_of(&bytes).unwrap_or_default();
    let triangles = joined(&indexed, &json["meshes"][0]["primitives"])
        .ok_or_else(|| foreign("does not say which of its triangles are panes"))?;
    if triangles
        .iter()
        .flatten()
        .any(|&i| i as usize >= positions.len())
    {
        return Err(foreign(
            "has a triangle that names a vertex beyond the last",
        ));
    }
    let extras = extras_of(&json).unwrap_or_default();
    let origin = serde_json::from_value::<[f64; 3]>(extras["origin"].clone()).map_or_else(
        |_| DVec3::from_array(node.transform().decomposed().0.map(f64::from)),
        DVec3::from_array,
    );
    let reflectance = serde_json::from_value(extras["reflectance"].clone()).unwrap_or_default();
    Ok(GlbContent {
        mesh: Mesh {
            positions,
            normals,
            uvs,
            triangles,
        },
        origin,
        reflectance,
        generation: extras["generation"].as_str().map(str::to_owned),
    })
}

/// The triangles of each primitive of a node's mesh; `None` if one has no indices.
fn indexed(node: &gltf::Node<'_>, blob: &[u8]) -> Option<Vec<Vec<[u32; 3]>>> {
    let triangles = |primitive: gltf::Primitive<'_>| {
        let reader = primitive.reader(|buffer| (buffer.index() == 0).then_some(blob));
        let indices: Vec<u32> = reader.read_indices()?.into_u32().collect();
        Some(indices.as_chunks::<3>().0.to_vec())
    };
    node.mesh()?.primitives().map(triangles).collect()
}

/// The triangles of all primitives in the order they had before panes were parted from the rest;
/// `None` if what the file says of it does not fit.
fn joined(indexed: &[Vec<[u32; 3]>], primitives: &Value) -> Option<Vec<[u32; 3]>> {
    let count = indexed.iter().map(Vec::len).sum::<usize>();
    let mut out: Vec<Option<[u32; 3]>> = vec![None; count];
    let mut unplaced: Vec<[u32; 3]> = Vec::new();
    for (k, triangles) in indexed.iter().enumerate() {
        let runs = &primitives[k]["extras"]["runs"];
        if runs.is_null() {
            unplaced.extend_from_slice(triangles);
            continue;
        }
        let runs: Vec<[u32; 2]> = serde_json::from_value(runs.clone()).ok()?;
        let places = runs
            .iter()
            .flat_map(|&[first, n]| u64::from(first)..u64::from(first) + u64::from(n));
        let mut triangles = triangles.iter();
        for place in places {
            let slot = out.get_mut(usize::try_from(place).ok()?)?;
            *slot = Some(*triangles.next()?);
        }
    }
    let mut unplaced = unplaced.into_iter();
    out.into_iter()
        .map(|t| t.or_else(|| unplaced.next()))
        .collect()
}

/// The JSON of a GLB file.
fn json_of(bytes: &[u8]) -> Option<Value> {
    let glb = gltf::binary::Glb::from_slice(bytes).ok()?;
    serde_json::from_slice(&glb.json).ok()
}

/// The extras of the first node with a mesh.
fn extras_of(root: &Value) -> Option<Value> {
    let node = root["nodes"]
        .as_array()?
        .iter()
        .find(|n| n.get("mesh").is_some())?;
    Some(node["extras"].clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::srgb8_from_linear;
    use crate::core::image::Plane;
    use crate::solution::png_textures;
    use crate::solution::tests::small_solution;

    fn decoded(bytes: &[u8]) -> (usize, usize, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .expect("header");
        let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
        let info = reader.next_frame(&mut pixels).expect("pixels");
        (info.width as usize, info.height as usize, pixels)
    }

    fn image_bytes<'a>(gltf: &'a gltf::Gltf, image: &gltf::Image<'_>) -> &'a [u8] {
        let gltf::image::Source::View { view, mime_type } = image.source() else {
            panic!("image is not embedded")
        };
        assert_eq!(mime_type, "image/png");
        &gltf.blob.as_deref().expect("blob")[view.offset()..view.offset() + view.length()]
    }

    #[test]
    fn panes_are_a_primitive_and_a_material_and_come_back_in_order() {
        let mut solution = small_solution();
        let plain = scene_glb(&solution, &GlbOptions::default()).expect("writes");
        let find = |bytes: &[u8], w: &str| bytes.windows(w.len()).any(|x| x == w.as_bytes());
        assert!(!find(&plain, "KHR_materials_transmission") && !find(&plain, "runs"));
        // the first of the two triangles is a pane: it comes second in the file
        let uv = |x: usize, y: usize| Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / 16.0;
        let data = (0..256).map(|i| {
            let uv = uv(i % 16, i / 16);
            let inside = solution.mesh.triangles[0].map(|k| solution.mesh.uvs[k as usize]);
            let side = (inside[1] - inside[0]).perp_dot(uv - inside[0]);
            let third = (inside[1] - inside[0]).perp_dot(inside[2] - inside[0]);
            // a texel and more away from the diagonal
            f32::from(side * third.signum() > 0.15)
        });
        solution.transmission = Some(Plane {
            width: 16,
            height: 16,
            data: data.collect(),
        });
        let flags = solution.pane_triangles().expect("panes");
        assert_eq!(flags.iter().filter(|p| **p).count(), 1);
        let bytes = scene_glb(&solution, &GlbOptions::default()).expect("writes");
        let gltf = gltf::Gltf::from_slice_without_validation(&bytes).expect("glTF");
        let mesh = gltf.meshes().next().expect("mesh");
        assert_eq!(mesh.primitives().count(), 2);
        let json = json_of(&bytes).expect("JSON");
        let panes = &json["materials"][1];
        let factor = &panes["extensions"]["KHR_materials_transmission"]["transmissionFactor"];
        assert_eq!(
            (panes["name"].as_str(), factor.as_f64()),
            (Some("panes"), Some(1.0))
        );
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, &bytes).expect("writes");
        assert_eq!(read_glb(&path).expect("reads").mesh, solution.mesh);
    }

    #[test]
    fn runs_that_do_not_fit_are_refused() {
        let triangles = [vec![[0, 1, 2]], vec![[3, 4, 5], [6, 7, 8]]];
        let of = |runs: Value| joined(&triangles, &json!([{}, {"extras": {"runs": runs}}]));
        let whole = Some(vec![[3, 4, 5], [0, 1, 2], [6, 7, 8]]);
        assert_eq!(of(json!([[0, 1], [2, 1]])), whole);
        for wrong in [
            json!([[0, 1]]),
            json!([[0, 3]]),
            json!([[2, 2]]),
            json!([[4_294_967_295_u32, 4_294_967_295_u32]]),
            json!("all"),
        ] {
            assert_eq!(of(wrong.clone()), None, "{wrong}");
        }
    }

    #[test]
    fn material_and_textures_follow_the_contract() {
        let solution = small_solution();
        let bytes = scene_glb(&solution, &GlbOptions::default()).expect("writes");
        let gltf = gltf::Gltf::from_slice(&bytes).expect("valid glTF");
        let material = gltf.materials().next().expect("material");
        let strength = material.emissive_strength().expect("extension");
        assert!((strength - 12.5).abs() < 1e-6);
        let pbr = material.pbr_metallic_roughness();
        let orm = pbr.metallic_roughness_texture().expect("orm").texture();
        assert_eq!(
            orm.index(),
            material
                .occlusion_texture()
                .expect("occlusion")
                .texture()
                .index()
        );
        let (w, h, pixels) = decoded(image_bytes(&gltf, &orm.source()));
        assert_eq!(
            (w, h),
            (solution.roughness.width, solution.roughness.height)
        );
        for (pixel, r) in pixels.chunks(3).zip(&solution.roughness.data) {
            assert_eq!((pixel[0], pixel[2]), (255, 0));
            assert!((f32::from(pixel[1]) / 255.0 - r).abs() <= 0.5 / 255.0 + 1e-6);
        }
        let base = pbr.base_color_texture().expect("base").texture();
        let (_, _, pixels) = decoded(image_bytes(&gltf, &base.source()));
        assert_eq!(
            pixels[..3],
            solution.albedo.data[0].to_array().map(srgb8_from_linear)
        );
        let emissive = material.emissive_texture().expect("emissive").texture();
        let (_, _, pixels) = decoded(image_bytes(&gltf, &emissive.source()));
        assert!(pixels.contains(&255), "normalised to its maximum");
    }

    #[test]
    fn metal_is_the_third_channel_at_the_finer_size() {
        let mut solution = small_solution();
        let (w, h) = (solution.albedo.width, solution.albedo.height);
        let mut metallic = Plane::filled(w, h, 0.0);
        metallic.data[w + 2] = 1.0;
        solution.metallic = Some(metallic.clone());
        for side in [32, 8] {
            let size = Plane::filled(side, side, 0.4);
            solution.roughness = size;
            let images = png_textures(&solution, 4096).expect("encodes");
            let orm = images.iter().find(|i| i.name == "ORM").expect("there");
            let (width, height, pixels) = decoded(&orm.bytes);
            assert_eq!((width, height), (side.max(w), side.max(h)));
            let metal = |x: usize, y: usize| pixels[3 * (y * width + x) + 2];
            let k = width / w;
            assert!(metal(2 * k, k) > 127 && metal(6 * k, k) == 0 && metal(2 * k, 5 * k) == 0);
            assert!(pixels.chunks(3).all(|p| p[0] == 255 && p[1] == 102));
            if k == 1 {
                let expected = metallic.data.iter().map(|m| (m * 255.0) as u8);
                assert!(pixels.chunks(3).map(|p| p[2]).eq(expected));
            }
        }
    }

    #[test]
    fn views_are_aligned_and_bounds_are_exact() {
        let solution = small_solution();
        let bytes = scene_glb(&solution, &GlbOptions::default()).expect("writes");
        assert_eq!(bytes.len() % 4, 0);
        assert_eq!(
            u32::from_le_bytes(bytes[8..12].try_into().expect("4 bytes")) as usize,
            bytes.len()
        );
        let gltf = gltf::Gltf::from_slice(&bytes).expect("valid");
        assert!(gltf.views().all(|v| v.offset() % 4 == 0));
        let (low, high) = solution.mesh.bounds();
        let position = gltf
            .meshes()
            .next()
            .expect("mesh")
            .primitives()
            .next()
            .expect("primitive")
            .bounding_box();
        assert_eq!(
            (Vec3::from(position.min), Vec3::from(position.max)),
            (low, high)
        );
    }

    /// A copy has the node's place, turn and size, the first one's vertices and triangles, and its own
    /// places in the atlas; with tangents, which follow the atlas, everything is its own.
    #[test]
    fn copies_share_their_geometry_and_keep_their_texture() {
        let mut solution = small_solution();
        let mesh = &mut solution.mesh;
        let turned = |p: Vec3| Vec3::new(4.0 - 2.0 * p.z, p.y, 2.0 * p.x);
        let quad = mesh.positions.clone();
        mesh.positions.extend(quad.into_iter().map(turned));
        mesh.normals.extend(vec![Vec3::Y; 4]);
        mesh.uvs
            .extend(mesh.uvs.clone().into_iter().map(|uv| 0.25 * uv));
        mesh.triangles.extend([[4, 6, 5], [4, 7, 6]]);
        let part = |name: &str, t| MeshPart::standing(name.into(), &solution.mesh, t);
        let mut options = GlbOptions {
            parts: vec![part("a", vec![0, 1]), part("b", vec![2, 3])],
            ..GlbOptions::default()
        };
        let read = |options: &GlbOptions| -> Value {
            let bytes = scene_glb(&solution, options).expect("writes");
            gltf::Gltf::from_slice(&bytes).expect("valid");
            let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
            serde_json::from_slice(&glb.json).expect("JSON")
        };
        let root = read(&options);
        let primitive = |root: &Value, k: usize| root["meshes"][k]["primitives"][0].clone();
        let [a, b] = [0, 1].map(|k| primitive(&root, k));
        assert_eq!(a["indices"], b["indices"]);
        for key in ["POSITION", "NORMAL"] {
            assert_eq!(a["attributes"][key], b["attributes"][key]);
        }
        assert_ne!(a["attributes"]["TEXCOORD_0"], b["attributes"]["TEXCOORD_0"]);
        let numbers = |v: &Value| -> Vec<f32> {
            let list = v.as_array().expect("a list").iter();
            list.filter_map(Value::as_f64).map(|x| x as f32).collect()
        };
        let node = |k: usize| root["nodes"][k + 1].clone();
        let of_b = node(1);
        let rotation = glam::Quat::from_slice(&numbers(&of_b["rotation"]));
        let scale = Vec3::from_slice(&numbers(&of_b["scale"]));
        let at = Vec3::from_slice(&numbers(&of_b["translation"]));
        let first = Vec3::from_slice(&numbers(&node(0)["translation"]));
        for p in &solution.mesh.positions[..4] {
            let placed = rotation * (scale * (*p - first)) + at;
            assert!((placed - turned(*p)).length() < 1e-4, "{placed}");
        }
        options.tangents = true;
        let root = read(&options);
        assert_ne!(
            primitive(&root, 0)["indices"],
            primitive(&root, 1)["indices"]
        );
        assert!(root["nodes"][2].get("rotation").is_none());
    }

    #[test]
    fn nothing_emits_means_no_extension() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::ZERO);
        let bytes = scene_glb(&solution, &GlbOptions::default()).expect("writes");
        let gltf = gltf::Gltf::from_slice(&bytes).expect("valid");
        assert_eq!(gltf.extensions_used().count(), 0);
        assert_eq!(gltf.images().count(), 2, "no unused image");
    }

    #[test]
    fn large_textures_are_halved_to_the_cap() {
        let solution = small_solution();
        let bytes = scene_glb(
            &solution,
            &GlbOptions {
                max_texture: 4,
                ..GlbOptions::default()
            },
        )
        .expect("writes");
        let gltf = gltf::Gltf::from_slice(&bytes).expect("valid");
        for image in gltf.images() {
            let (w, h, _) = decoded(image_bytes(&gltf, &image));
            assert!(w <= 4 && h <= 4);
        }
    }

    #[test]
    fn webp_textures_and_lights_name_their_extensions() {
        let light = PunctualLight {
            name: "lamp 1".into(),
            colour: [1.0, 0.5, 0.2],
            intensity: 3.0,
            position: [1.0, 2.0, 3.0],
            cone: None,
        };
        let options = GlbOptions {
            textures: TextureFormat::WebP,
            lights: vec![light],
            lightmap: true,
            ..GlbOptions::default()
        };
        let bytes = scene_glb(&small_solution(), &options).expect("writes");
        let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
        let root: Value = serde_json::from_slice(&glb.json).expect("JSON");
        assert_eq!(root["extensionsRequired"], json!(["EXT_texture_webp"]));
        assert!(
            root["extensionsUsed"]
                .as_array()
                .expect("list")
                .contains(&json!("KHR_lights_punctual"))
        );
        assert_eq!(root["scenes"][0]["nodes"], json!([0, 1]));
        for (texture, image) in root["textures"]
            .as_array()
            .expect("textures")
            .iter()
            .zip(root["images"].as_array().expect("images"))
        {
            assert!(
                texture.get("source").is_none()
                    && texture["extensions"]["EXT_texture_webp"]["source"].is_u64()
            );
            let view = &root["bufferViews"][image["bufferView"].as_u64().expect("view") as usize];
            let at = view["byteOffset"].as_u64().expect("offset") as usize;
            assert_eq!(&glb.bin.as_ref().expect("binary")[at + 8..at + 12], b"WEBP");
        }
    }

    #[test]
    fn an_empty_mesh_is_an_error_in_words() {
        let mut solution = small_solution();
        solution.mesh = Mesh::default();
        assert!(
            scene_glb(&solution, &GlbOptions::default())
                .expect_err("fails")
                .to_string()
                .contains("no triangles")
        );
    }
}
