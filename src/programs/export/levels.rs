//! `--lods`: coarser meshes of an object, to show it by from afar on the same textures.
//!
//! Edges are collapsed by quadric error, textures included ([`simplified_texture`]). What bounds a
//! chart stays as it is in the atlas: only vertices on a straight stretch of its outline may go. So
//! every level samples the atlas where the object does.

use crate::core::geometry::{Mesh, SurfaceDistance, vector_key};
use crate::ffi::meshopt::{Textured, simplified_texture};
use crate::solution::{DetailLevel, MeshPart};
use glam::Vec2;
use std::collections::HashMap;

/// Levels that may be asked for: the last has a 256th of the triangles.
pub(super) const MOST_LEVELS: u32 = 8;
/// Triangles that an object has as many of in one level as in none: what a graphics card takes up at
/// once (cited: Kubisch, *Introduction to Turing Mesh Shaders*, 2018, has 126 in a meshlet).
const MESHLET: usize = 126;
/// Share of the triangles of the level before at which a level is worth its memory (derived: halfway
/// between half of them, which is asked for, and all).
const WORTH: f32 = 0.75;
/// Share of the picture's height by which a level may be off where it is shown first (derived: a row
/// of a picture of 1000).
const ROW: f32 = 1e-3;
/// Sine of the angle up to which an outline is straight (derived: 32 steps of single precision on an
/// edge of a thousandth of the atlas).
const STRAIGHT: f32 = 32.0 * f32::EPSILON * 1e3;

/// Up to `count` levels of a part of `whole`, whose `panes` are flagged triangle by triangle. Level k
/// is meant for heights of 2⁻ᵏ of the picture and below: there it is off by a row at most, and has
/// about 2⁻ᵏ of the triangles (as Unity's generator of levels has it). Levels that save little are
/// left out, and so are all levels of what has few triangles.
pub(super) fn levels(
    part: &MeshPart,
    whole: &Mesh,
    panes: Option<&[bool]>,
    count: u32,
) -> Vec<DetailLevel> {
    let mesh = part.mesh(whole);
    if mesh.triangles.len() <= MESHLET {
        return Vec::new();
    }
    let glass = |number: &u32| panes.is_some_and(|p| p[*number as usize]);
    let glass: Vec<bool> = part.triangles.iter().map(glass).collect();
    let simplifier = Simplifier::new(&mesh, &glass);
    let mut out = Vec::new();
    let mut before = mesh.triangles.len();
    for k in 1..=count {
        let coverage = 0.5f32.powi(k as i32);
        let level = simplifier.level(coverage);
        let triangles = level.mesh.triangles.len();
        if triangles as f32 <= WORTH * before as f32 && triangles > 0 {
            before = triangles;
            out.push(level);
        }
    }
    out
}

/// An object, ready to be simplified.
struct Simplifier<'a> {
    mesh: &'a Mesh,
    /// Triangles that are no panes.
    solid: Vec<u32>,
    /// Panes stay as they are.
    panes: Vec<[u32; 3]>,
    locked: Vec<bool>,
    /// Metres that a step of 1 in the atlas covers.
    texture_length: f32,
}

impl<'a> Simplifier<'a> {
    fn new(mesh: &'a Mesh, glass: &[bool]) -> Self {
        let mut locked = outline_corners(mesh);
        let (mut solid, mut panes) = (Vec::new(), Vec::new());
        for (corners, glass) in mesh.triangles.iter().zip(glass) {
            if *glass {
                panes.push(*corners);
                corners.iter().for_each(|i| locked[*i as usize] = true);
            } else {
                solid.extend(corners);
            }
        }
        let sum = |area: &dyn Fn(usize) -> f32| (0..mesh.triangles.len()).map(area).sum::<f32>();
        let (surface, chart) = (sum(&|t| mesh.area(t)), sum(&|t| mesh.chart_area(t).abs()));
        Self {
            mesh,
            solid,
            panes,
            locked,
            texture_length: (surface / chart.max(f32::MIN_POSITIVE)).sqrt(),
        }
    }

    fn level(&self, coverage: f32) -> DetailLevel {
        let mesh = self.mesh;
        let surface = Textured {
            indices: &self.solid,
            positions: &mesh.positions,
            uvs: &mesh.uvs,
            texture_length: self.texture_length,
            locked: &self.locked,
        };
        let (low, high) = mesh.bounds();
        let target = (coverage * (self.solid.len() / 3) as f32) as usize;
        let allowed = ROW / coverage * (high - low).length();
        let solid = simplified_texture(surface, target, allowed);
        let corners = solid.as_chunks::<3>().0.iter().chain(&self.panes);
        let coarse = mesh.of_corners(corners.copied());
        let distance = SurfaceDistance::new(&coarse);
        let off = mesh.positions.iter().map(|p| distance.to(*p));
        DetailLevel {
            error: off.fold(0.0, f32::max),
            mesh: coarse,
            panes: self.panes.len(),
            coverage,
        }
    }
}

/// Which vertices bound a chart and are not between two others on a straight line in the atlas.
/// Vertices of one place in space and in the atlas are one.
fn outline_corners(mesh: &Mesh) -> Vec<bool> {
    let mut number = HashMap::new();
    let place: Vec<usize> = (0..mesh.positions.len())
        .map(|i| {
            let key = (
                vector_key(mesh.positions[i]),
                mesh.uvs[i].to_array().map(f32::to_bits),
            );
            *number.entry(key).or_insert(i)
        })
        .collect();
    let mut uses: HashMap<[usize; 2], u32> = HashMap::new();
    for [a, b, c] in mesh.triangles.iter().map(|t| t.map(|i| place[i as usize])) {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *uses.entry([from.min(to), from.max(to)]).or_default() += 1;
        }
    }
    let mut beside: Vec<Vec<usize>> = vec![Vec::new(); mesh.positions.len()];
    let mut bounds: Vec<[usize; 2]> = uses
        .into_iter()
        .filter_map(|(edge, n)| (n != 2).then_some(edge))
        .collect();
    bounds.sort_unstable();
    for [a, b] in bounds {
        beside[a].push(b);
        beside[b].push(a);
    }
    let corner = |i: usize| match beside[place[i]].as_slice() {
        [] => false,
        [a, b] => !is_straight([mesh.uvs[*a], mesh.uvs[i], mesh.uvs[*b]]),
        _ => true,
    };
    (0..mesh.positions.len()).map(corner).collect()
}

fn is_straight([a, b, c]: [Vec2; 3]) -> bool {
    let (to, from) = (b - a, c - b);
    to.dot(from) > 0.0 && to.perp_dot(from).abs() <= STRAIGHT * to.length() * from.length()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::solution::tests::small_solution;
    use crate::solution::{GlbOptions, Solution, scene_glb};
    use glam::Vec3;
    use serde_json::{Value, json};

    /// A waved cloth of 2 · `side`² triangles, 2 m wide, in one chart whose outline is `inset` in the
    /// middle of one side.
    fn cloth(side: u32, inset: f32) -> Solution {
        let mut solution = small_solution();
        let m = &mut solution.mesh;
        *m = Mesh::default();
        for i in 0..=side {
            for j in 0..=side {
                let at = Vec2::new(i as f32, j as f32) / side as f32;
                let y = 0.05 * (4.0 * at.x).sin() * (5.0 * at.y).cos();
                m.positions.push(Vec3::new(2.0 * at.x, y, 2.0 * at.y));
                m.normals.push(Vec3::Y);
                let bend = inset * (1.0 - at.x) * (std::f32::consts::PI * at.y).sin();
                m.uvs.push(0.1 + 0.8 * Vec2::new(at.x + bend, at.y));
            }
        }
        let row = side + 1;
        for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
            let a = i * row + j;
            m.triangles
                .extend([[a, a + 1, a + row], [a + 1, a + row + 1, a + row]]);
        }
        solution
    }

    /// Distance of a point to a triangle, by the nearest of many points of it.
    fn sampled(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
        let steps = 40;
        let at = |i: i32, j: i32| {
            let (u, v) = (i as f32 / steps as f32, j as f32 / steps as f32);
            p.distance(a + u * (b - a) + v * (c - a))
        };
        let cells = (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| (i, j)));
        cells.map(|(i, j)| at(i, j)).fold(f32::INFINITY, f32::min)
    }

    fn whole(solution: &Solution) -> MeshPart {
        MeshPart::whole("cloth", &solution.mesh)
    }

    #[test]
    fn triangles_fall_and_the_surface_stays_within_the_stated_error() {
        let solution = cloth(32, 0.0);
        let out = levels(&whole(&solution), &solution.mesh, None, 3);
        assert_eq!(out.len(), 3);
        let (mut before, mut error) = (2048, 0.0);
        for (k, level) in (1..).zip(&out) {
            let n = level.mesh.triangles.len();
            assert!(n as f32 <= WORTH * before as f32, "{n} of {before}");
            assert!(level.error >= error && level.error > 0.0);
            // a row of the picture, give and take what quadrics know of distances
            assert!(
                level.error < 2.0 * ROW * 2.0f32.powi(k) * 3.0,
                "{}",
                level.error
            );
            (before, error) = (n, level.error);
            let off = |p: &Vec3| {
                let triangles = 0..level.mesh.triangles.len();
                let to = triangles.map(|t| sampled(*p, level.mesh.corners(t)));
                to.fold(f32::INFINITY, f32::min)
            };
            let some = solution.mesh.positions.iter().step_by(7);
            let furthest = some.map(off).fold(0.0, f32::max);
            // samples lie up to a fortieth of an edge beside the nearest point
            assert!(furthest < level.error + 0.01, "{furthest} {}", level.error);
            let (low, high) = level.mesh.bounds();
            assert!(low.x.abs() < 1e-6 && (high - Vec3::new(2.0, high.y, 2.0)).length() < 1e-5);
        }
    }

    /// The chart covers what it covered: its outline is the same polygon.
    #[test]
    fn charts_keep_their_outline() {
        for inset in [0.0, 0.2] {
            let solution = cloth(32, inset);
            let mesh = &solution.mesh;
            let area = |m: &Mesh| {
                (0..m.triangles.len())
                    .map(|t| m.chart_area(t).abs())
                    .sum::<f32>()
            };
            let out = levels(&whole(&solution), mesh, None, 2);
            assert!(!out.is_empty());
            for level in &out {
                let (was, is) = (area(mesh), area(&level.mesh));
                assert!((was - is).abs() < 1e-4 * was, "{was} {is}");
            }
            let corners = outline_corners(mesh).iter().filter(|c| **c).count();
            // four, and those of the bent side
            assert!(
                if inset == 0.0 {
                    corners == 4
                } else {
                    corners > 30
                },
                "{corners}"
            );
        }
    }

    #[test]
    fn small_objects_have_no_levels_and_panes_stay() {
        let small = cloth(7, 0.0);
        assert!(small.mesh.triangles.len() < MESHLET);
        assert!(levels(&whole(&small), &small.mesh, None, 3).is_empty());
        let solution = cloth(32, 0.0);
        let glass: Vec<bool> = (0..2048).map(|t| t < 64).collect();
        let out = levels(&whole(&solution), &solution.mesh, Some(&glass), 1);
        let level = &out[0];
        assert_eq!(level.panes, 64);
        let n = level.mesh.triangles.len();
        for (k, t) in (n - 64..n).enumerate() {
            assert_eq!(level.mesh.corners(t), solution.mesh.corners(k));
        }
    }

    #[test]
    fn levels_are_nodes_beside_the_scene_that_name_their_error() {
        let solution = cloth(32, 0.0);
        let mut part = whole(&solution);
        part.levels = levels(&part, &solution.mesh, None, 2);
        let options = GlbOptions {
            parts: vec![part.clone()],
            tangents: true,
            lightmap: true,
            ..GlbOptions::default()
        };
        let bytes = scene_glb(&solution, &options).expect("writes");
        gltf::Gltf::from_slice(&bytes).expect("valid");
        let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
        let root: Value = serde_json::from_slice(&glb.json).expect("JSON");
        let nodes = root["nodes"].as_array().expect("nodes");
        assert_eq!(nodes[0]["children"], json!([1]));
        assert_eq!(nodes[1]["extensions"]["MSFT_lod"]["ids"], json!([2, 3]));
        assert_eq!(
            nodes[1]["extras"]["MSFT_screencoverage"],
            json!([0.5, 0.25, 0.0])
        );
        let used = root["extensionsUsed"].as_array().expect("a list");
        assert!(used.contains(&json!("MSFT_lod")));
        for (k, level) in part.levels.iter().enumerate() {
            let node = &nodes[2 + k];
            assert_eq!(node["name"], json!(format!("cloth_LOD{}", k + 1)));
            assert_eq!(node["extras"]["error"], json!(level.error));
            let mesh = node["mesh"].as_u64().expect("a mesh") as usize;
            let primitive = &root["meshes"][mesh]["primitives"][0];
            let indices = primitive["indices"].as_u64().expect("indices") as usize;
            let count = root["accessors"][indices]["count"].as_u64();
            assert_eq!(count, Some(3 * level.mesh.triangles.len() as u64));
            assert!(primitive["attributes"]["TANGENT"].is_u64());
        }
    }
}
