//! How many pixels of a kind are found: those of which more than half is stated to be of it against
//! those of which the truth says so.

use crate::core::image::Plane;

/// A pixel counts if more than this share of it is of the kind.
const HALF: f32 = 0.5;

/// Pixels counted over views.
#[derive(Clone, Debug, Default)]
pub(super) struct FoundTally {
    /// Views with a truth.
    pub(super) views: usize,
    /// Pixels truly of the kind.
    pub(super) truth: u64,
    /// Pixels stated to be.
    pub(super) stated: u64,
    /// Pixels that are both.
    pub(super) both: u64,
}

impl FoundTally {
    /// Adds the pixels of `mask` of a view; returns the places of those that are both.
    pub(super) fn add(
        &mut self,
        mask: &Plane<bool>,
        stated: &Plane<f32>,
        truth: &Plane<f32>,
    ) -> Vec<usize> {
        self.views += 1;
        let mut both = Vec::new();
        for i in (0..mask.data.len()).filter(|&i| mask.data[i]) {
            let (is, said) = (truth.data[i] > HALF, stated.data[i] > HALF);
            self.truth += u64::from(is);
            self.stated += u64::from(said);
            if is && said {
                both.push(i);
            }
        }
        self.both += both.len() as u64;
        both
    }

    /// Share of the true pixels that are stated; 1 if there are none.
    pub(super) fn found(&self) -> f64 {
        if self.truth > 0 {
            self.both as f64 / self.truth as f64
        } else {
            1.0
        }
    }

    /// Share of the stated pixels that are not true; 0 if there are none.
    pub(super) fn wrong(&self) -> f64 {
        (self.stated - self.both) as f64 / self.stated.max(1) as f64
    }
}
