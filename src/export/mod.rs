//! Files that other programs open.

mod frames;
mod glb;
mod job;
mod mitsuba;
mod picture;
mod usd;

pub use frames::FrameWriter;
pub use glb::{GlbOptions, read_glb_mesh, scene_glb};
pub use job::{ExportOptions, Format, camera_file, export};
pub use mitsuba::write_mitsuba;
pub use picture::{encode_grey8, encode_rgb8, linear_from_srgb, srgb8_from_linear};
pub use usd::write_usd;
