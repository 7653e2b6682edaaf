//! Which bits of floor that nothing borders on are closets, and which the insides of solids. From within
//! a closet the mesh shows the side that it shows to rooms, from within a solid the other. Whether windings
//! run inwards or outwards is the exporting program's habit, so most of what rooms see says which side is
//! theirs. (Asked shell by shell, a wall of a closet that a room sees from behind votes for the wrong
//! one.) Called by `rooms`.

use super::wall_map::{Plan, Storey};
use crate::core::geometry::Mesh;
use crate::core::trace::{Hit, Ray, Tracer};
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

/// The storey that rooms are looked for in.
pub(super) struct Surroundings<'a> {
    pub(super) plan: &'a Plan,
    pub(super) storey: &'a Storey,
    pub(super) mesh: &'a Mesh,
    pub(super) tracer: &'a dyn Tracer,
}

/// What a cell sees at eye level in one direction.
struct Sight {
    region: u32,
    cell: usize,
    /// 1 if its winding faces the cell, −1 if not.
    front: f32,
}

/// Those of the `lonely` regions that are closets: most of their cells see outer sides in at least three
/// of four directions. `regions` has the region of each cell of the plan, 0 = none.
pub(super) fn closets(
    around: &Surroundings<'_>,
    regions: &[u32],
    lonely: &BTreeSet<u32>,
) -> BTreeSet<u32> {
    if lonely.is_empty() {
        return BTreeSet::new();
    }
    let sights = around.sights(regions);
    let seen_by_rooms = sights.iter().filter(|s| !lonely.contains(&s.region));
    let fronts: f32 = seen_by_rooms.map(|s| s.front).sum();
    let outer = |s: &&Sight| s.front * fronts >= 0.0;
    let mut sides = vec![0u8; regions.len()];
    for s in sights.iter().filter(outer) {
        sides[s.cell] += 1;
    }
    // cells with outer sides around them, and all, of each region
    let mut cells: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for (region, sides) in regions.iter().zip(sides) {
        let (around, all) = cells.entry(*region).or_default();
        *around += usize::from(sides > 2);
        *all += 1;
    }
    let closet = |region: &&u32| (cells.get(region)).is_some_and(|(around, all)| 2 * around > *all);
    lonely.iter().filter(closet).copied().collect()
}

impl Surroundings<'_> {
    fn sights(&self, regions: &[u32]) -> Vec<Sight> {
        let y = self.storey.eye();
        let cells: Vec<usize> = (0..regions.len()).filter(|&i| regions[i] != 0).collect();
        let mut sights = Vec::new();
        for direction in [Vec3::X, Vec3::NEG_X, Vec3::Z, Vec3::NEG_Z] {
            let ray = |&i: &usize| {
                let c = self.plan.centre(i);
                Ray::new(Vec3::new(c.x, y, c.y), direction, f32::INFINITY)
            };
            let rays: Vec<Ray> = cells.iter().map(ray).collect();
            let mut hits = vec![Hit::miss(); rays.len()];
            self.tracer.closest(&rays, &mut hits);
            for (&cell, hit) in cells.iter().zip(&hits).filter(|(_, h)| h.is_hit()) {
                let normal = self.mesh.face_normal(hit.triangle as usize);
                sights.push(Sight {
                    region: regions[cell],
                    cell,
                    front: -normal.dot(direction).signum(),
                });
            }
        }
        sights
    }
}
