//! Small networks on processors: perceptrons, encodings of positions, a hash grid, Adam.
//!
//! A batch is a matrix of `features × samples`. Sums run over samples in their order and over parts
//! of a batch in theirs, so that the number of threads does not change a bit.

mod adam;
mod encoding;
mod hash_grid;
mod learner;
mod mlp;

pub use adam::{Adam, AdamRule};
pub use encoding::{encode, encoded, encoded_size};
pub use hash_grid::HashGrid;
pub use learner::Learner;
pub use mlp::{Activation, Join, Mlp, Shape, Trace};

use crate::core::parallel::map_chunks;
use std::ops::Range;

/// Samples that run through a network together. Derived: 128 × 512 activations of four bytes stay
/// in a core's second cache.
pub const BLOCK: usize = 128;
/// Parts of a batch with a gradient of their own: more would be larger than the batch.
const PARTS: usize = 16;

/// Slope of an objective along its `gradient`, by a central difference over moves of length
/// `length`, beside the gradient's own: 1 if that is right. `moved` moves the parameters by a
/// multiple of the gradient and answers with the objective; they end where they were.
#[cfg(test)]
pub(crate) fn slope_along(gradient: &[f32], length: f32, mut moved: impl FnMut(f32) -> f64) -> f64 {
    let size: f32 = gradient.iter().map(|g| g * g).sum();
    let h = length / size.sqrt();
    let central = (moved(h) - moved(-2.0 * h)) / f64::from(2.0 * h);
    moved(h);
    central / f64::from(size)
}

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
