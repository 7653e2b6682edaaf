//! One class, several materials: tiles and their grout share a label, not a roughness.
//!
//! The points of a class are divided by colour. The division stands if each side has evidence of its own, the two roughness values
//! differ by more than their errors, and together they explain the views better than one value does. Between the two colours, where a
//! texel holds both materials, the roughness is in between.

use super::roughness::{GroupFit, diffuse_radiance, fit_points, points_by_class};
use crate::brdf::Reflectance;
use crate::highlight::Evidence;
use crate::math::luminance;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Points a material needs for a fit of its own.
const FEWEST: usize = 40;
/// Distance of the two mean colours in standard deviations around them, from which a class counts as two-coloured: halves of a normal
/// distribution are 2.7 apart.
const APART: f32 = 3.0;
/// Share of the views' disagreement that a division must explain: tiles and grout explain 9 %, surfaces of one roughness whose colour
/// merely follows their place up to 4 %.
const GAIN: f64 = 0.05;
/// Standard errors by which the two roughness values must differ.
const DIFFERENT: f32 = 3.0;
/// Share of the way from one colour to the other on which points tell of the first, and of the second.
const PURE: f32 = 0.25;
/// Rounds of the division by colour: it has settled long before.
const ROUNDS: usize = 12;
/// Albedo below which colours count as equally dark.
const DARK: f32 = 0.01;

/// The roughness of every class and of the materials within.
#[derive(Clone, Debug, Default)]
pub struct Materials {
    classes: BTreeMap<u16, Class>,
}

#[derive(Clone, Debug)]
struct Class {
    whole: GroupFit,
    parts: Option<Parts>,
}

/// Two materials by colour: the rarer one, which is the thinner one too, and the usual one.
#[derive(Clone, Debug)]
struct Parts {
    axis: Axis,
    fits: [GroupFit; 2],
}

/// The way from the rarer albedo to the usual one: what a texel on the border of two materials mixes is light, hence albedo.
#[derive(Clone, Copy, Debug)]
struct Axis {
    from: Vec3,
    /// The way to the usual one, divided by its squared length.
    step: Vec3,
}

impl Axis {
    /// 0 at the rarer colour, 1 at the usual one.
    fn place(&self, colour: Vec3) -> f32 {
        (colour - self.from).dot(self.step).clamp(0.0, 1.0)
    }
}

impl Materials {
    /// Divides the classes fitted by `fits` where the evidence asks for it; `irradiance(triangle, position)` is that of the points.
    #[must_use]
    pub fn find(
        evidence: &Evidence,
        fits: Vec<GroupFit>,
        model: Reflectance,
        irradiance: &(dyn Fn(u32, Vec3) -> Vec3 + Sync),
    ) -> Self {
        let members = points_by_class(evidence);
        let classes = fits
            .into_iter()
            .map(|whole| {
                let points = members.get(&whole.class).map_or(&[][..], Vec::as_slice);
                let albedo = |&i: &usize| {
                    let p = &evidence.points[i];
                    let e = irradiance(p.triangle, p.position).max(Vec3::splat(1e-12));
                    (diffuse_radiance(evidence, model, i, whole.roughness) * PI / e).clamp(Vec3::ZERO, Vec3::ONE)
                };
                let colours: Vec<Vec3> = points.par_iter().map(albedo).collect();
                let parts = divide(&colours).and_then(|axis| Parts::fit(evidence, model, axis, points, &colours));
                (whole.class, Class { whole, parts })
            })
            .collect();
        Self { classes }
    }

    /// Roughness of a class at a point of albedo `colour` (`None`: unknown) and its standard error; `None` for a class without evidence.
    #[must_use]
    pub fn roughness(&self, class: u16, colour: Option<Vec3>) -> Option<(f32, f32)> {
        let Class { whole, parts } = self.classes.get(&class)?;
        let Some(p) = parts else { return Some((whole.roughness, whole.error)) };
        // the usual colour scatters from tile to tile; what lies beyond the rare one is just that
        let t = colour.map_or(1.0, |c| (p.axis.place(c) / (1.0 - PURE)).min(1.0));
        let between = |f: fn(&GroupFit) -> f32| f(&p.fits[0]) * (1.0 - t) + f(&p.fits[1]) * t;
        Some((between(|f| f.roughness), between(|f| f.error)))
    }

    /// Classes of two materials, with the roughness of both.
    pub fn divided(&self) -> impl Iterator<Item = (u16, [f32; 2])> {
        self.classes
            .iter()
            .filter_map(|(&class, c)| c.parts.as_ref().map(|p| (class, [p.fits[0].roughness, p.fits[1].roughness])))
    }

    /// The fits of whole classes.
    pub fn fits(&self) -> impl Iterator<Item = &GroupFit> {
        self.classes.values().map(|c| &c.whole)
    }
}

impl Parts {
    fn fit(evidence: &Evidence, model: Reflectance, axis: Axis, points: &[usize], colours: &[Vec3]) -> Option<Self> {
        let of = |lies: &dyn Fn(f32) -> bool| -> Vec<usize> {
            points.iter().zip(colours).filter(|(_, c)| lies(axis.place(**c))).map(|(i, _)| *i).collect()
        };
        let sides = [of(&|place| place <= PURE), of(&|place| place >= 1.0 - PURE)];
        if sides.iter().any(|s| s.len() < FEWEST) {
            return None;
        }
        let class = evidence.points[points[0]].class;
        let fits = [0, 1].map(|k| fit_points(evidence, model, class, &sides[k]));
        let together = fit_points(evidence, model, class, &sides.concat());
        let apart: f64 = fits.iter().map(|f| f.points as f64 * f.disagreement()).sum();
        let explains = apart < together.points as f64 * together.disagreement() * (1.0 - GAIN);
        let differ = (fits[0].roughness - fits[1].roughness).abs() > DIFFERENT * fits[0].error.hypot(fits[1].error);
        (explains && differ).then_some(Self { axis, fits })
    }
}

fn logarithm(albedo: Vec3) -> Vec3 {
    albedo.max(Vec3::splat(DARK)).map(f32::ln)
}

/// The way from the rarer to the more usual of the two colours that a list is divided into best (Lloyd 1982); `None` if it has one
/// colour.
fn divide(colours: &[Vec3]) -> Option<Axis> {
    if colours.len() < 2 * FEWEST {
        return None;
    }
    let logs: Vec<Vec3> = colours.iter().copied().map(logarithm).collect();
    let mut order: Vec<f32> = logs.iter().map(|l| luminance(*l)).collect();
    order.sort_by(f32::total_cmp);
    // from near the ends, where a rare material is
    let tail = order.len() / 20;
    let mut centres = [order[tail], order[order.len() - 1 - tail]].map(Vec3::splat);
    let (mut spread, mut side) = (0.0, vec![0usize; logs.len()]);
    for _ in 0..ROUNDS {
        let (mut sums, mut counts, mut square) = ([Vec3::ZERO; 2], [0.0f32; 2], 0.0);
        for (l, side) in logs.iter().zip(&mut side) {
            let d = centres.map(|c| (*l - c).length_squared());
            let k = usize::from(d[1] < d[0]);
            *side = k;
            sums[k] += *l;
            counts[k] += 1.0;
            square += d[k];
        }
        if counts.contains(&0.0) {
            return None;
        }
        spread = (square / (3.0 * logs.len() as f32)).sqrt();
        centres = [0, 1].map(|k| sums[k] / counts[k]);
    }
    // (three channels: the distance between grey colours is √3 times that of one)
    let way = centres[1] - centres[0];
    if way.length() / 3f32.sqrt() <= APART * spread.max(0.02) {
        return None;
    }
    let mean = |of: &dyn Fn(usize) -> bool| {
        let (sum, n) = (0..colours.len()).filter(|&i| of(i)).fold((Vec3::ZERO, 0.0), |s, i| (s.0 + colours[i], s.1 + 1.0));
        sum / f32::max(n, 1.0)
    };
    // the rarer material is the thinner one, and most of its pixels hold some of the other: the half farther off is purer
    let rare = usize::from(2 * side.iter().sum::<usize>() < side.len());
    let outwards = if rare == 1 { way } else { -way };
    let ends = [0, 1].map(|k| mean(&|i| side[i] == k && (k != rare || (logs[i] - centres[k]).dot(outwards) >= 0.0)));
    let step = ends[1 - rare] - ends[rare];
    Some(Axis { from: ends[rare], step: step / step.length_squared().max(f32::MIN_POSITIVE) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::highlight::{EvidencePoint, LEVELS, MODELS, Sight};
    use crate::inverse::fit_groups;
    use crate::sampling::KeyedRng;

    /// `n` albedos of normal scatter around a colour, relative standard deviation `spread`.
    fn scattered(rng: &mut KeyedRng, colour: Vec3, spread: f32, n: usize) -> Vec<Vec3> {
        (0..n)
            .map(|_| {
                let normal = (0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0;
                colour * (spread * normal).exp()
            })
            .collect()
    }

    #[test]
    fn two_colours_are_told_apart_and_one_is_not() {
        let mut rng = KeyedRng::new(1, 2);
        let (tile, grout) = (Vec3::new(0.53, 0.52, 0.44), Vec3::new(0.24, 0.23, 0.22));
        let mut both = scattered(&mut rng, tile, 0.08, 800);
        both.extend(scattered(&mut rng, grout, 0.1, 120));
        let axis = divide(&both).expect("two colours");
        // (the rarer one comes first)
        assert!(axis.place(grout) < 0.15 && axis.place(tile) > 0.95, "{} {}", axis.place(grout), axis.place(tile));
        let middle = axis.place(0.5 * (tile + grout));
        assert!((middle - 0.5).abs() < 0.1, "{middle}");
        assert!(divide(&scattered(&mut rng, tile, 0.25, 1000)).is_none(), "one colour of wide scatter");
        assert!(divide(&both[..50]).is_none(), "too few points");
        assert!(divide(&[Vec3::ZERO; 200]).is_none(), "black");
    }

    const LIGHT: Vec3 = Vec3::splat(2.0);

    /// Evidence of one class: per point its albedo and roughness; six views each, of which two meet a highlight.
    fn evidence_of(rng: &mut KeyedRng, points: &[(Vec3, f32)]) -> Evidence {
        let mut out = Evidence::default();
        for (i, &(albedo, roughness)) in points.iter().enumerate() {
            let first = out.sights.len() as u32;
            for view in 0..6 {
                let strength = if view < 2 { 0.05 * rng.next_f32() } else { 0.0 };
                let response = |r: f32| Vec3::splat(strength / (0.05 + r * r));
                let radiance = albedo * LIGHT / PI + response(roughness);
                out.sights.push(Sight { view, radiance, n_v: 0.8, weight: 1.0 });
                out.diffuse.push([1.0, 0.0, 0.0]);
                MODELS.iter().for_each(|_| out.specular.extend(LEVELS.map(response)));
            }
            let position = Vec3::X * i as f32;
            out.points.push(EvidencePoint { class: 7, triangle: 0, position, first, count: 6 });
        }
        out
    }

    #[test]
    fn a_class_divides_where_its_colours_differ_in_roughness_and_only_there() {
        let (tile, grout) = (Vec3::new(0.53, 0.52, 0.44), Vec3::new(0.24, 0.23, 0.22));
        for (second, divides) in [(0.9, true), (0.15, false)] {
            let mut rng = KeyedRng::new(3, 4);
            let mut points: Vec<(Vec3, f32)> = scattered(&mut rng, tile, 0.05, 300).into_iter().map(|c| (c, 0.15)).collect();
            points.extend(scattered(&mut rng, grout, 0.05, 80).into_iter().map(|c| (c, second)));
            let evidence = evidence_of(&mut rng, &points);
            let model = Reflectance::Paper;
            let materials = Materials::find(&evidence, fit_groups(&evidence, model), model, &|_, _| LIGHT);
            assert_eq!(materials.divided().count(), usize::from(divides), "grout of roughness {second}");
            let roughness = |c: Option<Vec3>| materials.roughness(7, c).expect("evidence").0;
            assert!((roughness(Some(tile)) - 0.15).abs() < 0.02 && (roughness(None) - 0.15).abs() < 0.02);
            assert!((roughness(Some(grout)) - second).abs() < 0.1, "{}", roughness(Some(grout)));
            let between = roughness(Some(grout.lerp(tile, 0.4)));
            assert!(!divides || (between > 0.3 && between < 0.75), "half of each: {between}");
            assert!(materials.roughness(8, None).is_none());
        }
    }
}
