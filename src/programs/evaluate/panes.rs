//! How well panes are found: pixels more than half of whose light goes through against those of
//! `gt/transmission/<stem>.exr`, and the tint where both agree.

use super::found::FoundTally;
use super::truth::GroundTruth;
use crate::core::image::Plane;
use crate::render::RenderedView;
use serde::{Deserialize, Serialize};

/// How well panes are found over a set of views, over the pixels that count for materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaneScores {
    /// Pixels that truly show a pane.
    pub true_pixels: u64,
    /// Pixels stated to show one.
    pub stated_pixels: u64,
    /// Share of the pixels that truly show a pane that are stated to; 1 if there are none.
    pub found: f64,
    /// Share of the pixels stated to show a pane that do not; 0 if there are none.
    pub wrong: f64,
    /// Root mean square error of transmission · tint per channel over the pixels that are both,
    /// absolute; 0 if there are none.
    pub transmittance_error: f64,
}

/// Sums over views.
#[derive(Clone, Debug, Default)]
pub(super) struct PaneTally {
    found: FoundTally,
    squares: f64,
}

impl PaneTally {
    /// Adds the pixels of `mask` of a view whose truth says what is a pane.
    pub(super) fn add(&mut self, mask: &Plane<bool>, rendered: &RenderedView, truth: &GroundTruth) {
        let Some(transmission) = &truth.transmission else {
            return;
        };
        for i in self.found.add(mask, &rendered.transmission, transmission) {
            let stated = rendered.albedo.data[i] * rendered.transmission.data[i];
            let off = (stated - truth.albedo.data[i] * transmission.data[i]).as_dvec3();
            self.squares += off.length_squared() / 3.0;
        }
    }

    /// The scores; none where no view has a truth.
    pub(super) fn finish(&self) -> Option<PaneScores> {
        (self.found.views > 0).then(|| PaneScores {
            true_pixels: self.found.truth,
            stated_pixels: self.found.stated,
            found: self.found.found(),
            wrong: self.found.wrong(),
            transmittance_error: (self.squares / self.found.both.max(1) as f64).sqrt(),
        })
    }
}
