//! The path tracer's surfaces and environment as the light sampler knows them.

use super::scene::{Environment, SurfaceModel};
use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::core::sampling::{KeyedRng, square_to_triangle};
use crate::lights::LightModel;
use glam::Vec3;

/// Surface points from which the light sampler learns what is visible from where. As many as the
/// irradiance bake of a small room has receivers.
const RECEIVERS: usize = 1 << 15;

/// What sends out light in a path traced scene.
pub(super) struct TracedLights<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) surfaces: &'a dyn SurfaceModel,
    pub(super) environment: &'a dyn Environment,
}

impl LightModel for TracedLights<'_> {
    fn is_emissive(&self, triangle: usize) -> bool {
        luminance(self.surfaces.mean_emission(triangle)) > 0.0
    }

    fn power(&self, mesh: &Mesh, triangle: usize) -> f64 {
        let mean = luminance(self.surfaces.mean_emission(triangle));
        f64::from(mean.max(0.0)) * f64::from(mesh.area(triangle))
    }

    fn radiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        self.surfaces.surface(triangle, u, v).emission
    }

    fn outward_normal(&self, triangle: usize) -> Vec3 {
        if self.surfaces.emits_forward_only(triangle) {
            self.mesh.face_normal(triangle)
        } else {
            Vec3::ZERO
        }
    }

    fn environment(&self, direction: Vec3) -> Vec3 {
        self.environment.radiance(direction)
    }

    fn is_dark_outside(&self) -> bool {
        self.environment.is_black()
    }
}

/// Points spread evenly over the area of a mesh, with the normals of their faces.
pub(super) fn receivers(mesh: &Mesh, seed: u64) -> Vec<(Vec3, Vec3)> {
    let mut sum = 0.0;
    let mut ends = Vec::with_capacity(mesh.triangles.len());
    for t in 0..mesh.triangles.len() {
        sum += f64::from(mesh.area(t));
        ends.push(sum);
    }
    let point = |i: usize| {
        let mut rng = KeyedRng::new(seed ^ 0x11_6475, i as u64);
        let x = (i as f64 + f64::from(rng.next_f32())) / RECEIVERS as f64 * sum;
        let t = ends.partition_point(|end| *end <= x).min(ends.len() - 1);
        let [u, v] = square_to_triangle([rng.next_f32(), rng.next_f32()]);
        (mesh.position(t, u, v), mesh.face_normal(t))
    };
    if sum > 0.0 && sum.is_finite() {
        (0..RECEIVERS).map(point).collect()
    } else {
        Vec::new()
    }
}
