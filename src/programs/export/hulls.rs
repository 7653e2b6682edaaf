//! `--hulls`: convex bodies that an object is made of, for engines that collide by these.
//!
//! An object that is not convex by itself is cut into nearly convex pieces by V-HACD (Mamou and Ghorbel 2009; crate `parry3d`),
//! and a piece becomes the convex hull of its own surface. Of a hull's points only those are kept
//! that it takes to hold all others: the one furthest outside is added until none is outside by more
//! than a millimetre, or an engine takes no more. What is flat becomes a plate behind its surface.

use crate::core::formats::GlbWriter;
use crate::core::geometry::{Mesh, SurfaceDistance, bounds, box_corners};
use crate::core::parallel;
use crate::error::Result;
use crate::solution::{MeshPart, Solution};
use glam::Vec3;
use parry3d::transformation::try_convex_hull;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use parry3d::transformation::voxelization::FillMode;
use serde_json::{Value, json};

/// Hulls of an object, at most (cited: half of what Isaac Sim's convex decomposition makes of a mesh
/// by default, as a room has hundreds of objects).
const MOST_HULLS: u32 = 16;
/// Depth of hollows, as a share of the diagonal of the bounding box, up to which a thing is convex
/// (derived: V-HACD sees nothing smaller, in cells of a 64th of the longest side).
const HOLLOW: f32 = 1.0 / 64.0;
/// Vertices of a hull, at most (cited: what PhysX takes on graphics cards).
const MOST_VERTICES: usize = 64;
/// Distance by which points may stand out of a hull, metres (derived: a tenth of [`PLATE`]).
const OUTSIDE: f32 = 1e-3;
/// Thickness of what is flat, metres (cited: the distance at which PhysX and Unreal begin to see
/// contacts is 0.02 m; half of it on either side).
const PLATE: f32 = 1e-2;
/// The file of hulls.
pub(super) const COLLISION: &str = "scene_collision.glb";

/// A closed convex body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hull {
    /// Corners, relative to the object's pivot, metres.
    pub positions: Vec<Vec3>,
    /// Triangles, wound so that they face outwards.
    pub triangles: Vec<[u32; 3]>,
}

/// The hulls of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectHulls {
    /// The object's name.
    pub name: String,
    /// Where the object stands, relative to the solution's origin, metres.
    pub pivot: Vec3,
    /// At least one.
    pub hulls: Vec<Hull>,
    /// Longest distance of a vertex of the object to the nearest hull, metres; 0 = all are inside.
    pub error: f32,
}

/// The hulls of some objects of a mesh, in their order; what has no surface has none.
#[must_use]
pub fn object_hulls(whole: &Mesh, parts: &[MeshPart]) -> Vec<ObjectHulls> {
    let hulls = parallel::map_chunks(parts.len(), 1, |range| {
        let part = &parts[range.start];
        let mesh = part.mesh(whole);
        let hulls = hulls(&mesh);
        (!hulls.is_empty()).then(|| ObjectHulls {
            name: part.name.clone(),
            pivot: part.pivot,
            error: furthest_outside(&mesh, &hulls),
            hulls,
        })
    });
    hulls.into_iter().flatten().collect()
}

/// `scene_collision.glb`: a node for each hull, named as Unreal looks for them.
///
/// # Errors
/// If the file would exceed 4 GiB.
pub fn collision_glb(solution: &Solution, objects: &[ObjectHulls]) -> Result<Vec<u8>> {
    let mut glb = GlbWriter::default();
    let mut nodes = vec![json!({
        "name": "scene",
        "translation": solution.origin.to_array(),
    })];
    let mut meshes: Vec<Value> = Vec::new();
    for object in objects {
        for (k, hull) in (1..).zip(&object.hulls) {
            let bounds = hull.bounds();
            let indices = glb.triangles(&hull.triangles);
            let position = glb.positions(&hull.positions, bounds);
            let name = format!("UCX_{}_{k:02}", object.name);
            nodes.push(json!({
                "name": name,
                "mesh": meshes.len(),
                "translation": object.pivot.as_dvec3().to_array(),
                "extras": {"error": object.error},
            }));
            let primitive = json!({"attributes": {"POSITION": position}, "indices": indices});
            meshes.push(json!({"name": name, "primitives": [primitive]}));
        }
    }
    if nodes.len() > 1 {
        nodes[0]["children"] = json!((1..nodes.len()).collect::<Vec<usize>>());
    }
    let mut root = json!({
        "asset": {"version": "2.0", "generator": concat!("unbake ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
    });
    if !meshes.is_empty() {
        root["meshes"] = json!(meshes);
    }
    glb.finish(root)
}

impl Hull {
    /// The corners of the bounding box, lowest first.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        bounds(&self.positions)
    }

    /// The convex hull of points; `None` if they lie in a plane, or nearly so.
    fn of(points: &[Vec3]) -> Option<Self> {
        let points: Vec<_> = points.iter().map(|p| p.to_array().into()).collect();
        let (positions, triangles) = try_convex_hull(&points).ok()?;
        let hull = Self {
            positions: positions.iter().map(|p| p.to_array().into()).collect(),
            triangles,
        };
        // of corners that nearly lie in a plane the library makes bodies that are neither
        let out = hull.positions.iter().map(|p| hull.height(*p));
        let convex = out.fold(0.0, f32::max) <= 0.5 * OUTSIDE;
        (hull.thickness() > 0.1 * PLATE && convex && hull.is_closed()).then_some(hull)
    }

    fn surface(&self) -> SurfaceDistance {
        SurfaceDistance::new(&Mesh {
            positions: self.positions.clone(),
            triangles: self.triangles.clone(),
            ..Mesh::default()
        })
    }

    fn corners(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].map(|i| self.positions[i as usize])
    }

    /// Volume, m³.
    fn volume(&self) -> f32 {
        let first = self.positions.first().copied().unwrap_or_default();
        let of = |t: usize| {
            let [a, b, c] = self.corners(t).map(|p| p - first);
            a.dot((b - a).cross(c - a)) / 6.0
        };
        (0..self.triangles.len()).map(of).sum()
    }

    /// About the extent in the shortest direction, metres: volume over half of the surface.
    fn thickness(&self) -> f32 {
        let of = |t: usize| {
            let [a, b, c] = self.corners(t);
            0.5 * (b - a).cross(c - a).length()
        };
        let surface: f32 = (0..self.triangles.len()).map(of).sum();
        2.0 * self.volume() / surface.max(f32::MIN_POSITIVE)
    }

    /// Whether every edge has a triangle on either side.
    fn is_closed(&self) -> bool {
        let mut edges: Vec<[u32; 2]> = Vec::new();
        for [a, b, c] in &self.triangles {
            edges.extend([[*a, *b], [*b, *c], [*c, *a]]);
        }
        edges.sort_unstable();
        let twice = edges.windows(2).any(|w| w[0] == w[1]);
        !twice
            && edges
                .iter()
                .all(|[a, b]| edges.binary_search(&[*b, *a]).is_ok())
    }

    /// How far a point stands out of the planes of its triangles, metres; below 0 inside.
    fn height(&self, point: Vec3) -> f32 {
        let over = |t: usize| {
            let [a, b, c] = self.corners(t);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            (point - a).dot(normal)
        };
        (0..self.triangles.len())
            .map(over)
            .fold(f32::NEG_INFINITY, f32::max)
    }
}

/// The hulls of a mesh.
fn hulls(mesh: &Mesh) -> Vec<Hull> {
    let (low, high) = mesh.bounds();
    let surface: f32 = (0..mesh.triangles.len()).map(|t| mesh.area(t)).sum();
    if surface <= OUTSIDE * OUTSIDE {
        return Vec::new();
    }
    let outside = is_seen_from_outside(mesh);
    if let Some(hull) = Hull::of(&mesh.positions).filter(|_| outside) {
        let hull = few_corners(hull);
        let deepest = |d: f32, p: &Vec3| d.max(-hull.height(*p));
        let hollow = mesh.positions.iter().fold(0.0, deepest);
        if hollow <= HOLLOW * (high - low).length() {
            return vec![hull];
        }
    }
    let positions: Vec<_> = mesh.positions.iter().map(|p| p.to_array().into()).collect();
    let parameters = VHACDParameters {
        max_convex_hulls: MOST_HULLS,
        fill_mode: match outside {
            true => FillMode::FloodFill {
                detect_cavities: false,
            },
            false => FillMode::SurfaceOnly,
        },
        ..VHACDParameters::default()
    };
    let pieces = VHACD::decompose(&parameters, &positions, &mesh.triangles, true)
        .compute_primitive_intersections(&positions, &mesh.triangles);
    let piece = |points: &Vec<_>| {
        let points: Vec<Vec3> = points
            .iter()
            .map(|p: &parry3d::math::Vector| p.to_array().into())
            .collect();
        body(&points, mesh)
    };
    let pieces = pieces.iter().filter_map(piece).map(few_corners);
    joined(pieces.collect())
}

/// A hull of a piece's points: their own, or of those of a plate; where rounding lets the library fail,
/// of a body around them that is half a plate's thickness larger.
fn body(points: &[Vec3], mesh: &Mesh) -> Option<Hull> {
    if points.is_empty() {
        return None;
    }
    let around = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| 0.5 * PLATE * axis);
    let larger = || -> Vec<Vec3> {
        let ends = |p: &Vec3| around.map(|a| [*p - a, *p + a]);
        points.iter().flat_map(ends).flatten().collect()
    };
    let boxed = || {
        let (low, high) = bounds(points);
        Hull::of(&box_corners(low - 0.5 * PLATE, high + 0.5 * PLATE))
    };
    Hull::of(points)
        .or_else(|| Hull::of(&plate(points, mesh)?))
        .or_else(|| Hull::of(&larger()))
        .or_else(boxed)
}

/// Two hulls that may become one.
struct Pair {
    places: [usize; 2],
    /// Their common hull.
    hull: Hull,
    /// By how much it is larger than both, m³.
    growth: f32,
}

impl Pair {
    /// The pair of two hulls of a list, if both are there and have a common hull.
    fn of(hulls: &[Option<Hull>], places: [usize; 2]) -> Option<Self> {
        let [a, b] = places.map(|k| hulls[k].as_ref());
        let (a, b) = (a?, b?);
        let points: Vec<Vec3> = a.positions.iter().chain(&b.positions).copied().collect();
        let hull = Hull::of(&points)?;
        Some(Self {
            places,
            growth: hull.volume() - a.volume() - b.volume(),
            hull,
        })
    }
}

/// At most [`MOST_HULLS`]: as long as there are more, the two become one that are together the least
/// larger than apart.
fn joined(hulls: Vec<Hull>) -> Vec<Hull> {
    let most = MOST_HULLS as usize;
    if hulls.len() <= most {
        return hulls;
    }
    let mut left = hulls.len();
    let mut hulls: Vec<Option<Hull>> = hulls.into_iter().map(Some).collect();
    let all = (0..hulls.len()).flat_map(|i| (0..i).map(move |j| [i, j]));
    let mut pairs: Vec<Pair> = all.filter_map(|p| Pair::of(&hulls, p)).collect();
    while left > most {
        let growth = |k: &usize| pairs[*k].growth;
        let least = (0..pairs.len()).min_by(|a, b| growth(a).total_cmp(&growth(b)));
        let Some(Pair {
            places: [gone, kept],
            hull,
            ..
        }) = least.map(|k| pairs.swap_remove(k))
        else {
            break;
        };
        hulls[gone] = None;
        hulls[kept] = Some(few_corners(hull));
        left -= 1;
        pairs.retain(|p| !p.places.contains(&gone) && !p.places.contains(&kept));
        let others = (0..hulls.len()).filter(|k| *k != kept);
        pairs.extend(others.filter_map(|k| Pair::of(&hulls, [k, kept])));
    }
    hulls.into_iter().flatten().collect()
}

/// Whether a mesh is a thing, whose faces turn outwards, rather than a room around the viewer, which
/// must stay empty.
fn is_seen_from_outside(mesh: &Mesh) -> bool {
    let (low, high) = mesh.bounds();
    let middle = 0.5 * (low + high);
    let volume = |t: usize| (mesh.corners(t)[0] - middle).dot(mesh.double_area_normal(t));
    (0..mesh.triangles.len()).map(volume).sum::<f32>() > 0.0
}

/// The points of a flat piece, and as many behind it; `None` if they lie on a line.
fn plate(points: &[Vec3], mesh: &Mesh) -> Option<Vec<Vec3>> {
    let furthest = |height: &dyn Fn(&Vec3) -> f32| {
        points
            .iter()
            .max_by(|a, b| height(a).total_cmp(&height(b)))
            .copied()
    };
    let a = *points.first()?;
    let b = furthest(&|p| p.distance_squared(a))?;
    let along = (b - a).try_normalize()?;
    let c = furthest(&|p| (*p - a).reject_from_normalized(along).length_squared())?;
    let normal = along.cross(c - a).try_normalize()?;
    let front: f32 = (0..mesh.triangles.len())
        .filter(|&t| (mesh.corners(t)[0] - a).dot(normal).abs() < PLATE)
        .map(|t| mesh.double_area_normal(t).dot(normal))
        .sum();
    let back = normal * PLATE.copysign(-front);
    Some(points.iter().flat_map(|p| [*p, *p + back]).collect())
}

/// A hull of few of a hull's corners, which holds all others but for [`OUTSIDE`] or as well as
/// [`MOST_VERTICES`] can.
fn few_corners(hull: Hull) -> Hull {
    let extreme = |direction: Vec3| {
        let along = |p: &&Vec3| p.dot(direction);
        let most = |a: &&Vec3, b: &&Vec3| along(a).total_cmp(&along(b));
        hull.positions.iter().max_by(most).copied()
    };
    // no axis, so that a box's corners are no draw
    let directions = [
        Vec3::new(3.0, 2.0, 1.0),
        Vec3::new(-2.0, 3.0, 1.0),
        Vec3::new(1.0, -2.0, 3.0),
    ];
    let mut chosen: Vec<Vec3> = directions
        .into_iter()
        .flat_map(|d| [d, -d])
        .filter_map(extreme)
        .collect();
    let mut best = None;
    loop {
        let inner = Hull::of(&chosen);
        let height = |p: &Vec3| inner.as_ref().map_or(0.0, |h| h.height(*p));
        let next = hull
            .positions
            .iter()
            .filter(|p| !chosen.contains(p))
            .map(|p| (height(p), *p))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let failed = inner.is_none();
        best = inner.or(best);
        match next {
            Some((height, p)) if chosen.len() < MOST_VERTICES && (failed || height > OUTSIDE) => {
                chosen.push(p);
            }
            _ => return best.unwrap_or(hull),
        }
    }
}

/// Longest distance of a vertex of the mesh to the nearest hull, metres.
fn furthest_outside(mesh: &Mesh, hulls: &[Hull]) -> f32 {
    let surfaces: Vec<SurfaceDistance> = hulls.iter().map(Hull::surface).collect();
    let boxes: Vec<(Vec3, Vec3)> = hulls.iter().map(Hull::bounds).collect();
    let distance = |p: Vec3| {
        let mut nearest = f32::INFINITY;
        for ((hull, surface), (low, high)) in hulls.iter().zip(&surfaces).zip(&boxes) {
            // not even the box is nearer
            if p.distance(p.clamp(*low, *high)) < nearest {
                let outside = hull.height(p) > 0.0;
                nearest = nearest.min(if outside { surface.to(p) } else { 0.0 });
            }
        }
        nearest
    };
    let distances = mesh.positions.iter().map(|p| distance(*p));
    distances.fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::add_box;
    use crate::solution::tests::small_solution;

    fn of(mesh: &Mesh) -> ObjectHulls {
        let part = MeshPart::whole("thing", mesh);
        let mut out = object_hulls(mesh, std::slice::from_ref(&part));
        assert_eq!(out.len(), 1);
        assert_eq!(out, object_hulls(mesh, &[part]), "the same twice");
        let object = out.remove(0);
        for hull in &object.hulls {
            assert!(hull.is_closed() && hull.thickness() > 0.0);
            assert!(hull.positions.len() <= MOST_VERTICES);
            // convex: no corner is in front of a face
            for p in &hull.positions {
                assert!(hull.height(*p) < 1e-4, "{}", hull.height(*p));
            }
        }
        let held = |p: &Vec3| {
            object
                .hulls
                .iter()
                .any(|h| h.height(*p) <= object.error + 1e-5)
        };
        assert!(mesh.positions.iter().all(held), "{}", object.error);
        object
    }

    fn volume(object: &ObjectHulls) -> f32 {
        object.hulls.iter().map(Hull::volume).sum()
    }

    #[test]
    fn a_box_is_one_hull_of_eight_corners() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::ZERO, Vec3::new(0.4, 0.8, 0.5), true);
        let object = of(&mesh);
        assert_eq!(object.hulls.len(), 1);
        assert_eq!(object.hulls[0].positions.len(), 8);
        assert!(object.error < 1e-5 && (volume(&object) - 0.16).abs() < 1e-4);
    }

    /// What is free between the legs stays free.
    #[test]
    fn a_table_is_several_hulls() {
        let mut mesh = Mesh::default();
        add_box(
            &mut mesh,
            Vec3::new(0.0, 0.7, 0.0),
            Vec3::new(1.2, 0.75, 0.8),
            true,
        );
        for (x, z) in [(0.0, 0.0), (1.14, 0.0), (0.0, 0.74), (1.14, 0.74)] {
            let low = Vec3::new(x, 0.0, z);
            add_box(&mut mesh, low, low + Vec3::new(0.06, 0.7, 0.06), true);
        }
        let object = of(&mesh);
        assert!(object.hulls.len() >= 5, "{}", object.hulls.len());
        let below = Vec3::new(0.6, 0.3, 0.4);
        assert!(object.hulls.iter().all(|h| h.height(below) > 0.0));
        assert!(object.error <= OUTSIDE + 1e-5, "{}", object.error);
    }

    #[test]
    fn a_room_stays_empty_and_its_walls_become_plates_behind_them() {
        let mut mesh = Mesh::default();
        let (low, high) = (Vec3::ZERO, Vec3::new(5.0, 2.5, 4.0));
        add_box(&mut mesh, low, high, false);
        let object = of(&mesh);
        let inside = [
            Vec3::new(2.5, 1.2, 2.0),
            Vec3::new(0.5, 0.5, 0.5),
            Vec3::new(4.5, 2.0, 3.5),
        ];
        for p in inside {
            assert!(object.hulls.iter().all(|h| h.height(p) > 0.0), "{p}");
        }
        let floor = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::Z],
            normals: vec![Vec3::Y; 4],
            uvs: vec![glam::Vec2::ZERO; 4],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
        };
        let object = of(&floor);
        assert_eq!(object.hulls.len(), 1);
        let (low, high) = object.hulls[0].bounds();
        assert!(
            high.y.abs() < 1e-6 && (low.y + PLATE).abs() < 1e-6,
            "{low} {high}"
        );
    }

    /// Forty bricks in a spiral are no more hulls than an engine is glad of, and none is forgotten.
    #[test]
    fn an_object_has_no_more_hulls_than_stated() {
        let mut mesh = Mesh::default();
        for k in 0..40 {
            let (s, c) = (0.4 * k as f32).sin_cos();
            let low = Vec3::new(0.05 * k as f32 * c, 0.04 * k as f32, 0.05 * k as f32 * s);
            add_box(&mut mesh, low, low + Vec3::new(0.1, 0.03, 0.1), true);
        }
        let object = of(&mesh);
        let count = object.hulls.len();
        assert!((4..=MOST_HULLS as usize).contains(&count), "{count}");
        assert!(object.error < 5.0 * OUTSIDE, "{}", object.error);
    }

    #[test]
    fn what_has_no_extent_has_no_hulls_and_no_input_is_too_odd() {
        let mut mesh = small_solution().mesh;
        mesh.positions.fill(Vec3::ONE);
        assert!(object_hulls(&mesh, &[MeshPart::whole("a", &mesh)]).is_empty());
        // a line, and a needle
        mesh.positions = vec![Vec3::ZERO, Vec3::X, 2.0 * Vec3::X, 3.0 * Vec3::X];
        assert!(object_hulls(&mesh, &[MeshPart::whole("a", &mesh)]).is_empty());
        mesh.positions[2].y = 1e-5;
        let _ = object_hulls(&mesh, &[MeshPart::whole("a", &mesh)]);
        let none = Mesh::default();
        assert!(object_hulls(&none, &[MeshPart::whole("a", &none)]).is_empty());
    }

    #[test]
    fn the_file_has_a_node_for_each_hull() {
        let solution = small_solution();
        let part = MeshPart::standing("table".into(), &solution.mesh, vec![0, 1]);
        let objects = object_hulls(&solution.mesh, &[part]);
        let bytes = collision_glb(&solution, &objects).expect("writes");
        let read = gltf::Gltf::from_slice(&bytes).expect("valid");
        let names: Vec<_> = read.nodes().filter_map(|n| n.name()).collect();
        assert_eq!(names, ["scene", "UCX_table_01"]);
        let none = collision_glb(&solution, &[]).expect("writes");
        gltf::Gltf::from_slice(&none).expect("valid");
    }
}
