//! The atlas: which texel lies on which point of the mesh, lookups with footprints, and filling of
//! what charts leave empty.

mod fill;
mod mips;
mod reduce;
mod shelves;
mod texels;

pub use fill::{Texel, fill_uncovered};
pub use mips::MipChain;
pub use reduce::{AtlasReduction, fitted};
pub use shelves::{Shelves, shelves};
pub use texels::{SurfacePoint, Texels};
