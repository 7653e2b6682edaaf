//! Rooms on the floor plan: read from a file, or found in the mesh.
//!
//! Found as people find them: a room is free floor that walls enclose, and a doorway is where a
//! wall goes on above. The wall map is therefore cut out of the mesh above door height, where
//! lintels close the doorways and furniture is out of the way (an occupancy grid: Elfes 1989). What
//! remains open is split at narrow places of its distance transform, by a watershed that fills from
//! the widest places down. All lengths scale with the storey's height, so a scene in other units
//! gives the same rooms.

use super::closets::{Surroundings, closets};
use super::input_error::as_input;
use super::wall_ends::{HALF_WALL, parted};
use super::wall_map::{Plan, storey};
use super::{RoomGrid, Scene};
use crate::core::formats;
use crate::core::image::Plane;
use crate::core::trace::Tracer;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Openings whose half width exceeds this join rooms rather than dividing them.
const WIDE: f32 = 0.8;
/// An opening this wide against the smaller side's own half width is a shape of the room, not a
/// door.
const NECK: f32 = 0.65;
/// Smallest half width of a room at its widest place.
const NARROW: f32 = 0.3;
/// Smallest floor of a room, m².
const MIN_AREA: f32 = 2.0;
/// How far room ids reach beyond the free floor, to cover the surfaces of walls and cupboards.
const REACH: f32 = 1.0;
#[derive(Deserialize)]
struct RoomsFile {
    cell: f64,
    x_min: f64,
    z_min: f64,
}

/// The JSON file beside a grid: of the same stem, else `rooms.json`.
pub(super) fn description(path: &Path) -> PathBuf {
    let own = path.with_extension("json");
    if own.is_file() {
        own
    } else {
        path.with_file_name("rooms.json")
    }
}

/// Reads a room grid: a PNG of ids and, beside it, its JSON (same stem, or `rooms.json`); its place
/// is relative to `origin`, file coordinates.
///
/// # Errors
/// One of the two is missing or damaged.
pub fn read_rooms(path: &Path, origin: DVec3) -> Result<RoomGrid> {
    let cells = formats::read_labels(path).map_err(|e| as_input(e, path, "rooms_path"))?;
    let json = description(path);
    let text = formats::read_input_text(&json).map_err(|e| {
        e.advise(
            "rooms_path needs it beside the grid with {\"cell\", \"x_min\", \"z_min\"} in metres",
        )
    })?;
    let file: RoomsFile = serde_json::from_str(&text).map_err(|e| {
        Error::input(
            &json,
            format!("{e}; expected {{\"cell\", \"x_min\", \"z_min\"}} in metres"),
        )
    })?;
    if !(file.cell > 0.0
        && file.cell.is_finite()
        && file.x_min.is_finite()
        && file.z_min.is_finite())
    {
        return Err(Error::input(
            &json,
            format!(
                "cell {} m at {}, {}; expected finite values and a positive cell",
                file.cell, file.x_min, file.z_min
            ),
        ));
    }
    let (x_min, z_min) = (
        (file.x_min - origin.x) as f32,
        (file.z_min - origin.z) as f32,
    );
    Ok(RoomGrid {
        cells,
        cell: file.cell as f32,
        x_min,
        z_min,
    })
}

impl RoomGrid {
    /// The room below or above a point: id of the grid cell it lies in, 0 outside.
    #[must_use]
    pub fn room_at(&self, point: Vec3) -> u16 {
        let (column, row) = (
            (point.x - self.x_min) / self.cell,
            (point.z - self.z_min) / self.cell,
        );
        if column >= 0.0
            && row >= 0.0
            && column < self.cells.width as f32
            && row < self.cells.height as f32
        {
            self.cells[(column as usize, row as usize)]
        } else {
            0
        }
    }

    /// The room a surface faces: a step of two cells along its normal takes walls thinner than a
    /// cell apart.
    #[must_use]
    pub fn room_of_surface(&self, point: Vec3, normal: Vec3) -> u16 {
        match self.room_at(point + normal * (2.0 * self.cell)) {
            0 => self.room_at(point),
            id => id,
        }
    }

    /// Number of rooms: the highest id.
    #[must_use]
    pub fn count(&self) -> u16 {
        self.cells.data.iter().copied().max().unwrap_or(0)
    }
}

/// Finds the rooms of a scene: ids from 1 by descending floor area; one room if nothing divides the
/// plan.
#[must_use]
pub fn find_rooms(scene: &Scene, tracer: &dyn Tracer) -> RoomGrid {
    rooms_reaching(scene, tracer, REACH)
}

/// The same rooms as a plan shows them: ids end half a wall beyond the free floor.
#[must_use]
pub fn floor_plan(scene: &Scene, tracer: &dyn Tracer) -> RoomGrid {
    rooms_reaching(scene, tracer, HALF_WALL)
}

fn rooms_reaching(scene: &Scene, tracer: &dyn Tracer, reach: f32) -> RoomGrid {
    let storey = storey(scene, tracer);
    let plan = Plan::new(scene, &storey);
    let walls = plan.walls(scene, &storey);
    let inside = plan.roofed(tracer, &storey);
    let free: Vec<bool> = walls.iter().zip(&inside).map(|(&w, &i)| !w && i).collect();
    let free = parted(&plan, &walls, free, storey.unit);
    let mut labels = watershed(&plan, &free, storey.unit);
    let lonely = merge_small(&plan, &mut labels, storey.unit);
    let around = Surroundings {
        plan: &plan,
        storey: &storey,
        mesh: &scene.mesh,
        tracer,
    };
    let closets = closets(&around, &labels, &lonely);
    let vanish = |l: &&mut u32| lonely.contains(*l) && !closets.contains(*l);
    labels.iter_mut().filter(vanish).for_each(|l| *l = 0);
    renumber(&mut labels);
    if labels.iter().all(|&l| l == 0) {
        // no enclosed floor found: everything is one room, which is always a valid answer
        labels.iter_mut().for_each(|l| *l = 1);
    } else {
        spread(
            &plan,
            &mut labels,
            (reach * storey.unit / plan.cell).ceil() as usize,
        );
    }
    let cells = Plane {
        width: plan.width,
        height: plan.height,
        data: labels
            .into_iter()
            .map(|l| l.min(u32::from(u16::MAX)) as u16)
            .collect(),
    };
    RoomGrid {
        cells,
        cell: plan.cell,
        x_min: plan.min.x,
        z_min: plan.min.y,
    }
}

/// Euclidean distance to the nearest cell that is not free, in cells (Felzenszwalb and Huttenlocher
/// 2012: parabolas per axis).
fn distance(plan: &Plan, free: &[bool]) -> Vec<f32> {
    const FAR: f64 = 1e12;
    let (w, h) = (plan.width, plan.height);
    let mut squared: Vec<f64> = free.iter().map(|&f| if f { FAR } else { 0.0 }).collect();
    let mut line = vec![0.0f64; w.max(h)];
    for x in 0..w {
        for y in 0..h {
            line[y] = squared[y * w + x];
        }
        let out = lower_envelope(&line[..h]);
        for y in 0..h {
            squared[y * w + x] = out[y];
        }
    }
    for y in 0..h {
        let out = lower_envelope(&squared[y * w..(y + 1) * w]);
        squared[y * w..(y + 1) * w].copy_from_slice(&out);
    }
    squared.into_iter().map(|d| d.sqrt() as f32).collect()
}

/// min over q of (p − q)² + f(q) for every p.
fn lower_envelope(f: &[f64]) -> Vec<f64> {
    let n = f.len();
    let (mut sites, mut from) = (vec![0usize; n], vec![f64::NEG_INFINITY; n + 1]);
    let mut k = 0;
    for q in 1..n {
        loop {
            let (qf, v) = (q as f64, sites[k] as f64);
            let s = ((f[q] + qf * qf) - (f[sites[k]] + v * v)) / (2.0 * (qf - v));
            if s > from[k] || k == 0 {
                if s <= from[k] {
                    sites[0] = q;
                    from[1] = f64::INFINITY;
                } else {
                    k += 1;
                    sites[k] = q;
                    from[k] = s;
                    from[k + 1] = f64::INFINITY;
                }
                break;
            }
            k -= 1;
        }
    }
    let last = k;
    let mut k = 0;
    (0..n)
        .map(|p| {
            while k < last && from[k + 1] < p as f64 {
                k += 1;
            }
            let d = p as f64 - sites[k] as f64;
            d * d + f[sites[k]]
        })
        .collect()
}

/// Regions of the free floor (ids from 1), split where an opening is narrow against both sides.
fn watershed(plan: &Plan, free: &[bool], unit: f32) -> Vec<u32> {
    let distances = distance(plan, free);
    let mut order: Vec<u32> = (0..plan.len() as u32)
        .filter(|&i| free[i as usize])
        .collect();
    order.sort_by(|&a, &b| {
        distances[b as usize]
            .total_cmp(&distances[a as usize])
            .then(a.cmp(&b))
    });
    let wide = WIDE * unit / plan.cell;
    let mut labels = vec![0u32; plan.len()];
    let (mut parent, mut peak) = (vec![0u32], vec![0.0f32]);
    for &i in &order {
        let (i, d) = (i as usize, distances[i as usize]);
        // the basin of the neighbour uphill takes the cell: following the wider side keeps basins
        // from leaking along walls
        let mut own = 0u32;
        let mut uphill = f32::NEG_INFINITY;
        for n in plan.neighbours(i).filter(|&n| labels[n] != 0) {
            let other = root(&mut parent, labels[n]);
            if own != 0 && own != other {
                let (low, high) = if peak[own as usize] < peak[other as usize] {
                    (own, other)
                } else {
                    (other, own)
                };
                // the cell is on the widest passage between two basins still unjoined: d is at most
                // its half width
                if d >= wide || d >= NECK * peak[low as usize] {
                    parent[low as usize] = high;
                    own = high;
                    uphill = uphill.max(distances[n]);
                    continue;
                }
            }
            if distances[n] > uphill {
                uphill = distances[n];
                own = root(&mut parent, other);
            }
        }
        if own == 0 {
            own = parent.len() as u32;
            parent.push(own);
            peak.push(d);
        }
        labels[i] = own;
    }
    // a strip narrower than a door on both sides is the inside of a wall
    let narrow = NARROW * unit / plan.cell;
    labels.iter_mut().filter(|l| **l != 0).for_each(|l| {
        let r = root(&mut parent, *l);
        *l = if peak[r as usize] < narrow { 0 } else { r };
    });
    labels
}

fn root(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        parent[i as usize] = parent[parent[i as usize] as usize];
        i = parent[i as usize];
    }
    i
}

/// Joins regions too small for a room with the neighbour they share the longest border with; those that
/// nothing borders on.
fn merge_small(plan: &Plan, labels: &mut [u32], unit: f32) -> BTreeSet<u32> {
    let min_cells = (MIN_AREA * unit * unit / (plan.cell * plan.cell)) as usize;
    let mut lonely = BTreeSet::new();
    loop {
        let mut area = std::collections::BTreeMap::<u32, usize>::new();
        labels
            .iter()
            .filter(|l| **l != 0)
            .for_each(|l| *area.entry(*l).or_default() += 1);
        let Some((&small, _)) = area
            .iter()
            .filter(|(l, a)| **a < min_cells && !lonely.contains(*l))
            .min_by_key(|(l, a)| (**a, **l))
        else {
            return lonely;
        };
        let mut border = std::collections::BTreeMap::<u32, usize>::new();
        for i in 0..labels.len() {
            if labels[i] == small {
                plan.neighbours(i)
                    .map(|n| labels[n])
                    .filter(|&l| l != 0 && l != small)
                    .for_each(|l| *border.entry(l).or_default() += 1);
            }
        }
        let longest = border
            .iter()
            .max_by_key(|(l, n)| (**n, std::cmp::Reverse(**l)));
        let Some((&target, _)) = longest else {
            lonely.insert(small);
            continue;
        };
        labels
            .iter_mut()
            .filter(|l| **l == small)
            .for_each(|l| *l = target);
    }
}

/// Ids 1, 2, … by descending area.
fn renumber(labels: &mut [u32]) {
    let mut area = std::collections::BTreeMap::<u32, usize>::new();
    labels
        .iter()
        .filter(|l| **l != 0)
        .for_each(|l| *area.entry(*l).or_default() += 1);
    let mut order: Vec<(u32, usize)> = area.into_iter().collect();
    order.sort_by_key(|&(l, a)| (std::cmp::Reverse(a), l));
    let ids: std::collections::BTreeMap<u32, u32> = order
        .iter()
        .enumerate()
        .map(|(i, (l, _))| (*l, i as u32 + 1))
        .collect();
    labels
        .iter_mut()
        .filter(|l| **l != 0)
        .for_each(|l| *l = ids[&*l]);
}

/// Lets ids grow by `steps` cells into what has none: wall surfaces belong to the room they face.
fn spread(plan: &Plan, labels: &mut [u32], steps: usize) {
    let mut front: Vec<usize> = (0..plan.len()).filter(|&i| labels[i] != 0).collect();
    for _ in 0..steps {
        let mut next = Vec::new();
        for &i in &front {
            for n in plan.neighbours(i) {
                if labels[n] == 0 {
                    labels[n] = labels[i];
                    next.push(n);
                }
            }
        }
        front = next;
    }
}
