//! From light and observations to materials: roughness per class from highlights, albedo in closed
//! form, mixed pixels at edges, the palette of painted classes, and what is known of the errors.

mod albedo;
mod albedo_palette;
mod class_prior;
mod clipped_albedo;
mod clipped_fit;
mod confidence;
mod contradicted_albedo;
mod flat_surface;
mod gloss_slope;
mod group_fit;
mod materials;
mod metal;
mod mixed_pixels;
mod palette_detail;
mod palette_look;
mod reflectance;
mod robust_cg;
mod roughness;
mod spatial_roughness;
mod unseen;
mod view_residual;

pub use albedo::{AlbedoEstimate, BLACK, Shading, estimate_albedo};
pub use albedo_palette::{ClassPalette, PaletteFit};
pub use class_prior::Ground;
pub use clipped_albedo::{LeastAlbedo, settle_clipped};
pub use clipped_fit::{ClippedFit, LightGroup, ShadingRow, fit_clipped};
pub use confidence::{ErrorSources, StatedErrors, albedo_error};
pub use contradicted_albedo::settle_contradicted;
pub use group_fit::GroupFit;
pub use materials::{Materials, Places, SPLIT_GAIN};
pub use metal::{Metal, find_metals};
pub use mixed_pixels::{MOST_TERMS, MixedPixelReport, MixedPixelSolver};
pub use reflectance::TexelReflectance;
pub use roughness::{choose_model, fit_groups};
pub use unseen::Unseen;
