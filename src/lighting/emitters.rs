//! Emitters: which texels emit, and how to sample them from any point of the scene.
//!
//! Emissive triangles are gathered into lamps; space into cells. Per cell the lamps are chosen with probability proportional to
//! the irradiance they are found to send there, with traced visibility, so that lamps in other rooms cost no samples. A defensive
//! share keeps every lamp possible, hence the estimate unbiased.

use super::LightField;
use crate::geometry::Mesh;
use crate::math::luminance;
use crate::sampling::{AliasTable, SobolSequence, square_to_triangle};
use crate::trace::{Ray, Tracer};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// At most this many lamps; more are merged with their neighbours in space.
const MAX_LAMPS: usize = 256;
/// Cells along the longest side of the scene: about one metre in a flat.
const CELLS_LONGEST: f32 = 20.0;
/// Receivers per cell used to find which lamps reach it.
const PROBES: usize = 24;
/// Share of samples spread over all lamps by unoccluded irradiance.
const DEFENSIVE: f64 = 0.15;

/// A texel emits if its least bright clean view exceeds this multiple of what a white surface could reflect there.
const MIN_EXCESS: f32 = 2.0;

/// Finds emissive triangles: those of classes known to emit, and those whose texels send out more than a white surface could
/// reflect (π·L/E above [`MIN_EXCESS`] in every clean view; scale-free, method §12.3 point 3). `excess` holds π·L_min/E per
/// covered texel (0 where unknown), `triangle` the triangle of each.
#[must_use]
pub fn detect_emissive(triangles: usize, triangle: &[u32], excess: &[f32], known: &[bool]) -> Vec<bool> {
    let mut votes = vec![(0u32, 0u32); triangles];
    for (&t, &x) in triangle.iter().zip(excess) {
        if x > 0.0 {
            let v = &mut votes[t as usize];
            v.0 += u32::from(x > MIN_EXCESS);
            v.1 += 1;
        }
    }
    votes.iter().zip(known).map(|(v, k)| *k || (v.0 > 0 && 2 * v.0 > v.1)).collect()
}

/// A point on an emitter.
#[derive(Clone, Copy, Debug)]
pub struct EmitterSample {
    /// World position.
    pub position: Vec3,
    /// Unit normal on the emitting side.
    pub normal: Vec3,
    /// Radiance sent out.
    pub radiance: Vec3,
    /// Density per m².
    pub pdf_area: f32,
}

struct Lamp {
    triangles: Vec<u32>,
    table: AliasTable,
    centre: Vec3,
    power: f64,
}

/// Samples emissive triangles.
pub struct Emitters {
    lamps: Vec<Lamp>,
    /// Per mesh triangle: lamp and probability density per m² within the lamp; `None`-like for non-emitters.
    slot: BTreeMap<u32, (u32, f32)>,
    everywhere: Option<AliasTable>,
    cells: BTreeMap<[i32; 3], AliasTable>,
    cell_size: f32,
}

impl Emitters {
    /// Gathers the emissive triangles of `field` into lamps and learns which of them reach the `receivers`.
    #[must_use]
    pub fn new(mesh: &Mesh, field: &LightField, tracer: &dyn Tracer, receivers: &[(Vec3, Vec3)]) -> Self {
        let emissive: Vec<u32> =
            (0..mesh.triangles.len()).filter(|&t| field.is_emissive(t) && mesh.area(t) > 0.0).map(|t| t as u32).collect();
        let (lo, hi) = mesh.bounds();
        let cell_size = ((hi - lo).max_element() / CELLS_LONGEST).max(f32::MIN_POSITIVE);
        let mut out = Self { lamps: Vec::new(), slot: BTreeMap::new(), everywhere: None, cells: BTreeMap::new(), cell_size };
        for group in split_into_lamps(mesh, emissive) {
            out.add_lamp(mesh, field, group);
        }
        out.everywhere = AliasTable::new(&out.lamps.iter().map(|l| l.power).collect::<Vec<_>>());
        if out.lamps.len() > 1 {
            out.learn_cells(mesh, field, tracer, receivers);
        }
        out
    }

    fn add_lamp(&mut self, mesh: &Mesh, field: &LightField, triangles: Vec<u32>) {
        let powers: Vec<f64> = triangles.iter().map(|&t| triangle_power(mesh, field, t as usize)).collect();
        let Some(table) = AliasTable::new(&powers) else { return };
        let area: f32 = triangles.iter().map(|&t| mesh.area(t as usize)).sum();
        let centre =
            triangles.iter().map(|&t| mesh.position(t as usize, 1.0 / 3.0, 1.0 / 3.0) * mesh.area(t as usize)).sum::<Vec3>()
                / area;
        for (i, &t) in triangles.iter().enumerate() {
            self.slot.insert(t, (self.lamps.len() as u32, table.pmf(i) / mesh.area(t as usize)));
        }
        self.lamps.push(Lamp { triangles, table, centre, power: powers.iter().sum() });
    }

    fn learn_cells(&mut self, mesh: &Mesh, field: &LightField, tracer: &dyn Tracer, receivers: &[(Vec3, Vec3)]) {
        let mut members: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
        for (i, (p, _)) in receivers.iter().enumerate() {
            members.entry(self.cell(*p)).or_default().push(i);
        }
        let tables: Vec<_> = members
            .par_iter()
            .filter_map(|(cell, ids)| {
                let mut reached = vec![0.0f64; self.lamps.len()];
                let mut possible = vec![0.0f64; self.lamps.len()];
                let stride = (ids.len() / PROBES).max(1);
                let sequence = SobolSequence::new(
                    0x1a3b,
                    crate::sampling::hash_u64(cell[0] as u64, crate::sampling::hash_u64(cell[1] as u64, cell[2] as u64)),
                );
                for (probe, &i) in ids.iter().step_by(stride).take(PROBES).enumerate() {
                    let (p, n) = receivers[i];
                    for (k, lamp) in self.lamps.iter().enumerate() {
                        let u = sequence.point4((probe * self.lamps.len() + k) as u32);
                        let s = lamp_point(mesh, field, lamp, u);
                        let d = s.position - p;
                        let d2 = d.length_squared().max(1e-8);
                        let dir = d / d2.sqrt();
                        // the emitter's own cosine is left out: it varies over the lamp more than over the cell
                        let geometry = f64::from(n.dot(dir).max(0.05) / d2) * lamp.power;
                        possible[k] += geometry;
                        let mut hidden = [0u8];
                        tracer.occluded(&[segment(p + n * (1e-3 * d2.sqrt()), s.position)], &mut hidden);
                        if hidden[0] == 0 {
                            reached[k] += geometry;
                        }
                    }
                }
                let (r, p): (f64, f64) = (reached.iter().sum(), possible.iter().sum());
                let weights: Vec<f64> =
                    (0..self.lamps.len())
                        .map(|k| {
                            if r > 0.0 {
                                (1.0 - DEFENSIVE) * reached[k] / r + DEFENSIVE * possible[k] / p
                            } else {
                                possible[k] / p
                            }
                        })
                        .collect();
                AliasTable::new(&weights).map(|t| (*cell, t))
            })
            .collect();
        self.cells = tables.into_iter().collect();
    }

    fn cell(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell_size).floor().to_array().map(|x| x as i32)
    }

    /// Whether there is nothing to sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lamps.is_empty()
    }

    /// Number of lamps (groups of emissive triangles).
    #[must_use]
    pub fn lamp_count(&self) -> usize {
        self.lamps.len()
    }

    /// The lamp choice that suits points around `p`; pass it to [`Self::sample`] and [`Self::pdf_area`].
    #[must_use]
    pub fn choice_at(&self, p: Vec3) -> Option<&AliasTable> {
        self.cells.get(&self.cell(p)).or(self.everywhere.as_ref())
    }

    /// Draws a point on an emitter.
    #[must_use]
    pub fn sample(&self, mesh: &Mesh, field: &LightField, choice: &AliasTable, u: [f32; 4]) -> EmitterSample {
        let (lamp, _) = choice.sample(u[0]);
        let mut s = lamp_point(mesh, field, &self.lamps[lamp], u);
        s.pdf_area *= choice.pmf(lamp);
        s
    }

    /// Density per m² with which [`Self::sample`] draws a point on `triangle`.
    #[must_use]
    pub fn pdf_area(&self, choice: &AliasTable, triangle: u32) -> f32 {
        self.slot.get(&triangle).map_or(0.0, |(lamp, pdf)| choice.pmf(*lamp as usize) * pdf)
    }
}

/// A ray from `from` that ends just short of `to`.
pub(crate) fn segment(from: Vec3, to: Vec3) -> Ray {
    let d = to - from;
    let length = d.length();
    Ray::new(from, d / length.max(f32::MIN_POSITIVE), length * (1.0 - 1e-3))
}

fn lamp_point(mesh: &Mesh, field: &LightField, lamp: &Lamp, u: [f32; 4]) -> EmitterSample {
    let (i, _) = lamp.table.sample(u[1]);
    let t = lamp.triangles[i] as usize;
    let [b1, b2] = square_to_triangle([u[2], u[3]]);
    EmitterSample {
        position: mesh.position(t, b1, b2),
        normal: field.outward_normal(t),
        radiance: field.emitted(t, b1, b2),
        pdf_area: lamp.table.pmf(i) / mesh.area(t),
    }
}

/// Luminance × area, from a few points; a floor keeps dim corners possible.
fn triangle_power(mesh: &Mesh, field: &LightField, t: usize) -> f64 {
    const POINTS: [(f32, f32); 4] = [(1.0 / 3.0, 1.0 / 3.0), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)];
    let lum: Vec<f32> = POINTS.iter().map(|&(u, v)| luminance(field.emitted(t, u, v)).max(0.0)).collect();
    let peak = lum.iter().copied().fold(0.0, f32::max);
    f64::from((lum.iter().sum::<f32>() / 4.0).max(0.1 * peak).max(1e-12)) * f64::from(mesh.area(t))
}

/// Splits triangles into at most [`MAX_LAMPS`] compact groups by halving the largest extent until groups are lamp-sized.
fn split_into_lamps(mesh: &Mesh, triangles: Vec<u32>) -> Vec<Vec<u32>> {
    let (lo, hi) = mesh.bounds();
    let small = 0.02 * (hi - lo).length();
    let centre = |t: u32| mesh.position(t as usize, 1.0 / 3.0, 1.0 / 3.0);
    let mut groups = if triangles.is_empty() { vec![] } else { vec![triangles] };
    loop {
        let extent = |g: &Vec<u32>| {
            let b = g.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, &t| (b.0.min(centre(t)), b.1.max(centre(t))));
            b.1 - b.0
        };
        let largest = groups
            .iter()
            .enumerate()
            .filter(|(_, g)| g.len() > 1)
            .map(|(i, g)| (i, extent(g)))
            .max_by(|a, b| a.1.max_element().total_cmp(&b.1.max_element()));
        let Some((i, e)) = largest else { break };
        if e.max_element() < small || groups.len() >= MAX_LAMPS {
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
                gap(a).total_cmp(&gap(b)).then(b.abs_diff(g.len() / 2).cmp(&a.abs_diff(g.len() / 2)))
            })
            .unwrap_or(1);
        let tail = g.split_off(cut);
        groups[i] = g;
        groups.push(tail);
    }
    groups
}

impl Emitters {
    /// Centres and powers of the lamps, for reports.
    #[must_use]
    pub fn lamps(&self) -> Vec<(Vec3, f64)> {
        self.lamps.iter().map(|l| (l.centre, l.power)).collect()
    }
}
