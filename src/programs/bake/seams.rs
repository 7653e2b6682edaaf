//! Seams: where one surface is cut into two charts, both sides of the cut are made to show the
//! same light.
//!
//! A bilinear lookup on the border of a chart mixes texels that lie differently on either side, so
//! that even a lightmap without noise shows its cuts. The texels at borders are moved as little as
//! possible so that lookups agree along the cut: least squares, min |x − x₀|² + λ Σ (a_s·x)², a_s
//! the difference of the two lookups at a point of the cut, by conjugate gradients on
//! (I + λ AᵀA) x = x₀ (Iwanicki, "Lighting Technology of The Last of Us", SIGGRAPH 2013).

use crate::core::geometry::{Mesh, SMOOTH, vector_key};
use crate::core::image::{RgbPlane, Wrap, bilinear_taps};
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// Weight of a difference across the cut beside that of a change of a texel. Derived: a step is
/// left with a hundredth of itself.
const STIFFNESS: f32 = 100.0;
/// Most steps of the conjugate gradients, and the share of the residual at which they end.
const STEPS: usize = 200;
const ENOUGH: f32 = 1e-5;

/// A point of a cut: the difference of its two lookups, as weights of texels.
type Difference = Vec<(u32, f32)>;

/// A cut edge: where its ends lie in either chart.
#[derive(Clone, Copy, Debug)]
struct Cut {
    one: [Vec2; 2],
    other: [Vec2; 2],
}

/// The cuts of a mesh's atlas, for maps of one size.
pub(super) struct Seams {
    /// Texels at cuts, ascending.
    cells: Vec<u32>,
    /// Of numbers among them.
    differences: Vec<Difference>,
}

impl Seams {
    /// Finds the cuts for maps of `side` texels.
    pub(super) fn new(mesh: &Mesh, side: usize) -> Self {
        let size = side as f32;
        let mut differences = Vec::new();
        for cut in cuts(mesh) {
            let length = |uv: [Vec2; 2]| (uv[1] - uv[0]).length() * size;
            let points = (2.0 * length(cut.one).max(length(cut.other)))
                .ceil()
                .max(1.0) as usize;
            for i in 0..points {
                let at = (i as f32 + 0.5) / points as f32;
                let taps = |uv: [Vec2; 2]| {
                    bilinear_taps(side, side, uv[0].lerp(uv[1], at) * size, Wrap::Clamp)
                };
                let mut sum: BTreeMap<u32, f32> = BTreeMap::new();
                for (cell, w) in taps(cut.one) {
                    *sum.entry(cell as u32).or_default() += w;
                }
                for (cell, w) in taps(cut.other) {
                    *sum.entry(cell as u32).or_default() -= w;
                }
                differences.push(sum.into_iter().filter(|(_, w)| *w != 0.0).collect());
            }
        }
        let differences: Vec<Difference> = differences;
        let mut cells: Vec<u32> = differences.iter().flatten().map(|d| d.0).collect();
        cells.sort_unstable();
        cells.dedup();
        let number = |cell: u32| cells.partition_point(|c| *c < cell) as u32;
        let numbered = |d: &Difference| d.iter().map(|&(c, w)| (number(c), w)).collect();
        Self {
            differences: differences.iter().map(numbered).collect(),
            cells,
        }
    }

    /// Number of points at which both sides of a cut are compared.
    pub(super) fn len(&self) -> usize {
        self.differences.len()
    }

    /// Root mean square of the differences across cuts, over all channels.
    pub(super) fn step(&self, map: &RgbPlane) -> f32 {
        let values = self.values(map);
        let squares = self
            .differences
            .iter()
            .map(|d| across(d, &values).length_squared());
        let sum = squares.fold(0.0f64, |sum, s| sum + f64::from(s) / 3.0);
        (sum / self.len().max(1) as f64).sqrt() as f32
    }

    /// Makes both sides of every cut of a map agree; light stays light.
    pub(super) fn close(&self, map: &mut RgbPlane) {
        let start = self.values(map);
        let mut x = start.clone();
        let residual = |x: &[Vec3]| -> Vec<Vec3> {
            let applied = self.applied(x);
            start.iter().zip(&applied).map(|(b, a)| *b - *a).collect()
        };
        // every channel has its own steps: the operator is the same
        let mut r = residual(&x);
        let mut p = r.clone();
        let mut rr = dot(&r, &r);
        let first = rr;
        for _ in 0..STEPS {
            if rr.cmple(first * ENOUGH * ENOUGH).all() {
                break;
            }
            let applied = self.applied(&p);
            let alpha = ratio(rr, dot(&p, &applied));
            x.iter_mut().zip(&p).for_each(|(x, p)| *x += alpha * *p);
            r.iter_mut()
                .zip(&applied)
                .for_each(|(r, a)| *r -= alpha * *a);
            let next = dot(&r, &r);
            let beta = ratio(next, rr);
            p.iter_mut().zip(&r).for_each(|(p, r)| *p = *r + beta * *p);
            rr = next;
        }
        for (&cell, value) in self.cells.iter().zip(x) {
            map.data[cell as usize] = value;
        }
    }

    fn values(&self, map: &RgbPlane) -> Vec<Vec3> {
        self.cells.iter().map(|&c| map.data[c as usize]).collect()
    }

    /// (I + λ AᵀA) x.
    fn applied(&self, x: &[Vec3]) -> Vec<Vec3> {
        let mut out = x.to_vec();
        for d in &self.differences {
            let step = STIFFNESS * across(d, x);
            d.iter().for_each(|&(i, w)| out[i as usize] += w * step);
        }
        out
    }
}

fn across(d: &Difference, x: &[Vec3]) -> Vec3 {
    d.iter().map(|&(i, w)| w * x[i as usize]).sum()
}

fn dot(a: &[Vec3], b: &[Vec3]) -> Vec3 {
    a.iter().zip(b).map(|(a, b)| *a * *b).sum()
}

fn ratio(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::select(
        b.cmpgt(Vec3::ZERO),
        a / b.max(Vec3::splat(f32::MIN_POSITIVE)),
        Vec3::ZERO,
    )
}

/// The edges along which a smooth surface is cut into charts.
fn cuts(mesh: &Mesh) -> Vec<Cut> {
    // a side of an edge: its ends from the lower position to the higher
    let mut edges: BTreeMap<[[u32; 3]; 2], Vec<[u32; 2]>> = BTreeMap::new();
    for corners in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let [pa, pb] = [a, b].map(|v| vector_key(mesh.positions[v as usize]));
            let side = if pa <= pb { [a, b] } else { [b, a] };
            edges
                .entry([pa.min(pb), pa.max(pb)])
                .or_default()
                .push(side);
        }
    }
    let mut out = Vec::new();
    for sides in edges.values() {
        let [one, other] = sides.as_slice() else {
            continue; // a border, or an edge where more than two surfaces meet
        };
        let uv = |side: &[u32; 2]| side.map(|v| mesh.uvs[v as usize]);
        let normal = |side: &[u32; 2], k: usize| mesh.normals[side[k] as usize];
        let smooth = (0..2).all(|k| normal(one, k).dot(normal(other, k)) > SMOOTH);
        if smooth && uv(one) != uv(other) {
            out.push(Cut {
                one: uv(one),
                other: uv(other),
            });
        }
    }
    out
}
