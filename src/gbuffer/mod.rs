//! What each view sees: first hits per pixel, which pixels are free of edges, and the observations
//! of a surface point.

mod clipping;
mod observe;
mod view_buffer;

pub use clipping::clipped_pixels;
pub use observe::{Observation, ObservedView, Observer, Orientation};
pub use view_buffer::{ViewBuffer, pixel_rays};
