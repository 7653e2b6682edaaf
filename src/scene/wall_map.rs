//! The wall map: where walls, free floor and roof are on the floor plan's grid, cut out of the mesh
//! (an occupancy grid: Elfes 1989). Called by `rooms`.

use super::Scene;
use crate::core::trace::{Hit, Ray, Tracer};
use glam::{Vec2, Vec3};

/// Storey height that fixes the unit of the lengths below, metres.
const STOREY: f32 = 2.6;
/// Cell of the occupancy grid.
const CELL: f32 = 0.06;
/// Most cells along one side; a larger plan gets larger cells.
const MAX_SIDE: usize = 2048;
/// Doors end below this height above the floor.
const DOOR: f32 = 2.12;
/// Slices cut between door height and ceiling.
const SLICES: usize = 7;
/// Heights between which a partition stands: above tables, sofas and worktops, below its own top.
const PARTITION: [f32; 2] = [1.1, 1.5];
/// A cell is wall if the mesh crosses it in this many slices: hanging lamps and rods cross fewer.
const WALL_SLICES: u8 = 3;

/// Heights of the storey the cameras stand in, and the unit its lengths are measured in.
pub(super) struct Storey {
    floor: f32,
    ceiling: f32,
    pub(super) unit: f32,
    roofed: bool,
}

impl Storey {
    /// Height at which partitions stand and little else.
    pub(super) fn eye(&self) -> f32 {
        let share = 0.5 * (PARTITION[0] + PARTITION[1]) / STOREY;
        self.floor + share * (self.ceiling - self.floor)
    }
}

pub(super) fn storey(scene: &Scene, tracer: &dyn Tracer) -> Storey {
    let (lo, hi) = scene.mesh.bounds();
    let cameras: Vec<Vec3> = scene.views.iter().map(|v| v.camera.position).collect();
    let along = |direction: Vec3| -> Vec<f32> {
        let rays: Vec<Ray> = cameras
            .iter()
            .map(|&c| Ray::new(c, direction, f32::INFINITY))
            .collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        tracer.closest(&rays, &mut hits);
        let mut y: Vec<f32> = hits
            .iter()
            .zip(&cameras)
            .filter(|(h, _)| h.is_hit())
            .map(|(h, c)| c.y + direction.y * h.t)
            .collect();
        y.sort_by(f32::total_cmp);
        y
    };
    // furniture below and lamps above the cameras pull to the middle: take the outer quartiles
    let (below, above) = (along(Vec3::NEG_Y), along(Vec3::Y));
    let floor = below.get(below.len() / 4).copied().unwrap_or(lo.y);
    let roofed = 2 * above.len() > cameras.len();
    let ceiling = if roofed {
        above[(3 * above.len() / 4).min(above.len() - 1)]
    } else {
        hi.y
    };
    let height = (ceiling - floor).max(1e-6);
    // storeys are 2.2 to 4 m high; anything else means other units
    let unit = if (2.0..=4.5).contains(&height) {
        1.0
    } else {
        height / STOREY
    };
    Storey {
        floor,
        ceiling: floor + height,
        unit,
        roofed,
    }
}

/// The floor plan's grid.
pub(super) struct Plan {
    pub(super) min: Vec2,
    pub(super) cell: f32,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Plan {
    pub(super) fn new(scene: &Scene, storey: &Storey) -> Self {
        let (lo, hi) = scene.mesh.bounds();
        let extent = Vec2::new(hi.x - lo.x, hi.z - lo.z);
        let cell = (CELL * storey.unit)
            .max(extent.max_element() / (MAX_SIDE - 4) as f32)
            .max(f32::MIN_POSITIVE);
        let side = |length: f32| ((length / cell).ceil() as usize + 4).min(MAX_SIDE);
        Self {
            min: Vec2::new(lo.x, lo.z) - 2.0 * cell,
            cell,
            width: side(extent.x),
            height: side(extent.y),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.width * self.height
    }

    /// World x, z of a cell's centre.
    pub(super) fn centre(&self, i: usize) -> Vec2 {
        self.min
            + Vec2::new((i % self.width) as f32 + 0.5, (i / self.width) as f32 + 0.5) * self.cell
    }

    /// The cell that a place lies in.
    pub(super) fn at(&self, place: Vec2) -> Option<usize> {
        let p = (place - self.min) / self.cell;
        let on =
            p.x >= 0.0 && p.y >= 0.0 && (p.x as usize) < self.width && (p.y as usize) < self.height;
        on.then(|| p.y as usize * self.width + p.x as usize)
    }

    /// The up to four edge neighbours of a cell.
    pub(super) fn neighbours(&self, i: usize) -> impl Iterator<Item = usize> + use<> {
        let (w, x, y, h) = (self.width, i % self.width, i / self.width, self.height);
        [
            (x > 0).then(|| i - 1),
            (x + 1 < w).then(|| i + 1),
            (y > 0).then(|| i - w),
            (y + 1 < h).then(|| i + w),
        ]
        .into_iter()
        .flatten()
    }

    /// Cells of walls, which the mesh crosses in several slices between door height and ceiling,
    /// and of partitions, which it crosses in all slices at eye level.
    pub(super) fn walls(&self, scene: &Scene, storey: &Storey) -> Vec<bool> {
        let height = storey.ceiling - storey.floor;
        let top = storey.floor + height - 0.1 * storey.unit.min(height);
        let bottom = (storey.floor + DOOR * storey.unit).min(top - 0.12 * height);
        let high = self.crossings(scene, bottom, top);
        let at = |metres: f32| storey.floor + (metres * storey.unit).min(metres / STOREY * height);
        let eye = self.crossings(scene, at(PARTITION[0]), at(PARTITION[1]));
        high.into_iter()
            .zip(eye)
            .map(|(h, e)| h >= WALL_SLICES || e as usize == SLICES)
            .collect()
    }

    /// In how many of [`SLICES`] slices between two heights the mesh crosses each cell.
    fn crossings(&self, scene: &Scene, bottom: f32, top: f32) -> Vec<u8> {
        let heights: Vec<f32> = (0..SLICES)
            .map(|k| bottom + (top - bottom) * (k as f32 + 0.5) / SLICES as f32)
            .collect();
        let mut count = vec![0u8; self.len()];
        let mut last = vec![u8::MAX; self.len()];
        for (k, &y) in heights.iter().enumerate() {
            for t in 0..scene.mesh.triangles.len() {
                let corners = scene.mesh.corners(t);
                if let Some((a, b)) = slice(&corners, y) {
                    self.line(a, b, |i| {
                        if last[i] != k as u8 {
                            last[i] = k as u8;
                            count[i] += 1;
                        }
                    });
                }
            }
        }
        count
    }

    /// Visits the cells a segment passes, in steps of half a cell.
    fn line(&self, a: Vec2, b: Vec2, mut visit: impl FnMut(usize)) {
        let steps = (((b - a).length() / (0.5 * self.cell)).ceil() as usize).clamp(1, 4 * MAX_SIDE);
        for s in 0..=steps {
            if let Some(i) = self.at(a + (b - a) * (s as f32 / steps as f32)) {
                visit(i);
            }
        }
    }

    /// Cells with a floor below and, in a roofed scene, a ceiling above.
    pub(super) fn roofed(&self, tracer: &dyn Tracer, storey: &Storey) -> Vec<bool> {
        let y = storey.floor + 0.9 * (storey.ceiling - storey.floor);
        let trace = |direction: Vec3| -> Vec<bool> {
            let rays: Vec<Ray> = (0..self.len())
                .map(|i| {
                    let c = self.centre(i);
                    Ray::new(Vec3::new(c.x, y, c.y), direction, f32::INFINITY)
                })
                .collect();
            let mut occluded = vec![0u8; rays.len()];
            tracer.occluded(&rays, &mut occluded);
            occluded.into_iter().map(|o| o != 0).collect()
        };
        let mut inside = trace(Vec3::NEG_Y);
        if storey.roofed {
            inside
                .iter_mut()
                .zip(trace(Vec3::Y))
                .for_each(|(i, above)| *i &= above);
        }
        inside
    }
}

/// The segment (x, z) in which a triangle crosses height `y`.
fn slice(corners: &[Vec3; 3], y: f32) -> Option<(Vec2, Vec2)> {
    let mut points = [Vec2::ZERO; 2];
    let mut n = 0;
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        if (a.y <= y) != (b.y <= y) && n < 2 {
            let p = a + (b - a) * ((y - a.y) / (b.y - a.y));
            points[n] = Vec2::new(p.x, p.z);
            n += 1;
        }
    }
    (n == 2).then_some((points[0], points[1]))
}
