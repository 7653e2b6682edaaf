//! How well metal is found: pixels that are more than half metal against those of
//! `gt/metallic/<stem>.exr`, and what the metal reflects at normal incidence where both agree.

use super::found::FoundTally;
use super::truth::GroundTruth;
use crate::core::image::Plane;
use crate::render::RenderedView;
use serde::{Deserialize, Serialize};

/// How well metal is found over a set of views, over the pixels that count for materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MetalScores {
    /// Truly metal pixels.
    pub true_pixels: u64,
    /// Pixels stated to be metal.
    pub stated_pixels: u64,
    /// Share of the truly metal pixels that are stated to be; 1 if there are none.
    pub found: f64,
    /// Share of the pixels stated to be metal that are not; 0 if there are none.
    pub wrong: f64,
    /// Root mean square error of F0 per channel over the pixels that are both, absolute; 0 if there
    /// are none.
    pub f0_error: f64,
    /// Root mean square error of the roughness over the same pixels.
    pub roughness_error: f64,
}

/// Sums over views.
#[derive(Clone, Debug, Default)]
pub(super) struct MetalTally {
    found: FoundTally,
    f0_squares: f64,
    roughness_squares: f64,
}

impl MetalTally {
    /// Adds the pixels of `mask` of a view whose truth says what is metal.
    pub(super) fn add(&mut self, mask: &Plane<bool>, rendered: &RenderedView, truth: &GroundTruth) {
        let Some(metallic) = &truth.metallic else {
            return;
        };
        for i in self.found.add(mask, &rendered.metallic, metallic) {
            let off = (rendered.albedo.data[i] - truth.albedo.data[i]).as_dvec3();
            self.f0_squares += off.length_squared() / 3.0;
            let off = rendered.roughness.data[i] - truth.roughness.data[i];
            self.roughness_squares += f64::from(off).powi(2);
        }
    }

    /// The scores; none where no view has a truth.
    pub(super) fn finish(&self) -> Option<MetalScores> {
        let root = |squares: f64| (squares / self.found.both.max(1) as f64).sqrt();
        (self.found.views > 0).then(|| MetalScores {
            true_pixels: self.found.truth,
            stated_pixels: self.found.stated,
            found: self.found.found(),
            wrong: self.found.wrong(),
            f0_error: root(self.f0_squares),
            roughness_error: root(self.roughness_squares),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    /// Ten pixels, the last left out: the first four are metal, those from the third to the eighth
    /// are said to be, a tenth too bright and a fifth too rough.
    #[test]
    fn shares_and_errors_have_their_closed_forms() {
        let plane = |f: &dyn Fn(usize) -> f32| Plane {
            width: 10,
            height: 1,
            data: (0..10).map(f).collect(),
        };
        let colour = |x: f32| Plane::filled(10, 1, Vec3::splat(x));
        let mut truth = GroundTruth {
            albedo: colour(0.6),
            roughness: plane(&|_| 0.1),
            metallic: None,
            transmission: None,
        };
        let rendered = RenderedView {
            radiance: colour(0.0),
            albedo: colour(0.7),
            roughness: plane(&|_| 0.3),
            metallic: plane(&|i| if i >= 2 && i != 8 { 1.0 } else { 0.25 }),
            transmission: plane(&|_| 0.0),
            labels: Plane::filled(10, 1, 1),
            emission: colour(0.0),
            confidence: Plane::filled(10, 1, Vec2::ZERO),
        };
        let mut mask = Plane::filled(10, 1, true);
        mask.data[9] = false;
        let mut tally = MetalTally::default();
        tally.add(&mask, &rendered, &truth);
        assert!(tally.finish().is_none(), "no truth, no scores");
        truth.metallic = Some(plane(&|i| if i < 4 { 1.0 } else { 0.0 }));
        tally.add(&mask, &rendered, &truth);
        let s = tally.finish().expect("one view");
        assert_eq!((s.true_pixels, s.stated_pixels), (4, 6));
        assert_eq!((s.found, s.wrong), (0.5, 4.0 / 6.0));
        assert!((s.f0_error - 0.1).abs() < 1e-6 && (s.roughness_error - 0.2).abs() < 1e-6);
    }
}
