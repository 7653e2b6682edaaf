//! Which triangles are worth sampling as lights, and how they are gathered into lamps.

use super::light_model::{LightModel, PLACES};
use super::primitives::SHORT;
use crate::core::geometry::Mesh;
use crate::core::trace::{Hit, Ray, Tracer};
use glam::Vec3;

/// Reflecting triangles this many times brighter than the mean are sampled like lamps.
/// Measured: ×½ albedo +0.1 dB, ×2 albedo +0.1 dB (docs/constants.md).
const BRIGHT: f64 = 2.5;
/// At most this many lamps, and portals; more are merged with their neighbours in space.
/// Measured: ×½ little, ×2 roughness +2.7 dB (docs/constants.md).
pub(super) const MAX_LAMPS: usize = 128;

/// Triangles worth sampling: the emissive ones, and those that reflect much more light than the
/// average surface (a window sill in the sun). Sampling the latter changes no estimate, only its
/// noise.
pub(super) fn bright_sets(mesh: &Mesh, model: &dyn LightModel, power: &[f64]) -> [Vec<u32>; 2] {
    let area: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| f64::from(mesh.area(t)))
        .collect();
    let reflecting = |t: usize| !model.is_emissive(t) && area[t] > 0.0;
    let (sum, total) = (0..area.len())
        .filter(|&t| reflecting(t))
        .fold((0.0, 0.0), |s, t| (s.0 + power[t], s.1 + area[t]));
    let threshold = BRIGHT * sum / f64::max(total, f64::MIN_POSITIVE);
    let emissive = (0..area.len())
        .filter(|&t| model.is_emissive(t) && area[t] > 0.0)
        .map(|t| t as u32)
        .collect();
    let bright = (0..area.len())
        .filter(|&t| reflecting(t) && power[t] > threshold * area[t])
        .map(|t| t as u32)
        .collect();
    [emissive, bright]
}

/// The triangles that can be seen from right above somewhere. A shadow ray ends so close to its
/// source that it may overlook what covers that: a hidden twin of a lamp would shine through it.
/// Hemisphere rays meet whatever is dropped here and visible after all. What shines to both sides
/// stays.
pub(super) fn uncovered(
    mesh: &Mesh,
    model: &dyn LightModel,
    tracer: &dyn Tracer,
    triangles: Vec<u32>,
) -> Vec<u32> {
    let (lo, hi) = mesh.bounds();
    let above = 0.5 * SHORT * (hi - lo).length();
    let rays: Vec<Ray> = triangles
        .iter()
        .flat_map(|&t| {
            let normal = model.outward_normal(t as usize);
            PLACES.map(|(u, v)| {
                Ray::new(
                    mesh.position(t as usize, u, v) + normal * above,
                    -normal.normalize_or(Vec3::Y),
                    2.0 * above,
                )
            })
        })
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let seen = |i: usize| {
        model.outward_normal(triangles[i] as usize) == Vec3::ZERO
            || hits[PLACES.len() * i..][..PLACES.len()]
                .iter()
                .any(|h| h.triangle == triangles[i])
    };
    (0..triangles.len())
        .filter(|&i| seen(i))
        .map(|i| triangles[i])
        .collect()
}

/// Splits items into at most `most` compact groups by cutting the largest group at its widest gap
/// until groups are smaller than `small`.
pub(super) fn split_into_lamps(
    centre: &dyn Fn(u32) -> Vec3,
    small: f32,
    most: usize,
    items: Vec<u32>,
) -> Vec<Vec<u32>> {
    let mut groups = if items.is_empty() {
        vec![]
    } else {
        vec![items]
    };
    loop {
        let extent = |g: &Vec<u32>| {
            let b = g
                .iter()
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, &t| {
                    (b.0.min(centre(t)), b.1.max(centre(t)))
                });
            b.1 - b.0
        };
        let largest = groups
            .iter()
            .enumerate()
            .filter(|(_, g)| g.len() > 1)
            .map(|(i, g)| (i, extent(g)))
            .max_by(|a, b| a.1.max_element().total_cmp(&b.1.max_element()));
        let Some((i, e)) = largest else { break };
        if e.max_element() < small || groups.len() >= most {
            break;
        }
        let axis = if e.x >= e.y && e.x >= e.z {
            0
        } else if e.y >= e.z {
            1
        } else {
            2
        };
        let mut g = std::mem::take(&mut groups[i]);
        g.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
        // cut at the widest gap, so that separate lamps stay whole
        let cut = (1..g.len())
            .max_by(|&a, &b| {
                let gap = |k: usize| centre(g[k])[axis] - centre(g[k - 1])[axis];
                gap(a)
                    .total_cmp(&gap(b))
                    .then(b.abs_diff(g.len() / 2).cmp(&a.abs_diff(g.len() / 2)))
            })
            .unwrap_or(1);
        let tail = g.split_off(cut);
        groups[i] = g;
        groups.push(tail);
    }
    groups
}
