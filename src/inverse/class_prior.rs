//! What a texel's albedo should be expected to be before it is looked at: that of its class nearby.

use super::AlbedoEstimate;
use crate::geometry::Mesh;
use crate::math::luminance;
use crate::optim::{median, weighted_median};
use crate::texture::Texels;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Least relative standard deviation of the prior.
const PRIOR_SPREAD: f32 = 0.05;
/// Variance of the prior relative to that of the clean texels: surfaces at edges are often others
/// than those between them.
const PRIOR_DOUBT: f32 = 2.0;
/// Standard deviation of the prior where there is no class, or nothing of it is seen clean.
const ANYTHING: f32 = 0.3;

/// Texels within which the prior is gathered, and how many clean ones outweigh the class.
const REACH: f32 = 32.0;
const ENOUGH: f32 = 50.0;

/// Mean albedo and its variance from the clean texels of a texel's class: those nearby, as far as
/// they are frontal, sharp and not far from what is usual in the class; the class as a whole where
/// they are few.
pub(super) fn class_prior(
    albedo: &AlbedoEstimate,
    texels: &Texels,
    mesh: &Mesh,
    labels: &[u16],
    ids: &[u32],
) -> Vec<(Vec3, f32)> {
    let side = |i: usize| {
        texels
            .texel_area(mesh, texels.point[i].triangle as usize)
            .sqrt()
    };
    let stride = (texels.len() / 2_000_000).max(1);
    let clean: Vec<usize> = (0..texels.len())
        .step_by(stride)
        .filter(|&i| albedo.clean[i] && albedo.error[i].is_finite())
        .collect();
    let value = |i: usize| albedo.value[i].clamp(Vec3::ZERO, Vec3::ONE);
    // a wide footprint is a distant or a slanting look
    let sharp = median(clean.iter().map(|&i| albedo.footprint[i]).collect()).unwrap_or(1.0);
    let trust = |i: usize| {
        (sharp / albedo.footprint[i].max(f32::MIN_POSITIVE))
            .powi(2)
            .min(1.0)
    };
    let mut members: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    clean
        .iter()
        .for_each(|&i| members.entry(labels[i]).or_default().push(i));
    let class: BTreeMap<u16, (Vec3, f32)> = members
        .iter()
        .map(|(l, m)| (*l, typical(m, &value, &trust)))
        .collect();
    let all = typical(&clean, &value, &trust);
    let usual_side = median(
        clean
            .iter()
            .step_by(clean.len() / 4096 + 1)
            .map(|&i| side(i))
            .collect(),
    )
    .unwrap_or(1.0);
    let cube = usual_side.max(f32::MIN_POSITIVE) * REACH;
    let place = |i: usize| {
        (
            labels[i],
            (texels.position(mesh, i) / cube)
                .floor()
                .as_ivec3()
                .to_array(),
        )
    };
    let mut near: BTreeMap<(u16, [i32; 3]), [f64; 5]> = BTreeMap::new();
    for &i in &clean {
        let (usual, spread) = class[&labels[i]];
        let a = value(i);
        let odd = (luminance(a) - luminance(usual)).powi(2) / (9.0 * spread);
        let w = f64::from(trust(i) / (1.0 + odd));
        let sums = near.entry(place(i)).or_default();
        let l = f64::from(luminance(a));
        for (s, v) in
            sums.iter_mut()
                .zip([1.0, f64::from(a.x), f64::from(a.y), f64::from(a.z), l * l])
        {
            *s += w * v;
        }
    }
    ids.par_iter()
        .map(|&i| {
            let i = i as usize;
            let Some((usual, spread)) = class.get(&labels[i]).copied().filter(|_| labels[i] != 0)
            else {
                return (
                    if albedo.error[i].is_finite() {
                        value(i)
                    } else {
                        all.0
                    },
                    ANYTHING * ANYTHING,
                );
            };
            let Some(s) = near.get(&place(i)) else {
                return (usual, spread);
            };
            let total = s[0] as f32;
            let mean =
                Vec3::new(s[1] as f32, s[2] as f32, s[3] as f32) / total.max(f32::MIN_POSITIVE);
            let variance = s[4] as f32 / total.max(f32::MIN_POSITIVE) - luminance(mean).powi(2);
            let share = total / (total + ENOUGH);
            let mean = usual.lerp(mean, share);
            (
                mean,
                (variance.max(0.0) * share + spread * (1.0 - share))
                    .max((PRIOR_SPREAD * luminance(mean)).powi(2))
                    * PRIOR_DOUBT,
            )
        })
        .collect()
}

/// Weighted median of the albedos, channel by channel, and the variance of their luminance by its
/// median deviation.
fn typical(
    members: &[usize],
    value: &dyn Fn(usize) -> Vec3,
    trust: &dyn Fn(usize) -> f32,
) -> (Vec3, f32) {
    let some: Vec<usize> = members
        .iter()
        .copied()
        .step_by(members.len() / 40_000 + 1)
        .collect();
    let middle = |of: &dyn Fn(Vec3) -> f32| {
        let pairs: Vec<(f32, f32)> = some.iter().map(|&i| (of(value(i)), trust(i))).collect();
        weighted_median(&pairs).map(|k| pairs[k].0)
    };
    let Some(x) = middle(&|a| a.x) else {
        return (Vec3::splat(0.5), 0.1);
    };
    let centre = Vec3::new(
        x,
        middle(&|a| a.y).unwrap_or(x),
        middle(&|a| a.z).unwrap_or(x),
    );
    let deviation = middle(&|a| (luminance(a) - luminance(centre)).abs()).unwrap_or(0.0);
    (
        centre,
        (1.4826 * deviation)
            .max(PRIOR_SPREAD * luminance(centre))
            .max(1e-3)
            .powi(2),
    )
}
