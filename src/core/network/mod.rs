//! Small networks on processors: perceptrons, encodings of positions, a hash grid, Adam.
//!
//! A batch is a matrix of `features × samples`. Sums run over samples in their order and over parts
//! of a batch in theirs, so that the number of threads does not change a bit.

mod adam;
mod encoding;
mod hash_grid;
mod mlp;

pub use adam::{Adam, AdamRule};
pub use encoding::{encode, encoded_size};
pub use hash_grid::HashGrid;
pub use mlp::{Activation, Join, Mlp, Shape, Trace};

use crate::core::parallel::map_chunks;
use std::ops::Range;

/// Samples that run through a network together. Derived: 128 × 512 activations of four bytes stay
/// in a core's second cache.
pub const BLOCK: usize = 128;
/// Parts of a batch with a gradient of their own: more would be larger than the batch.
const PARTS: usize = 16;

/// What [`sum_gradient`] gathers.
pub struct Summed<T> {
    /// Sum over all samples.
    pub gradient: Vec<f32>,
    /// What the blocks answered, in their order.
    pub values: Vec<T>,
}

/// Sums the gradient of `parameters` numbers over `samples`: `add` sees blocks of at most
/// [`BLOCK`] samples.
#[must_use]
pub fn sum_gradient<T: Send>(
    parameters: usize,
    samples: usize,
    add: impl Fn(Range<usize>, &mut [f32]) -> Vec<T> + Sync + Send,
) -> Summed<T> {
    let part = samples.div_ceil(PARTS).max(BLOCK);
    let parts = map_chunks(samples, part, |range| {
        let mut of_part = Summed {
            gradient: vec![0.0; parameters],
            values: Vec::new(),
        };
        for start in range.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(range.end);
            of_part.values.extend(add(block, &mut of_part.gradient));
        }
        of_part
    });
    let mut sum = Summed {
        gradient: vec![0.0; parameters],
        values: Vec::with_capacity(samples),
    };
    for part in parts {
        let pairs = sum.gradient.iter_mut().zip(&part.gradient);
        pairs.for_each(|(s, g)| *s += g);
        sum.values.extend(part.values);
    }
    sum
}
