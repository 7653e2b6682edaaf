//! Triangles that belong together because they touch or nearly so: the pieces of one lamp.

use super::Mesh;
use glam::{Vec2, Vec3};
use std::collections::{BTreeMap, HashMap};

/// Vertices closer than this share of the gap are one.
const WELD: f32 = 2e-3;

/// Groups of `triangles` that share a corner, or whose bounding boxes lie at most `gap` apart (in
/// the mesh's unit). Each group lists its triangles in the order given; groups are in the order of
/// their first triangle.
#[must_use]
pub fn clusters(mesh: &Mesh, triangles: &[u32], gap: f32) -> Vec<Vec<u32>> {
    let parts = welded(mesh, triangles, WELD * gap);
    let boxes: Vec<(Vec3, Vec3)> = parts
        .iter()
        .map(|part| {
            let corners = part
                .iter()
                .flat_map(|&k| mesh.corners(triangles[k] as usize));
            corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| {
                (b.0.min(p), b.1.max(p))
            })
        })
        .collect();
    let mut near = Sets::new(parts.len());
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order.sort_by(|&a, &b| boxes[a].0.x.total_cmp(&boxes[b].0.x));
    for (i, &a) in order.iter().enumerate() {
        for &b in order[i + 1..]
            .iter()
            .take_while(|&&b| boxes[b].0.x <= boxes[a].1.x + gap)
        {
            if (boxes[a].0 - boxes[b].1)
                .max(boxes[b].0 - boxes[a].1)
                .max_element()
                <= gap
            {
                near.join(a, b);
            }
        }
    }
    let whole = |group: Vec<usize>| {
        let mut members: Vec<usize> = group
            .into_iter()
            .flat_map(|p| parts[p].iter().copied())
            .collect();
        members.sort_unstable();
        members.into_iter().map(|k| triangles[k]).collect()
    };
    near.members().into_iter().map(whole).collect()
}

/// Groups of `triangles` that share a corner, corners at most about `weld` apart being one. Each
/// group lists its triangles in the order given; groups are in the order of their first triangle.
#[must_use]
pub fn touching(mesh: &Mesh, triangles: &[u32], weld: f32) -> Vec<Vec<u32>> {
    welded(mesh, triangles, weld)
        .into_iter()
        .map(|group| group.into_iter().map(|k| triangles[k]).collect())
        .collect()
}

/// [`touching`], as places in the list `triangles`.
fn welded(mesh: &Mesh, triangles: &[u32], weld: f32) -> Vec<Vec<usize>> {
    let mut touching = Sets::new(triangles.len());
    let mut at: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    for (k, &t) in triangles.iter().enumerate() {
        for p in mesh.corners(t as usize) {
            let key = (p / weld.max(f32::MIN_POSITIVE))
                .round()
                .to_array()
                .map(|x| x as i64);
            touching.join(k, *at.entry(key).or_insert(k));
        }
    }
    touching.members()
}

/// For every triangle the number of its piece: what vertices hold together, texture seams and sharp
/// edges apart. Pieces are numbered from 0.
#[must_use]
pub fn pieces(mesh: &Mesh) -> Vec<u32> {
    held_together(mesh, Sets::new(mesh.positions.len()))
}

/// For every triangle the number of its body: what vertices at one place hold together. Bodies are
/// numbered from 0.
#[must_use]
pub fn bodies(mesh: &Mesh) -> Vec<u32> {
    let places = mesh.positions.iter().map(|p| (*p + Vec3::ZERO).to_array());
    held_together(mesh, Sets::of_places(places))
}

/// For every triangle the number of its chart: what corners at one place of the atlas hold together.
/// Charts are numbered from 0 in the order of their first triangles.
#[must_use]
pub fn charts(mesh: &Mesh) -> Vec<u32> {
    let places = mesh.uvs.iter().map(|uv| (*uv + Vec2::ZERO).to_array());
    held_together(mesh, Sets::of_places(places))
}

/// For every triangle the number of what its corners hold together, beside the sets that vertices
/// form already.
fn held_together(mesh: &Mesh, mut of_vertex: Sets) -> Vec<u32> {
    for [a, b, c] in &mesh.triangles {
        of_vertex.join(*a as usize, *b as usize);
        of_vertex.join(*a as usize, *c as usize);
    }
    let roots = mesh.triangles.iter().map(|t| of_vertex.root(t[0] as usize));
    numbered(roots)
}

/// For every triangle the number of its smooth patch: what edges hold together across which the face
/// turns by less than `cosine` says, whichever way its triangles are wound. Patches are numbered from
/// 0 in the order of their first triangles.
#[must_use]
pub fn smooth_patches(mesh: &Mesh, cosine: f32) -> Vec<u32> {
    let mut patches = Sets::new(mesh.triangles.len());
    let mut at: HashMap<[u32; 2], usize> = HashMap::new();
    for (t, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let other = *at.entry([from.min(to), from.max(to)]).or_insert(t);
            if mesh.face_normal(t).dot(mesh.face_normal(other)).abs() > cosine {
                patches.join(t, other);
            }
        }
    }
    numbered((0..mesh.triangles.len()).map(|t| patches.root(t)))
}

/// Numbers from 0 in the place of keys, in the order of their first use.
pub fn numbered(keys: impl IntoIterator<Item = usize>) -> Vec<u32> {
    let mut number = BTreeMap::new();
    keys.into_iter()
        .map(|key| {
            let next = number.len() as u32;
            *number.entry(key).or_insert(next)
        })
        .collect()
}

/// Disjoint sets of numbers; the root of a set is its smallest member.
struct Sets(Vec<usize>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    /// Those that are at one place to the bit; 0 must not be −0.
    fn of_places<const N: usize>(places: impl ExactSizeIterator<Item = [f32; N]>) -> Self {
        let mut sets = Self::new(places.len());
        let mut at: HashMap<[u32; N], usize> = HashMap::with_capacity(places.len());
        for (i, place) in places.enumerate() {
            sets.join(i, *at.entry(place.map(f32::to_bits)).or_insert(i));
        }
        sets
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }

    /// The sets, by their smallest member.
    fn members(mut self) -> Vec<Vec<usize>> {
        let mut out: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for i in 0..self.0.len() {
            out.entry(self.root(i)).or_default().push(i);
        }
        out.into_values().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// Two triangles that share an edge by vertices of their own, as at a texture's seam, and one apart.
    #[test]
    fn a_body_holds_together_across_seams() {
        let corners = [
            [Vec3::ZERO, Vec3::X, Vec3::Y],
            [Vec3::Y, -Vec3::ZERO + Vec3::X, Vec3::ONE],
            [Vec3::Z * 5.0, Vec3::X * 5.0, Vec3::Y * 5.0],
        ];
        let mesh = Mesh {
            positions: corners.concat(),
            triangles: (0..3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            ..Mesh::default()
        };
        assert_eq!(bodies(&mesh), [0, 0, 1]);
        assert_eq!(pieces(&mesh), [0, 1, 2]);
    }

    /// A ridge of four triangles: two fall to one side, two to the other, one of them wound the other
    /// way; a fifth lies apart.
    #[test]
    fn a_sharp_edge_divides_patches_and_winding_does_not() {
        let heights = |steep: f32| {
            [
                Vec3::new(-1.0, -steep, 0.0),
                Vec3::new(-1.0, -steep, 1.0),
                Vec3::ZERO,
                Vec3::Z,
                Vec3::new(1.0, -steep, 0.0),
                Vec3::new(1.0, -steep, 1.0),
                Vec3::X * 5.0,
                Vec3::X * 6.0,
                Vec3::new(5.0, 0.0, 1.0),
            ]
        };
        let mesh = |steep| Mesh {
            positions: heights(steep).to_vec(),
            normals: vec![Vec3::Y; 9],
            uvs: vec![Vec2::ZERO; 9],
            triangles: vec![[0, 1, 2], [2, 1, 3], [4, 2, 3], [4, 3, 5], [6, 8, 7]],
        };
        assert_eq!(smooth_patches(&mesh(1.0), 0.87), [0, 0, 1, 1, 2]);
        assert_eq!(smooth_patches(&mesh(0.1), 0.87), [0, 0, 0, 0, 1]);
    }

    /// Unit right triangles at the given places.
    fn triangles_at(places: &[Vec3]) -> Mesh {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Z];
        let positions: Vec<Vec3> = places
            .iter()
            .flat_map(|p| corners.map(|c| *p + c))
            .collect();
        let n = positions.len();
        Mesh {
            positions,
            normals: vec![Vec3::NEG_Y; n],
            uvs: vec![Vec2::ZERO; n],
            triangles: (0..places.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
        }
    }

    #[test]
    fn corners_and_short_gaps_join_and_long_gaps_part() {
        // 0 and 2 share a corner, 3 lies 4 cm above 2, 1 stands alone
        let mesh = triangles_at(&[
            Vec3::ZERO,
            Vec3::X * 20.0,
            Vec3::X,
            Vec3::new(1.0, 0.04, 0.0),
        ]);
        assert_eq!(
            clusters(&mesh, &[0, 1, 2, 3], 0.05),
            [vec![0, 2, 3], vec![1]]
        );
        assert_eq!(
            clusters(&mesh, &[0, 1, 2, 3], 0.03),
            [vec![0, 2], vec![1], vec![3]]
        );
        assert_eq!(clusters(&mesh, &[3, 1], 0.05), [vec![3], vec![1]]);
        assert!(clusters(&mesh, &[], 0.05).is_empty());
        // boxes that lie close do not touch
        assert_eq!(
            touching(&mesh, &[3, 0, 2, 1], 1e-4),
            [vec![3], vec![0, 2], vec![1]]
        );
    }

    #[test]
    fn pieces_are_held_together_by_vertices_and_not_by_places() {
        let mut mesh = triangles_at(&[Vec3::ZERO, Vec3::ZERO, 5.0 * Vec3::X, Vec3::Y]);
        mesh.triangles[3] = [
            mesh.triangles[0][1],
            mesh.triangles[3][1],
            mesh.triangles[3][2],
        ];
        assert_eq!(pieces(&mesh), [0, 1, 2, 0]);
        assert!(pieces(&triangles_at(&[])).is_empty());
    }
}
