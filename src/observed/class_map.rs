//! The class of any surface point, read from the atlas.

use super::Surface;
use crate::core::image::Plane;
use glam::Vec3;

/// Classes of surface points; emitting triangles have none.
pub struct ClassMap<'a> {
    surface: &'a Surface<'a>,
    labels: Plane<u16>,
    emissive: &'a [bool],
}

impl<'a> ClassMap<'a> {
    /// The classes of a surface on which the triangles marked in `emissive` emit.
    #[must_use]
    pub fn new(surface: &'a Surface<'a>, emissive: &'a [bool]) -> Self {
        Self {
            surface,
            labels: surface.texels.scatter(&surface.labels, 0),
            emissive,
        }
    }

    /// Class id at the point of a triangle nearest to `position`; 0 without a label.
    #[must_use]
    pub fn label(&self, triangle: u32, position: Vec3) -> u16 {
        self.surface.nearest(&self.labels, triangle, position)
    }

    /// The same, `None` on surfaces without material: those that emit.
    #[must_use]
    pub fn material(&self, triangle: u32, position: Vec3) -> Option<u16> {
        (!self.emissive[triangle as usize]).then(|| self.label(triangle, position))
    }
}
