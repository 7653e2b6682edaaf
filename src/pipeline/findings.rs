//! What a reconstruction knows about its own faults, for [`crate::verdict`]: gathered from the
//! surface, the light and the albedo once they stand, by the stage that assembles the result.

use super::Light;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::median;
use crate::inverse::AlbedoEstimate;
use crate::observed::Surface;
use crate::scene::Shortfall;
use crate::verdict::{Findings, GUESS, Reason, Share};
use std::collections::BTreeMap;

/// Classes that a finding names at most.
const NAMED: usize = 3;

/// How far the looks at each texel disagree, relative to the albedo: before paint settles it, which
/// takes the disagreement out of sight. Not a number where fewer than two looks tell.
pub(super) fn spread_of_looks(albedo: &AlbedoEstimate) -> Vec<f32> {
    (0..albedo.value.len())
        .map(|i| {
            let value = luminance(albedo.value[i]);
            let tells = albedo.clean[i] && albedo.looks[i] >= 1.5 && value > 0.0;
            if tells {
                albedo.error[i] * albedo.looks[i].sqrt() / value
            } else {
                f32::NAN
            }
        })
        .collect()
}

/// Gathers the findings; `spread` as from [`spread_of_looks`], `albedo` and `errors` as they go
/// into the result.
pub(super) fn findings(
    surface: &Surface,
    light: &Light,
    albedo: &AlbedoEstimate,
    errors: &[f32],
    spread: &[f32],
) -> Findings {
    let texels = &surface.texels;
    let area: Vec<f64> = (0..texels.len())
        .into_par_iter()
        .map(|i| f64::from(texels.area(&surface.scene.mesh, i)))
        .collect();
    let emits = |i: usize| light.emissive[texels.point[i].triangle as usize];
    let seen = |i: usize| surface.fusion.views[i] > 0;
    let known = |i: usize| seen(i) && !emits(i) && errors[i].is_finite();
    let tally = Tally {
        surface,
        area: &area,
    };
    // by the pixels of the sharpest look: what is looked at counts, not slivers behind a sofa
    let pixels: Vec<f64> = (0..texels.len())
        .map(|i| area[i] / f64::from(albedo.footprint[i]).powi(2))
        .map(|n| if n.is_finite() { n } else { 0.0 })
        .collect();
    let shown = Tally {
        surface,
        area: &pixels,
    };
    let value = |i: usize| f64::from(luminance(albedo.value[i]));
    let at_bound = |i: usize| {
        let v = albedo.value[i];
        v.max_element() >= 1.0 || v.min_element() <= 0.0
    };
    let labelled = surface.is_labelled();
    let told = |i: usize| !spread[i].is_nan() && !emits(i);
    let middle = median(
        (0..spread.len())
            .filter(|&i| told(i))
            .map(|i| spread[i])
            .collect(),
    );
    let uneven = tally.share(told, |i| spread[i] > middle.unwrap_or(0.0));
    Findings {
        mean_albedo: shown.mean(known, |i| value(i).clamp(0.0, 1.0)),
        // (no estimate need be worse than a guess)
        stated_error: shown
            .mean(known, |i| f64::from(errors[i]).min(GUESS).powi(2))
            .sqrt(),
        disagreement: f64::from(surface.disagreement),
        disagreement_place: uneven.place,
        unseen: tally.share(|_| true, |i| !seen(i)),
        seen_once: tally.share(known, |i| surface.fusion.views[i] == 1),
        albedo_at_bound: tally.share(known, at_bound),
        unlabelled: tally.share(known, |i| surface.fusion.label[i] == 0),
        labelled,
        others: doubts_of_files(&surface.shortfalls),
        ..Findings::default()
    }
}

/// Error of the albedo where photographs are gamma-encoded and taken as linear. Measured: 13.4 dB
/// (`synth --rooms 1 --views 6 --width 256`, sRGB-encoded and cut off at 1, draft; 2026-11-25).
const ENCODED: f64 = 0.21;

/// The doubt about infinite pixels on lights whose radiance is not estimated.
pub(super) fn doubt_of_infinite(files: &[Shortfall]) -> Option<Reason> {
    let infinite: usize = files.iter().map(|s| s.infinite_on_lights).sum();
    (infinite > 0).then(|| Reason {
        what: format!(
            "{infinite} infinite pixels on lights count as no brighter than the room, since light beyond the ceiling is not estimated: save the images in single precision"
        ),
        // nobody knows how much: no better than a guess
        weight: GUESS,
        place: String::new(),
    })
}

/// What the files' values give reason to doubt, though each could be right.
fn doubts_of_files(files: &[Shortfall]) -> Vec<Reason> {
    let mut doubts = Vec::new();
    let ending = files.iter().filter(|s| s.ends_at_one).count();
    if ending > 0 {
        doubts.push(Reason {
            what: format!(
                "{ending} of {} photographs end at exactly 1: clipped light, or gamma-encoded pictures for screens (\"color_space\" in transforms.json says which: \"rec709\" or \"srgb\")",
                files.len()
            ),
            // as likely as not
            weight: ENCODED * (0.5 * ending as f64 / files.len() as f64).sqrt(),
            place: String::new(),
        });
    }
    doubts
}

/// Means and shares by area.
struct Tally<'a> {
    surface: &'a Surface<'a>,
    /// Area of each covered texel, in whatever unit.
    area: &'a [f64],
}

impl Tally<'_> {
    /// Mean of `value` over the texels that count; 0 where none does.
    fn mean(&self, counts: impl Fn(usize) -> bool, value: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut whole) = (0.0, 0.0);
        for i in (0..self.area.len()).filter(|&i| counts(i)) {
            sum += self.area[i] * value(i);
            whole += self.area[i];
        }
        if whole > 0.0 { sum / whole } else { 0.0 }
    }

    /// Share of those that count for which `holds`, with the classes that have most of it.
    fn share(&self, counts: impl Fn(usize) -> bool, holds: impl Fn(usize) -> bool) -> Share {
        let mut classes: BTreeMap<u16, f64> = BTreeMap::new();
        for i in (0..self.area.len()).filter(|&i| counts(i) && holds(i)) {
            *classes.entry(self.surface.labels[i]).or_default() += self.area[i];
        }
        let mut order: Vec<(u16, f64)> = classes.into_iter().filter(|c| c.1 > 0.0).collect();
        order.sort_by(|a, b| b.1.total_cmp(&a.1));
        let scene = self.surface.scene;
        let names: Vec<String> = order
            .iter()
            .take(NAMED)
            .map(|(id, _)| scene.class_name(*id))
            .collect();
        Share {
            share: self.mean(&counts, |i| f64::from(u8::from(holds(i)))),
            place: names.join(", "),
        }
    }
}
