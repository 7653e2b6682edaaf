//! Panes: thin sheets that reflect a part of the light, scatter a part, and let the rest straight
//! through (glTF's `KHR_materials_transmission`, no refraction).
//!
//! What a camera sees through a pane is followed beside what the pane reflects, weighed by its
//! transmittance T(θ): no noise where the light behind has none. Rays of later bounces and shadow
//! rays meet a pane by chance: it lets them pass with the probability mean(T), a grey one, and
//! what stops a path counts 1/(1 − mean(T)), so that the mean is right. A tint therefore colours
//! what is seen through a pane, and dims, but does not colour, the light that falls through it.

use super::scene::{Surface, SurfaceModel};
use super::tracer::PathTracer;
use super::wave::Wave;
use crate::core::geometry::Mesh;
use crate::core::trace::{Coverage, CutOut, Hit, MOST_LAYERS, Ray, Tracer, beyond, number_of_ray};
use glam::Vec3;

/// A scene's surfaces as what lets light through.
pub(super) struct Panes<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) surfaces: &'a dyn SurfaceModel,
}

impl Panes<'_> {
    /// What goes through the surface that a ray along the unit `direction` meets.
    fn transmittance(&self, direction: Vec3, hit: &Hit, surface: &Surface) -> Vec3 {
        let normal = self.mesh.face_normal(hit.triangle as usize);
        surface.transmittance(normal.dot(direction).abs())
    }

    fn surface(&self, hit: &Hit) -> Surface {
        self.surfaces.surface(hit.triangle as usize, hit.u, hit.v)
    }
}

impl Coverage for Panes<'_> {
    fn stops(&self, ray: &Ray, hit: &Hit) -> bool {
        let direction = Vec3::from_array(ray.direction);
        let passing = mean(self.transmittance(direction, hit, &self.surface(hit)));
        passing == 0.0 || number_of_ray(ray, hit) >= passing
    }
}

fn mean(transmittance: Vec3) -> f32 {
    transmittance.element_sum() / 3.0
}

impl<'a> PathTracer<'a> {
    /// The scene's panes, if it has any.
    fn panes(&self) -> Option<Panes<'a>> {
        let (mesh, surfaces) = (self.mesh, self.surfaces);
        self.has_panes.then_some(Panes { mesh, surfaces })
    }

    /// Finds what a wave's rays meet. Rays from the camera (bounce 0) meet every pane, and a path
    /// of its own goes on behind it.
    pub(super) fn find_hits(&self, wave: &mut Wave, bounce: u32) {
        wave.hits.clear();
        wave.hits.resize(wave.rays.len(), Hit::miss());
        let Some(panes) = self.panes() else {
            return self.tracer.closest(&wave.rays, &mut wave.hits);
        };
        if bounce > 0 {
            return CutOut::new(self.tracer, &panes).closest(&wave.rays, &mut wave.hits);
        }
        let mut first = 0;
        for _ in 0..MOST_LAYERS {
            self.tracer
                .closest(&wave.rays[first..], &mut wave.hits[first..]);
            let met = first..wave.rays.len();
            first = met.end;
            for i in met.filter(|&i| wave.hits[i].is_hit()).collect::<Vec<_>>() {
                let (ray, hit, mut path) = (wave.rays[i], wave.hits[i], wave.paths[i]);
                let direction = Vec3::from_array(ray.direction);
                path.beta *= panes.transmittance(direction, &hit, &panes.surface(&hit));
                if path.beta != Vec3::ZERO {
                    wave.paths.push(path);
                    wave.rays.push(beyond(&ray, &hit));
                }
            }
            wave.hits.resize(wave.rays.len(), Hit::miss());
            if first == wave.rays.len() {
                return;
            }
        }
    }

    /// What a path counts that a surface has stopped: of those that arrived at a pane, the others
    /// went through.
    pub(super) fn weight_of_stopped(&self, direction: Vec3, hit: &Hit, surface: &Surface) -> f32 {
        self.panes().map_or(1.0, |panes| {
            1.0 / (1.0 - mean(panes.transmittance(direction, hit, surface)))
        })
    }

    /// Whether anything stops shadow rays.
    pub(super) fn find_occluded(&self, rays: &[Ray], occluded: &mut [u8]) {
        match self.panes() {
            Some(panes) => CutOut::new(self.tracer, &panes).occluded(rays, occluded),
            None => self.tracer.occluded(rays, occluded),
        }
    }
}
