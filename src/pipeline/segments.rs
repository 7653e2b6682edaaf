//! Segments of one material, where no photograph has labels.
//!
//! The mesh falls apart into smooth patches; each patch has a look: what it reflects of the light
//! that was baked, a = πL/E, by its luminance, its two hues and how much it scatters. Patches of one
//! look are one segment, found by the small-variance limit of a Dirichlet process mixture (DP-means;
//! Kulis and Jordan 2012): a patch farther than [`APART`] standard errors from every segment begins
//! one of its own, and segments move to the mean of their patches until nothing changes. Segments
//! then take the place of classes: roughness is fitted to them, paint is found on them. Called by
//! the stage of the light between its coarse bake and its fine one, which needs them where nobody looks.

use super::doubt::Doubt;
use super::{SolveOptions, Switch};
use crate::core::geometry::{numbered, smooth_patches};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::{MAD_SCALE, median};
use crate::core::texture::SurfacePoint;
use crate::inverse::BLACK;
use crate::observed::Surface;
use glam::{Vec3, Vec4};
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Cosine of the angle at which a face begins another patch. Derived: 30°, half of what parts the
/// faces of the flattest regular body that has edges to speak of (a hexagonal prism's 60°).
const SMOOTH: f32 = 0.866;
/// Standard errors of a patch's look: of ln luminance (light as baked), of its hues, of the logarithm
/// of its scatter. Measured on grey-white-room, aws-house and `synth` without labels (docs/lab/segments.md).
const LUMINANCE: f32 = 0.06;
const HUE: f32 = 0.05;
const SCATTER: f32 = 0.5;
/// Scatter that noise and light leave on paint (relative): less is not told apart.
const LEAST_SCATTER: f32 = 0.03;
/// Error of an albedo, relative, that two materials taken for one must be expected to make. Derived:
/// they differ by up to [`APART`] times [`LUMINANCE`], by a third of it either way for even odds
/// (uniform distribution, 2/√12).
const TAKEN_FOR_ONE: f32 = 0.29 * APART * LUMINANCE;
/// Error of an albedo, relative, by the light of rooms without labels: what nobody sees sends out is
/// guessed from segments. Measured: walls and panels of grey-white-room and `synth` (docs/lab/segments.md).
const LIGHT: f32 = 0.12;
/// Standard errors beyond which two looks are of two materials. Derived: 1.1 % of a look's four
/// normal numbers lie farther off (χ²₄).
const APART: f32 = 3.6;
/// Clean texels from which a patch has a look.
const ENOUGH: usize = 12;
/// Texels of a patch that tell its look at most.
const SAMPLES: usize = 4_000;
/// Rounds of DP-means at most; it ends when nothing changes.
const ROUNDS: usize = 30;
/// Cells along the scene's diagonal in which a patch without a look finds its neighbour. Derived: a
/// few centimetres in a room, several edges of furniture.
const CELLS: f32 = 100.0;

/// The look of a patch, in standard errors, and its area.
#[derive(Clone, Copy, Debug)]
struct Look {
    at: Vec4,
    area: f32,
}

/// What is known of the light before segments are.
#[derive(Clone, Copy)]
pub(super) struct LightSoFar<'a> {
    /// Irradiance of a coarse bake, filled outside charts.
    pub(super) irradiance: &'a RgbPlane,
    /// Emitting triangles.
    pub(super) emissive: &'a [bool],
}

/// The number of every texel's segment, from 1, and 0 where no patch tells; `None` where photographs
/// have labels.
pub(super) fn find_segments(
    surface: &Surface,
    light: LightSoFar<'_>,
    options: &SolveOptions,
    progress: &Progress,
) -> Option<Vec<u16>> {
    if surface.is_labelled() || options.segments == Switch::Off {
        return None;
    }
    let patch = smooth_patches(&surface.scene.mesh, SMOOTH);
    let looks = looks(surface, light, &patch);
    let order: Vec<u32> = looks.keys().copied().collect();
    let list: Vec<Look> = order.iter().map(|p| looks[p]).collect();
    let segments = dp_means(&list);
    let number = |s: &u32| u16::try_from(s + 1).unwrap_or(u16::MAX);
    let mut of_patch: BTreeMap<u32, u16> = (order.into_iter())
        .zip(segments.iter().map(number))
        .collect();
    adopt_unknown(surface, &patch, &mut of_patch);
    progress.note(format!(
        "no labels: {} patches of the mesh have {} looks, which take the place of classes",
        segments.len(),
        segments.iter().max().map_or(0, |m| m + 1)
    ));
    let label = |p: &SurfacePoint| of_patch.get(&patch[p.triangle as usize]).copied();
    let labels = surface.texels.point.iter().map(|p| label(p).unwrap_or(0));
    Some(labels.collect())
}

/// What segments in the place of classes are against a result.
pub(super) fn doubt_of_segments() -> Doubt {
    Doubt {
        what: "without labels two materials that look alike may be taken for one, and what unseen surface reflects is less known".into(),
        relative: f64::from(TAKEN_FOR_ONE.hypot(LIGHT)),
    }
}

/// The look of every patch that enough clean texels show.
fn looks(surface: &Surface, light: LightSoFar<'_>, patch: &[u32]) -> BTreeMap<u32, Look> {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for i in 0..texels.len() {
        let t = texels.point[i].triangle as usize;
        if surface.fusion.clean[i] && surface.fusion.views[i] > 0 && !light.emissive[t] {
            members.entry(patch[t]).or_default().push(i);
        }
    }
    let members: Vec<(u32, Vec<usize>)> = members.into_iter().collect();
    let found: Vec<Option<(u32, Look)>> = members
        .par_iter()
        .map(|(p, ids)| {
            let reflected = |i: usize| {
                let e = texels.lookup(mesh, light.irradiance, i);
                let known = e.min_element() > 0.0 && surface.fusion.radiance[i].is_finite();
                known.then(|| (surface.fusion.radiance[i] * PI / e).max(Vec3::splat(BLACK)))
            };
            let some = ids.iter().step_by(ids.len() / SAMPLES + 1);
            let values: Vec<Vec3> = some.filter_map(|&i| reflected(i)).collect();
            let area = |i: &usize| texels.area(mesh, *i);
            (values.len() >= ENOUGH).then(|| (*p, Look::of(&values, ids.iter().map(area).sum())))
        })
        .collect();
    found.into_iter().flatten().collect()
}

impl Look {
    fn of(values: &[Vec3], area: f32) -> Self {
        let middle =
            |of: &dyn Fn(&Vec3) -> f32| median(values.iter().map(of).collect()).unwrap_or(0.0);
        let log = middle(&|v| luminance(*v).ln());
        let scatter = MAD_SCALE * middle(&|v| (luminance(*v).ln() - log).abs());
        Self {
            at: Vec4::new(
                log / LUMINANCE,
                middle(&|v| (v.x / v.y).ln()) / HUE,
                middle(&|v| (v.z / v.y).ln()) / HUE,
                scatter.max(LEAST_SCATTER).ln() / SCATTER,
            ),
            area,
        }
    }
}

/// The segment of every look: DP-means from the largest on.
fn dp_means(looks: &[Look]) -> Vec<u32> {
    let mut order: Vec<usize> = (0..looks.len()).collect();
    order.sort_by(|&a, &b| looks[b].area.total_cmp(&looks[a].area));
    let mut centres: Vec<Vec4> = Vec::new();
    let mut of: Vec<usize> = vec![usize::MAX; looks.len()];
    for _ in 0..ROUNDS {
        let before = of.clone();
        for &k in &order {
            let distance = |c: &Vec4| c.distance_squared(looks[k].at);
            let nearest = (0..centres.len())
                .min_by(|&a, &b| distance(&centres[a]).total_cmp(&distance(&centres[b])));
            of[k] = match nearest.filter(|&n| distance(&centres[n]) <= APART * APART) {
                Some(n) => n,
                None => {
                    centres.push(looks[k].at);
                    centres.len() - 1
                }
            };
        }
        let mut sums = vec![(Vec4::ZERO, 0.0f32); centres.len()];
        for (look, &c) in looks.iter().zip(&of) {
            sums[c] = (sums[c].0 + look.at * look.area, sums[c].1 + look.area);
        }
        for (centre, (sum, area)) in centres.iter_mut().zip(&sums) {
            if *area > 0.0 {
                *centre = *sum / *area;
            }
        }
        if of == before {
            break;
        }
    }
    numbered(of)
}

/// Patches without a look take the segment of the patch nearest to them that has one: an edge's is
/// that of what it bounds.
fn adopt_unknown(surface: &Surface, patch: &[u32], of_patch: &mut BTreeMap<u32, u16>) {
    let mesh = &surface.scene.mesh;
    let known: Vec<(Vec3, u16)> = (0..mesh.triangles.len())
        .filter_map(|t| {
            let segment = of_patch.get(&patch[t])?;
            Some((mesh.position(t, 1.0 / 3.0, 1.0 / 3.0), *segment))
        })
        .collect();
    let (lo, hi) = mesh.bounds();
    let side = ((hi - lo).length() / CELLS).max(f32::MIN_POSITIVE);
    let cell = |p: Vec3| ((p - lo) / side).floor().as_ivec3().to_array();
    let mut cells: BTreeMap<[i32; 3], Vec<(Vec3, u16)>> = BTreeMap::new();
    for k in known {
        cells.entry(cell(k.0)).or_default().push(k);
    }
    let mut first_of: BTreeMap<u32, usize> = BTreeMap::new();
    for (t, p) in patch.iter().enumerate() {
        if !of_patch.contains_key(p) {
            first_of.entry(*p).or_insert(t);
        }
    }
    for (p, t) in first_of {
        let at = mesh.position(t, 1.0 / 3.0, 1.0 / 3.0);
        let [x, y, z] = cell(at);
        let near = (0..27)
            .filter_map(|k| cells.get(&[x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]))
            .flatten()
            .min_by(|a, b| a.0.distance(at).total_cmp(&b.0.distance(at)));
        if let Some((_, segment)) = near {
            of_patch.insert(p, *segment);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(albedo: Vec3, area: f32) -> Look {
        Look::of(&[albedo; 16], area)
    }

    /// Patches that differ by what the light is unknown to are one segment; another hue or another
    /// brightness is another, whatever the order.
    #[test]
    fn one_paint_in_uneven_light_is_one_segment() {
        let paint = Vec3::new(0.7, 0.7, 0.68);
        let mut looks: Vec<Look> = [1.0, 1.1, 0.93, 1.05]
            .map(|f| look(paint * f, 4.0))
            .to_vec();
        looks.push(look(Vec3::new(0.4, 0.2, 0.1), 9.0));
        looks.push(look(paint * 0.3, 2.0));
        let of = dp_means(&looks);
        assert!(of[..4].iter().all(|s| *s == of[0]), "{of:?}");
        assert!(of[4] != of[0] && of[5] != of[0] && of[4] != of[5], "{of:?}");
        looks.reverse();
        let mut back = dp_means(&looks);
        back.reverse();
        for (a, b) in [(0, 3), (0, 4), (4, 5)] {
            assert_eq!(of[a] == of[b], back[a] == back[b]);
        }
        assert!(dp_means(&[]).is_empty());
    }

    /// Grain parts wood from paint of its colour.
    #[test]
    fn grain_is_a_look() {
        let brown = Vec3::new(0.4, 0.25, 0.15);
        let wood: Vec<Vec3> = (0..40).map(|i| brown * (0.6 + 0.02 * i as f32)).collect();
        let looks = [look(brown, 5.0), Look::of(&wood, 5.0)];
        let of = dp_means(&looks);
        assert_ne!(of[0], of[1], "{looks:?}");
    }
}
