//! What the photographs see of the geometry: fused radiance and labels on the atlas, exposure and
//! white balance of the views.

mod camera_fixed;
mod class_map;
mod contradictions;
mod find_panes;
mod fusion;
mod gains;
mod labels;
mod pair_gains;
mod panes;
mod photometric;
mod scanned;
mod surface;

pub use camera_fixed::{CameraRig, find_camera_rigs};
pub use class_map::ClassMap;
pub use contradictions::{Contradictions, MissingGeometry};
pub use find_panes::find_panes;
pub(crate) use fusion::prefer_clean;
pub use fusion::{Fusion, UNSEEN, fuse_radiance};
pub use gains::{ViewGains, estimate_gains};
pub(crate) use labels::complete_labels;
pub use panes::{Pane, Panes};
pub(crate) use photometric::{balance_views, leave_out_clipped_sky};
pub use scanned::{ScannedSurface, scanned_surface};
pub use surface::{ClippedTexel, Surface, TextureSizes};
pub(crate) use surface::{coverage, filled};

#[cfg(test)]
pub(crate) use surface::tests as surface_tests;
