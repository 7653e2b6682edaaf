//! Light from outside: a panorama, turned, whose sun is a light of its own.
//!
//! The path tracer asks for the environment through openings, evenly: a disc of half a degree that
//! is a million times brighter than the sky would be found by hardly any ray. Pixels that send
//! more than their part are cut down to the brightest others, and what is cut off becomes light
//! from one direction.

use crate::core::geometry::{Camera, Projection};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::radiance::Environment;
use crate::render::{self, PointLight, Shape};
use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::TAU;

/// Share of a panorama's light above which a pixel's is a light of its own. Derived: with less,
/// a thousand samples meet it.
const OUTSTANDING: f32 = 1e-3;
/// Cosine within which outstanding pixels are one light: two degrees, four discs of the sun.
const TOGETHER: f32 = 0.999_39;

/// The light from outside.
pub(super) struct Sky {
    map: Environment,
    /// From directions of the world to those of the panorama.
    map_from_world: Mat3,
    /// Lights that were cut out of the panorama.
    pub(super) suns: Vec<PointLight>,
}

impl Sky {
    /// No light.
    pub(super) fn black() -> Self {
        Self {
            map: Environment::black(),
            map_from_world: Mat3::IDENTITY,
            suns: Vec::new(),
        }
    }

    /// A panorama times `scale`, turned about the vertical axis by `turn` in radians.
    pub(super) fn new(mut panorama: RgbPlane, scale: f32, turn: f32) -> Self {
        panorama
            .data
            .iter_mut()
            .for_each(|p| *p = (*p * scale).max(Vec3::ZERO));
        let world_from_map = Mat3::from_rotation_y(turn);
        let suns = cut_out_suns(&mut panorama, world_from_map);
        Self {
            map: Environment::from_map(panorama),
            map_from_world: world_from_map.transpose(),
            suns,
        }
    }
}

impl render::Environment for Sky {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        self.map.radiance(self.map_from_world * direction)
    }

    fn is_black(&self) -> bool {
        self.map.is_black()
    }
}

/// Cuts outstanding pixels down; returns what was cut off as lights.
fn cut_out_suns(panorama: &mut RgbPlane, world_from_map: Mat3) -> Vec<PointLight> {
    let (w, h) = (panorama.width, panorama.height);
    let camera = Camera {
        projection: Projection::Equirectangular,
        width: w,
        height: h,
        world_from_camera: Mat3::IDENTITY,
        position: Vec3::ZERO,
    };
    let centre = |i: usize| Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5);
    let solid = |i: usize| camera.pixel_solid_angle(centre(i));
    let flux = |p: &RgbPlane, i: usize| luminance(p.data[i]) * solid(i);
    let total: f64 = (0..w * h).map(|i| f64::from(flux(panorama, i))).sum();
    let outstanding = |i: &usize| f64::from(flux(panorama, *i)) > f64::from(OUTSTANDING) * total;
    let mut bright: Vec<usize> = (0..w * h).filter(outstanding).collect();
    // in a panorama of few pixels every one is a part of the sky, not a sun
    let wide: f32 = bright.iter().map(|&i| solid(i)).sum();
    if bright.is_empty() || wide > TAU * (1.0 - TOGETHER) * 16.0 {
        return Vec::new();
    }
    let mut others: Vec<f32> = (0..w * h).map(|i| luminance(panorama.data[i])).collect();
    bright.iter().for_each(|&i| others[i] = 0.0);
    let ceiling = others.into_iter().fold(0.0, f32::max);
    bright.sort_by(|&a, &b| {
        flux(panorama, b)
            .total_cmp(&flux(panorama, a))
            .then(a.cmp(&b))
    });
    let mut suns: Vec<(Vec3, Vec3)> = Vec::new();
    for i in bright {
        let towards = world_from_map * camera.direction(centre(i));
        let kept = (ceiling / luminance(panorama.data[i]).max(f32::MIN_POSITIVE)).min(1.0);
        let cut = panorama.data[i] * (1.0 - kept) * solid(i);
        panorama.data[i] *= kept;
        match suns.iter_mut().find(|s| s.0.dot(towards) > TOGETHER) {
            Some(sun) => sun.1 += cut,
            None => suns.push((towards, cut)),
        }
    }
    let light = |(towards, intensity): (Vec3, Vec3)| PointLight {
        position: Vec3::ZERO,
        intensity,
        axis: -towards,
        shape: Shape::Distant,
    };
    suns.into_iter().map(light).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::render::Environment as _;
    use std::f32::consts::PI;

    /// A sun on an even sky: what is cut off and what stays is what was there, and lies where the
    /// turn brings it.
    #[test]
    fn sun_and_sky_are_the_panorama() {
        let (w, h) = (512, 256);
        let mut panorama = Plane::filled(w, h, Vec3::ONE);
        // in the middle: direction −z
        let i = h / 2 * w + w / 2;
        panorama.data[i] = Vec3::splat(1e6);
        let solid = (PI / h as f32) * (TAU / w as f32);
        let sky = Sky::new(panorama.clone(), 2.0, std::f32::consts::FRAC_PI_2);
        assert_eq!(sky.suns.len(), 1);
        let sun = &sky.suns[0];
        assert!(
            (sun.intensity.x / (2.0 * 1e6 * solid) - 1.0).abs() < 1e-3,
            "{sun:?}"
        );
        // −z turned counter-clockwise by a quarter is −x: the light goes towards +x
        assert!((sun.axis - Vec3::X).length() < 0.02, "{sun:?}");
        assert!((sky.radiance(-Vec3::X) - 2.0).length() < 1e-4);
        // no sun in what is even
        assert!(
            Sky::new(Plane::filled(8, 4, Vec3::ONE), 1.0, 0.0)
                .suns
                .is_empty()
        );
    }
}
