//! Keyed random numbers, low-discrepancy points and warps.
//!
//! Randomness is keyed by what is computed (texel, pass, sample), never by the thread that computes
//! it.

mod keyed;
mod sobol;
mod warp;

pub use keyed::{KeyedRng, hash_u64};
pub use sobol::{SobolBlock, SobolSequence, hammersley, radical_inverse_base2};
pub use warp::{
    cosine_hemisphere_pdf, disk_from_square, square_to_cosine_hemisphere, square_to_triangle,
    square_to_uniform_hemisphere, uniform_hemisphere_pdf,
};

mod alias;
mod discrete;
mod slots;
pub use alias::AliasTable;
pub use discrete::Discrete;
pub use slots::SlotTable;
