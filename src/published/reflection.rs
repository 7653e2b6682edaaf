//! The specular image of a view: L_s of every pixel and its slope by roughness, from rays along
//! half-vector samples (method §4.2), and which pixels are virtual highlights (method §6).

use super::lobe::{LobeSample, half_vector_sample};
use super::pixels::{Pixel, PixelGrid};
use crate::core::math::Frame;
use crate::core::parallel::prelude::*;
use crate::core::sampling::{KeyedRng, hammersley, hash_u64, square_to_uniform_hemisphere};
use crate::core::trace::{Hit, Ray, Tracer};
use crate::radiance::LightField;
use glam::Vec3;

/// Rays per pixel (cited: supplement, Sec. C.1).
pub const SAMPLES: u32 = 16;
/// Rays start this far above the surface, metres (cited: method §2.2).
const LIFT: f32 = 0.01;
/// Roughness at which highlights are looked for (cited: method §6).
const MIRROR: f32 = 0.01;
/// Pixels per task: 8,192 rays, so that one foreign call carries many.
const CHUNK: usize = 512;

/// Specular radiance of a pixel and its derivative by roughness.
#[derive(Clone, Copy, Debug, Default)]
pub struct Specular {
    /// L_s.
    pub radiance: Vec3,
    /// dL_s/dR.
    pub slope: Vec3,
}

/// What reflects, and how its slope is taken.
#[derive(Clone, Copy)]
pub struct Reflector<'a> {
    /// Embree.
    pub tracer: &'a dyn Tracer,
    /// Radiance of what rays meet.
    pub field: &'a LightField,
    /// Whether slopes are those of the lobe over the light ([`super::Correction::W1`]).
    pub corrected: bool,
}

impl Reflector<'_> {
    /// L_s of each of `pixels` at its roughness. `key` decides the samples.
    #[must_use]
    pub fn reflect(&self, pixels: &[Pixel], roughness: &[f32], key: u64) -> Vec<Specular> {
        let mut out = vec![Specular::default(); pixels.len()];
        out.par_chunks_mut(CHUNK)
            .zip(pixels.par_chunks(CHUNK).zip(roughness.par_chunks(CHUNK)))
            .for_each(|(out, (pixels, roughness))| self.chunk(pixels, roughness, key, out));
        out
    }

    /// E/π at each of `pixels` by uniform rays over its hemisphere, a shifted Hammersley set each
    /// (method §3.1): (2/N) Σ L cosθ. `key` decides the shifts.
    #[must_use]
    pub fn gather(&self, pixels: &[Pixel], samples: u32, key: u64) -> Vec<Vec3> {
        let one = |pixel: &Pixel| {
            let frame = Frame::from_normal(pixel.normal);
            let mut rng = KeyedRng::new(key, u64::from(pixel.cell));
            let shift = [rng.next_f32(), rng.next_f32()];
            let from = pixel.position + LIFT * pixel.normal;
            let mut cosines = Vec::with_capacity(samples as usize);
            let rays: Vec<Ray> = (0..samples)
                .map(|j| {
                    let h = hammersley(j, samples);
                    let u = [0, 1].map(|k| (h[k] + shift[k]).fract());
                    let direction = square_to_uniform_hemisphere(u);
                    cosines.push(direction.z);
                    Ray::new(from, frame.world_from_local(direction), f32::INFINITY)
                })
                .collect();
            let mut hits = vec![Hit::miss(); rays.len()];
            self.tracer.closest(&rays, &mut hits);
            let light = rays
                .iter()
                .zip(&hits)
                .zip(&cosines)
                .map(|((ray, hit), cos)| {
                    let along = Vec3::from_array(ray.direction);
                    self.field.arriving(hit, along, 0.0) * *cos
                });
            light.sum::<Vec3>() * (2.0 / samples as f32)
        };
        pixels.par_iter().map(one).collect()
    }

    fn chunk(&self, pixels: &[Pixel], roughness: &[f32], key: u64, out: &mut [Specular]) {
        let mut rays = Vec::with_capacity(pixels.len() * SAMPLES as usize);
        let mut samples: Vec<(usize, LobeSample)> = Vec::with_capacity(rays.capacity());
        for (i, (pixel, r)) in pixels.iter().zip(roughness).enumerate() {
            let frame = Frame::from_normal(pixel.normal);
            let view = frame
                .local_from_world(pixel.to_camera)
                .as_dvec3()
                .to_array();
            let mut rng = KeyedRng::new(key, hash_u64(u64::from(pixel.cell), 0));
            let shift = [rng.next_f32(), rng.next_f32()];
            for j in 0..SAMPLES {
                let h = hammersley(j, SAMPLES);
                let s =
                    [0, 1].map(|k| f64::from((h[k] + shift[k]).fract().clamp(1e-6, 1.0 - 1e-6)));
                let Some(sample) = half_vector_sample(s, view, f64::from(*r), self.corrected)
                else {
                    continue;
                };
                let direction = frame
                    .world_from_local(Vec3::from_array(sample.direction.map(|x| x as f32)))
                    .normalize();
                let from = pixel.position + LIFT * pixel.normal;
                rays.push(Ray::new(from, direction, f32::INFINITY));
                samples.push((i, sample));
            }
        }
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        for ((ray, hit), (i, sample)) in rays.iter().zip(&hits).zip(&samples) {
            let light = self
                .field
                .arriving(hit, Vec3::from_array(ray.direction), 0.0);
            out[*i].radiance += light * sample.weight as f32;
            out[*i].slope += light * sample.slope as f32;
        }
        for o in out {
            o.radiance /= SAMPLES as f32;
            o.slope /= SAMPLES as f32;
        }
    }
}

/// Which pixels of a view are virtual highlights: a mirror there would show some of `lights`.
/// Pixels of a class in `eroded` count only where the class surrounds them by 15 × 15 pixels.
#[must_use]
pub fn virtual_highlights(lights: Reflector<'_>, grid: &PixelGrid, eroded: &[u16]) -> Vec<bool> {
    let mirror = vec![MIRROR; grid.pixels.len()];
    let inside = interior(grid, eroded);
    let shown = lights.reflect(&grid.pixels, &mirror, 0);
    shown
        .iter()
        .zip(inside)
        .map(|(s, inside)| inside && s.radiance.max_element() > 0.0)
        .collect()
}

/// Whether each pixel's class fills the square of 15 pixels around it, for classes in `eroded`; all
/// others are inside.
fn interior(grid: &PixelGrid, eroded: &[u16]) -> Vec<bool> {
    /// Half of the published filter's 15 pixels.
    const REACH: i64 = 7;
    let mut class = vec![u16::MAX; grid.size()];
    for p in &grid.pixels {
        class[p.cell as usize] = p.class;
    }
    let (width, height) = (grid.width as i64, grid.height as i64);
    let same = |cell: usize, own: u16| {
        let (face, rest) = (
            cell / (grid.width * grid.height),
            cell % (grid.width * grid.height),
        );
        let (x, y) = ((rest % grid.width) as i64, (rest / grid.width) as i64);
        let ys = (y - REACH).max(0)..=(y + REACH).min(height - 1);
        ys.into_iter().all(|y| {
            let row = face * grid.width * grid.height + y as usize * grid.width;
            let first = row + (x - REACH).max(0) as usize;
            let last = row + (x + REACH).min(width - 1) as usize;
            class[first..=last].iter().all(|c| *c == own)
        })
    };
    grid.pixels
        .par_iter()
        .map(|p| !eroded.contains(&p.class) || same(p.cell as usize, p.class))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    #[test]
    fn a_floor_is_eroded_and_a_wall_is_not() {
        let pixel = |cell: u32| Pixel {
            position: Vec3::ZERO,
            normal: Vec3::Y,
            to_camera: Vec3::Y,
            uv: Vec2::ZERO,
            footprint: 0.0,
            radiance: Vec3::ZERO,
            contrast: 0.0,
            class: if cell % 40 < 20 { 1 } else { 2 },
            room: 1,
            cell,
        };
        let grid = PixelGrid {
            pixels: (0..1600).map(pixel).collect(),
            width: 40,
            height: 40,
            faces: 1,
        };
        let inside = interior(&grid, &[1]);
        let row = &inside[20 * 40..21 * 40];
        assert!(row[..13].iter().all(|i| *i), "up to seven from the border");
        assert!(row[13..20].iter().all(|i| !*i));
        assert!(row[20..].iter().all(|i| *i), "walls stay whole");
    }
}
