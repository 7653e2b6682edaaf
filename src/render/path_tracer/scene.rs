//! What the path tracer renders: materials and emission of surfaces, the light from outside, known
//! irradiance.

use crate::core::brdf::{BaseColour, Material, Reflectance};
use glam::Vec3;

/// What light meets at a surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Colour, and how much of it is metal's.
    pub base: BaseColour,
    /// Share in [0, 1] of the light not reflected specularly that goes straight through instead of
    /// being scattered; its colour is the base's, metal has none.
    pub transmission: f32,
    /// Roughness R.
    pub roughness: f32,
    /// Emitted radiance.
    pub emission: Vec3,
}

impl Surface {
    /// A surface that is no metal.
    #[must_use]
    pub const fn dielectric(material: Material, emission: Vec3) -> Self {
        Self {
            base: BaseColour {
                colour: material.albedo,
                metallic: 0.0,
            },
            transmission: 0.0,
            roughness: material.roughness,
            emission,
        }
    }

    /// The diffuse part, and the lobe but for its reflectance at normal incidence.
    #[must_use]
    pub fn material(&self) -> Material {
        Material {
            albedo: self.base.diffuse() * (1.0 - self.transmission),
            roughness: self.roughness,
        }
    }

    /// What goes straight through of light that arrives at `cosine` to the normal, [0, 1].
    #[must_use]
    pub fn transmittance(&self, cosine: f32) -> Vec3 {
        self.base.transmitted(self.transmission, cosine)
    }
}

/// Materials and emission of a mesh.
pub trait SurfaceModel: Sync {
    /// The surface at barycentrics (u, v) of a triangle.
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface;
    /// Mean emitted radiance of a triangle: decides how often it is sampled as a light. Must be
    /// positive where it emits.
    fn mean_emission(&self, triangle: usize) -> Vec3;
    /// Class id of a triangle; 0 = unlabelled.
    fn label(&self, triangle: usize) -> u16;
    /// Whether light passes through any surface.
    fn has_panes(&self) -> bool {
        false
    }
    /// The reflection model that the materials belong to.
    fn reflectance(&self) -> Reflectance {
        Reflectance::Paper
    }
    /// Whether the diffuse part lies below the dielectric lobe and has only what that lets through,
    /// 1 − F(v·h) (Khronos Group 2021, glTF 2.0, appendix B.3.5); else it is beside it, as in the paper.
    fn is_layered(&self) -> bool {
        false
    }
    /// Whether a triangle emits only towards the side its winding faces (false: towards both).
    fn emits_forward_only(&self, _triangle: usize) -> bool {
        false
    }
}

/// Light from directions without geometry.
pub trait Environment: Sync {
    /// Radiance arriving from a unit direction (pointing away from the scene).
    fn radiance(&self, direction: Vec3) -> Vec3;
    /// Whether no light comes from outside at all.
    fn is_black(&self) -> bool {
        false
    }
}

/// No light from outside.
pub struct BlackEnvironment;
impl Environment for BlackEnvironment {
    fn radiance(&self, _: Vec3) -> Vec3 {
        Vec3::ZERO
    }
    fn is_black(&self) -> bool {
        true
    }
}

/// Irradiance that need not be sampled.
#[derive(Clone, Copy, Default)]
pub struct KnownLight<'a> {
    /// At the points the camera sees: only their specular lobe is followed. The diffuse part is
    /// then free of noise.
    pub first: Option<&'a dyn IndirectCache>,
    /// At all later points of a path: only the specular lobe is followed on.
    pub later: Option<&'a dyn IndirectCache>,
}

/// Irradiance known on surfaces.
pub trait IndirectCache: Sync {
    /// Irradiance on the front side at barycentrics (u, v) of a triangle.
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3;
}
