//! Bounces between patches: J = ρ (D + F J), J being the exitance of a patch, by Jacobi's iteration,
//! each step of which is a bounce (Goral et al. 1984).

use super::links::LINKS;
use super::patches::{NONE, Patch, areas};
use crate::core::parallel::map_chunks;
use crate::core::parallel::prelude::*;
use crate::render::LightmapTexels;
use glam::{Vec3, Vec3A};

/// Share of the reflected light at which bounces of an edit end. Derived: a quarter of a step of 8
/// bits at full scale.
pub(super) const ANSWERED: f32 = 1e-3;
/// The same where nothing is edited, from which edits begin. Derived: far below the other.
pub(super) const SETTLED: f32 = 1e-5;
/// Bounces at most. Derived: 0.9^64 is about 1e-3.
const MOST_BOUNCES: u32 = 64;
/// Patches per parallel piece. Derived: a few tens of pieces.
const PIECE: usize = 64;
/// What a texel counts that nothing sees: in a patch of such texels there must be an area to divide
/// by. Derived: any small share.
const HIDDEN: f32 = 1e-4;

/// Area of every texel that is seen, m²: as large a share as `seen` tells of [`LINKS`].
pub(super) fn seen_areas(texels: &LightmapTexels<'_>, seen: &[u8]) -> Vec<f32> {
    let share = |s: u8| (f32::from(s) / LINKS as f32).max(HIDDEN);
    let whole = areas(texels);
    whole.iter().zip(seen).map(|(a, &s)| a * share(s)).collect()
}

/// Form factors F_ij: which share of what patch i sees is patch j. Rows are sparse and sum to 1 or,
/// where there are openings, less.
pub(super) struct FormFactors {
    /// Where each row begins, and the end of the last.
    starts: Vec<usize>,
    columns: Vec<u16>,
    shares: Vec<f32>,
}

impl FormFactors {
    /// Of the links of the patches' texels, each weighing as much as its texel's `areas`.
    pub(super) fn of_links(
        links: &[u16],
        of_texels: &[u16],
        areas: &[f32],
        patches: usize,
    ) -> Self {
        let mut members: Vec<Vec<u32>> = vec![Vec::new(); patches];
        for (i, &p) in of_texels.iter().enumerate() {
            members[usize::from(p)].push(i as u32);
        }
        let rows = map_chunks(patches, PIECE, |range| {
            let mut row = vec![0.0f32; usize::from(NONE) + 1];
            let of_patch = |p: usize| {
                let mut whole = 0.0;
                for &i in &members[p] {
                    let i = i as usize;
                    let area = areas[i];
                    whole += area * LINKS as f32;
                    for &link in &links[i * LINKS..(i + 1) * LINKS] {
                        row[usize::from(link)] += area;
                    }
                }
                row[usize::from(NONE)] = 0.0;
                let mut entries = Vec::new();
                for (j, share) in row[..patches].iter_mut().enumerate() {
                    if *share > 0.0 {
                        entries.push((j as u16, *share / whole));
                        *share = 0.0;
                    }
                }
                entries
            };
            range.map(of_patch).collect::<Vec<_>>()
        });
        let mut out = Self {
            starts: vec![0],
            columns: Vec::new(),
            shares: Vec::new(),
        };
        for row in rows.into_iter().flatten() {
            out.columns.extend(row.iter().map(|e| e.0));
            out.shares.extend(row.iter().map(|e| e.1));
            out.starts.push(out.columns.len());
        }
        out
    }

    /// The form factors of patch i, as (j, share).
    pub(super) fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.starts[i]..self.starts[i + 1];
        self.columns[range.clone()]
            .iter()
            .zip(&self.shares[range])
            .map(|(j, s)| (usize::from(*j), *s))
    }

    /// Irradiance of patch i from the exitances of all.
    fn gathered(&self, i: usize, exitance: &[Vec3A]) -> Vec3A {
        self.row(i).map(|(j, share)| exitance[j] * share).sum()
    }
}

/// The light of a scene after its bounces.
pub(super) struct Bounced {
    /// Exitance ρE of each patch, radiance unit times steradian.
    pub exitance: Vec<Vec3A>,
    /// Bounces computed.
    pub bounces: u32,
    /// Share of all reflected light that is left out at most, as far as it falls as it fell last.
    pub remainder: f32,
}

/// What is given to [`bounce`].
pub(super) struct Reflecting<'a> {
    /// The patches.
    pub patches: &'a [Patch],
    /// Between them.
    pub factors: &'a FormFactors,
    /// Reflectance of each.
    pub reflectance: &'a [Vec3],
    /// Direct irradiance of each.
    pub direct: &'a [Vec3],
    /// Remainder at which it ends.
    pub enough: f32,
}

/// Solves for the exitances, beginning with a guess.
pub(super) fn bounce(reflecting: &Reflecting<'_>, guess: Vec<Vec3A>) -> Bounced {
    let Reflecting {
        patches,
        factors,
        reflectance,
        direct,
        enough,
    } = *reflecting;
    let mut out = Bounced {
        exitance: guess,
        bounces: 0,
        remainder: f32::INFINITY,
    };
    let mut before = f32::INFINITY;
    while out.remainder > enough && out.bounces < MOST_BOUNCES {
        let mut next = vec![Vec3A::ZERO; patches.len()];
        next.par_chunks_mut(PIECE)
            .enumerate()
            .for_each(|(c, piece)| {
                for (k, value) in piece.iter_mut().enumerate() {
                    let i = c * PIECE + k;
                    let light = Vec3A::from(direct[i]) + factors.gathered(i, &out.exitance);
                    *value = Vec3A::from(reflectance[i]) * light;
                }
            });
        let flux = |of: &dyn Fn(usize) -> Vec3A| -> f32 {
            let one = |i: usize| of(i).element_sum() * patches[i].area;
            (0..patches.len()).map(one).sum()
        };
        let step = flux(&|i| (next[i] - out.exitance[i]).abs());
        let whole = flux(&|i| next[i]);
        // a geometric series: what is still to come is step · q / (1 − q)
        let brightest = reflectance
            .iter()
            .fold(0.0, |b: f32, r| b.max(r.max_element()));
        let q = if before.is_finite() && before > 0.0 {
            (step / before).clamp(0.0, brightest)
        } else {
            brightest
        };
        let left = step * q / (1.0 - q).max(1e-3);
        out.remainder = if whole > 0.0 { left / whole } else { 0.0 };
        out.exitance = next;
        out.bounces += 1;
        before = step;
    }
    out
}

/// Means of a value over the texels of each patch, weighed by area.
pub(super) fn means(
    values: &[Vec3],
    of_texels: &[u16],
    areas: &[f32],
    patches: &[Patch],
) -> Vec<Vec3> {
    let mut out = vec![Vec3::ZERO; patches.len()];
    for ((&p, &value), &area) in of_texels.iter().zip(values).zip(areas) {
        out[usize::from(p)] += value * area;
    }
    for (sum, patch) in out.iter_mut().zip(patches) {
        *sum /= patch.area;
    }
    out
}
