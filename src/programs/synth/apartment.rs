//! The floor plan: rooms in a row along x, joined by doorways, with windows open to the sky and
//! furniture by room kind.
//!
//! Each room is a box of its own whose doorways are short tunnels through the partition, so that no
//! wall is seen from behind.

use super::catalogue::{
    CEILING, DOOR_FRAME, GLASS_DOOR, PARQUET, SKIRTING, TILED_FLOOR, WALL, WINDOW_FRAME,
};
use super::charts::{Chart, Finish};
use super::furniture;
use super::options::SynthOptions;
use super::pattern::Paint;
use super::plan::{Decorator, Footprint, Room};
use crate::core::sampling::KeyedRng;
use glam::{Vec2, Vec3};

/// Thickness of partitions and depth of window reveals, metres.
const WALL_THICKNESS: f32 = 0.16;
const DOOR: Vec2 = Vec2::new(0.9, 2.05);
/// Gap around the leaf of a glass door, metres.
const DOOR_CLEARANCE: f32 = 0.005;
/// Distance of a doorway's centre from the south wall (z = depth), metres.
const DOOR_FROM_SOUTH: f32 = 1.15;
const SILL: f32 = 0.9;
const WINDOW: Vec2 = Vec2::new(1.5, 1.3);
const SKIRTING_HEIGHT: f32 = 0.09;
const SKIRTING_DEPTH: f32 = 0.014;

/// An apartment before packing.
pub struct Apartment {
    /// All surfaces.
    pub charts: Vec<Chart>,
    /// Materials the charts refer to.
    pub paints: Vec<Paint>,
    /// Rooms from west to east.
    pub rooms: Vec<Room>,
    /// Where furniture stands, world coordinates.
    pub footprints: Vec<Footprint>,
}

impl Apartment {
    /// The apartment of some options.
    #[must_use]
    pub fn new(options: &SynthOptions) -> Self {
        let &SynthOptions { seed, rooms, .. } = options;
        let mut out = Self {
            charts: Vec::new(),
            paints: Vec::new(),
            rooms: Vec::new(),
            footprints: Vec::new(),
        };
        let mut x = 0.0;
        for i in 0..rooms {
            let mut rng = KeyedRng::new(seed, 1000 + i as u64);
            let mut draw = |low: f32, high: f32| low + (high - low) * rng.next_f32();
            let size = Vec3::new(draw(4.5, 5.4), 2.7, draw(4.6, 5.2));
            out.rooms.push(Room {
                x,
                size,
                kind: i % 3,
            });
            x += size.x + WALL_THICKNESS;
        }
        // all rooms share the z of their doorways: measured from the shallowest room's south wall
        let shallowest = out.rooms.iter().fold(f32::INFINITY, |m, r| m.min(r.size.z));
        for i in 0..rooms {
            let mut d = Decorator::new(KeyedRng::new(seed, 2000 + i as u64), options);
            let room = out.rooms[i];
            let doors = [(i > 0), (i + 1 < rooms)];
            d.builder_at(Vec3::new(room.x, 0.0, 0.0), |d| {
                shell(d, room.size, shallowest - DOOR_FROM_SOUTH, doors);
                furniture::furnish(d, room.kind, room.size);
                if options.panes && i + 1 < rooms {
                    glass_door(d, room.size, shallowest - DOOR_FROM_SOUTH);
                }
            });
            let first = out.paints.len();
            out.paints.append(&mut d.paints);
            out.charts.extend(d.builder.charts.into_iter().map(|mut c| {
                c.finish.material += first;
                c
            }));
            out.footprints.append(&mut d.footprints);
        }
        if options.diffuse {
            out.paints.iter_mut().for_each(Paint::make_matte);
        }
        if options.wallpaper {
            out.paper_walls();
        }
        out
    }

    /// Papers every wall.
    fn paper_walls(&mut self) {
        for chart in self.charts.iter().filter(|c| c.finish.class == WALL) {
            self.paints[chart.finish.material].make_wallpaper();
        }
    }

    /// Whether a standing camera has at least `clearance` metres to walls and furniture.
    #[must_use]
    pub fn is_free(&self, room: usize, p: Vec2, clearance: f32) -> bool {
        let r = &self.rooms[room];
        let inside = p.x > r.x + clearance
            && p.x < r.x + r.size.x - clearance
            && p.y > clearance
            && p.y < r.size.z - clearance;
        inside
            && self.footprints.iter().all(|(low, high)| {
                let outside = (*low - p).max(p - *high).max(Vec2::ZERO);
                outside.length() > clearance
            })
    }
}

/// A wall seen from the room: a rectangle that stands on the floor.
struct Wall {
    /// Where it starts, on the floor.
    corner: Vec3,
    /// Unit direction in which it runs.
    along: Vec3,
    /// Unit normal, into the room.
    inward: Vec3,
    /// Metres along it.
    length: f32,
    /// Metres up.
    height: f32,
}

impl Wall {
    /// The point `start` metres along the wall and `up` above the floor.
    fn at(&self, start: f32, up: f32) -> Vec3 {
        self.corner + self.along * start + Vec3::Y * up
    }
}

/// A rectangular opening in a wall.
#[derive(Clone, Copy)]
struct Opening {
    /// Metres from the start of the wall.
    start: f32,
    /// Metres above the floor.
    bottom: f32,
    /// Width and height, metres.
    size: Vec2,
}

/// What the parts of a room are made of.
struct ShellFinishes {
    floor: Finish,
    wall: Finish,
    ceiling: Finish,
    window_frame: Finish,
    door_frame: Finish,
    skirting: Finish,
}

impl ShellFinishes {
    /// Draws the finishes of a room, in this order.
    fn draw(d: &mut Decorator) -> Self {
        let tiled = d.rng.below(2) == 0;
        Self {
            floor: d.finish(if tiled { TILED_FLOOR } else { PARQUET }),
            wall: d.finish(WALL),
            ceiling: d.finish(CEILING),
            window_frame: d.finish(WINDOW_FRAME),
            door_frame: d.finish(DOOR_FRAME),
            skirting: d.finish(SKIRTING),
        }
    }
}

/// Floor, ceiling, walls with openings, reveals, skirting. The room spans (0, 0, 0) to `size`;
/// `doors` says whether the west and the east wall have one, centred at `door_z`.
fn shell(d: &mut Decorator, size: Vec3, door_z: f32, doors: [bool; 2]) {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let finishes = ShellFinishes::draw(d);
    d.builder
        .rect_facing(Vec3::ZERO, x, z, Vec3::Y, finishes.floor);
    d.builder
        .rect_facing(y, x, z, Vec3::NEG_Y, finishes.ceiling);
    let wall = |corner, along, inward, length| Wall {
        corner,
        along,
        inward,
        length,
        height: size.y,
    };
    let north = wall(Vec3::ZERO, Vec3::X, Vec3::Z, size.x);
    let south = wall(z + x, Vec3::NEG_X, Vec3::NEG_Z, size.x);
    window_wall(d, &north, &finishes);
    d.builder
        .rect_facing(z + x, -x, y, Vec3::NEG_Z, finishes.wall);
    skirt(d, &north, 0.0, north.length, finishes.skirting);
    skirt(d, &south, 0.0, south.length, finishes.skirting);
    // west (x = 0) runs north to south reversed so that the normal points east; east likewise
    let west = wall(z, Vec3::NEG_Z, Vec3::X, size.z);
    let east = wall(x, Vec3::Z, Vec3::NEG_X, size.z);
    let sides = [(west, size.z - door_z), (east, door_z)];
    for ((side, door_centre), has_door) in sides.iter().zip(doors) {
        if has_door {
            door_wall(d, side, *door_centre, &finishes);
        } else {
            wall_with_opening(d, side, None, finishes.wall);
            skirt(d, side, 0.0, side.length, finishes.skirting);
        }
    }
}

/// The north wall (z = 0, seen along −z) with a window; its reveal is open to the sky.
fn window_wall(d: &mut Decorator, north: &Wall, finishes: &ShellFinishes) {
    let left = 0.5 * (north.length - WINDOW.x) + d.uniform(-0.2, 0.2);
    let window = Opening {
        start: left,
        bottom: SILL,
        size: WINDOW,
    };
    let frame = finishes.window_frame;
    wall_with_opening(d, north, Some(window), finishes.wall);
    tunnel(d, north, window, Vec3::NEG_Z * WALL_THICKNESS, frame);
    window_bars(d, Vec3::new(left, SILL, -0.5 * WALL_THICKNESS), frame);
}

/// A wall with a doorway around `centre` metres from its start: each room builds its half of the
/// tunnel and of the threshold.
fn door_wall(d: &mut Decorator, wall: &Wall, centre: f32, finishes: &ShellFinishes) {
    let door = Opening {
        start: centre - 0.5 * DOOR.x,
        bottom: 0.0,
        size: DOOR,
    };
    let after = door.start + DOOR.x;
    wall_with_opening(d, wall, Some(door), finishes.wall);
    skirt(d, wall, 0.0, door.start, finishes.skirting);
    skirt(d, wall, after, wall.length - after, finishes.skirting);
    let depth = -wall.inward * (0.5 * WALL_THICKNESS);
    tunnel(d, wall, door, depth, finishes.door_frame);
    let threshold = wall.at(door.start, door.bottom);
    d.builder.rect_facing(
        threshold,
        depth,
        wall.along * DOOR.x,
        Vec3::Y,
        finishes.floor,
    );
}

/// A closed leaf of glass in the middle of the east doorway, centred at `door_z`: one sheet that
/// both rooms see.
fn glass_door(d: &mut Decorator, size: Vec3, door_z: f32) {
    let leaf = d.finish(GLASS_DOOR);
    let corner = Vec3::new(
        size.x + 0.5 * WALL_THICKNESS,
        DOOR_CLEARANCE,
        door_z - 0.5 * DOOR.x + DOOR_CLEARANCE,
    );
    let extent = DOOR - 2.0 * DOOR_CLEARANCE;
    let (along, up) = (Vec3::Z * extent.x, Vec3::Y * extent.y);
    d.builder.rect_facing(corner, along, up, Vec3::NEG_X, leaf);
}

/// The pieces of a wall around its opening.
fn wall_with_opening(d: &mut Decorator, wall: &Wall, opening: Option<Opening>, finish: Finish) {
    let mut piece = |u0: f32, u1: f32, v0: f32, v1: f32| {
        if u1 - u0 > 1e-4 && v1 - v0 > 1e-4 {
            d.builder.rect_facing(
                wall.at(u0, v0),
                wall.along * (u1 - u0),
                Vec3::Y * (v1 - v0),
                wall.inward,
                finish,
            );
        }
    };
    let Some(o) = opening else {
        return piece(0.0, wall.length, 0.0, wall.height);
    };
    let (end, top) = (o.start + o.size.x, o.bottom + o.size.y);
    piece(0.0, o.start, 0.0, wall.height);
    piece(end, wall.length, 0.0, wall.height);
    piece(o.start, end, 0.0, o.bottom);
    piece(o.start, end, top, wall.height);
}

/// The four inner sides of an opening that leads `depth` out of the room; its floor is left out
/// when it starts at floor level.
fn tunnel(d: &mut Decorator, wall: &Wall, opening: Opening, depth: Vec3, finish: Finish) {
    let corner = wall.at(opening.start, opening.bottom);
    let (w, h) = (wall.along * opening.size.x, Vec3::Y * opening.size.y);
    d.builder.rect_facing(corner, depth, h, wall.along, finish);
    d.builder
        .rect_facing(corner + w, depth, h, -wall.along, finish);
    d.builder
        .rect_facing(corner + h, depth, w, Vec3::NEG_Y, finish);
    if corner.y > 0.0 {
        d.builder.rect_facing(corner, depth, w, Vec3::Y, finish);
    }
}

/// A cross of glazing bars.
fn window_bars(d: &mut Decorator, corner: Vec3, finish: Finish) {
    let bar = 0.025;
    let mid = corner + Vec3::X * 0.5 * WINDOW.x;
    d.builder.cuboid(
        mid - Vec3::new(bar, 0.0, bar),
        mid + Vec3::new(bar, WINDOW.y, bar),
        false,
        finish,
    );
    let mid = corner + Vec3::Y * 0.62 * WINDOW.y;
    let half = 0.5 * WINDOW.x - bar;
    for x in [0.0, 0.5 * WINDOW.x + bar] {
        let low = mid + Vec3::new(x, -bar, -bar);
        d.builder.cuboid(
            low,
            low + Vec3::new(half, 2.0 * bar, 2.0 * bar),
            true,
            finish,
        );
    }
}

/// Skirting board along `length` metres of a wall from `start`.
fn skirt(d: &mut Decorator, wall: &Wall, start: f32, length: f32, finish: Finish) {
    if length < 0.05 {
        return;
    }
    let corner = wall.corner + wall.along * start;
    let front = corner + wall.inward * SKIRTING_DEPTH;
    let up = Vec3::Y * SKIRTING_HEIGHT;
    d.builder
        .rect_facing(front, wall.along * length, up, wall.inward, finish);
    d.builder.rect_facing(
        front + up,
        wall.along * length,
        -wall.inward * SKIRTING_DEPTH,
        Vec3::Y,
        finish,
    );
}

#[cfg(test)]
mod tests {
    use super::super::catalogue::{
        CABINET, HANDLE, LAMP_STAND, METALS, MIRROR, PICTURE, PICTURE_FRAME, PLANT_POT, PLANTER,
        TABLE, TABLE_TOP,
    };
    use super::*;
    use std::collections::BTreeSet;

    /// Fittings come in every room, and what they do not replace stays as it was to the bit.
    #[test]
    fn fittings_leave_the_rest_of_the_apartment_alone() {
        let of = |fittings: bool, rooms: usize| {
            Apartment::new(&SynthOptions {
                rooms,
                fittings,
                ..SynthOptions::default()
            })
        };
        let classes = |a: &Apartment| -> BTreeSet<u16> {
            let metal = a.charts.iter().filter(|c| c.finish.metallic > 0.0);
            metal.map(|c| c.finish.class).collect()
        };
        assert!(classes(&of(false, 3)).is_empty());
        assert_eq!(classes(&of(true, 3)), BTreeSet::from(METALS));
        let one_room = BTreeSet::from([MIRROR, HANDLE, PLANTER, TABLE_TOP]);
        assert_eq!(classes(&of(true, 1)), one_room);
        // cupboards make way for the hood; knobs and lamp stands are of one class
        let replaced = [
            CABINET,
            PICTURE,
            PICTURE_FRAME,
            PLANT_POT,
            LAMP_STAND,
            TABLE,
        ];
        let rest = |a: &Apartment| -> Vec<(u16, Vec<Vec3>, [Vec3; 2])> {
            let kept = |c: &&Chart| {
                !replaced.contains(&c.finish.class) && !METALS.contains(&c.finish.class)
            };
            a.charts
                .iter()
                .filter(kept)
                .map(|c| {
                    let colours = a.paints[c.finish.material].colours;
                    (c.finish.class, c.positions.clone(), colours)
                })
                .collect()
        };
        let (plain, fitted) = (of(false, 3), of(true, 3));
        assert!(rest(&plain) == rest(&fitted));
    }
}
