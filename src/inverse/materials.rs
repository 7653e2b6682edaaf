//! One class, several materials: tiles and their grout share a label, not a roughness; nor does the
//! wood of two rooms.
//!
//! A class has one roughness unless the evidence asks for more: one per room, one that follows the
//! colour from texel to texel, or, if neither, one that follows the place (`place.rs`). A division
//! by room or colour stands if each side has evidence of its own, the roughness values differ by
//! more than their errors, and views that had no part in the fit are explained better by them than
//! by one value (cross-validation); of two such, the one that explains more. Between two colours,
//! where a texel holds both materials, the roughness is in between.
//!
//! No mark is a cliff: where evidence lies close to one, the answers on both sides are averaged by
//! [`passing_weight`] (model averaging, Hoeting et al. 1999), so that the roughness moves steadily
//! with the input.

use super::BLACK;
use super::group_fit::GroupFit;
use super::roughness::{fit, held_out};
use super::spatial_roughness::{self, Field};
use super::view_residual::{COMMON_SHARE, Disagreement, diffuse_radiance, points_by_class};
use crate::core::brdf::Reflectance;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, ROUNDS, SURELY, least_passing, median, passing_weight};
use crate::highlight::Evidence;
use glam::Vec3;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Distance of the two mean colours in median deviations from them, from which a class counts as
/// two-coloured. Derived: halves of a normal distribution, whose means are 2√(2/π) = 1.596 and whose
/// median deviation is 0.436 standard deviations, are 3.66 apart; an eighth more.
const APART: f32 = 4.1;
/// Share of the held-out views' disagreement that a division must explain: tiles and grout explain
/// 9 %, surfaces of one roughness whose colour merely follows their place up to 4 %.
pub const SPLIT_GAIN: f64 = COMMON_SHARE;
/// Share of the way from one colour to the other on which points tell of the first, and of the
/// second. Derived: they are nearer to it than to an even mixture.
const PURE: f32 = 0.25;

/// The roughness of every class and of the materials within.
#[derive(Clone, Debug, Default)]
pub struct Materials {
    classes: BTreeMap<u16, Class>,
}

#[derive(Clone, Debug)]
struct Class {
    whole: GroupFit,
    /// Divisions with what each counts for; what is left of 1 is the whole's.
    divisions: Vec<(f32, ClassSplit)>,
}

/// A division that the evidence supports at least in part.
#[derive(Clone, Debug)]
struct Candidate {
    division: ClassSplit,
    /// Share of the held-out views' disagreement that it explains.
    gain: f64,
    /// How surely its sides differ.
    different: f64,
}

/// What tells the materials of a class apart.
#[derive(Clone, Debug)]
enum ClassSplit {
    Colour(Parts),
    /// One fit per room with evidence of its own.
    Room(BTreeMap<u16, GroupFit>),
    Place(Field),
}

/// What is known of the evidence's points besides their views.
pub struct Places<'a> {
    /// Irradiance at a point of a triangle.
    pub irradiance: &'a (dyn Fn(u32, Vec3) -> Vec3 + Sync),
    /// The room that it faces, 0 = none.
    pub room: &'a (dyn Fn(u32, Vec3) -> u16 + Sync),
}

/// Two materials by colour: the rarer one, which is the thinner one too, and the usual one.
#[derive(Clone, Debug)]
struct Parts {
    axis: Axis,
    fits: [GroupFit; 2],
}

/// The way from the rarer albedo to the usual one: what a texel on the border of two materials
/// mixes is light, hence albedo.
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
    /// Divides the classes fitted by `fits` where that explains more than the share `least` of the
    /// held-out views' disagreement.
    #[must_use]
    pub fn find(
        evidence: &Evidence,
        fits: Vec<GroupFit>,
        model: Reflectance,
        places: &Places,
        least: f64,
    ) -> Self {
        let members = points_by_class(evidence);
        let classes = fits
            .into_iter()
            .map(|whole| {
                let points = members.get(&whole.class).map_or(&[][..], Vec::as_slice);
                let table = Disagreement::of(evidence, model, points);
                let albedo = |&i: &usize| {
                    let p = &evidence.points[i];
                    let e = (places.irradiance)(p.triangle, p.position).max(Vec3::splat(1e-12));
                    (diffuse_radiance(evidence, model, i, whole.roughness) * PI / e)
                        .clamp(Vec3::ZERO, Vec3::ONE)
                };
                let colours: Vec<Vec3> = points.par_iter().map(albedo).collect();
                let rooms: Vec<u16> = points
                    .iter()
                    .map(|&i| {
                        (places.room)(evidence.points[i].triangle, evidence.points[i].position)
                    })
                    .collect();
                let by_colour = divide(&colours).and_then(|(axis, told_apart)| {
                    let mut found = by_colour(whole.class, axis, &table, &colours)?;
                    found.different *= told_apart;
                    Some(found)
                });
                let by_room = by_room(whole.class, &table, &rooms);
                let mut divisions = weighed(by_colour, by_room, least);
                let rest = 1.0 - divisions.iter().map(|d| f64::from(d.0)).sum::<f64>();
                if rest > 0.0 {
                    let halves =
                        [0, 1].map(|half| Disagreement::of_half(evidence, model, points, half));
                    // what errors common to all points amount to is a spread: where it is light that errs,
                    // one roughness seems to follow the place (it explains up to 8 % of the disagreement)
                    let least = least + f64::from(SURELY) * COMMON_SHARE - SPLIT_GAIN;
                    let field = spatial_roughness::by_place(&whole, &table, &halves, least);
                    divisions.extend(field.map(|(field, gain)| {
                        let weight = rest * passing_weight(gain, least);
                        (weight as f32, ClassSplit::Place(field))
                    }));
                }
                (whole.class, Class { whole, divisions })
            })
            .collect();
        Self { classes }
    }

    /// One roughness per class, whatever the evidence says.
    #[must_use]
    pub fn undivided(fits: Vec<GroupFit>) -> Self {
        Self {
            classes: fits
                .into_iter()
                .map(|whole| {
                    (
                        whole.class,
                        Class {
                            whole,
                            divisions: Vec::new(),
                        },
                    )
                })
                .collect(),
        }
    }

    /// With one roughness for each of some classes more.
    #[must_use]
    pub fn with(mut self, fits: impl IntoIterator<Item = GroupFit>) -> Self {
        self.classes
            .extend(Self::undivided(fits.into_iter().collect()).classes);
        self
    }

    /// Roughness of a class in a room at a `place` of albedo `colour` (`None`: unknown) and its
    /// standard error; `None` for a class without evidence.
    #[must_use]
    pub fn roughness(
        &self,
        class: u16,
        room: u16,
        colour: Option<Vec3>,
        place: Vec3,
    ) -> Option<(f32, f32)> {
        let Class { whole, divisions } = self.classes.get(&class)?;
        let of = |f: &GroupFit| (f.roughness, f.error);
        let answer = |division: &ClassSplit| match division {
            ClassSplit::Room(fits) => of(fits.get(&room).unwrap_or(whole)),
            ClassSplit::Place(field) => field.at(place),
            ClassSplit::Colour(p) => {
                // the usual colour scatters from tile to tile; what lies beyond the rare one is
                // just that
                let t = colour.map_or(1.0, |c| (p.axis.place(c) / (1.0 - PURE)).min(1.0));
                let between =
                    |f: fn(&GroupFit) -> f32| f(&p.fits[0]) * (1.0 - t) + f(&p.fits[1]) * t;
                (between(|f| f.roughness), between(|f| f.error))
            }
        };
        let rest = 1.0 - divisions.iter().map(|d| d.0).sum::<f32>();
        let answers: Vec<(f32, (f32, f32))> = divisions
            .iter()
            .map(|(weight, division)| (*weight, answer(division)))
            .chain((rest > 0.0).then(|| (rest, of(whole))))
            .collect();
        Some(averaged(&answers))
    }

    /// Classes of two colours, with the roughness of both.
    pub fn by_colour(&self) -> impl Iterator<Item = (u16, [f32; 2])> {
        self.classes
            .iter()
            .flat_map(|(&class, c)| c.divisions.iter().map(move |d| (class, &d.1)))
            .filter_map(|(class, d)| match d {
                ClassSplit::Colour(p) => Some((class, [p.fits[0].roughness, p.fits[1].roughness])),
                _ => None,
            })
    }

    /// Classes whose roughness differs from room to room, with the rooms' values.
    pub fn by_room(&self) -> impl Iterator<Item = (u16, Vec<(u16, f32)>)> {
        self.classes
            .iter()
            .flat_map(|(&class, c)| c.divisions.iter().map(move |d| (class, &d.1)))
            .filter_map(|(class, d)| match d {
                ClassSplit::Room(fits) => Some((
                    class,
                    fits.iter().map(|(room, f)| (*room, f.roughness)).collect(),
                )),
                _ => None,
            })
    }

    /// Classes whose roughness follows the place, with the values that a twentieth of their points
    /// lies below, and above.
    pub fn by_place(&self) -> impl Iterator<Item = (u16, [f32; 2])> {
        self.classes
            .iter()
            .flat_map(|(&class, c)| c.divisions.iter().map(move |d| (class, &d.1)))
            .filter_map(|(class, d)| match d {
                ClassSplit::Place(field) => Some((class, field.range())),
                _ => None,
            })
    }

    /// The fits of whole classes.
    pub fn fits(&self) -> impl Iterator<Item = &GroupFit> {
        self.classes.values().map(|c| &c.whole)
    }
}

/// What two ways to divide a class count for: as much as their gains pass `least` and their sides
/// differ; of both, mostly the one that explains more.
fn weighed(
    by_colour: Option<Candidate>,
    by_room: Option<Candidate>,
    least: f64,
) -> Vec<(f32, ClassSplit)> {
    let weight = |c: &Option<Candidate>| {
        c.as_ref()
            .map_or(0.0, |c| passing_weight(c.gain, least) * c.different)
    };
    let (colour, room) = (weight(&by_colour), weight(&by_room));
    let gain = |c: &Option<Candidate>| c.as_ref().map_or(0.0, |c| c.gain);
    // how surely colour explains more than room
    let first = passing_weight(gain(&by_colour), gain(&by_room));
    let weights = [
        colour * (1.0 - room * (1.0 - first)),
        room * (1.0 - colour * first),
    ];
    [by_colour, by_room]
        .into_iter()
        .zip(weights)
        .filter(|(_, w)| *w > 0.0)
        .filter_map(|(c, w)| Some((w as f32, c?.division)))
        .collect()
}

/// Mean and standard error of a mixture of answers, each with its weight; weights add to 1.
fn averaged(answers: &[(f32, (f32, f32))]) -> (f32, f32) {
    if let [(_, one)] = answers {
        return *one;
    }
    let mean: f32 = answers.iter().map(|(w, a)| w * a.0).sum();
    let variance: f32 = answers
        .iter()
        .map(|(w, a)| w * (a.1 * a.1 + (a.0 - mean).powi(2)))
        .sum();
    (mean, variance.sqrt())
}

/// Divides a class by colour.
fn by_colour(class: u16, axis: Axis, table: &Disagreement, colours: &[Vec3]) -> Option<Candidate> {
    let of = |lies: &dyn Fn(f32) -> bool| table.of_points(|k| lies(axis.place(colours[k])));
    let sides = [of(&|place| place <= PURE), of(&|place| place >= 1.0 - PURE)];
    let explained = explained(class, &sides)?;
    let fits = <[GroupFit; 2]>::try_from(explained.fits).ok()?;
    Some(Candidate {
        division: ClassSplit::Colour(Parts { axis, fits }),
        gain: explained.gain,
        different: explained.different,
    })
}

/// The same room by room.
fn by_room(class: u16, table: &Disagreement, rooms: &[u16]) -> Option<Candidate> {
    let mut size: BTreeMap<u16, usize> = BTreeMap::new();
    rooms
        .iter()
        .filter(|room| **room != 0)
        .for_each(|room| *size.entry(*room).or_default() += 1);
    let names: Vec<u16> = size
        .into_iter()
        .filter(|(_, n)| *n >= ENOUGH)
        .map(|(room, _)| room)
        .collect();
    let sides: Vec<Disagreement> = names
        .iter()
        .map(|room| table.of_points(|k| rooms[k] == *room))
        .collect();
    let explained = explained(class, &sides)?;
    Some(Candidate {
        division: ClassSplit::Room(names.into_iter().zip(explained.fits).collect()),
        gain: explained.gain,
        different: explained.different,
    })
}

/// The sides of a division, each fitted by itself.
struct Explained {
    fits: Vec<GroupFit>,
    /// Share of the held-out views' disagreement that the division explains.
    gain: f64,
    /// How surely the sides differ.
    different: f64,
}

/// Fits each side of a division; `None` unless the sides may differ.
fn explained(class: u16, sides: &[Disagreement]) -> Option<Explained> {
    if sides.len() < 2 || sides.iter().any(|s| s.rows.len() < ENOUGH) {
        return None;
    }
    let apart: f64 = sides.iter().map(held_out).sum();
    let together = Disagreement {
        levels: sides[0].levels,
        rows: sides.iter().flat_map(|s| s.rows.iter().cloned()).collect(),
        places: sides
            .iter()
            .flat_map(|s| s.places.iter().copied())
            .collect(),
    };
    let together = held_out(&together);
    if together <= 0.0 {
        return None;
    }
    let gain = 1.0 - apart / together;
    let fits: Vec<GroupFit> = sides.iter().map(|s| fit(class, s)).collect();
    let by_value = |a: &&GroupFit, b: &&GroupFit| a.roughness.total_cmp(&b.roughness);
    let (low, high) = (fits.iter().min_by(by_value)?, fits.iter().max_by(by_value)?);
    let mark = f64::from(SURELY * low.own_error.hypot(high.own_error));
    let different = passing_weight(f64::from(high.roughness - low.roughness), mark);
    (different > 0.0).then_some(Explained {
        fits,
        gain,
        different,
    })
}

/// The way from the rarer to the more usual of the two colours that a list is divided into best
/// (Lloyd 1982), and how surely they are two; `None` if it has one colour.
fn divide(colours: &[Vec3]) -> Option<(Axis, f64)> {
    // what lost a channel to a highlight has no colour
    let whole = |c: &Vec3| c.min_element() > BLACK;
    let colours: Vec<Vec3> = colours.iter().copied().filter(whole).collect();
    if colours.len() < 2 * ENOUGH {
        return None;
    }
    let logs: Vec<Vec3> = colours.iter().map(|c| c.map(f32::ln)).collect();
    let mut order: Vec<f32> = logs.iter().map(|l| luminance(*l)).collect();
    order.sort_by(f32::total_cmp);
    // from near the ends, where a rare material is
    let tail = order.len() / 20;
    let mut centres = [order[tail], order[order.len() - 1 - tail]].map(Vec3::splat);
    let mut side = vec![0usize; logs.len()];
    for _ in 0..ROUNDS {
        let (mut sums, mut counts) = ([Vec3::ZERO; 2], [0.0f32; 2]);
        for (l, side) in logs.iter().zip(&mut side) {
            let d = centres.map(|c| (*l - c).length_squared());
            let k = usize::from(d[1] < d[0]);
            *side = k;
            sums[k] += *l;
            counts[k] += 1.0;
        }
        if counts.contains(&0.0) {
            return None;
        }
        centres = [0, 1].map(|k| sums[k] / counts[k]);
    }
    let way = centres[1] - centres[0];
    // (the median: what a highlight took most of is far off)
    let off = logs.iter().zip(&side).map(|(l, k)| l.distance(centres[*k]));
    // (three channels: the distance between grey colours is √3 times that of one)
    let [spread, apart] = [median(off.collect())?, way.length()].map(|d| d / 3f32.sqrt());
    // (albedo is not known better than to 0.02, of which the median deviation is two thirds)
    let mark = f64::from(APART * spread.max(0.0135));
    let apart = f64::from(apart);
    if apart <= least_passing(mark) {
        return None;
    }
    let mean = |of: &dyn Fn(usize) -> bool| {
        let (sum, n) = (0..colours.len())
            .filter(|&i| of(i))
            .fold((Vec3::ZERO, 0.0), |s, i| (s.0 + colours[i], s.1 + 1.0));
        sum / f32::max(n, 1.0)
    };
    // the rarer material is the thinner one, and most of its pixels hold some of the other: the
    // half farther off is purer
    let rare = usize::from(2 * side.iter().sum::<usize>() < side.len());
    let outwards = if rare == 1 { way } else { -way };
    let ends = [0, 1].map(|k| {
        mean(&|i| side[i] == k && (k != rare || (logs[i] - centres[k]).dot(outwards) >= 0.0))
    });
    let step = ends[1 - rare] - ends[rare];
    let axis = Axis {
        from: ends[rare],
        step: step / step.length_squared().max(f32::MIN_POSITIVE),
    };
    Some((axis, passing_weight(apart, mark)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::SpecularLobe;
    use crate::core::sampling::KeyedRng;
    use crate::highlight::TestSight;
    use crate::inverse::fit_groups;

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
        let (axis, surely) = divide(&both).expect("two colours");
        assert_eq!(surely, 1.0);
        // (the rarer one comes first)
        assert!(
            axis.place(grout) < 0.15 && axis.place(tile) > 0.95,
            "{} {}",
            axis.place(grout),
            axis.place(tile)
        );
        let middle = axis.place(0.5 * (tile + grout));
        assert!((middle - 0.5).abs() < 0.1, "{middle}");
        // a few whose colour a highlight took away change nothing
        both.extend([Vec3::ZERO; 12]);
        let (axis, surely) = divide(&both).expect("two colours and black");
        assert!(surely > 0.99 && axis.place(tile) > 0.95, "{surely}");
        assert!(axis.place(grout) < 0.15, "{}", axis.place(grout));
        let one = divide(&scattered(&mut rng, tile, 0.25, 1000));
        assert!(
            one.is_none_or(|(_, surely)| surely < 0.05),
            "one colour of wide scatter"
        );
        assert!(divide(&both[..50]).is_none(), "too few points");
        assert!(divide(&[Vec3::ZERO; 200]).is_none(), "black");
    }

    const LIGHT: Vec3 = Vec3::splat(2.0);

    /// Evidence of one class: per point its albedo and roughness; six views each, of which two meet
    /// a highlight.
    fn evidence_of(rng: &mut KeyedRng, points: &[(Vec3, f32)]) -> Evidence {
        let mut out = Evidence::default();
        for &(albedo, roughness) in points {
            let looks: Vec<_> = (0..6)
                .map(|view| {
                    let strength = if view < 2 { 0.05 * rng.next_f32() } else { 0.0 };
                    move |_: SpecularLobe, r: f32| [Vec3::splat(strength / (0.05 + r * r)); 2]
                })
                .collect();
            let sights: Vec<TestSight> = looks
                .iter()
                .map(|response| TestSight {
                    radiance: albedo * LIGHT / PI + response(out.lobes[0], roughness)[0],
                    diffuse: [1.0, 0.0, 0.0],
                    response,
                })
                .collect();
            out.push_test(7, &sights, 0);
        }
        out
    }

    #[test]
    fn a_class_divides_where_its_colours_differ_in_roughness_and_only_there() {
        let (tile, grout) = (Vec3::new(0.53, 0.52, 0.44), Vec3::new(0.24, 0.23, 0.22));
        for (second, divides) in [(0.9, true), (0.15, false)] {
            let mut rng = KeyedRng::new(3, 4);
            let mut points: Vec<(Vec3, f32)> = scattered(&mut rng, tile, 0.05, 300)
                .into_iter()
                .map(|c| (c, 0.15))
                .collect();
            points.extend(
                scattered(&mut rng, grout, 0.05, 80)
                    .into_iter()
                    .map(|c| (c, second)),
            );
            let evidence = evidence_of(&mut rng, &points);
            let model = Reflectance::Paper;
            let places = Places {
                irradiance: &|_, _| LIGHT,
                room: &|_, _| 1,
            };
            let materials = Materials::find(
                &evidence,
                fit_groups(&evidence, model),
                model,
                &places,
                SPLIT_GAIN,
            );
            assert_eq!(
                materials.by_colour().count(),
                usize::from(divides),
                "grout of roughness {second}"
            );
            assert_eq!(materials.by_room().count(), 0);
            let roughness = |c: Option<Vec3>| {
                materials
                    .roughness(7, 1, c, Vec3::ZERO)
                    .expect("evidence")
                    .0
            };
            assert!(
                (roughness(Some(tile)) - 0.15).abs() < 0.02
                    && (roughness(None) - 0.15).abs() < 0.02
            );
            assert!(
                (roughness(Some(grout)) - second).abs() < 0.1,
                "{}",
                roughness(Some(grout))
            );
            let between = roughness(Some(grout.lerp(tile, 0.4)));
            assert!(
                !divides || (between > 0.3 && between < 0.75),
                "half of each: {between}"
            );
            assert!(materials.roughness(8, 1, None, Vec3::ZERO).is_none());
        }
    }

    #[test]
    fn roughness_moves_steadily_with_the_evidence_across_every_mark() {
        // a second room whose roughness departs from the first's in small steps: somewhere on the
        // way the class divides
        let wood = Vec3::new(0.4, 0.3, 0.2);
        let found = |second: f32| {
            let mut rng = KeyedRng::new(5, 6);
            let points: Vec<(Vec3, f32)> = scattered(&mut rng, wood, 0.1, 400)
                .into_iter()
                .enumerate()
                .map(|(i, c)| (c, if i < 200 { 0.2 } else { second }))
                .collect();
            let evidence = evidence_of(&mut rng, &points);
            let model = Reflectance::Paper;
            let places = Places {
                irradiance: &|_, _| LIGHT,
                room: &|_, p| if p.x < 200.0 { 1 } else { 2 },
            };
            let fits = fit_groups(&evidence, model);
            let materials = Materials::find(&evidence, fits, model, &places, SPLIT_GAIN);
            let at = |room: u16| {
                let own = materials.roughness(7, room, Some(wood), Vec3::ZERO);
                own.expect("evidence").0
            };
            [at(1), at(2)]
        };
        const STEPS: usize = 40;
        let walk: Vec<[f32; 2]> = (0..=STEPS)
            .map(|k| found(0.2 + 0.3 * k as f32 / STEPS as f32))
            .collect();
        assert!(walk[0][1] - walk[0][0] < 0.01, "one roughness at first");
        assert!(walk[STEPS][1] - walk[STEPS][0] > 0.25, "two at last");
        // between two steps either room's value may move by what the whole way is in a tenth of it
        for (k, w) in walk.windows(2).enumerate() {
            let moved = (w[1][0] - w[0][0]).abs().max((w[1][1] - w[0][1]).abs());
            assert!(moved < 0.06, "step {k}: {:?} to {:?}", w[0], w[1]);
        }
        // and rounding moves nothing
        for second in [0.25, 0.28, 0.31, 0.34, 0.4] {
            let (a, b) = (found(second), found(second * (1.0 + 1e-6)));
            for (a, b) in a.iter().zip(&b) {
                assert!((a - b).abs() < 1e-3, "{second}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_class_divides_by_room_where_its_roughness_differs_from_room_to_room_and_only_there() {
        let wood = Vec3::new(0.4, 0.3, 0.2);
        for (second, divides) in [(0.6, true), (0.2, false)] {
            let mut rng = KeyedRng::new(5, 6);
            let points: Vec<(Vec3, f32)> = scattered(&mut rng, wood, 0.1, 400)
                .into_iter()
                .enumerate()
                .map(|(i, c)| (c, if i < 250 { 0.2 } else { second }))
                .collect();
            let evidence = evidence_of(&mut rng, &points);
            let model = Reflectance::Paper;
            // (points lie along x; a third room has too few of them)
            let places = Places {
                irradiance: &|_, _| LIGHT,
                room: &|_, p| {
                    if p.x < 250.0 {
                        1
                    } else {
                        2 + u16::from(p.x >= 380.0)
                    }
                },
            };
            let materials = Materials::find(
                &evidence,
                fit_groups(&evidence, model),
                model,
                &places,
                SPLIT_GAIN,
            );
            assert_eq!(
                materials.by_room().count(),
                usize::from(divides),
                "second room of roughness {second}"
            );
            assert_eq!(materials.by_colour().count(), 0);
            let roughness = |room: u16| {
                materials
                    .roughness(7, room, Some(wood), Vec3::ZERO)
                    .expect("evidence")
                    .0
            };
            assert!((roughness(1) - 0.2).abs() < 0.03, "{}", roughness(1));
            assert!((roughness(2) - second).abs() < 0.05, "{}", roughness(2));
            let whole = materials.fits().next().expect("a class").roughness;
            assert_eq!(roughness(3), whole, "too few points of its own");
            let one = Materials::undivided(fit_groups(&evidence, model));
            assert_eq!(
                one.roughness(7, 2, None, Vec3::ZERO).expect("evidence").0,
                whole
            );
        }
    }
}
