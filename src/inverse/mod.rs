//! From light and observations to materials: stage I albedo, stage II roughness, stage III
//! refinement.

mod albedo;
mod albedo_palette;
mod class_prior;
mod confidence;
mod materials;
mod mixed_pixels;
mod robust_cg;
mod roughness;
mod spatial_roughness;
mod view_residual;

pub use albedo::{AlbedoEstimate, DiffuseShading, estimate_albedo, specular_image};
pub use albedo_palette::{Paint, Painting};
pub use confidence::albedo_error;
pub use materials::{DIVISION_GAIN, Materials, Places};
pub use mixed_pixels::{UnmixReport, Unmixing};
pub use roughness::{GroupFit, choose_model, fit_groups};
