//! First hits of one view's pixel centres, traced once.

use crate::core::geometry::{Camera, Mesh, Projection};
use crate::core::image::{Plane, Wrap};
use crate::core::parallel::prelude::*;
use crate::core::trace::{Hit, Ray, Tracer};
use glam::{Vec2, Vec3};

/// Two neighbouring hits lie on one surface if they leave each other's tangent plane by less than
/// this share of their distance (30°), and their normals agree to about 45°.
const SAME_SURFACE_SINE: f32 = 0.5;
pub(super) const SAME_SURFACE_COSINE: f32 = 0.7;

/// Rays through the centres of n × n equal squares of each of some pixels in row `y`, to infinity:
/// pixel by pixel, row-major within the pixel.
#[must_use]
pub fn pixel_rays(
    camera: &Camera,
    y: usize,
    columns: impl IntoIterator<Item = usize>,
    n: usize,
) -> Vec<Ray> {
    let ray = |x: usize, s: usize| {
        let offset = Vec2::new((s % n) as f32 + 0.5, (s / n) as f32 + 0.5) / n as f32;
        Ray::new(
            camera.position,
            camera.direction(Vec2::new(x as f32, y as f32) + offset),
            f32::INFINITY,
        )
    };
    columns
        .into_iter()
        .flat_map(|x| (0..n * n).map(move |s| ray(x, s)))
        .collect()
}

/// Triangle and distance at every pixel centre of a view, row-major.
#[derive(Clone, Debug)]
pub struct ViewBuffer {
    /// Camera at the buffer's size.
    pub camera: Camera,
    /// Triangle per pixel; [`Hit::MISS`] where no geometry is seen.
    pub triangle: Plane<u32>,
    /// Distance along the pixel's ray, metres; infinite for a miss.
    pub distance: Plane<f32>,
}

impl ViewBuffer {
    /// Traces one ray through every pixel centre.
    #[must_use]
    pub fn trace(camera: &Camera, tracer: &dyn Tracer) -> Self {
        let (w, h) = (camera.width, camera.height);
        let mut triangle = Plane::filled(w, h, Hit::MISS);
        let mut distance = Plane::filled(w, h, f32::INFINITY);
        triangle
            .data
            .par_chunks_mut(w)
            .zip(distance.data.par_chunks_mut(w))
            .enumerate()
            .for_each(|(y, (tri, dist))| {
                let rays = pixel_rays(camera, y, 0..w, 1);
                let mut hits = vec![Hit::miss(); w];
                tracer.closest(&rays, &mut hits);
                for (x, hit) in hits.iter().enumerate() {
                    tri[x] = hit.triangle;
                    dist[x] = hit.t;
                }
            });
        Self {
            camera: *camera,
            triangle,
            distance,
        }
    }

    /// What lies beyond the left and right border of an image of this view.
    #[must_use]
    pub fn wrap(&self) -> Wrap {
        match self.camera.projection {
            Projection::Equirectangular => Wrap::Repeat,
            _ => Wrap::Clamp,
        }
    }

    /// World position seen at a pixel; meaningless for a miss.
    #[must_use]
    pub fn position(&self, x: usize, y: usize) -> Vec3 {
        let d = self
            .camera
            .direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
        self.camera.position + d * self.distance[(x, y)]
    }

    /// Pixels whose eight neighbours all see the same smooth surface and carry the same label:
    /// their radiance is that of one surface, not a mixture across an edge.
    #[must_use]
    pub fn clean_pixels(&self, mesh: &Mesh, labels: Option<&Plane<u16>>) -> Plane<bool> {
        let (w, h) = (self.triangle.width, self.triangle.height);
        let wraps = self.wrap() == Wrap::Repeat;
        let mut clean = Plane::filled(w, h, false);
        clean
            .data
            .par_chunks_mut(w)
            .enumerate()
            .for_each(|(y, row)| {
                for (x, out) in row.iter_mut().enumerate() {
                    *out = self.is_clean(mesh, labels, wraps, x, y);
                }
            });
        clean
    }

    fn is_clean(
        &self,
        mesh: &Mesh,
        labels: Option<&Plane<u16>>,
        wraps: bool,
        x: usize,
        y: usize,
    ) -> bool {
        let t = self.triangle[(x, y)];
        if t == Hit::MISS {
            return false;
        }
        let (w, h) = (self.triangle.width as i64, self.triangle.height as i64);
        let label_at = |x: usize, y: usize| {
            labels.map(|l| {
                l[(
                    x * l.width / self.triangle.width,
                    y * l.height / self.triangle.height,
                )]
            })
        };
        let own_label = label_at(x, y);
        let mut own: Option<(Vec3, Vec3)> = None;
        for (dx, dy) in [
            (-1, -1),
            (0, -1),
            (1, -1),
            (-1, 0),
            (1, 0),
            (-1, 1),
            (0, 1),
            (1, 1),
        ] {
            let (mut nx, ny) = (x as i64 + dx, y as i64 + dy);
            if wraps {
                nx = nx.rem_euclid(w);
            }
            if nx < 0 || nx >= w || ny < 0 || ny >= h {
                continue;
            }
            let (nx, ny) = (nx as usize, ny as usize);
            if label_at(nx, ny) != own_label {
                return false;
            }
            let other = self.triangle[(nx, ny)];
            if other == t {
                continue;
            }
            if other == Hit::MISS {
                return false;
            }
            let (p, n) =
                *own.get_or_insert_with(|| (self.position(x, y), mesh.face_normal(t as usize)));
            let (q, m) = (self.position(nx, ny), mesh.face_normal(other as usize));
            let step = q - p;
            let reach = SAME_SURFACE_SINE * step.length();
            if n.dot(m).abs() < SAME_SURFACE_COSINE
                || n.dot(step).abs() > reach
                || m.dot(step).abs() > reach
            {
                return false;
            }
        }
        true
    }
}
