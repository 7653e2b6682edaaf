//! What clipped looks tell once the light is known, put where later stages look for it.
//!
//! Of a pixel in which some channels are at the ceiling the others are as good as ever. Its surface
//! has the hue of its class in the light there, so that the clipped channels follow from them (the
//! correlation of the channels restores saturated pixels, Zhang and Brainard 2004): if p is what the
//! class reflects there, L_c = p_c · exp(mean over the channels m below the ceiling of ln L_m/p_m),
//! and at least the ceiling. Such a look is never clean, so that it counts only where there is no
//! better one. Where all channels are at the ceiling a reflecting surface is left with a bound.

use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::trace::Hit;
use crate::observed::{ClippedTexel, Surface};
use glam::Vec3;

/// Sectors of the sky: four quarters around, above and below the horizon.
pub(super) const SECTORS: usize = 8;

/// Sector that a direction points to.
pub(super) fn sector(direction: Vec3) -> usize {
    usize::from(direction.x < 0.0)
        + 2 * usize::from(direction.z < 0.0)
        + 4 * usize::from(direction.y < 0.0)
}

/// What a clipped texel sends out.
pub(super) struct Restored {
    /// Index among the covered texels.
    pub(super) texel: u32,
    /// Radiance.
    pub(super) radiance: Vec3,
    /// It is a light, not a surface that reflects.
    pub(super) is_light: bool,
    /// What it sends out at least.
    pub(super) least: Vec3,
    /// Side of the sharpest clipped pixel's footprint, metres.
    pub(super) footprint: f32,
}

/// Everything that is known of clipped texels and pixels.
pub(super) struct ClippedLooks {
    /// The clipped texels.
    pub(super) texels: Vec<Restored>,
    /// Radiance of the clipped sky per sector; zero where unknown.
    pub(super) sky: [Vec3; SECTORS],
    /// What the class of every texel reflects of the light there, on the atlas; zero where that is
    /// unknown.
    pub(super) reflected: RgbPlane,
}

impl ClippedLooks {
    /// Restores fused radiance and photographs; texels that reflect are noted as bounds.
    pub(super) fn apply(&self, surface: &mut Surface) {
        for t in &self.texels {
            let (i, f) = (t.texel as usize, &mut surface.fusion);
            let radiance = t.radiance.max(f.peak[i]);
            f.radiance[i] = radiance;
            f.peak[i] = radiance;
            f.floor[i] = luminance(radiance);
            f.clean[i] |= t.is_light;
            if !t.is_light {
                surface.clipped.push(ClippedTexel {
                    texel: t.texel,
                    least: t.least,
                    footprint: t.footprint,
                });
            }
        }
        surface.bounds = vec![None; surface.views.len()];
        for v in 0..surface.views.len() {
            self.restore_view(surface, v);
        }
    }

    fn restore_view(&self, surface: &mut Surface, v: usize) {
        let Some(ceiling) = surface.ceilings[v].as_ref() else {
            return;
        };
        let (view, width) = (&surface.views[v], ceiling.width);
        let restored: Vec<(usize, Option<Vec3>)> = (ceiling.data.par_iter().enumerate())
            .filter(|(_, bits)| **bits != 0)
            .map(|(i, &bits)| {
                let (seen, at) = (view.radiance.data[i], (i % width, i / width));
                let triangle = view.buffer.triangle.data[i];
                if triangle == Hit::MISS {
                    let sky = self.sky[sector(view.buffer.direction(at.0, at.1))];
                    let whole = seen.max(where_clipped(bits, sky));
                    return (i, by_hue(bits, seen, sky).or(Some(whole)));
                }
                let position = view.buffer.position(at.0, at.1);
                let expected = surface.nearest(&self.reflected, triangle, position);
                (i, by_hue(bits, seen, expected))
            })
            .collect();
        let mut bounds = ceiling.map(|_| false);
        let all_valid = ceiling.map(|_| true);
        let view = &mut surface.views[v];
        let valid = view.valid.get_or_insert(all_valid);
        for (i, radiance) in restored {
            match radiance {
                Some(radiance) => view.radiance.data[i] = radiance,
                // a lower bound: no look at the material, unless a mask says what it is
                None => bounds.data[i] = std::mem::replace(&mut valid.data[i], false),
            }
        }
        surface.bounds[v] = Some(bounds);
    }
}

/// The channels of `value` that are clipped, the others zero.
pub(super) fn where_clipped(bits: u8, value: Vec3) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|c| {
        if (bits >> c) & 1 == 1 { value[c] } else { 0.0 }
    }))
}

/// A look whose clipped channels follow from the others and the colour that is `expected`; `None`
/// where there are none, or no colour.
fn by_hue(bits: u8, seen: Vec3, expected: Vec3) -> Option<Vec3> {
    let measured: Vec<usize> = (0..3).filter(|c| (bits >> c) & 1 == 0).collect();
    if measured.is_empty() || expected.min_element() <= 0.0 || seen.min_element() <= 0.0 {
        return None;
    }
    let sum: f32 = measured.iter().map(|&c| (seen[c] / expected[c]).ln()).sum();
    let level = (sum / measured.len() as f32).exp();
    Some(seen.max(where_clipped(bits, expected * level)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A surface of known hue: what is clipped comes back, and what is not stays.
    #[test]
    fn clipped_channels_follow_from_the_others() {
        let truth = Vec3::new(1.8, 1.2, 0.6);
        let seen = truth.min(Vec3::ONE);
        let found = by_hue(0b011, seen, truth * 0.7).expect("blue is known");
        assert!((found / truth - 1.0).abs().max_element() < 1e-5, "{found}");
        // never below the ceiling, and nothing without a channel or a hue
        let found = by_hue(0b001, seen, Vec3::new(0.1, 1.0, 0.6)).expect("known");
        assert_eq!(found, seen);
        assert!(by_hue(0b111, seen, truth).is_none());
        assert!(by_hue(0b001, seen, Vec3::ZERO).is_none());
    }
}
