//! A glTF file as a scene: surfaces with their materials, pictures and lights
//! (`KHR_lights_punctual`), and its data as stored, for whoever writes the file again. Called by
//! `bake`, and by `read_texture` for pictures.
//!
//! Geometry is read by `gltf`, with all its checks; here is what lies around it.

use super::gltf::{Placed, Reader, Reading, WITHOUT_TRIANGLES};
use super::gltf_bytes::{load_uri, split};
use super::gltf_material::GltfMaterial;
use super::gltf_numbers::{component, component_size};
use super::gltf_texture::GltfTexture;
use super::picture::{Picture8, decode_rgba8};
use crate::{Error, Result};
use glam::{DMat4, DVec3, Vec3, Vec4};
use serde::Deserialize;
use serde_json::Value;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A file, opened.
pub struct GltfFile<'a> {
    reader: Reader<'a>,
    root: Value,
    path: PathBuf,
}

/// A primitive of a mesh where a node puts it; coordinates of the world.
#[derive(Clone, Debug)]
pub struct Piece {
    /// The node.
    pub node: usize,
    /// Its mesh.
    pub mesh: usize,
    /// Number of the primitive in the mesh.
    pub primitive: usize,
    /// Its material; `None` = the standard's default.
    pub material: Option<usize>,
    /// Vertices.
    pub positions: Vec<DVec3>,
    /// Their normals, if the file has them.
    pub normals: Option<Vec<Vec3>>,
    /// Vertices of each triangle; fronts count counter-clockwise.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates by set, those of the file: v = 0 at row 0.
    pub uvs: BTreeMap<u32, Vec<[f64; 2]>>,
    /// Colours that multiply the base colour, if the file has them; linear.
    pub colours: Option<Vec<Vec4>>,
}

/// A light without extent.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfLight {
    /// What kind of light.
    pub kind: GltfLightKind,
    /// Luminous intensity in cd (lm/sr), or of distant light the illuminance in lux; linear RGB.
    pub intensity: Vec3,
    /// Where it is.
    pub position: DVec3,
    /// Unit axis along which it shines.
    pub direction: DVec3,
}

/// The kinds of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GltfLightKind {
    /// Everywhere alike.
    Point,
    /// A cone: angles to the axis at which the light begins to fall and has ended, radians.
    Spot([f64; 2]),
    /// From one direction everywhere.
    Directional,
}

/// Numbers of vertices as stored.
#[derive(Clone, Debug, PartialEq)]
pub struct RawAttribute {
    /// The name, such as `POSITION`.
    pub name: String,
    /// Bytes of all vertices, without gaps.
    pub bytes: Vec<u8>,
    /// Bytes of one vertex.
    pub size: usize,
    /// glTF's number of the component type.
    pub component_type: u32,
    /// glTF's name of the shape, such as `VEC3`.
    pub shape: String,
    /// Whether integers stand for numbers up to 1.
    pub normalized: bool,
}

#[derive(Deserialize)]
struct LightJson {
    #[serde(rename = "type")]
    kind: String,
    #[serde(default = "white")]
    color: [f32; 3],
    #[serde(default = "one")]
    intensity: f32,
    #[serde(default)]
    spot: SpotJson,
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct SpotJson {
    inner_cone_angle: f64,
    outer_cone_angle: f64,
}

impl Default for SpotJson {
    fn default() -> Self {
        Self {
            inner_cone_angle: 0.0,
            outer_cone_angle: std::f64::consts::FRAC_PI_4,
        }
    }
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn one() -> f32 {
    1.0
}

impl RawAttribute {
    /// The bytes of some vertices, each padded to a multiple of four, as glTF wants them.
    #[must_use]
    pub fn gathered(&self, vertices: &[u32]) -> Vec<u8> {
        let stride = self.stride();
        let mut out = Vec::with_capacity(vertices.len() * stride);
        for &v in vertices {
            let at = v as usize * self.size;
            out.extend_from_slice(&self.bytes[at..at + self.size]);
            out.resize(out.len().next_multiple_of(4), 0);
        }
        out
    }

    /// Bytes from one vertex to the next of [`Self::gathered`].
    #[must_use]
    pub fn stride(&self) -> usize {
        self.size.next_multiple_of(4)
    }

    /// Lowest and highest value of every number over some vertices, as stored.
    #[must_use]
    pub fn bounds(&self, vertices: &[u32]) -> [Vec<f64>; 2] {
        let width = component_size(self.component_type).unwrap_or(self.size);
        let numbers = self.size / width;
        let mut low = vec![f64::INFINITY; numbers];
        let mut high = vec![f64::NEG_INFINITY; numbers];
        for &v in vertices {
            for (k, (low, high)) in low.iter_mut().zip(&mut high).enumerate() {
                let at = v as usize * self.size + k * width;
                let x = component(&self.bytes[at..at + width], self.component_type, false);
                *low = low.min(x);
                *high = high.max(x);
            }
        }
        [low, high]
    }
}

impl<'a> GltfFile<'a> {
    /// Opens a `.glb` or `.gltf` from its bytes; files that it names are looked up beside `path`.
    ///
    /// # Errors
    /// The file is damaged, requires an extension that is not understood, or lacks a buffer.
    pub fn open(bytes: &'a [u8], path: &Path) -> Result<Self> {
        let (json, _) = split(bytes, path)?;
        let reader = Reader::open(bytes, path)?;
        let root = serde_json::from_slice(json)
            .map_err(|e| Error::input(path, format!("the glTF JSON is malformed: {e}")))?;
        Ok(Self {
            reader,
            root,
            path: path.to_path_buf(),
        })
    }
}

impl GltfFile<'_> {
    fn fail(&self, message: String) -> Error {
        Error::input(&self.path, message)
    }

    /// The JSON as it stands in the file.
    #[must_use]
    pub fn root(&self) -> &Value {
        &self.root
    }

    /// The nodes at the top of the default scene; of a file without scenes those that nobody lists as a child.
    #[must_use]
    pub fn top_nodes(&self) -> Vec<usize> {
        self.reader.document.top_nodes()
    }

    /// The bytes of a buffer view, unpacked if they are packed.
    ///
    /// # Errors
    /// There is no such view, or its bytes are missing or damaged.
    pub fn view_bytes(&self, view: usize) -> Result<&[u8]> {
        self.reader.view_bytes(view).map_err(|m| self.fail(m))
    }

    /// All surfaces of the default scene.
    ///
    /// # Errors
    /// Damaged data, or no triangles at all.
    pub fn pieces(&self) -> Result<Vec<Piece>> {
        let placed = self.reader.placed().map_err(|m| self.fail(m))?;
        let mut pieces = Vec::new();
        for at in &placed {
            let Some(mesh) = at.mesh else { continue };
            let of_mesh = self.reader.mesh(mesh).map_err(|m| self.fail(m))?;
            for primitive in 0..of_mesh.primitives.len() {
                let piece = self.piece(at, mesh, primitive);
                let named = |m| self.fail(format!("mesh {mesh}, primitive {primitive}: {m}"));
                pieces.extend(piece.map_err(named)?);
            }
        }
        if pieces.iter().all(|p| p.triangles.is_empty()) {
            return Err(self.fail(WITHOUT_TRIANGLES.into()));
        }
        Ok(pieces)
    }

    fn piece(&self, at: &Placed, mesh: usize, primitive: usize) -> Reading<Option<Piece>> {
        let entry = &self.reader.mesh(mesh)?.primitives[primitive];
        let Some(part) = self.reader.part(entry, &at.world)? else {
            return Ok(None);
        };
        let source = self.reader.source(entry)?;
        let count = part.positions.len();
        let outside = part
            .triangles
            .iter()
            .flatten()
            .find(|&&v| v as usize >= count);
        if let Some(v) = outside {
            return Err(format!(
                "a triangle uses vertex {v} of {count}; export the mesh again"
            ));
        }
        let fits = |what: &str, n: usize| match n == count {
            true => Ok(()),
            false => Err(format!(
                "{n} {what} for {count} positions; export the mesh again"
            )),
        };
        let mut uvs = BTreeMap::new();
        for name in entry.attributes.keys() {
            let set = name.strip_prefix("TEXCOORD_").and_then(|n| n.parse().ok());
            let Some(set) = set else { continue };
            if let Some(uv) = self.reader.vectors::<2>(&source, name)? {
                fits(name, uv.len())?;
                uvs.insert(set, uv);
            }
        }
        let colours = self.reader.colours(&source)?;
        if let Some(colours) = &colours {
            fits("colours", colours.len())?;
        }
        let colour = |c: Vec4| c.clamp(Vec4::ZERO, Vec4::ONE);
        Ok(Some(Piece {
            node: at.node,
            mesh,
            primitive,
            material: entry.material,
            positions: part.positions,
            normals: part.normals,
            triangles: part.triangles,
            uvs,
            colours: colours.map(|list| list.into_iter().map(colour).collect()),
        }))
    }

    /// The materials in the file's order; notes say what of them is not read.
    ///
    /// # Errors
    /// A material that has values out of range.
    pub fn materials(&self, notes: &mut BTreeSet<String>) -> Result<Vec<GltfMaterial>> {
        let mut found = Vec::new();
        for (i, material) in self.reader.document.materials.iter().enumerate() {
            if let Some(fault) = material.fault() {
                return Err(self.fail(format!(
                    "material {i}: {fault} is out of range; correct the material and export again"
                )));
            }
            if material.is_specular_glossiness() {
                notes.insert(
                    "KHR_materials_pbrSpecularGlossiness is not read: its materials count as the file's fallback; \
                     convert them to metal and roughness"
                        .into(),
                );
            }
            for name in material.unread() {
                notes.insert(format!(
                    "{name} is not read: its materials reflect as they would without it"
                ));
            }
            found.push(GltfMaterial::from(material));
        }
        Ok(found)
    }

    /// A texture by its number: its picture, or the fallback where that is of a format not read.
    ///
    /// # Errors
    /// The texture does not exist or has no picture of a format that is read.
    pub fn texture(&self, index: usize) -> Result<GltfTexture> {
        self.reader.texture(index).map_err(|m| self.fail(m))
    }

    /// The bytes of a picture file.
    ///
    /// # Errors
    /// There is no such picture, or it cannot be read.
    pub fn image_bytes(&self, index: usize) -> Result<Cow<'_, [u8]>> {
        let what = format!("image {index}");
        let image = self.reader.document.images.get(index);
        let image =
            image.ok_or_else(|| self.fail(format!("{what} does not exist; export again")))?;
        if let Some(uri) = &image.uri {
            return load_uri(&what, uri, &self.path).map(Cow::Owned);
        }
        let view = image.buffer_view;
        let view = view
            .ok_or_else(|| self.fail(format!("{what} has neither a uri nor data; export again")))?;
        let bytes = self.reader.view_bytes(view);
        let bytes = bytes.map_err(|m| self.fail(format!("{what}: {m}")))?;
        Ok(Cow::Borrowed(bytes))
    }

    /// A picture, decoded.
    ///
    /// # Errors
    /// It cannot be read, is damaged, or of a format that is not known.
    pub fn picture(&self, index: usize) -> Result<Picture8> {
        let bytes = self.image_bytes(index)?;
        decode_rgba8(&bytes).map_err(|m| self.fail(format!("image {index}: {m}")))
    }

    /// The lights of the default scene.
    ///
    /// # Errors
    /// A light that is malformed.
    pub fn lights(&self) -> Result<Vec<GltfLight>> {
        const KEY: &str = "KHR_lights_punctual";
        let list = self.root["extensions"][KEY]["lights"].as_array();
        let placed = self.reader.placed().map_err(|m| self.fail(m))?;
        let mut lights = Vec::new();
        for at in placed {
            let light = &self.root["nodes"][at.node]["extensions"][KEY]["light"];
            let Some(index) = light.as_u64() else {
                continue;
            };
            let found = list.and_then(|l| l.get(index as usize)).ok_or_else(|| {
                let (node, again) = (at.node, "export again");
                self.fail(format!(
                    "node {node} has light {index}, which does not exist; {again}"
                ))
            })?;
            let light = LightJson::deserialize(found).map_err(|e| e.to_string());
            let light = light.and_then(|l| placed_light(&l, &at.world));
            lights.push(light.map_err(|m| self.fail(format!("light {index}: {m}")))?);
        }
        Ok(lights)
    }

    /// The numbers that a primitive's vertices have, as stored; floats where Draco packed them.
    ///
    /// # Errors
    /// An attribute that is damaged or of an unknown kind.
    pub fn attributes(&self, mesh: usize, primitive: usize) -> Result<Vec<RawAttribute>> {
        let read = || -> Reading<Vec<RawAttribute>> {
            let entry = &self.reader.mesh(mesh)?.primitives[primitive];
            let list = entry.attributes.iter();
            list.map(|(name, &a)| self.attribute(mesh, primitive, name, a))
                .collect()
        };
        read().map_err(|m| self.fail(format!("mesh {mesh}, primitive {primitive}: {m}")))
    }

    fn attribute(
        &self,
        mesh: usize,
        primitive: usize,
        name: &str,
        accessor: usize,
    ) -> Reading<RawAttribute> {
        let a = self.reader.accessor(accessor)?;
        let numbers = match a.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => return Err(format!("{name} is {other}; export again")),
        };
        let raw =
            |bytes: Vec<u8>, size: usize, component_type: u32, normalized: bool| RawAttribute {
                name: name.to_owned(),
                bytes,
                size,
                component_type,
                shape: a.shape.clone(),
                normalized,
            };
        let source = self
            .reader
            .source(&self.reader.mesh(mesh)?.primitives[primitive])?;
        if source.is_packed(name) {
            let floats = match numbers {
                2 => flat(self.reader.vectors::<2>(&source, name)?),
                3 => flat(self.reader.vectors::<3>(&source, name)?),
                4 => flat(self.reader.vectors::<4>(&source, name)?),
                _ => {
                    return Err(format!(
                        "{name}: numbers packed by Draco; export without it"
                    ));
                }
            };
            const FLOAT: u32 = 5126;
            return Ok(raw(floats, 4 * numbers, FLOAT, false));
        }
        let size = component_size(a.component_type).ok_or("unknown component type")? * numbers;
        let found = self.reader.elements(accessor, size as u64)?;
        let mut out = Vec::with_capacity(found.count * size);
        (0..found.count).for_each(|i| out.extend_from_slice(found.element(i, size)));
        Ok(raw(out, size, a.component_type, a.normalized))
    }
}

/// Vectors as the bytes of floats.
fn flat<const N: usize>(vectors: Option<Vec<[f64; N]>>) -> Vec<u8> {
    let numbers = vectors.into_iter().flatten().flatten();
    numbers.flat_map(|x| (x as f32).to_le_bytes()).collect()
}

fn placed_light(light: &LightJson, world: &DMat4) -> Reading<GltfLight> {
    let kind = match light.kind.as_str() {
        "point" => GltfLightKind::Point,
        "directional" => GltfLightKind::Directional,
        "spot" => {
            let (inner, outer) = (light.spot.inner_cone_angle, light.spot.outer_cone_angle);
            let right = std::f64::consts::FRAC_PI_2 + 1e-6;
            if !(inner >= 0.0 && inner <= outer && outer > 0.0 && outer <= right) {
                return Err(format!(
                    "its cone goes from {inner} to {outer}; expected 0 ≤ inner ≤ outer ≤ π/2"
                ));
            }
            GltfLightKind::Spot([inner, outer])
        }
        other => {
            return Err(format!(
                "{other:?} is no kind of light; expected point, spot or directional"
            ));
        }
    };
    let intensity = Vec3::from_array(light.color) * light.intensity;
    if !(intensity.is_finite() && intensity.min_element() >= 0.0) {
        return Err(format!(
            "its intensity is {intensity}; light is not negative"
        ));
    }
    let direction = world
        .transform_vector3(DVec3::NEG_Z)
        .normalize_or(DVec3::NEG_Z);
    Ok(GltfLight {
        kind,
        intensity,
        position: world.transform_point3(DVec3::ZERO),
        direction,
    })
}
