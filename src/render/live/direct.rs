//! The direct light of every group on the texels, path traced to the first surface and filtered over
//! it: D_k of `E = Σ s_k D_k + F ρ E`.

use super::groups::{LightGroup, lit_by};
use crate::core::progress::Progress;
use crate::core::trace::Tracer;
use crate::irradiance::Irradiance;
use crate::render::{LightmapTexels, PathTracer, PathTracerOptions, Receiving};
use crate::solution::Solution;
use glam::Vec3;

/// Paths per texel in each of the independent parts, one ray to a lamp and one into the hemisphere
/// each: lamps are near, the light from outside comes through windows far away.
/// Measured (docs/lab/live-relighting.md): ×2 to lamps and ×½ to the sky takes 30 % longer, and the
/// error of edits is the same.
const LAMP_PATHS: u32 = 1;
/// Measured: as above.
const OUTSIDE_PATHS: u32 = 4;

/// Irradiance by group and texel: `[group][texel]`, linear RGB.
pub(super) type Direct = Vec<Vec<Vec3>>;

/// Traces the direct light of each group at the texels of an atlas.
pub(super) fn direct_light(
    solution: &Solution,
    groups: &[LightGroup],
    texels: &LightmapTexels<'_>,
    tracer: &dyn Tracer,
    progress: &Progress,
) -> Direct {
    let options = PathTracerOptions {
        max_bounces: 1,
        ..PathTracerOptions::default()
    };
    let normals = texels.normals();
    let mut filter = None;
    let light_of = |k: usize| {
        let mut factors = vec![Vec3::ZERO; groups.len()];
        factors[k] = Vec3::ONE;
        let mut world = lit_by(solution, groups, &factors);
        if !groups.iter().any(LightGroup::is_outside) {
            world.scale_environment(Vec3::ZERO);
        }
        let renderer = PathTracer::new(&solution.mesh, tracer, &world, &world, options);
        let receiving = Receiving {
            renderer: &renderer,
            cache: None,
            normals: &normals,
        };
        let paths = if groups[k].is_outside() {
            OUTSIDE_PATHS
        } else {
            LAMP_PATHS
        };
        let parts = texels.sample(&receiving, paths, k as u64, progress);
        filter
            .get_or_insert_with(|| texels.filter(&renderer))
            .filter(&Irradiance::of_parts(parts), |_| 1.0)
            .value
    };
    (0..groups.len()).map(light_of).collect()
}
