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

/// Sums the gradient of `parameters` numbers over `samples`: `add` sees blocks of at most
/// [`BLOCK`] samples.
#[must_use]
pub fn sum_gradient(
    parameters: usize,
    samples: usize,
    add: impl Fn(Range<usize>, &mut [f32]) + Sync + Send,
) -> Vec<f32> {
    let part = samples.div_ceil(PARTS).max(BLOCK);
    let parts = map_chunks(samples, part, |range| {
        let mut gradient = vec![0.0; parameters];
        for start in range.clone().step_by(BLOCK) {
            add(start..(start + BLOCK).min(range.end), &mut gradient);
        }
        gradient
    });
    let mut parts = parts.into_iter();
    let mut sum = parts.next().unwrap_or_else(|| vec![0.0; parameters]);
    for part in parts {
        sum.iter_mut().zip(&part).for_each(|(s, g)| *s += g);
    }
    sum
}
