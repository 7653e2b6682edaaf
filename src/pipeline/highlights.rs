//! Stage "highlights": points per class whose views tell of roughness, and their specular response
//! at tabulated roughness levels.

use super::decisions::{choose_matte, report_matte};
use super::{Light, SolveOptions};
use crate::core::progress::Progress;
use crate::highlight::{
    Candidate, DIELECTRICS, Evidence, SelectOptions, Tabulation, gather_evidence, roughness_levels,
    select_points,
};
use crate::observed::{ClassMap, Surface};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

/// Points per class that tell whether its highlights can be observed.
const PILOT: usize = 1500;

/// What highlights tell.
pub struct Highlights {
    /// Points, their sights and tabulated responses.
    pub evidence: Evidence,
    /// Classes whose lobes are certain to be too wide for highlights.
    pub matte: BTreeSet<u16>,
}

/// Selects points and traces their specular responses.
#[must_use]
pub fn gather_highlights(
    surface: &Surface,
    light: &Light,
    options: &SolveOptions,
    progress: &Progress,
) -> Highlights {
    let lit = surface.lit(&light.field, &light.emitters);
    let classes = ClassMap::new(surface, &light.emissive);
    let candidates = progress.stage("highlights", 0, |_| {
        let select = SelectOptions {
            stride: 3,
            even: options.evidence_points,
            highlights: options.evidence_points,
            seed: options.seed,
        };
        select_points(&lit, surface, &classes, &select)
    });
    let found = progress.stage("specular samples", candidates.len() as u64, |p| {
        let levels = roughness_levels(options.roughness_levels);
        let tabulation = Tabulation {
            levels: &levels,
            lobes: DIELECTRICS,
            rays_per_lobe: options.evidence_rays,
        };
        let gather =
            |some: &[Candidate]| gather_evidence(&lit, surface, some, tabulation, options.seed, p);
        // a few points per class tell whether the others can add anything
        let (pilot, rest) = divided(&candidates, PILOT);
        let begin = Instant::now();
        let mut evidence = gather(&pilot);
        let seconds = begin.elapsed().as_secs_f64();
        let matte = choose_matte(&evidence, options);
        let mut rest: Vec<Candidate> = rest
            .into_iter()
            .filter(|c| !matte.contains(&c.class))
            .collect();
        if let Some(budget) = &options.budget {
            let keep = budget.evidence(pilot.len(), seconds, evidence.rays, rest.len(), progress);
            let all = rest.len().max(1);
            rest = rest
                .into_iter()
                .enumerate()
                .filter(|(i, _)| (i + 1) * keep / all > i * keep / all)
                .map(|(_, c)| c)
                .collect();
        }
        evidence.append(gather(&rest));
        Highlights { evidence, matte }
    });
    report_matte(surface.scene, &found.matte, options, progress);
    found
}

/// About `few` candidates of every class, evenly drawn, and the others.
fn divided(candidates: &[Candidate], few: usize) -> (Vec<Candidate>, Vec<Candidate>) {
    let mut size: BTreeMap<u16, usize> = BTreeMap::new();
    candidates
        .iter()
        .for_each(|c| *size.entry(c.class).or_default() += 1);
    let mut at: BTreeMap<u16, usize> = BTreeMap::new();
    candidates.iter().copied().partition(|c| {
        let k = at.entry(c.class).or_default();
        *k += 1;
        (*k - 1).is_multiple_of(size[&c.class].div_ceil(few))
    })
}
