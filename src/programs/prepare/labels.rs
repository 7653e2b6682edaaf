//! Class ids per pixel, rendered from a surface whose triangles have classes: one ray per pixel
//! centre. For captures that label geometry instead of photographs.

use super::capture::LabelledMesh;
use super::lens::Optics;
use crate::core::geometry::{Camera, Lens, Mesh, Projection};
use crate::core::image::Plane;
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::error::Result;
use glam::{DMat4, DVec3, Vec2};

/// Columns of a rendered label image at most: labels may have any resolution of the same aspect.
pub(super) const MOST_COLUMNS: usize = 1024;

/// A surface ready to be looked at.
pub struct LabelSource {
    tracer: EmbreeTracer,
    classes: Vec<u16>,
    origin: DVec3,
}

impl LabelSource {
    /// Builds the acceleration structure around the surface's first vertex.
    ///
    /// # Errors
    /// A vertex index out of range, or Embree's own.
    pub fn new(surface: &LabelledMesh) -> Result<Self> {
        let origin = surface.mesh.positions.first().copied().unwrap_or_default();
        let positions = surface.mesh.positions.iter();
        let mesh = Mesh {
            positions: positions.map(|p| (*p - origin).as_vec3()).collect(),
            triangles: surface.mesh.triangles.clone(),
            ..Mesh::default()
        };
        Ok(Self {
            tracer: EmbreeTracer::new(&mesh)?,
            classes: surface.classes.clone(),
            origin,
        })
    }

    /// What a photograph of this pose, projection and size sees; 0 where it sees nothing.
    #[must_use]
    pub fn render(&self, pose: &DMat4, optics: &Optics, size: [usize; 2]) -> Plane<u16> {
        let camera = camera(pose, optics, size, self.origin);
        let width = size[0].min(MOST_COLUMNS);
        let height = ((size[1] * width) as f64 / size[0] as f64).round().max(1.0) as usize;
        let camera = camera.resized(width, height);
        // a lens that is resampled first never comes here
        let rays: Vec<Ray> = (0..width * height)
            .map(|i| {
                let pixel = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
                Ray::new(camera.position, camera.direction(pixel), f32::INFINITY)
            })
            .collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        let class = |h: &Hit| {
            let t = h.is_hit().then_some(h.triangle as usize);
            t.and_then(|t| self.classes.get(t)).copied().unwrap_or(0)
        };
        Plane {
            width,
            height,
            data: hits.iter().map(class).collect(),
        }
    }
}

/// The solver's camera for a shot, positions relative to `origin`.
pub(super) fn camera(
    pose: &DMat4,
    optics: &Optics,
    [width, height]: [usize; 2],
    origin: DVec3,
) -> Camera {
    let projection = match optics {
        Optics::Panorama | Optics::Distorted(_) => Projection::Equirectangular,
        Optics::Perspective(p) => Projection::Pinhole(Lens {
            fl_x: p.focal[0] as f32,
            fl_y: p.focal[1] as f32,
            cx: p.centre[0] as f32,
            cy: p.centre[1] as f32,
            k: p.radial.map(|x| x as f32),
            p: p.tangential.map(|x| x as f32),
        }),
    };
    Camera {
        projection,
        width,
        height,
        world_from_camera: glam::DMat3::from_mat4(*pose).as_mat3(),
        position: (pose.w_axis.truncate() - origin).as_vec3(),
    }
}
