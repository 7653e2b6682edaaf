//! Stage II: one roughness per class by a pooled search over the evidence.
//!
//! The disagreement of the views ([`super::view_residual`]), summed over the points of a group, is
//! tabulated at all levels; its global minimum is the answer and its depth the confidence (method
//! §12.3 point 7).

use super::gloss_slope::{self, MIDDLE};
use super::group_fit::GroupFit;
use super::view_residual::{COMMON_SHARE, Disagreement, points_by_class};
use crate::core::brdf::Reflectance;
use crate::core::stats::{Mean, SURELY, passing_weight};
use crate::highlight::Evidence;

/// Error that all points of a class have in common: lobes between tabulated levels, highlights
/// blurred by pixels, light baked at finite resolution. Measured: the root mean square of the errors below 0.05 of 25
/// classes of the four shared scenes (docs/lab/roughness.md).
pub(super) const COMMON: f32 = 0.02;
/// A more elaborate model must explain the views better by this share of the disagreement. Measured: ×½ same bits, ×2
/// roughness +0.2 dB (dining-room, draft; docs/lab/roughness.md).
const MODEL_GAIN: f64 = 0.01;

/// Fits every group of the evidence under one reflection model.
#[must_use]
pub fn fit_groups(evidence: &Evidence, model: Reflectance) -> Vec<GroupFit> {
    points_by_class(evidence)
        .into_iter()
        .map(|(class, points)| {
            let mut found = fit(class, &Disagreement::of(evidence, model, &points));
            if model == Reflectance::Burley {
                without_highlights_nobody_sees(&mut found, &evidence.levels);
            }
            gloss_slope::reconsider(evidence, model, &points, &mut found);
            found
        })
        .collect()
}

/// Fits all groups under every model and keeps the simplest that explains the views; also returns
/// the mean disagreement per model. The model is that of the surface at large; a class that another
/// one explains better has the roughness that it has there.
#[must_use]
pub fn choose_model(evidence: &Evidence) -> (Reflectance, Vec<GroupFit>, Vec<(Reflectance, f64)>) {
    let fits = Reflectance::ALL.map(|model| fit_groups(evidence, model));
    let mean = |fits: &Vec<GroupFit>| {
        let points: usize = fits.iter().map(|f| f.points).sum();
        let all = fits.iter().map(|f| f.points as f64 * f.disagreement());
        all.sum::<f64>() / points.max(1) as f64
    };
    let scores: Vec<f64> = fits.iter().map(mean).collect();
    let best = (1..fits.len()).fold(0, |best, k| {
        if explains_better(scores[k], scores[best]) {
            k
        } else {
            best
        }
    });
    let of_class = |class: usize| {
        let own = &fits[best][class];
        let others = fits.iter().map(|of_model| &of_model[class]);
        let least = others.min_by(|a, b| a.disagreement().total_cmp(&b.disagreement()));
        let better = least.filter(|f| explains_better(f.disagreement(), own.disagreement()));
        better.unwrap_or(own).clone()
    };
    let chosen = (0..fits[best].len()).map(of_class).collect();
    let scores = Reflectance::ALL.into_iter().zip(scores).collect();
    (Reflectance::ALL[best], chosen, scores)
}

/// Whether a disagreement is so much less than another that its model explains the views better.
fn explains_better(disagreement: f64, than: f64) -> bool {
    disagreement < than * (1.0 - MODEL_GAIN)
}

/// Sum over the points of how far their views disagree at the roughness that the other points ask
/// for: each of [`FOLDS`] parts is judged by what is fitted to the rest (Stone 1974,
/// cross-validation), so that more values explain nothing by their number alone.
pub(super) fn held_out(table: &Disagreement) -> f64 {
    (0..FOLDS.min(table.rows.len()))
        .map(|fold| {
            let (rest, held) = (
                table.sum(|i| i % FOLDS != fold),
                table.sum(|i| i % FOLDS == fold),
            );
            at_roughness(
                table.levels,
                &held,
                parabola_minimum(table.levels, lowest(&rest), &rest).0,
            )
        })
        .sum()
}

/// Parts of the points in turn left out of a fit. Cited: five (Breiman and Spector 1992).
const FOLDS: usize = 5;

/// The level of the least value.
pub(super) fn lowest(objective: &[f64]) -> usize {
    (0..objective.len())
        .min_by(|&a, &b| objective[a].total_cmp(&objective[b]))
        .unwrap_or(0)
}

/// A table over the levels between two of them.
pub(super) fn at_roughness(levels: &[f32], table: &[f64], roughness: f32) -> f64 {
    let above = levels
        .partition_point(|l| *l < roughness)
        .clamp(1, levels.len() - 1);
    let [low, high] = [levels[above - 1], levels[above]];
    let t = f64::from(((roughness - low) / (high - low)).clamp(0.0, 1.0));
    table[above - 1] * (1.0 - t) + table[above] * t
}

/// Fits one roughness to the points of a class, given by their disagreement.
pub(super) fn fit(class: u16, table: &Disagreement) -> GroupFit {
    let Disagreement {
        levels,
        rows,
        places,
    } = table;
    let n = rows.len().max(1) as f64;
    let objective: Vec<f64> = table.sum(|_| true).into_iter().map(|sum| sum / n).collect();
    let best = lowest(&objective);
    let (roughness, curvature) = parabola_minimum(levels, best, &objective);
    // spread of the points' slopes around the minimum: sandwich estimate; neighbours, under one
    // highlight and one error of the light, err together
    let (lo, hi) = (best.saturating_sub(1), (best + 1).min(levels.len() - 1));
    let step = f64::from(levels[hi] - levels[lo]);
    let slopes: Vec<f64> = rows.iter().map(|r| (r[hi] - r[lo]) / step).collect();
    let slope = Mean::over(places, &slopes);
    let noise = if curvature > 0.0 {
        (slope.error / curvature) as f32
    } else {
        // an end of the levels is best: for sure if the slope there is, else any would do
        let sure = passing_weight(slope.value.abs(), f64::from(SURELY) * slope.error) as f32;
        1.0 + sure * (step as f32 - 1.0)
    };
    let [low, high] = within(MODEL_GAIN, levels, &objective);
    // where nearly any roughness would do, the least disagreement is chance: the mean of all that
    // would do errs least
    let any = passing_weight(f64::from(high - low), f64::from(MIDDLE)) as f32;
    let roughness = roughness + any * (0.5 * (low + high) - roughness);
    let error_over = |range| noise.hypot(distance_within(range, roughness));
    let common = within(COMMON_SHARE, levels, &objective);
    GroupFit {
        class,
        roughness,
        error: error_over(common).hypot(COMMON).min(1.0),
        own_error: error_over([low, high]).min(1.0),
        objective,
        points: rows.len(),
    }
}

/// Takes back as much of a fit's roughness below the widest lobe's as the views do not ask a highlight
/// for: where the widest explains them but for [`COMMON_SHARE`] as well as any, there is none. For Burley's
/// model, whose diffuse part changes with roughness, too, so that surfaces without any highlight prefer some R
/// below 1 (by 0.04 to 0.1; docs/lab/roughness.md). What is moved adds to the error.
fn without_highlights_nobody_sees(found: &mut GroupFit, levels: &[f32]) {
    let (Some(widest), Some(at_widest)) = (levels.last(), found.objective.last()) else {
        return;
    };
    let least = found.disagreement();
    // (products of residuals may be negative on average)
    let explained = (at_widest - least) / least.abs();
    let moved = (1.0 - passing_weight(explained, COMMON_SHARE) as f32) * (widest - found.roughness);
    found.roughness += moved;
    found.error = found.error.hypot(moved).min(1.0);
}

/// The roughness values around the best whose disagreement exceeds the least by at most a `share`
/// of it. Unlike the points' scatter this range does not shrink with their number: the model's own
/// error is common to all points.
fn within(share: f64, levels: &[f32], objective: &[f64]) -> [f32; 2] {
    let best = lowest(objective);
    let least = objective[best];
    // (products of residuals may be negative on average)
    let limit = least + share * least.abs();
    // where the objective crosses the limit between an outside level and its inside neighbour
    let crossing = |inside: usize, outside: usize| {
        let (a, b) = (objective[inside], objective[outside]);
        let t = if b > a {
            ((limit - a) / (b - a)).clamp(0.0, 1.0) as f32
        } else {
            1.0
        };
        levels[inside] + t * (levels[outside] - levels[inside])
    };
    let low = (0..best)
        .rev()
        .find(|&k| objective[k] > limit)
        .map_or(levels[0], |k| crossing(k + 1, k));
    let high = (best + 1..levels.len())
        .find(|&k| objective[k] > limit)
        .map_or(levels[levels.len() - 1], |k| crossing(k - 1, k));
    [low, high]
}

/// Root mean square distance from `roughness` of a uniform distribution over a range.
fn distance_within([low, high]: [f32; 2], roughness: f32) -> f32 {
    let (down, up) = ((roughness - low).max(0.0), (high - roughness).max(0.0));
    ((down.powi(3) + up.powi(3)) / (3.0 * (down + up).max(1e-6))).sqrt()
}

/// Vertex of the parabola through the best level and its neighbours (unequal spacing), and the
/// second derivative there.
pub(super) fn parabola_minimum(levels: &[f32], best: usize, objective: &[f64]) -> (f32, f64) {
    let last = levels.len() - 1;
    let mid = best.clamp(1, last - 1);
    let x = [mid - 1, mid, mid + 1].map(|i| f64::from(levels[i]));
    let y = [mid - 1, mid, mid + 1].map(|i| objective[i]);
    let (d1, d2) = ((y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1]));
    let curvature = 2.0 * (d2 - d1) / (x[2] - x[0]);
    if curvature <= 0.0 {
        return (levels[best], curvature);
    }
    let slope_mid = d1 + (x[1] - x[0]) * curvature * 0.5;
    let vertex = x[1] - slope_mid / curvature;
    let bounds = (
        f64::from(levels[best.saturating_sub(1)]),
        f64::from(levels[(best + 1).min(last)]),
    );
    (vertex.clamp(bounds.0, bounds.1) as f32, curvature)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::SpecularLobe;
    use crate::highlight::{DIELECTRICS, LEVELS, TestSight};
    use glam::Vec3;

    fn bowl(centre: f32, depth: f64) -> Vec<f64> {
        LEVELS
            .iter()
            .map(|r| 0.02 * (1.0 + depth * f64::from(r - centre).powi(2)))
            .collect()
    }

    /// Gradient row: vertex and curvature of the search are those of the objective, against its
    /// analytic derivatives.
    #[test]
    fn the_parabola_is_exact_for_quadratics_and_close_for_smooth_bowls() {
        for centre in [0.2f64, 0.33, 0.5, 0.75] {
            let nearest = |f: &dyn Fn(f64) -> f64| {
                let objective: Vec<f64> = LEVELS.iter().map(|r| f(f64::from(*r))).collect();
                let best = (0..LEVELS.len())
                    .min_by(|&a, &b| objective[a].total_cmp(&objective[b]))
                    .expect("levels");
                parabola_minimum(&LEVELS, best, &objective)
            };
            let (vertex, curvature) = nearest(&|r| 0.3 + 2.5 * (r - centre).powi(2));
            assert!(
                (f64::from(vertex) - centre).abs() < 1e-6 && (curvature - 5.0).abs() < 1e-5,
                "{vertex} {curvature}"
            );
            // cosh has the second derivative 4·cosh(0) = 4 at its minimum
            let (vertex, curvature) = nearest(&|r| (2.0 * (r - centre)).cosh());
            assert!(
                (f64::from(vertex) - centre).abs() < 2e-3 && (curvature / 4.0 - 1.0).abs() < 0.03,
                "{vertex} {curvature}"
            );
        }
    }

    #[test]
    fn a_sharp_minimum_is_sure_and_a_flat_one_is_not() {
        let error = |depth| distance_within(within(0.01, &LEVELS, &bowl(0.42, depth)), 0.42);
        let sharp = error(100.0);
        let flat = error(0.0);
        assert!(sharp < 0.02, "{sharp}");
        // uniform over all levels: √((0.39³ + 0.58³) / (3 · 0.97))
        assert!(
            (flat - ((0.39f32.powi(3) + 0.58f32.powi(3)) / (3.0 * 0.97)).sqrt()).abs() < 1e-4,
            "{flat}"
        );
        // 1 % above the minimum lies √(0.01 / 1) = 0.1 away on both sides: ±0.1 uniform, but for
        // the chords between levels
        let known = error(1.0);
        assert!((known - 0.1 / 3f32.sqrt()).abs() < 0.012, "{known}");
    }

    #[test]
    fn what_the_views_do_not_tell_is_in_the_middle_of_what_they_allow() {
        let table = |bowl: Vec<f64>| Disagreement {
            levels: &LEVELS,
            rows: vec![bowl; 50],
            places: (0..50).map(|i| Vec3::X * i as f32).collect(),
        };
        let mut flat = bowl(0.42, 0.0);
        flat[16] *= 0.999; // R = 0.9 by chance
        let found = fit(1, &table(flat));
        assert!(
            (found.roughness - 0.515).abs() < 0.01 && found.error > 0.25,
            "{found:?}"
        );
        let known = fit(1, &table(bowl(0.9, 1.0)));
        assert!((known.roughness - 0.9).abs() < 0.02, "{known:?}");
    }

    /// The widest lobe explains a bowl around 0.9 but for 1 % or 4 % of the least disagreement, which errors common
    /// to all points may do, or but for 10 %, which they may not.
    #[test]
    fn what_the_widest_lobe_explains_as_well_has_no_highlight() {
        for (depth, expected) in [(1.0, 1.0), (4.0, 1.0), (10.0, 0.9)] {
            let table = Disagreement {
                levels: &LEVELS,
                rows: vec![bowl(0.9, depth); 50],
                places: (0..50).map(|i| Vec3::X * i as f32).collect(),
            };
            let mut found = fit(1, &table);
            without_highlights_nobody_sees(&mut found, &LEVELS);
            assert!(
                (found.roughness - expected).abs() < 0.01,
                "{depth}: {found:?}"
            );
            assert!(
                (found.roughness - 0.9).abs() < 1.1 * found.error,
                "{found:?}"
            );
        }
    }

    /// A glossy Lambertian among walls that follow Burley's model.
    #[test]
    fn a_class_that_another_model_explains_better_has_its_roughness_there() {
        let diffuse = |view: usize| [0.7 + 0.1 * view as f32, 0.2, 0.0];
        let highlight = |view: usize| {
            let strength = if view == 0 { 0.02 } else { 0.0 };
            move |_: SpecularLobe, r: f32| [Vec3::splat(strength / (0.02 + r * r)); 2]
        };
        let none = |_: SpecularLobe, _: f32| [Vec3::ZERO; 2];
        let looks: Vec<_> = (0..6).map(highlight).collect();
        let mut evidence = Evidence::default();
        for i in 0..400 {
            let wall = |view: usize| TestSight {
                radiance: Vec3::splat(Reflectance::diffuse_at(diffuse(view), 0.9)),
                diffuse: diffuse(view),
                response: &none,
            };
            let vase = |view: usize| TestSight {
                radiance: Vec3::ONE + looks[view](DIELECTRICS[0], 0.15)[0],
                diffuse: diffuse(view),
                response: &looks[view],
            };
            evidence.push_test(1, &(0..6).map(wall).collect::<Vec<_>>(), 0);
            if i % 4 == 0 {
                evidence.push_test(2, &(0..6).map(vase).collect::<Vec<_>>(), 0);
            }
        }
        let (model, fits, _) = choose_model(&evidence);
        assert_eq!(model, Reflectance::Burley);
        assert!((fits[1].roughness - 0.15).abs() < 0.03, "{:?}", fits[1]);
    }
}
