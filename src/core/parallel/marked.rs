//! Parallel iterators that mark their pieces on the [tape](super::tape) while one is recorded.
//!
//! The adaptor stands at the source of a loop and hands out the very iterators of rayon, so that
//! nothing is lost where no tape runs: a flag is looked at once a piece. Recording relies on one
//! thread running the pieces one after the other; a piece then lasts until the next one begins or
//! the loop ends, and loops within pieces nest.

use super::tape;
use rayon::iter::plumbing::{Consumer, Folder, Producer, ProducerCallback, UnindexedConsumer};
use rayon::iter::{self, IndexedParallelIterator, ParallelIterator};
use rayon::slice::{self, ParallelSlice, ParallelSliceMut};

/// Runs both, possibly at the same time, and returns their results.
pub fn join<A: Send, B: Send>(
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    let marks = tape::fork();
    let piece = |_| {
        if marks {
            tape::piece();
        }
    };
    let both = rayon::join(
        || {
            piece(());
            a()
        },
        || {
            piece(());
            b()
        },
    );
    if marks {
        tape::join();
    }
    both
}

/// A source of a parallel loop, marked on the tape.
#[derive(Clone, Debug)]
pub struct Marked<I>(I);

impl<I: IndexedParallelIterator> ParallelIterator for Marked<I> {
    type Item = I::Item;

    fn drive_unindexed<C: UnindexedConsumer<Self::Item>>(self, consumer: C) -> C::Result {
        iter::plumbing::bridge(self, consumer)
    }

    fn opt_len(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

impl<I: IndexedParallelIterator> IndexedParallelIterator for Marked<I> {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn drive<C: Consumer<Self::Item>>(self, consumer: C) -> C::Result {
        iter::plumbing::bridge(self, consumer)
    }

    fn with_producer<B: ProducerCallback<Self::Item>>(self, callback: B) -> B::Output {
        let marks = tape::fork();
        let longest = if marks {
            self.0.len().div_ceil(tape::PIECES)
        } else {
            usize::MAX
        };
        let out = self.0.with_producer(Marking {
            callback,
            marks,
            longest,
        });
        if marks {
            tape::join();
        }
        out
    }
}

/// Wraps the producer that the source hands out.
struct Marking<B> {
    callback: B,
    marks: bool,
    longest: usize,
}

impl<T, B: ProducerCallback<T>> ProducerCallback<T> for Marking<B> {
    type Output = B::Output;

    fn callback<P: Producer<Item = T>>(self, producer: P) -> B::Output {
        self.callback.callback(MarkedProducer {
            producer,
            marks: self.marks,
            longest: self.longest,
        })
    }
}

/// A producer whose pieces are marked where `marks` is set, and no longer than `longest`.
struct MarkedProducer<P> {
    producer: P,
    marks: bool,
    longest: usize,
}

impl<P: Producer> Producer for MarkedProducer<P> {
    type Item = P::Item;
    type IntoIter = P::IntoIter;

    fn into_iter(self) -> Self::IntoIter {
        if self.marks {
            tape::piece();
        }
        self.producer.into_iter()
    }

    fn min_len(&self) -> usize {
        self.producer.min_len()
    }

    fn max_len(&self) -> usize {
        self.producer.max_len().min(self.longest)
    }

    fn split_at(self, index: usize) -> (Self, Self) {
        let (a, b) = self.producer.split_at(index);
        let (marks, longest) = (self.marks, self.longest);
        let with = |producer| Self {
            producer,
            marks,
            longest,
        };
        (with(a), with(b))
    }

    fn fold_with<F: Folder<Self::Item>>(self, folder: F) -> F {
        if self.marks {
            tape::piece();
        }
        self.producer.fold_with(folder)
    }
}

/// As rayon's, marked.
pub trait IntoParallelIterator: Sized {
    /// Rayon's iterator.
    type Iter: IndexedParallelIterator;
    /// A parallel iterator that takes the collection.
    fn into_par_iter(self) -> Marked<Self::Iter>;
}

impl<T: iter::IntoParallelIterator<Iter: IndexedParallelIterator>> IntoParallelIterator for T {
    type Iter = T::Iter;
    fn into_par_iter(self) -> Marked<Self::Iter> {
        Marked(iter::IntoParallelIterator::into_par_iter(self))
    }
}

/// As rayon's, marked.
pub trait IntoParallelRefIterator<'a> {
    /// Rayon's iterator.
    type Iter: IndexedParallelIterator;
    /// A parallel iterator over references.
    fn par_iter(&'a self) -> Marked<Self::Iter>;
}

impl<'a, T: iter::IntoParallelRefIterator<'a, Iter: IndexedParallelIterator> + ?Sized>
    IntoParallelRefIterator<'a> for T
{
    type Iter = T::Iter;
    fn par_iter(&'a self) -> Marked<Self::Iter> {
        Marked(iter::IntoParallelRefIterator::par_iter(self))
    }
}

/// As rayon's, marked.
pub trait IntoParallelRefMutIterator<'a> {
    /// Rayon's iterator.
    type Iter: IndexedParallelIterator;
    /// A parallel iterator over mutable references.
    fn par_iter_mut(&'a mut self) -> Marked<Self::Iter>;
}

impl<'a, T: iter::IntoParallelRefMutIterator<'a, Iter: IndexedParallelIterator> + ?Sized>
    IntoParallelRefMutIterator<'a> for T
{
    type Iter = T::Iter;
    fn par_iter_mut(&'a mut self) -> Marked<Self::Iter> {
        Marked(iter::IntoParallelRefMutIterator::par_iter_mut(self))
    }
}

/// As rayon's `ParallelSlice`, marked.
pub trait ParallelSlices<T: Sync> {
    /// Runs of `size` elements; the last may be shorter.
    fn par_chunks(&self, size: usize) -> Marked<slice::Chunks<'_, T>>;
    /// Runs of exactly `size` elements.
    fn par_chunks_exact(&self, size: usize) -> Marked<slice::ChunksExact<'_, T>>;
}

impl<T: Sync> ParallelSlices<T> for [T] {
    fn par_chunks(&self, size: usize) -> Marked<slice::Chunks<'_, T>> {
        Marked(ParallelSlice::par_chunks(self, size))
    }
    fn par_chunks_exact(&self, size: usize) -> Marked<slice::ChunksExact<'_, T>> {
        Marked(ParallelSlice::par_chunks_exact(self, size))
    }
}

/// As rayon's `ParallelSliceMut`; loops marked, sorts as they are.
pub trait ParallelSlicesMut<T: Send> {
    /// Runs of `size` elements; the last may be shorter.
    fn par_chunks_mut(&mut self, size: usize) -> Marked<slice::ChunksMut<'_, T>>;
    /// Sorts; equal elements may change places.
    fn par_sort_unstable(&mut self)
    where
        T: Ord;
    /// Sorts by a comparison; equal elements may change places.
    fn par_sort_unstable_by(&mut self, by: impl Fn(&T, &T) -> std::cmp::Ordering + Sync);
}

impl<T: Send> ParallelSlicesMut<T> for [T] {
    fn par_chunks_mut(&mut self, size: usize) -> Marked<slice::ChunksMut<'_, T>> {
        Marked(ParallelSliceMut::par_chunks_mut(self, size))
    }
    fn par_sort_unstable(&mut self)
    where
        T: Ord,
    {
        ParallelSliceMut::par_sort_unstable(self);
    }
    fn par_sort_unstable_by(&mut self, by: impl Fn(&T, &T) -> std::cmp::Ordering + Sync) {
        ParallelSliceMut::par_sort_unstable_by(self, by);
    }
}
