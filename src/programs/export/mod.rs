//! Files that other programs open.

mod frames;
mod job;
mod mitsuba;
mod punctual;
mod usd;

pub use frames::FrameWriter;
pub use job::{ExportOptions, Format, camera_file, export};
pub use mitsuba::write_mitsuba;
pub use punctual::punctual_lights;
pub use usd::write_usd;
