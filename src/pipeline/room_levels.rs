//! One paint in several rooms: what the light of each room is not known to, its surfaces tell.
//!
//! Where photographs do not hold the light (display-referred ones, after the energy balance), the
//! level of every room is known to a relative error s only, and one paint comes out at as many
//! albedos as there are rooms. The rooms of a class are a mixture: a share π of them has the class's
//! common paint μ, seen as N(μ, s²) in ln albedo, the others a paint of their own, seen as
//! N(μ, s² + σ²) with the scatter σ of indoor surfaces. Expectation maximisation (Dempster, Laird
//! and Rubin 1977) finds μ, π and the probability that a room has the common paint; by that share of
//! its distance the room moves to μ, and the light takes over what it gives up. Called by
//! the energy balance.

use super::Light;
use super::missing_light::scale_irradiance;
use super::texel_radiance::texture_of;
use super::white_paint::{WHITE, WHITE_SPREAD};
use crate::core::parallel::prelude::*;
use crate::core::stats::weighted_median;
use crate::inverse::{AlbedoEstimate, BLACK};
use crate::observed::Surface;
use crate::verdict::GUESS;
use glam::Vec3;
use std::collections::BTreeMap;

/// Scatter of indoor albedos in logarithm. Derived: that of the guess, at the albedo of white paint.
const OWN_PAINT: f32 = GUESS as f32 / (0.5 * WHITE);
/// Rounds of the expectation maximisation. Derived: its steps shrink by half or more where two
/// groups lie apart, 2⁻³⁰ is below rounding.
const ROUNDS: usize = 30;
/// Texels of a class in a room that tell its level at most.
const SAMPLES: usize = 20_000;

/// The level of a class in a room.
#[derive(Clone, Copy, Debug)]
struct Level {
    /// Median of ln albedo over its clean surface, per channel.
    log: Vec3,
    /// Its area, m².
    area: f32,
}

/// What became of the levels of classes in rooms.
#[derive(Clone, Debug, Default)]
pub(super) struct PooledLevels {
    /// The largest move, in ln albedo.
    pub(super) largest: f32,
    /// Probability that a class has in a room the paint that it has in others, by label and room;
    /// nothing of a class that is in one room only.
    pub(super) common: BTreeMap<(u16, u16), f32>,
}

/// Moves every class of every room towards the paint that the class has in all, as far as the rooms'
/// light is unknown. Levels are those of `expected`, the albedos as far as paint allows.
pub(super) fn pool_room_levels(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    expected: &[Vec3],
    rooms: &[u16],
) -> PooledLevels {
    let light_error = light_error(surface);
    let tells = |i: usize| {
        let emits = light.emissive[surface.texels.point[i].triangle as usize];
        let agreed = !surface.contradictions.contradicted(i);
        albedo.clean[i] && albedo.error[i].is_finite() && !emits && agreed
    };
    let mut moves: BTreeMap<(u16, u16), Vec3> = BTreeMap::new();
    let mut common = BTreeMap::new();
    for (class, levels) in levels(surface, &tells, expected, rooms) {
        let (ids, levels): (Vec<u16>, Vec<Level>) = levels.into_iter().unzip();
        // one room alone has nothing in common with others
        let several = levels.len() > 1;
        for (room, painted) in ids.into_iter().zip(common_paint(&levels, light_error)) {
            moves.insert((class, room), painted.step);
            if several {
                common.insert((class, room), painted.common);
            }
        }
    }
    let factors: Vec<Vec3> = (0..albedo.value.len())
        .into_par_iter()
        .map(|i| match moves.get(&(surface.labels[i], rooms[i])) {
            Some(m) => (-*m).exp(),
            None => Vec3::ONE,
        })
        .collect();
    let ratio = texture_of(&surface.texels, &factors);
    scale_irradiance(surface, light, albedo, &ratio);
    let largest = |m: &Vec3| m.abs().max_element();
    PooledLevels {
        largest: moves.values().map(largest).fold(0.0, f32::max),
        common,
    }
}

/// Relative error to which the light of a room is known: how far white paints scatter, and what
/// photographs of one place differ by.
pub(super) fn light_error(surface: &Surface) -> f32 {
    WHITE_SPREAD.hypot(surface.disagreement)
}

/// The level of every class in each room that shows it, by class.
fn levels(
    surface: &Surface,
    tells: &dyn Fn(usize) -> bool,
    expected: &[Vec3],
    rooms: &[u16],
) -> BTreeMap<u16, BTreeMap<u16, Level>> {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    let mut members: BTreeMap<(u16, u16), Vec<usize>> = BTreeMap::new();
    for i in (0..texels.len()).filter(|&i| surface.labels[i] != 0 && tells(i)) {
        members
            .entry((surface.labels[i], rooms[i]))
            .or_default()
            .push(i);
    }
    let mut found: BTreeMap<u16, BTreeMap<u16, Level>> = BTreeMap::new();
    for ((class, room), ids) in members {
        let area = |i: usize| texels.area(mesh, i);
        let some = ids.iter().step_by(ids.len() / SAMPLES + 1).copied();
        let some: Vec<(Vec3, f32)> = some.map(|i| (expected[i], area(i))).collect();
        let middle = |c: usize| {
            let pairs: Vec<(f32, f32)> = some.iter().map(|(v, a)| (v[c], *a)).collect();
            weighted_median(&pairs).map_or(BLACK, |k| pairs[k].0.max(BLACK))
        };
        let log = Vec3::new(middle(0), middle(1), middle(2)).ln();
        let area = ids.iter().map(|&i| area(i)).sum();
        let rooms = found.entry(class).or_default();
        rooms.insert(room, Level { log, area });
    }
    found
}

/// A room beside the paint that most of them have.
#[derive(Clone, Copy, Debug)]
struct Painted {
    /// Probability that the room has it.
    common: f32,
    /// How far it moves towards it, in ln albedo.
    step: Vec3,
}

/// What each room has of the paint that most of them have.
fn common_paint(levels: &[Level], light_error: f32) -> Vec<Painted> {
    let middle = |c: usize| {
        let pairs: Vec<(f32, f32)> = levels.iter().map(|l| (l.log[c], l.area)).collect();
        weighted_median(&pairs).map_or(0.0, |k| pairs[k].0)
    };
    let mut paint = Vec3::new(middle(0), middle(1), middle(2));
    let (narrow, wide) = (light_error, light_error.hypot(OWN_PAINT));
    let density = |d: f32, s: f32| (-0.5 * (d / s).powi(2)).exp() / s.max(f32::MIN_POSITIVE);
    let mut common = 0.5f32;
    let mut own: Vec<f32> = vec![1.0; levels.len()];
    for _ in 0..ROUNDS {
        for (p, l) in own.iter_mut().zip(levels) {
            // the channels share the light's error: the farthest one tells
            let d = (l.log - paint).abs().max_element();
            let (same, other) = (
                common * density(d, narrow),
                (1.0 - common) * density(d, wide),
            );
            *p = same / (same + other).max(f32::MIN_POSITIVE);
        }
        // (the mean of a uniform prior and the rooms: one room alone proves nothing)
        common = (own.iter().sum::<f32>() + 1.0) / (levels.len() as f32 + 2.0);
        let weight: f32 = own.iter().zip(levels).map(|(p, l)| p * l.area).sum();
        let sum: Vec3 = (own.iter().zip(levels))
            .map(|(p, l)| l.log * (p * l.area))
            .sum();
        if weight > 0.0 {
            paint = sum / weight;
        }
    }
    (own.iter().zip(levels))
        .map(|(&common, l)| Painted {
            common,
            step: (paint - l.log) * common,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(albedo: f32, area: f32) -> Level {
        Level {
            log: Vec3::splat(albedo.ln()),
            area,
        }
    }

    /// Rooms that differ by less than their light is known to become one paint, nearly.
    #[test]
    fn rooms_within_the_light_s_error_share_a_paint() {
        let levels = [0.74, 0.82, 0.74, 0.8, 0.71, 0.79, 0.67].map(|a| level(a, 10.0));
        let moves = common_paint(&levels, 0.2);
        let after: Vec<f32> = (levels.iter().zip(&moves))
            .map(|(l, m)| (l.log.x + m.step.x).exp())
            .collect();
        let most = after.iter().copied().fold(0.0, f32::max);
        let least = after.iter().copied().fold(1.0, f32::min);
        assert!(most / least < 1.05, "{after:?}");
        assert!((0.7..0.8).contains(&least), "{after:?}");
    }

    /// A room of another colour keeps it, and does not move the others' paint; where the light is
    /// known nothing moves but what it leaves open.
    #[test]
    fn a_room_of_its_own_colour_keeps_it() {
        let mut levels = [0.8, 0.78, 0.82, 0.8].map(|a| level(a, 10.0)).to_vec();
        levels.push(level(0.15, 12.0));
        let red = Level {
            log: Vec3::new(0.8, 0.3, 0.2).ln(),
            area: 9.0,
        };
        levels.push(red);
        let moves = common_paint(&levels, 0.15);
        for (l, m) in levels[4..].iter().zip(&moves[4..]) {
            assert!(m.step.abs().max_element() < 0.02, "{l:?}: {m:?}");
            assert!(m.common < 0.1, "{l:?}: {m:?}");
        }
        for m in &moves[..4] {
            assert!(m.step.abs().max_element() < 0.05, "{m:?}");
            assert!(m.common > 0.8, "{m:?}");
        }
        let sure = common_paint(&[level(0.8, 1.0), level(0.6, 1.0), level(0.7, 1.0)], 0.01);
        let moved = sure
            .iter()
            .filter(|m| m.step.abs().max_element() > 0.02)
            .count();
        assert_eq!(moved, 0, "{sure:?}");
        assert!(common_paint(&[], 0.1).is_empty());
        assert!(
            common_paint(&[level(0.3, 1.0)], 0.1)[0]
                .step
                .abs()
                .max_element()
                < 1e-6
        );
    }
}
