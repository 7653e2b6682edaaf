//! What paths carry from bounce to bounce, and the buffers they are traced in.

use super::scene::KnownLight;
use crate::core::brdf::{BaseColour, DIELECTRIC, Material, Reflectance, over_dielectric};
use crate::core::trace::{Hit, Ray};
use crate::lights::LightSampler;
use glam::Vec3;

/// Which lobes of a vertex are followed; the diffuse one alone is Lambert's, whatever the
/// reflection model. `Neither` is for first hits whose diffuse light is known.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Lobes {
    Both,
    Diffuse,
    Specular,
    Neither,
}

/// How far paths are followed.
#[derive(Clone, Copy)]
pub(super) struct Following<'a> {
    /// The lobes followed at the first hit.
    pub(super) first: Lobes,
    /// Where diffuse light is taken from.
    pub(super) known: KnownLight<'a>,
}

/// A surface interaction.
pub(super) struct Vertex {
    pub(super) position: Vec3,
    pub(super) face_normal: Vec3,
    pub(super) normal: Vec3,
    pub(super) view: Vec3,
    pub(super) material: Material,
    /// Specular reflectance at normal incidence.
    pub(super) f0: Vec3,
    pub(super) lobes: Lobes,
    /// Luminance against which a shadow ray's worth is measured; 0 traces every one.
    pub(super) reference: f32,
}

impl Vertex {
    /// What the specular lobe reflects over a dielectric's under a model.
    pub(super) fn metal_share(&self, model: Reflectance, view: Vec3, light: Vec3) -> Vec3 {
        if self.f0 == DIELECTRIC {
            return Vec3::ONE;
        }
        let h = (view + light).normalize_or(self.normal);
        over_dielectric(self.f0, model.fresnel(view.dot(h).clamp(0.0, 1.0)))
    }
}

/// A path on its way.
#[derive(Clone, Copy)]
pub(super) struct Path {
    pub(super) slot: u32,
    /// Throughput after the first vertex.
    pub(super) beta: Vec3,
    /// Factors of the first vertex' diffuse (with albedo) and specular lobe.
    pub(super) first: [Vec3; 2],
    /// Where the last direction was drawn, on a surface of which normal, and with what density.
    pub(super) origin: Vec3,
    pub(super) normal: Vec3,
    pub(super) pdf: f32,
}

/// Collected light of one path.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) emission: Vec3,
    pub(super) diffuse: Vec3,
    pub(super) specular: Vec3,
}

/// A shadow ray and what it brings if nothing is in its way.
pub(super) struct ShadowRay {
    pub(super) slot: u32,
    pub(super) diffuse: Vec3,
    pub(super) specular: Vec3,
}

/// Features of a path's first hit.
#[derive(Clone, Copy)]
pub(super) struct Feature {
    pub(super) base: BaseColour,
    pub(super) transmission: f32,
    /// Albedo of the diffuse part; through panes what is seen of it behind them is added.
    pub(super) albedo: Vec3,
    pub(super) roughness: f32,
    /// Of the last surface that is seen through panes, as is the distance.
    pub(super) normal: Vec3,
    pub(super) depth: f32,
    pub(super) label: u16,
}

/// Keys of a path: what its random numbers derive from.
#[derive(Clone, Copy)]
pub(super) struct PathKey {
    pub(super) key: u64,
    pub(super) sample: u32,
}

/// Buffers of one task, kept between bounces.
#[derive(Default)]
pub(super) struct Wave {
    pub(super) paths: Vec<Path>,
    pub(super) rays: Vec<Ray>,
    pub(super) hits: Vec<Hit>,
    pub(super) next_paths: Vec<Path>,
    pub(super) next_rays: Vec<Ray>,
    pub(super) shadow: Vec<ShadowRay>,
    pub(super) shadow_rays: Vec<Ray>,
    pub(super) occluded: Vec<u8>,
    /// What the light along rays counts for the panes they passed.
    pub(super) passed: Vec<Vec3>,
    /// The lights as the vertex at hand chooses among them.
    pub(super) choice: LightSampler,
}
