//! The geometry of `scene.glb`: each part's mesh with its vertices' attributes, divided by material.

use super::glb_lights::LuminousPart;
use super::{DetailLevel, MeshPart};
use crate::core::formats::GlbWriter;
use crate::core::geometry::{Mesh, tangent_mesh};
use glam::Vec3;
use serde_json::{Value, json};
use std::borrow::Cow;

/// Which triangles let light through, and the number of their material.
pub(super) struct Panes {
    pub triangles: Vec<bool>,
    pub material: usize,
}

/// Triangles of one material.
struct Primitive {
    /// Numbers of triangles of the mesh they are stored with.
    triangles: Vec<u32>,
    material: usize,
    /// Of panes: where their triangles stand among the part's, as first and count.
    runs: Vec<[u32; 2]>,
}

impl Primitive {
    fn of(material: usize, triangles: impl Iterator<Item = u32>) -> Self {
        Self {
            triangles: triangles.collect(),
            material,
            runs: Vec::new(),
        }
    }
}

/// The triangles of a part as primitives: panes apart from the rest.
fn divided(part: &MeshPart, material: usize, panes: Option<&Panes>) -> Vec<Primitive> {
    let count = part.triangles.len() as u32;
    let Some(panes) = panes else {
        return vec![Primitive::of(material, 0..count)];
    };
    let (mut rest, mut glass) = (
        Primitive::of(material, 0..0),
        Primitive::of(panes.material, 0..0),
    );
    for (i, &number) in (0..count).zip(&part.triangles) {
        if !panes.triangles[number as usize] {
            rest.triangles.push(i);
            continue;
        }
        glass.triangles.push(i);
        match glass
            .runs
            .last_mut()
            .filter(|[first, count]| first + count == i)
        {
            Some([_, count]) => *count += 1,
            None => glass.runs.push([i, 1]),
        }
    }
    let mut out = vec![rest, glass];
    out.retain(|p| !p.triangles.is_empty());
    out
}

/// What all parts have in common.
pub(super) struct PartGeometry<'a> {
    /// The mesh that they are parts of.
    pub whole: &'a Mesh,
    /// Number of the material of what is no pane.
    pub material: usize,
    pub panes: Option<Panes>,
    /// A second texture set, equal to the first, for the lightmap.
    pub lightmap: bool,
    pub tangents: bool,
}

impl PartGeometry<'_> {
    /// The geometry of a part; one that is all there is keeps its vertices' order, unused ones included.
    pub fn of_part(&self, part: &MeshPart) -> Cow<'_, Mesh> {
        let all = part.pivot == Vec3::ZERO && part.triangles.len() == self.whole.triangles.len();
        match all {
            true => Cow::Borrowed(self.whole),
            false => Cow::Owned(part.mesh(self.whole)),
        }
    }

    /// Stores the geometry `mesh` of a part; returns its mesh, of one primitive or, with panes, two.
    pub fn mesh_entry(&self, glb: &mut GlbWriter, part: &MeshPart, mesh: &Mesh) -> Value {
        let primitives = divided(part, self.material, self.panes.as_ref());
        json!({"name": part.name, "primitives": self.stored(glb, mesh, &primitives)})
    }

    /// The mesh of a part that is a copy of another, whose entry is `original`: it has the other's vertices and
    /// triangles, but its own places in the atlas, and so its own texture and light. `None` where panes
    /// divide it otherwise.
    pub fn copy_entry(
        &self,
        glb: &mut GlbWriter,
        part: &MeshPart,
        mesh: &Mesh,
        original: &Value,
    ) -> Option<Value> {
        let primitives = divided(part, self.material, self.panes.as_ref());
        let stored = original["primitives"].as_array()?;
        let alike = primitives.len() == 1 && stored.len() == 1;
        let is_pane = |material: &Value| {
            let panes = self.panes.as_ref().map(|p| json!(p.material));
            panes.as_ref() == Some(material)
        };
        let material = json!(primitives.first()?.material);
        if !alike || is_pane(&material) || is_pane(&stored[0]["material"]) {
            return None;
        }
        let mut primitive = stored[0].clone();
        let uv = glb.uvs(&mesh.uvs);
        primitive["material"] = material;
        primitive["attributes"]["TEXCOORD_0"] = json!(uv);
        if self.lightmap {
            primitive["attributes"]["TEXCOORD_1"] = json!(uv);
        }
        Some(json!({"name": part.name, "primitives": [primitive]}))
    }

    /// Stores the geometry of a level of detail; returns its mesh.
    pub fn level_entry(&self, glb: &mut GlbWriter, name: &str, level: &DetailLevel) -> Value {
        let count = level.mesh.triangles.len() as u32;
        let panes = count - level.panes as u32;
        let glass = self.panes.as_ref().map_or(0, |p| p.material);
        let mut primitives = vec![
            Primitive::of(self.material, 0..panes),
            Primitive::of(glass, panes..count),
        ];
        primitives.retain(|p| !p.triangles.is_empty());
        json!({"name": name, "primitives": self.stored(glb, &level.mesh, &primitives)})
    }

    /// Stores a mesh; returns its primitives.
    fn stored(&self, glb: &mut GlbWriter, mesh: &Mesh, primitives: &[Primitive]) -> Vec<Value> {
        let tangents = self
            .tangents
            .then(|| tangent_mesh(&with_valid_normals(mesh)));
        let mesh = tangents.as_ref().map_or(mesh, |t| &t.mesh);
        let indices: Vec<u32> = primitives
            .iter()
            .map(|p| {
                let corners = p.triangles.iter().map(|&t| mesh.triangles[t as usize]);
                glb.triangles(&corners.collect::<Vec<_>>())
            })
            .collect();
        let mut attributes = attributes(glb, mesh);
        if let Some(t) = &tangents {
            attributes["TANGENT"] = json!(glb.tangents(&t.tangents));
        }
        if self.lightmap {
            attributes["TEXCOORD_1"] = attributes["TEXCOORD_0"].clone();
        }
        let entries = primitives.iter().zip(indices);
        let entry = |(p, indices): (&Primitive, u32)| {
            let mut entry =
                json!({"attributes": attributes, "indices": indices, "material": p.material});
            if !p.runs.is_empty() {
                entry["extras"] = json!({"runs": p.runs});
            }
            entry
        };
        entries.map(entry).collect()
    }
}

/// Stores what a mesh says of its vertices; returns the accessors.
fn attributes(glb: &mut GlbWriter, mesh: &Mesh) -> Value {
    let position = glb.positions(&mesh.positions, mesh.bounds());
    let normal = glb.vectors(&valid_normals(mesh));
    let uv = glb.uvs(&mesh.uvs);
    json!({"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv})
}

/// Stores the geometry of a surface that only shines; returns its mesh.
pub(super) fn luminous_entry(glb: &mut GlbWriter, part: &LuminousPart, material: usize) -> Value {
    let mesh = &part.mesh;
    let indices = glb.triangles(&mesh.triangles);
    let position = glb.positions(&mesh.positions, mesh.bounds());
    let normal = glb.vectors(&valid_normals(mesh));
    json!({"name": part.name, "primitives": [
        {"attributes": {"POSITION": position, "NORMAL": normal}, "indices": indices, "material": material},
    ]})
}

/// glTF demands unit normals; anything else (a vertex without area) points up.
fn valid_normals(mesh: &Mesh) -> Vec<Vec3> {
    let valid = |n: &Vec3| match (n.length_squared() - 1.0).abs() < 1e-3 {
        true => *n,
        false => n.normalize_or(Vec3::Y),
    };
    mesh.normals.iter().map(valid).collect()
}

fn with_valid_normals(mesh: &Mesh) -> Mesh {
    Mesh {
        normals: valid_normals(mesh),
        ..mesh.clone()
    }
}

#[cfg(test)]
mod tests {
    use crate::solution::tests::small_solution;
    use crate::solution::{GlbOptions, scene_glb};
    use glam::{Vec3, Vec4};

    #[test]
    fn tangents_are_there_where_they_are_wanted() {
        let solution = small_solution();
        let mut options = GlbOptions::default();
        let written = |options: &GlbOptions| -> Option<Vec<Vec4>> {
            let bytes = scene_glb(&solution, options).expect("writes");
            let gltf = gltf::Gltf::from_slice(&bytes).expect("valid");
            let mesh = gltf.meshes().next().expect("a mesh");
            let primitive = mesh.primitives().next().expect("a primitive");
            let reader = primitive.reader(|_| gltf.blob.as_deref());
            let tangents = reader.read_tangents()?;
            Some(tangents.map(Vec4::from_array).collect())
        };
        assert_eq!(written(&options), None);
        options.tangents = true;
        // u grows along x, and v along z: up in the texture is −z, as is normal × tangent
        let expected = vec![Vec3::X.extend(1.0); 4];
        assert_eq!(written(&options), Some(expected));
    }
}
