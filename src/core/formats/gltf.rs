//! glTF 2.0 geometry: `.glb` and `.gltf` with embedded or neighbouring buffers.
//!
//! Only what geometry needs is deserialised, and every index, offset and count is checked against
//! the bytes that are there before anything is allocated: a hostile file gives an error, never a
//! panic or a huge allocation. Node transforms are composed in f64, so that a mesh moved far from
//! the origin by its node keeps its shape.

use super::gltf_bytes::{load_buffer, split};
use super::gltf_compressed::Unpacked;
use super::gltf_document::{Copies, Document, MeshEntry, Primitive, composed};
use super::gltf_numbers::normalised;
use super::gltf_texture::{GltfTexture, UvSource};
use super::raw_mesh::{NameKind, Part, RawMesh};
use super::surface_look::{Look, TextureSource};
use crate::{Error, Result};
use glam::{DMat4, DVec3, Vec2, Vec3, Vec4};
use std::borrow::Cow;
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;
use std::rc::Rc;

/// Beginnings of the names of extensions that a file may require without changing what is read
/// here (materials, lights, numbers of features), and of those that are read: copies, nodes left out,
/// integers and packed data.
const UNDERSTOOD: [&str; 16] = [
    "EXT_mesh_features",
    "EXT_structural_metadata",
    "EXT_instance_features",
    "KHR_node_visibility",
    "EXT_mesh_gpu_instancing",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "EXT_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_xmp",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
];
/// Deepest node hierarchy followed; real files stay far below, and a cycle must end.
const MAX_DEPTH: usize = 256;
/// Most mesh instances; a hostile hierarchy can reach one node along exponentially many paths.
const MAX_INSTANCES: usize = 1 << 20;
/// Most vertices and most indices of all instances together. Derived: 2²⁷ vertices take 6 GB here;
/// a file of a few MB can ask for a thousand times that by naming the same data again and again.
const MAX_ELEMENTS: u64 = 1 << 27;

/// Geometry of a `.glb` or `.gltf` from its bytes; neighbouring buffer files are looked up beside
/// `path`.
///
/// # Errors
/// If the file is damaged, asks for more bytes than there are, or holds no triangles.
pub fn mesh_from_gltf(bytes: &[u8], path: &Path) -> Result<RawMesh> {
    let fail = |m: String| Error::input(path, m);
    let parts = Reader::open(bytes, path)?.parts().map_err(fail)?;
    if parts.is_empty() {
        return Err(fail(WITHOUT_TRIANGLES.into()));
    }
    RawMesh::from_parts(parts, path)
}

/// What is said of a file without surface.
pub(super) const WITHOUT_TRIANGLES: &str =
    "no triangle geometry in the scene; export the mesh with its triangles";

/// A file whose JSON is read and whose buffers are at hand.
pub(super) struct Reader<'a> {
    pub(super) document: Document,
    pub(super) buffers: Vec<Cow<'a, [u8]>>,
    /// Packed views that were unpacked.
    pub(super) views: Vec<OnceCell<Vec<u8>>>,
    /// Bytes in `views`.
    pub(super) unpacked: Cell<u64>,
    /// Draco's primitives by their buffer view: a mesh may stand in the scene many times.
    draco: RefCell<BTreeMap<usize, Rc<Unpacked>>>,
}

/// A primitive with what Draco had of it.
pub(super) struct Source<'a> {
    primitive: &'a Primitive,
    draco: Option<Rc<Unpacked>>,
}

/// A node of the scene.
#[derive(Clone, Copy)]
pub(super) struct Placed {
    /// Its number.
    pub(super) node: usize,
    /// Its mesh, if it has one.
    pub(super) mesh: Option<usize>,
    /// Its transform.
    pub(super) world: DMat4,
}

impl Source<'_> {
    /// Whether Draco has an attribute.
    pub(super) fn is_packed(&self, name: &str) -> bool {
        let extension = self.primitive.extensions.draco.as_ref();
        extension.is_some_and(|d| d.attributes.contains_key(name))
    }
}

pub(super) type Reading<T> = std::result::Result<T, String>;

impl<'a> Reader<'a> {
    /// Reads the JSON of a file and its buffers.
    ///
    /// # Errors
    /// The file is damaged, requires what is not understood, or a buffer of it is missing.
    pub(super) fn open(bytes: &'a [u8], path: &Path) -> Result<Self> {
        let fail = |m: String| Error::input(path, m);
        let (json, blob) = split(bytes, path)?;
        let document = Document::read(json).map_err(fail)?;
        let known = |e: &&String| !UNDERSTOOD.iter().any(|u| e.starts_with(u));
        if let Some(e) = document.extensions_required.iter().find(known) {
            return Err(fail(format!(
                "it requires the extension {e}, which is not supported; export without it"
            )));
        }
        let load = |(i, b)| load_buffer(i, b, blob, path);
        let buffers = document.buffers.iter().enumerate().map(load);
        let buffers = buffers.collect::<Result<Vec<_>>>()?;
        let views = document.buffer_views.iter().map(|_| OnceCell::new());
        Ok(Self {
            buffers,
            views: views.collect(),
            unpacked: Cell::new(0),
            draco: RefCell::default(),
            document,
        })
    }
}

impl Reader<'_> {
    /// Adds a primitive's vertices and indices to what the file has asked for so far.
    fn count(&self, primitive: &Primitive, asked: &mut u64) -> Reading<()> {
        let most = self.buffers.iter().map(|b| b.len() as u64).max();
        for index in [
            primitive.attributes.get("POSITION").copied(),
            primitive.indices,
        ] {
            let accessor = index.and_then(|a| self.document.accessors.get(a));
            let Some(accessor) = accessor else { continue };
            let view = accessor
                .buffer_view
                .and_then(|v| self.document.buffer_views.get(v));
            let plain = view.is_some_and(|v| v.extensions.packed.is_none());
            // a count that no buffer can hold is refused where it is read, with better words
            if !plain || accessor.count <= most.unwrap_or(0) {
                *asked = asked.saturating_add(accessor.count);
            }
        }
        if *asked <= 2 * MAX_ELEMENTS {
            return Ok(());
        }
        Err(format!(
            "its instances ask for more than {MAX_ELEMENTS} vertices in all; simplify the mesh"
        ))
    }

    /// All triangle primitives of the default scene, in world coordinates.
    fn parts(&self) -> Reading<Vec<Part>> {
        let mut parts = Vec::new();
        for placed in self.placed()? {
            let Some(m) = placed.mesh else { continue };
            for (p, primitive) in self.mesh(m)?.primitives.iter().enumerate() {
                let part = self
                    .part(primitive, &placed.world)
                    .map_err(|e| format!("mesh {m}, primitive {p}: {e}"))?;
                parts.extend(part.map(|part| Part {
                    names: self.names(&placed, primitive),
                    look: self.look(primitive),
                    ..part
                }));
            }
        }
        Ok(parts)
    }

    /// What the file calls a primitive's triangles: by its material, and by its node or mesh.
    fn names(&self, placed: &Placed, primitive: &Primitive) -> Vec<(NameKind, String)> {
        let d = &self.document;
        let material = primitive.material.and_then(|m| d.materials.get(m));
        let node = d.nodes.get(placed.node).and_then(|n| n.name.clone());
        let mesh = placed.mesh.and_then(|m| d.meshes.get(m));
        let object = node.or(mesh.and_then(|m| m.name.clone()));
        let material = material.and_then(|m| m.name.clone());
        let material = material.map(|name| (NameKind::Material, name));
        let object = object.map(|name| (NameKind::Object, name));
        material.into_iter().chain(object).collect()
    }

    pub(super) fn mesh(&self, m: usize) -> Reading<&MeshEntry> {
        let found = self.document.meshes.get(m);
        found.ok_or_else(|| format!("mesh {m} does not exist; export the mesh again"))
    }

    /// Nodes of the default scene with their world transforms, in the order of the hierarchy, one
    /// whose mesh is copied once for each copy; what their meshes ask for is counted.
    pub(super) fn placed(&self) -> Reading<Vec<Placed>> {
        let d = &self.document;
        let (mut found, mut visited) = (Vec::new(), 0usize);
        let mut worlds = BTreeMap::new();
        let mut stack: Vec<(usize, DMat4, usize)> = d
            .top_nodes()
            .into_iter()
            .rev()
            .map(|n| (n, DMat4::IDENTITY, 0))
            .collect();
        while let Some((index, parent, depth)) = stack.pop() {
            visited += 1;
            if depth > MAX_DEPTH || visited > MAX_INSTANCES {
                return Err(
                    "the node hierarchy is cyclic or nested too deeply; export the mesh again"
                        .into(),
                );
            }
            let node = d
                .nodes
                .get(index)
                .ok_or_else(|| format!("node {index} does not exist; export the mesh again"))?;
            if node.extensions.hidden() {
                continue;
            }
            let world = parent * node.transform();
            worlds.insert(index, world);
            stack.extend(node.children.iter().rev().map(|&c| (c, world, depth + 1)));
            let copies = match (&node.extensions.copies, node.mesh) {
                (Some(copies), Some(_)) => self
                    .copies(copies)
                    .map_err(|e| format!("node {index}, EXT_mesh_gpu_instancing: {e}"))?,
                _ => vec![DMat4::IDENTITY],
            };
            visited += copies.len();
            found.extend(copies.into_iter().map(|copy| Placed {
                node: index,
                mesh: node.mesh,
                world: world * copy,
            }));
        }
        self.place_skinned(&mut found, &worlds)?;
        let mut asked = 0;
        for m in found.iter().filter_map(|p| p.mesh) {
            for primitive in &self.mesh(m)?.primitives {
                self.count(primitive, &mut asked)?;
            }
        }
        Ok(found)
    }

    /// Puts the meshes of skins where their joints have them, whatever their own node says (the
    /// standard, 3.7.3.3).
    fn place_skinned(&self, found: &mut [Placed], worlds: &BTreeMap<usize, DMat4>) -> Reading<()> {
        let mut known: BTreeMap<usize, DMat4> = BTreeMap::new();
        for placed in found.iter_mut().filter(|p| p.mesh.is_some()) {
            let node = self.document.nodes.get(placed.node);
            let Some(skin) = node.and_then(|n| n.skin) else {
                continue;
            };
            placed.world = match known.entry(skin) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(place) => *place.insert(self.at_rest(skin, worlds)?),
            };
        }
        Ok(())
    }

    /// From a skinned mesh's coordinates to the world: at rest all joints agree, so the first decides.
    fn at_rest(&self, skin: usize, worlds: &BTreeMap<usize, DMat4>) -> Reading<DMat4> {
        let found = self.document.skins.get(skin);
        let found = found.ok_or_else(|| format!("skin {skin} does not exist; export again"))?;
        let joint = found.joints.first().and_then(|j| worlds.get(j)).copied();
        let unbound = found.inverse_bind_matrices.map(|a| self.floats::<16>(a));
        let unbound = unbound.transpose()?.and_then(|list| list.first().copied());
        let unbound = unbound.map_or(DMat4::IDENTITY, |m| DMat4::from_cols_array(&m));
        Ok(joint.unwrap_or(DMat4::IDENTITY) * unbound)
    }

    /// From a mesh's coordinates to its node's, for each copy.
    fn copies(&self, copies: &Copies) -> Reading<Vec<DMat4>> {
        let number = |name: &str| copies.attributes.get(name).copied();
        let vectors = |name: &str| number(name).map(|a| self.floats::<3>(a)).transpose();
        let translations = vectors("TRANSLATION")?;
        let scales = vectors("SCALE")?;
        let rotations = number("ROTATION").map(|a| self.floats::<4>(a));
        let rotations = rotations.transpose()?;
        let lengths = [
            translations.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
        ];
        let mut lengths = lengths.into_iter().flatten();
        let count = lengths
            .next()
            .ok_or("it says nothing of where the copies are; export every copy as a node")?;
        if lengths.any(|n| n != count) {
            return Err("its lists are of different lengths; export the mesh again".into());
        }
        let copy = |i: usize| {
            composed(
                translations.as_ref().map(|t| t[i]),
                rotations.as_ref().map(|r| r[i]),
                scales.as_ref().map(|s| s[i]),
            )
        };
        Ok((0..count).map(copy).collect())
    }

    /// A primitive in world coordinates; `None` where it is no surface.
    pub(super) fn part(&self, primitive: &Primitive, world: &DMat4) -> Reading<Option<Part>> {
        let mode = primitive.mode.unwrap_or(4);
        if mode < 4 {
            return Ok(None); // points and lines carry no surface
        }
        let position = primitive.attributes.get("POSITION");
        position.ok_or("no POSITION; export the mesh again")?;
        let source = self.source(primitive)?;
        let positions: Vec<DVec3> = self
            .vectors::<3>(&source, "POSITION")?
            .unwrap_or_default()
            .into_iter()
            .map(|p| world.transform_point3(DVec3::from_array(p)))
            .collect();
        let of_length = |what: &str, n: usize| -> Reading<()> {
            if n == positions.len() {
                Ok(())
            } else {
                Err(format!(
                    "{n} {what} for {} positions; export the mesh again",
                    positions.len()
                ))
            }
        };
        // normals transform with the inverse transpose; its sign carries mirrorings
        let normal_matrix = glam::DMat3::from_mat4(*world).inverse().transpose();
        let normals = match self.vectors::<3>(&source, "NORMAL")? {
            Some(n) if normal_matrix.is_finite() => {
                of_length("normals", n.len())?;
                let turned = |n| (normal_matrix * DVec3::from_array(n)).normalize_or_zero();
                Some(
                    n.into_iter()
                        .map(|n| turned(n).as_vec3())
                        .collect::<Vec<Vec3>>(),
                )
            }
            _ => None,
        };
        // (geometry is usable without)
        let colours = self.colours(&source).ok().flatten();
        let colours = colours.filter(|c| c.len() == positions.len());
        let uvs = self.uvs(&source)?;
        if let Some(uvs) = &uvs {
            of_length("texture coordinates", uvs.len())?;
        }
        let mut triangles = match (&source.draco, primitive.indices) {
            (Some(d), _) => d.triangles(),
            (None, Some(a)) => triangulate(&self.indices(a)?, mode)?,
            (None, None) => {
                let all: Vec<u32> = (0..positions.len() as u32).collect();
                triangulate(&all, mode)?
            }
        };
        if glam::DMat3::from_mat4(*world).determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2)); // a mirroring node turns the winding round
        }
        Ok(Some(Part {
            positions,
            normals,
            uvs,
            triangles,
            names: Vec::new(),
            colours: colours.map(|list| list.into_iter().map(Vec4::truncate).collect()),
            look: None,
        }))
    }

    /// Where a primitive's attributes are read.
    pub(super) fn source<'p>(&self, primitive: &'p Primitive) -> Reading<Source<'p>> {
        let draco = self.draco(primitive)?;
        Ok(Source { primitive, draco })
    }

    /// The primitive unpacked, if Draco packed it.
    fn draco(&self, primitive: &Primitive) -> Reading<Option<Rc<Unpacked>>> {
        let Some(packed) = &primitive.extensions.draco else {
            return Ok(None);
        };
        if let Some(done) = self.draco.borrow().get(&packed.buffer_view) {
            return Ok(Some(Rc::clone(done)));
        }
        let stated = |index: Option<usize>| match index {
            Some(a) => Ok(self.accessor(a)?.count),
            None => Err("a primitive of Draco without indices; export the mesh again".to_owned()),
        };
        let vertices = stated(primitive.attributes.get("POSITION").copied())?;
        let triangles = stated(primitive.indices)? / 3;
        let bytes = self.view_bytes(packed.buffer_view)?;
        let done = Rc::new(Unpacked::new(bytes, vertices, triangles)?);
        let mut known = self.draco.borrow_mut();
        known.insert(packed.buffer_view, Rc::clone(&done));
        Ok(Some(done))
    }

    /// The vectors of an attribute, from Draco or from its accessor; `None` where the primitive has
    /// no such attribute.
    pub(super) fn vectors<const N: usize>(
        &self,
        from: &Source<'_>,
        name: &str,
    ) -> Reading<Option<Vec<[f64; N]>>> {
        let Some(&index) = from.primitive.attributes.get(name) else {
            return Ok(None);
        };
        let extension = from.primitive.extensions.draco.as_ref();
        let packed = extension.and_then(|d| d.attributes.get(name));
        match (&from.draco, packed) {
            (Some(unpacked), Some(&id)) => {
                let a = self.accessor(index)?;
                unpacked.vectors(id, a.component_type, a.normalized)
            }
            _ => self.floats::<N>(index),
        }
        .map(Some)
    }

    /// Texture coordinates where the material's base colour is sampled (`KHR_texture_transform`).
    fn uvs(&self, from: &Source<'_>) -> Reading<Option<Vec<Vec2>>> {
        let material = from.primitive.material;
        let material = material.and_then(|m| self.document.materials.get(m));
        let paint = material.and_then(|m| m.paint().texture);
        let source = paint.map_or_else(UvSource::default, |t| t.uv);
        let named = format!("TEXCOORD_{}", source.set);
        let has = from.primitive.attributes.contains_key(&named);
        let name = if has { named.as_str() } else { "TEXCOORD_0" };
        let read = self.vectors::<2>(from, name)?;
        Ok(read.map(|uv| uv.into_iter().map(|uv| source.sampled_at(uv)).collect()))
    }

    /// Linear colours of the vertices, with alpha; as the file has them, in range or not.
    pub(super) fn colours(&self, from: &Source<'_>) -> Reading<Option<Vec<Vec4>>> {
        let Some(&accessor) = from.primitive.attributes.get("COLOR_0") else {
            return Ok(None);
        };
        let a = self.accessor(accessor)?;
        // whole numbers stand for shares by the standard; some writers forget to say so
        let share = match a.normalized {
            true => 1.0,
            false => normalised(1.0, a.component_type),
        };
        let of = |x: f64| (share * x) as f32;
        let colours = match a.shape.as_str() {
            "VEC4" => (self.vectors::<4>(from, "COLOR_0")?)
                .map(|list| list.into_iter().map(|c| Vec4::from(c.map(of))).collect()),
            _ => (self.vectors::<3>(from, "COLOR_0")?).map(|list| {
                let opaque = |c: [f64; 3]| Vec3::from(c.map(of)).extend(1.0);
                list.into_iter().map(opaque).collect()
            }),
        };
        Ok(colours)
    }

    /// A texture: its picture and how it goes on; of a picture in several formats the one that is
    /// read.
    pub(super) fn texture(&self, index: usize) -> Reading<GltfTexture> {
        let missing = |what: &str| format!("texture {index} {what}; export again");
        let texture = self.document.textures.get(index);
        let texture = texture.ok_or_else(|| missing("does not exist"))?;
        let webp = texture.extensions.webp.as_ref().and_then(|w| w.source);
        let image = texture.source.or(webp);
        let image = image.ok_or_else(|| match texture.extensions.unread() {
            Some(format) => format!(
                "texture {index} is {format} only; PNG, JPEG and WebP are read: convert it \
                 (`gltf-transform png old.glb new.glb`) or export with PNG pictures"
            ),
            None => missing("has no picture"),
        })?;
        let sampler = texture.sampler.and_then(|s| self.document.samplers.get(s));
        Ok(GltfTexture::new(image, sampler))
    }

    /// The colour that a primitive is painted with: its material's, metal or not.
    fn look(&self, primitive: &Primitive) -> Option<Look> {
        let material = self.document.materials.get(primitive.material?)?;
        let paint = material.paint();
        let [r, g, b, _] = paint.factor;
        let texture = paint.texture.map(|t| match self.texture(t.texture) {
            Ok(texture) => TextureSource::Embedded(texture.image),
            Err(why) => TextureSource::Unusable(why),
        });
        Some(Look {
            factor: Vec3::new(r, g, b),
            texture,
        })
    }
}

/// Triangles of an index list: mode 4 = list, 5 = strip, 6 = fan.
fn triangulate(indices: &[u32], mode: u32) -> Reading<Vec<[u32; 3]>> {
    Ok(match mode {
        4 if !indices.len().is_multiple_of(3) => {
            return Err(format!(
                "{} indices are no whole triangles; export the mesh again",
                indices.len()
            ));
        }
        4 => indices
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]])
            .collect(),
        5 => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[1], w[0], w[2]]
                }
            })
            .collect(),
        6 => indices
            .get(1..)
            .unwrap_or_default()
            .windows(2)
            .map(|w| [indices[0], w[0], w[1]])
            .collect(),
        _ => return Err(format!("unknown primitive mode {mode}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::engine::Engine;

    /// A `.gltf` of one triangle below two nodes, with the buffer embedded in base64.
    fn document(count: u64, matrix: &str) -> String {
        let floats: Vec<u8> = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
            .iter()
            .flat_map(|f| f.to_le_bytes())
            .collect();
        let text = base64::prelude::BASE64_STANDARD.encode(&floats);
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1],"translation":[10000,0,0]}},{{"mesh":0{matrix}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{text}"}}]}}"#
        )
    }

    #[test]
    fn node_transforms_compose_and_mirroring_keeps_the_outside_outside() {
        let mesh = mesh_from_gltf(
            document(3, r#","scale":[-2,1,1]"#).as_bytes(),
            Path::new("t.gltf"),
        )
        .expect("readable");
        assert_eq!(
            mesh.positions,
            vec![
                DVec3::new(1e4, 0.0, 0.0),
                DVec3::new(9998.0, 0.0, 0.0),
                DVec3::new(1e4, 1.0, 0.0)
            ]
        );
        let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
        assert!((b - a).cross(c - a).z > 0.0, "the front still faces +z");
        assert!(mesh.uvs.is_empty() && mesh.normals.is_empty());
    }

    #[test]
    fn joints_place_the_mesh_of_a_skin_and_hidden_nodes_are_left_out() {
        let read = |node: &str, skins: &str| {
            let text =
                document(3, node).replace(r#""nodes":[{"c"#, &format!(r#"{skins}"nodes":[{{"c"#));
            mesh_from_gltf(text.as_bytes(), Path::new("t.gltf")).map_err(|e| e.to_string())
        };
        let moved = r#","scale":[9,9,9],"skin":0"#;
        let mesh = read(moved, r#""skins":[{"joints":[0]}],"#).expect("readable");
        assert_eq!(mesh.positions[1], DVec3::new(10_001.0, 0.0, 0.0));
        assert!(read(moved, "").is_err_and(|e| e.contains("skin 0")));
        let flat = read(
            moved,
            r#""skins":[{"joints":[0],"inverseBindMatrices":0}],"#,
        );
        assert!(flat.is_err_and(|e| e.contains("MAT4")));
        let seen = |visible: &str| {
            let said =
                format!(r#","extensions":{{"KHR_node_visibility":{{"visible":{visible}}}}}"#);
            read(&said, "")
        };
        assert!(seen("true").is_ok());
        assert!(seen("false").is_err_and(|e| e.contains("no triangle")));
    }

    #[test]
    fn a_picture_of_a_format_that_is_not_read_is_named() {
        let painted = |texture: &str| {
            let text = document(3, "").replace(r#""attributes""#, r#""material":0,"attributes""#);
            let material =
                r#""materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"#;
            let text = text.replacen('{', &format!(r#"{{{material}"textures":[{texture}],"#), 1);
            let mesh = mesh_from_gltf(text.as_bytes(), Path::new("t.gltf")).expect("geometry");
            mesh.looks[0].texture.clone().expect("a picture")
        };
        let ktx2 = r#"{"extensions":{"KHR_texture_basisu":{"source":0}}}"#;
        for (texture, said) in [(ktx2, "KTX2"), ("", "texture 0 does not exist")] {
            let TextureSource::Unusable(why) = painted(texture) else {
                panic!("{texture} cannot be read");
            };
            assert!(why.contains(said), "{why}");
        }
        let webp = r#"{"extensions":{"EXT_texture_webp":{"source":3}}}"#;
        assert_eq!(painted(webp), TextureSource::Embedded(3));
    }

    /// The triangle's own corners serve as three translations, scales, or vectors that are too short
    /// for rotations.
    #[test]
    fn copies_are_placed_below_their_node_and_faulty_lists_are_errors() {
        let with = |attributes: &str| {
            let copies = format!(
                r#","translation":[0,0,7],"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{{attributes}}}}}}}"#
            );
            mesh_from_gltf(document(3, &copies).as_bytes(), Path::new("t.gltf"))
        };
        let mesh = with(r#""TRANSLATION":0"#).expect("readable");
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (9, 3));
        for (copy, at) in [DVec3::ZERO, DVec3::X, DVec3::Y].into_iter().enumerate() {
            let corner = mesh.positions[3 * copy + 1];
            assert_eq!(corner, DVec3::new(10_001.0, 0.0, 7.0) + at);
        }
        let mesh = with(r#""SCALE":0,"TRANSLATION":0"#).expect("readable");
        assert_eq!(mesh.positions[4], DVec3::new(10_002.0, 0.0, 7.0));
        for (faulty, said) in [
            ("", "where the copies are"),
            (r#""ROTATION":0"#, "VEC4"),
            (r#""TRANSLATION":5"#, "accessor 5 does not exist"),
        ] {
            let e = with(faulty).expect_err(faulty).to_string();
            assert!(
                e.contains("node 1, EXT_mesh_gpu_instancing") && e.contains(said),
                "{e}"
            );
        }
    }

    #[test]
    fn what_is_named_many_times_is_counted_before_it_is_read() {
        // a million vertices in zeros, a thousand nodes: 36 MB that would become 24 GB
        let nodes = vec![r#"{"mesh":0}"#; 1000].join(",");
        let document = format!(
            r#"{{"nodes":[{nodes}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3000000,"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36000000}}],"buffers":[{{"byteLength":36000000}}]}}"#
        );
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        let json = format!("{document}{}", " ".repeat((4 - document.len() % 4) % 4));
        glb.extend((28 + json.len() as u32 + 36_000_000).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json.as_bytes());
        glb.extend(36_000_000u32.to_le_bytes());
        glb.extend(b"BIN\0");
        glb.resize(glb.len() + 36_000_000, 0);
        let e = mesh_from_gltf(&glb, Path::new("t.glb")).expect_err("too much");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("vertices in all"),
            "{e}"
        );
    }

    #[test]
    fn buffers_lie_beside_the_mesh_and_extensions_are_understood() {
        let dir = tempfile::tempdir().expect("temp");
        let (outside, mesh) = (dir.path().join("outside.bin"), dir.path().join("in/m.gltf"));
        std::fs::create_dir(dir.path().join("in")).expect("folder");
        std::fs::write(&outside, [0u8; 36]).expect("buffer");
        let with = |uri: &str, more: &str| {
            let text = format!(
                r#"{{{more}"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
                "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],
                "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36,"uri":"{uri}"}}]}}"#
            );
            mesh_from_gltf(text.as_bytes(), &mesh).map_err(|e| e.to_string())
        };
        let absolute = outside.display().to_string();
        for uri in [
            "../outside.bin",
            "%2e%2e/outside.bin",
            "./../in/../outside.bin",
            &absolute,
        ] {
            assert!(with(uri, "").is_err_and(|e| e.contains("beside")), "{uri}");
        }
        std::fs::write(dir.path().join("in/b.bin"), [0u8; 36]).expect("buffer");
        assert!(with("./b.bin", "").is_ok());
        let required = r#""extensionsRequired":["KHR_materials_unlit"],"#;
        assert!(with("b.bin", required).is_ok());
        let required = r#""extensionsRequired":["KHR_of_tomorrow"],"#;
        assert!(with("b.bin", required).is_err_and(|e| e.contains("KHR_of_tomorrow")));
        std::os::unix::fs::symlink("/dev/zero", dir.path().join("in/z.bin")).expect("link");
        assert!(with("z.bin", "").is_err_and(|e| e.contains("device")));
    }

    #[test]
    fn counts_beyond_the_bytes_and_cycles_are_errors() {
        for count in [4, u64::MAX / 2, u64::MAX] {
            let e = mesh_from_gltf(document(count, "").as_bytes(), Path::new("t.gltf"))
                .expect_err("too many")
                .to_string();
            assert!(
                e.contains("t.gltf") && (e.contains("claims") || e.contains("malformed")),
                "{e}"
            );
        }
        let cyclic = document(3, r#","children":[0]"#);
        assert!(mesh_from_gltf(cyclic.as_bytes(), Path::new("t.gltf")).is_err());
    }

    #[test]
    fn every_truncation_and_byte_flip_of_a_glb_is_survived() {
        let json = document(3, "");
        let json = format!("{json}{}", " ".repeat((4 - json.len() % 4) % 4));
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((20 + json.len() as u32).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json.as_bytes());
        assert!(mesh_from_gltf(&glb, Path::new("t.glb")).is_ok());
        for n in 0..glb.len() {
            assert!(
                mesh_from_gltf(&glb[..n], Path::new("t.glb")).is_err(),
                "truncated to {n}"
            );
            for flip in [0x01, 0x80] {
                let mut damaged = glb.clone();
                damaged[n] ^= flip;
                let _ = mesh_from_gltf(&damaged, Path::new("t.glb"));
            }
        }
    }

    #[test]
    fn strips_and_fans_become_triangles() {
        assert_eq!(
            triangulate(&[0, 1, 2, 3], 5),
            Ok(vec![[0, 1, 2], [2, 1, 3]])
        );
        assert_eq!(
            triangulate(&[0, 1, 2, 3], 6),
            Ok(vec![[0, 1, 2], [0, 2, 3]])
        );
        assert!(triangulate(&[0, 1], 4).is_err());
        assert_eq!(triangulate(&[], 6), Ok(vec![]));
    }
}
