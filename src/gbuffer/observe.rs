//! Observations of a surface point: in which views it is seen, with what radiance, and how well.
//!
//! A view sees a point if the pixels around its projection first hit the point's own surface; their
//! radiance is interpolated bilinearly over those pixels only. No ray is needed beyond the view's
//! own first hits.

use super::ViewBuffer;
use super::view_buffer::SAME_SURFACE_COSINE;
use crate::core::geometry::{Camera, Mesh};
use crate::core::image::{Plane, RgbPlane, bilinear_taps};
use glam::{Vec2, Vec3};

/// A photograph with what its pixels see.
#[derive(Clone, Debug)]
pub struct ObservedView {
    /// First hits at the image's size.
    pub buffer: ViewBuffer,
    /// Scene-linear radiance, same size.
    pub radiance: RgbPlane,
    /// Pixels of one smooth surface and label.
    pub clean: Plane<bool>,
    /// Class ids, any size with the same aspect.
    pub labels: Option<Plane<u16>>,
    /// Pixels that may be used (same size as the image); all if absent.
    pub valid: Option<Plane<bool>>,
}

/// Parallel surfaces farther apart than this share of their distance from the camera are two: well
/// above the rounding of positions.
const LAYER: f32 = 5e-5;
/// Cosine of the angle up to which triangles count as parallel.
const PARALLEL: f32 = 0.999_99;

/// The plane of a surface point, and how far what belongs to its surface may leave it.
struct Tangent {
    /// Unit normal.
    normal: Vec3,
    /// Distance from which parallel surface is another layer, metres.
    layer: f32,
    /// Distance that a third of a pixel explains, metres.
    lift: f32,
}

impl Tangent {
    /// Whether what is seen at `offset` from the point, with the unit normal that `normal_there`
    /// gives, is the point's own surface.
    fn holds(&self, offset: Vec3, normal_there: impl FnOnce() -> Vec3) -> bool {
        let off_plane = self.normal.dot(offset).abs();
        if off_plane <= self.layer {
            return true;
        }
        let alike = normal_there().dot(self.normal).abs();
        // what lies parallel at a distance is another layer: a lamp's glass before its frame, a
        // picture before its wall
        if alike > PARALLEL {
            return false;
        }
        // between two points of a smooth surface, whose normals differ by an angle of sine s, it
        // leaves the tangent plane by s times their distance at most; a wall that meets a ceiling
        // is another surface
        let bend = if alike < SAME_SURFACE_COSINE {
            0.0
        } else {
            (1.0 - alike * alike).max(0.0).sqrt()
        };
        off_plane <= self.lift + bend * offset.length()
    }
}

/// One view's look at a surface point.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Index into the observer's views.
    pub view: u32,
    /// Radiance towards the camera.
    pub radiance: Vec3,
    /// Continuous pixel coordinates.
    pub pixel: glam::Vec2,
    /// Cosine between the face normal and the direction to the camera.
    pub n_v: f32,
    /// Side of the pixel's footprint on the surface, metres.
    pub footprint: f32,
    /// Whether all pixels used are clean.
    pub clean: bool,
    /// Class id at the nearest pixel that meets the surface; 0 without labels.
    pub label: u16,
}

/// Finds the observations of surface points in a set of views.
pub struct Observer<'a> {
    /// The mesh all views were traced against.
    pub mesh: &'a Mesh,
    /// The views.
    pub views: &'a [ObservedView],
}

impl Observer<'_> {
    /// Appends to `out` (cleared first) every view that sees `position` on a surface with outward
    /// unit `face_normal`.
    pub fn observe(&self, position: Vec3, face_normal: Vec3, out: &mut Vec<Observation>) {
        out.clear();
        for (i, view) in self.views.iter().enumerate() {
            let clean = |k: usize| {
                let valid = view.valid.as_ref().is_none_or(|v| v.data[k]);
                valid.then(|| view.clean.data[k])
            };
            out.extend(self.observe_in(i as u32, position, face_normal, clean));
        }
    }

    /// Appends to `out` every view that sees `position` at pixels of which `are_taken` (view, pixel)
    /// says so, and at no others.
    pub fn observe_at(
        &self,
        are_taken: impl Fn(usize, usize) -> bool,
        position: Vec3,
        face_normal: Vec3,
        out: &mut Vec<Observation>,
    ) {
        for i in 0..self.views.len() {
            let clean = |k: usize| are_taken(i, k).then_some(true);
            let seen = self.observe_in(i as u32, position, face_normal, clean);
            out.extend(seen.filter(|o| o.clean));
        }
    }

    /// The look of one view at pixels of which `is_clean` says whether they are; `None`: not used.
    fn observe_in(
        &self,
        index: u32,
        position: Vec3,
        face_normal: Vec3,
        is_clean: impl Fn(usize) -> Option<bool>,
    ) -> Option<Observation> {
        let view = &self.views[index as usize];
        let camera: &Camera = &view.buffer.camera;
        let to_camera = camera.position - position;
        let distance = to_camera.length();
        let n_v = face_normal.dot(to_camera) / distance;
        if n_v.is_nan() || n_v <= 0.02 {
            return None;
        }
        let pixel = camera.project(position)?;
        let angle = camera.pixel_angle(pixel);
        let footprint = distance * angle / n_v.sqrt();
        let taps = bilinear_taps(camera.width, camera.height, pixel, view.buffer.wrap());
        // reach of two pixels along the surface; off the plane by a third of a pixel's footprint at
        // most
        let reach = 2.5 * distance * angle / n_v.max(0.1);
        let lift = (0.35 * distance * angle).max(2e-4 * distance);
        let (mut sum, mut weight, mut clean) = (Vec3::ZERO, 0.0f32, true);
        // corner and weight of the nearest pixel that meets the surface
        let (mut nearest, mut most) = (Vec2::ZERO, 0.0);
        for (k, w) in taps {
            let t = view.buffer.distance.data[k];
            let Some(is_clean) = is_clean(k).filter(|_| w > 0.0 && t.is_finite()) else {
                continue;
            };
            let corner = Vec2::new((k % camera.width) as f32, (k / camera.width) as f32);
            let direction = view.buffer.direction(k % camera.width, k / camera.width);
            let offset = camera.position + direction * t - position;
            if offset.length() > reach {
                continue;
            }
            let triangle = view.buffer.triangle.data[k] as usize;
            let plane = Tangent {
                normal: face_normal,
                layer: LAYER * t,
                lift,
            };
            if !plane.holds(offset, || self.mesh.face_normal(triangle)) {
                continue;
            }
            clean &= is_clean;
            sum += view.radiance.data[k] * w;
            weight += w;
            if w > most {
                (nearest, most) = (corner, w);
            }
        }
        if weight < 0.25 {
            return None;
        }
        let label = view.labels.as_ref().map_or(0, |l| {
            let scale = Vec2::new(
                l.width as f32 / camera.width as f32,
                l.height as f32 / camera.height as f32,
            );
            // elsewhere than in that pixel is what hides the rest of the surface
            let met = if pixel.floor() == nearest {
                pixel
            } else {
                nearest + 0.5
            };
            *l.nearest(met * scale)
        });
        Some(Observation {
            view: index,
            radiance: sum / weight,
            pixel,
            n_v,
            footprint,
            clean: clean && weight > 0.99,
            label,
        })
    }
}
