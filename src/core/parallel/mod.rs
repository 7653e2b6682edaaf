//! Deterministic parallel loops: fixed chunks, results folded in order, so that the number of
//! threads never changes a bit of the answer.
//!
//! Every parallel loop of the program goes through [`prelude`], which is rayon's with one thing
//! added: a run on one thread can be recorded as a [`tape`] of all pieces of work, from which
//! `unbake bench scaling` works out what more threads would give.

mod marked;
pub mod tape;

/// Parallel iterators: use this where `rayon::prelude` would be.
pub mod prelude {
    pub use super::marked::{
        IntoParallelIterator, IntoParallelRefIterator, IntoParallelRefMutIterator, ParallelSlices,
        ParallelSlicesMut,
    };
    pub use rayon::iter::{IndexedParallelIterator, ParallelExtend, ParallelIterator};
}
pub use marked::join;

use prelude::*;

/// Elements per chunk of a deterministic reduction: a constant of the algorithm, not of the
/// machine.
pub const CHUNK: usize = 4096;

/// Maps fixed-size index ranges `[begin, end)` covering `0..len` in parallel and returns the
/// results in order.
pub fn map_chunks<T: Send>(
    len: usize,
    chunk: usize,
    f: impl Fn(std::ops::Range<usize>) -> T + Sync + Send,
) -> Vec<T> {
    let chunk = chunk.max(1);
    // every chunk may go to another thread: longer runs would leave threads idle at the end
    (0..len.div_ceil(chunk))
        .into_par_iter()
        .with_max_len(1)
        .map(|i| f(i * chunk..((i + 1) * chunk).min(len)))
        .collect()
}

/// Sums `f(i)` over `0..len` in f64 with the same bits for any number of threads.
pub fn sum_f64(len: usize, f: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    map_chunks(len, CHUNK, |r| r.map(&f).sum::<f64>())
        .into_iter()
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sum_has_the_same_bits_for_any_thread_count() {
        let run = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool")
                .install(|| sum_f64(100_003, |i| (i as f64).sin() * 1e-3).to_bits())
        };
        assert_eq!(run(1), run(3));
        assert_eq!(run(1), run(7));
    }

    #[test]
    fn chunks_cover_the_range_once() {
        let parts = map_chunks(10, 4, |r| (r.start, r.end));
        assert_eq!(parts, vec![(0, 4), (4, 8), (8, 10)]);
        assert!(map_chunks(0, 4, |r| r.len()).is_empty());
    }
}
