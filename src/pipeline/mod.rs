//! The order of the stages, from a scene folder to a reconstruction.

mod albedo;
mod assemble;
mod checkpoint;
mod clipped_light;
mod decisions;
mod findings;
mod highlights;
mod light;
mod missing_light;
mod neural;
mod observe;
mod options;
mod painted;
mod presets;
mod quality;
mod reflections;
mod roughness;
mod solve;
mod time_budget;

pub use crate::core::switch::Switch;
pub use albedo::{SolvedAlbedo, solve_albedo};
pub use checkpoint::{Checkpoints, Kept};
pub use highlights::{Highlights, gather_highlights};
pub(crate) use light::texture_of;
pub use light::{Light, bake_irradiance_texels, reconstruct_light};
pub use observe::observe;
pub use options::{Fit, SolveOptions};
pub use presets::SolveRequest;
pub use quality::Quality;
pub use reflections::{Reflections, trace_reflections};
pub use roughness::{Roughness, fit_roughness};
pub use solve::{Solved, reconstruct};
pub(crate) use time_budget::rounds_worth;
pub use time_budget::{Budget, parse_seconds};
