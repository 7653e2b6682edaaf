//! Classes that are metal.
//!
//! A dielectric shows one diffuse radiance to all views and adds a colourless lobe; a metal has no
//! diffuse part, and its lobe takes the colour of its reflectance at normal incidence, F0. Either
//! way a view of a point is a·x + y, with one unknown x per colour and point: the diffuse radiance
//! with a = 1 and y = S, or F0 with a = P and y = Q, where S = F0·P + Q is linear in F0 (Schlick
//! 1994). So both are fitted to the same views with as many unknowns, and neither needs
//! irradiance; the one that explains views held out better is the one.

use super::group_fit::GroupFit;
use super::roughness::{COMMON, at_roughness, fit, held_out};
use super::view_residual::{Disagreement, KNEE, damped_product, points_by_class};
use crate::core::brdf::{DIELECTRIC, Reflectance};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{Mean, SURELY, median_colour};
use crate::highlight::Evidence;
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// Points of a class from which it can be told whether it is metal. Measured: at 50 the brass table top of tests/metals.rs is
/// not found.
const FEWEST: usize = 40;
/// Least luminance of a metal's F0. Derived: between diamond's 0.17, the most of any common
/// dielectric, and 0.5 of the darkest common metals (geometric mean).
const LEAST_F0: f32 = 0.3;

/// A class that is metal.
#[derive(Clone, Debug)]
pub struct Metal {
    /// Its roughness.
    pub fit: GroupFit,
    /// Reflectance at normal incidence, linear Rec. 709.
    pub f0: Vec3,
    /// Standard error of its luminance.
    pub f0_error: f32,
}

/// The classes that are metal, by evidence that tabulates a dielectric's lobe and a white metal's.
#[must_use]
pub fn find_metals(evidence: &Evidence, model: Reflectance) -> Vec<Metal> {
    points_by_class(evidence)
        .into_iter()
        .filter_map(|(class, points)| metal(evidence, model, class, &points))
        .collect()
}

/// The class as metal, if that explains its views better than a dielectric, beyond chance, and is
/// possible.
fn metal(evidence: &Evidence, model: Reflectance, class: u16, points: &[usize]) -> Option<Metal> {
    if points.len() < FEWEST {
        return None;
    }
    let of = |kind| table(evidence, model, points, kind);
    let (dielectric, metal) = (of(Kind::Dielectric), of(Kind::Metal));
    let whole = fit(class, &metal);
    let places = &metal.places;
    let roughness = fit(class, &dielectric).roughness;
    let levels = &evidence.levels;
    let better: Vec<f64> = (dielectric.rows.iter().zip(&metal.rows))
        .map(|(d, m)| at_roughness(levels, d, roughness) - at_roughness(levels, m, whole.roughness))
        .collect();
    let gain = Mean::over(places, &better);
    if gain.value < f64::from(SURELY) * gain.error || held_out(&metal) >= held_out(&dielectric) {
        return None;
    }
    let f0 = colours(evidence, model, points, whole.roughness);
    let colour = median_colour(&f0)?;
    let bright: Vec<f64> = f0.iter().map(|f| f64::from(luminance(*f))).collect();
    let error = Mean::over(places, &bright).error;
    (luminance(colour) >= LEAST_F0).then_some(Metal {
        fit: whole,
        f0: colour,
        // a normal sample's median errs by √(π/2) of what its mean does
        f0_error: (error as f32 * FRAC_PI_2.sqrt()).hypot(COMMON),
    })
}

/// What a surface may be.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Dielectric,
    Metal,
}

/// How far the views of every point disagree at every level.
fn table<'a>(
    evidence: &'a Evidence,
    model: Reflectance,
    points: &[usize],
    kind: Kind,
) -> Disagreement<'a> {
    let row = |&i: &usize| {
        let mut looks = Looks::of(evidence, model, i, kind);
        (0..evidence.levels.len())
            .map(|k| looks.explain(k).disagreement)
            .collect()
    };
    Disagreement {
        levels: &evidence.levels,
        rows: points.par_iter().map(row).collect(),
        places: (points.iter())
            .map(|&i| evidence.points[i].position)
            .collect(),
    }
}

/// F0 at every point, at the level nearest to a roughness.
fn colours(evidence: &Evidence, model: Reflectance, points: &[usize], roughness: f32) -> Vec<Vec3> {
    let level = evidence.nearest_level(roughness);
    let f0 = |&i: &usize| {
        Looks::of(evidence, model, i, Kind::Metal)
            .explain(level)
            .unknown
    };
    points.par_iter().map(f0).collect()
}

/// A view of a point as a·x + y.
struct Look {
    seen: Vec3,
    factor: Vec3,
    rest: Vec3,
    /// Half the difference of the luminance of two estimates of `factor` and of `rest`.
    noise: [f32; 2],
    weight: f32,
    /// Luminance that errors are relative to.
    scale: f32,
}

/// The views of one point.
struct Looks<'a> {
    evidence: &'a Evidence,
    model: Reflectance,
    first: usize,
    count: usize,
    kind: Kind,
    /// Median luminance of the views.
    scale: f32,
    looks: Vec<Look>,
    share: Vec<f32>,
}

/// The unknown of a point and how far its views disagree all the same.
struct Explained {
    unknown: Vec3,
    disagreement: f64,
}

impl<'a> Looks<'a> {
    fn of(evidence: &'a Evidence, model: Reflectance, point: usize, kind: Kind) -> Self {
        let p = &evidence.points[point];
        let (first, count) = (p.first as usize, p.count as usize);
        Self {
            evidence,
            model,
            first,
            count,
            kind,
            scale: evidence.median_luminance(first..first + count),
            looks: Vec::with_capacity(count),
            share: Vec::with_capacity(count),
        }
    }

    /// The views at level `k`.
    fn look(&mut self, k: usize) {
        let (evidence, scale) = (self.evidence, self.scale);
        self.looks.clear();
        for j in self.first..self.first + self.count {
            let s = &evidence.sights[j];
            let [plain, white] = [0, 1].map(|m| evidence.response(j, m)[k]);
            let [plain_noise, white_noise] = [0, 1].map(|m| evidence.noise(j, m)[k]);
            let (factor, rest, noise) = match self.kind {
                Kind::Dielectric => {
                    let factor = evidence.diffuse_factor(j, self.model, evidence.levels[k]);
                    (Vec3::splat(factor), plain, [0.0, plain_noise])
                }
                Kind::Metal => {
                    let base = DIELECTRIC.x;
                    let p = (white - plain) / (1.0 - base);
                    let p_noise = (white_noise - plain_noise) / (1.0 - base);
                    (p, plain - p * base, [p_noise, plain_noise - p_noise * base])
                }
            };
            self.looks.push(Look {
                seen: s.radiance,
                factor,
                rest,
                noise,
                weight: s.weight,
                scale: scale.max(luminance(s.radiance)),
            });
        }
    }

    /// The unknown that explains the views best at level `k`: least squares, reweighted as where
    /// views agree on a diffuse radiance, once more since a lobe's factors differ from view to view.
    fn explain(&mut self, k: usize) -> Explained {
        self.look(k);
        self.share.clear();
        self.share.extend(self.looks.iter().map(|l| l.weight));
        let mut unknown = self.least_squares();
        for _ in 0..3 {
            for (l, share) in self.looks.iter().zip(&mut self.share) {
                let off = l.error(unknown).abs().dot(Vec3::splat(1.0 / 3.0));
                *share = l.weight / (1.0 + (off / KNEE).powi(2));
            }
            unknown = self.least_squares();
        }
        Explained {
            unknown,
            disagreement: self.disagreement(unknown),
        }
    }

    /// The unknown of least squares with the present shares, within what is possible.
    fn least_squares(&self) -> Vec3 {
        let (mut top, mut bottom) = (Vec3::ZERO, Vec3::splat(f32::MIN_POSITIVE));
        for (l, share) in self.looks.iter().zip(&self.share) {
            let w = share / (l.scale * l.scale);
            top += w * l.factor * (l.seen - l.rest);
            bottom += w * l.factor * l.factor;
        }
        let most = match self.kind {
            Kind::Dielectric => Vec3::INFINITY,
            Kind::Metal => Vec3::ONE,
        };
        (top / bottom).clamp(Vec3::ZERO, most)
    }

    /// Mean product of the residuals of two independent estimates, robust.
    fn disagreement(&self, unknown: Vec3) -> f64 {
        let bright = luminance(unknown);
        let noise = |l: &Look| bright * l.noise[0] + l.noise[1];
        let (mut top, mut bottom) = (0.0, f32::MIN_POSITIVE);
        for (l, share) in self.looks.iter().zip(&self.share) {
            let (w, a) = (share / (l.scale * l.scale), luminance(l.factor));
            top += w * a * noise(l);
            bottom += w * a * a;
        }
        let absorbed = top / bottom;
        let (mut sum, mut weight) = (0.0, 0.0);
        for l in &self.looks {
            let e = l.error(unknown);
            let noise = (noise(l) - absorbed * luminance(l.factor)) / l.scale;
            sum += f64::from(l.weight * damped_product(e, noise) * (1.0 / 3.0));
            weight += f64::from(l.weight);
        }
        sum / weight.max(f64::MIN_POSITIVE)
    }
}

impl Look {
    fn error(&self, unknown: Vec3) -> Vec3 {
        (self.seen - self.rest - unknown * self.factor) / self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::SpecularLobe;
    use crate::core::sampling::KeyedRng;
    use crate::highlight::TestSight;

    const MODEL: Reflectance = Reflectance::Smith;
    const GOLD: Vec3 = Vec3::new(1.0, 0.77, 0.34);

    /// Points of class 3, six views each, of roughness 0.31: of diffuse radiance `diffuse` and that
    /// reflectance at normal incidence.
    fn seen(diffuse: Vec3, f0: Vec3) -> Evidence {
        let mut rng = KeyedRng::new(7, 1);
        let mut out = Evidence {
            lobes: [
                SpecularLobe::dielectric(MODEL),
                SpecularLobe::white_metal(MODEL),
            ],
            ..Evidence::default()
        };
        for _ in 0..200 {
            let mut look = || {
                // most looks mirror a wall, some a lamp
                let lamp = if rng.next_f32() < 0.3 { 4.0 } else { 0.0 };
                let (wall, lamp) = (0.5 + rng.next_f32(), lamp * rng.next_f32());
                let grazing = 0.02 * rng.next_f32();
                let white = move |r: f32| wall + lamp * 0.1 / (0.05 + r * r);
                let lobe = move |f0: Vec3, r: f32| (f0 + (1.0 - f0) * grazing) * white(r);
                let noise = 1.0 + 0.02 * (rng.next_f32() - 0.5);
                let radiance = (diffuse + lobe(f0, 0.31)) * noise;
                (radiance, move |l: SpecularLobe, r: f32| [lobe(l.f0, r); 2])
            };
            let looks: Vec<_> = (0..6).map(|_| look()).collect();
            let sights: Vec<TestSight> = looks
                .iter()
                .map(|(radiance, response)| TestSight {
                    radiance: *radiance,
                    diffuse: [1.0, 0.0, 0.0],
                    response,
                })
                .collect();
            out.push_test(3, &sights, 0);
        }
        out
    }

    #[test]
    fn gold_is_found_with_its_colour_and_roughness() {
        let found = find_metals(&seen(Vec3::ZERO, GOLD), MODEL);
        let [gold] = &found[..] else {
            panic!("{found:?}")
        };
        assert!((gold.f0 - GOLD).abs().max_element() < 0.02, "{}", gold.f0);
        assert!((gold.fit.roughness - 0.31).abs() < 0.03, "{:?}", gold.fit);
        assert!(gold.f0_error < 0.05, "{}", gold.f0_error);
    }

    /// Lacquer so dark that it has no diffuse part to speak of is explained as well by a metal of
    /// F0 0.04: there is none.
    #[test]
    fn paint_and_black_lacquer_are_no_metal() {
        for diffuse in [0.0f32, 0.02, 0.2, 0.8] {
            let found = find_metals(&seen(Vec3::splat(diffuse), DIELECTRIC), MODEL);
            assert!(found.is_empty(), "{diffuse}: {found:?}");
        }
    }
}
