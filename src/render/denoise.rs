//! (being written)
use super::Frame;
use crate::image::RgbPlane;
/// Denoises.
pub fn denoise(frame: &Frame, _panorama: bool) -> RgbPlane {
    frame.radiance()
}
