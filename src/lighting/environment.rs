//! Radiance of directions in which no geometry is hit: what lies beyond the windows.

use crate::gbuffer::ObservedView;
use crate::geometry::{Camera, Projection};
use crate::image::{Plane, RgbPlane, Wrap};
use crate::texture::fill_uncovered;
use crate::trace::Hit;
use glam::{Mat3, Vec2, Vec3};

/// Size of the environment map: 0.7° per pixel, finer than the parallax of a window seen from two places in a room.
const WIDTH: usize = 512;
const HEIGHT: usize = 256;

/// A distant environment: an equirectangular map in world axes.
#[derive(Clone, Debug)]
pub struct Environment {
    map: RgbPlane,
    camera: Camera,
    seen: f32,
}

impl Environment {
    /// An environment from an equirectangular map in world axes (design §1.1 with the identity pose).
    #[must_use]
    pub fn from_map(map: RgbPlane) -> Self {
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: map.width,
            height: map.height,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        Self { map, camera, seen: 1.0 }
    }

    /// Black in every direction.
    #[must_use]
    pub fn black() -> Self {
        Self { seen: 0.0, ..Self::from_map(Plane::filled(2, 1, Vec3::ZERO)) }
    }

    /// Collects the pixels that see no geometry: the mean per direction over all views, unseen directions filled from the seen ones
    /// around them. Pixels next to geometry are left out (they are mixtures). Black if every ray hits something.
    #[must_use]
    pub fn observe(views: &[ObservedView]) -> Self {
        let mut out = Self::from_map(Plane::filled(WIDTH, HEIGHT, Vec3::ZERO));
        let mut count = vec![0u32; WIDTH * HEIGHT];
        let mut sum = vec![Vec3::ZERO; WIDTH * HEIGHT];
        for v in views {
            let b = &v.buffer;
            let (w, h) = (b.triangle.width, b.triangle.height);
            for y in 1..h.saturating_sub(1) {
                for x in 1..w.saturating_sub(1) {
                    let open = (x - 1..=x + 1).all(|i| (y - 1..=y + 1).all(|j| b.triangle[(i, j)] == Hit::MISS));
                    if !open || v.valid.as_ref().is_some_and(|m| !m[(x, y)]) {
                        continue;
                    }
                    let d = b.camera.direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                    if let Some(p) = out.camera.project(d) {
                        let i = (p.y as usize).min(HEIGHT - 1) * WIDTH + (p.x as usize).min(WIDTH - 1);
                        sum[i] += v.radiance[(x, y)];
                        count[i] += 1;
                    }
                }
            }
        }
        let seen = count.iter().filter(|c| **c > 0).count();
        if seen == 0 {
            return Self::black();
        }
        for i in 0..sum.len() {
            if count[i] > 0 {
                out.map.data[i] = sum[i] / count[i] as f32;
            }
        }
        let covered = Plane { width: WIDTH, height: HEIGHT, data: count.iter().map(|c| *c > 0).collect() };
        out.map = fill_uncovered(&out.map, &covered);
        out.seen = seen as f32 / (WIDTH * HEIGHT) as f32;
        out
    }

    /// Radiance from a unit world direction.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.camera.project(direction).map_or(Vec3::ZERO, |p| self.map.bilinear(p, Wrap::Repeat))
    }

    /// Whether any light comes from outside.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.map.data.iter().all(|v| *v == Vec3::ZERO)
    }

    /// Share of the map's pixels that some view saw.
    #[must_use]
    pub fn seen_share(&self) -> f32 {
        self.seen
    }

    /// The map itself.
    #[must_use]
    pub fn map(&self) -> &RgbPlane {
        &self.map
    }
}
