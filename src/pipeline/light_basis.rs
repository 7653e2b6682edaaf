//! The irradiance that some texels or parts of the sky throw, each alone. Light adds up, so an unknown
//! radiance can be fitted to what surfaces show. And the bake of few samples that they and `light` share. Called by
//! `clipped_light`, `hidden_faces` and `light`.

use super::texel_radiance::texture_of;
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::irradiance::{Irradiance, IrradianceOptions, bake_irradiance};
use crate::lights::{Emitters, LitScene};
use crate::observed::Surface;
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use glam::Vec3;

/// What sends light, up to three sources in a channel each.
pub(super) struct Sources {
    /// Radiance that texels send, 0 where they are no source.
    pub(super) sent: Vec<Vec3>,
    /// Radiance from outside.
    pub(super) environment: Environment,
}

/// Irradiance of the sources alone at the texels of `coarse`, bounced light not included; unit: π × that of the
/// radiances for a source all around.
pub(super) fn light_of(
    surface: &Surface,
    sources: Sources,
    coarse: &Texels,
    options: &IrradianceOptions,
) -> Vec<Vec3> {
    let Sources { sent, environment } = sources;
    let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
    let mut emissive = vec![false; mesh.triangles.len()];
    for (p, sent) in texels.point.iter().zip(&sent) {
        emissive[p.triangle as usize] |= *sent != Vec3::ZERO;
    }
    let on_light: Vec<bool> = (texels.point.iter())
        .map(|p| emissive[p.triangle as usize])
        .collect();
    let surfaces = SurfaceRadiance {
        radiance: texture_of(texels, &sent),
        emissive: texels.scatter(&on_light, false),
        emissive_triangles: &emissive,
        back: Vec::new(),
    };
    let field = LightField::new(mesh, &surface.orientation, surfaces, environment);
    let emitters = emitters_of(surface, &field, coarse);
    let lit = surface.lit(&field, &emitters);
    bake(surface, lit, coarse, options, &Progress::silent()).value
}

/// What a light field sends from, to be sampled from the texels of `receivers`.
pub(super) fn emitters_of(surface: &Surface, field: &LightField, receivers: &Texels) -> Emitters {
    let probes: Vec<(Vec3, Vec3)> = (0..receivers.len())
        .map(|i| surface.receiver(receivers, i))
        .map(|r| (r.position, r.normal))
        .collect();
    Emitters::new(&surface.scene.mesh, field, &surface.tracer, &probes)
}

/// The irradiance of `texels` in a light.
pub(super) fn bake(
    surface: &Surface,
    lit: LitScene<'_>,
    texels: &Texels,
    options: &IrradianceOptions,
    progress: &Progress,
) -> Irradiance {
    bake_irradiance(
        &lit.into(),
        texels.len(),
        |i| surface.receiver(texels, i),
        options,
        progress,
    )
}
