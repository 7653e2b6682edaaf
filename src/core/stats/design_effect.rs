//! How much less neighbouring values tell than independent ones.

use glam::Vec3;
use std::collections::BTreeMap;

/// Blocks per diagonal of the bounding box, coarse to fine. Derived: sums over coarser blocks are
/// too few for a variance, and two powers of two around any correlation length see most of it.
const BLOCKS: [f32; 5] = [4.0, 8.0, 16.0, 32.0, 64.0];

/// The design effect of values of mean zero at places in space: the variance of their sum over that
/// of independent values, Σ over blocks (Σ v)² / Σ v², the largest over sizes of block (Kish,
/// *Survey Sampling*, 1965, §8.2). At least 1; 1 where fewer than two blocks hold values. The
/// sum over all values counts as known (it is zero about their mean).
#[must_use]
pub fn design_effect(places: &[Vec3], values: &[f64]) -> f64 {
    let alone: f64 = values.iter().map(|v| v * v).sum();
    if alone <= 0.0 || !alone.is_finite() {
        return 1.0;
    }
    let (low, high) = places
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
            (low.min(*p), high.max(*p))
        });
    let diagonal = (high - low).length();
    if diagonal <= 0.0 || !diagonal.is_finite() {
        return 1.0;
    }
    let mut sums: BTreeMap<[i16; 3], f64> = BTreeMap::new();
    BLOCKS
        .iter()
        .map(|blocks| {
            sums.clear();
            for (p, v) in places.iter().zip(values) {
                let cell = ((*p - low) * (blocks / diagonal)).floor().to_array();
                *sums.entry(cell.map(|x| x as i16)).or_default() += v;
            }
            let together: f64 = sums.values().map(|s| s * s).sum();
            let free = (sums.len() as f64 - 1.0) / sums.len() as f64;
            if free > 0.0 {
                together / (free * alone)
            } else {
                1.0
            }
        })
        .fold(1.0, f64::max)
}

/// A mean over surface points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Its standard error; neighbours err together ([`design_effect`]).
    pub error: f64,
}

impl Mean {
    /// That of `values` at `places`, as many; 0 without any.
    #[must_use]
    pub fn over(places: &[Vec3], values: &[f64]) -> Self {
        let n = values.len().max(1) as f64;
        let value = values.iter().sum::<f64>() / n;
        let off: Vec<f64> = values.iter().map(|v| v - value).collect();
        let alone = off.iter().map(|o| o * o).sum::<f64>() / n / n;
        Self {
            value,
            error: (alone * design_effect(places, &off)).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    /// Values on a square that are one draw per tile of `side` places: the mean of n places errs as
    /// that of n / side² independent ones.
    fn tiled(side: usize) -> f64 {
        let draw = |x: usize, y: usize| {
            let mut rng = KeyedRng::new(3, (y / side * 1000 + x / side) as u64);
            f64::from((0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0)
        };
        let at = || (0..128usize).flat_map(|y| (0..128usize).map(move |x| (x, y)));
        let places: Vec<Vec3> = at()
            .map(|(x, y)| Vec3::new(x as f32, y as f32, 0.0))
            .collect();
        let values: Vec<f64> = at().map(|(x, y)| draw(x, y)).collect();
        design_effect(&places, &values)
    }

    #[test]
    fn values_that_go_together_count_once() {
        let independent = tiled(1);
        assert!((1.0..1.8).contains(&independent), "{independent}");
        for side in [4, 8] {
            let (found, truth) = (tiled(side), (side * side) as f64);
            assert!((0.6..1.7).contains(&(found / truth)), "{side}: {found}");
        }
    }

    #[test]
    fn of_nothing_follows_nothing() {
        assert_eq!(design_effect(&[], &[]), 1.0);
        assert_eq!(design_effect(&[Vec3::X; 3], &[1.0, -2.0, 1.0]), 1.0);
        assert_eq!(design_effect(&[Vec3::X, Vec3::Y], &[0.0, 0.0]), 1.0);
        assert_eq!(design_effect(&[Vec3::X, Vec3::Y], &[f64::NAN, 0.0]), 1.0);
    }
}
