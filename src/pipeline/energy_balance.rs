//! Energy balance of rooms: light that neither the photographs nor the fit of clipped lights hold.
//!
//! What surfaces of a room receive, they have sent out themselves but for lamps and openings: with
//! all of those too dark (tone-mapped windows, lamps behind furniture that the mesh lacks) E is
//! about πL, and A = πL/E stands at one everywhere. That bound is a statement about the light. In
//! every part of a room whose brightest large surfaces reflect more than white paint does, the
//! irradiance is raised, channel by channel, until they are white paint (white patch: Land &
//! McCann 1971); what is darker is left alone. A texel that still exceeds the bound gets the mean
//! of what it may be below it. Only display-referred photographs, which cameras compress by place,
//! are judged so, and only where walls and ceilings at large stand at the bound. What then still
//! outshines any paint on a surface that faces down, where no sun falls, is a lamp that its camera
//! held below the ceiling of the file. Called by `solve` after the albedo, before the missing light.

use super::clipped_light::FoundLight;
use super::missing_light::scale_irradiance;
use super::room_levels::pool_room_levels;
use super::texel_radiance::texture_of;
use super::unclipped_lamps::find_unclipped_lamps;
use super::white_paint::{MOST, WHITE, WHITE_SPREAD};
use super::{Light, SolveOptions, Switch};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::inverse_mills;
use crate::inverse::AlbedoEstimate;
use crate::observed::Surface;
use crate::verdict::MissingLight;
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// Share of the seen surface at the bound from which the light is taken to be short. Derived: walls
/// and ceiling are two thirds of a room at least, and half of them must stand there; below it white
/// walls do whose irradiance is a few per cent low (measured: 28 % of staircase2, whose paint is
/// 0.89).
const AT_BOUND: f64 = 1.0 / 3.0;
const BOUND: f32 = 0.95;
/// Side of a part of a room seen from above, metres: parts are this far from their neighbours and
/// three as wide. Derived: light changes over distances of the rooms' height, cut by half.
const PART: f32 = 1.0;
/// Share of a part's surface that its brightest surfaces have. Derived: walls and ceiling are two
/// thirds to five sixths of a room; half of the lesser.
const BRIGHTEST: f32 = 0.3;

/// A part of a room: its room and place seen from above.
type Part = (u16, [i32; 2]);

/// What the energy balance adds.
pub(super) struct Balanced {
    /// Light that was missing.
    pub(super) missing: MissingLight,
    /// Standard error of each texel's albedo from the cast of its light being paint; that of its level
    /// is the missing light's.
    pub(super) cast_error: Vec<f32>,
    /// Lamps that the photographs hold below their ceiling.
    pub(super) lamps: Vec<FoundLight>,
}

/// Raises the irradiance where surfaces would reflect more than white paint; `None` where nothing
/// stands at the bound.
pub(super) fn balance_rooms(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    rooms: &[u16],
    options: &SolveOptions,
    progress: &Progress,
) -> Option<Balanced> {
    if options.clipped_light == Switch::Off || !surface.encoded {
        return None;
    }
    let texels = Reflecting::of(surface, light, albedo, rooms);
    let bound = texels.share(|a| a.max_element() >= BOUND);
    if bound < AT_BOUND {
        return None;
    }
    let short = texels.shortage();
    let factors: Vec<Vec3> = (0..albedo.value.len())
        .into_par_iter()
        .map(|i| factor_at(&short, rooms[i], texels.plan(i)))
        .collect();
    let missing = texels.missing(&factors);
    scale_irradiance(
        surface,
        light,
        albedo,
        &texture_of(&surface.texels, &factors),
    );
    let expected: Vec<Vec3> = (0..factors.len())
        .into_par_iter()
        .map(|i| Held::below_bound(albedo, i, factors[i]).albedo)
        .collect();
    let levels = pool_room_levels(surface, light, albedo, &expected, rooms);
    let lamps = find_unclipped_lamps(surface, light, albedo);
    let mut cast_errors = vec![0.0; factors.len()];
    for (i, factor) in factors.iter().enumerate() {
        if albedo.error[i].is_finite() {
            let held = Held::below_bound(albedo, i, *factor);
            albedo.value[i] = held.albedo;
            albedo.error[i] *= held.error_left;
            cast_errors[i] = cast_error(held.albedo, *factor);
        }
    }
    progress.note(format!(
        "energy balance: {:.0} % of the surface would reflect more than any paint; white paint in \
         every part of a room takes {:.0} ± {:.0} % more light than the photographs hold",
        100.0 * bound,
        100.0 * missing.share / (1.0 - missing.share),
        100.0 * missing.standard_error / (1.0 - missing.share).powi(2),
    ));
    progress.note(format!(
        "one paint in several rooms: their levels move by up to {:.0} %; {} lamps outshine any paint",
        100.0 * levels.largest.exp_m1(),
        lamps.len()
    ));
    Some(Balanced {
        lamps,
        missing,
        cast_error: cast_errors,
    })
}

/// Error of the luminance of an albedo that was settled by `factor`, for the cast of the light that
/// this implies may be paint instead.
///
/// A room all of whose surfaces have one colour looks the same under coloured light. Made white, its
/// albedo is ρ_c; with the colour taken for paint whose brightest channel is white paint's, it is
/// ρ_c f_c/max f. Neither is likelier, so the expected squared error of the first is half the
/// squared distance of the two.
fn cast_error(albedo: Vec3, factor: Vec3) -> f32 {
    let paint = albedo * factor / factor.max_element();
    (luminance(albedo) - luminance(paint)) * std::f32::consts::FRAC_1_SQRT_2
}

/// A texel's albedo as far as paint allows.
struct Held {
    albedo: Vec3,
    /// What of its error is left.
    error_left: f32,
}

impl Held {
    /// That of texel `i`, whose light was raised by `factor`.
    fn below_bound(albedo: &AlbedoEstimate, i: usize, factor: Vec3) -> Self {
        let value = albedo.value[i];
        let raised = f32::from(u8::from(luminance(factor) > 1.0));
        let error = albedo.error[i].hypot(raised * WHITE_SPREAD * luminance(value));
        if !error.is_finite() {
            return Self {
                albedo: value,
                error_left: 1.0,
            };
        }
        let below = value.to_array().map(|a| below_bound(a, error));
        let deviation = below.iter().map(|b| b.deviation).fold(0.0, f32::max);
        Self {
            albedo: Vec3::from(below.map(|b| b.mean)),
            error_left: deviation / error.max(f32::MIN_POSITIVE),
        }
    }
}

/// Mean and standard deviation.
#[derive(Clone, Copy)]
struct Moments {
    mean: f32,
    deviation: f32,
}

/// An albedo measured as `value` ± `error` that no paint lets exceed [`BOUND`]: mean of the truncated
/// normal distribution v − s λ(z), variance s² (1 − λ (λ + z)), z = (bound − v)/s, λ = φ/Φ (Johnson,
/// Kotz and Balakrishnan 1994, ch. 13).
fn below_bound(value: f32, error: f32) -> Moments {
    let (v, s) = (f64::from(value), f64::from(error.max(1e-4)));
    let z = (f64::from(BOUND) - v) / s;
    let mills = inverse_mills(z);
    let variance = s * s * (1.0 - mills * (mills + z)).max(0.0);
    Moments {
        mean: (v - s * mills).max(0.0) as f32,
        deviation: variance.sqrt() as f32,
    }
}

/// What is known of the surfaces that reflect.
struct Reflecting<'a> {
    surface: &'a Surface<'a>,
    albedo: &'a [Vec3],
    rooms: &'a [u16],
    /// Area of each texel; 0 where it does not count.
    area: Vec<f32>,
}

impl<'a> Reflecting<'a> {
    fn of(
        surface: &'a Surface<'a>,
        light: &Light,
        albedo: &'a AlbedoEstimate,
        rooms: &'a [u16],
    ) -> Self {
        let counts = |i: usize, t: usize| {
            albedo.error[i].is_finite()
                && !light.emissive[t]
                && surface.fusion.views[i] > 0
                && surface.texels.interior[i]
        };
        let area = (0..albedo.value.len())
            .map(|i| {
                let t = surface.texels.point[i].triangle as usize;
                if counts(i, t) {
                    surface.texels.texel_area(&surface.scene.mesh, t)
                } else {
                    0.0
                }
            })
            .collect();
        Self {
            surface,
            albedo: &albedo.value,
            rooms,
            area,
        }
    }

    /// Texel `i` seen from above, in parts.
    fn plan(&self, i: usize) -> Vec2 {
        let p = self.surface.texels.position(&self.surface.scene.mesh, i);
        Vec2::new(p.x, p.z) / PART
    }

    /// Share of the surface for which `holds`.
    fn share(&self, holds: impl Fn(Vec3) -> bool) -> f64 {
        let (mut part, mut whole) = (0.0f64, 0.0f64);
        for (a, area) in self.albedo.iter().zip(&self.area) {
            part += if holds(*a) { f64::from(*area) } else { 0.0 };
            whole += f64::from(*area);
        }
        part / whole.max(f64::MIN_POSITIVE)
    }

    /// Factor by which the light is short in every part, per channel.
    fn shortage(&self) -> BTreeMap<Part, Vec3> {
        let mut members: BTreeMap<Part, Vec<usize>> = BTreeMap::new();
        for i in (0..self.area.len()).filter(|&i| self.area[i] > 0.0) {
            let key = (self.rooms[i], self.plan(i).floor().as_ivec2().to_array());
            members.entry(key).or_default().push(i);
        }
        let parts: Vec<Part> = members.keys().copied().collect();
        parts
            .into_par_iter()
            .map(|part| {
                let near: Vec<usize> = neighbours(part)
                    .filter_map(|p| members.get(&p))
                    .flatten()
                    .copied()
                    .collect();
                let brightest = |c: usize| {
                    let mut values: Vec<(f32, f32)> = near
                        .iter()
                        .map(|&i| (self.albedo[i][c], self.area[i]))
                        .collect();
                    upper_quantile(&mut values, BRIGHTEST)
                };
                let short = Vec3::new(brightest(0), brightest(1), brightest(2)) / WHITE;
                (part, short.clamp(Vec3::ONE, Vec3::splat(MOST)))
            })
            .collect::<Vec<_>>()
            .into_iter()
            .collect()
    }

    /// Share of the light that `factors` add, over the surface.
    fn missing(&self, factors: &[Vec3]) -> MissingLight {
        let (mut known, mut whole) = (0.0f64, 0.0f64);
        for (i, area) in self.area.iter().enumerate() {
            // light by light: what surfaces send out over what they reflect of it
            let before = f64::from(*area);
            known += before;
            whole += before * f64::from(luminance(factors[i]));
        }
        let rest = known / whole.max(f64::MIN_POSITIVE);
        MissingLight {
            share: 1.0 - rest,
            standard_error: rest * f64::from(WHITE_SPREAD),
        }
    }
}

/// A part and those that touch it in its room.
fn neighbours((room, [x, z]): Part) -> impl Iterator<Item = Part> {
    (-1..=1).flat_map(move |dx| (-1..=1).map(move |dz| (room, [x + dx, z + dz])))
}

/// The factor at a place of a room, between the middles of its parts; one where none is near.
fn factor_at(short: &BTreeMap<Part, Vec3>, room: u16, plan: Vec2) -> Vec3 {
    let (low, within) = ((plan - 0.5).floor(), (plan - 0.5) - (plan - 0.5).floor());
    let (mut sum, mut total) = (Vec3::ZERO, 0.0f32);
    for corner in 0..4 {
        let step = Vec2::new((corner % 2) as f32, (corner / 2) as f32);
        let weight = (Vec2::ONE - (step - within).abs()).max(Vec2::splat(1e-3));
        let weight = weight.x * weight.y;
        if let Some(factor) = short.get(&(room, (low + step).as_ivec2().to_array())) {
            sum += *factor * weight;
            total += weight;
        }
    }
    if total > 0.0 { sum / total } else { Vec3::ONE }
}

/// The value that a share `upper` of the weights in (value, weight) lies above.
fn upper_quantile(values: &mut [(f32, f32)], upper: f32) -> f32 {
    values.sort_by(|a, b| b.0.total_cmp(&a.0));
    let wanted = upper * values.iter().map(|v| v.1).sum::<f32>();
    let mut sum = 0.0;
    for (value, weight) in values.iter() {
        sum += weight;
        if sum >= wanted {
            return *value;
        }
    }
    values.last().map_or(0.0, |v| v.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_share_is_by_area() {
        let mut values = vec![(0.2, 5.0), (1.4, 1.0), (0.9, 4.0)];
        assert_eq!(upper_quantile(&mut values, 0.1), 1.4);
        assert_eq!(upper_quantile(&mut values, 0.3), 0.9);
        assert_eq!(upper_quantile(&mut values, 0.9), 0.2);
        assert_eq!(upper_quantile(&mut [], 0.3), 0.0);
    }

    #[test]
    fn what_exceeds_any_paint_lies_below_the_bound_and_the_rest_stays() {
        let dark = below_bound(0.3, 0.05);
        assert!((dark.mean - 0.3).abs() < 1e-4 && (dark.deviation - 0.05).abs() < 1e-4);
        for (value, error) in [(1.0, 0.08), (1.4, 0.1), (0.95, 0.2), (3.0, 0.01)] {
            let b = below_bound(value, error);
            assert!(
                b.mean < BOUND && b.mean > 0.0 && b.deviation <= error,
                "{value} ± {error}: {} ± {}",
                b.mean,
                b.deviation
            );
        }
        // half a normal distribution: its mean is √(2/π) of its deviation from its end
        let half = below_bound(BOUND, 0.1);
        assert!((BOUND - half.mean - 0.1 * 0.797_884_6).abs() < 1e-5);
    }

    /// A room of one strong colour is made white, and the truth lies within two of its stated errors;
    /// where the light lacks the same in all channels nothing is added.
    #[test]
    fn one_strong_colour_may_be_paint_or_light() {
        for truth in [Vec3::new(0.75, 0.4, 0.2), Vec3::new(0.2, 0.35, 0.7)] {
            let seen = truth * 1.3; // light that is short by 1.3
            let factor = (seen / WHITE).max(Vec3::splat(0.2));
            let settled = seen / factor;
            let off = luminance(settled) - luminance(truth);
            let error = cast_error(settled, factor);
            assert!(
                off > 3.0 * WHITE_SPREAD * luminance(settled) && off < 2.0 * error,
                "{off} {error}"
            );
        }
        assert!(cast_error(Vec3::splat(WHITE), Vec3::splat(2.5)).abs() < 1e-6);
    }

    /// Between the middles of parts the factor is in between, and another room has no say.
    #[test]
    fn factors_change_smoothly_within_a_room() {
        let short = BTreeMap::from([
            ((1, [0, 0]), Vec3::splat(1.0)),
            ((1, [1, 0]), Vec3::splat(3.0)),
            ((2, [0, 1]), Vec3::splat(6.0)),
        ]);
        let at = |x: f32, z: f32| factor_at(&short, 1, Vec2::new(x, z)).x;
        assert!((at(0.5, 0.5) - 1.0).abs() < 0.02 && (at(1.5, 0.5) - 3.0).abs() < 0.02);
        assert!((at(1.0, 0.5) - 2.0).abs() < 0.02, "{}", at(1.0, 0.5));
        assert!((at(0.5, 0.9) - 1.0).abs() < 0.02, "{}", at(0.5, 0.9));
        assert_eq!(factor_at(&short, 3, Vec2::splat(0.5)), Vec3::ONE);
    }
}
