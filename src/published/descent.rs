//! The loop of all published optimisations: epochs over shuffled views, a visit of one view at a
//! time.

use crate::core::progress::Progress;
use crate::core::sampling::{KeyedRng, hash_u64};

/// What is done at a view.
pub trait Descent {
    /// Before the first view of an epoch.
    fn begin_epoch(&mut self, _epoch: u32) {}
    /// One visit of a view; `key` decides its randomness.
    fn visit(&mut self, view: usize, key: u64);
}

/// Visits all of `views` in each of `epochs`, in an order that `key` decides.
pub fn descend(
    descent: &mut dyn Descent,
    epochs: u32,
    views: usize,
    key: impl Fn(u32) -> u64,
    progress: &Progress,
) {
    let mut order: Vec<usize> = (0..views).collect();
    for epoch in 0..epochs {
        let key = key(epoch);
        let mut rng = KeyedRng::new(key, 0);
        for i in (1..views).rev() {
            order.swap(i, rng.below(i + 1));
        }
        descent.begin_epoch(epoch);
        for &v in &order {
            descent.visit(v, hash_u64(key, v as u64 + 1));
            progress.advance(1);
        }
    }
}
