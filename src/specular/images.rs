//! The specular part of the photographs: what every pixel's surface mirrors, given its roughness.

use super::{DirectionalAlbedo, Levels, Own, Reflector, ShadingPoint, WIDE};
use crate::core::blocks::{Columns, Packed, column, values};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use crate::core::sampling::hash_u64;
use crate::core::switch::Switch;
use crate::core::trace::Hit;
use crate::observed::{ClassMap, Surface};
use glam::{Vec2, Vec3};
use std::collections::BTreeSet;
use std::f32::consts::FRAC_1_PI;
use std::sync::atomic::{AtomicU64, Ordering};

/// Which lobes are too wide to need rays: those of the classes `matte` (auto), all above a
/// roughness of a half (on), or none (off).
pub struct WideRule<'a> {
    /// How it is decided.
    pub switch: Switch,
    /// Classes certain to have lobes too wide for highlights.
    pub matte: &'a BTreeSet<u16>,
}

/// What specular images are made from.
pub struct SpecularImages<'a> {
    /// The surface and its views.
    pub surface: &'a Surface<'a>,
    /// Classes of its points.
    pub classes: &'a ClassMap<'a>,
    /// Roughness texture of the atlas.
    pub roughness: &'a Plane<f32>,
    /// Irradiance texture.
    pub irradiance: &'a RgbPlane,
    /// Directional albedo of wide lobes.
    pub lobes: &'a DirectionalAlbedo,
    /// Which lobes are wide.
    pub wide: WideRule<'a>,
}

/// An image and the rays that it took.
pub struct TracedImage {
    /// Specular radiance per pixel.
    pub image: RgbPlane,
    /// Rays traced.
    pub rays: u64,
}

impl Packed for TracedImage {
    fn columns(&self) -> Columns {
        let size = [self.image.width as u64, self.image.height as u64, self.rays];
        vec![column(&size), column(&self.image.data)]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [size, data] = columns else {
            return None;
        };
        let [width, height, rays] = values::<u64>(size)?.try_into().ok()?;
        let image = Plane {
            width: usize::try_from(width).ok()?,
            height: usize::try_from(height).ok()?,
            data: values(data)?,
        };
        let whole = image.width.checked_mul(image.height) == Some(image.data.len());
        whole.then_some(Self { image, rays })
    }
}

impl SpecularImages<'_> {
    /// Roughness at a surface point.
    #[must_use]
    pub fn roughness_at(&self, triangle: u32, position: Vec3) -> f32 {
        self.surface.nearest(self.roughness, triangle, position)
    }

    /// Specular radiance where the lobe is so wide that the mean light tells it; no ray is needed
    /// there.
    #[must_use]
    pub fn even_light(&self, triangle: u32, position: Vec3, n_v: f32) -> Option<Vec3> {
        let roughness = self.roughness_at(triangle, position);
        let wide = match self.wide.switch {
            Switch::Auto => {
                roughness > WIDE
                    && self
                        .wide
                        .matte
                        .contains(&self.classes.label(triangle, position))
            }
            Switch::On => roughness >= 0.5,
            Switch::Off => false,
        };
        wide.then(|| {
            let size = Vec2::new(self.irradiance.width as f32, self.irradiance.height as f32);
            let at = self.surface.uv_at(triangle, position) * size;
            self.irradiance.bilinear(at, Wrap::Clamp)
                * (FRAC_1_PI * self.lobes.response(n_v, roughness))
        })
    }

    /// Pixels of all views that need specular rays, counted at every fourth row and column.
    #[must_use]
    pub fn traced_pixels(&self) -> usize {
        const STEP: usize = 4;
        let mut count = 0;
        for b in self.surface.views.iter().map(|v| &v.buffer) {
            for y in (0..b.triangle.height).step_by(STEP) {
                for x in (0..b.triangle.width).step_by(STEP) {
                    let t = b.triangle[(x, y)];
                    if t == Hit::MISS {
                        continue;
                    }
                    let position = b.position(x, y);
                    let (normal, _) = self.surface.normals_at(t, position);
                    let n_v = normal.dot((b.camera.position - position).normalize_or_zero());
                    count += usize::from(self.even_light(t, position, n_v).is_none());
                }
            }
        }
        count * STEP * STEP
    }

    /// Specular radiance at every pixel of a view.
    #[must_use]
    pub fn trace(&self, reflector: &Reflector, view_index: usize) -> TracedImage {
        let b = &self.surface.views[view_index].buffer;
        let (w, h) = (b.triangle.width, b.triangle.height);
        let mut image = Plane::filled(w, h, Vec3::ZERO);
        let rays = AtomicU64::new(0);
        image
            .data
            .par_chunks_mut(w)
            .enumerate()
            .for_each(|(y, row)| {
                let mut gazes = Vec::with_capacity(w);
                let mut levels = Vec::with_capacity(w);
                let mut columns = Vec::with_capacity(w);
                for (x, out) in row.iter_mut().enumerate() {
                    let t = b.triangle[(x, y)];
                    if t == Hit::MISS {
                        continue;
                    }
                    let d = b.direction(x, y);
                    let position = b.camera.position + d * b.distance[(x, y)];
                    let (normal, face_normal) = self.surface.normals_at(t, position);
                    if face_normal.dot(d) >= 0.0 {
                        continue;
                    }
                    if let Some(value) = self.even_light(t, position, -normal.dot(d)) {
                        *out = value;
                        continue;
                    }
                    gazes.push(ShadingPoint {
                        position,
                        normal,
                        face_normal,
                        view: -d,
                        key: hash_u64(view_index as u64, (y * w + x) as u64),
                        turn: 0,
                    });
                    levels.push(self.roughness_at(t, position));
                    columns.push(x);
                }
                let mut out = vec![Vec3::ZERO; gazes.len()];
                rays.fetch_add(
                    reflector.reflect(&gazes, Levels::Own(Own::dielectric(&levels)), &mut out),
                    Ordering::Relaxed,
                );
                for (x, value) in columns.into_iter().zip(out) {
                    row[x] = value;
                }
            });
        TracedImage {
            image,
            rays: rays.into_inner(),
        }
    }
}
