//! The floor plan: rooms in a row along x, joined by doorways, with windows open to the sky and
//! furniture by room kind.
//!
//! Each room is a box of its own whose doorways are short tunnels through the partition, so that no
//! wall is seen from behind.

use super::catalogue::{CEILING, DOOR_FRAME, PARQUET, SKIRTING, TILED_FLOOR, WALL, WINDOW_FRAME};
use super::charts::{Chart, Finish};
use super::furniture;
use super::pattern::Paint;
use super::plan::{Decorator, Footprint, Room};
use crate::sampling::KeyedRng;
use glam::{Vec2, Vec3};

/// Thickness of partitions and depth of window reveals, metres.
const WALL_THICKNESS: f32 = 0.16;
const DOOR: Vec2 = Vec2::new(0.9, 2.05);
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
    /// Window openings, two triangles each.
    pub portals: Vec<[Vec3; 3]>,
    /// Where furniture stands, world coordinates.
    pub footprints: Vec<Footprint>,
}

impl Apartment {
    /// The apartment of a seed.
    #[must_use]
    pub fn new(seed: u64, rooms: usize) -> Self {
        let mut out = Self {
            charts: Vec::new(),
            paints: Vec::new(),
            rooms: Vec::new(),
            portals: Vec::new(),
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
            let mut d = Decorator::new(KeyedRng::new(seed, 2000 + i as u64));
            let room = out.rooms[i];
            let doors = [(i > 0), (i + 1 < rooms)];
            d.builder_at(Vec3::new(room.x, 0.0, 0.0), |d| {
                shell(d, room.size, shallowest - DOOR_FROM_SOUTH, doors);
                furniture::furnish(d, room.kind, room.size);
            });
            let first = out.paints.len();
            out.paints.append(&mut d.paints);
            out.charts.extend(d.builder.charts.into_iter().map(|mut c| {
                c.finish.material += first;
                c
            }));
            out.footprints.append(&mut d.footprints);
            out.portals.append(&mut d.portals);
        }
        out
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

/// Floor, ceiling, walls with openings, reveals, skirting. The room spans (0, 0, 0) to `size`.
fn shell(d: &mut Decorator, size: Vec3, door_z: f32, doors: [bool; 2]) {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let tiled = d.rng.below(2) == 0;
    let floor = d.finish(if tiled { TILED_FLOOR } else { PARQUET });
    let (wall, ceiling, frame, jamb) = (
        d.finish(WALL),
        d.finish(CEILING),
        d.finish(WINDOW_FRAME),
        d.finish(DOOR_FRAME),
    );
    let skirting = d.finish(SKIRTING);
    d.builder.rect_facing(Vec3::ZERO, x, z, Vec3::Y, floor);
    d.builder.rect_facing(y, x, z, Vec3::NEG_Y, ceiling);
    // north wall (z = 0, seen along −z) with a window; reveal open to the sky
    let left = 0.5 * (size.x - WINDOW.x) + d.uniform(-0.2, 0.2);
    wall_with_opening(
        d,
        Vec3::ZERO,
        Vec3::X,
        Vec3::Z,
        size,
        (left, WINDOW.x, SILL, WINDOW.y),
        wall,
    );
    tunnel(
        d,
        Vec3::new(left, SILL, 0.0),
        Vec3::X,
        Vec3::NEG_Z,
        WINDOW,
        WALL_THICKNESS,
        frame,
    );
    window_bars(d, Vec3::new(left, SILL, -0.5 * WALL_THICKNESS), frame);
    let outer = Vec3::new(left, SILL, -WALL_THICKNESS);
    let corner = |a: f32, b: f32, d: &Decorator| {
        d.builder
            .world(outer + Vec3::new(a * WINDOW.x, b * WINDOW.y, 0.0))
    };
    let c = [
        corner(0.0, 0.0, d),
        corner(1.0, 0.0, d),
        corner(1.0, 1.0, d),
        corner(0.0, 1.0, d),
    ];
    d.portals.extend([[c[0], c[1], c[2]], [c[0], c[2], c[3]]]);
    // south wall
    d.builder.rect_facing(z + x, -x, y, Vec3::NEG_Z, wall);
    skirt(d, Vec3::ZERO, Vec3::X, Vec3::Z, size.x, skirting);
    skirt(d, z + x, Vec3::NEG_X, Vec3::NEG_Z, size.x, skirting);
    // west (x = 0) runs north to south reversed so that the normal points east; east likewise
    for (side, &has_door) in doors.iter().enumerate() {
        let (corner, along, inward) = if side == 0 {
            (z, Vec3::NEG_Z, Vec3::X)
        } else {
            (x, Vec3::Z, Vec3::NEG_X)
        };
        let extent = Vec3::new(size.z, size.y, size.x);
        if !has_door {
            wall_with_opening(d, corner, along, inward, extent, (0.0, 0.0, 0.0, 0.0), wall);
            skirt(d, corner, along, inward, size.z, skirting);
            continue;
        }
        let centre = if side == 0 { size.z - door_z } else { door_z };
        let start = centre - 0.5 * DOOR.x;
        wall_with_opening(
            d,
            corner,
            along,
            inward,
            extent,
            (start, DOOR.x, 0.0, DOOR.y),
            wall,
        );
        skirt(d, corner, along, inward, start, skirting);
        let after = start + DOOR.x;
        skirt(
            d,
            corner + along * after,
            along,
            inward,
            size.z - after,
            skirting,
        );
        // each room builds its half of the tunnel
        tunnel(
            d,
            corner + along * start,
            along,
            -inward,
            DOOR,
            0.5 * WALL_THICKNESS,
            jamb,
        );
        let threshold = corner + along * start;
        d.builder.rect_facing(
            threshold,
            -inward * 0.5 * WALL_THICKNESS,
            along * DOOR.x,
            Vec3::Y,
            floor,
        );
    }
}

/// A wall from `corner` along `along`, seen from the side of `inward`, around an opening (start,
/// width, bottom, height).
fn wall_with_opening(
    d: &mut Decorator,
    corner: Vec3,
    along: Vec3,
    inward: Vec3,
    size: Vec3,
    o: (f32, f32, f32, f32),
    finish: Finish,
) {
    let (start, width, bottom, height) = o;
    let mut piece = |u0: f32, u1: f32, v0: f32, v1: f32| {
        if u1 - u0 > 1e-4 && v1 - v0 > 1e-4 {
            let corner = corner + along * u0 + Vec3::Y * v0;
            d.builder.rect_facing(
                corner,
                along * (u1 - u0),
                Vec3::Y * (v1 - v0),
                inward,
                finish,
            );
        }
    };
    if width == 0.0 {
        return piece(0.0, size.x, 0.0, size.y);
    }
    piece(0.0, start, 0.0, size.y);
    piece(start + width, size.x, 0.0, size.y);
    piece(start, start + width, 0.0, bottom);
    piece(start, start + width, bottom + height, size.y);
}

/// The four inner sides of an opening; its floor is left out when it starts at floor level.
fn tunnel(
    d: &mut Decorator,
    corner: Vec3,
    along: Vec3,
    outward: Vec3,
    opening: Vec2,
    depth: f32,
    finish: Finish,
) {
    let (w, h, o) = (along * opening.x, Vec3::Y * opening.y, outward * depth);
    d.builder.rect_facing(corner, o, h, along, finish);
    d.builder.rect_facing(corner + w, o, h, -along, finish);
    d.builder.rect_facing(corner + h, o, w, Vec3::NEG_Y, finish);
    if corner.y > 0.0 {
        d.builder.rect_facing(corner, o, w, Vec3::Y, finish);
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

/// Skirting board along a wall.
fn skirt(d: &mut Decorator, corner: Vec3, along: Vec3, inward: Vec3, length: f32, finish: Finish) {
    if length < 0.05 {
        return;
    }
    let (front, up) = (corner + inward * SKIRTING_DEPTH, Vec3::Y * SKIRTING_HEIGHT);
    d.builder
        .rect_facing(front, along * length, up, inward, finish);
    d.builder.rect_facing(
        front + up,
        along * length,
        -inward * SKIRTING_DEPTH,
        Vec3::Y,
        finish,
    );
}
