//! The ground: mathematics, images, meshes, textures, rays, reflection and files, in words that every
//! graphics program shares. Nothing here knows what a reconstruction is.

pub mod blocks;
pub mod brdf;
pub mod formats;
pub mod geometry;
pub mod image;
pub mod lock;
pub mod math;
pub mod memory;
pub mod metrics;
pub mod network;
pub mod parallel;
pub mod progress;
pub mod sampling;
pub mod stats;
pub mod switch;
pub mod texture;
pub mod trace;
