//! Whether a class that seems matte may be glossy: the slope of what the views show against the
//! specular response that a roughness predicts.
//!
//! The robust disagreement ([`super::view_residual`]) takes highlights of a few pixels for
//! outliers, and a response that misses them by a pixel explains the views less than none. The slope
//! a(R) of observed on predicted differences between a point's views tells the two apart: it is 0 at
//! every sharp level where there is no gloss, and errors of the prediction (place, footprint, light
//! field) only attenuate it (regression dilution, Fuller 1987, 1.1): a gloss of roughness R has a(R)
//! between ½ and 1. Where even the sharpest lobe predicts less than is seen, the differences are not
//! gloss, and the slope says nothing. Products of the two halves of a response have no noise bias.
//! Called by [`super::roughness`] for every class.

use super::confidence::LIGHT_ERROR;
use super::group_fit::GroupFit;
use super::view_residual::COMMON_SHARE;
use crate::core::brdf::Reflectance;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, GROSS_ERRORS, Mean, passing_weight};
use crate::highlight::Evidence;
use glam::Vec3;

/// Roughness below which highlights can be seen, and above which a fit counts as matte; as wide a range of values that
/// explain the views equally well says nothing. Derived: half of all there are, [0, 1]: less than one bit is known.
pub(super) const MIDDLE: f32 = 0.5;
/// Least slope of gloss. Derived: a prediction of signal s and error e has the slope s² / (s² + e²) (regression
/// dilution), and s ≥ e.
const DILUTED: f64 = 0.5;

/// Slope and standard error per level.
struct Slopes(Vec<(f64, f64)>);

/// Sums of observed by predicted, and of predicted by predicted differences per level.
type Moments = Vec<[f64; 2]>;

/// Averages a fit that seems matte with the gloss that the slopes allow (Hoeting et al. 1999).
pub(super) fn reconsider(
    evidence: &Evidence,
    model: Reflectance,
    points: &[usize],
    found: &mut GroupFit,
) {
    let matte = passing_weight(f64::from(found.roughness), f64::from(MIDDLE));
    let enough = passing_weight(points.len() as f64, ENOUGH as f64);
    if matte * enough <= 0.0 {
        return;
    }
    Slopes::of(evidence, model, points).average(&evidence.levels, matte * enough, found);
}

impl Slopes {
    fn of(evidence: &Evidence, model: Reflectance, points: &[usize]) -> Self {
        let places: Vec<Vec3> = (points.iter())
            .map(|&i| evidence.points[i].position)
            .collect();
        let own: Vec<Moments> = (points.par_iter())
            .map(|&i| moments(evidence, model, i))
            .collect();
        let slope = |k: usize| {
            let total: f64 = own.iter().map(|m| m[k][1]).sum();
            if total <= 0.0 {
                return (0.0, f64::INFINITY);
            }
            let a = own.iter().map(|m| m[k][0]).sum::<f64>() / total;
            // of a ratio (Cochran 1977, 2.11); neighbours err together
            let off: Vec<f64> = own.iter().map(|m| m[k][0] - a * m[k][1]).collect();
            (
                a,
                Mean::over(&places, &off).error * off.len() as f64 / total,
            )
        };
        let levels = (0..evidence.levels.len()).into_par_iter().with_max_len(1);
        Self(levels.map(slope).collect())
    }

    /// How likely the slope of level `k` is, which errors common to all points make uncertain, or corrupt.
    fn likelihood(&self, k: usize) -> f64 {
        let (a, error) = self.0[k];
        let z = (a - a.clamp(DILUTED, 1.0)) / error.hypot(f64::from(LIGHT_ERROR));
        (1.0 - GROSS_ERRORS) * (-0.5 * z * z).exp() + GROSS_ERRORS
    }

    fn average(&self, levels: &[f32], matte: f64, found: &mut GroupFit) {
        let (sharpest, error) = self.0[0];
        let gloss = passing_weight(1.0 - sharpest, error);
        let least = found.disagreement();
        if !gloss.is_finite() || least <= 0.0 {
            return;
        }
        let last = levels.len() - 1;
        // the mean of n disagreements that scatter as much as they are large is known to 1/√n
        let common = COMMON_SHARE.hypot((found.points.max(1) as f64).sqrt().recip());
        let (mut all, mut glossy, mut first, mut second) = (0.0, 0.0, 0.0, 0.0);
        for (k, level) in levels.iter().enumerate() {
            let (below, above) = (levels[k.saturating_sub(1)], levels[(k + 1).min(last)]);
            let weight = f64::from(above - below)
                * (-(found.objective[k] / least - 1.0) / common).exp()
                * self.likelihood(k);
            all += weight;
            if *level < MIDDLE {
                let r = f64::from(*level);
                glossy += weight;
                first += weight * r;
                second += weight * r * r;
            }
        }
        let share = matte * gloss * glossy / all;
        if share.is_nan() || share <= 0.0 {
            return;
        }
        let centre = first / glossy;
        let variance = (second / glossy - centre * centre).max(0.0);
        let (old, error) = (f64::from(found.roughness), f64::from(found.error));
        let mean = share * centre + (1.0 - share) * old;
        let spread = share * (variance + (centre - mean).powi(2))
            + (1.0 - share) * (error * error + (old - mean).powi(2));
        found.roughness = mean as f32;
        found.error = spread.sqrt().min(1.0) as f32;
    }
}

/// A point's moments: weighted over its views, relative to their median luminance.
fn moments(evidence: &Evidence, model: Reflectance, point: usize) -> Moments {
    let m = evidence.dielectric(model);
    let p = &evidence.points[point];
    let views = p.first as usize..(p.first + p.count) as usize;
    let bright = |j: usize| luminance(evidence.sights[j].radiance);
    let scale = evidence.median_luminance(views.clone());
    let total: f32 = views.clone().map(|j| evidence.sights[j].weight).sum();
    let mean = |of: &dyn Fn(usize) -> f32| {
        let sum: f32 = views
            .clone()
            .map(|j| evidence.sights[j].weight * of(j))
            .sum();
        f64::from(sum / total)
    };
    let seen = |j: usize| bright(j) / scale;
    let seen_mean = mean(&seen) as f32;
    (0..evidence.levels.len())
        .map(|k| {
            let response = |j: usize| luminance(evidence.response(j, m)[k]) / scale;
            let noise = |j: usize| evidence.noise(j, m)[k] / scale;
            let (response_mean, noise_mean) = (mean(&response) as f32, mean(&noise) as f32);
            let of = |j: usize| (response(j) - response_mean, noise(j) - noise_mean);
            [
                mean(&|j| (seen(j) - seen_mean) * of(j).0),
                mean(&|j| of(j).0 * of(j).0 - of(j).1 * of(j).1),
            ]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::highlight::LEVELS;

    fn matte_by_a_hair() -> GroupFit {
        GroupFit {
            class: 1,
            roughness: 1.0,
            error: 0.05,
            own_error: 0.05,
            objective: LEVELS
                .iter()
                .map(|r| 0.05 * (1.0 + 0.04 * f64::from(1.0 - r)))
                .collect(),
            points: 500,
        }
    }

    /// Slopes of a class whose response falls as 1/R² from `sharp` at the sharpest level on.
    fn slopes(sharp: f64) -> Slopes {
        let slope = |r: &f32| (sharp * (1.0 + f64::from(r / 0.31).powi(2)), 0.05);
        Slopes(LEVELS.iter().map(slope).collect())
    }

    #[test]
    fn a_slope_between_a_half_and_one_refutes_matte_and_its_error_tells() {
        let mut found = matte_by_a_hair();
        slopes(0.3).average(&LEVELS, 1.0, &mut found);
        assert!(found.roughness < 0.65, "{found:?}");
        assert!(
            (found.roughness - 0.31).abs() < 2.0 * found.error,
            "{found:?}"
        );
    }

    #[test]
    fn what_no_lobe_predicts_or_no_view_shows_is_left_alone() {
        for sharp in [1.2, 0.0] {
            let mut found = matte_by_a_hair();
            found.objective[17] *= if sharp == 0.0 { 0.6 } else { 1.0 };
            slopes(sharp).average(&LEVELS, 1.0, &mut found);
            assert!(found.roughness > 0.97, "{sharp}: {found:?}");
        }
    }
}
