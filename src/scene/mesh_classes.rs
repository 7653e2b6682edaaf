//! Classes that the mesh itself names: by its materials, its objects or numbered labels, where no
//! photograph has labels.
//!
//! Names count where they tell surfaces apart: at least two that say something ([`tells`]), on most
//! of the surface. `Material.001`, `textured_output` or the name of an atlas say nothing. Materials
//! keep their names whole, for copies ("paint.001") are adapted copies as a rule; objects lose their
//! numbers ("Chair 2" is a chair). Called by `load`.

use super::words::{is_lamp, words};
use super::{Class, PreparedMesh};
use crate::core::formats::{NameKind, RawMesh, SurfaceNames};
use crate::core::image::Plane;
use crate::core::switch::Switch;
use crate::error::printable;
use std::collections::{BTreeMap, BTreeSet};

/// The mesh's own classes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshClasses {
    /// Class id per triangle, 0 = none.
    pub of_triangle: Vec<u16>,
    /// What they are named after.
    pub kind: NameKind,
}

/// Classes that an account of the mesh's own names.
const NAMED: usize = 6;

impl MeshClasses {
    /// What people call what the classes are named after.
    #[must_use]
    pub fn source(&self) -> &'static str {
        match self.kind {
            NameKind::Material => "materials",
            NameKind::Object => "objects",
            NameKind::Class => "numbered classes",
        }
    }

    /// How many classes the mesh has, and the first of their names.
    pub(super) fn account(&self, classes: &[Class]) -> String {
        let used: BTreeSet<u16> = self.of_triangle.iter().copied().collect();
        let used: Vec<&str> = (classes.iter().filter(|c| used.contains(&c.id)))
            .map(|c| c.name.as_str())
            .collect();
        let more = if used.len() > NAMED { ", …" } else { "" };
        let first = used[..used.len().min(NAMED)].join(", ");
        format!(
            "{} as {} classes ({first}{more})",
            self.source(),
            used.len()
        )
    }

    /// Class ids of what rays met; 0 where they met no triangle.
    #[must_use]
    pub fn of_hits(&self, triangle: &Plane<u32>) -> Plane<u16> {
        triangle.map(|t| self.of_triangle.get(*t as usize).copied().unwrap_or(0))
    }
}

/// Triangles and what their file calls them.
pub(super) struct Named<'a> {
    names: &'a [SurfaceNames],
    /// The file's triangle of each, and its area.
    triangles: Vec<(u32, f64)>,
}

impl<'a> Named<'a> {
    /// The triangles of a prepared mesh, by the names of its file.
    pub(super) fn prepared(mesh: &PreparedMesh, names: &'a [SurfaceNames]) -> Self {
        let area = |t: usize| f64::from(mesh.mesh.area(t));
        let triangles = mesh.file_triangle.iter().enumerate();
        Self {
            names,
            triangles: triangles.map(|(t, file)| (*file, area(t))).collect(),
        }
    }

    /// The triangles of a file as they are.
    fn file(raw: &'a RawMesh) -> Self {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| raw.positions.get(i as usize).copied().unwrap_or_default());
            0.5 * (b - a).cross(c - a).length()
        };
        Self {
            names: &raw.names,
            triangles: (0..).zip(raw.triangles.iter().map(area)).collect(),
        }
    }
}

/// What a mesh's names give.
#[derive(Clone, Debug)]
pub struct ClassesByName {
    /// The class of every triangle.
    pub mesh: MeshClasses,
    /// All classes, the declared ones among them, by ascending id.
    pub classes: Vec<Class>,
}

impl ClassesByName {
    /// Those of a file's mesh in a scene without labels that declares no classes; `None` where its
    /// names say nothing.
    #[must_use]
    pub fn of(raw: &RawMesh) -> Option<Self> {
        mesh_classes(&Named::file(raw), None, Switch::Auto)
    }

    /// How many classes there are, and the first of their names.
    #[must_use]
    pub fn account(&self) -> String {
        self.mesh.account(&self.classes)
    }
}

/// The classes of a mesh by the first kind of names that tells surfaces apart. `declared` are those
/// of `transforms.json`: a name or number that is among them is that class.
pub(super) fn mesh_classes(
    mesh: &Named<'_>,
    declared: Option<&[Class]>,
    switch: Switch,
) -> Option<ClassesByName> {
    if switch == Switch::Off {
        return None;
    }
    let any = switch == Switch::On;
    let chosen = (mesh.names.iter()).find(|n| any || parts_surfaces(mesh, n, declared))?;
    let mut classes = declared.unwrap_or_default().to_vec();
    let mut ids: BTreeMap<String, u16> = BTreeMap::new();
    let mut of_name = Vec::with_capacity(chosen.names.len());
    for name in &chosen.names {
        let shown = shown(name, chosen.kind);
        let id = match ids.get(&shown) {
            Some(id) => *id,
            None => class_of(&shown, chosen.kind, &mut classes)?,
        };
        ids.insert(shown, id);
        of_name.push(id);
    }
    classes.sort_by_key(|c| c.id);
    let of = |(t, _): &(u32, f64)| {
        let name = chosen.of_triangle.get(*t as usize);
        let id = name.and_then(|n| of_name.get(*n as usize));
        id.copied().unwrap_or(0)
    };
    Some(ClassesByName {
        mesh: MeshClasses {
            of_triangle: mesh.triangles.iter().map(of).collect(),
            kind: chosen.kind,
        },
        classes,
    })
}

/// The id of a name: the declared class of this name or number, or a new one; `None` if there are no
/// ids left.
fn class_of(name: &str, kind: NameKind, classes: &mut Vec<Class>) -> Option<u16> {
    let number = name.parse::<u16>().ok().filter(|n| *n > 0);
    let known = classes.iter().find(|c| {
        (kind == NameKind::Class && number == Some(c.id)) || c.name.eq_ignore_ascii_case(name)
    });
    if let Some(class) = known {
        return Some(class.id);
    }
    let free = |id: &u16| classes.iter().all(|c| c.id != *id);
    let highest = classes.iter().map(|c| c.id).max().unwrap_or(0);
    let id = (number.filter(|n| kind == NameKind::Class && free(n))).or(highest.checked_add(1))?;
    let name = match number {
        Some(_) if kind == NameKind::Class => format!("class {name}"),
        Some(_) => format!("object {name}"),
        None => name.to_owned(),
    };
    let is_light = is_lamp(&name);
    classes.push(Class { id, name, is_light });
    Some(id)
}

/// Whether at least two names say something, and most of the surface has such a name.
fn parts_surfaces(mesh: &Named<'_>, names: &SurfaceNames, declared: Option<&[Class]>) -> bool {
    let is_declared = |n: &str| {
        let mut classes = declared.into_iter().flatten();
        classes.any(|c| c.name.eq_ignore_ascii_case(n))
    };
    // numbers of classes and objects are given on purpose
    let numbered = |n: &str| names.kind != NameKind::Material && n.parse::<u32>().is_ok();
    let telling: Vec<bool> = (names.names.iter())
        .map(|n| tells(n) || is_declared(n) || numbered(n))
        .collect();
    let (mut told, mut all) = (0.0f64, 0.0f64);
    let mut used = BTreeSet::new();
    for (t, area) in &mesh.triangles {
        all += area;
        let name = names.of_triangle.get(*t as usize);
        let Some(name) = name
            .map(|n| *n as usize)
            .filter(|n| telling.get(*n) == Some(&true))
        else {
            continue;
        };
        told += area;
        used.insert(shown(&names.names[name], names.kind));
    }
    used.len() >= 2 && 2.0 * told > all
}

/// A name for people: fit to print, and an object's without its number.
fn shown(name: &str, kind: NameKind) -> String {
    let name = printable(name.trim()).into_owned();
    if kind != NameKind::Object {
        return name;
    }
    let tail = |c: char| c.is_ascii_digit() || "._- #()".contains(c);
    let stem = name.trim_end_matches(tail);
    if stem.is_empty() {
        name
    } else {
        stem.to_owned()
    }
}

/// Words of names that programs give by themselves.
const GENERIC: [&str; 46] = [
    "material",
    "materials",
    "mat",
    "default",
    "none",
    "null",
    "mesh",
    "object",
    "obj",
    "node",
    "group",
    "geometry",
    "geo",
    "primitive",
    "shape",
    "atlas",
    "texture",
    "textures",
    "textured",
    "tex",
    "output",
    "baked",
    "bake",
    "lambert",
    "phong",
    "blinn",
    "standard",
    "initial",
    "shading",
    "initialshadinggroup",
    "shadinggroup",
    "untitled",
    "unnamed",
    "scene",
    "root",
    "model",
    "surface",
    "polygon",
    "polysurface",
    "scan",
    "image",
    "diffuse",
    "map",
    "page",
    "solid",
    "new",
];

/// Whether a name says what a surface is: it has a word of at least three letters that no program
/// writes by itself, and is neither a file's name nor a hexadecimal key.
fn tells(name: &str) -> bool {
    let lower = name.trim().to_lowercase();
    let file = [".png", ".jpg", ".jpeg", ".tif", ".tga", ".exr", ".bmp"];
    let plain: String = lower.chars().filter(|c| c.is_alphanumeric()).collect();
    let hexadecimal = plain.len() >= 8
        && plain.chars().all(|c| c.is_ascii_hexdigit())
        && plain.chars().any(|c| c.is_ascii_digit());
    if hexadecimal || file.iter().any(|e| lower.contains(e)) {
        return false;
    }
    words(name)
        .iter()
        .any(|w| w.chars().count() >= 3 && !GENERIC.contains(&w.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::RawMesh;
    use crate::scene::{LoadOptions, prepare_mesh};
    use glam::DVec3;
    use std::path::Path;

    /// Squares side by side, one per name, two triangles each, and one triangle without area.
    fn prepared(kind: NameKind, names: &[&str]) -> (PreparedMesh, Vec<SurfaceNames>) {
        let mut raw = RawMesh::default();
        let mut of_triangle = vec![0];
        raw.triangles.push([0, 0, 0]);
        for k in 0..names.len() {
            let first = raw.positions.len() as u32;
            for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                raw.positions.push(DVec3::new(x + 2.0 * k as f64, y, 0.0));
            }
            raw.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            of_triangle.extend([k as u32; 2]);
        }
        let names = vec![SurfaceNames {
            kind,
            names: names.iter().map(|n| (*n).to_owned()).collect(),
            of_triangle,
        }];
        let options = LoadOptions {
            unwrap_resolution: 128,
            ..LoadOptions::default()
        };
        let mesh = prepare_mesh(raw, Path::new("m.obj"), false, &options).expect("usable");
        (mesh, names)
    }

    fn found(kind: NameKind, names: &[&str], declared: Option<&[Class]>) -> Option<ClassesByName> {
        let (mesh, names) = prepared(kind, names);
        mesh_classes(&Named::prepared(&mesh, &names), declared, Switch::Auto)
    }

    #[test]
    fn names_that_programs_give_are_no_classes() {
        for names in [
            &["Material.001", "Material.002"][..],
            &["material_0"],
            &["tex_u1_v1", "textured_output"],
            &["oak.png", "wall.jpg"],
            &["3f2a9c01bb", "77aa12cd9e"],
            &["wall"],
            &["1", "2", "3"],
            &["wall", "floor", "Material.001", "Material.002", "Material"],
        ] {
            assert!(
                found(NameKind::Material, names, None).is_none(),
                "{names:?}"
            );
        }
        let (mesh, names) = prepared(NameKind::Material, &["Material.001", "Material.002"]);
        let named = Named::prepared(&mesh, &names);
        assert!(
            mesh_classes(&named, None, Switch::On).is_some(),
            "unless asked for"
        );
    }

    /// Every triangle with area has the class of its name, in the order of the mesh that is used.
    #[test]
    fn materials_are_classes_and_lamps_are_known_by_name() {
        let names = [
            "WallPaint",
            "ceiling light.001",
            "light oak",
            "window_glass",
            "Material",
        ];
        let f = found(NameKind::Material, &names, None).expect("classes");
        assert_eq!(f.mesh.of_triangle, [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]);
        let lights: Vec<&str> = f
            .classes
            .iter()
            .filter(|c| c.is_light)
            .map(|c| c.name.as_str())
            .collect();
        assert_eq!(lights, ["ceiling light.001"]);
        assert!(f.classes[3].is_window() && !f.classes[0].is_window());
        assert_eq!(
            f.account(),
            "materials as 5 classes (WallPaint, ceiling light.001, light oak, window_glass, Material)"
        );
    }

    #[test]
    fn objects_of_one_name_are_one_class_and_numbers_count() {
        let f = found(NameKind::Object, &["Chair_1", "Chair_2", "Wall0"], None).expect("classes");
        assert_eq!(f.mesh.of_triangle, [1, 1, 1, 1, 2, 2]);
        let f = found(NameKind::Object, &["7", "12"], None).expect("classes");
        assert_eq!(f.classes[1].name, "object 12");
    }

    /// What `transforms.json` declares goes before what a name suggests.
    #[test]
    fn declared_classes_keep_their_ids_and_kinds() {
        let class = |id, name: &str, is_light| Class {
            id,
            name: name.into(),
            is_light,
        };
        let declared = [class(4, "wall", false), class(9, "tube", true)];
        let f = found(NameKind::Class, &["9", "4", "17"], Some(&declared)).expect("classes");
        assert_eq!(f.mesh.of_triangle, [9, 9, 4, 4, 17, 17]);
        assert_eq!(f.classes[2].name, "class 17");
        let f = found(NameKind::Material, &["Tube", "lamp"], Some(&declared)).expect("classes");
        assert_eq!(f.mesh.of_triangle, [9, 9, 10, 10]);
        assert!(f.classes.iter().all(|c| c.is_light == (c.id > 4)));
    }
}
