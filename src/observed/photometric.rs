//! What is wrong with photographs as photographs: exposure and white balance that drift from view
//! to view, and clipped skies.

use super::estimate_gains;
use crate::core::image::Plane;
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::stats::median;
use crate::core::switch::Switch;
use crate::core::trace::Hit;
use crate::gbuffer::{ObservedView, Observer, Orientation};
use crate::scene::Scene;

/// Where a view's sky is clipped below what another view shows of the sky, its pixels tell nothing;
/// if all are clipped alike, the ceiling stays as the best lower bound there is.
pub(crate) fn leave_out_clipped_sky(views: &mut [ObservedView], clipped: &[Option<Plane<u8>>]) {
    let sky = |v: &ObservedView| -> f32 {
        let seen = v
            .buffer
            .triangle
            .data
            .iter()
            .zip(&v.radiance.data)
            .filter(|(t, _)| **t == Hit::MISS);
        seen.map(|(_, l)| luminance(*l)).fold(0.0, f32::max)
    };
    let brightest: Vec<f32> = views.iter().map(sky).collect();
    let top = brightest.iter().copied().fold(0.0, f32::max);
    for ((view, clipped), own) in views.iter_mut().zip(clipped).zip(brightest) {
        let Some(clipped) = clipped.as_ref().filter(|_| own < 0.9 * top) else {
            continue;
        };
        let misses = &view.buffer.triangle.data;
        let valid = view.valid.get_or_insert_with(|| clipped.map(|_| true));
        for (i, valid) in valid.data.iter_mut().enumerate() {
            *valid &= !(clipped.data[i] != 0 && misses[i] == Hit::MISS);
        }
    }
}

/// What the views say of each other once their exposures are settled.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Balanced {
    /// Whether geometry turned out to be only roughly right.
    pub(crate) rough: bool,
    /// By how much they disagree about what they share: the median deviation of ln radiance, 0
    /// where nothing tells.
    pub(crate) disagreement: f32,
}

/// Solves for exposure and white balance of every view and takes them out of the images if the
/// views ask for it.
pub(crate) fn balance_views(
    scene: &Scene,
    views: &mut [ObservedView],
    orientation: &Orientation,
    switch: Switch,
    progress: &Progress,
) -> Balanced {
    const WHAT: &str = "exposure and white balance";
    if switch == Switch::Off {
        progress.decide(WHAT, "as photographed", "--exposure off", true);
        return Balanced::default();
    }
    let gains = progress.stage("exposure of the views", 1, |_| {
        estimate_gains(
            &Observer {
                mesh: &scene.mesh,
                views,
            },
            orientation,
        )
    });
    let apply = switch == Switch::On || gains.is_needed();
    let mut why = format!(
        "views differ by {:.1} % (RMS) at {} shared points; they disagree by {:.1} % as photographed, by {:.1} % balanced",
        100.0 * gains.rms(),
        gains.points,
        100.0 * gains.before,
        100.0 * gains.after
    );
    if let Some(worst) = gains.error.iter().copied().reduce(f32::max) {
        let typical = median(gains.error.clone()).unwrap_or(worst);
        why += &format!(
            "; geometry is only roughly right, so pairs of views voted: exposures are known to {:.0} % in the median, {:.0} % at worst",
            100.0 * typical,
            100.0 * worst
        );
    }
    progress.decide(
        WHAT,
        if apply { "balanced" } else { "as photographed" },
        why,
        switch == Switch::On,
    );
    if apply {
        for (v, view) in views.iter_mut().enumerate() {
            let correction = gains.correction(v);
            view.radiance.data.iter_mut().for_each(|l| *l *= correction);
        }
    }
    Balanced {
        rough: gains.geometry_is_rough(),
        disagreement: if apply { gains.after } else { gains.before },
    }
}
