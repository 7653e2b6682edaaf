//! Radiance of directions in which no geometry is hit: what lies beyond the windows.

use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::atan2;
use crate::core::texture::fill_uncovered;
use crate::core::trace::Hit;
use crate::ffi::simd::{prefetch, with_widest};
use crate::gbuffer::ObservedView;
use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Size of the environment map: 0.7° per pixel, finer than the parallax of a window seen from two
/// places in a room.
const WIDTH: usize = 512;
const HEIGHT: usize = 256;
/// How many directions before its turn the memory is asked for what one needs.
const AHEAD: usize = 8;
const FRAC_1_TAU: f32 = 0.5 * FRAC_1_PI;

/// A distant environment: an equirectangular map in world axes.
#[derive(Clone, Debug)]
pub struct Environment {
    map: RgbPlane,
    /// The map with one more column and row on every side (wrapped and clamped), so that a lookup
    /// needs no case distinction.
    padded: Vec<Vec3>,
    seen: f32,
}

/// The camera whose image the map is.
fn camera(width: usize, height: usize) -> Camera {
    let (world_from_camera, position) = (Mat3::IDENTITY, Vec3::ZERO);
    Camera {
        projection: Projection::Equirectangular,
        width,
        height,
        world_from_camera,
        position,
    }
}

impl Environment {
    /// An environment from an equirectangular map in world axes (docs/scene-format.md, identity
    /// pose).
    #[must_use]
    pub fn from_map(map: RgbPlane) -> Self {
        let (w, h) = (map.width, map.height);
        let padded = (0..h + 2)
            .flat_map(|y| (0..w + 2).map(move |x| ((x + w - 1) % w, y.clamp(1, h) - 1)))
            .map(|(x, y)| map[(x, y)])
            .collect();
        Self {
            map,
            padded,
            seen: 1.0,
        }
    }

    /// Black in every direction.
    #[must_use]
    pub fn black() -> Self {
        Self {
            seen: 0.0,
            ..Self::from_map(Plane::filled(2, 1, Vec3::ZERO))
        }
    }

    /// Collects the pixels that see no geometry: the mean per direction over all views, unseen
    /// directions filled from the seen ones around them. Pixels next to geometry are left out (they
    /// are mixtures). Black if every ray hits something.
    #[must_use]
    pub fn observe(views: &[ObservedView]) -> Self {
        let camera = camera(WIDTH, HEIGHT);
        let mut count = vec![0u32; WIDTH * HEIGHT];
        let mut sum = vec![Vec3::ZERO; WIDTH * HEIGHT];
        for v in views {
            let b = &v.buffer;
            let (w, h) = (b.triangle.width, b.triangle.height);
            for y in 1..h.saturating_sub(1) {
                for x in 1..w.saturating_sub(1) {
                    let open = (x - 1..=x + 1)
                        .all(|i| (y - 1..=y + 1).all(|j| b.triangle[(i, j)] == Hit::MISS));
                    if !open || v.valid.as_ref().is_some_and(|m| !m[(x, y)]) {
                        continue;
                    }
                    let d = b
                        .camera
                        .direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                    if let Some(p) = camera.project(d) {
                        let i =
                            (p.y as usize).min(HEIGHT - 1) * WIDTH + (p.x as usize).min(WIDTH - 1);
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
        for (s, &n) in sum.iter_mut().zip(&count) {
            *s /= n.max(1) as f32;
        }
        let mean = Plane {
            width: WIDTH,
            height: HEIGHT,
            data: sum,
        };
        let covered = Plane {
            width: WIDTH,
            height: HEIGHT,
            data: count.iter().map(|c| *c > 0).collect(),
        };
        let map = fill_uncovered(&mean, &covered);
        Self {
            seen: seen as f32 / (WIDTH * HEIGHT) as f32,
            ..Self::from_map(map)
        }
    }

    /// Radiance from a unit world direction.
    #[must_use]
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        if direction.is_nan() {
            return Vec3::ZERO;
        }
        let [x, y] = self.place(direction);
        self.at(x, y)
    }

    /// Radiance from a unit world direction each: `directions` holds their coordinates one after
    /// the other, which are overwritten. Places are found in vector registers, then the map is
    /// read.
    pub fn radiances(&self, directions: [&mut [f32]; 3], mut each: impl FnMut(usize, Vec3)) {
        let [x, y, z] = directions;
        let n = x.len();
        let (y, z) = (&mut y[..n], &mut z[..n]);
        with_widest(|| {
            for k in 0..n {
                [x[k], y[k]] = self.place(Vec3::new(x[k], y[k], z[k]));
            }
        });
        for k in 0..n {
            if let (Some(x), Some(y)) = (x.get(k + AHEAD), y.get(k + AHEAD)) {
                let (at, next, _) = self.taps(*x, *y);
                prefetch(&self.padded, at);
                prefetch(&self.padded, next);
            }
            each(k, self.at(x[k], y[k]));
        }
    }

    /// Column and row in the padded map, half a pixel to the upper left: where the first of four
    /// taps begins.
    #[inline(always)]
    fn place(&self, d: Vec3) -> [f32; 2] {
        let longitude = atan2(d.x, -d.z);
        let colatitude = atan2((d.x * d.x + d.z * d.z).sqrt(), d.y);
        [
            (longitude * FRAC_1_TAU + 0.5) * self.map.width as f32 + 0.5,
            colatitude * FRAC_1_PI * self.map.height as f32 + 0.5,
        ]
    }

    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> Vec3 {
        let (at, next, [tx, ty]) = self.taps(x, y);
        let (upper, lower) = (&self.padded[at..at + 2], &self.padded[next..next + 2]);
        (upper[0] * (1.0 - tx) + upper[1] * tx) * (1.0 - ty)
            + (lower[0] * (1.0 - tx) + lower[1] * tx) * ty
    }

    /// Where the upper and the lower two of four taps begin, and the shares of the right and of the
    /// lower ones.
    #[inline(always)]
    fn taps(&self, x: f32, y: f32) -> (usize, usize, [f32; 2]) {
        let (w, h) = (self.map.width as u32, self.map.height as u32);
        let (column, row) = ((x as u32).min(w), (y as u32).min(h));
        let at = (row * (w + 2) + column) as usize;
        (at, at + w as usize + 2, [x - column as f32, y - row as f32])
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Wrap;

    /// The lookup of one pass equals the plain one: project, then interpolate between four pixels.
    #[test]
    fn lookups_equal_projection_and_interpolation() {
        let (w, h) = (37, 16);
        let value = |i: usize| Vec3::new((i * 7919 % 101) as f32, (i * 31 % 17) as f32, 1.0);
        let map = Plane {
            width: w,
            height: h,
            data: (0..w * h).map(value).collect(),
        };
        let (environment, camera) = (Environment::from_map(map.clone()), camera(w, h));
        for i in 0..4000 {
            let (z, phi) = (1.0 - 2.0 * (i as f32 + 0.5) / 4000.0, i as f32 * 2.399_963);
            let s = (1.0 - z * z).sqrt();
            for d in [
                Vec3::new(s * phi.cos(), z, s * phi.sin()),
                Vec3::Y,
                Vec3::NEG_Y,
                Vec3::Z,
                Vec3::new(1e-9, 0.0, 1.0),
            ] {
                let expected = map.bilinear(camera.project(d).expect("a direction"), Wrap::Repeat);
                assert!(
                    (environment.radiance(d) - expected).abs().max_element() < 2e-2,
                    "{d}"
                );
            }
        }
        let d = [
            Vec3::new(0.6, 0.0, -0.8),
            Vec3::new(0.0, 0.6, 0.8),
            Vec3::NEG_Y,
        ];
        let mut columns = [0, 1, 2].map(|a| d.map(|v| v[a]));
        let [x, y, z] = &mut columns;
        let mut seen = 0;
        environment.radiances([x, y, z], |k, l| {
            assert_eq!(l, environment.radiance(d[k]));
            seen += 1;
        });
        assert_eq!(seen, 3);
        assert_eq!(environment.radiance(Vec3::NAN), Vec3::ZERO);
        assert_eq!(Environment::black().radiance(Vec3::X), Vec3::ZERO);
    }
}
