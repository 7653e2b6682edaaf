//! The path tracer's scene: what is traced, and the tables its lights are sampled by.

use super::lights::{TracedLights, receivers};
use super::options::PathTracerOptions;
use super::panes::Panes;
use super::scene::{Environment, SurfaceModel};
use crate::core::brdf::Reflectance;
use crate::core::geometry::Mesh;
use crate::core::trace::{CutOut, Tracer};
use crate::lights::Emitters;
use crate::render::point_light::PointLight;

/// A scene ready to be rendered.
pub struct PathTracer<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) tracer: &'a dyn Tracer,
    pub(super) surfaces: &'a dyn SurfaceModel,
    pub(super) environment: &'a dyn Environment,
    pub(super) emitters: Emitters,
    pub(super) points: Vec<PointLight>,
    pub(super) reflectance: Reflectance,
    pub(super) layered: bool,
    pub(super) has_panes: bool,
    pub(super) options: PathTracerOptions,
    /// Offset of ray origins relative to the largest coordinate involved.
    pub(super) offset_floor: f32,
}

impl<'a> PathTracer<'a> {
    /// Prepares a scene: collects its lights and builds the tables they are sampled by.
    #[must_use]
    pub fn new(
        mesh: &'a Mesh,
        tracer: &'a dyn Tracer,
        surfaces: &'a dyn SurfaceModel,
        environment: &'a dyn Environment,
        options: PathTracerOptions,
    ) -> Self {
        let model = TracedLights {
            mesh,
            surfaces,
            environment,
        };
        let panes = Panes { mesh, surfaces };
        let through = CutOut::new(tracer, &panes);
        let seeing: &dyn Tracer = if surfaces.has_panes() {
            &through
        } else {
            tracer
        };
        let emitters = Emitters::new(mesh, &model, seeing, &receivers(mesh, options.seed));
        let (low, high) = mesh.bounds();
        let offset_floor = 0.01 * (high - low).max_element();
        Self {
            mesh,
            tracer,
            surfaces,
            environment,
            emitters,
            points: Vec::new(),
            reflectance: surfaces.reflectance(),
            layered: surfaces.is_layered(),
            has_panes: surfaces.has_panes(),
            options,
            offset_floor,
        }
    }

    /// The scene as the light sampler knows it.
    pub(super) fn light_model(&self) -> TracedLights<'a> {
        TracedLights {
            mesh: self.mesh,
            surfaces: self.surfaces,
            environment: self.environment,
        }
    }

    /// The mesh that is rendered.
    #[must_use]
    pub fn mesh(&self) -> &'a Mesh {
        self.mesh
    }

    /// What traces its rays.
    #[must_use]
    pub fn tracer(&self) -> &'a dyn Tracer {
        self.tracer
    }

    /// Adds lights without extent.
    #[must_use]
    pub fn with_points(mut self, points: Vec<PointLight>) -> Self {
        self.points = points;
        self
    }

    /// Sets the samples per pixel.
    pub fn set_samples(&mut self, samples: u32) {
        self.options.samples = samples.max(1);
    }
}
