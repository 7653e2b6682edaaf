//! Floor plans: rooms extruded to shells with doors and windows, and the grid of room ids.
//!
//! A wall is cut into cells at the ends and edges of its openings; a cell inside a passage is left
//! out, one inside a door or window takes that class. Floors and ceilings are triangulated by
//! `earcut` (the port of Mapbox's earcut, the one most programs use). Called by `zind`.

use super::capture::{LabelledMesh, RoomIds, RoomOutline};
use crate::core::image::Plane;
use glam::{DVec2, DVec3};

/// Cuts nearer than this are one: below what any annotation resolves (derived: a tenth of a pixel
/// of a 2048-pixel panorama at 3 m is 0.9 mm).
const SAME_CUT: f64 = 1e-3;
/// An opening lies on the wall whose line it misses by less than this, metres (cited: ZInD's
/// layouts snap openings to walls; half a wall's thickness separates two rooms).
const ON_WALL: f64 = 0.1;
/// Cell of the room grid, metres: that of `unbake synth`.
pub const ROOM_CELL: f64 = 0.05;
/// How far ids reach beyond the outline, metres: half a thick inner wall, so that a wall's surface
/// belongs to the room it faces.
const REACH: f64 = 0.15;
/// Cells along one side at most; a larger plan gets larger cells.
const MAX_SIDE: f64 = 4096.0;

/// A hole, door leaf or window pane in a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Its ends on the plan.
    pub ends: [DVec2; 2],
    /// Lower and upper edge above the floor.
    pub heights: [f64; 2],
    /// Class of the pane.
    pub class: u16,
    /// Nothing fills it: it leads into another room.
    pub passage: bool,
}

/// A room to extrude: z is up, the plan is (x, y).
#[derive(Clone, Debug, PartialEq)]
pub struct Shell {
    /// Closed polygon of either orientation.
    pub corners: Vec<DVec2>,
    /// Height of the ceiling above the floor at z = 0.
    pub height: f64,
    /// What is in its walls.
    pub openings: Vec<Opening>,
}

/// Class ids of a shell's parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShellClasses {
    /// Floor.
    pub floor: u16,
    /// Ceiling.
    pub ceiling: u16,
    /// Wall.
    pub wall: u16,
}

/// Adds a room's floor, ceiling and walls, facing inwards; returns the number of openings that lie
/// on no wall.
pub fn extrude(shell: &Shell, classes: ShellClasses, into: &mut LabelledMesh) -> usize {
    let mut corners = shell.corners.clone();
    if area(&corners) < 0.0 {
        corners.reverse();
    }
    let mut triangles: Vec<u32> = Vec::new();
    earcut::Earcut::new().earcut(
        corners.iter().map(|c| c.to_array()),
        &[] as &[u32],
        &mut triangles,
    );
    for (z, class) in [(0.0, classes.floor), (shell.height, classes.ceiling)] {
        let first = into.mesh.positions.len() as u32;
        into.mesh
            .positions
            .extend(corners.iter().map(|c| c.extend(z)));
        for t in triangles.chunks_exact(3) {
            // earcut keeps the polygon's orientation or turns it as a whole: ask the triangle
            let [a, b, c] = [t[0], t[1], t[2]].map(|i| corners[i as usize]);
            let up = (b - a).perp_dot(c - a) > 0.0;
            let (b, c) = if up == (z == 0.0) {
                (t[1], t[2])
            } else {
                (t[2], t[1])
            };
            into.mesh.triangles.push([t[0], b, c].map(|i| i + first));
            into.classes.push(class);
        }
    }
    let walls: Vec<[DVec2; 2]> = (0..corners.len())
        .map(|i| [corners[i], corners[(i + 1) % corners.len()]])
        .collect();
    let (mut on_wall, mut lost) = (vec![Vec::new(); walls.len()], 0);
    for opening in &shell.openings {
        match nearest_wall(&walls, opening) {
            Some(w) => on_wall[w].push(*opening),
            None => lost += 1,
        }
    }
    for (wall, openings) in walls.iter().zip(&on_wall) {
        add_wall(*wall, openings, shell.height, classes.wall, into);
    }
    lost
}

/// Twice the signed area would do as well: positive if counter-clockwise.
fn area(corners: &[DVec2]) -> f64 {
    let n = corners.len();
    0.5 * (0..n)
        .map(|i| corners[i].perp_dot(corners[(i + 1) % n]))
        .sum::<f64>()
}

/// The wall both ends of an opening lie nearest to.
fn nearest_wall(walls: &[[DVec2; 2]], opening: &Opening) -> Option<usize> {
    walls
        .iter()
        .map(|[a, b]| {
            opening
                .ends
                .iter()
                .map(|&p| distance(p, *a, *b))
                .fold(0.0, f64::max)
        })
        .enumerate()
        .min_by(|x, y| x.1.total_cmp(&y.1))
        .filter(|&(_, d)| d < ON_WALL)
        .map(|(i, _)| i)
}

/// Distance of a point from a segment.
fn distance(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    let d = b - a;
    let t = (p - a).dot(d) / d.length_squared().max(f64::MIN_POSITIVE);
    (p - a - d * t.clamp(0.0, 1.0)).length()
}

fn add_wall(
    [a, b]: [DVec2; 2],
    openings: &[Opening],
    height: f64,
    wall: u16,
    into: &mut LabelledMesh,
) {
    let length = (b - a).length();
    if length < SAME_CUT {
        return;
    }
    let direction = (b - a) / length;
    let along = |o: &Opening| {
        let [u, v] = o.ends.map(|p| (p - a).dot(direction));
        [u.min(v), u.max(v)]
    };
    let columns = cuts(length, openings.iter().flat_map(along));
    let rows = cuts(height, openings.iter().flat_map(|o| o.heights));
    for u in columns.windows(2) {
        for z in rows.windows(2) {
            let middle = [0.5 * (u[0] + u[1]), 0.5 * (z[0] + z[1])];
            let inside = |o: &&Opening| {
                let [u0, u1] = along(o);
                let [z0, z1] = o.heights;
                (u0..u1).contains(&middle[0]) && (z0..z1).contains(&middle[1])
            };
            let within: Vec<&Opening> = openings.iter().filter(inside).collect();
            if within.iter().any(|o| o.passage) {
                continue;
            }
            let class = within.first().map_or(wall, |o| o.class);
            let at = |u: f64, z: f64| (a + direction * u).extend(z);
            add_quad(
                [
                    at(u[1], z[0]),
                    at(u[0], z[0]),
                    at(u[0], z[1]),
                    at(u[1], z[1]),
                ],
                class,
                into,
            );
        }
    }
}

/// 0, `end` and the values between them, ascending, none twice.
fn cuts(end: f64, values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut cuts: Vec<f64> = values
        .filter(|v| (SAME_CUT..end - SAME_CUT).contains(v))
        .collect();
    cuts.sort_by(f64::total_cmp);
    cuts.dedup_by(|a, b| *a - *b < SAME_CUT);
    cuts.insert(0, 0.0);
    cuts.push(end);
    cuts
}

fn add_quad(corners: [DVec3; 4], class: u16, into: &mut LabelledMesh) {
    let first = into.mesh.positions.len() as u32;
    into.mesh.positions.extend(corners);
    for t in [[0, 1, 2], [0, 2, 3]] {
        into.mesh.triangles.push(t.map(|i| i + first));
        into.classes.push(class);
    }
}

/// Rasterises outlines; `None` without any area.
#[must_use]
pub fn room_ids(outlines: &[RoomOutline]) -> Option<RoomIds> {
    let all = || outlines.iter().flat_map(|o| &o.corners);
    let lo = all().copied().reduce(DVec2::min)? - REACH - ROOM_CELL;
    let hi = all().copied().reduce(DVec2::max)? + REACH + ROOM_CELL;
    let extent = (hi - lo).max_element();
    if !(extent.is_finite() && extent > 0.0) {
        return None;
    }
    let cell = ROOM_CELL.max(extent / MAX_SIDE);
    let (width, height) = (
        ((hi.x - lo.x) / cell).ceil() as usize,
        ((hi.y - lo.y) / cell).ceil() as usize,
    );
    let mut cells = Plane::filled(width, height, 0u16);
    for y in 0..height {
        for x in 0..width {
            let p = lo + DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * cell;
            cells[(x, y)] = room_of(outlines, p);
        }
    }
    Some(RoomIds {
        cells,
        cell,
        min: lo,
    })
}

/// The outline a point lies in, else the nearest within reach.
fn room_of(outlines: &[RoomOutline], p: DVec2) -> u16 {
    if let Some(i) = outlines.iter().position(|o| contains(&o.corners, p)) {
        return (i + 1) as u16;
    }
    let edge = |o: &RoomOutline| {
        let n = o.corners.len();
        (0..n)
            .map(|i| distance(p, o.corners[i], o.corners[(i + 1) % n]))
            .fold(f64::INFINITY, f64::min)
    };
    outlines
        .iter()
        .map(edge)
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|&(_, d)| d < REACH)
        .map_or(0, |(i, _)| (i + 1) as u16)
}

/// Even-odd rule.
fn contains(corners: &[DVec2], p: DVec2) -> bool {
    let n = corners.len();
    (0..n)
        .filter(|&i| {
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x)
        })
        .count()
        % 2
        == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLASSES: ShellClasses = ShellClasses {
        floor: 1,
        ceiling: 2,
        wall: 3,
    };

    fn l_shaped() -> Vec<DVec2> {
        [
            (0.0, 0.0),
            (4.0, 0.0),
            (4.0, 2.0),
            (2.0, 2.0),
            (2.0, 5.0),
            (0.0, 5.0),
        ]
        .map(DVec2::from)
        .to_vec()
    }

    /// Volume by the divergence theorem; inward faces make it negative.
    fn volume(m: &LabelledMesh) -> f64 {
        let corners = |t: &[u32; 3]| t.map(|i| m.mesh.positions[i as usize]);
        m.mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = corners(t);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    fn area_of(m: &LabelledMesh, class: u16) -> f64 {
        let triangle = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| m.mesh.positions[i as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        m.mesh
            .triangles
            .iter()
            .zip(&m.classes)
            .filter(|(_, c)| **c == class)
            .map(|(t, _)| triangle(t))
            .sum()
    }

    #[test]
    fn a_shell_is_closed_and_faces_inwards_whatever_the_orientation() {
        for reverse in [false, true] {
            let mut corners = l_shaped();
            if reverse {
                corners.reverse();
            }
            let shell = Shell {
                corners,
                height: 2.5,
                openings: vec![],
            };
            let mut mesh = LabelledMesh::default();
            assert_eq!(extrude(&shell, CLASSES, &mut mesh), 0);
            assert!(
                (volume(&mesh) + 14.0 * 2.5).abs() < 1e-9,
                "{}",
                volume(&mesh)
            );
            assert!((area_of(&mesh, 1) - 14.0).abs() < 1e-9);
            assert!((area_of(&mesh, 3) - 18.0 * 2.5).abs() < 1e-9);
        }
    }

    #[test]
    fn passages_are_holes_and_windows_panes() {
        let door = Opening {
            ends: [DVec2::new(1.0, 0.02), DVec2::new(2.0, -0.01)],
            heights: [0.0, 2.0],
            class: 4,
            passage: true,
        };
        let window = Opening {
            ends: [DVec2::new(0.0, 3.0), DVec2::new(0.0, 1.0)],
            heights: [0.9, 1.9],
            class: 5,
            passage: false,
        };
        let far = Opening {
            ends: [DVec2::new(9.0, 3.0), DVec2::new(9.0, 1.0)],
            ..window
        };
        let shell = Shell {
            corners: l_shaped(),
            height: 2.5,
            openings: vec![door, window, far],
        };
        let mut mesh = LabelledMesh::default();
        assert_eq!(
            extrude(&shell, CLASSES, &mut mesh),
            1,
            "one lies on no wall"
        );
        assert!((area_of(&mesh, 5) - 2.0).abs() < 1e-9);
        assert!((area_of(&mesh, 4)).abs() < 1e-9);
        assert!((area_of(&mesh, 3) - (45.0 - 2.0 - 2.0)).abs() < 1e-9);
    }

    #[test]
    fn room_ids_reach_over_the_wall_and_no_further() {
        let square = |x: f64, name: &str| RoomOutline {
            name: name.into(),
            corners: [(x, 0.0), (x + 3.0, 0.0), (x + 3.0, 3.0), (x, 3.0)]
                .map(DVec2::from)
                .to_vec(),
        };
        let ids = room_ids(&[square(0.0, "a"), square(3.1, "b")]).expect("a plan");
        let at = |x: f64, z: f64| {
            let p = (DVec2::new(x, z) - ids.min) / ids.cell;
            ids.cells[(p.x as usize, p.y as usize)]
        };
        assert_eq!((at(1.0, 1.0), at(4.0, 2.9)), (1, 2));
        assert_eq!((at(3.02, 1.0), at(3.08, 1.0)), (1, 2));
        assert_eq!(at(-0.17, 1.0), 0);
        assert!(room_ids(&[]).is_none());
    }
}
