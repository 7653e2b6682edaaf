//! Shading and image formation.
//!
//! * [`path_tracer`]: unbiased light transport over any [`crate::trace::Tracer`], in batches;
//! * [`path_tracer_lights`]: which light to sample from where;
//! * the hybrid renderer: irradiance texture plus traced specular reflection;
//! * [`denoise`]: variance-guided filtering of what it renders.

pub mod denoise;
mod hybrid;
pub mod path_tracer;
pub mod path_tracer_lights;

pub use hybrid::{HybridOptions, HybridRenderer, RenderedView, ViewRenderer};
pub use path_tracer::{
    BlackEnvironment, Environment, Frame, IndirectCache, IrradiancePoint, PathTracer, PathTracerOptions, Surface, SurfaceModel,
};
