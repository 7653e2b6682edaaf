//! Lamps as lights without extent, for programs that do not light by emissive surfaces.

use crate::render::{PointLight, Shape};
use crate::solution::{Lamp, PunctualLight, Solution, SpotCone};
use glam::{DVec3, Vec3};
use std::f32::consts::TAU;

/// A point light per lamp that sends out as much light.
#[must_use]
pub fn punctual_lights(solution: &Solution) -> Vec<PunctualLight> {
    let light = |g: &Lamp| {
        let normal: Vec3 = g
            .triangles
            .iter()
            .map(|&t| solution.mesh.double_area_normal(t as usize))
            .sum();
        surface_light(&format!("lamp {}", g.id), g, normal)
    };
    solution.lamps.iter().map(light).collect()
}

/// A point light that sends out as much light as a luminous surface, a flat one of which hangs on
/// something: its light starts a little in front of it. `normals` is the sum of its triangles'
/// normals, each twice as long as its area.
pub(super) fn surface_light(name: &str, lamp: &Lamp, normals: Vec3) -> PunctualLight {
    let radiance = Vec3::from_array(lamp.radiance);
    let front = (normals / (2.0 * lamp.area.max(f32::MIN_POSITIVE))).as_dvec3() * 0.05;
    PunctualLight {
        name: name.to_owned(),
        colour: colour(radiance),
        // π · L · area over the full sphere
        intensity: f64::from(0.25 * brightest(radiance) * lamp.area),
        position: (DVec3::from_array(lamp.centre) + front).to_array(),
        cone: None,
    }
}

/// An added light without extent; a measured luminaire sends as much light everywhere.
pub(super) fn point_light(name: &str, light: &PointLight, origin: DVec3) -> PunctualLight {
    let intensity = match light.shape {
        Shape::Bulb | Shape::Spot(_) | Shape::Distant => light.intensity,
        Shape::Measured(..) => mean_intensity(light),
    };
    let cone = match light.shape {
        Shape::Spot(cosines) => Some(SpotCone {
            direction: light.axis.as_dvec3().to_array(),
            angles: cosines.map(|c| f64::from(c.clamp(-1.0, 1.0)).acos()),
        }),
        Shape::Bulb | Shape::Measured(..) | Shape::Distant => None,
    };
    PunctualLight {
        name: name.to_owned(),
        colour: colour(intensity),
        intensity: f64::from(brightest(intensity)),
        position: (light.position.as_dvec3() + origin).to_array(),
        cone,
    }
}

fn brightest(light: Vec3) -> f32 {
    light.max_element().max(f32::MIN_POSITIVE)
}

fn colour(light: Vec3) -> [f64; 3] {
    let share = light / brightest(light);
    share.clamp(Vec3::ZERO, Vec3::ONE).as_dvec3().to_array()
}

/// Mean over the sphere, by the midpoint rule in height and angle.
fn mean_intensity(light: &PointLight) -> Vec3 {
    const STEPS: [usize; 2] = [64, 128];
    let towards = |i: usize| {
        let y = 1.0 - 2.0 * ((i / STEPS[1]) as f32 + 0.5) / STEPS[0] as f32;
        let (s, c) = (TAU * ((i % STEPS[1]) as f32 + 0.5) / STEPS[1] as f32).sin_cos();
        let r = (1.0 - y * y).max(0.0).sqrt();
        light.towards(Vec3::new(r * c, y, r * s))
    };
    let count = STEPS[0] * STEPS[1];
    (0..count).map(towards).sum::<Vec3>() / count as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    /// A spot with a hard edge at 60° fills a quarter of the sphere.
    #[test]
    fn means_over_the_sphere_are_powers() {
        let half = (PI / 3.0).cos();
        let mut light = PointLight {
            position: Vec3::ONE,
            intensity: Vec3::new(4.0, 2.0, 1.0),
            axis: Vec3::new(0.6, 0.0, 0.8),
            shape: Shape::Spot([half, half - 1e-4]),
        };
        let mean = mean_intensity(&light) / light.intensity;
        assert!((mean - 0.25).abs().max_element() < 0.01, "{mean}");
        let spot = point_light("spot", &light, DVec3::X);
        let cone = spot.cone.expect("a spot");
        assert!((cone.angles[0] - f64::from(PI) / 3.0).abs() < 1e-3);
        assert_eq!((spot.intensity, spot.position), (4.0, [2.0, 1.0, 1.0]));
        light.shape = Shape::Bulb;
        let bulb = point_light("bulb", &light, DVec3::ZERO);
        assert_eq!((bulb.cone, bulb.colour), (None, [1.0, 0.5, 0.25]));
    }
}
