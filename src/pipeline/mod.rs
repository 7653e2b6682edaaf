//! The order of the stages, from a scene folder to a reconstruction.

mod balance;
mod budget;
mod checkpoint;
mod decisions;
mod labels;
mod light;
mod neural;
mod options;
mod painted;
mod presets;
mod second_pass;
mod solve;
mod surface;

pub(crate) use budget::rounds_worth;
pub use budget::{Budget, parse_seconds};
pub use checkpoint::{Checkpoints, Kept};
pub use decisions::Sizes;
pub(crate) use light::texture_of;
pub use light::{Light, bake_irradiance_texels, reconstruct_light};
pub use options::{Fit, SolveOptions, Switch};
pub use presets::{Quality, SolveRequest};
pub use solve::{Solved, reconstruct};
pub use surface::Surface;
