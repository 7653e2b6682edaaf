//! Roughness that changes from place to place within a class: wear, polish, several things of one
//! label and one colour.
//!
//! The views' disagreement is summed over the nearest points of evidence and a share of the class's
//! mean, so that places whose points say little keep the class's roughness and those that know
//! better have their own: a local likelihood (Tibshirani & Hastie 1987) shrunk towards the whole.
//! Neighbouring points share errors that are not noise, and halves of the points would agree on
//! them; so it is views that judge: what one half of them asks for must explain the other half
//! better.

use super::group_fit::GroupFit;
use super::roughness::{at_roughness, fit, lowest, parabola_minimum};
use super::view_residual::Disagreement;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, least_passing};
use glam::Vec3;
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// What the class counts for beside them: what explains most is taken. Derived: as much as a place, whose difference
/// from the class is halved then; a quarter of it gives places twice the standard deviation, a sixteenth four times.
const STRENGTHS: [f64; 3] = [1.0, 0.25, 0.0625];
/// Points of evidence at which a place's roughness is interpolated between. Derived: those around it, were they laid
/// out in squares.
const BETWEEN: usize = 8;

type Spot = GeomWithData<[f32; 3], (f32, f32)>;

/// Roughness over the places of a class.
#[derive(Clone, Debug)]
pub(super) struct Field {
    spots: RTree<Spot>,
}

impl Field {
    /// The roughness at a point and its standard error: those of the nearest points of evidence, by
    /// inverse squared distance.
    pub(super) fn at(&self, place: Vec3) -> (f32, f32) {
        let (mut sum, mut total) = ([0.0f32; 2], 0.0f32);
        let nearest = self
            .spots
            .nearest_neighbor_iter_with_distance_2(&place.to_array())
            .take(BETWEEN);
        for (spot, square) in nearest {
            let weight = 1.0 / square.max(1e-6);
            sum = [sum[0] + weight * spot.data.0, sum[1] + weight * spot.data.1];
            total += weight;
        }
        (sum[0] / total, sum[1] / total)
    }

    /// The roughness values that a twentieth of the points lies below, and above.
    pub(super) fn range(&self) -> [f32; 2] {
        let mut values: Vec<f32> = self.spots.iter().map(|s| s.data.0).collect();
        values.sort_by(f32::total_cmp);
        let tail = values.len() / 20;
        [values[tail], values[values.len() - 1 - tail]]
    }
}

/// The roughness from place to place of the class `whole`, and what share of one half of the views'
/// disagreement it explains if it is found from the other half; `None` if that does not
/// come near `least`. `table` and `halves` hold the disagreement at the same places: of all views, and
/// of either half (zero where a half has not two views).
pub(super) fn by_place(
    whole: &GroupFit,
    table: &Disagreement,
    halves: &[Disagreement; 2],
    least: f64,
) -> Option<(Field, f64)> {
    let told = |k: usize| halves.iter().all(|h| h.rows[k].iter().any(|d| *d != 0.0));
    let judges = [0, 1].map(|half: usize| halves[half].of_points(told));
    let judged = &judges[0].places;
    // two places at least
    if judged.len() < 2 * ENOUGH {
        return None;
    }
    let around = neighbours(judged);
    let gains = STRENGTHS.map(|strength| gain(&judges, &around, strength));
    let (strength, gain) = STRENGTHS
        .into_iter()
        .zip(gains)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, gain)| *gain > least_passing(least))?;
    let around = neighbours(&table.places);
    let own: Vec<(f32, f32)> = around
        .par_iter()
        .map(|near| {
            let rows = near
                .iter()
                .map(|&k| table.rows[k as usize].clone())
                .collect();
            let local = fit(
                whole.class,
                &Disagreement {
                    levels: table.levels,
                    rows,
                    places: near.iter().map(|&k| table.places[k as usize]).collect(),
                },
            );
            (
                vertex(
                    table.levels,
                    &shrunk(table, near, &whole.objective, strength),
                ),
                local.error,
            )
        })
        .collect();
    // no place is less certain than if nothing but the class were known
    let spread = own
        .iter()
        .map(|(r, _)| (r - whole.roughness).powi(2))
        .sum::<f32>()
        / own.len() as f32;
    let at_most = spread.sqrt().hypot(whole.error);
    let spots = table
        .places
        .iter()
        .zip(own)
        .map(|(p, (r, error))| Spot::new(p.to_array(), (r, error.min(at_most))))
        .collect();
    Some((
        Field {
            spots: RTree::bulk_load(spots),
        },
        gain,
    ))
}

/// The [`ENOUGH`] positions that are nearest to each of them, itself included, in order of their
/// index.
fn neighbours(positions: &[Vec3]) -> Vec<Vec<u32>> {
    let numbered = positions
        .iter()
        .zip(0u32..)
        .map(|(p, k)| GeomWithData::new(p.to_array(), k));
    let tree: RTree<GeomWithData<[f32; 3], u32>> = RTree::bulk_load(numbered.collect());
    let nearest = |p: &Vec3| {
        let mut near: Vec<u32> = tree
            .nearest_neighbor_iter(&p.to_array())
            .take(ENOUGH)
            .map(|g| g.data)
            .collect();
        near.sort_unstable();
        near
    };
    positions.par_iter().map(nearest).collect()
}

/// The share of one half of the views' disagreement that places explain if they are found from the
/// other half.
fn gain(halves: &[Disagreement; 2], around: &[Vec<u32>], strength: f64) -> f64 {
    let (mut apart, mut together) = (0.0, 0.0);
    for [from, held] in [[0, 1], [1, 0]] {
        let (from, held) = (&halves[from], &halves[held]);
        let mean: Vec<f64> = from
            .sum(|_| true)
            .into_iter()
            .map(|d| d / around.len() as f64)
            .collect();
        let local = |near: &Vec<u32>| vertex(from.levels, &shrunk(from, near, &mean, strength));
        let explained: Vec<f64> = around
            .par_iter()
            .zip(&held.rows)
            .map(|(near, row)| at_roughness(held.levels, row, local(near)))
            .collect();
        apart += explained.iter().sum::<f64>();
        together += at_roughness(held.levels, &held.sum(|_| true), vertex(from.levels, &mean));
    }
    if together > 0.0 {
        1.0 - apart / together
    } else {
        0.0
    }
}

/// The disagreement of the points `near` and of `strength` times as many that are like the class's
/// `mean`.
fn shrunk(table: &Disagreement, near: &[u32], mean: &[f64], strength: f64) -> Vec<f64> {
    let mut sum: Vec<f64> = mean
        .iter()
        .map(|m| m * strength * near.len() as f64)
        .collect();
    for &k in near {
        sum.iter_mut()
            .zip(&table.rows[k as usize])
            .for_each(|(s, d)| *s += d);
    }
    sum
}

fn vertex(levels: &[f32], objective: &[f64]) -> f32 {
    parabola_minimum(levels, lowest(objective), objective).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    const LEVELS: [f32; 6] = [0.1, 0.2, 0.35, 0.5, 0.7, 1.0];

    /// Points on a strip four metres long whose views ask for the roughness `of(x)`, with noise;
    /// both halves of the views and all.
    fn strip(
        noise: f64,
        of: impl Fn(f32) -> f32,
    ) -> (Disagreement<'static>, [Disagreement<'static>; 2]) {
        let mut rng = KeyedRng::new(9, 4);
        let positions: Vec<Vec3> = (0..1200)
            .map(|_| Vec3::new(4.0 * rng.next_f32(), 0.3 * rng.next_f32(), 0.0))
            .collect();
        let mut rows = || -> Vec<Vec<f64>> {
            let row = |p: &Vec3| {
                let off = noise * (f64::from(rng.next_f32()) - 0.5);
                LEVELS
                    .iter()
                    .map(|r| 0.01 + 0.1 * (f64::from(r - of(p.x)) + off).powi(2))
                    .collect()
            };
            positions.iter().map(row).collect()
        };
        let halves = [rows(), rows()];
        let both = halves[0]
            .iter()
            .zip(&halves[1])
            .map(|(a, b)| a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect())
            .collect();
        let table = |rows| Disagreement {
            levels: &LEVELS,
            rows,
            places: positions.clone(),
        };
        (table(both), halves.map(table))
    }

    #[test]
    fn wear_along_a_strip_is_found_and_evenness_stays_even() {
        let worn = |x: f32| 0.2 + 0.15 * x;
        let (table, halves) = strip(0.4, worn);
        let (field, gain) =
            by_place(&fit(1, &table), &table, &halves, f64::NEG_INFINITY).expect("points enough");
        assert!(gain > 0.15, "{gain}");
        let mut last = 0.0;
        for x in [0.3, 1.0, 2.0, 3.0, 3.7] {
            let (r, error) = field.at(Vec3::new(x, 0.15, 0.0));
            assert!(
                r > last && (r - worn(x)).abs() < 0.06 && error > 0.0 && error < 0.3,
                "{r} ± {error} at {x}"
            );
            last = r;
        }
        let [low, high] = field.range();
        assert!(low < 0.3 && high > 0.7, "{low} {high}");
        let (table, halves) = strip(0.4, |_| 0.5);
        let (field, gain) =
            by_place(&fit(1, &table), &table, &halves, f64::NEG_INFINITY).expect("points enough");
        assert!(gain < 0.02, "{gain}");
        assert!((field.at(Vec3::X).0 - 0.5).abs() < 0.05);
    }

    #[test]
    fn what_one_half_of_the_views_says_and_the_other_denies_explains_nothing() {
        let (table, _) = strip(0.0, |x| 0.2 + 0.15 * x);
        let (_, [one, _]) = strip(0.0, |x| 0.2 + 0.15 * x);
        let (_, [_, other]) = strip(0.0, |x| 0.8 - 0.15 * x);
        let (_, gain) = by_place(&fit(1, &table), &table, &[one, other], f64::NEG_INFINITY)
            .expect("points enough");
        assert!(gain < 0.0, "{gain}");
        let few = |t: &Disagreement<'static>| t.of_points(|k| k < 2 * ENOUGH - 1);
        let (table, halves) = strip(0.0, |_| 0.5);
        let few_halves = [few(&halves[0]), few(&halves[1])];
        assert!(
            by_place(
                &fit(1, &table),
                &few(&table),
                &few_halves,
                f64::NEG_INFINITY
            )
            .is_none(),
            "too few points"
        );
    }
}
