//! What a reconstruction is: the textures that `solve` makes and that evaluation, rendering and export read.

use crate::geometry::Mesh;
use crate::image::{Plane, RgbPlane};
use glam::{DVec3, Vec2};

/// A reconstructed scene. Every texture covers the same atlas; sizes differ. Texture coordinates are `uv · size` with texel
/// centres at +0.5 and row 0 at v = 0; texels outside charts are padded so that bilinear lookups need no mask.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Geometry with the atlas the textures belong to (positions relative to `origin`).
    pub mesh: Mesh,
    /// File coordinates of the internal coordinate origin.
    pub origin: DVec3,
    /// Linear RGB in [0, 1].
    pub albedo: RgbPlane,
    /// Roughness R in [0, 1], α = R².
    pub roughness: Plane<f32>,
    /// Irradiance E, same radiance unit as the images times steradian.
    pub irradiance: RgbPlane,
    /// Outgoing radiance as observed (TBL), without view dependence.
    pub radiance: RgbPlane,
    /// Emitted radiance, 0 where none.
    pub emission: RgbPlane,
    /// Standard errors (albedo, roughness); 1e4 = unobserved.
    pub confidence: Plane<Vec2>,
    /// Class ids per texel, 0 = unlabelled.
    pub labels: Plane<u16>,
    /// Room ids per texel, 0 = outside.
    pub rooms: Plane<u16>,
    /// Radiance from directions without geometry: an equirectangular map in world axes (design §1.1 with the identity pose).
    pub environment: RgbPlane,
}
