//! `--split`: the mesh as objects, named by what they are.
//!
//! A triangle belongs to the class at its middle. An object is all of a class, or a piece of it that
//! touches no other piece of the class (corners of one place are one corner, whatever seam of the
//! atlas or sharp edge runs through it).

use crate::core::geometry::{Mesh, touching};
use crate::scene::unnamed_class;
use crate::solution::{MeshPart, Solution, lamp_gap};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// What the mesh is divided into.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// One object of all surfaces.
    #[default]
    None,
    /// An object per class.
    Classes,
    /// An object per connected piece of a class.
    Objects,
}

/// A class and what it is called.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClassName {
    /// Id in `labels.png`.
    pub id: u16,
    /// Name.
    pub name: String,
}

/// Distance up to which corners are one, as a share of the longest distance between parts of one
/// lamp ([`lamp_gap`]): what several exporters round a coordinate to (derived: 4e-6 of the scene's
/// diagonal is 32 steps of single precision).
const WELD: f32 = 2e-3;

/// The objects of a solution, class by class, the largest of each first; empty for [`Split::None`].
/// Classes without a name in `names` are called "class 7".
#[must_use]
pub fn objects(solution: &Solution, split: Split, names: &[ClassName]) -> Vec<MeshPart> {
    if split == Split::None {
        return Vec::new();
    }
    let mesh = &solution.mesh;
    let mut classes: BTreeMap<u16, Vec<u32>> = BTreeMap::new();
    for t in 0..mesh.triangles.len() {
        let class = solution.class_at(mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0));
        classes.entry(class).or_default().push(t as u32);
    }
    let mut taken = BTreeSet::new();
    let mut out = Vec::new();
    for (class, triangles) in classes {
        let name = class_name(class, names);
        let pieces = match split {
            Split::Objects => pieces_by_size(mesh, &triangles),
            Split::None | Split::Classes => vec![triangles],
        };
        for triangles in pieces {
            let name = unlike(&name, ' ', &mut taken);
            out.push(MeshPart::standing(name, mesh, triangles));
        }
    }
    out
}

fn class_name(class: u16, names: &[ClassName]) -> String {
    let known = names
        .iter()
        .find(|n| n.id == class && !n.name.trim().is_empty());
    known.map_or_else(|| unnamed_class(class), |n| n.name.trim().to_owned())
}

/// The name, or the name with the first number from 2 on that makes it one of its own.
pub(super) fn unlike(name: &str, before_number: char, taken: &mut BTreeSet<String>) -> String {
    let numbered = (2..).map(|n| format!("{name}{before_number}{n}"));
    let free = std::iter::once(name.to_owned())
        .chain(numbered)
        .find(|n| !taken.contains(n))
        .unwrap_or_default();
    taken.insert(free.clone());
    free
}

/// A piece of a class and its bounding box.
struct Piece {
    triangles: Vec<u32>,
    low: Vec3,
    high: Vec3,
}

impl Piece {
    fn of(mesh: &Mesh, triangles: Vec<u32>) -> Self {
        let corners = triangles.iter().flat_map(|&t| mesh.corners(t as usize));
        let (low, high) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| {
            (b.0.min(p), b.1.max(p))
        });
        Self {
            triangles,
            low,
            high,
        }
    }

    fn diagonal(&self) -> f32 {
        (self.high - self.low).length()
    }

    /// Distance between the boxes; 0 where they overlap.
    fn distance(&self, other: &Self) -> f32 {
        (self.low - other.high)
            .max(other.low - self.high)
            .max(Vec3::ZERO)
            .length()
    }
}

/// The connected pieces of a class, largest box first. Specks, no larger than what parts two lamps,
/// are no things: each goes to the piece nearest to it, where there is one.
fn pieces_by_size(mesh: &Mesh, triangles: &[u32]) -> Vec<Vec<u32>> {
    let gap = lamp_gap(mesh);
    let mut pieces: Vec<Piece> = touching(mesh, triangles, WELD * gap)
        .into_iter()
        .map(|triangles| Piece::of(mesh, triangles))
        .collect();
    pieces.sort_by(|a, b| b.diagonal().total_cmp(&a.diagonal()));
    // all of a class may be specks: the largest stays
    let things = pieces.partition_point(|p| p.diagonal() > gap).max(1);
    let specks = pieces.split_off(things.min(pieces.len()));
    let mut groups: Vec<Vec<u32>> = pieces.iter().map(|p| p.triangles.clone()).collect();
    for speck in specks {
        let nearest = (0..pieces.len()).min_by(|&a, &b| {
            let distance = |k: usize| pieces[k].distance(&speck);
            distance(a).total_cmp(&distance(b))
        });
        if let Some(k) = nearest {
            groups[k].extend(&speck.triangles);
        }
    }
    groups.iter_mut().for_each(|g| g.sort_unstable());
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::{RawMesh, read_mesh};
    use crate::core::image::Plane;
    use crate::programs::export::punctual_lights;
    use crate::solution::tests::small_solution;
    use crate::solution::{GlbOptions, find_lamps, scene_glb};
    use glam::{DVec3, Vec2};
    use serde_json::{Value, json};

    /// Square tables at `places` (x, z), metres, each a top of two triangles whose diagonal is a seam
    /// of the atlas; the k-th is of class `classes[k]`.
    fn tables(places: &[Vec2], classes: &[u16]) -> Solution {
        let mut solution = small_solution();
        let n = places.len() as f32;
        solution.mesh = Mesh::default();
        for (k, p) in places.iter().enumerate() {
            let corner = |x: f32, z: f32| Vec3::new(p.x + x, 0.7 + 0.1 * k as f32, p.y + z);
            let uv = |x: f32, z: f32| Vec2::new((k as f32 + 0.1 + 0.8 * x) / n, 0.1 + 0.8 * z);
            let m = &mut solution.mesh;
            let first = m.positions.len() as u32;
            for (x, z) in [(0., 0.), (0., 1.), (1., 1.), (0., 0.), (1., 1.), (1., 0.)] {
                m.positions.push(corner(x, z));
                m.normals.push(Vec3::Y);
                m.uvs.push(uv(x, z));
            }
            m.triangles.extend([
                [first, first + 1, first + 2],
                [first + 3, first + 4, first + 5],
            ]);
        }
        solution.labels = Plane {
            width: places.len(),
            height: 1,
            data: classes.to_vec(),
        };
        solution
    }

    fn names(parts: &[MeshPart]) -> Vec<&str> {
        parts.iter().map(|p| p.name.as_str()).collect()
    }

    fn named(list: &[(u16, &str)]) -> Vec<ClassName> {
        let class = |&(id, name): &(u16, &str)| ClassName {
            id,
            name: name.into(),
        };
        list.iter().map(class).collect()
    }

    #[test]
    fn objects_are_named_by_class_and_stand_on_their_lower_side() {
        let places = [
            Vec2::ZERO,
            Vec2::new(5., 0.),
            Vec2::new(0., 5.),
            Vec2::splat(5.),
        ];
        let solution = tables(&places, &[3, 3, 9, 0]);
        let known = named(&[(3, "chair"), (9, "chair 2")]);
        assert!(objects(&solution, Split::None, &known).is_empty());
        let classes = objects(&solution, Split::Classes, &known);
        assert_eq!(names(&classes), ["unlabelled", "chair", "chair 2"]);
        let parts = objects(&solution, Split::Objects, &known);
        // a class that is called like another's second piece counts on
        assert_eq!(
            names(&parts),
            ["unlabelled", "chair", "chair 2", "chair 2 2"]
        );
        let unnamed = objects(&solution, Split::Classes, &[]);
        assert_eq!(names(&unnamed), ["unlabelled", "class 3", "class 9"]);
        assert_eq!(parts[1].pivot, Vec3::new(0.5, 0.7, 0.5));
        assert_eq!(parts[1].triangles, [0, 1], "over the seam of the atlas");
        assert_eq!(parts[2].pivot, Vec3::new(5.5, 0.8, 0.5));
    }

    #[test]
    fn specks_belong_to_what_is_nearest() {
        let mut solution = tables(&[Vec2::ZERO, Vec2::new(5., 0.)], &[3, 3]);
        let (low, high) = solution.mesh.bounds();
        let tiny = 1e-3 * (high - low).length();
        let first = solution.mesh.positions.len() as u32;
        for step in [Vec3::ZERO, Vec3::X, Vec3::Z] {
            solution
                .mesh
                .positions
                .push(Vec3::new(4.5, 0.75, 0.5) + tiny * step);
            solution.mesh.normals.push(Vec3::Y);
            solution.mesh.uvs.push(Vec2::splat(0.1));
        }
        solution.mesh.triangles.push([first, first + 1, first + 2]);
        let parts = objects(&solution, Split::Objects, &[]);
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[1].triangles, [2, 3, 4]);
        // ten times as large, it is a thing
        for k in 1..3 {
            let i = first as usize;
            let step = solution.mesh.positions[i + k] - solution.mesh.positions[i];
            solution.mesh.positions[i + k] += 9.0 * step;
        }
        assert_eq!(objects(&solution, Split::Objects, &[]).len(), 3);
    }

    /// Corners of a mesh, triangle by triangle, in an order that does not depend on the file's.
    fn corners(mesh: &RawMesh) -> Vec<(DVec3, Vec2)> {
        let mut triangles: Vec<Vec<(DVec3, Vec2)>> = mesh
            .triangles
            .iter()
            .map(|t| {
                t.map(|i| (mesh.positions[i as usize], mesh.uvs[i as usize]))
                    .to_vec()
            })
            .collect();
        // the atlas is no two triangles' at once
        let key = |t: &Vec<(DVec3, Vec2)>| t.iter().map(|c| c.1.to_array()).collect::<Vec<_>>();
        triangles.sort_by(|a, b| key(a).partial_cmp(&key(b)).expect("finite"));
        triangles.concat()
    }

    #[test]
    fn surfaces_materials_and_lamps_are_the_same_however_they_are_divided() {
        let places = [
            Vec2::ZERO,
            Vec2::new(5., 0.),
            Vec2::new(0., 5.),
            Vec2::splat(5.),
        ];
        let mut solution = tables(&places, &[3, 3, 9, 0]);
        solution.emission.data[9] = Vec3::new(12.5, 10.0, 3.0);
        solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        let folder = tempfile::tempdir().expect("temp");
        let write = |split: Split| {
            let options = GlbOptions {
                lights: punctual_lights(&solution),
                lightmap: true,
                parts: objects(&solution, split, &[]),
                ..GlbOptions::default()
            };
            let bytes = scene_glb(&solution, &options).expect("writes");
            let path = folder.path().join("scene.glb");
            std::fs::write(&path, &bytes).expect("writes");
            gltf::Gltf::from_slice(&bytes).expect("valid");
            let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
            let root: Value = serde_json::from_slice(&glb.json).expect("JSON");
            (read_mesh(&path).expect("reads"), root)
        };
        let lamp_nodes = |root: &Value| -> Vec<Value> {
            let nodes = root["nodes"].as_array().expect("nodes");
            let roots = root["scenes"][0]["nodes"].as_array().expect("roots");
            let is_root = |i: &usize| roots.contains(&json!(i));
            let lamps = (0..nodes.len()).filter(|i| nodes[*i].get("extensions").is_some());
            lamps.filter(is_root).map(|i| nodes[i].clone()).collect()
        };
        let (whole, one) = write(Split::None);
        assert_eq!(lamp_nodes(&one).len(), solution.lamps.len());
        assert!(!solution.lamps.is_empty());
        for (split, count) in [(Split::Classes, 3), (Split::Objects, 4)] {
            let (divided, several) = write(split);
            assert_eq!(several["meshes"].as_array().map(Vec::len), Some(count));
            let (a, b) = (corners(&whole), corners(&divided));
            assert_eq!(a.len(), b.len());
            for (a, b) in a.iter().zip(&b) {
                // half a step of single precision of a few metres
                assert!((a.0 - b.0).abs().max_element() < 5e-7, "{a:?} {b:?}");
                assert_eq!(a.1, b.1);
            }
            for key in ["materials", "textures", "samplers", "extensions"] {
                assert_eq!(one[key], several[key], "{key}");
            }
            assert_eq!(lamp_nodes(&one), lamp_nodes(&several));
            for mesh in several["meshes"].as_array().expect("meshes") {
                let attributes = &mesh["primitives"][0]["attributes"];
                assert!(attributes["TEXCOORD_1"].is_u64());
                let positions = attributes["POSITION"].as_u64().expect("an accessor");
                let accessor = &several["accessors"][positions as usize];
                let bound = |b: &str, k: usize| accessor[b][k].as_f64().expect("a number");
                assert_eq!(bound("min", 1), 0.0, "stands on its pivot");
                assert!((bound("min", 0) + bound("max", 0)).abs() < 1e-6);
            }
        }
    }
}
