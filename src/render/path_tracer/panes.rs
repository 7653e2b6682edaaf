//! Panes: thin sheets that reflect a part of the light, scatter a part, and let the rest straight
//! through (glTF's `KHR_materials_transmission`, no refraction).
//!
//! What a camera sees through a pane is followed beside what the pane reflects, weighed by its
//! transmittance T(θ): no noise where the light behind has none. Rays of later bounces and shadow
//! rays meet a pane by chance: it lets them pass with the probability mean(T), they count T/mean(T)
//! then, and what stops a path counts 1/(1 − mean(T)), so that the mean is right in every channel.

use super::scene::{Surface, SurfaceModel};
use crate::core::geometry::Mesh;
use crate::core::trace::{Coverage, Hit, Ray, passes_by_chance};
use crate::render::panes::grey;
use glam::Vec3;

/// A scene's surfaces as what lets light through.
pub(super) struct Panes<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) surfaces: &'a dyn SurfaceModel,
}

impl Panes<'_> {
    /// What goes through the surface that a ray along the unit `direction` meets.
    pub(super) fn transmittance(&self, direction: Vec3, hit: &Hit, surface: &Surface) -> Vec3 {
        let normal = self.mesh.face_normal(hit.triangle as usize);
        surface.transmittance(normal.dot(direction).abs())
    }

    pub(super) fn surface(&self, hit: &Hit) -> Surface {
        self.surfaces.surface(hit.triangle as usize, hit.u, hit.v)
    }
}

impl Coverage for Panes<'_> {
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool {
        let direction = Vec3::from_array(ray.direction);
        let passing = grey(self.transmittance(direction, hit, &self.surface(hit)));
        !passes_by_chance(ray, hit, passing)
    }

    fn passed(&self, ray: &Ray, hit: &Hit) -> Vec3 {
        let direction = Vec3::from_array(ray.direction);
        let through = self.transmittance(direction, hit, &self.surface(hit));
        through / grey(through)
    }
}
