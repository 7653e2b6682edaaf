//! What the rays of a wave meet, and what stops shadow rays, with panes in between (`panes.rs`).

use super::panes::Panes;
use super::scene::Surface;
use super::tracer::PathTracer;
use super::wave::Wave;
use crate::core::trace::{CutOut, Hit, MOST_LAYERS, beyond};
use crate::render::panes::grey;
use glam::Vec3;

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
            wave.passed.clear();
            wave.passed.resize(wave.rays.len(), Vec3::ONE);
            let seen = CutOut::new(self.tracer, &panes);
            seen.closest_and_passed(&wave.rays, &mut wave.hits, &mut wave.passed);
            for (path, passed) in wave.paths.iter_mut().zip(&wave.passed) {
                path.beta *= *passed;
            }
            return;
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
            1.0 / (1.0 - grey(panes.transmittance(direction, hit, surface)))
        })
    }

    /// Whether anything stops a wave's shadow rays; the light of those that pass panes counts for these.
    pub(super) fn find_occluded(&self, wave: &mut Wave) {
        let rays = &wave.shadow_rays;
        wave.occluded.clear();
        wave.occluded.resize(rays.len(), 0);
        let Some(panes) = self.panes() else {
            return self.tracer.occluded(rays, &mut wave.occluded);
        };
        wave.passed.clear();
        wave.passed.resize(rays.len(), Vec3::ONE);
        let seen = CutOut::new(self.tracer, &panes);
        seen.occluded_and_passed(rays, &mut wave.occluded, &mut wave.passed);
        for (shadow, passed) in wave.shadow.iter_mut().zip(&wave.passed) {
            shadow.diffuse *= *passed;
            shadow.specular *= *passed;
        }
    }
}
