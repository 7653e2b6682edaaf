//! Stage "metals": which classes are metal, by views of some of their points.

use super::{Light, SolveOptions};
use crate::core::brdf::{Reflectance, SpecularLobe};
use crate::core::progress::Progress;
use crate::highlight::{Candidate, Evidence, Tabulation, gather_evidence};
use crate::inverse::{Metal, find_metals};
use crate::observed::Surface;
use std::collections::BTreeMap;

/// Points per class that tell whether it is metal: more than twice what a fit takes, few beside the evidence.
const POINTS: usize = 100;

/// Looks for metals among the classes with evidence.
#[must_use]
pub(super) fn look_for_metals(
    surface: &Surface,
    light: &Light,
    evidence: &Evidence,
    model: Reflectance,
    options: &SolveOptions,
    progress: &Progress,
) -> Vec<Metal> {
    let lit = surface.lit(&light.field, &light.emitters);
    let candidates = some_points(evidence);
    progress.stage("metals", candidates.len() as u64, |p| {
        let tabulation = Tabulation {
            levels: &evidence.levels,
            lobes: [
                SpecularLobe::dielectric(model),
                SpecularLobe::white_metal(model),
            ],
            rays_per_lobe: options.evidence_rays,
        };
        let found = gather_evidence(&lit, surface, &candidates, tabulation, options.seed, p);
        find_metals(&found, model)
    })
}

/// At most [`POINTS`] of every class, evenly drawn; what has no label is no one thing.
fn some_points(evidence: &Evidence) -> Vec<Candidate> {
    let mut classes: BTreeMap<u16, Vec<Candidate>> = BTreeMap::new();
    for point in evidence.points.iter().filter(|p| p.class != 0) {
        let candidate = Candidate::at(point.triangle, point.position, point.class);
        classes.entry(point.class).or_default().push(candidate);
    }
    classes
        .into_values()
        .flat_map(|all| {
            let step = all.len().div_ceil(POINTS);
            all.into_iter().step_by(step.max(1))
        })
        .collect()
}

/// The texels of metals: what they show is no diffuse light, so that nothing may be concluded from
/// it as if it were.
pub(super) fn metal_texels<'a>(
    surface: &Surface,
    light: &Light,
    metals: &'a [Metal],
) -> Vec<(u32, &'a Metal)> {
    let metal = |i: usize| {
        let shines = light.emissive[surface.texels.point[i].triangle as usize];
        let class = surface.labels[i];
        metals.iter().find(|m| m.fit.class == class && !shines)
    };
    (0..surface.texels.len())
        .filter_map(|i| Some((i as u32, metal(i)?)))
        .collect()
}
