//! Which pixels of a camera's images show the scene, and not what the camera carries along.

use super::Plane;

/// The mask of all images of one kind and size: tripod, operator, car roof or nadir cap stand in
/// the same place in each of them.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraMask {
    /// Panoramas if true, else pinhole images.
    pub panorama: bool,
    /// Whether a pixel shows the scene, at the images' size.
    pub visible: Plane<bool>,
}

impl CameraMask {
    /// Whether this is the mask of `width × height` images of a kind.
    #[must_use]
    pub fn covers(&self, panorama: bool, width: usize, height: usize) -> bool {
        (self.panorama, self.visible.width, self.visible.height) == (panorama, width, height)
    }

    /// Share of the pixels that do not show the scene.
    #[must_use]
    pub fn masked_share(&self) -> f32 {
        let masked = self.visible.data.iter().filter(|v| !**v).count();
        masked as f32 / self.visible.data.len().max(1) as f32
    }
}
