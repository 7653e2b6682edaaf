//! Places as networks see them: within [−1, 1] along the scene's longest axis, encoded or moved a
//! little.

use super::pixels::Pixel;
use crate::core::network::encoded;
use crate::core::sampling::KeyedRng;
use glam::Vec3;
use nalgebra::DMatrix;
use std::f32::consts::TAU;

/// Scale and origin of a scene for networks.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    centre: Vec3,
    scale: f32,
}

impl Place {
    /// Of the box from `lo` to `hi`.
    #[must_use]
    pub fn of_box(lo: Vec3, hi: Vec3) -> Self {
        let half = (0.5 * (hi - lo)).max_element();
        Self {
            centre: 0.5 * (lo + hi),
            scale: 1.0 / half.max(f32::MIN_POSITIVE),
        }
    }

    /// A position within [−1, 1].
    #[must_use]
    pub fn normalised(&self, p: Vec3) -> Vec3 {
        (p - self.centre) * self.scale
    }

    /// Metres of a length given in units of the scene's half size.
    #[must_use]
    pub fn metres(&self, length: f32) -> f32 {
        length / self.scale
    }

    /// NeRF's encoding of the positions of `points`, a column each.
    #[must_use]
    pub fn encoded(&self, points: &[Pixel], octaves: usize) -> DMatrix<f32> {
        encoded(points.iter().map(|p| self.normalised(p.position)), octaves)
    }

    #[cfg(test)]
    pub fn of_points(points: &[Pixel]) -> Self {
        let fold =
            |f: fn(Vec3, Vec3) -> Vec3, from| points.iter().map(|p| p.position).fold(from, f);
        Self::of_box(
            fold(Vec3::min, Vec3::INFINITY),
            fold(Vec3::max, Vec3::NEG_INFINITY),
        )
    }
}

/// A normally distributed number (Box & Muller 1958).
pub fn normal(rng: &mut KeyedRng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.next_f32()).ln()).sqrt();
    radius * (TAU * rng.next_f32()).cos()
}

/// Points in a box and slopes of some objective there, `fit` times as large as those of a mean, for
/// gradient checks.
#[cfg(test)]
pub fn test_points(n: usize, fit: f32) -> (Vec<Pixel>, Vec<super::strategy::MaterialSlope>) {
    let mut rng = KeyedRng::new(11, 4);
    let mut random = move || Vec3::from_array(std::array::from_fn(|_| 2.0 * rng.next_f32() - 1.0));
    (0..n)
        .map(|_| {
            let normal = random().normalize();
            let pixel = Pixel {
                position: 3.0 * random(),
                normal,
                to_camera: (normal + 0.5 * random()).normalize(),
                uv: 0.5 * (random().truncate() + 1.0),
                footprint: 0.0,
                radiance: random().abs(),
                contrast: random().x.abs(),
                class: 1,
                room: 1,
                cell: 0,
            };
            let slope = super::strategy::MaterialSlope {
                by_albedo: fit / n as f32 * random(),
                by_roughness: fit / n as f32 * random().x,
            };
            (pixel, slope)
        })
        .unzip()
}
