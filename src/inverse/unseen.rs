//! Albedo of surface that no view sees: that of the nearest seen surface of its class, going along
//! the surface and staying in the room (geodesic inpainting).
//!
//! The way is measured over cells of a few texels: cells of one class and room that touch are
//! neighbours (Dijkstra 1959). Straight distance would cross walls, and distance in the atlas means
//! nothing at all: the wall of one room has no say in the paint of the next. Class and room may
//! show nothing seen that is connected to a place; then the nearest in the room counts, and only if
//! the room shows none, the nearest anywhere. Called by the pipeline once the seen texels are settled.

use super::AlbedoEstimate;
use super::class_prior::LEAST_SPREAD;
use super::mixed_pixels::COVERAGE_ERROR;
use crate::core::geometry::Mesh;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, median, step_over_many};
use crate::core::texture::Texels;
use glam::Vec3;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};

/// A cell of one class in one room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Cell {
    class: u16,
    room: u16,
    place: [i32; 3],
}

/// What is seen in a cell: the sum of its albedos and their weight.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    albedo: Vec3,
    weight: f32,
}

/// What is known of every covered texel.
pub struct Unseen<'a> {
    /// Texels of the atlas.
    pub texels: &'a Texels,
    /// The mesh they lie on.
    pub mesh: &'a Mesh,
    /// Class of each, 0 = unlabelled.
    pub labels: &'a [u16],
    /// Room of each.
    pub rooms: &'a [u16],
    /// Whether it reflects: lamps are no guide.
    pub reflects: &'a dyn Fn(usize) -> bool,
}

impl Unseen<'_> {
    /// Gives texels whose error is not finite an albedo; returns their number. Those of a class of
    /// which nothing is seen keep theirs.
    pub fn complete(&self, albedo: &mut AlbedoEstimate, error: &[f32]) -> usize {
        let side = self.cell_side();
        let cell: Vec<Cell> = (0..self.texels.len())
            .into_par_iter()
            .map(|i| Cell {
                class: self.labels[i],
                room: self.rooms[i],
                place: (self.texels.position(self.mesh, i) / side)
                    .floor()
                    .as_ivec3()
                    .to_array(),
            })
            .collect();
        // a clean texel's variance is the least there is, that of one seen at edges alone larger by coverage's
        let clean = LEAST_SPREAD.powi(2);
        let unclean = clean / (clean + COVERAGE_ERROR.powi(2));
        let mut cells: HashMap<Cell, Sum> = HashMap::new();
        for (i, cell) in cell.iter().enumerate() {
            let sum = cells.entry(*cell).or_default();
            if error[i].is_finite() && (self.reflects)(i) {
                let weight = if albedo.clean[i] { 1.0 } else { unclean };
                sum.albedo += albedo.value[i] * weight;
                sum.weight += weight;
            }
        }
        let found = nearest(&cells.into_iter().collect());
        let mut filled = 0;
        for (i, cell) in cell.iter().enumerate() {
            if error[i].is_finite() || !(self.reflects)(i) {
                continue;
            }
            if let Some(value) = found.get(cell) {
                albedo.value[i] = *value;
                filled += 1;
            }
        }
        filled
    }

    /// The side of a square of [`ENOUGH`] texels of the usual size: a cell averages noise, but spans no wall.
    fn cell_side(&self) -> f32 {
        let stride = step_over_many(self.texels.len());
        let side = |i| self.texels.area(self.mesh, i).sqrt();
        let sides = (0..self.texels.len()).step_by(stride).map(side);
        let side = median(sides.collect()).unwrap_or(1.0);
        (ENOUGH as f32).sqrt() * side.max(f32::MIN_POSITIVE)
    }
}

/// The albedo of the nearest cell with anything seen, for every cell that has a way to one or a
/// class that is seen anywhere.
fn nearest(cells: &BTreeMap<Cell, Sum>) -> BTreeMap<Cell, Vec3> {
    let mut found: BTreeMap<Cell, Vec3> = BTreeMap::new();
    // (ways by their bits, which are in order where none is negative)
    let mut queue: BinaryHeap<Reverse<(u32, Cell, Cell)>> = cells
        .iter()
        .filter(|(_, sum)| sum.weight > 0.0)
        .map(|(cell, _)| Reverse((0, *cell, *cell)))
        .collect();
    let seen = |cell: &Cell| {
        let sum = cells.get(cell).copied().unwrap_or_default();
        sum.albedo / sum.weight.max(f32::MIN_POSITIVE)
    };
    while let Some(Reverse((way, cell, from))) = queue.pop() {
        if found.contains_key(&cell) {
            continue;
        }
        found.insert(cell, seen(&from));
        for next in around(&cell) {
            if cells.contains_key(&next.1) && !found.contains_key(&next.1) {
                let way = f32::from_bits(way) + next.0;
                queue.push(Reverse((way.to_bits(), next.1, from)));
            }
        }
    }
    let apart: Vec<Cell> = cells
        .keys()
        .filter(|c| !found.contains_key(c))
        .copied()
        .collect();
    let (mut in_room, mut anywhere) = (BTreeMap::new(), BTreeMap::new());
    if !apart.is_empty() {
        for (cell, sum) in cells.iter().filter(|(_, sum)| sum.weight > 0.0) {
            let seen = Spot::new(spot(cell), sum.albedo / sum.weight);
            let rooms: &mut Vec<Spot> = in_room.entry((cell.class, cell.room)).or_default();
            rooms.push(seen);
            let all: &mut Vec<Spot> = anywhere.entry(cell.class).or_default();
            all.push(seen);
        }
    }
    let in_room = trees(in_room);
    let anywhere = trees(anywhere);
    for cell in apart {
        let tree = in_room.get(&(cell.class, cell.room));
        let tree = tree.or_else(|| anywhere.get(&cell.class));
        if let Some(near) = tree.and_then(|t| t.nearest_neighbor(&spot(&cell))) {
            found.insert(cell, near.data);
        }
    }
    found
}

type Spot = GeomWithData<[f32; 3], Vec3>;

/// Of a cell, for the search by straight distance.
fn spot(cell: &Cell) -> [f32; 3] {
    cell.place.map(|c| c as f32)
}

fn trees<K: Ord>(lists: BTreeMap<K, Vec<Spot>>) -> BTreeMap<K, RTree<Spot>> {
    lists
        .into_iter()
        .map(|(key, list)| (key, RTree::bulk_load(list)))
        .collect()
}

/// The 26 cells around one, each with the length of the way there.
fn around(cell: &Cell) -> impl Iterator<Item = (f32, Cell)> {
    let Cell { class, room, place } = *cell;
    (0..27i32).filter(|k| *k != 13).map(move |k| {
        let step = [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1];
        let axes = step.iter().filter(|s| **s != 0).count();
        let place = [0, 1, 2].map(|a| place[a].saturating_add(step[a]));
        ((axes as f32).sqrt(), Cell { class, room, place })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    const SIDE: usize = 128;

    /// Two walls back to back, 1 cm apart, 4 m long and 1 m high: one faces room 1, the other room
    /// 2; the atlas has one above the other.
    fn two_walls() -> (Mesh, Texels, Vec<u16>) {
        let mut mesh = Mesh::default();
        for (z, row) in [(0.0, 0.0), (0.01, 0.5)] {
            let first = mesh.positions.len() as u32;
            for (x, y) in [(0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (0.0, 1.0)] {
                mesh.positions.push(Vec3::new(x, y, z));
                mesh.normals.push(Vec3::Z);
                mesh.uvs
                    .push(Vec2::new(0.02 + 0.24 * x, row + 0.02 + 0.4 * y));
            }
            mesh.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        let texels = Texels::rasterize(&mesh, SIDE, SIDE);
        let rooms = texels.point.iter().map(|p| 1 + p.triangle as u16 / 2);
        let rooms = rooms.collect();
        (mesh, texels, rooms)
    }

    #[test]
    fn paint_comes_along_the_wall_and_not_through_it() {
        let (mesh, texels, rooms) = two_walls();
        let (beige, pink) = (Vec3::new(0.7, 0.6, 0.5), Vec3::new(0.8, 0.4, 0.4));
        let n = texels.len();
        // room 1 is seen in its left half only, room 2 in its right half
        let x = |i: usize| texels.position(&mesh, i).x;
        let seen = |i: usize| (x(i) < 1.0) == (rooms[i] == 1);
        let mut albedo = AlbedoEstimate {
            value: (0..n)
                .map(|i| if rooms[i] == 1 { beige } else { pink })
                .map(|c| c * 1.0)
                .collect(),
            error: vec![0.01; n],
            looks: vec![3.0; n],
            specular_share: vec![0.0; n],
            clean: vec![true; n],
            footprint: vec![0.01; n],
        };
        let error: Vec<f32> = (0..n)
            .map(|i| if seen(i) { 0.01 } else { f32::INFINITY })
            .collect();
        (0..n)
            .filter(|&i| !seen(i))
            .for_each(|i| albedo.value[i] = Vec3::ZERO);
        let labels = vec![1; n];
        let unseen = Unseen {
            texels: &texels,
            mesh: &mesh,
            labels: &labels,
            rooms: &rooms,
            reflects: &|_| true,
        };
        let filled = unseen.complete(&mut albedo, &error);
        assert_eq!(filled, (0..n).filter(|&i| !seen(i)).count());
        for (i, (room, value)) in rooms.iter().zip(&albedo.value).enumerate() {
            let want = if *room == 1 { beige } else { pink };
            let off = (*value - want).abs().max_element();
            assert!(off < 1e-5, "room {room} at x = {}", x(i));
        }
    }

    #[test]
    fn the_nearest_along_the_way_counts_and_what_has_no_way_takes_its_rooms() {
        let cell = |room: u16, x: i32| Cell {
            class: 1,
            room,
            place: [x, 0, 0],
        };
        let seen = |v: f32| Sum {
            albedo: Vec3::splat(v),
            weight: 1.0,
        };
        let mut cells: BTreeMap<Cell, Sum> =
            (0..10).map(|x| (cell(1, x), Sum::default())).collect();
        cells.insert(cell(1, 0), seen(0.2));
        cells.insert(cell(1, 9), seen(0.8));
        // apart from all, in the same room; and a room of which nothing is seen
        cells.insert(cell(1, 40), Sum::default());
        cells.insert(cell(2, -20), Sum::default());
        let found = nearest(&cells);
        let at = |room, x| found[&cell(room, x)].x;
        assert_eq!([at(1, 3), at(1, 6), at(1, 40)], [0.2, 0.8, 0.8]);
        assert_eq!(at(2, -20), 0.2);
        cells.clear();
        cells.insert(cell(1, 0), Sum::default());
        assert!(nearest(&cells).is_empty(), "nothing is seen at all");
    }
}
