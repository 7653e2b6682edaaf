//! A mesh as a file holds it: not yet validated, in the file's own coordinates and precision.

use super::surface_look::Look;
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::path::Path;

/// Triangles as read from a file. Indices may be out of range and positions non-finite: `scene`
/// decides what is usable.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawMesh {
    /// Vertex positions in file coordinates; f64 because scenes far from their origin would lose
    /// millimetres in f32.
    pub positions: Vec<DVec3>,
    /// Vertex normals; empty where the file has none for at least one part, else as long as
    /// `positions`.
    pub normals: Vec<Vec3>,
    /// Texture coordinates with v = 0 at texture row 0; empty where at least one part has none,
    /// because half an atlas is no atlas, else as long as `positions`.
    pub uvs: Vec<Vec2>,
    /// Vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
    /// What the file calls its triangles, one entry per kind of name that it has.
    pub names: Vec<SurfaceNames>,
    /// Linear RGB per vertex; empty where the file has none, else as long as `positions`.
    pub colours: Vec<Vec3>,
    /// The materials that triangles have, as far as their colour goes.
    pub looks: Vec<Look>,
    /// Index into `looks` per triangle, [`SurfaceNames::NONE`] without a material; empty where no
    /// triangle has one.
    pub look_of_triangle: Vec<u32>,
    /// What of the file is out of the ordinary.
    pub oddities: Box<Oddities>,
}

/// What of a file's mesh is out of the ordinary; nothing, as a rule.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Oddities {
    /// Where only some parts have texture coordinates: theirs, which say where pictures lie; as long
    /// as the positions, NaN at the vertices of the parts that have none. Else empty.
    pub partial_uvs: Vec<Vec2>,
    /// The parts without texture coordinates where others have some, as people know them.
    pub without_uvs: Vec<String>,
    /// What had to be guessed of colours, for people.
    pub look_notes: Vec<String>,
}

/// What a file's names of triangles are names of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NameKind {
    /// Materials (glTF, OBJ's `usemtl`).
    Material,
    /// Nodes or groups (glTF, OBJ's `o` and `g`), or numbered objects (PLY).
    Object,
    /// Numbered classes (PLY).
    Class,
}

/// What a file calls its triangles in one respect. Numbers are names too: those of their digits.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceNames {
    /// What they are names of.
    pub kind: NameKind,
    /// Each name once, in the order of the triangles that have it first.
    pub names: Vec<String>,
    /// Index into `names` per triangle; [`SurfaceNames::NONE`] without a name.
    pub of_triangle: Vec<u32>,
}

impl SurfaceNames {
    /// The index of triangles without a name.
    pub const NONE: u32 = u32::MAX;

    /// The names of all triangles in order; `None` if there is none.
    pub(super) fn of<S: Into<String>>(
        kind: NameKind,
        names: impl Iterator<Item = Option<S>>,
    ) -> Option<Self> {
        let mut index: HashMap<String, u32> = HashMap::new();
        let mut list: Vec<String> = Vec::new();
        let of_triangle = names
            .map(|name| {
                let Some(name) = name.map(Into::into) else {
                    return Self::NONE;
                };
                let next = list.len() as u32;
                *index.entry(name).or_insert_with_key(|name| {
                    list.push(name.clone());
                    next
                })
            })
            .collect();
        (!list.is_empty()).then_some(Self {
            kind,
            names: list,
            of_triangle,
        })
    }
}

/// One piece of a file's geometry on its way into a [`RawMesh`].
#[derive(Default)]
pub(super) struct Part {
    pub positions: Vec<DVec3>,
    pub normals: Option<Vec<Vec3>>,
    pub uvs: Option<Vec<Vec2>>,
    pub triangles: Vec<[u32; 3]>,
    /// Names of all its triangles, by kind.
    pub names: Vec<(NameKind, String)>,
    /// Linear RGB per vertex.
    pub colours: Option<Vec<Vec3>>,
    /// What its triangles are painted with.
    pub look: Option<Look>,
}

impl RawMesh {
    /// Joins parts; an attribute one part lacks is dropped from the whole, but texture coordinates are
    /// kept apart: they say where the other parts' pictures lie.
    pub(super) fn from_parts(parts: Vec<Part>, path: &Path) -> Result<Self> {
        let total: usize = parts.iter().map(|p| p.positions.len()).sum();
        if u32::try_from(total).is_err() {
            return Err(Error::input(
                path,
                format!(
                    "{total} vertices; at most {} are supported. Simplify the mesh",
                    u32::MAX
                ),
            ));
        }
        let with_normals = parts.iter().all(|p| p.normals.is_some());
        let some_uvs = parts.iter().any(|p| p.uvs.is_some());
        let mut mesh = Self {
            names: names_of(&parts),
            ..Self::default()
        };
        if some_uvs {
            mesh.oddities.without_uvs = parts_without_uvs(&parts);
        }
        mesh.take_looks(&parts);
        let coloured = parts.iter().any(|p| p.colours.is_some());
        for part in parts {
            let first = mesh.positions.len() as u64;
            let count = part.positions.len();
            for t in part.triangles {
                if let Some(bad) = t.iter().find(|&&i| i as usize >= count) {
                    return Err(Error::input(
                        path,
                        format!(
                            "a triangle uses vertex {bad}, but its part has {count} vertices; export the mesh again"
                        ),
                    ));
                }
                mesh.triangles
                    .push(t.map(|i| (first + u64::from(i)) as u32));
            }
            mesh.positions.extend(part.positions);
            if coloured {
                let white = || vec![Vec3::ONE; count];
                mesh.colours.extend(part.colours.unwrap_or_else(white));
            }
            if with_normals {
                mesh.normals.extend(part.normals.unwrap_or_default());
            }
            if some_uvs {
                let none = || vec![Vec2::NAN; count];
                mesh.uvs.extend(part.uvs.unwrap_or_else(none));
            }
        }
        if !mesh.oddities.without_uvs.is_empty() {
            mesh.oddities.partial_uvs = std::mem::take(&mut mesh.uvs);
        }
        Ok(mesh)
    }

    /// Where pictures lie: texture coordinates, NaN at vertices of parts that have none; empty where no
    /// part has any.
    #[must_use]
    pub fn picture_uvs(&self) -> &[Vec2] {
        match self.oddities.without_uvs.is_empty() {
            true => &self.uvs,
            false => &self.oddities.partial_uvs,
        }
    }

    /// The parts' materials, equal ones once.
    fn take_looks(&mut self, parts: &[Part]) {
        if parts.iter().all(|p| p.look.is_none()) {
            return;
        }
        for part in parts {
            let index = part.look.as_ref().map_or(SurfaceNames::NONE, |look| {
                let known = self.looks.iter().position(|l| l == look);
                known.unwrap_or_else(|| {
                    self.looks.push(look.clone());
                    self.looks.len() - 1
                }) as u32
            });
            let each = std::iter::repeat_n(index, part.triangles.len());
            self.look_of_triangle.extend(each);
        }
    }
}

/// What people call the parts with triangles and no texture coordinates: by object and material,
/// else by number.
fn parts_without_uvs(parts: &[Part]) -> Vec<String> {
    let called = |(number, part): (usize, &Part)| {
        let name = |kind: NameKind| {
            let found = part.names.iter().find(|n| n.0 == kind);
            found.map(|n| format!("\"{}\"", n.1))
        };
        match (name(NameKind::Object), name(NameKind::Material)) {
            (Some(object), Some(material)) => format!("{object} (material {material})"),
            (Some(object), None) => object,
            (None, Some(material)) => format!("material {material}"),
            (None, None) => format!("number {}", number + 1),
        }
    };
    let lacking = |p: &(usize, &Part)| p.1.uvs.is_none() && !p.1.triangles.is_empty();
    let all = parts.iter().enumerate();
    all.filter(lacking).map(called).collect()
}

/// The names of the parts' triangles; parts that share a name share its index.
fn names_of(parts: &[Part]) -> Vec<SurfaceNames> {
    let of = |kind: NameKind| {
        let name = |p: &Part| {
            let found = p.names.iter().find(|n| n.0 == kind);
            found.map(|n| n.1.clone())
        };
        let each = parts
            .iter()
            .flat_map(|p| std::iter::repeat_n(name(p), p.triangles.len()));
        SurfaceNames::of(kind, each)
    };
    let kinds = [NameKind::Class, NameKind::Material, NameKind::Object];
    kinds.into_iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_without_texture_coordinates_leaves_the_others_theirs() {
        let part = |object: &str, uvs: Option<Vec<Vec2>>| Part {
            positions: vec![DVec3::ZERO; 3],
            triangles: vec![[0, 1, 2]],
            names: vec![(NameKind::Object, object.to_owned())],
            uvs,
            ..Part::default()
        };
        let read = |parts| RawMesh::from_parts(parts, Path::new("m.glb")).expect("joins");
        let atlas = vec![Vec2::splat(0.5); 3];
        let mesh = read(vec![part("lamp", None), part("room", Some(atlas.clone()))]);
        assert_eq!(mesh.oddities.without_uvs, ["\"lamp\""]);
        assert!(mesh.uvs.is_empty() && mesh.oddities.partial_uvs[..3].iter().all(|t| t.is_nan()));
        assert_eq!(mesh.oddities.partial_uvs[3..], atlas);
        let mesh = read(vec![part("lamp", None), part("room", None)]);
        assert!(mesh.oddities.without_uvs.is_empty() && mesh.oddities.partial_uvs.is_empty());
    }
}
