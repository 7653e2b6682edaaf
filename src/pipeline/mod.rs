//! The order of the stages, from a scene folder to a reconstruction.

mod light;
mod options;
mod solve;
mod surface;

pub use light::{Light, bake_irradiance_texels, reconstruct_light};
pub use options::{Quality, SolveOptions};
pub use solve::{Solved, reconstruct};
pub use surface::Surface;
