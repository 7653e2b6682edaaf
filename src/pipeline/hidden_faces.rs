//! Faces of lamps that no view shows clearly: whether they shine.
//!
//! A label says that a surface belongs to a lamp, and nothing of the light that its hidden faces send:
//! the upper half of a shade shines like the lower one, the back of a panel does not. What such faces would light, the
//! ceiling above all, is in the photographs. Under the right light, surface of one class has everywhere the
//! same πL/E but for its texture; under that of faces that are dark it seems black beside them. So a class of lamps
//! loses its hidden faces where the photographs are surely likelier without their light; what these held to it and
//! is apart without them (the tip of what closes the space above a panel) is then asked about likewise. Called by `light`.

use super::known_lights::owners;
use super::light_basis::{Sources, light_of};
use super::texel_radiance::texture_of;
use crate::core::geometry::clusters;
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, SURELY, USUALLY, design_effect, median};
use crate::core::texture::{SurfacePoint, Texels};
use crate::irradiance::IrradianceOptions;
use crate::observed::Surface;
use crate::radiance::Environment;
use crate::solution::lamp_gap;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

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
    if hidden.parts.is_empty() {
        return None;
    }
    let rows = rows(surface, lamps, first, &hidden);
    let dark = dark_parts(&hidden.parts, |k, dark| {
        let errors = match hidden.parts[k].kind {
            Kind::Unseen => SURELY,
            // what dark faces alone held is more likely dark itself
            Kind::Remnant => USUALLY,
        };
        denied(&rows, k, dark, errors)
    });
    if !dark.contains(&true) {
        return None;
    }
    let of_triangle = |part: &Option<usize>| part.is_some_and(|k| dark[k]);
    let parts = hidden.parts.iter().zip(&dark).filter(|(_, dark)| **dark);
    let classes: BTreeSet<u16> = parts.map(|(part, _)| part.class).collect();
    Some(DarkFaces {
        classes: classes.into_iter().collect(),
        triangles: hidden.part.iter().map(of_triangle).collect(),
    })
}

/// Which parts are dark, one by one: `denied` says whether one is, the ones before it being as given.
/// Remnants are asked about where they are apart.
fn dark_parts(parts: &[Part], denied: impl Fn(usize, &[bool]) -> bool) -> Vec<bool> {
    let mut dark = vec![false; parts.len()];
    for (k, part) in parts.iter().enumerate() {
        let is_apart = part.kind == Kind::Unseen || {
            let unseen = Part {
                kind: Kind::Unseen,
                ..*part
            };
            let held_by = parts.iter().position(|p| *p == unseen);
            held_by.is_some_and(|j| dark[j])
        };
        dark[k] = is_apart && denied(k, &dark);
    }
    dark
}

/// What [`dark_faces`] found.
pub(super) struct DarkFaces {
    /// Triangles of lamps that do not shine.
    pub(super) triangles: Vec<bool>,
    /// The classes of these lamps.
    pub(super) classes: Vec<u16>,
}

/// Why it is asked whether faces of a lamp shine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// No view shows them clearly.
    Unseen,
    /// Such faces alone hold them to their lamp.
    Remnant,
}

/// Faces of the lamps of one class that are asked about together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Part {
    kind: Kind,
    class: u16,
}

/// Faces that are asked about.
struct Hidden {
    /// Those that send enough to ask about: unseen ones first, then those that send most.
    parts: Vec<Part>,
    /// Index into `parts` of every triangle of one.
    part: Vec<Option<usize>>,
}

impl Hidden {
    fn of(surface: &Surface, lamps: &[bool], sent: &[Vec3]) -> Self {
        let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
        let mut clear = vec![0i32; lamps.len()];
        let mut labels = BTreeMap::<usize, Vec<u16>>::new();
        let mut sent_by = BTreeMap::<usize, f32>::new();
        for (i, p) in texels.point.iter().enumerate() {
            let t = p.triangle as usize;
            clear[t] += if surface.fusion.clean[i] { 1 } else { -1 };
            if lamps[t] {
                labels.entry(t).or_default().push(surface.labels[i]);
                *sent_by.entry(t).or_default() += texels.area(mesh, i) * luminance(sent[i]);
            }
        }
        // (of a face at a lamp's outline views that graze it show a rim; one without a texel is as that whose it is)
        let owner = owners(mesh, texels);
        let is_hidden = |t: usize| clear[owner[t] as usize] < 0;
        let burning: Vec<u32> = (0..lamps.len() as u32)
            .filter(|&t| lamps[t as usize])
            .collect();
        let mut part: Vec<Option<Part>> = vec![None; lamps.len()];
        let sends = |t: usize| sent_by.get(&t).copied().unwrap_or(0.0);
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
            let of = |kind: Kind| own.map(|class| Part { kind, class });
            let (unseen, seen): (Vec<u32>, Vec<u32>) =
                lamp.iter().partition(|&&t| is_hidden(t as usize));
            unseen
                .iter()
                .for_each(|&t| part[t as usize] = of(Kind::Unseen));
            if !unseen.is_empty() {
                let mut pieces = clusters(mesh, &seen, lamp_gap(mesh));
                let power = |piece: &[u32]| piece.iter().map(|&t| sends(t as usize)).sum::<f32>();
                // the lamp itself
                pieces.sort_by(|a, b| power(b).total_cmp(&power(a)));
                let remnants = pieces.iter().skip(1).flatten();
                remnants.for_each(|&t| part[t as usize] = of(Kind::Remnant));
            }
        }
        let all: f32 = sent_by.values().sum();
        let mut power = BTreeMap::<Part, f32>::new();
        for (t, part) in part.iter().enumerate() {
            if let Some(part) = part {
                *power.entry(*part).or_default() += sends(t);
            }
        }
        let mut found: Vec<(Part, f32)> = power.into_iter().collect();
        found.retain(|(_, p)| *p > LEAST_POWER * all);
        found.sort_by(|(a, p), (b, q)| a.kind.cmp(&b.kind).then(q.total_cmp(p)));
        let parts: Vec<Part> = found.into_iter().map(|(part, _)| part).collect();
        let index = |part: Part| parts.iter().position(|p| *p == part);
        Self {
            part: part.into_iter().map(|p| p.and_then(index)).collect(),
            parts,
        }
    }

    /// Irradiance of each part alone.
    fn light(&self, surface: &Surface, first: FirstLight<'_>) -> Vec<RgbPlane> {
        let texels = &surface.texels;
        let three = |from: usize| {
            let sent = |(p, l): (&SurfacePoint, &Vec3)| {
                let mut sent = Vec3::ZERO;
                let part = self.part[p.triangle as usize];
                if let Some(c) = part.filter(|k| (from..from + 3).contains(k)) {
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
        (0..self.parts.len()).step_by(3).map(three).collect()
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
    /// What each part of the hidden faces adds to that.
    hidden: Vec<f32>,
}

/// Least share of its irradiance that a place keeps without hidden faces: two bakes of few samples
/// differ by as much.
const LEAST_KEPT: f32 = 0.05;

impl Row {
    /// ln πL/E without some parts of the hidden faces.
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
        hidden: (0..hidden.parts.len())
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

/// Whether the photographs are likelier by that many standard `errors` if part `k` of the hidden faces is
/// dark, the others being as `dark` says: by deviations of Laplace's distribution, of as many
/// independent places as the surface has.
fn denied(rows: &BTreeMap<u16, Vec<Row>>, k: usize, dark: &[bool], errors: f32) -> bool {
    let without: Vec<bool> = (0..dark.len()).map(|j| dark[j] || j == k).collect();
    let gain = |of: &Vec<Row>| {
        let [shining, off] = [dark, &without].map(|dark| Scatter::of(of, dark));
        let independent = of.len() as f64 / shining.design.max(off.design);
        independent * (shining.deviation / off.deviation).ln()
    };
    let gain: f64 = (rows.values().filter(|of| of.len() >= ENOUGH))
        .map(gain)
        .sum();
    gain > f64::from(errors * errors / 2.0)
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
    fn remnants_are_asked_about_where_dark_faces_held_them() {
        let part = |kind, class| Part { kind, class };
        let parts = [
            part(Kind::Unseen, 3),
            part(Kind::Unseen, 4),
            part(Kind::Remnant, 4),
            part(Kind::Remnant, 3),
            part(Kind::Remnant, 5),
        ];
        let all_but_class_3 = |k: usize, _: &[bool]| k != 0;
        let dark = dark_parts(&parts, all_but_class_3);
        assert_eq!(dark, [false, true, true, false, false]);
        // each is judged with those before it out of the light
        let after = |k: usize, dark: &[bool]| k != 2 || dark == [true, true, false, false, false];
        assert_eq!(dark_parts(&parts, after), [true, true, true, true, false]);
    }

    #[test]
    fn what_hidden_faces_light_says_whether_they_shine() {
        assert!(denied(&room(false), 0, &[false, false], SURELY));
        assert!(!denied(&room(true), 0, &[false, false], SURELY));
        assert!(
            !denied(&room(true), 1, &[false, false], SURELY),
            "even light says nothing"
        );
        assert!(
            !denied(&BTreeMap::new(), 0, &[false], SURELY),
            "nothing says nothing"
        );
    }
}
