//! How far the views of evidence points disagree at a candidate roughness.
//!
//! A point's views, less their specular part, must agree on one diffuse radiance. It is eliminated
//! in closed form (variable projection, Golub & Pereyra 1973), so that neither albedo nor
//! irradiance is needed. Looks that photographs clip are lower bounds: they disagree only where the
//! diffuse radiance of the others and the specular part fall short of them (censored observations,
//! Tobin 1958).

use super::class_prior::{ANYTHING, LEAST_SPREAD};
use crate::core::brdf::Reflectance;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::weighted_median;
use crate::highlight::Evidence;
use glam::Vec3;
use std::collections::BTreeMap;
use std::ops::Range;

/// Relative disagreement from which the loss grows linearly.
/// Measured: ×½ roughness −0.1 dB, ×2 roughness +0.2 dB (docs/constants.md).
pub(super) const KNEE: f32 = 0.02;
/// Share of the views' disagreement that errors common to all points amount to: what explains less is no finding.
/// Measured on four scenes, of which dining-room decides: .03 costs it 1.8 dB (docs/lab/roughness.md).
pub(super) const COMMON_SHARE: f64 = 0.05;

/// How far the views of one point disagree at every level of the evidence.
type Row = Vec<f64>;

/// The disagreement of some points at all levels.
pub(super) struct Disagreement<'a> {
    /// Roughness levels, ascending.
    pub(super) levels: &'a [f32],
    /// Per point and level.
    pub(super) rows: Vec<Row>,
    /// Where the points lie.
    pub(super) places: Vec<Vec3>,
}

impl<'a> Disagreement<'a> {
    /// The disagreement of points, given by their indices.
    pub(super) fn of(evidence: &'a Evidence, model: Reflectance, points: &[usize]) -> Self {
        Self::of_sights(evidence, model, points, Views::All)
    }

    /// As [`Self::of`], of every other view only: the even ones for `half` 0, the odd ones for 1.
    /// Points of which it has fewer than two sights disagree about nothing.
    pub(super) fn of_half(
        evidence: &'a Evidence,
        model: Reflectance,
        points: &[usize],
        half: u32,
    ) -> Self {
        Self::of_sights(evidence, model, points, Views::EveryOther(half))
    }

    fn of_sights(
        evidence: &'a Evidence,
        model: Reflectance,
        points: &[usize],
        views: Views,
    ) -> Self {
        let row = |&i: &usize| {
            let mut looks = Looks::of(evidence, model, i, views);
            (0..evidence.levels.len())
                .map(|k| looks.disagreement(k))
                .collect()
        };
        Self {
            levels: &evidence.levels,
            rows: points.par_iter().map(row).collect(),
            places: points
                .iter()
                .map(|&i| evidence.points[i].position)
                .collect(),
        }
    }

    /// That of the points for which `keep(k)` is true, `k` counting them.
    pub(super) fn of_points(&self, keep: impl Fn(usize) -> bool) -> Self {
        let (rows, places) = (self.rows.iter().zip(&self.places).enumerate())
            .filter(|(k, _)| keep(*k))
            .map(|(_, (row, place))| (row.clone(), *place))
            .unzip();
        Self {
            levels: self.levels,
            rows,
            places,
        }
    }

    /// Sum per level over the points for which `keep(k)` is true.
    pub(super) fn sum(&self, keep: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut sum = vec![0.0; self.levels.len()];
        for (_, row) in self.rows.iter().enumerate().filter(|(k, _)| keep(*k)) {
            sum.iter_mut().zip(row).for_each(|(s, r)| *s += r);
        }
        sum
    }
}

/// Indices of the evidence's points, class by class.
pub(super) fn points_by_class(evidence: &Evidence) -> BTreeMap<u16, Vec<usize>> {
    let mut classes: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    evidence
        .points
        .iter()
        .enumerate()
        .for_each(|(i, p)| classes.entry(p.class).or_default().push(i));
    classes
}

/// The views whose sights are taken.
#[derive(Clone, Copy)]
enum Views {
    All,
    /// The even ones for 0, the odd ones for 1.
    EveryOther(u32),
}

impl Views {
    fn has(self, view: u32) -> bool {
        match self {
            Self::All => true,
            Self::EveryOther(half) => view % 2 == half,
        }
    }
}

/// A sight less its specular part.
struct Look {
    /// Diffuse radiance, and its weight.
    diffuse: Vec3,
    weight: f32,
    /// Noise of its luminance.
    noise: f32,
}

/// A point's views less their specular part: what is left should be one diffuse radiance.
struct Looks<'a> {
    evidence: &'a Evidence,
    model: Reflectance,
    /// The model's lobe among those of the evidence.
    lobe: usize,
    sights: Vec<usize>,
    /// Sights that are lower bounds.
    bounds: Vec<usize>,
    /// Median luminance of the views.
    scale: f32,
    /// Diffuse radiance at the level last asked for, and its weight.
    diffuse: Vec<(Vec3, f32)>,
    /// Noise of its luminance.
    noise: Vec<f32>,
    /// What each counts for the centre.
    share: Vec<f32>,
}

impl<'a> Looks<'a> {
    fn of(evidence: &'a Evidence, model: Reflectance, point: usize, views: Views) -> Self {
        let p = &evidence.points[point];
        let end = p.first + p.count;
        let some = |span: Range<u32>| {
            let all = span.start as usize..span.end as usize;
            all.filter(|&j| views.has(evidence.sights[j].view))
                .collect()
        };
        let sights: Vec<usize> = some(p.first..end);
        Self {
            evidence,
            model,
            lobe: evidence.dielectric(model),
            scale: evidence.median_luminance(sights.iter().copied()),
            sights,
            bounds: some(end..end + p.bounds),
            diffuse: Vec::new(),
            noise: Vec::new(),
            share: Vec::new(),
        }
    }

    /// Sight `j` less its specular part if the roughness is that of level `k`.
    fn look(&self, j: usize, k: usize) -> Look {
        let (evidence, s) = (self.evidence, &self.evidence.sights[j]);
        let factor = evidence.diffuse_factor(j, self.model, evidence.levels[k]);
        Look {
            diffuse: (s.radiance - evidence.response(j, self.lobe)[k]) / factor,
            weight: s.weight * factor,
            noise: evidence.noise(j, self.lobe)[k] / factor,
        }
    }

    /// The diffuse radiance the views agree on best if the roughness is that of level `k`.
    fn centre(&mut self, k: usize) -> Vec3 {
        self.diffuse.clear();
        self.noise.clear();
        for i in 0..self.sights.len() {
            let look = self.look(self.sights[i], k);
            self.diffuse.push((look.diffuse, look.weight));
            self.noise.push(look.noise);
        }
        robust_centre(&self.diffuse, self.scale, &mut self.share)
    }

    /// Robust relative disagreement of the views at level `k`: mean product of the residuals of two
    /// independent estimates of the responses. Of their noise nothing is left on average; in a
    /// square it would stay, and narrow lobes, which are noisier than wide ones, would seem to
    /// explain the views less.
    fn disagreement(&mut self, k: usize) -> f64 {
        if self.sights.len() < 2 {
            return 0.0;
        }
        let centre = self.centre(k);
        let common = self
            .noise
            .iter()
            .zip(&self.share)
            .map(|(n, s)| n * s)
            .sum::<f32>();
        let (mut sum, mut weight) = (0.0, 0.0);
        for ((d, w), noise) in self.diffuse.iter().zip(&self.noise) {
            let e = (*d - centre) / self.scale;
            let product = damped_product(e, (noise - common) / self.scale);
            sum += f64::from(w * product * (1.0 / 3.0));
            weight += f64::from(*w);
        }
        for &j in &self.bounds {
            let look = self.look(j, k);
            let e = (look.diffuse - centre) / self.scale;
            let product = damped_shortfall(e, (look.noise - common) / self.scale);
            sum += f64::from(look.weight * product * (1.0 / 3.0));
            weight += f64::from(look.weight);
        }
        sum / weight
    }
}

/// Root of a robust loss with the residual's sign: the loss is square where residuals are small and linear beyond, up
/// to [`ANYTHING`]: views that disagree by more tell nothing (a moving object, misregistration).
fn damped(residual: Vec3) -> Vec3 {
    let most = ANYTHING.sqrt();
    residual.map(|r| (r / (r.abs() + KNEE).sqrt()).clamp(-most, most))
}

/// The product of the residuals of two estimates that are `noise` above and below their mean, which
/// is off by `residual`; summed over colours.
pub(super) fn damped_product(residual: Vec3, noise: f32) -> f32 {
    let [a, b] = estimates(residual, noise);
    (damped(a) * damped(b)).element_sum()
}

/// [`damped_product`] of a lower bound: residuals that meet it count nothing.
fn damped_shortfall(residual: Vec3, noise: f32) -> f32 {
    let [a, b] = estimates(residual, noise).map(|r| r.max(Vec3::ZERO));
    (damped(a) * damped(b)).element_sum()
}

/// The residuals of two estimates that are `noise` above and below their mean. Of noise as much can be taken out as
/// pixels err by at least: beyond, halves that both miss a highlight would agree on there being none.
fn estimates(residual: Vec3, noise: f32) -> [Vec3; 2] {
    let noise = Vec3::splat(noise.clamp(-LEAST_SPREAD, LEAST_SPREAD));
    [residual + noise, residual - noise]
}

/// The diffuse radiance that the views of a point agree on best, if its roughness is about
/// `roughness`.
pub(super) fn diffuse_radiance(
    evidence: &Evidence,
    model: Reflectance,
    point: usize,
    roughness: f32,
) -> Vec3 {
    Looks::of(evidence, model, point, Views::All).centre(evidence.nearest_level(roughness))
}

/// Weighted mean refined twice by Cauchy-like weights, per colour together. `share` takes what each
/// value counts for it, 1 in all.
fn robust_centre(values: &[(Vec3, f32)], scale: f32, share: &mut Vec<f32>) -> Vec3 {
    let by_luminance: Vec<(f32, f32)> = values.iter().map(|v| (luminance(v.0), v.1)).collect();
    let mut centre = weighted_median(&by_luminance).map_or(Vec3::ZERO, |i| values[i].0);
    for _ in 0..2 {
        share.clear();
        share.extend(values.iter().map(|(v, w)| {
            let r = (*v - centre).abs().dot(Vec3::splat(1.0 / 3.0)) / scale;
            w / (1.0 + (r / 0.03).powi(2))
        }));
        let total: f32 = share.iter().sum();
        if total > 0.0 {
            share.iter_mut().for_each(|s| *s /= total);
            centre = values.iter().zip(&*share).map(|(v, s)| v.0 * *s).sum();
        }
    }
    centre
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::SpecularLobe;
    use crate::core::sampling::KeyedRng;
    use crate::highlight::TestSight;
    use crate::inverse::fit_groups;

    /// Points of roughness 0.62, six views each, whose traced responses are the noisier the
    /// narrower the lobe. `known`: whether the halves' difference is.
    fn noisy(known: bool) -> Evidence {
        let mut rng = KeyedRng::new(11, 5);
        let mut out = Evidence::default();
        let response = |strength: f32, r: f32| strength / (0.2 + r * r);
        for _ in 0..600 {
            let looks: Vec<[f32; 4]> = (0..6)
                .map(|_| std::array::from_fn(|_| rng.next_f32()))
                .collect();
            let estimates = looks.iter().map(|[strength, _, a, b]| {
                move |_: SpecularLobe, r: f32| {
                    let [a, b] = [a, b].map(|u| {
                        let noise = 0.03 * (1.2 - r) * (2.0 * u - 1.0);
                        Vec3::splat(response(0.03 * strength, r) + noise)
                    });
                    if known { [a, b] } else { [0.5 * (a + b); 2] }
                }
            });
            let estimates: Vec<_> = estimates.collect();
            let sights: Vec<TestSight> = (looks.iter().zip(&estimates))
                .map(|([strength, noise, ..], response_of)| TestSight {
                    radiance: Vec3::splat(
                        1.0 + response(0.03 * strength, 0.62) + 0.01 * (noise - 0.5),
                    ),
                    diffuse: [1.0, 0.0, 0.0],
                    response: response_of,
                })
                .collect();
            out.push_test(7, &sights, 0);
        }
        out
    }

    /// Two views that see no highlight, and one that sees its brightest part clipped: whatever falls
    /// short of the ceiling is too rough, and what exceeds it does as well as any other.
    #[test]
    fn a_clipped_highlight_is_a_lower_bound() {
        let highlight = |_: SpecularLobe, r: f32| [Vec3::splat(0.05 / (0.05 + r * r)); 2];
        let none = |_: SpecularLobe, _: f32| [Vec3::ZERO; 2];
        let sight = |radiance: f32, response| TestSight {
            radiance: Vec3::splat(radiance),
            diffuse: [1.0, 0.0, 0.0],
            response,
        };
        let found = |clipped: usize| {
            let mut out = Evidence::default();
            for _ in 0..200 {
                // the true highlight is of 0.83, at R = 0.1; half of R² is allowed at most
                let sights = [sight(1.0, &none), sight(1.0, &none), sight(1.5, &highlight)];
                out.push_test(7, &sights[..2 + clipped], clipped);
            }
            fit_groups(&out, Reflectance::Paper).remove(0)
        };
        let (told, untold) = (found(1), found(0));
        assert!(told.roughness < 0.23, "{told:?}");
        assert!(untold.error > 0.25, "{untold:?}");
    }

    #[test]
    fn noise_of_the_responses_does_not_make_surfaces_look_rougher() {
        let found = |known: bool| fit_groups(&noisy(known), Reflectance::Paper)[0].roughness;
        assert!((found(true) - 0.62).abs() < 0.06, "{}", found(true));
        assert!(
            found(false) > 0.7,
            "the noise of the test must matter: {}",
            found(false)
        );
    }
}
