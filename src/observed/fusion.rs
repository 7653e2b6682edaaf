//! Texture-based lighting (TBL): the radiance every texel sends out, fused from all views that see
//! it.
//!
//! The paper copies one pixel of one view per texel (method §2.1, W6), so that a highlight seen
//! from that view becomes light. Here every view contributes with a weight from its footprint; a
//! weighted median finds the view-independent level and a one-step Huber mean around it uses all
//! consistent views.

use crate::core::blocks::{Columns, Packed, column, flags, truths, values};
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::stats::weighted_median;
use crate::core::texture::Texels;
use crate::gbuffer::{Observation, Observer, Orientation};
use glam::Vec3;

/// Texels per parallel task.
const CHUNK: usize = 2048;

/// Tasks per block that processes share. Derived: at a microsecond a look and tens of looks a texel
/// a block takes half a second, beside which a file of half a megabyte is nothing.
const BLOCK: usize = 8;

/// Relative difference of two looks up to which both count alike.
const ALIKE: f32 = 0.05;

/// The label of a texel that no view sees.
pub const UNSEEN: u32 = u32::MAX;

/// Fused radiance per covered texel.
#[derive(Clone, Debug, Default)]
pub struct Fusion {
    /// Radiance sent out, zero where unobserved.
    pub radiance: Vec<Vec3>,
    /// Whether a view sees the texel in pixels free of edges. Without one, `radiance` is a mixture
    /// with a neighbouring surface, which beside a lamp is a false light.
    pub clean: Vec<bool>,
    /// Radiance of the brightest view: for lamps smaller than a pixel, which mixing only darkens.
    pub peak: Vec<Vec3>,
    /// Number of views used.
    pub views: Vec<u8>,
    /// Class id by vote of the observing views, 0 = unlabelled, [`UNSEEN`] where no view sees the
    /// texel.
    pub label: Vec<u32>,
    /// Smallest luminance over the clean views: light that cannot be a highlight.
    pub floor: Vec<f32>,
}

/// Fuses the observations of every texel.
#[must_use]
pub fn fuse_radiance(
    observer: &Observer,
    orientation: &Orientation,
    texels: &Texels,
    progress: &Progress,
) -> Fusion {
    let parts = progress.map_chunks(texels.len(), CHUNK, BLOCK, |range| {
        let mut out = Fusion::default();
        let mut seen = Vec::new();
        for i in range.clone() {
            let t = texels.point[i].triangle as usize;
            let n = observer.mesh.face_normal(t) * orientation.sign(t);
            observer.observe(texels.position(observer.mesh, i), n, &mut seen);
            let peak = seen
                .iter()
                .map(|o| o.radiance)
                .max_by(|a, b| luminance(*a).total_cmp(&luminance(*b)));
            out.peak.push(peak.unwrap_or(Vec3::ZERO));
            out.clean.push(seen.iter().any(|o| o.clean));
            prefer_clean(&mut seen);
            out.label.push(vote_label(&seen));
            out.radiance.push(robust_mean(&seen));
            out.views.push(seen.len().min(255) as u8);
            out.floor.push(
                seen.iter()
                    .map(|o| luminance(o.radiance))
                    .fold(f32::INFINITY, f32::min),
            );
        }
        progress.advance(range.len() as u64);
        out
    });
    let mut all = Fusion::default();
    for p in parts {
        all.radiance.extend(p.radiance);
        all.clean.extend(p.clean);
        all.peak.extend(p.peak);
        all.views.extend(p.views);
        all.label.extend(p.label);
        all.floor.extend(p.floor);
    }
    all
}

impl Fusion {
    /// Takes a texel for one that no view sees.
    pub(crate) fn forget(&mut self, texel: usize) {
        self.radiance[texel] = Vec3::ZERO;
        self.clean[texel] = false;
        self.peak[texel] = Vec3::ZERO;
        self.views[texel] = 0;
        self.label[texel] = UNSEEN;
        self.floor[texel] = f32::INFINITY;
    }
}

impl Packed for Fusion {
    fn columns(&self) -> Columns {
        let Self {
            radiance,
            clean,
            peak,
            views,
            label,
            floor,
        } = self;
        vec![
            column(radiance),
            truths(clean),
            column(peak),
            views.clone(),
            column(label),
            column(floor),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [radiance, clean, peak, views, label, floor] = columns else {
            return None;
        };
        Some(Self {
            radiance: values(radiance)?,
            clean: flags(clean),
            peak: values(peak)?,
            views: views.clone(),
            label: values(label)?,
            floor: values(floor)?,
        })
    }
}

/// Keeps only clean observations if there is at least one.
pub(crate) fn prefer_clean(seen: &mut Vec<Observation>) {
    if seen.iter().any(|o| o.clean) {
        seen.retain(|o| o.clean);
    }
}

/// Sharpness weight of an observation: inverse footprint area.
pub(crate) fn sharpness(o: &Observation) -> f32 {
    1.0 / (o.footprint * o.footprint).max(f32::MIN_POSITIVE)
}

/// The label most of these looks agree on, those from in front first; ties go to the smaller id.
fn vote_label(seen: &[Observation]) -> u32 {
    let mut ballot: Vec<(u32, f32)> = Vec::new();
    for o in seen {
        match ballot.iter_mut().find(|b| b.0 == u32::from(o.label)) {
            Some(b) => b.1 += o.n_v,
            None => ballot.push((o.label.into(), o.n_v)),
        }
    }
    ballot.sort_by_key(|b| b.0);
    ballot
        .iter()
        .fold(
            (UNSEEN, 0.0f32),
            |best, b| if b.1 > best.1 { *b } else { best },
        )
        .0
}

/// The radiance that the looks agree on.
fn robust_mean(seen: &[Observation]) -> Vec3 {
    match seen {
        [] => Vec3::ZERO,
        [one] => one.radiance,
        [a, b] => {
            // of two that disagree by more than noise the darker is nearer to the truth:
            // reflections only add. No third speaks for the brighter: the farther off it is, the
            // less it moves the mean at all
            let [a, b] = [a, b].map(|o| luminance(o.radiance));
            let darker = a.min(b);
            mean_around(seen, darker, (a - b).abs().min(ALIKE * darker), |far| {
                far * far
            })
        }
        _ => {
            let (median, spread) = median_and_spread(seen);
            mean_around(seen, median, spread, |far| far)
        }
    }
}

/// Weighted median by luminance, and the median distance from it.
fn median_and_spread(seen: &[Observation]) -> (f32, f32) {
    let mut order: Vec<(f32, f32)> = seen
        .iter()
        .map(|o| (luminance(o.radiance), sharpness(o).sqrt()))
        .collect();
    // no single view, however sharp, may outvote the others: a highlight is often seen from nearby
    let mut weights: Vec<f32> = order.iter().map(|o| o.1).collect();
    weights.sort_by(f32::total_cmp);
    let most = weights[weights.len() / 2];
    order.iter_mut().for_each(|o| o.1 = o.1.min(most));
    let median = weighted_median(&order).map_or(0.0, |i| order[i].0);
    let mut spread: Vec<f32> = order.iter().map(|o| (o.0 - median).abs()).collect();
    spread.sort_by(f32::total_cmp);
    (median, spread[spread.len() / 2])
}

/// Mean weighted by sharpness over `penalty(d)`, d being the distance from a luminance in units of
/// what `spread` allows for, at least 1.
fn mean_around(
    seen: &[Observation],
    centre: f32,
    spread: f32,
    penalty: impl Fn(f32) -> f32,
) -> Vec3 {
    let scale = 1.5 * spread + 0.02 * centre + f32::MIN_POSITIVE;
    let (mut sum, mut total) = (Vec3::ZERO, 0.0);
    for o in seen {
        let far = ((luminance(o.radiance) - centre).abs() / scale).max(1.0);
        let w = sharpness(o).sqrt() / penalty(far);
        sum += o.radiance * w;
        total += w;
    }
    if total > 0.0 { sum / total } else { Vec3::ZERO }
}
