//! Files that other programs open.

mod frames;
mod glb;
mod picture;

pub use frames::FrameWriter;
pub use glb::{GlbOptions, read_glb_mesh, scene_glb};
pub use picture::{encode_grey8, encode_rgb8, linear_from_srgb, srgb8_from_linear};
