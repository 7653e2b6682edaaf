//! A lit scene: the geometry, visibility, light field and lights that every gathering ray needs.

use super::Emitters;
use crate::core::geometry::Mesh;
use crate::core::trace::Tracer;
use crate::radiance::LightField;

/// Everything rays need.
#[derive(Clone, Copy)]
pub struct LitScene<'a> {
    /// Geometry.
    pub mesh: &'a Mesh,
    /// Visibility.
    pub tracer: &'a dyn Tracer,
    /// Radiance along rays.
    pub field: &'a LightField,
    /// Emitters to sample.
    pub emitters: &'a Emitters,
    /// Distance by which rays start above the surface, metres.
    pub offset: f32,
}
