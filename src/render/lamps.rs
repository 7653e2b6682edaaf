//! Lamps of a solution: emitting triangles that touch or nearly so are one lamp.

use super::World;
use crate::geometry::clusters;
use crate::math::luminance;
use glam::Vec3;
use serde::Serialize;
use std::f32::consts::PI;

/// Parts of a lamp lie at most this far apart, metres.
const GAP: f32 = 0.05;

/// A lamp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LampGroup {
    /// Number by which it is named, 1 for the most powerful.
    pub id: usize,
    /// Centre in the coordinates of the scene's file, metres.
    pub position: [f64; 3],
    /// Extent of its bounding box, metres.
    pub size: [f32; 3],
    /// Luminous area, m².
    pub area: f32,
    /// Emitted power: π · ∫ radiance dA, radiance units · m², as luminance.
    pub power: f32,
    /// Mean emitted radiance.
    pub radiance: [f32; 3],
    /// Its triangles.
    #[serde(skip)]
    pub triangles: Vec<u32>,
}

/// The lamps of a solution, most powerful first.
#[must_use]
pub fn lamp_groups(world: &World<'_>, origin: glam::DVec3) -> Vec<LampGroup> {
    let mesh = world.mesh();
    let emitting: Vec<u32> = (0..mesh.triangles.len())
        .filter(|&t| world.emits(t) && mesh.area(t) > 0.0)
        .map(|t| t as u32)
        .collect();
    let mut out: Vec<LampGroup> = clusters(mesh, &emitting, GAP)
        .into_iter()
        .map(|t| describe(world, t, origin))
        .collect();
    out.sort_by(|a, b| {
        b.power
            .total_cmp(&a.power)
            .then(a.triangles.first().cmp(&b.triangles.first()))
    });
    for (i, g) in out.iter_mut().enumerate() {
        g.id = i + 1;
    }
    out
}

fn describe(world: &World<'_>, mut triangles: Vec<u32>, origin: glam::DVec3) -> LampGroup {
    triangles.sort_unstable();
    let mesh = world.mesh();
    let (mut area, mut flux, mut centre) = (0.0f32, Vec3::ZERO, Vec3::ZERO);
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &t in &triangles {
        let t = t as usize;
        let a = mesh.area(t);
        area += a;
        flux += world.own_emission(t) * a;
        centre += mesh.position(t, 1.0 / 3.0, 1.0 / 3.0) * a;
        for p in mesh.corners(t) {
            (low, high) = (low.min(p), high.max(p));
        }
    }
    LampGroup {
        id: 0,
        position: ((centre / area).as_dvec3() + origin).to_array(),
        size: (high - low).to_array(),
        area,
        power: PI * luminance(flux),
        radiance: (flux / area).to_array(),
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;
    use glam::DVec3;

    #[test]
    fn touching_triangles_are_one_lamp_and_distant_ones_are_not() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        // a second quad, two metres above, half the size
        let base = solution.mesh.positions.len() as u32;
        for i in 0..4 {
            let p = solution.mesh.positions[i];
            solution
                .mesh
                .positions
                .push(Vec3::new(0.5 * p.x, p.y + 2.0, 0.5 * p.z));
            solution.mesh.normals.push(Vec3::Y);
            solution.mesh.uvs.push(solution.mesh.uvs[i]);
        }
        let more: Vec<[u32; 3]> = solution
            .mesh
            .triangles
            .iter()
            .map(|t| t.map(|i| i + base))
            .collect();
        solution.mesh.triangles.extend(more);
        let world = World::new(&solution);
        let lamps = lamp_groups(&world, DVec3::ZERO);
        assert_eq!(lamps.len(), 2);
        assert_eq!((lamps[0].id, lamps[0].triangles.len()), (1, 2));
        assert!(
            (lamps[0].power / lamps[1].power - 4.0).abs() < 1e-3,
            "a quarter of the area"
        );
        assert!((lamps[0].power - PI * 2.0 * lamps[0].area).abs() < 1e-3 * lamps[0].power);
        assert!((lamps[1].position[1] - 2.1).abs() < 1e-5);
    }
}
