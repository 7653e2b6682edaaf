//! Radiance of texels before any light is baked: as views show it, on lamps and where nobody looks too.

use crate::core::geometry::clusters;
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::texture::{Texels, fill_uncovered};
use crate::observed::{Surface, coverage};
use crate::solution::lamp_gap;
use glam::Vec3;
use std::collections::BTreeMap;

/// Triangles of which it is known whether they shine.
pub(super) struct KnownFaces {
    /// Lamps.
    pub(super) lamps: Vec<bool>,
    /// Faces of lamps that do not shine, whatever views that graze them show; empty if there are none.
    pub(super) dark: Vec<bool>,
}

impl KnownFaces {
    /// Whether covered texel `i` lies on a dark face of a lamp.
    pub(super) fn is_dark(&self, surface: &Surface, i: usize) -> bool {
        !self.dark.is_empty() && lit(surface, &self.dark, i)
    }
}

/// Values of covered texels as a texture, filled outside charts.
pub(crate) fn texture_of(texels: &Texels, values: &[Vec3]) -> RgbPlane {
    fill_uncovered(&texels.scatter(values, Vec3::ZERO), &coverage(texels))
}

/// Values of the texels that are `observed` as a texture, filled from beside them.
pub(super) fn filled_radiance(surface: &Surface, values: &[Vec3], observed: &[bool]) -> RgbPlane {
    let plane = surface.texels.scatter(values, Vec3::ZERO);
    fill_uncovered(&plane, &surface.texels.scatter(observed, false))
}

/// A first look at the radiance: where no clean pixel shows it, that of texels nearby in the atlas.
/// Lamps are no guide to those around them: unseen books beside a lamp's chart would shine like the
/// lamp, and light their shelf.
pub(super) fn first_radiance(surface: &Surface, values: &[Vec3], known: &KnownFaces) -> RgbPlane {
    let lamp = |i: usize| lit(surface, &known.lamps, i);
    let guides: Vec<bool> = (0..values.len())
        .map(|i| surface.fusion.clean[i] && !lamp(i) && !known.is_dark(surface, i))
        .collect();
    let mut plane = filled_radiance(surface, values, &guides);
    (0..values.len())
        .filter(|&i| lamp(i))
        .for_each(|i| plane.data[surface.texels.cell[i] as usize] = values[i]);
    plane
}

/// Whether covered texel `i` lies on a triangle marked in `emissive`.
pub(super) fn lit(surface: &Surface, emissive: &[bool], i: usize) -> bool {
    emissive[surface.texels.point[i].triangle as usize]
}

/// Observed radiance; on emitters without a clean pixel the brightest view, and where no view sees
/// them the median of their lamp, or that of their class if the whole lamp is unseen: a lamp of few
/// pixels must not count as dark, for all albedos hang on its light.
pub(super) fn trusted_radiance(surface: &Surface, emissive: &[bool]) -> Vec<Vec3> {
    let f = &surface.fusion;
    let look = |i: usize| {
        if lit(surface, emissive, i) && !f.clean[i] {
            f.peak[i]
        } else {
            f.radiance[i]
        }
    };
    let emitting: Vec<u32> = (0..emissive.len() as u32)
        .filter(|&t| emissive[t as usize])
        .collect();
    let mut lamp_of = vec![0usize; emissive.len()];
    for (lamp, triangles) in clusters(
        &surface.scene.mesh,
        &emitting,
        lamp_gap(&surface.scene.mesh),
    )
    .iter()
    .enumerate()
    {
        triangles.iter().for_each(|&t| lamp_of[t as usize] = lamp);
    }
    let lamp = |i: usize| lamp_of[surface.texels.point[i].triangle as usize];
    let (mut of_lamp, mut of_class) = (
        BTreeMap::<usize, Vec<Vec3>>::new(),
        BTreeMap::<u16, Vec<Vec3>>::new(),
    );
    for i in (0..f.radiance.len()).filter(|&i| lit(surface, emissive, i) && f.views[i] > 0) {
        of_lamp.entry(lamp(i)).or_default().push(look(i));
        of_class.entry(surface.labels[i]).or_default().push(look(i));
    }
    let of_lamp: BTreeMap<usize, Vec3> = of_lamp
        .into_iter()
        .map(|(k, v)| (k, median_light(v)))
        .collect();
    let of_class: BTreeMap<u16, Vec3> = of_class
        .into_iter()
        .map(|(k, v)| (k, median_light(v)))
        .collect();
    (0..f.radiance.len())
        .map(|i| {
            let unseen = f.views[i] == 0 && lit(surface, emissive, i);
            let others = || {
                of_lamp
                    .get(&lamp(i))
                    .or_else(|| of_class.get(&surface.labels[i]))
                    .copied()
            };
            unseen.then(others).flatten().unwrap_or_else(|| look(i))
        })
        .collect()
}

/// The colour of median luminance.
fn median_light(mut values: Vec<Vec3>) -> Vec3 {
    values.sort_by(|a, b| luminance(*a).total_cmp(&luminance(*b)));
    values[values.len() / 2]
}
