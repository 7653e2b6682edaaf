//! Radiance along rays: the light field of surfaces (TBL, texture-based lighting) and the distant
//! environment seen where rays leave the scene.

mod environment;
mod light_field;
mod packed_texels;

pub use environment::Environment;
pub use light_field::{LightField, SurfaceRadiance};
