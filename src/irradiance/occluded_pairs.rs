//! Which texels are hidden from which: lists of numbers, mutual.

use crate::core::parallel::prelude::*;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

/// The texels hidden from each.
#[derive(Default)]
pub(crate) struct OccludedPairs {
    /// Texel by texel, ascending.
    ids: Vec<u32>,
    /// Where each texel's end; empty where nobody looked.
    end: Vec<usize>,
}

impl OccludedPairs {
    /// From the hidden ones that each texel found out about, every pair once.
    pub(crate) fn mutual(found: &[Vec<u32>]) -> Self {
        let next: Vec<AtomicUsize> = found.iter().map(|_| AtomicUsize::new(0)).collect();
        each_way(found, |i, _| {
            next[i].fetch_add(1, Ordering::Relaxed);
        });
        let mut sum = 0;
        for next in &next {
            sum += next.swap(sum, Ordering::Relaxed);
        }
        let ids: Vec<AtomicU32> = (0..sum)
            .into_par_iter()
            .map(|_| AtomicU32::new(0))
            .collect();
        each_way(found, |i, j| {
            ids[next[i].fetch_add(1, Ordering::Relaxed)].store(j, Ordering::Relaxed)
        });
        // (where each list begins has moved to where it ends)
        let end: Vec<usize> = next.into_iter().map(AtomicUsize::into_inner).collect();
        let mut ids: Vec<u32> = ids.into_iter().map(AtomicU32::into_inner).collect();
        let (mut rest, mut start, mut lists) = (ids.as_mut_slice(), 0, Vec::new());
        for &end in &end {
            let (list, others) = rest.split_at_mut(end - start);
            (rest, start) = (others, end);
            lists.push(list);
        }
        // whoever wrote first
        lists.into_par_iter().for_each(|list| list.sort_unstable());
        Self { ids, end }
    }

    /// The texels hidden from texel `i`, ascending.
    pub(crate) fn of(&self, i: usize) -> &[u32] {
        let Some(&end) = self.end.get(i) else {
            return &[];
        };
        &self.ids[if i == 0 { 0 } else { self.end[i - 1] }..end]
    }

    /// Takes away those of the texels around texel `i` that are hidden from it; `id` tells their
    /// numbers.
    pub(crate) fn part<T>(&self, i: usize, near: &mut Vec<T>, id: impl Fn(&T) -> u32) {
        let hidden = self.of(i);
        if !hidden.is_empty() {
            near.retain(|n| hidden.binary_search(&id(n)).is_err());
        }
    }

    #[cfg(test)]
    pub(crate) fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }
}

/// `each(i, j)` and `each(j, i)` for every j that texel i found out about.
fn each_way(found: &[Vec<u32>], each: impl Fn(usize, u32) + Sync) {
    found.par_iter().enumerate().for_each(|(i, list)| {
        list.iter().for_each(|&j| {
            each(i, j);
            each(j as usize, i as u32);
        });
    });
}
