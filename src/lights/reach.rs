//! What was learned of the visibility of lamps, cell by cell.

use super::light_sampler::DEFENSIVE;
use std::collections::BTreeMap;

/// Per cell of space and lamp: how much of the expected irradiance arrives; in a dense grid around
/// the cells that hold receivers.
#[derive(Default)]
pub(super) struct ReachTable {
    base: [i32; 3],
    size: [usize; 3],
    /// One more than the place in `tables`; 0 where nothing was learned.
    index: Vec<u32>,
    tables: Vec<Vec<f32>>,
    /// What holds where nothing was learned.
    everywhere: Vec<f32>,
}

/// What a cell's receivers found of a lamp.
#[derive(Clone, Copy, Default)]
pub(super) struct Found {
    /// Irradiance that arrives.
    pub arrives: f32,
    /// Irradiance that was expected.
    pub expected: f32,
}

impl ReachTable {
    /// Nothing known of any of `lamps`: all of the expected irradiance arrives.
    pub(super) fn unknown(lamps: usize) -> Self {
        Self {
            everywhere: vec![1.0; lamps],
            ..Self::default()
        }
    }

    /// Takes what the cells found, lamp by lamp. A few probes may miss a lamp that the cell does
    /// see: its neighbours' findings count too. Of equal light, what arrives in a few places only
    /// varies more: the least variance has the root of the share that arrives.
    pub(super) fn learn(&mut self, probed: &BTreeMap<[i32; 3], Vec<Found>>) {
        let reach = |f: &Found| {
            if f.expected > 0.0 {
                DEFENSIVE + (f.arrives / f.expected).sqrt()
            } else {
                1.0
            }
        };
        let learned = probed.iter().map(|(cell, own)| {
            let mut sum = own.clone();
            // (all of them count as much as the cell itself)
            let each = (neighbours(*cell).count() as f32).recip();
            for near in neighbours(*cell).filter_map(|c| probed.get(&c)) {
                for (s, n) in sum.iter_mut().zip(near) {
                    s.arrives += each * n.arrives;
                    s.expected += each * n.expected;
                }
            }
            (*cell, sum.iter().map(reach).collect())
        });
        self.set(learned.collect());
    }

    fn set(&mut self, learned: Vec<([i32; 3], Vec<f32>)>) {
        let bound = |pick: fn(i32, i32) -> i32, a: usize| {
            learned.iter().map(|(c, _)| c[a]).reduce(pick).unwrap_or(0)
        };
        self.base = std::array::from_fn(|a| bound(i32::min, a));
        // receivers lie in the scene's box, which has about CELLS_LONGEST cells a side
        self.size = std::array::from_fn(|a| {
            (bound(i32::max, a).saturating_sub(self.base[a]) as usize + 1).min(256)
        });
        self.index = vec![0; self.size.iter().product()];
        for (cell, table) in learned {
            if let Some(i) = self.slot(cell) {
                self.tables.push(table);
                self.index[i] = self.tables.len() as u32;
            }
        }
    }

    fn slot(&self, cell: [i32; 3]) -> Option<usize> {
        let at: [usize; 3] = std::array::from_fn(|a| {
            i64::from(cell[a]).wrapping_sub(i64::from(self.base[a])) as usize
        });
        (0..3)
            .all(|a| at[a] < self.size[a])
            .then(|| (at[2] * self.size[1] + at[1]) * self.size[0] + at[0])
    }

    /// Per lamp: the share that arrives in a cell.
    pub(super) fn at(&self, cell: [i32; 3]) -> &[f32] {
        let place = self
            .slot(cell)
            .and_then(|s| self.index.get(s))
            .map_or(0, |i| *i as usize);
        self.tables
            .get(place.wrapping_sub(1))
            .unwrap_or(&self.everywhere)
    }
}

/// The 26 cells around one.
fn neighbours(cell: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (0..27).filter(|i| *i != 13).map(move |i| {
        [
            cell[0] + i % 3 - 1,
            cell[1] + i / 3 % 3 - 1,
            cell[2] + i / 9 - 1,
        ]
    })
}
