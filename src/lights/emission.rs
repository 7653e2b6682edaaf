//! Which triangles emit: those that send out more light than any surface could reflect there.

use std::collections::BTreeMap;

/// A texel emits if its least bright clean view exceeds this multiple of what a white surface could
/// reflect there. Derived: endless ceilings that shine all over, above a floor that reflects half, exceed it by 1 / 0.5.
const MIN_EXCESS: f32 = 2.0;
/// How much brighter than the brightest reflecting surfaces (99 % quantile of E/π) an unlabelled
/// emitter must be.
/// Measured: ×½ roughness −0.3 dB, ×2 same bits (docs/constants.md).
const BRIGHTER: f32 = 3.0;

/// What one texel says about emission.
#[derive(Clone, Copy, Debug)]
pub struct EmissionEvidence {
    /// Triangle of the texel.
    pub triangle: u32,
    /// Class of the texel, 0 = unlabelled.
    pub label: u16,
    /// Luminance of the least bright clean view.
    pub floor: f32,
    /// Luminance a white diffuse surface would send out there, E/π.
    pub white: f32,
    /// Whether any view sees the texel.
    pub observed: bool,
}

/// Finds emissive triangles: those of `known` emitters, and those that send out more than a white
/// surface could reflect (method §12.3 point 3; scale-free, unlike the paper's absolute threshold).
/// Because irradiance in dark corners is uncertain, the excess alone does not suffice: the surface
/// must also be brighter than the brightest reflecting surfaces of the scene, by far where no label
/// says that most of its class is.
#[must_use]
pub fn detect_emissive(triangles: usize, texels: &[EmissionEvidence], known: &[bool]) -> Vec<bool> {
    let exceeds = |e: &EmissionEvidence| e.observed && e.floor > MIN_EXCESS * e.white;
    let mut white: Vec<f32> = texels
        .iter()
        .filter(|e| e.observed)
        .map(|e| e.white)
        .collect();
    white.sort_by(f32::total_cmp);
    let brightest_reflection = white.get(white.len() * 99 / 100).copied().unwrap_or(0.0);
    let mut classes: BTreeMap<u16, (u64, u64)> = BTreeMap::new();
    let mut votes = vec![(0u32, 0u32, 0u32); triangles];
    for e in texels.iter().filter(|e| e.observed) {
        let class = classes.entry(e.label).or_default();
        class.1 += 1;
        class.0 += u64::from(exceeds(e) && e.floor > brightest_reflection);
        let v = &mut votes[e.triangle as usize];
        v.2 += 1;
        v.0 += u32::from(exceeds(e));
        v.1 += u32::from(exceeds(e) && e.floor > BRIGHTER * brightest_reflection);
    }
    let emitting_class: BTreeMap<u16, bool> = classes
        .iter()
        .map(|(k, c)| (*k, *k != 0 && 2 * c.0 > c.1))
        .collect();
    let mut label = vec![0u16; triangles];
    for e in texels {
        label[e.triangle as usize] = e.label;
    }
    (0..triangles)
        .map(|t| {
            let (excess, bright, seen) = votes[t];
            let by_class =
                2 * excess > seen && emitting_class.get(&label[t]).copied().unwrap_or(false);
            known[t] || (seen > 0 && (2 * bright > seen || by_class))
        })
        .collect()
}
