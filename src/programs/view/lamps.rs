//! Sliders of the page for the lights that can be changed, in the order of the light operator's groups.

use crate::core::geometry::Mesh;
use crate::render::live::{LightGroup, light_groups};
use crate::solution::Solution;
use glam::{Vec2, Vec3};

/// One or several lamps of the solution, or the light from outside.
#[derive(Clone, Debug)]
pub struct Slider {
    /// What the page calls it.
    pub name: String,
    /// Numbers of its lamps in `lights.json`; empty for the light from outside.
    pub ids: Vec<usize>,
    /// Emitting triangles; empty for the light from outside.
    pub triangles: Vec<u32>,
    /// Middle of its bounding box.
    pub centre: Vec3,
    /// Class of its largest triangle.
    pub class: u16,
}

/// The sliders of a solution: one for each group of lamps in the order of their numbers; light from
/// outside, if there is any, comes last. What emits and is no lamp has none.
#[must_use]
pub fn sliders(solution: &Solution) -> Vec<Slider> {
    let groups = light_groups(solution);
    let shown = groups
        .iter()
        .filter(|g| g.is_outside() || !g.ids.is_empty());
    shown.map(|g| slider(solution, g)).collect()
}

/// Number of the lamp of every vertex, counted from 1; 0 where nothing emits.
#[must_use]
pub fn lamp_of_vertices(mesh: &Mesh, lamps: &[Slider]) -> Vec<u8> {
    let mut out = vec![0; mesh.positions.len()];
    for (i, lamp) in lamps.iter().enumerate() {
        for &t in &lamp.triangles {
            for v in mesh.triangles[t as usize] {
                out[v as usize] = i as u8 + 1;
            }
        }
    }
    out
}

fn slider(solution: &Solution, group: &LightGroup) -> Slider {
    let mesh = &solution.mesh;
    let triangles = &group.triangles;
    let corners = || triangles.iter().flat_map(|&t| mesh.corners(t as usize));
    let (low, high) = corners().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| {
        (l.min(p), h.max(p))
    });
    let largest = triangles
        .iter()
        .max_by(|a, b| mesh.area(**a as usize).total_cmp(&mesh.area(**b as usize)));
    let class = largest.map_or(0, |&t| {
        let size = Vec2::new(solution.labels.width as f32, solution.labels.height as f32);
        *solution
            .labels
            .nearest(mesh.uv(t as usize, 0.33, 0.33) * size)
    });
    let name = match group.ids[..] {
        [] => "Light from outside".to_owned(),
        [one] => format!("Lamp {one}"),
        [first, .., last] => format!("Lamps {first} to {last}"),
    };
    let centre = if triangles.is_empty() {
        Vec3::ZERO
    } else {
        0.5 * (low + high)
    };
    Slider {
        name,
        ids: group.ids.clone(),
        triangles: triangles.clone(),
        centre,
        class,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::solution::{Lamp, find_lamps};
    use glam::DVec3;

    /// Sliders of lamps, as many as the operator has groups for.
    const SLIDERS: usize = 11;

    /// A floor of 2 m, and above it, 2 m high, two lamps facing down whose radiances differ by the
    /// given factor.
    fn room(factor: f32) -> Solution {
        let mut mesh = Mesh::default();
        let mut quad = |centre: Vec3, half: f32, up: bool, u0: f32, u1: f32| {
            let base = mesh.positions.len() as u32;
            for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                mesh.positions.push(centre + Vec3::new(x, 0.0, z) * half);
                mesh.normals.push(if up { Vec3::Y } else { Vec3::NEG_Y });
                mesh.uvs.push(Vec2::new(
                    if x < 0.0 { u0 } else { u1 },
                    if z < 0.0 { 0.02 } else { 0.98 },
                ));
            }
            let faces = if up {
                [[0, 2, 1], [0, 3, 2]]
            } else {
                [[0, 1, 2], [0, 2, 3]]
            };
            mesh.triangles
                .extend(faces.map(|f: [u32; 3]| f.map(|i| i + base)));
        };
        quad(Vec3::ZERO, 1.0, true, 0.02, 0.48);
        quad(Vec3::new(-0.9, 2.0, 0.0), 0.05, false, 0.55, 0.7);
        quad(Vec3::new(0.9, 2.0, 0.0), 0.05, false, 0.8, 0.95);
        let mut emission = Plane::filled(64, 64, Vec3::ZERO);
        for y in 0..64 {
            for x in 33..64 {
                emission.data[y * 64 + x] = if x < 48 {
                    Vec3::ONE
                } else {
                    Vec3::splat(factor)
                };
            }
        }
        Solution {
            lamps: find_lamps(&mesh, &emission, DVec3::ZERO),
            portals: Vec::new(),
            mesh,
            origin: DVec3::ZERO,
            albedo: Plane::filled(8, 8, Vec3::splat(0.5)),
            roughness: Plane::filled(8, 8, 0.5),
            irradiance: Plane::filled(64, 64, Vec3::splat(1e-6)),
            radiance: Plane::filled(8, 8, Vec3::ZERO),
            emission,
            confidence: Plane::filled(8, 8, Vec2::ZERO),
            metallic: None,
            transmission: None,
            irradiance_error: None,
            camera_masks: Vec::new(),
            labels: Plane::filled(8, 8, 3),
            rooms: Plane::filled(8, 8, 1),
            reflectance: crate::core::brdf::Reflectance::Paper,
            environment: Plane::filled(8, 4, Vec3::ZERO),
        }
    }

    #[test]
    fn lamps_are_counted_as_a_person_would() {
        let found = sliders(&room(4.0));
        assert_eq!(found.len(), 2, "two quads of two triangles each, no sky");
        assert_eq!((found[0].triangles.len(), found[0].class), (2, 3));
        assert!(found[0].centre.x > 0.0, "the stronger first");
        let of_vertex = lamp_of_vertices(&room(4.0).mesh, &found);
        assert_eq!(of_vertex, [0, 0, 0, 0, 2, 2, 2, 2, 1, 1, 1, 1]);
    }

    #[test]
    fn sliders_bear_the_numbers_of_the_stored_list() {
        let mut solution = room(4.0);
        let few = sliders(&solution);
        assert_eq!(few[0].ids, [1]);
        assert_eq!(few[1].name, "Lamp 2");
        let lamp = solution.lamps[1].clone();
        solution
            .lamps
            .extend((3..=20).map(|id| Lamp { id, ..lamp.clone() }));
        let many = sliders(&solution);
        assert_eq!(many.len(), SLIDERS);
        assert_eq!(many[SLIDERS - 1].name, "Lamps 11 to 20");
        let ids: Vec<usize> = many.iter().flat_map(|s| s.ids.iter().copied()).collect();
        assert_eq!(ids, (1..=20).collect::<Vec<_>>());
    }

    #[test]
    fn a_dark_scene_has_no_lamps() {
        let mut solution = room(1.0);
        solution.emission.data.fill(Vec3::ZERO);
        solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        assert!(sliders(&solution).is_empty());
        solution.environment.data[3] = Vec3::ONE;
        assert_eq!(sliders(&solution).len(), 1);
    }
}
