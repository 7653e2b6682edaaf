//! Lamps as point lights, for programs that do not light by emissive surfaces.

use crate::solution::{Lamp, PunctualLight, Solution};
use glam::{DVec3, Vec3};

/// A point light per lamp that sends out as much light.
#[must_use]
pub fn punctual_lights(solution: &Solution) -> Vec<PunctualLight> {
    let light = |g: &Lamp| {
        let brightest = g
            .radiance
            .iter()
            .copied()
            .fold(0.0, f32::max)
            .max(f32::MIN_POSITIVE);
        // a flat lamp hangs on something: its light starts a little in front of it
        let normal: Vec3 = g
            .triangles
            .iter()
            .map(|&t| solution.mesh.double_area_normal(t as usize))
            .sum();
        let front = (normal / (2.0 * g.area.max(f32::MIN_POSITIVE))).as_dvec3() * 0.05;
        PunctualLight {
            name: format!("lamp {}", g.id),
            colour: g
                .radiance
                .map(|c| f64::from((c / brightest).clamp(0.0, 1.0))),
            // π · L · area over the full sphere
            intensity: f64::from(0.25 * brightest * g.area),
            position: (DVec3::from_array(g.centre) + front).to_array(),
        }
    };
    solution.lamps.iter().map(light).collect()
}
