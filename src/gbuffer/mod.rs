//! What each view sees: first hits per pixel, which pixels are free of edges, and the observations
//! of a surface point.

mod clipping;
mod observe;
mod orientation;
mod view_buffer;

<<<<<<< HEAD
pub use clipping::clipped_pixels;
pub use observe::{Observation, ObservedView, Observer};
pub use orientation::{Orientation, Probe};
=======
pub use clipping::clipped_channels;
pub use observe::{Observation, ObservedView, Observer, Orientation};
>>>>>>> d9703df (Clipped light: the radiance of lights beyond the sensor's ceiling from the shading they throw)
pub use view_buffer::{ViewBuffer, pixel_rays};
