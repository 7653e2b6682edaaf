//! How well emission is found: the intersection over union (IoU) of the emitting pixels and the
//! squared error of log(1 + L_e), as FIPT reports them.
//!
//! The truth is `gt/emission/<stem>.exr` where a scene has it. Elsewhere it is derived from what
//! the scene declares: a pixel of a class of kind `light` emits the radiance its photograph shows,
//! unless it is so much darker than its class that it must be the lamp's housing.

use crate::Result;
use crate::core::formats::read_rgb;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::render::RenderedView;
use crate::scene::{Scene, View};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A pixel of a light class darker than this share of the 90 % quantile of its view's light pixels
/// does not emit.
const HOUSING: f32 = 0.02;

/// How well emission is found over a set of views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EmissionScores {
    /// Intersection over union of emitting pixels, pooled over all views; 1 if nothing emits and
    /// nothing is said to.
    pub iou: f64,
    /// Mean over the views with emission (true or stated) of their own IoU.
    pub mean_iou: f64,
    /// Mean over all pixels and channels of (log(1 + L_e) − log(1 + L̂_e))², natural logarithm,
    /// working radiance.
    pub log_l2: f64,
    /// Truly emitting pixels.
    pub true_pixels: u64,
    /// Pixels stated to emit.
    pub stated_pixels: u64,
    /// Σ stated radiance / Σ true radiance over the pixels that are both (luminance): 1 is exact; 1
    /// where there are none.
    pub power_ratio: f64,
    /// The same with each view's stated radiance under the view's one gain: photographs exposed for
    /// themselves give light in a unit of their own, which says nothing of the lamps' share of it.
    pub power_ratio_gained: f64,
    /// Whether the truth is a file of the scene (otherwise derived from classes of kind light and
    /// photographs).
    pub truth_from_file: bool,
}

/// Sums over views.
#[derive(Clone, Debug, Default)]
pub(super) struct EmissionTally {
    both: u64,
    either: u64,
    truth: u64,
    stated: u64,
    log_squares: f64,
    channels: u64,
    ious: Vec<f64>,
    /// Luminance where both emit: stated, the same under the view's gain, true.
    power: [f64; 3],
    from_file: bool,
}

impl EmissionTally {
    /// Adds a view; `truth` and its rendering have the same size, and `gain` on linear radiance
    /// brings the rendering closest to the photograph.
    pub(super) fn add(&mut self, truth: &EmissionTruth, rendered: &RenderedView, gain: f64) {
        let (mut both, mut either) = (0u64, 0u64);
        for (t, p) in truth.radiance.data.iter().zip(&rendered.emission.data) {
            let (is, said) = (*t != Vec3::ZERO, *p != Vec3::ZERO);
            self.truth += u64::from(is);
            self.stated += u64::from(said);
            both += u64::from(is && said);
            either += u64::from(is || said);
            if is && said {
                let stated = f64::from(luminance(*p));
                let terms = [stated, gain * stated, f64::from(luminance(*t))];
                self.power.iter_mut().zip(terms).for_each(|(s, t)| *s += t);
            }
            for c in 0..3 {
                self.log_squares +=
                    (f64::from(t[c]).ln_1p() - f64::from(p[c].max(0.0)).ln_1p()).powi(2);
            }
        }
        self.channels += 3 * truth.radiance.data.len() as u64;
        self.both += both;
        self.either += either;
        if either > 0 {
            self.ious.push(both as f64 / either as f64);
        }
        self.from_file |= truth.from_file;
    }

    /// The scores; `None` without any view.
    pub(super) fn finish(&self) -> Option<EmissionScores> {
        let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 1.0 };
        (self.channels > 0).then(|| EmissionScores {
            iou: ratio(self.both as f64, self.either as f64),
            mean_iou: ratio(self.ious.iter().sum(), self.ious.len() as f64),
            log_l2: self.log_squares / self.channels as f64,
            true_pixels: self.truth,
            stated_pixels: self.stated,
            power_ratio: ratio(self.power[0], self.power[2]),
            power_ratio_gained: ratio(self.power[1], self.power[2]),
            truth_from_file: self.from_file,
        })
    }
}

/// True emission of one view, 0 where nothing emits.
pub(super) struct EmissionTruth {
    pub(super) radiance: RgbPlane,
    from_file: bool,
}

impl EmissionTruth {
    /// From the scene's own file, or from classes of kind `light`; `None` where a scene has
    /// neither.
    pub(super) fn of(
        scene: &Scene,
        view: &View,
        photograph: &RgbPlane,
        labels: &Plane<u16>,
        lights: &BTreeSet<u16>,
    ) -> Result<Option<Self>> {
        let file = scene
            .folder
            .join("gt/emission")
            .join(format!("{}.exr", view.stem));
        if file.is_file() {
            let gain = view.exposure_ev.exp2();
            let radiance = read_rgb(&file)?.map(|v| *v * gain);
            super::truth::check_size(&file, radiance.width, radiance.height, &view.camera)?;
            return Ok(Some(Self {
                radiance,
                from_file: true,
            }));
        }
        if lights.is_empty() {
            return Ok(None);
        }
        let lit = |i: usize| lights.contains(&labels.data[i]);
        let mut levels: Vec<f32> = (0..labels.data.len())
            .filter(|&i| lit(i))
            .map(|i| luminance(photograph.data[i]))
            .filter(|l| l.is_finite())
            .collect();
        levels.sort_by(f32::total_cmp);
        let bright = levels.get(levels.len() * 9 / 10).copied().unwrap_or(0.0);
        let data = (0..labels.data.len())
            .map(|i| {
                let l = photograph.data[i];
                if lit(i) && l.is_finite() && luminance(l) > HOUSING * bright {
                    l
                } else {
                    Vec3::ZERO
                }
            })
            .collect();
        Ok(Some(Self {
            radiance: Plane {
                width: labels.width,
                height: labels.height,
                data,
            },
            from_file: false,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::RenderedView;

    /// Eight pixels: the first four truly emit 1; the last six are said to emit e − 1 (so that
    /// log(1 + L) is 1 there).
    #[test]
    fn overlap_and_logarithms_have_their_closed_forms() {
        let plane = |f: &dyn Fn(usize) -> f32| Plane {
            width: 8,
            height: 1,
            data: (0..8).map(|i| Vec3::splat(f(i))).collect(),
        };
        let truth = EmissionTruth {
            radiance: plane(&|i| if i < 4 { 1.0 } else { 0.0 }),
            from_file: true,
        };
        let e = std::f32::consts::E - 1.0;
        let rendered = RenderedView {
            radiance: plane(&|_| 0.0),
            albedo: plane(&|_| 0.0),
            roughness: Plane::filled(8, 1, 0.0),
            metallic: Plane::filled(8, 1, 0.0),
            transmission: Plane::filled(8, 1, 0.0),
            labels: Plane::filled(8, 1, 1),
            emission: plane(&|i| if i >= 2 { e } else { 0.0 }),
            confidence: Plane::filled(8, 1, glam::Vec2::ZERO),
        };
        let mut tally = EmissionTally::default();
        assert!(tally.finish().is_none());
        tally.add(&truth, &rendered, 0.5);
        let s = tally.finish().expect("one view");
        assert!((s.iou - 2.0 / 8.0).abs() < 1e-12 && (s.mean_iou - s.iou).abs() < 1e-12);
        let ln2 = 2f64.ln();
        let expected = (2.0 * ln2 * ln2 + 2.0 * (1.0 - ln2).powi(2) + 4.0) / 8.0;
        assert!(
            (s.log_l2 - expected).abs() < 1e-6,
            "{} {expected}",
            s.log_l2
        );
        assert!((s.power_ratio - f64::from(e)).abs() < 1e-6);
        assert!((s.power_ratio_gained - 0.5 * f64::from(e)).abs() < 1e-6);
        assert_eq!((s.true_pixels, s.stated_pixels), (4, 6));
    }
}
