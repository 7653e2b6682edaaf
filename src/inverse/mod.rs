//! From light and observations to materials: stage I albedo, stage II roughness, stage III
//! refinement.

mod albedo;
mod class_prior;
mod confidence;
mod disagreement;
mod materials;
mod matte;
mod mixtures;
mod paint;
mod place;
mod roughness;
mod unmix;

pub use albedo::{AlbedoEstimate, DiffuseShading, estimate_albedo, specular_image};
pub use confidence::albedo_error;
pub use materials::{DIVISION_GAIN, Materials, Places};
pub use matte::{WIDE, WideLobes};
pub use paint::{Paint, Painting};
pub use roughness::{GroupFit, choose_model, fit_groups};
pub use unmix::{UnmixReport, Unmixing};
