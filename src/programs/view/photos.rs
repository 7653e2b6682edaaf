//! Photographs for the page: read on demand, a few kept.

use super::encode::{gzip, radiometric};
use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use crate::error::Result;
use crate::scene::Scene;
use glam::{Mat3, Vec2, Vec3};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Photographs kept decoded (6 MB each at 1024 × 512), and kept packed.
const KEPT: usize = 12;

/// Recently used photographs.
#[derive(Default)]
pub struct Photos {
    pixels: Recent<usize, RgbPlane>,
    packed: Recent<(usize, usize), Vec<u8>>,
}

/// The last [`KEPT`] values that were made.
struct Recent<K, V>(Mutex<VecDeque<(K, Arc<V>)>>);

impl<K, V> Default for Recent<K, V> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K: PartialEq + Copy, V> Recent<K, V> {
    /// The value of `key`; made outside the lock, so that others are not held up (two may make the
    /// same at once, which is harmless).
    fn get(&self, key: K, make: impl FnOnce() -> Result<V>) -> Result<Arc<V>> {
        let found = |list: &VecDeque<(K, Arc<V>)>| {
            list.iter().find(|(k, _)| *k == key).map(|(_, v)| v.clone())
        };
        if let Some(value) = found(&self.0.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Ok(value);
        }
        let value = Arc::new(make()?);
        let mut list = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if found(&list).is_none() {
            list.push_back((key, value.clone()));
            if list.len() > KEPT {
                list.pop_front();
            }
        }
        Ok(value)
    }
}

impl Photos {
    /// The pixels of view `i`.
    ///
    /// # Errors
    /// If the photograph cannot be read.
    pub fn pixels(&self, scene: &Scene, i: usize) -> Result<Arc<RgbPlane>> {
        self.pixels.get(i, || scene.load_radiance(&scene.views[i]))
    }

    /// The photograph of view `i` as a panorama in its camera's axes, packed for the page.
    ///
    /// # Errors
    /// If the photograph cannot be read.
    pub fn packed(&self, scene: &Scene, i: usize, cap: usize, scale: f32) -> Result<Arc<Vec<u8>>> {
        self.packed.get((i, cap), || {
            let pixels = self.pixels(scene, i)?;
            let camera = &scene.views[i].camera;
            Ok(gzip(&match camera.projection {
                Projection::Equirectangular => radiometric(&pixels, cap, scale),
                Projection::Pinhole(_) => {
                    radiometric(&panorama(&pixels, camera, cap.min(2048)), cap, scale)
                }
            }))
        })
    }
}

/// A pinhole image laid onto a panorama in its camera's axes, black where it shows nothing.
fn panorama(image: &RgbPlane, camera: &Camera, width: usize) -> RgbPlane {
    let local = Camera {
        world_from_camera: Mat3::IDENTITY,
        position: Vec3::ZERO,
        ..*camera
    };
    let height = width / 2;
    let target = Camera {
        projection: Projection::Equirectangular,
        width,
        height,
        ..local
    };
    let pixel = |i: usize| {
        let d = target.direction(Vec2::new(
            (i % width) as f32 + 0.5,
            (i / width) as f32 + 0.5,
        ));
        local
            .project(d)
            .map_or(Vec3::ZERO, |p| image.bilinear(p, Wrap::Clamp))
    };
    Plane {
        width,
        height,
        data: (0..width * height).into_par_iter().map(pixel).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Lens;

    #[test]
    fn a_pinhole_image_lands_in_the_middle_of_its_panorama() {
        let lens = Lens {
            fl_x: 32.0,
            fl_y: 32.0,
            cx: 32.0,
            cy: 32.0,
            ..Lens::default()
        };
        let camera = Camera {
            projection: Projection::Pinhole(lens),
            width: 64,
            height: 64,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ONE,
        };
        let p = panorama(&Plane::filled(64, 64, Vec3::ONE), &camera, 64);
        assert_eq!(p[(32, 16)], Vec3::ONE, "straight ahead");
        assert_eq!(p[(1, 16)], Vec3::ZERO, "behind");
        let share = p.data[16 * 64..17 * 64]
            .iter()
            .filter(|v| **v == Vec3::ONE)
            .count();
        assert!((15..=17).contains(&share), "90° of 360°: {share}");
    }

    #[test]
    fn only_the_latest_values_are_kept() {
        let recent: Recent<usize, usize> = Recent::default();
        for i in 0..2 * KEPT {
            assert_eq!(*recent.get(i, || Ok(i)).expect("made"), i);
        }
        let made = std::cell::Cell::new(false);
        let make = |v| {
            made.set(true);
            Ok(v)
        };
        recent.get(2 * KEPT - 1, || make(0)).expect("kept");
        assert!(!made.get());
        recent.get(0, || make(0)).expect("made again");
        assert!(made.get());
    }
}
