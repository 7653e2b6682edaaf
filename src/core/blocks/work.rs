//! Blocks: pieces of a stage that several processes share. How a stage is divided depends on its
//! input alone, so that the joined results have the same bits whoever computed which.

use super::packed::Columns;
use std::ops::Range;

/// Blocks of one call at most. Derived: four for each of 64 processes, so that the last to end
/// leaves the others idle for a quarter of their share at most.
const MOST_BLOCKS: usize = 256;

/// How `len` elements are divided into blocks of whole units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Division {
    len: usize,
    /// Elements per block; the last may be shorter.
    size: usize,
}

impl Division {
    /// Blocks of one `unit` of elements or more: as many as there can be, up to a bound.
    #[must_use]
    pub fn new(len: usize, unit: usize) -> Self {
        let unit = unit.max(1);
        let units = len.div_ceil(unit);
        let size = units.div_ceil(MOST_BLOCKS).max(1) * unit;
        Self { len, size }
    }

    /// Number of blocks.
    #[must_use]
    pub fn count(&self) -> usize {
        self.len.div_ceil(self.size)
    }

    /// The elements of a block.
    #[must_use]
    pub fn range(&self, block: usize) -> Range<usize> {
        block * self.size..((block + 1) * self.size).min(self.len)
    }
}

/// The blocks of one call.
pub struct Work<'a> {
    /// Number of blocks.
    pub count: usize,
    /// Computes a block; callable from any thread, as often as need be, with the same result.
    pub compute: &'a (dyn Fn(usize) -> Columns + Sync),
    /// Takes a sentence that the user should read.
    pub note: &'a (dyn Fn(&str) + Sync),
}

/// Processes that walk through the same program and share its blocks.
///
/// Nothing that goes wrong between them makes a run fail: a block that cannot be had from another
/// process is computed here.
pub trait Transport: Send + Sync {
    /// The stage of this name begins.
    fn enter(&self, stage: &str);
    /// The results of all blocks in their order, wherever they were computed. Every process calls
    /// this with the same work, in the same order.
    fn results(&self, work: &Work<'_>) -> Vec<Columns>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_the_elements_once_in_whole_units() {
        for (len, unit) in [(0, 4), (1, 4), (10, 4), (100_003, 7), (1 << 20, 1), (5, 0)] {
            let d = Division::new(len, unit);
            assert!(d.count() <= MOST_BLOCKS, "{len}/{unit}: {}", d.count());
            let mut next = 0;
            for b in 0..d.count() {
                let r = d.range(b);
                assert!(r.start == next && r.end > r.start, "{len}/{unit}: {r:?}");
                assert!(r.end == len || r.end.is_multiple_of(unit.max(1)));
                next = r.end;
            }
            assert_eq!(next, len);
        }
    }
}
