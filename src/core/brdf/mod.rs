//! The reflection model of the paper (method §4.1): a Lambertian lobe plus a dielectric GGX lobe,
//!
//! f = A/π + D F G / (4 (n·v)(n·l)), with α = R², F0 = 0.04 and k = (R+1)²/8,
//!
//! *without* a (1−F) factor on the diffuse part: A plus the specular albedo may therefore exceed 1, by up to 0.04 at normal
//! incidence and up to F = 1 at grazing. Whoever chooses albedos (`synth`) keeps them below about
//! 0.85 so that light decays.
//!
//! * [`ggx`]: value and derivative in R, generic over [`crate::core::math::Real`], in the form that
//!   survives f32;
//! * `vndf`: sampling of visible normals and its density;
//! * [`material`]: a surface's parameters with evaluation, sampling and density in world space;
//! * [`lobe`]: what metals reflect in place of dielectrics;
//! * [`chunk`]: the same value and derivative over structure-of-arrays slices, vectorised.

pub mod chunk;
pub mod ggx;
pub mod lobe;
pub mod material;
pub mod reflectance;
mod vndf;

pub use chunk::{SpecularChunk, specular_chunk};
pub use ggx::{F0, fresnel, ggx_d, smith_g1, specular, specular_d_roughness};
pub use lobe::{BaseColour, DIELECTRIC, SpecularLobe, over_dielectric};
pub use material::{BrdfSample, MIN_ROUGHNESS, Material};
pub use reflectance::Reflectance;
pub use vndf::{ggx_g1_exact, sample_vndf, vndf_reflection_pdf};
