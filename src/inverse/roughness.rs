//! Stage II: one roughness per class by a pooled search over the evidence.
//!
//! For a candidate roughness every point's views, less their specular part, must agree on one diffuse radiance. The disagreement,
//! summed over the points of a group, is tabulated at all levels; its global minimum is the answer and its depth the confidence
//! (method §12.3 point 7; variable projection, Golub & Pereyra 1973: the diffuse radiance is eliminated in closed form).

use crate::brdf::Reflectance;
use crate::highlight::{Evidence, MODELS};
use crate::math::luminance;
use crate::optim::{median, weighted_median};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Relative disagreement beyond which a view counts as an outlier (moving object, misregistration).
const OUTLIER: f32 = 0.25;

/// What the evidence says about one group.
#[derive(Clone, Debug)]
pub struct GroupFit {
    /// Class id.
    pub class: u16,
    /// Best roughness.
    pub roughness: f32,
    /// Standard error of the roughness from the curvature of the objective.
    pub error: f32,
    /// Objective per level (mean relative disagreement).
    pub objective: Vec<f64>,
    /// Points used.
    pub points: usize,
}

impl GroupFit {
    /// The least mean relative disagreement of the views.
    #[must_use]
    pub fn disagreement(&self) -> f64 {
        self.objective.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// A more elaborate model must explain the views better by this share of the disagreement.
const MODEL_GAIN: f64 = 0.01;

/// Fits every group of the evidence under one reflection model.
#[must_use]
pub fn fit_groups(evidence: &Evidence, model: Reflectance) -> Vec<GroupFit> {
    points_by_class(evidence)
        .into_iter()
        .map(|(class, points)| fit_rows(&evidence.levels, class, &disagreements(evidence, model, &points)))
        .collect()
}

/// Indices of the evidence's points, class by class.
pub(super) fn points_by_class(evidence: &Evidence) -> BTreeMap<u16, Vec<usize>> {
    let mut classes: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    evidence.points.iter().enumerate().for_each(|(i, p)| classes.entry(p.class).or_default().push(i));
    classes
}

/// Fits all groups under every model and keeps the simplest that explains the views; also returns the mean disagreement per model.
#[must_use]
pub fn choose_model(evidence: &Evidence) -> (Reflectance, Vec<GroupFit>, Vec<(Reflectance, f64)>) {
    let mut best: Option<(Reflectance, Vec<GroupFit>, f64)> = None;
    let mut scores = Vec::new();
    for model in Reflectance::ALL {
        let fits = fit_groups(evidence, model);
        let points: usize = fits.iter().map(|f| f.points).sum();
        let total: f64 = fits.iter().map(|f| f.points as f64 * f.disagreement()).sum();
        let score = total / points.max(1) as f64;
        scores.push((model, score));
        if best.as_ref().is_none_or(|b| score < b.2 * (1.0 - MODEL_GAIN)) {
            best = Some((model, fits, score));
        }
    }
    let (model, fits, _) = best.unwrap_or((Reflectance::Paper, Vec::new(), 0.0));
    (model, fits, scores)
}

/// How far the views of one point disagree at every level of the evidence.
pub(super) type Row = Vec<f64>;

/// The disagreement of points, given by their indices.
pub(super) fn disagreements(evidence: &Evidence, model: Reflectance, points: &[usize]) -> Vec<Row> {
    let row = |&i: &usize| {
        let mut looks = Looks::of(evidence, model, i);
        (0..evidence.levels.len()).map(|k| looks.disagreement(k)).collect()
    };
    points.par_iter().map(row).collect()
}

/// Sum over the points of how far their views disagree at the roughness that the other points ask for: each of [`FOLDS`] parts is
/// judged by what is fitted to the rest (Stone 1974, cross-validation), so that more values explain nothing by their number alone.
pub(super) fn held_out(levels: &[f32], rows: &[Row]) -> f64 {
    let sum = |keep: &dyn Fn(usize) -> bool| -> Vec<f64> {
        (0..levels.len()).map(|k| rows.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, r)| r[k]).sum()).collect()
    };
    (0..FOLDS.min(rows.len()))
        .map(|fold| {
            let (rest, held) = (sum(&|i| i % FOLDS != fold), sum(&|i| i % FOLDS == fold));
            at_roughness(levels, &held, parabola_minimum(levels, lowest(&rest), &rest).0)
        })
        .sum()
}

/// Parts of the points in turn left out of a fit.
const FOLDS: usize = 5;

/// The level of the least value.
fn lowest(objective: &[f64]) -> usize {
    (0..objective.len()).min_by(|&a, &b| objective[a].total_cmp(&objective[b])).unwrap_or(0)
}

/// A table over the levels between two of them.
fn at_roughness(levels: &[f32], table: &[f64], roughness: f32) -> f64 {
    let above = levels.partition_point(|l| *l < roughness).clamp(1, levels.len() - 1);
    let [low, high] = [levels[above - 1], levels[above]];
    let t = f64::from(((roughness - low) / (high - low)).clamp(0.0, 1.0));
    table[above - 1] * (1.0 - t) + table[above] * t
}

/// Fits one roughness to the points of a class, given by their disagreement.
pub(super) fn fit_rows(levels: &[f32], class: u16, rows: &[Row]) -> GroupFit {
    let n = rows.len().max(1) as f64;
    let objective: Vec<f64> = (0..levels.len()).map(|k| rows.iter().map(|r| r[k]).sum::<f64>() / n).collect();
    let best = lowest(&objective);
    let (roughness, curvature) = parabola_minimum(levels, best, &objective);
    // spread of the points' slopes around the minimum: sandwich estimate
    let (lo, hi) = (best.saturating_sub(1), (best + 1).min(levels.len() - 1));
    let step = f64::from(levels[hi] - levels[lo]);
    let slopes: Vec<f64> = rows.iter().map(|r| (r[hi] - r[lo]) / step).collect();
    let mean = slopes.iter().sum::<f64>() / n;
    let variance = slopes.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n / n;
    let noise = if curvature > 0.0 { (variance.sqrt() / curvature) as f32 } else { 1.0 };
    let error = noise.hypot(indistinguishable(levels, roughness, &objective)).min(1.0);
    GroupFit { class, roughness, error, objective, points: rows.len() }
}

/// Standard deviation around `roughness` of a roughness known only to explain the views as well as the best does, up to what no model
/// can be trusted to tell apart: uniform over the levels around the best whose disagreement is within [`MODEL_GAIN`] of it. Unlike the
/// points' scatter this does not shrink with their number: the model's own error is common to all points.
fn indistinguishable(levels: &[f32], roughness: f32, objective: &[f64]) -> f32 {
    let limit = objective.iter().copied().fold(f64::INFINITY, f64::min) * (1.0 + MODEL_GAIN);
    let best = lowest(objective);
    // where the objective crosses the limit between an outside level and its inside neighbour
    let crossing = |inside: usize, outside: usize| {
        let (a, b) = (objective[inside], objective[outside]);
        let t = if b > a { ((limit - a) / (b - a)).clamp(0.0, 1.0) as f32 } else { 1.0 };
        levels[inside] + t * (levels[outside] - levels[inside])
    };
    let low = (0..best).rev().find(|&k| objective[k] > limit).map_or(levels[0], |k| crossing(k + 1, k));
    let high = (best + 1..levels.len()).find(|&k| objective[k] > limit).map_or(levels[levels.len() - 1], |k| crossing(k - 1, k));
    let (down, up) = ((roughness - low).max(0.0), (high - roughness).max(0.0));
    // mean square distance of a uniform distribution over [low, high] from the estimate
    ((down.powi(3) + up.powi(3)) / (3.0 * (down + up).max(1e-6))).sqrt()
}

/// A point's views less their specular part: what is left should be one diffuse radiance.
struct Looks<'a> {
    evidence: &'a Evidence,
    model: Reflectance,
    sights: std::ops::Range<usize>,
    /// Median luminance of the views.
    scale: f32,
    /// Diffuse radiance at the level last asked for, and its weight.
    diffuse: Vec<(Vec3, f32)>,
}

impl<'a> Looks<'a> {
    fn of(evidence: &'a Evidence, model: Reflectance, point: usize) -> Self {
        let p = &evidence.points[point];
        let sights = p.first as usize..(p.first + p.count) as usize;
        let scale =
            median(evidence.sights[sights.clone()].iter().map(|s| luminance(s.radiance)).collect()).unwrap_or(0.0).max(1e-9);
        Self { evidence, model, diffuse: Vec::with_capacity(sights.len()), sights, scale }
    }

    /// The diffuse radiance the views agree on best if the roughness is that of level `k`.
    fn centre(&mut self, k: usize) -> Vec3 {
        let (evidence, model) = (self.evidence, self.model);
        let m = MODELS.iter().position(|m| (*m == Reflectance::Paper) == (model == Reflectance::Paper)).unwrap_or(0);
        self.diffuse.clear();
        self.diffuse.extend(self.sights.clone().map(|j| {
            let s = &evidence.sights[j];
            let factor = evidence.diffuse_factor(j, model, evidence.levels[k]);
            ((s.radiance - evidence.response(j, m)[k]) / factor, s.weight * factor)
        }));
        robust_centre(&self.diffuse, self.scale)
    }

    /// Robust relative disagreement of the views at level `k`.
    fn disagreement(&mut self, k: usize) -> f64 {
        let centre = self.centre(k);
        let (mut sum, mut weight) = (0.0, 0.0);
        for (d, w) in &self.diffuse {
            let e = (*d - centre) / self.scale;
            let r = e.abs().dot(Vec3::splat(1.0 / 3.0));
            sum += f64::from(w * (r * r / (r + 0.02)).min(OUTLIER));
            weight += f64::from(*w);
        }
        sum / weight
    }
}

/// The diffuse radiance that the views of a point agree on best, if its roughness is about `roughness`.
pub(super) fn diffuse_radiance(evidence: &Evidence, model: Reflectance, point: usize, roughness: f32) -> Vec3 {
    let away = |k: &usize| (evidence.levels[*k] - roughness).abs();
    let nearest = (0..evidence.levels.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(0);
    Looks::of(evidence, model, point).centre(nearest)
}

/// Weighted mean refined twice by Cauchy-like weights, per colour together.
fn robust_centre(values: &[(Vec3, f32)], scale: f32) -> Vec3 {
    let by_luminance: Vec<(f32, f32)> = values.iter().map(|v| (luminance(v.0), v.1)).collect();
    let mut centre = weighted_median(&by_luminance).map_or(Vec3::ZERO, |i| values[i].0);
    for _ in 0..2 {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (v, w) in values {
            let r = (*v - centre).abs().dot(Vec3::splat(1.0 / 3.0)) / scale;
            let k = w / (1.0 + (r / 0.03).powi(2));
            sum += *v * k;
            total += k;
        }
        if total > 0.0 {
            centre = sum / total;
        }
    }
    centre
}

/// Vertex of the parabola through the best level and its neighbours (unequal spacing), and the second derivative there.
fn parabola_minimum(levels: &[f32], best: usize, objective: &[f64]) -> (f32, f64) {
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
    let bounds = (f64::from(levels[best.saturating_sub(1)]), f64::from(levels[(best + 1).min(last)]));
    (vertex.clamp(bounds.0, bounds.1) as f32, curvature)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::highlight::LEVELS;

    fn bowl(centre: f32, depth: f64) -> Vec<f64> {
        LEVELS.iter().map(|r| 0.02 * (1.0 + depth * f64::from(r - centre).powi(2))).collect()
    }

    /// Gradient row: vertex and curvature of the search are those of the objective, against its analytic derivatives.
    #[test]
    fn the_parabola_is_exact_for_quadratics_and_close_for_smooth_bowls() {
        for centre in [0.2f64, 0.33, 0.5, 0.75] {
            let nearest = |f: &dyn Fn(f64) -> f64| {
                let objective: Vec<f64> = LEVELS.iter().map(|r| f(f64::from(*r))).collect();
                let best = (0..LEVELS.len()).min_by(|&a, &b| objective[a].total_cmp(&objective[b])).expect("levels");
                parabola_minimum(&LEVELS, best, &objective)
            };
            let (vertex, curvature) = nearest(&|r| 0.3 + 2.5 * (r - centre).powi(2));
            assert!((f64::from(vertex) - centre).abs() < 1e-6 && (curvature - 5.0).abs() < 1e-5, "{vertex} {curvature}");
            // cosh has the second derivative 4·cosh(0) = 4 at its minimum
            let (vertex, curvature) = nearest(&|r| (2.0 * (r - centre)).cosh());
            assert!((f64::from(vertex) - centre).abs() < 2e-3 && (curvature / 4.0 - 1.0).abs() < 0.03, "{vertex} {curvature}");
        }
    }

    #[test]
    fn a_sharp_minimum_is_sure_and_a_flat_one_is_not() {
        let sharp = indistinguishable(&LEVELS, 0.42, &bowl(0.42, 100.0));
        let flat = indistinguishable(&LEVELS, 0.42, &bowl(0.42, 0.0));
        assert!(sharp < 0.02, "{sharp}");
        // uniform over all levels: √((0.39³ + 0.58³) / (3 · 0.97))
        assert!((flat - ((0.39f32.powi(3) + 0.58f32.powi(3)) / (3.0 * 0.97)).sqrt()).abs() < 1e-4, "{flat}");
        // 1 % above the minimum lies √(0.01 / 1) = 0.1 away on both sides: ±0.1 uniform, but for the chords between levels
        let known = indistinguishable(&LEVELS, 0.42, &bowl(0.42, 1.0));
        assert!((known - 0.1 / 3f32.sqrt()).abs() < 0.012, "{known}");
    }
}
