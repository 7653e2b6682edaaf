//! The surface where a sampled function is zero, as squares: one vertex in every cell of the grid
//! that it crosses, at the mean of the crossings of the cell's edges, and a square across every edge
//! that it crosses (Gibson 1998, "Constrained Elastic Surface Nets", MICCAI, without relaxation).
//! Cells of which a corner is unknown have no vertex: the surface ends where nothing is known. Called
//! by `depth_mesh`.

use glam::{IVec3, Vec3};
use std::collections::BTreeMap;

/// A surface of squares.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Net {
    /// Places, in units of the grid.
    pub positions: Vec<Vec3>,
    /// Corners, wound so that the function grows along their normals.
    pub squares: Vec<[u32; 4]>,
}

/// What is known at a point of the grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Distance to the surface in units of the grid, negative inside.
    pub distance: f32,
    /// Share of the evidence for inside, 0 to 1; above a half where the distance is negative.
    pub inside: f32,
}

/// Change of a distance from point to point beyond which it is not one surface's. Derived: a distance
/// changes by no more than the points' own; half of that again for its error.
const JUMP: f32 = 1.5;

impl Sample {
    fn is_inside(self) -> bool {
        self.distance < 0.0
    }

    /// Where on the way to `other` the surface is, 0 to 1: where the distance is zero, or at an outline,
    /// where distances of different surfaces meet, where half of the evidence is for inside.
    fn crossing(self, other: Self) -> f32 {
        let (here, there) = (self.inside - 0.5, other.inside - 0.5);
        let jumps = (self.distance - other.distance).abs() > JUMP && here * there < 0.0;
        let [a, b] = match jumps {
            true => [here, there],
            false => [self.distance, other.distance],
        };
        a / (a - b)
    }
}

/// The zero of a function known at some points of the grid, which `known` lists in ascending order.
#[must_use]
pub fn surface_net(known: &[IVec3], value: impl Fn(IVec3) -> Option<Sample>) -> Net {
    let mut net = Net::default();
    let mut vertex: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    for &cell in known {
        if let Some(place) = crossing(cell, &value) {
            vertex.insert(cell.to_array(), net.positions.len() as u32);
            net.positions.push(place);
        }
    }
    for &p in known {
        for axis in 0..3 {
            let (x, y, z) = (unit(axis), unit((axis + 1) % 3), unit((axis + 2) % 3));
            let (Some(a), Some(b)) = (value(p), value(p + x)) else {
                continue;
            };
            if a.is_inside() == b.is_inside() {
                continue;
            }
            // the four cells around the edge, counter-clockwise seen against its direction
            let around = [p - y - z, p - z, p, p - y];
            let corners = around.map(|c| vertex.get(&c.to_array()).copied());
            let [Some(i), Some(j), Some(k), Some(l)] = corners else {
                continue;
            };
            let square = if a.is_inside() {
                [i, j, k, l]
            } else {
                [i, l, k, j]
            };
            net.squares.push(square);
        }
    }
    net
}

fn unit(axis: usize) -> IVec3 {
    [IVec3::X, IVec3::Y, IVec3::Z][axis]
}

/// Mean of the points where the edges of a cell cross zero; `None` where none does or a corner is
/// unknown.
fn crossing(cell: IVec3, value: &impl Fn(IVec3) -> Option<Sample>) -> Option<Vec3> {
    let corner = |k: i32| IVec3::new(k & 1, k >> 1 & 1, k >> 2);
    let mut values = [Sample::default(); 8];
    for (k, v) in values.iter_mut().enumerate() {
        *v = value(cell + corner(k as i32))?;
    }
    let (mut sum, mut count) = (Vec3::ZERO, 0.0f32);
    for a in 0..8usize {
        for axis in 0..3 {
            let b = a | 1 << axis;
            if a == b || values[a].is_inside() == values[b].is_inside() {
                continue;
            }
            let t = values[a].crossing(values[b]);
            let [from, to] = [a, b].map(|k| (cell + corner(k as i32)).as_vec3());
            sum += from.lerp(to, t);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(distance: f32) -> Sample {
        let inside = f32::from(distance < 0.0);
        Sample { distance, inside }
    }

    /// At an outline the surface is where half of the evidence is for inside, whatever the distances.
    #[test]
    fn outlines_lie_where_half_the_evidence_is() {
        let [a, b] =
            [(-0.1, 0.75), (3.0, 0.0)].map(|(distance, inside)| Sample { distance, inside });
        assert!((a.crossing(b) - 1.0 / 3.0).abs() < 1e-6);
        let near = Sample {
            distance: 0.3,
            inside: 0.0,
        };
        assert!((a.crossing(near) - 0.25).abs() < 1e-6, "one surface");
    }

    /// A ball: closed, every edge shared by two squares, wound outwards, at its radius; cut where
    /// nothing is known.
    #[test]
    fn a_ball_is_closed_and_faces_out_and_ends_where_nothing_is_known() {
        let n = 12;
        let known: Vec<IVec3> = (-n..=n)
            .flat_map(|x| (-n..=n).flat_map(move |y| (-n..=n).map(move |z| IVec3::new(x, y, z))))
            .collect();
        let ball = |p: IVec3| Some(sample(p.as_vec3().length() - 8.0));
        let net = surface_net(&known, ball);
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for t in &net.squares {
            let [a, b, c, d] = t.map(|i| net.positions[i as usize]);
            assert!((c - a).cross(d - b).dot(a + b + c + d) > 0.0, "outwards");
            for k in 0..4 {
                let (a, b) = (t[k], t[(k + 1) % 4]);
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|n| *n == 0), "closed");
        assert!(net.positions.iter().all(|p| (p.length() - 8.0).abs() < 0.2));
        let half: Vec<IVec3> = known.into_iter().filter(|p| p.x <= 0).collect();
        let cut = surface_net(&half, |p| ball(p).filter(|_| p.x <= 0));
        assert!(cut.positions.iter().all(|p| p.x <= 0.0) && !cut.squares.is_empty());
    }
}
