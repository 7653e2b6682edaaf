//! The tree of boxes that the page's shader traces reflections through.
//!
//! A record per inner node, 16 words of 32 bits: lower corner of the first child's box (3 × f32), the first child (u32), upper corner of
//! that box, the second child, then the second child's box in the same way with two zeros. A child is the number of a record or, with
//! the highest bit set, that of a triangle; the first record is the root.

use crate::core::geometry::Mesh;
use bvh::aabb::{Aabb, Bounded};
use bvh::bounding_hierarchy::{BHShape, BoundingHierarchy};
use bvh::bvh::{Bvh, BvhNode};
use glam::Vec3;
use nalgebra::Point3;

/// Triangles beyond are not traced. Derived: records of nodes and triangles fill a texture of 4096 × 2048 texels, 128 MiB.
const MOST_TRIANGLES: usize = 1 << 20;
/// Places of the shader's stack, one per level of the tree; deeper trees are not traced.
const STACK: usize = 64;
/// Marks a child that is a triangle.
const LEAF: u32 = 1 << 31;
/// Words of a record.
const WORDS: usize = 16;

/// The box of a triangle.
struct TriangleBox {
    low: Vec3,
    high: Vec3,
    node: usize,
}

impl Bounded<f32, 3> for TriangleBox {
    fn aabb(&self) -> Aabb<f32, 3> {
        Aabb::with_bounds(
            Point3::from(self.low.to_array()),
            Point3::from(self.high.to_array()),
        )
    }
}

impl BHShape<f32, 3> for TriangleBox {
    fn set_bh_node_index(&mut self, node: usize) {
        self.node = node;
    }

    fn bh_node_index(&self) -> usize {
        self.node
    }
}

/// The records of a mesh's tree; none for a mesh of fewer than two triangles, of more than the page can hold, or whose tree is deeper
/// than the shader's stack.
#[must_use]
pub fn records(mesh: &Mesh) -> Vec<u32> {
    let count = mesh.triangles.len();
    if !(2..=MOST_TRIANGLES).contains(&count) {
        return Vec::new();
    }
    let mut boxes: Vec<TriangleBox> = (0..count)
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            TriangleBox {
                low: a.min(b).min(c),
                high: a.max(b).max(c),
                node: 0,
            }
        })
        .collect();
    let nodes = Bvh::build_par(&mut boxes).nodes;
    if depth(&nodes) > STACK {
        return Vec::new();
    }
    // inner nodes by the order in which they lie there
    let mut number = vec![0u32; nodes.len()];
    let mut inner = 0;
    for (place, node) in number.iter_mut().zip(&nodes) {
        *place = match node {
            BvhNode::Leaf { shape_index, .. } => LEAF | *shape_index as u32,
            BvhNode::Node { .. } => {
                inner += 1;
                inner - 1
            }
        };
    }
    let mut out = Vec::with_capacity(inner as usize * WORDS);
    for node in &nodes {
        if let BvhNode::Node {
            child_l_index,
            child_l_aabb,
            child_r_index,
            child_r_aabb,
            ..
        } = node
        {
            let corner = |p: &Point3<f32>| [p.x, p.y, p.z].map(f32::to_bits);
            let children = [number[*child_l_index], number[*child_r_index]];
            for (bounds, words) in [(child_l_aabb, children), (child_r_aabb, [0, 0])] {
                for (point, word) in [&bounds.min, &bounds.max].into_iter().zip(words) {
                    out.extend(corner(point));
                    out.push(word);
                }
            }
        }
    }
    out
}

/// Levels of inner nodes.
fn depth(nodes: &[BvhNode<f32, 3>]) -> usize {
    let (mut deepest, mut open) = (0, vec![(0, 1)]);
    while let Some((at, level)) = open.pop() {
        if let BvhNode::Node {
            child_l_index,
            child_r_index,
            ..
        } = nodes[at]
        {
            deepest = deepest.max(level);
            open.push((child_l_index, level + 1));
            open.push((child_r_index, level + 1));
        }
    }
    deepest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;
    use crate::core::trace::{BruteForce, Hit, Ray, Tracer};
    use glam::Vec2;

    /// Triangles of random places and sizes.
    fn scattered(count: usize) -> Mesh {
        let mut random = KeyedRng::new(7, 0);
        let mut vector =
            |size: f32| Vec3::new(random.next_f32(), random.next_f32(), random.next_f32()) * size;
        let positions: Vec<Vec3> = (0..count)
            .flat_map(|_| {
                let at = vector(10.0);
                [at + vector(5.0), at + vector(5.0), at + vector(5.0)]
            })
            .collect();
        Mesh {
            normals: vec![Vec3::Y; positions.len()],
            uvs: vec![Vec2::ZERO; positions.len()],
            triangles: (0..count as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
            positions,
        }
    }

    /// The nearest triangle met, found as the shader finds it but for the order of children.
    fn met(records: &[u32], mesh: &Mesh, ray: &Ray) -> Option<usize> {
        let (origin, direction) = (Vec3::from(ray.origin), Vec3::from(ray.direction));
        let mut best: Option<(f32, usize)> = None;
        let mut stack = vec![0u32];
        while let Some(child) = stack.pop() {
            if child & LEAF != 0 {
                let t = (child & !LEAF) as usize;
                let single = BruteForce::new(&Mesh {
                    triangles: vec![mesh.triangles[t]],
                    ..mesh.clone()
                });
                let mut hit = [Hit::miss()];
                single.closest(&[*ray], &mut hit);
                if hit[0].is_hit() && best.is_none_or(|b| hit[0].t < b.0) {
                    best = Some((hit[0].t, t));
                }
                continue;
            }
            let at = child as usize * WORDS;
            let corner = |k: usize| {
                Vec3::from_slice(&[0, 1, 2].map(|c| f32::from_bits(records[at + k + c])))
            };
            for (k, next) in [(0, records[at + 3]), (8, records[at + 7])] {
                let (a, b) = (
                    (corner(k) - origin) / direction,
                    (corner(k + 4) - origin) / direction,
                );
                let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
                if enter.max(0.0) <= leave {
                    stack.push(next);
                }
            }
        }
        best.map(|b| b.1)
    }

    #[test]
    fn rays_meet_what_they_meet_without_the_tree() {
        let mesh = scattered(60);
        let records = records(&mesh);
        assert_eq!(records.len(), 59 * WORDS);
        let plain = BruteForce::new(&mesh);
        let mut hits = 0;
        for i in 0..200 {
            let mut random = KeyedRng::new(1, i);
            let mut vector = || Vec3::from_array(std::array::from_fn(|_| random.next_f32()));
            let (from, to) = (vector() * 10.0, vector() * 10.0);
            let ray = Ray::new(from, (to - from).normalize(), f32::INFINITY);
            let mut hit = [Hit::miss()];
            plain.closest(&[ray], &mut hit);
            let expected = hit[0].is_hit().then_some(hit[0].triangle as usize);
            hits += usize::from(expected.is_some());
            assert_eq!(met(&records, &mesh, &ray), expected, "ray {i}");
        }
        assert!(hits > 50, "{hits}");
    }

    #[test]
    fn the_shader_has_the_stack_that_trees_are_made_for() {
        let shader = include_str!("assets/tracing.js");
        assert!(shader.contains(&format!("const STACK = {STACK};")));
    }

    #[test]
    fn meshes_of_any_size_make_a_tree_or_none() {
        assert!(records(&scattered(0)).is_empty());
        assert!(records(&scattered(1)).is_empty());
        assert_eq!(records(&scattered(2)).len(), WORDS);
        // the same triangle many times: halved, not endlessly parted
        let one = scattered(1);
        let same = Mesh {
            triangles: vec![one.triangles[0]; 5000],
            ..one
        };
        assert_eq!(records(&same).len(), 4999 * WORDS);
    }
}
