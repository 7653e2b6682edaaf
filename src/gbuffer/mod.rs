//! What each view sees: first hits per pixel, which pixels are free of edges, and the observations
//! of a surface point.

mod observe;
mod orientation;
mod view_buffer;

pub use observe::{Observation, ObservedView, Observer};
pub use orientation::{Orientation, Probe};
pub use view_buffer::{PixelRays, ViewBuffer, wrap_of};
