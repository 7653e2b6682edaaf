//! Triangles and portal cells that send out light, packed for sampling: what one sample needs lies side by side in memory.

use super::{Hull, LightField};
use crate::geometry::Mesh;
use crate::sampling::square_to_triangle;
use crate::trace::Ray;
use glam::Vec3;

/// A direction towards an emitter.
#[derive(Clone, Copy, Debug)]
pub struct EmitterSample {
    /// Shadow ray: hits nothing if the emitter is visible.
    pub ray: Ray,
    /// Radiance arriving if visible.
    pub radiance: Vec3,
    /// Density per steradian at the receiver.
    pub pdf: f32,
}

/// Shadow rays end this share of their length before the surface they aim at: ten times the rounding of positions and no more, for
/// what lies between would be overlooked.
pub(super) const SHORT: f32 = 1e-4;

/// A flat piece of a lamp, one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Source {
    corner: Vec3,
    edge1: Vec3,
    edge2: Vec3,
    /// Unit normal of the side that sends out light.
    normal: Vec3,
    /// Density per m² within its lamp.
    density: f32,
    /// The mesh triangle; [`PORTAL`] for a cell of the hull.
    triangle: u32,
}

/// Marks a source that is a parallelogram through which the environment is seen.
pub(super) const PORTAL: u32 = u32::MAX;

impl Source {
    pub(super) fn of_triangle(mesh: &Mesh, field: &LightField, t: u32, density: f32) -> Self {
        let [a, b, c] = mesh.corners(t as usize);
        Self { corner: a, edge1: b - a, edge2: c - a, normal: field.outward_normal(t as usize), density, triangle: t }
    }

    pub(super) fn of_portal(hull: &Hull, cell: u32, density: f32) -> Self {
        let [corner, edge1, edge2, normal] = hull.cell_frame(cell);
        Self { corner, edge1, edge2, normal, density, triangle: PORTAL }
    }

    /// The direction to the point of the source that `u` in [0, 1)² stands for; nothing is looked up or decided yet.
    #[inline(always)]
    pub(super) fn aim(&self, origin: Vec3, u: [f32; 2]) -> Aim {
        let portal = self.triangle == PORTAL;
        let folded = square_to_triangle(u);
        let place = if portal { u } else { folded };
        let d = self.corner + self.edge1 * place[0] + self.edge2 * place[1] - origin;
        let d2 = d.length_squared();
        let length = d2.sqrt();
        let inverse = 1.0 / length;
        let cosine = -self.normal.dot(d) * inverse;
        let t_far = if portal { f32::INFINITY } else { length * (1.0 - SHORT) };
        Aim { ray: Ray::new(origin, d * inverse, t_far), cosine, density: self.density * d2, place, triangle: self.triangle }
    }

    /// Radiance that arrives along `aim` if nothing is in the way.
    #[inline]
    pub(super) fn radiance(&self, field: &LightField, aim: &Aim) -> Vec3 {
        match self.triangle {
            PORTAL => field.environment.radiance(Vec3::from_array(aim.ray.direction)),
            t => field.emitted(t as usize, aim.place[0], aim.place[1]),
        }
    }
}

/// Below this cosine at the source it counts as seen from behind.
pub(super) const GRAZING: f32 = 1e-6;

/// A direction to a point of a source, which may face away.
pub(super) struct Aim {
    /// Shadow ray.
    pub ray: Ray,
    /// Density per steradian at the receiver times `cosine`; that of the source within its lamp.
    pub density: f32,
    /// At the source; negative where the receiver is behind it.
    pub cosine: f32,
    /// Barycentrics of the point, or its place on the portal's cell.
    pub place: [f32; 2],
    /// The mesh triangle; [`PORTAL`] where the environment is what shines.
    pub triangle: u32,
}

impl Aim {
    /// Whether the receiver lies in front of the source (false too where the cosine is not a number).
    #[inline(always)]
    pub(super) fn in_front(&self) -> bool {
        self.cosine > GRAZING
    }

    /// Density per steradian at the receiver; that of the source within its lamp.
    pub(super) fn pdf(&self) -> f32 {
        self.density / self.cosine
    }
}
