//! Shells of a mesh: triangles connected over manifold edges, and how their windings agree.
//!
//! Two triangles are neighbours if they are the only two at an edge; vertices at the same place
//! are one, whatever texture seams and creases made of them. Two neighbours wound alike run through
//! their edge in opposite directions. Called by [`crate::gbuffer::Orientation`].

use super::{Mesh, vector_key};
use glam::Vec3;

/// A triangle across a manifold edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Neighbour {
    /// The other triangle.
    pub triangle: u32,
    /// Whether both are wound alike.
    pub alike: bool,
}

/// The connected shells of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Shells {
    /// Neighbours of all triangles, one triangle after the other.
    neighbours: Vec<Neighbour>,
    /// Where those of triangle `t` begin; one more entry than triangles.
    begin: Vec<u32>,
    /// Triangles shell by shell, the first of each being its smallest.
    members: Vec<u32>,
    /// Where each shell begins in `members`; one more entry than shells.
    shell_begin: Vec<u32>,
    /// Winding relative to the shell's first triangle.
    parity: Vec<i8>,
}

impl Shells {
    /// Finds the shells of a mesh. On a shell that cannot be oriented (a Möbius band) the
    /// relative windings are those along some tree.
    #[must_use]
    pub fn of(mesh: &Mesh) -> Self {
        let n = mesh.triangles.len();
        let pairs = manifold_pairs(mesh);
        let mut begin = vec![0u32; n + 1];
        for (a, b, _) in &pairs {
            begin[*a as usize + 1] += 1;
            begin[*b as usize + 1] += 1;
        }
        for t in 0..n {
            begin[t + 1] += begin[t];
        }
        let mut next = begin.clone();
        let mut neighbours = vec![
            Neighbour {
                triangle: 0,
                alike: true
            };
            2 * pairs.len()
        ];
        let mut put = |of: u32, triangle: u32, alike: bool| {
            let at = &mut next[of as usize];
            neighbours[*at as usize] = Neighbour { triangle, alike };
            *at += 1;
        };
        for (a, b, alike) in pairs {
            put(a, b, alike);
            put(b, a, alike);
        }
        let mut shells = Self {
            neighbours,
            begin,
            members: Vec::with_capacity(n),
            shell_begin: vec![0],
            parity: vec![0; n],
        };
        for t in 0..n {
            if shells.parity[t] == 0 {
                shells.spread_from(t as u32);
            }
        }
        shells
    }

    /// Adds the shell of `first`, breadth first.
    fn spread_from(&mut self, first: u32) {
        let start = self.members.len();
        self.parity[first as usize] = 1;
        self.members.push(first);
        let mut at = start;
        while let Some(&t) = self.members.get(at) {
            for k in self.begin[t as usize]..self.begin[t as usize + 1] {
                let n = self.neighbours[k as usize];
                if self.parity[n.triangle as usize] == 0 {
                    let own = self.parity[t as usize];
                    self.parity[n.triangle as usize] = if n.alike { own } else { -own };
                    self.members.push(n.triangle);
                }
            }
            at += 1;
        }
        self.shell_begin.push(self.members.len() as u32);
    }

    /// The triangles of every shell.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.shell_begin
            .windows(2)
            .map(|w| &self.members[w[0] as usize..w[1] as usize])
    }

    /// Triangles across the manifold edges of triangle `t`, at most three.
    #[must_use]
    pub fn neighbours(&self, t: u32) -> &[Neighbour] {
        &self.neighbours[self.begin[t as usize] as usize..self.begin[t as usize + 1] as usize]
    }

    /// 1 if triangle `t` is wound like the first of its shell, −1 if against it.
    #[must_use]
    pub fn parity(&self, t: u32) -> f32 {
        f32::from(self.parity[t as usize])
    }
}

/// Pairs of triangles that alone share an edge, and whether they are wound alike.
fn manifold_pairs(mesh: &Mesh) -> Vec<(u32, u32, bool)> {
    let place = welded(&mesh.positions);
    // (lower place, higher place, triangle, from lower to higher)
    let mut edges: Vec<(u32, u32, u32, bool)> = Vec::with_capacity(3 * mesh.triangles.len());
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let p = corners.map(|i| place[i as usize]);
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            if a != b {
                edges.push((a.min(b), a.max(b), t as u32, a < b));
            }
        }
    }
    edges.sort_unstable();
    edges
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .filter_map(|around| match around {
            [a, b] if a.2 != b.2 => Some((a.2, b.2, a.3 != b.3)),
            _ => None,
        })
        .collect()
}

/// For every vertex the number of the first at the same place.
fn welded(positions: &[Vec3]) -> Vec<u32> {
    let bits = |i: u32| vector_key(positions[i as usize]);
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_unstable_by_key(|&i| (bits(i), i));
    let mut place = vec![0u32; positions.len()];
    for same in order.chunk_by(|a, b| bits(*a) == bits(*b)) {
        same.iter().for_each(|&i| place[i as usize] = same[0]);
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of `n` squares in the plane z = 0, two triangles each, no vertex shared.
    fn strip(n: usize) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..n {
            let (x, first) = (i as f32, mesh.positions.len() as u32);
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.positions.push(Vec3::new(x + dx, dy, 0.0));
            }
            mesh.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        mesh
    }

    #[test]
    fn seams_do_not_part_and_turned_triangles_are_told() {
        let mut mesh = strip(3);
        for t in [1, 4] {
            mesh.triangles[t].swap(1, 2);
        }
        let shells = Shells::of(&mesh);
        let list: Vec<&[u32]> = shells.iter().collect();
        assert_eq!(list.len(), 1);
        assert_eq!(list[0].len(), 6);
        let parity: Vec<f32> = (0..6).map(|t| shells.parity(t)).collect();
        assert_eq!(parity, [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]);
        // across the diagonal, and to the right where there is another square
        assert_eq!(shells.neighbours(0).len(), 2);
        assert_eq!(shells.neighbours(4).len(), 1);
    }

    #[test]
    fn three_triangles_at_an_edge_are_no_neighbours_and_pieces_apart_no_shell() {
        let mut mesh = strip(1);
        let first = mesh.positions.len() as u32;
        mesh.positions
            .extend([Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), Vec3::Z]);
        mesh.triangles.push([first, first + 1, first + 2]);
        assert_eq!(Shells::of(&mesh).iter().count(), 3);
        assert_eq!(Shells::of(&Mesh::default()).iter().count(), 0);
    }
}
