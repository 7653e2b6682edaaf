//! The multiresolution hash grid (Müller et al. 2022, Sec. 3): on every level the features of a
//! cell's eight corners, mixed trilinearly; corners of fine levels share the entries of a table.

use crate::core::parallel::prelude::*;
use crate::core::sampling::KeyedRng;
use glam::{IVec3, Vec3};

/// Features of a corner (cited: Müller et al., table 1).
const FEATURES: usize = 2;
/// Factors of the spatial hash (cited: Müller et al., eq. 4).
const PRIMES: [u32; 3] = [1, 2_654_435_761, 805_459_861];
/// First features are uniform within ± this (cited: Müller et al., Sec. 4).
const FIRST: f32 = 1e-4;

struct Level {
    /// Cells along an axis.
    side: u32,
    /// Entries of the table.
    entries: usize,
    /// Its first number in [`HashGrid::parameters`].
    start: usize,
}

/// A trainable encoding of positions in the unit cube.
pub struct HashGrid {
    levels: Vec<Level>,
    parameters: Vec<f32>,
}

/// A corner of a cell and its weight.
#[derive(Clone, Copy)]
struct Corner {
    /// First of its numbers in [`HashGrid::parameters`].
    at: usize,
    weight: f32,
}

impl Level {
    fn corners(&self, p: Vec3) -> [Corner; 8] {
        let at = p.clamp(Vec3::ZERO, Vec3::ONE) * self.side as f32;
        let cell = at.floor().min(Vec3::splat((self.side - 1) as f32));
        let f = at - cell;
        let cell: IVec3 = cell.as_ivec3();
        std::array::from_fn(|c| {
            let far = [c & 1, c >> 1 & 1, c >> 2];
            let weight = (0..3)
                .map(|k| if far[k] == 1 { f[k] } else { 1.0 - f[k] })
                .product();
            let place = [0, 1, 2].map(|k| cell[k] as u32 + far[k] as u32);
            let side = self.side as usize + 1;
            let entry = if side * side * side <= self.entries {
                place[0] as usize + side * (place[1] as usize + side * place[2] as usize)
            } else {
                let mixed = (0..3).fold(0, |h, k| h ^ place[k].wrapping_mul(PRIMES[k]));
                mixed as usize % self.entries
            };
            Corner {
                at: self.start + FEATURES * entry,
                weight,
            }
        })
    }
}

impl HashGrid {
    /// `levels` grids from `coarse` to `fine` cells along an axis, in geometric progression, with
    /// at most `entries` entries each.
    #[must_use]
    pub fn new(levels: usize, coarse: u32, fine: u32, entries: usize, seed: u64) -> Self {
        let growth = (f64::from(fine) / f64::from(coarse)).ln() / (levels.max(2) - 1) as f64;
        let mut start = 0;
        let levels: Vec<Level> = (0..levels)
            .map(|l| {
                let side = (f64::from(coarse) * (growth * l as f64).exp()).round() as u32;
                let corners = (side as usize + 1).pow(3);
                let level = Level {
                    side,
                    entries: corners.min(entries),
                    start,
                };
                start += FEATURES * level.entries;
                level
            })
            .collect();
        let mut rng = KeyedRng::new(seed, 0);
        let parameters = (0..start)
            .map(|_| FIRST * (2.0 * rng.next_f32() - 1.0))
            .collect();
        Self { levels, parameters }
    }

    /// Numbers of an encoded position.
    #[must_use]
    pub fn outputs(&self) -> usize {
        FEATURES * self.levels.len()
    }

    /// All features.
    #[must_use]
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// The same, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Writes the features at `p` in the unit cube (clamped): [`Self::outputs`] numbers.
    pub fn encode(&self, p: Vec3, out: &mut [f32]) {
        for (level, out) in self.levels.iter().zip(out.chunks_exact_mut(FEATURES)) {
            out.fill(0.0);
            for corner in level.corners(p) {
                for (k, o) in out.iter_mut().enumerate() {
                    *o += corner.weight * self.parameters[corner.at + k];
                }
            }
        }
    }

    /// Adds to `gradient` the transpose of [`Self::encode`]: `slopes` has [`Self::outputs`] numbers
    /// for each of `points`.
    pub fn backward(&self, points: &[Vec3], slopes: &[f32], gradient: &mut [f32]) {
        let width = self.outputs();
        let mut tables = Vec::with_capacity(self.levels.len());
        let mut rest = gradient;
        for level in &self.levels {
            let (table, after) = rest.split_at_mut(FEATURES * level.entries);
            tables.push(table);
            rest = after;
        }
        // level by level, so that every entry's sum has its order
        tables
            .into_par_iter()
            .zip(self.levels.par_iter())
            .enumerate()
            .for_each(|(l, (table, level))| {
                for (p, slopes) in points.iter().zip(slopes.chunks_exact(width)) {
                    for corner in level.corners(*p) {
                        for k in 0..FEATURES {
                            table[corner.at - level.start + k] +=
                                corner.weight * slopes[FEATURES * l + k];
                        }
                    }
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(n: usize) -> Vec<Vec3> {
        let mut rng = KeyedRng::new(2, 2);
        let mut point = || Vec3::from_array(std::array::from_fn(|_| rng.next_f32()));
        (0..n).map(|_| point()).collect()
    }

    #[test]
    fn linear_features_are_met_between_corners() {
        let mut grid = HashGrid::new(2, 4, 8, 1 << 10, 1);
        for level in 0..2 {
            let (start, side) = (grid.levels[level].start, grid.levels[level].side);
            let corners = (side as usize + 1).pow(3);
            assert_eq!(
                grid.levels[level].entries, corners,
                "no corner shares an entry"
            );
            for entry in 0..corners {
                let x = entry % (side as usize + 1);
                grid.parameters[start + FEATURES * entry] = x as f32 / side as f32;
            }
        }
        let mut out = vec![0.0; grid.outputs()];
        for p in points(50) {
            grid.encode(p, &mut out);
            assert!((out[0] - p.x).abs() < 1e-6 && (out[2] - p.x).abs() < 1e-6);
        }
    }

    /// ⟨encode(θ), g⟩ = ⟨θ, backward(g)⟩, also where corners share entries.
    #[test]
    fn the_gradient_is_the_transpose_of_the_encoding() {
        let grid = HashGrid::new(4, 4, 64, 1 << 9, 3);
        let points = points(200);
        let mut rng = KeyedRng::new(5, 5);
        let slopes: Vec<f32> = (0..points.len() * grid.outputs())
            .map(|_| rng.next_f32() - 0.5)
            .collect();
        let mut out = vec![0.0; grid.outputs()];
        let mut forward = 0.0f64;
        for (p, g) in points.iter().zip(slopes.chunks(grid.outputs())) {
            grid.encode(*p, &mut out);
            forward += out
                .iter()
                .zip(g)
                .map(|(o, g)| f64::from(o * g))
                .sum::<f64>();
        }
        let mut gradient = vec![0.0; grid.parameters().len()];
        grid.backward(&points, &slopes, &mut gradient);
        let pairs = gradient.iter().zip(grid.parameters());
        let backward: f64 = pairs.map(|(g, p)| f64::from(g * p)).sum();
        assert!(forward.abs() > 1e-6 && (forward / backward - 1.0).abs() < 1e-4);
    }
}
