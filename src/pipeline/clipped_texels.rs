//! Which texels and which part of the sky the photographs show at the sensor's ceiling, and no view
//! below it. Called by the stage `clipped_light`.

use super::clipped_looks::where_clipped;
use super::{SolveOptions, Switch};
use crate::core::image::RgbPlane;
use crate::core::parallel::prelude::*;
use crate::gbuffer::Observation;
use crate::observed::Surface;
use crate::radiance::Environment;
use glam::Vec3;

/// Texels at the ceiling.
pub(super) struct ClippedTexels {
    /// Channels at the ceiling, one bit each, per texel; 0 = not clipped.
    pub(super) bits: Vec<u8>,
    /// Side of the sharpest clipped pixel's footprint, metres; infinite where none.
    pub(super) footprint: Vec<f32>,
    /// Indicator of the clipped sky per channel, and whether there is any.
    pub(super) sky: RgbPlane,
    pub(super) has_sky: bool,
}

impl ClippedTexels {
    pub(super) fn find(surface: &mut Surface, options: &SolveOptions) -> Self {
        let lights: Vec<u16> = (surface.scene.classes.iter().filter(|c| c.is_light))
            .map(|c| c.id)
            .collect();
        let (bits, footprint) = (0..surface.texels.len())
            .into_par_iter()
            .map_init(Vec::new, |seen, i| {
                let is_light = lights.contains(&surface.labels[i]);
                clipped_bits(surface, i, is_light, seen)
            })
            .unzip();
        let (sky, has_sky) = clipped_sky(surface, options);
        Self {
            bits,
            footprint,
            sky,
            has_sky,
        }
    }
}

/// Channels in which texel `i` is at the ceiling in most looks at it, and the footprint of the
/// sharpest of those.
fn clipped_bits(
    surface: &Surface,
    i: usize,
    is_light: bool,
    seen: &mut Vec<Observation>,
) -> (u8, f32) {
    let f = &surface.fusion;
    if f.clean[i] || f.views[i] == 0 {
        return (0, f32::INFINITY);
    }
    let t = surface.texels.point[i].triangle as usize;
    let normal = surface.scene.mesh.face_normal(t) * surface.orientation.sign(t);
    surface.observer().observe(
        surface.texels.position(&surface.scene.mesh, i),
        normal,
        seen,
    );
    let (mut bits, mut at, mut below) = (0u8, 0.0f32, 0.0f32);
    let (mut bound, mut measured) = (Vec3::ZERO, Vec3::ZERO);
    let mut footprint = f32::INFINITY;
    for o in seen.iter() {
        let own = surface.ceilings[o.view as usize].as_ref().map_or(0, |c| {
            let (x, y) = (o.pixel.x.max(0.0) as usize, o.pixel.y.max(0.0) as usize);
            c[(x.min(c.width - 1), y.min(c.height - 1))]
        });
        let (held, free) = split(own, o.radiance);
        (bound, measured) = (bound.max(held), measured.max(free));
        let weight = 1.0 / o.footprint.max(f32::MIN_POSITIVE);
        if own == 0 {
            below += weight;
        } else {
            at += weight;
            bits |= own;
            footprint = footprint.min(o.footprint);
        }
    }
    // another view, exposed for it, shows as much as the bounds and did not clip it
    for c in 0..3 {
        if measured[c] >= bound[c] {
            bits &= !(1 << c);
        }
    }
    // mixed pixels at a lamp's edge are not the lamp's radiance
    let enough = if is_light { at > 0.0 } else { at >= below };
    (if enough { bits } else { 0 }, footprint)
}

/// The channels of `value` that are clipped, and those that are not; zero elsewhere.
fn split(bits: u8, value: Vec3) -> (Vec3, Vec3) {
    let held = where_clipped(bits, value);
    (held, value - held)
}

/// Where the sky is at the ceiling, by direction and channel.
fn clipped_sky(surface: &mut Surface, options: &SolveOptions) -> (RgbPlane, bool) {
    let black = || (Environment::black().map().clone(), false);
    if options.environment == Switch::Off {
        return black();
    }
    let mut kept = Vec::with_capacity(surface.views.len());
    for (view, ceiling) in surface.views.iter_mut().zip(&surface.ceilings) {
        let marks = match ceiling {
            Some(c) => c.map(|b| Vec3::from_array([0, 1, 2].map(|k| f32::from((b >> k) & 1)))),
            None => view.radiance.map(|_| Vec3::ZERO),
        };
        kept.push(std::mem::replace(&mut view.radiance, marks));
    }
    let marks = Environment::observe(&surface.views);
    for (view, radiance) in surface.views.iter_mut().zip(kept) {
        view.radiance = radiance;
    }
    let has_sky = !marks.is_black();
    (marks.map().clone(), has_sky)
}
