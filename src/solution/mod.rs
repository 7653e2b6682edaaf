//! What a reconstruction is: the textures that `solve` makes and that evaluation, rendering and
//! export read.

mod camera_masks;
mod generation;
mod glb;
mod glb_geometry;
mod glb_lights;
mod glb_textures;
mod lamps;
mod mesh_part;
mod store;

pub use generation::check_generation;
pub use glb::{GlbOptions, objects_glb, scene_glb};
pub use glb_lights::{LuminousPart, PunctualLight, SpotCone};
pub use glb_textures::{
    NamedImage, TextureFormat, TexturePacking, material_textures, png_textures,
};
pub use lamps::{LIGHTS, Lamp, LampKind, find_lamps, lamp_gap, triangle_emission};
pub use mesh_part::{DetailLevel, MeshPart, copies_among};
pub use store::{FILES, SaveOptions};

use crate::core::brdf::Reflectance;
use crate::core::geometry::Mesh;
use crate::core::image::{CameraMask, Plane, RgbPlane, Wrap};
use glam::{DVec3, Vec2};

/// A reconstructed scene. Every texture covers the same atlas; sizes differ. Texture coordinates
/// are `uv · size` with texel centres at +0.5 and row 0 at v = 0; texels outside charts are padded
/// so that bilinear lookups need no mask.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Geometry with the atlas the textures belong to (positions relative to `origin`).
    pub mesh: Mesh,
    /// File coordinates of the internal coordinate origin.
    pub origin: DVec3,
    /// Linear RGB in [0, 1]; where there is metal, what it reflects at normal incidence.
    pub albedo: RgbPlane,
    /// Share of metal in [0, 1], size and layout of the albedo; `None` where the scene has none.
    pub metallic: Option<Plane<f32>>,
    /// Share in [0, 1] of the light that is not reflected specularly which goes straight through
    /// instead of being scattered, size and layout of the albedo; the albedo is its tint then.
    /// `None` where nothing is transparent.
    pub transmission: Option<Plane<f32>>,
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
    /// Relative standard error of the irradiance's luminance, 0 outside charts; `None` where nobody
    /// estimated it.
    pub irradiance_error: Option<Plane<f32>>,
    /// Class ids per texel, 0 = unlabelled.
    pub labels: Plane<u16>,
    /// Room ids per texel, 0 = outside.
    pub rooms: Plane<u16>,
    /// Radiance from directions without geometry: an equirectangular map in world axes
    /// (docs/scene-format.md with the identity pose).
    pub environment: RgbPlane,
    /// The reflection model that albedo and roughness belong to.
    pub reflectance: Reflectance,
    /// Its lamps, most powerful first: every program numbers them by this list.
    pub lamps: Vec<Lamp>,
    /// Openings to the environment, numbered on from the lamps. They have no triangles: their light
    /// is the environment's.
    pub portals: Vec<Lamp>,
    /// What the photographs' cameras carry along, one mask per kind and size of image; those
    /// without any are left out.
    pub camera_masks: Vec<CameraMask>,
}

impl Solution {
    /// The class at a place of the atlas; 0 = unlabelled.
    #[must_use]
    pub fn class_at(&self, uv: Vec2) -> u16 {
        let size = Vec2::new(self.labels.width as f32, self.labels.height as f32);
        *self.labels.nearest(uv * size)
    }

    /// The share of metal at a place of the atlas, [0, 1].
    #[must_use]
    pub fn metal_at(&self, uv: Vec2) -> f32 {
        share_at(self.metallic.as_ref(), uv)
    }

    /// The share of transmitted light at a place of the atlas, [0, 1].
    #[must_use]
    pub fn transmission_at(&self, uv: Vec2) -> f32 {
        share_at(self.transmission.as_ref(), uv)
    }

    /// Which triangles let light through anywhere, looked at in the cells of a grid of 6 steps along
    /// each edge; `None` where nothing is transparent.
    #[must_use]
    pub fn pane_triangles(&self) -> Option<Vec<bool>> {
        self.transmission.as_ref()?;
        let steps = PANE_STEPS as f32;
        let cells = || (0..PANE_STEPS).flat_map(|i| (0..PANE_STEPS - i).map(move |j| (i, j)));
        let transparent = |t: usize| {
            cells().any(|(i, j)| {
                let at = |k: u32| (k as f32 + 1.0 / 3.0) / steps;
                self.transmission_at(self.mesh.uv(t, at(i), at(j))) > HALF_A_STEP
            })
        };
        let panes: Vec<bool> = (0..self.mesh.triangles.len()).map(transparent).collect();
        panes.contains(&true).then_some(panes)
    }
}

/// Steps along a triangle's edge at which it is looked at for glass: a pane is as large as a
/// triangle, or nearly.
const PANE_STEPS: u32 = 6;
/// Shares that 8 bits round to 0. Derived.
const HALF_A_STEP: f32 = 0.5 / 255.0;

/// A texture's value at a place of the atlas; 0 without one.
fn share_at(share: Option<&Plane<f32>>, uv: Vec2) -> f32 {
    share.map_or(0.0, |s| {
        s.bilinear(uv * Vec2::new(s.width as f32, s.height as f32), Wrap::Clamp)
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::Vec3;

    /// A complete little solution for tests of whatever reads one: two triangles, textures of
    /// different sizes.
    pub(crate) fn small_solution() -> Solution {
        let mesh = Mesh {
            positions: vec![
                Vec3::new(-1.0, 0.1, -1.0 / 3.0),
                Vec3::new(1.0, 0.1, -1.0 / 3.0),
                Vec3::new(1.0, 0.1, 1.7),
                Vec3::new(-1.0, 0.1, 1.7),
            ],
            normals: vec![Vec3::Y; 4],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
        };
        let ramp = |w: usize, h: usize, scale: f32| Plane {
            width: w,
            height: h,
            data: (0..w * h)
                .map(|i| Vec3::new(i as f32, (i % w) as f32, 1.0) * (scale / (w * h) as f32))
                .collect(),
        };
        let mut emission = Plane::filled(8, 8, Vec3::ZERO);
        emission.data[9] = Vec3::new(12.5, 10.0, 3.0);
        Solution {
            mesh,
            origin: DVec3::new(10_000.123_456_789, -2.5, 0.1),
            albedo: ramp(16, 16, 0.8),
            roughness: Plane {
                width: 32,
                height: 32,
                data: (0..1024).map(|i| i as f32 / 1023.0).collect(),
            },
            irradiance: ramp(8, 8, 6.0),
            radiance: ramp(8, 8, 2.0),
            emission,
            confidence: Plane {
                width: 16,
                height: 16,
                data: (0..256).map(|i| Vec2::new(i as f32 * 0.01, 1e4)).collect(),
            },
            metallic: None,
            transmission: None,
            irradiance_error: Some(Plane {
                width: 16,
                height: 16,
                data: (0..256).map(|i| i as f32 * 0.001).collect(),
            }),
            labels: Plane {
                width: 16,
                height: 16,
                data: (0..256).map(|i| (i % 7) as u16 * 9000).collect(),
            },
            rooms: Plane::filled(16, 16, 1),
            environment: ramp(8, 4, 3.0),
            reflectance: Reflectance::Burley,
            lamps: Vec::new(),
            portals: Vec::new(),
            camera_masks: vec![CameraMask {
                panorama: true,
                visible: Plane {
                    width: 8,
                    height: 4,
                    data: (0..32).map(|i| i < 24).collect(),
                },
            }],
        }
    }
}
