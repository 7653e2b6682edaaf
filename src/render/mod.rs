//! Shading and image formation.
//!
//! * [`path_tracer`]: unbiased light transport over any [`crate::trace::Tracer`], in batches;
//! * [`path_tracer_lights`]: which light to sample from where;
//! * [`denoise`]: variance-guided filtering of what it renders.

pub mod denoise;
pub mod path_tracer;
pub mod path_tracer_lights;

pub use path_tracer::{
    BlackEnvironment, Environment, Frame, IndirectCache, IrradiancePoint, PathTracer, PathTracerOptions, Surface, SurfaceModel,
};
