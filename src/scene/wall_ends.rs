//! Openings between wall ends that face each other: two stubs of wall in one line, with floor to walk
//! on along both sides of each and between them, are a partition with an opening in it, however wide
//! (folded doors, wing walls). A distance transform does not see it where the opening is as wide as the
//! room, so the line between the ends is closed before rooms are told apart. Corners of a room, columns
//! and cupboards along a wall are no such stubs. Called by `rooms`.

use super::wall_map::Plan;
use crate::core::parallel::prelude::*;
use glam::Vec2;

/// Half a thick inner wall, metres: pieces within it of one line are one partition.
pub(super) const HALF_WALL: f32 = 0.15;
/// A stub is at least this long, metres. Derived: twice a thick wall, else it is a column.
const STUB: f32 = 4.0 * HALF_WALL;
/// Nobody walks through less, metres: the posts of a glazed door are one stub, and the inside of a
/// wall is no floor to walk on. Derived: narrow door leaves are 0.6 m wide.
const PASSAGE: f32 = 0.6;

/// What a line across the plan meets at a place.
#[derive(Clone, Copy, PartialEq)]
enum Met {
    /// Wall that one can walk along on both sides.
    Stub,
    /// Free floor, on both sides too.
    Open,
    /// Free floor beside something.
    Free,
    Other,
}

/// Places of one kind that follow each other on a line.
struct Run {
    met: Met,
    places: std::ops::Range<usize>,
}

/// Free floor without the cells between wall ends that face each other. `unit`: metres in units of
/// the scene.
pub(super) fn parted(plan: &Plan, walls: &[bool], mut free: Vec<bool>, unit: f32) -> Vec<bool> {
    let map = Map {
        plan,
        walls,
        free: &free,
        unit,
    };
    let main = map.direction();
    let lines: Vec<Line> = [main, main.perp()]
        .into_iter()
        .flat_map(|along| map.lines(along))
        .collect();
    let closed: Vec<usize> = lines
        .par_iter()
        .flat_map_iter(|line| map.openings(line))
        .collect();
    closed.into_iter().for_each(|i| free[i] = false);
    free
}

struct Map<'a> {
    plan: &'a Plan,
    walls: &'a [bool],
    free: &'a [bool],
    /// Metres in units of the scene.
    unit: f32,
}

/// Places a cell apart along a straight line over the whole plan.
struct Line {
    start: Vec2,
    along: Vec2,
    count: usize,
}

impl Map<'_> {
    /// The main direction of the walls: the mean direction from wall to wall over cells of wall, as an
    /// angle that repeats every quarter turn.
    fn direction(&self) -> Vec2 {
        // between cells a few apart, so that steps of the grid do not outweigh slanted walls
        const APART: i32 = 8;
        let mut sum = Vec2::ZERO;
        for i in (0..self.plan.len()).filter(|&i| self.walls[i]) {
            for dz in -APART..=APART {
                for dx in [-APART, APART] {
                    for d in [
                        Vec2::new(dx as f32, dz as f32),
                        Vec2::new(dz as f32, dx as f32),
                    ] {
                        let half = self.plan.centre(i) + 0.5 * d * self.plan.cell;
                        let end = self.plan.centre(i) + d * self.plan.cell;
                        if self.is(self.walls, half) && self.is(self.walls, end) {
                            sum += Vec2::from_angle(4.0 * d.to_angle());
                        }
                    }
                }
            }
        }
        Vec2::from_angle(0.25 * sum.to_angle())
    }

    fn is(&self, cells: &[bool], place: Vec2) -> bool {
        self.plan.at(place).is_some_and(|i| cells[i])
    }

    /// Lines along a direction, a cell apart, that cover the plan.
    fn lines(&self, along: Vec2) -> Vec<Line> {
        let plan = self.plan;
        let size = Vec2::new(plan.width as f32, plan.height as f32) * plan.cell;
        let count = (size.length() / plan.cell).ceil() as usize + 1;
        let middle = plan.min + 0.5 * size;
        let from = |k: usize| (k as f32 - 0.5 * count as f32) * plan.cell;
        let line = |k: usize| Line {
            start: middle + along.perp() * from(k) + along * from(0),
            along,
            count,
        };
        (0..count).map(line).collect()
    }

    /// Metres as cells.
    fn cells(&self, metres: f32) -> i32 {
        (metres * self.unit / self.plan.cell).round() as i32
    }

    fn met(&self, place: Vec2, across: Vec2) -> Met {
        let at = |k: i32| place + across * (k as f32 * self.plan.cell);
        let half = self.cells(HALF_WALL);
        let wall = (-half..=half).any(|k| self.is(self.walls, at(k)));
        // beyond a wall that stands anywhere within its half thickness
        let beside = 2 * half + 1..=2 * half + self.cells(PASSAGE);
        let open = (beside.flat_map(|k| [k, -k])).all(|k| self.is(self.free, at(k)));
        match (wall, open) {
            (true, true) => Met::Stub,
            (false, true) if self.is(self.free, place) => Met::Open,
            (false, false) if self.is(self.free, place) => Met::Free,
            _ => Met::Other,
        }
    }

    /// Cells of the openings between stubs along a line.
    fn openings(&self, line: &Line) -> Vec<usize> {
        let place = |k: usize| line.start + line.along * (k as f32 * self.plan.cell);
        let across = line.along.perp();
        let mut met: Vec<Met> = (0..line.count)
            .map(|k| self.met(place(k), across))
            .collect();
        let passage = self.cells(PASSAGE) as usize;
        for three in runs(&met).windows(3) {
            let [a, posts, b] = three else { continue };
            let between = (a.met, posts.met, b.met) == (Met::Stub, Met::Open, Met::Stub);
            if between && posts.places.len() < passage {
                met[posts.places.clone()].fill(Met::Stub);
            }
        }
        for m in met.iter_mut().filter(|m| **m == Met::Open) {
            *m = Met::Free;
        }
        let stub = |r: &Run| r.met == Met::Stub && r.places.len() >= self.cells(STUB) as usize;
        let found = runs(&met);
        let gaps =
            (found.windows(3)).filter(|w| stub(&w[0]) && w[1].met == Met::Free && stub(&w[2]));
        gaps.flat_map(|w| w[1].places.clone())
            .filter_map(|k| self.plan.at(place(k)))
            .collect()
    }
}

fn runs(met: &[Met]) -> Vec<Run> {
    let mut first = 0;
    let run = |same: &[Met]| {
        let places = first..first + same.len();
        first = places.end;
        Run {
            met: same[0],
            places,
        }
    };
    met.chunk_by(|a, b| a == b).map(run).collect()
}
