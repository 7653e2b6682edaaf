//! What one texel shows of its albedo, and how far that is from a colour: brightness counts less
//! than hue, in which light errs least. Called by the albedo palette and what it keeps of patterns.

use glam::Vec3;

/// Error of a colour's hue and saturation relative to that of its luminance: light errs in
/// brightness rather than in colour.
/// Measured: ×½ albedo +0.1 dB, ×2 little (docs/constants.md).
const CHROMA: f32 = 0.4;

/// ln albedo and its standard error in luminance.
#[derive(Clone, Copy)]
pub(super) struct Look {
    pub(super) log: Vec3,
    pub(super) error: f32,
}

impl Look {
    pub(super) const fn at(log: Vec3, error: f32) -> Self {
        Self { log, error }
    }

    /// Squared distance to a colour in standard errors.
    pub(super) fn distance2(&self, log: Vec3) -> f32 {
        let d = self.log - log;
        let bright = d.element_sum() / 3.0;
        let hue = d - Vec3::splat(bright);
        (bright * bright + hue.length_squared() / (CHROMA * CHROMA)) / (self.error * self.error)
    }

    /// Density of looks at this distance: Gaussian, of unit mass over (ln albedo)³.
    pub(super) fn density(&self, distance2: f32) -> f32 {
        let volume = (2.0 * std::f32::consts::PI).powf(1.5)
            * 3f32.sqrt()
            * CHROMA
            * CHROMA
            * self.error.powi(3);
        (-0.5 * distance2).exp() / volume
    }
}
