//! Robust statistics that several stages share.

mod design_effect;

pub use design_effect::{Mean, design_effect};

use glam::Vec3;
use std::collections::BTreeMap;

/// What turns a median absolute deviation into a Gaussian's standard deviation. Derived: 1/Φ⁻¹(3/4).
pub const MAD_SCALE: f32 = 1.4826;

/// Standard errors from which a difference is none of chance's making. Derived: a Gaussian goes beyond three once in
/// 370 times.
pub const SURELY: f32 = 3.0;

/// Standard errors within which nearly all of chance stays; a residual beyond them counts less. Derived: a Gaussian
/// is within two in 95 of 100 cases.
pub const USUALLY: f32 = 2.0;

/// Samples from which a statistic speaks for itself. Derived: the spread of so many is known to 1/√(2 · 50), a tenth
/// of itself.
pub const ENOUGH: usize = 50;

/// Samples of which a statistic is asked where there are more. Derived: the median of so many is known to √(π/2) / 64,
/// 2 % of their spread.
pub const MANY: usize = 4096;

/// The step at which a list of `length` is walked so that no more than [`MANY`] are asked; at least 1.
#[must_use]
pub const fn step_over_many(length: usize) -> usize {
    length / MANY + 1
}

/// Chance that a datum is wrong as a whole: a label, a piece of evidence. Cited: one to ten in a hundred of routine
/// data (Hampel et al. 1986, §1.2c).
pub const GROSS_ERRORS: f64 = 0.05;

/// Rounds of an alternation that has settled by then: assignment and mean (Lloyd 1982), expectation and maximisation, mean shift.
/// The share of a pattern moves by less than a percent of itself after ten.
pub const ROUNDS: usize = 15;

/// Index of the weighted median among (value, weight) pairs: the smallest value at which the
/// weights up to it reach half of their sum. `None` for an empty list. Weights are ≥ 0; if all are
/// 0, the smallest value is the median. NaN values count as largest.
#[must_use]
pub fn weighted_median(pairs: &[(f32, f32)]) -> Option<usize> {
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|&a, &b| pairs[a].0.total_cmp(&pairs[b].0));
    let half = 0.5 * pairs.iter().map(|p| f64::from(p.1)).sum::<f64>();
    let mut below = 0.0;
    order
        .iter()
        .copied()
        .find(|&i| {
            below += f64::from(pairs[i].1);
            below >= half
        })
        .or(order.last().copied())
}

/// The middle one of some values in order (the upper of two); `None` for an empty list. NaN counts
/// as largest.
#[must_use]
pub fn median(mut values: Vec<f32>) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The median of some colours, channel by channel; `None` without any.
#[must_use]
pub fn median_colour(values: &[Vec3]) -> Option<Vec3> {
    let channel = |c: usize| median(values.iter().map(|v| v[c]).collect());
    Some(Vec3::new(channel(0)?, channel(1)?, channel(2)?))
}

/// The median colour of each class.
#[must_use]
pub fn median_colours(values: impl IntoIterator<Item = (u16, Vec3)>) -> BTreeMap<u16, Vec3> {
    let mut members: BTreeMap<u16, Vec<Vec3>> = BTreeMap::new();
    for (class, colour) in values {
        members.entry(class).or_default().push(colour);
    }
    let median = |(class, all): (u16, Vec<Vec3>)| Some((class, median_colour(&all)?));
    members.into_iter().filter_map(median).collect()
}

/// Within this share of a mark a value has neither passed nor missed it. Derived: a standard error
/// estimated from a few dozen independent parts is itself uncertain by a tenth.
const DRAW: f64 = 0.1;

/// How far a positive value has passed a mark: 0 up to a tenth below it, 1 from a tenth above it,
/// smooth and steady between. Decisions blended by this weight move with their evidence instead of
/// hanging on its rounding; clear ones are what a comparison makes them. A mark of −∞ is passed by
/// everything but NaN.
#[must_use]
pub fn passing_weight(value: f64, mark: f64) -> f64 {
    if value.is_nan() || mark.is_nan() {
        return 0.0;
    }
    if mark <= 0.0 {
        return f64::from(u8::from(value > mark));
    }
    let t = ((value / mark - (1.0 - DRAW)) / (2.0 * DRAW)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A value that [`passing_weight`] gives no weight does not exceed this.
#[must_use]
pub fn least_passing(mark: f64) -> f64 {
    if mark > 0.0 {
        mark * (1.0 - DRAW)
    } else {
        mark
    }
}

/// The inverse Mills ratio φ(z)/Φ(z) of the standard normal distribution, φ its density and Φ its
/// distribution function: by the series of Φ about 0 or, in the lower tail, Laplace's continued
/// fraction (Abramowitz and Stegun 1964, 26.2.11 and 26.2.14). Positive; 0 for z → ∞, −z for z →
/// −∞.
#[must_use]
pub fn inverse_mills(z: f64) -> f64 {
    const TAIL: f64 = -3.0;
    if z < TAIL {
        // Φ/φ at z is 1/(x + 1/(x + 2/(x + …))), x = −z
        return (1..=60)
            .rev()
            .fold(-z, |below, k| -z + f64::from(k) / below);
    }
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    let (mut term, mut sum, mut k) = (z, z, 1.0);
    while term.abs() > 1e-17 * sum.abs() && k < 1e3 {
        k += 2.0;
        term *= z * z / k;
        sum += term;
    }
    // beyond 8 the rest of the distribution is below rounding
    let below = if z > 8.0 { 1.0 } else { 0.5 + density * sum };
    density / below
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clear_decisions_are_clear_and_close_ones_steady() {
        for mark in [0.05, 3.0] {
            assert_eq!(passing_weight(least_passing(mark), mark), 0.0);
            assert_eq!(passing_weight(1.11 * mark, mark), 1.0);
            assert!((passing_weight(mark, mark) - 0.5).abs() < 1e-9);
            let steps: Vec<f64> = (0..1000)
                .map(|i| passing_weight(mark * 0.002 * f64::from(i), mark))
                .collect();
            // steepest in the middle: 1.5 / 0.2 per relative change
            assert!(
                steps
                    .windows(2)
                    .all(|w| w[1] >= w[0] && w[1] - w[0] < 0.016)
            );
        }
        assert_eq!(passing_weight(-1.0, f64::NEG_INFINITY), 1.0);
        assert_eq!(passing_weight(f64::NAN, 0.05), 0.0);
        assert_eq!(passing_weight(-0.2, 0.05), 0.0);
    }

    #[test]
    fn median_is_the_middle_value() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![5.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(vec![5.0, f32::NAN, 3.0, 1.0]), Some(5.0));
    }

    #[test]
    fn median_splits_the_weight_in_halves() {
        assert_eq!(weighted_median(&[]), None);
        assert_eq!(weighted_median(&[(3.0, 1.0)]), Some(0));
        assert_eq!(
            weighted_median(&[(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]),
            Some(2)
        );
        // one heavy value decides; two equal halves give the smaller one
        assert_eq!(
            weighted_median(&[(3.0, 5.0), (1.0, 1.0), (2.0, 1.0)]),
            Some(0)
        );
        assert_eq!(weighted_median(&[(2.0, 1.0), (1.0, 1.0)]), Some(1));
        assert_eq!(weighted_median(&[(2.0, 0.0), (1.0, 0.0)]), Some(1));
        assert_eq!(
            weighted_median(&[(f32::NAN, 1.0), (1.0, 1.0), (0.0, 1.0)]),
            Some(1)
        );
        // against the definition, on values in no order
        let pairs: Vec<(f32, f32)> = (0..57)
            .map(|i| (((i * 37) % 57) as f32, ((i * 11) % 7) as f32))
            .collect();
        let m = pairs[weighted_median(&pairs).expect("not empty")].0;
        let total: f32 = pairs.iter().map(|p| p.1).sum();
        let below: f32 = pairs.iter().filter(|p| p.0 < m).map(|p| p.1).sum();
        let up_to: f32 = pairs.iter().filter(|p| p.0 <= m).map(|p| p.1).sum();
        assert!(below < 0.5 * total && up_to >= 0.5 * total);
    }

    /// Values of φ/Φ to ten digits, and the limits.
    #[test]
    fn inverse_mills_has_its_known_values() {
        for (z, ratio) in [
            (0.0, 0.797_884_560_8),
            (1.0, 0.287_599_970_9),
            (-1.0, 1.525_135_276_2),
            (-3.0, 3.283_098_655_7),
            (-5.0, 5.186_503_967_1),
            (3.0, 0.004_437_839_0),
        ] {
            assert!((inverse_mills(z) / ratio - 1.0).abs() < 1e-6, "{z}");
        }
        assert!((inverse_mills(-1e6) / 1e6 - 1.0).abs() < 1e-9);
        assert!(inverse_mills(40.0) < 1e-300);
        assert!((inverse_mills(-3.0 + 1e-9) - inverse_mills(-3.0 - 1e-9)).abs() < 1e-6);
    }
}
