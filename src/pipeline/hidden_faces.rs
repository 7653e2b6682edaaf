//! Faces of lamps that no view shows clearly: whether they shine.
//!
//! A label says that a surface belongs to a lamp, and nothing of the light that its hidden faces send:
//! the upper half of a shade shines like the lower one, the back of a panel does not. What such faces would light, the
//! ceiling above all, is in the photographs. Under the right light, surface of one class has everywhere the
//! same πL/E but for its texture; under that of faces that are dark it seems black beside them. So a class of lamps
//! loses its hidden faces where the photographs are surely likelier without their light. Called by `light`.

use super::light_basis::{Sources, light_of};
use super::texel_radiance::texture_of;
use crate::core::geometry::clusters;
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, SURELY, design_effect, median};
use crate::core::texture::{SurfacePoint, Texels};
use crate::irradiance::IrradianceOptions;
use crate::observed::Surface;
use crate::radiance::Environment;
use crate::solution::lamp_gap;
use glam::Vec3;
use std::collections::BTreeMap;

/// Share of the lamps' power below which hidden faces are not asked about. Derived: the irradiance is meant to be
/// right within 2 %.
const LEAST_POWER: f32 = 0.02;
/// Pieces of surface that are asked.
const ROWS: usize = 50_000;
/// Least mean deviation of ln πL/E within a class: bakes of few samples leave as much on perfect paint.
/// Measured: 1.6 to 2.3 % on grey-white-room (docs/lab/clipped-light.md).
const LEAST_DEVIATION: f64 = 0.02;

/// The light as a first bake shows it, every hidden face shining.
#[derive(Clone, Copy)]
pub(super) struct FirstLight<'a> {
    /// Radiance of the surface's texels.
    pub(super) sent: &'a [Vec3],
    /// Texels of the bake.
    pub(super) texels: &'a Texels,
    /// Their irradiance as a texture.
    pub(super) irradiance: &'a RgbPlane,
    /// Rays and emitter samples for the light of hidden faces alone.
    pub(super) options: &'a IrradianceOptions,
}

/// The hidden faces of `lamps` that the photographs say are dark; `None` if all shine.
pub(super) fn dark_faces(
    surface: &Surface,
    lamps: &[bool],
    first: FirstLight<'_>,
) -> Option<DarkFaces> {
    let hidden = Hidden::of(surface, lamps, first.sent);
    if hidden.classes.is_empty() {
        return None;
    }
    let rows = rows(surface, lamps, first, &hidden);
    let mut dark = vec![false; hidden.classes.len()];
    for k in 0..dark.len() {
        dark[k] = denied(&rows, k, &dark);
    }
    if !dark.contains(&true) {
        return None;
    }
    let of_triangle = |class: &Option<usize>| class.is_some_and(|k| dark[k]);
    let classes = hidden.classes.iter().zip(&dark);
    Some(DarkFaces {
        classes: classes.filter(|(_, d)| **d).map(|(c, _)| *c).collect(),
        triangles: hidden.class.iter().map(of_triangle).collect(),
    })
}

/// What [`dark_faces`] found.
pub(super) struct DarkFaces {
    /// Triangles of lamps that do not shine.
    pub(super) triangles: Vec<bool>,
    /// The classes of these lamps.
    pub(super) classes: Vec<u16>,
}

/// Hidden faces by the class of their lamp.
struct Hidden {
    /// Classes whose hidden faces send enough to ask about, those that send most first.
    classes: Vec<u16>,
    /// Index into `classes` of every hidden triangle of one.
    class: Vec<Option<usize>>,
}

impl Hidden {
    fn of(surface: &Surface, lamps: &[bool], sent: &[Vec3]) -> Self {
        let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
        let mut clear = vec![0i32; lamps.len()];
        let mut labels = BTreeMap::<usize, Vec<u16>>::new();
        for (i, p) in texels.point.iter().enumerate() {
            let t = p.triangle as usize;
            clear[t] += if surface.fusion.clean[i] { 1 } else { -1 };
            if lamps[t] {
                labels.entry(t).or_default().push(surface.labels[i]);
            }
        }
        // (of a face at a lamp's outline views that graze it show a rim)
        let is_hidden = |t: usize| clear[t] < 0;
        let burning: Vec<u32> = (0..lamps.len() as u32)
            .filter(|&t| lamps[t as usize])
            .collect();
        let mut class: Vec<Option<u16>> = vec![None; lamps.len()];
        for lamp in clusters(mesh, &burning, lamp_gap(mesh)) {
            // hidden faces have the label of whatever lies nearest
            let of = |hidden: bool| {
                let faces = lamp.iter().map(|&t| t as usize);
                let some = faces.filter(move |&t| is_hidden(t) == hidden);
                some.filter_map(|t| labels.get(&t))
                    .flatten()
                    .copied()
                    .collect::<Vec<u16>>()
            };
            let own = most_frequent(of(false)).or_else(|| most_frequent(of(true)));
            for t in lamp.iter().map(|&t| t as usize).filter(|&t| is_hidden(t)) {
                class[t] = own;
            }
        }
        let (mut power, mut all) = (BTreeMap::<u16, f32>::new(), 0.0);
        for (i, p) in texels.point.iter().enumerate() {
            let t = p.triangle as usize;
            if lamps[t] {
                let sent = texels.area(mesh, i) * luminance(sent[i]);
                all += sent;
                if let Some(class) = class[t] {
                    *power.entry(class).or_default() += sent;
                }
            }
        }
        let mut found: Vec<(u16, f32)> = power.into_iter().collect();
        found.retain(|(_, p)| *p > LEAST_POWER * all);
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        let classes: Vec<u16> = found.into_iter().map(|(c, _)| c).collect();
        let index = |c: u16| classes.iter().position(|k| *k == c);
        Self {
            class: class.into_iter().map(|c| c.and_then(index)).collect(),
            classes,
        }
    }

    /// Irradiance of each class's hidden faces alone.
    fn light(&self, surface: &Surface, first: FirstLight<'_>) -> Vec<RgbPlane> {
        let texels = &surface.texels;
        let three = |from: usize| {
            let sent = |(p, l): (&SurfacePoint, &Vec3)| {
                let mut sent = Vec3::ZERO;
                let class = self.class[p.triangle as usize];
                if let Some(c) = class.filter(|k| (from..from + 3).contains(k)) {
                    sent[c - from] = luminance(*l);
                }
                sent
            };
            let sources = Sources {
                sent: texels.point.iter().zip(first.sent).map(sent).collect(),
                environment: Environment::black(),
            };
            let light = light_of(surface, sources, first.texels, first.options);
            texture_of(first.texels, &light)
        };
        (0..self.classes.len()).step_by(3).map(three).collect()
    }
}

/// The label that occurs most often, the smallest of several; `None` without any.
fn most_frequent(labels: Vec<u16>) -> Option<u16> {
    let mut counts = BTreeMap::<u16, usize>::new();
    labels
        .into_iter()
        .for_each(|l| *counts.entry(l).or_default() += 1);
    counts
        .into_iter()
        .min_by_key(|(l, n)| (std::cmp::Reverse(*n), *l))
        .map(|(l, _)| l)
}

/// A piece of surface that reflects.
struct Row {
    position: Vec3,
    /// ln πL.
    log_radiosity: f32,
    /// Luminance of its irradiance, every hidden face shining.
    light: f32,
    /// What the hidden faces of each class add to that.
    hidden: Vec<f32>,
}

/// Least share of its irradiance that a place keeps without hidden faces: two bakes of few samples
/// differ by as much.
const LEAST_KEPT: f32 = 0.05;

impl Row {
    /// ln πL/E without the hidden faces of some classes.
    fn log_albedo(&self, dark: &[bool]) -> f32 {
        let less: f32 = (self.hidden.iter().zip(dark))
            .map(|(h, dark)| if *dark { *h } else { 0.0 })
            .sum();
        self.log_radiosity - (self.light - less).max(LEAST_KEPT * self.light).ln()
    }
}

/// Surface that views see clearly, evenly drawn, by class.
fn rows(
    surface: &Surface,
    lamps: &[bool],
    first: FirstLight<'_>,
    hidden: &Hidden,
) -> BTreeMap<u16, Vec<Row>> {
    let (mesh, texels, fusion) = (&surface.scene.mesh, &surface.texels, &surface.fusion);
    let light = hidden.light(surface, first);
    let useful: Vec<usize> = (0..texels.len())
        .filter(|&i| fusion.clean[i] && texels.interior[i])
        .filter(|&i| !lamps[texels.point[i].triangle as usize])
        .collect();
    let row = |&i: &usize| Row {
        position: texels.position(mesh, i),
        log_radiosity: (std::f32::consts::PI * luminance(fusion.radiance[i])).ln(),
        light: luminance(texels.lookup(mesh, first.irradiance, i)),
        hidden: (0..hidden.classes.len())
            .map(|k| texels.lookup(mesh, &light[k / 3], i)[k % 3])
            .collect(),
    };
    let asked: Vec<(u16, Row)> = useful
        .par_iter()
        .step_by(useful.len().div_ceil(ROWS).max(1))
        .map(|i| (surface.labels[*i], row(i)))
        .filter(|(_, r)| r.log_radiosity.is_finite() && r.light > 0.0)
        .collect();
    by_class(asked)
}

fn by_class(rows: Vec<(u16, Row)>) -> BTreeMap<u16, Vec<Row>> {
    let mut out = BTreeMap::<u16, Vec<Row>>::new();
    for (class, row) in rows {
        out.entry(class).or_default().push(row);
    }
    out
}

/// Whether the photographs are surely likelier if the hidden faces of class `k` are dark, those of others being
/// as `dark` says: by deviations of Laplace's distribution, of as many independent places as the
/// surface has.
fn denied(rows: &BTreeMap<u16, Vec<Row>>, k: usize, dark: &[bool]) -> bool {
    let without: Vec<bool> = (0..dark.len()).map(|j| dark[j] || j == k).collect();
    let gain = |of: &Vec<Row>| {
        let [shining, off] = [dark, &without].map(|dark| Scatter::of(of, dark));
        let independent = of.len() as f64 / shining.design.max(off.design);
        independent * (shining.deviation / off.deviation).ln()
    };
    let gain: f64 = (rows.values().filter(|of| of.len() >= ENOUGH))
        .map(gain)
        .sum();
    gain > f64::from(SURELY * SURELY / 2.0)
}

/// How πL/E scatters within a class.
struct Scatter {
    /// Mean deviation of its logarithm from the median.
    deviation: f64,
    /// How many pieces of surface tell as much as one alone.
    design: f64,
}

impl Scatter {
    fn of(rows: &[Row], dark: &[bool]) -> Self {
        let values: Vec<f32> = rows.iter().map(|r| r.log_albedo(dark)).collect();
        let middle = median(values.clone()).unwrap_or(0.0);
        let apart: Vec<f64> = values.iter().map(|v| f64::from(v - middle)).collect();
        let places: Vec<Vec3> = rows.iter().map(|r| r.position).collect();
        let mean = apart.iter().map(|v| v.abs()).sum::<f64>() / apart.len().max(1) as f64;
        Self {
            deviation: mean.max(LEAST_DEVIATION),
            design: design_effect(&places, &apart),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ceiling of one paint and a wall, with a lamp's hidden side above (hidden light near it).
    fn room(shines: bool) -> BTreeMap<u16, Vec<Row>> {
        let rows = (0..2000)
            .map(|i| {
                let (x, y) = ((i % 50) as f32 * 0.1, (i / 50) as f32 * 0.1);
                let near = 1.0 / (0.05 + (x - 2.5).powi(2) + (y - 2.0).powi(2));
                let texture = 0.1 * ((i * 7919 % 1000) as f32 / 1000.0 - 0.5);
                let light = 1.0 + near;
                let sent = if shines { light } else { 1.0 };
                let row = Row {
                    position: Vec3::new(x, y, 0.0),
                    log_radiosity: (0.5 * sent).ln() + texture,
                    light,
                    hidden: vec![near, 0.3],
                };
                (1 + u16::from(i % 3 == 0), row)
            })
            .collect();
        by_class(rows)
    }

    #[test]
    fn what_hidden_faces_light_says_whether_they_shine() {
        assert!(denied(&room(false), 0, &[false, false]));
        assert!(!denied(&room(true), 0, &[false, false]));
        assert!(
            !denied(&room(true), 1, &[false, false]),
            "even light says nothing"
        );
        assert!(
            !denied(&BTreeMap::new(), 0, &[false]),
            "nothing says nothing"
        );
    }
}
