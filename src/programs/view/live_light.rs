//! Changed light for the page: the light operator's answers, packed as a texture of ratios that the
//! page multiplies the reconstructed irradiance by.

use super::encode::{packed_map, rgb9e5};
use crate::core::image::RgbPlane;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::trace::Tracer;
use crate::render::live::{LightEdit, LightGroup, LiveLight, open_or_build};
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::time::Instant;

/// Texels per parallel piece. Derived: some tens of pieces a megapixel.
const PIECE: usize = 8192;
/// Factors beyond are refused: nothing would be left of the range of the page's textures.
const MOST_FACTOR: f32 = 1e4;

/// The operator, and where its texels go.
pub struct PageLight {
    light: LiveLight,
    /// Lit texel that each cell of the map shows: its own or the nearest.
    shown: Vec<u32>,
    /// How long it took to make or read, seconds.
    seconds: f64,
}

impl PageLight {
    /// Reads or traces the operator of a solution.
    #[must_use]
    pub fn new(solution: &Solution, folder: Option<&Path>, tracer: &dyn Tracer) -> Self {
        let clock = Instant::now();
        let light = open_or_build(solution, folder, tracer, &Progress::silent());
        let lit = (0..light.cells().len()).filter(|&i| light.is_lit(i));
        let shown = nearest_covered(light.size(), light.cells(), lit);
        Self {
            light,
            shown,
            seconds: clock.elapsed().as_secs_f64(),
        }
    }

    /// What the page is told of it.
    #[must_use]
    pub fn description(&self) -> Value {
        let [width, height] = self.light.size();
        let error = self.light.error();
        json!({
            "width": width,
            "height": height,
            "lights": self.light.groups().len(),
            "patches": self.light.patch_count(),
            "error": error.relative,
            "error_db": error.decibels(),
            "median_error": error.median,
            "seconds": self.seconds,
        })
    }

    /// Factor on the light that surfaces send out and do not emit, on the operator's map.
    #[must_use]
    pub fn reflection_factors(&self, edit: &LightEdit, solution: &Solution) -> RgbPlane {
        let mut map = self.light.ratio_map(&self.light.answer(edit));
        let [width, height] = self.light.size();
        for (i, value) in map.data.iter_mut().enumerate() {
            let centre = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            let class = solution.class_at(centre / Vec2::new(width as f32, height as f32));
            if let Some(factor) = edit.classes.get(&class) {
                *value *= *factor;
            }
        }
        map
    }

    /// Factor on what each triangle emits; `None` where it is no light.
    #[must_use]
    pub fn emission_factors(&self, edit: &LightEdit, triangles: usize) -> Vec<Option<Vec3>> {
        let mut out = vec![None; triangles];
        for (k, group) in self.light.groups().iter().enumerate() {
            for &t in &group.triangles {
                out[t as usize] = Some(edit.light(k));
            }
        }
        out
    }

    /// Factor on the light from outside.
    #[must_use]
    pub fn outside_factor(&self, edit: &LightEdit) -> Vec3 {
        let outside = self.light.groups().iter().position(LightGroup::is_outside);
        outside.map_or(Vec3::ONE, |k| edit.light(k))
    }

    /// The answer to an edit: 16 bytes (`UBLL`, its time in milliseconds and the remainder of the
    /// bounces as f32, their number as u32), then a block of ratios ([`packed_map`]).
    #[must_use]
    pub fn answer(&self, edit: &LightEdit) -> Vec<u8> {
        let clock = Instant::now();
        let [width, height] = self.light.size();
        let answer = self.light.answer(edit);
        let mut packed = vec![0u32; answer.ratio.len()];
        packed
            .par_chunks_mut(PIECE)
            .enumerate()
            .for_each(|(c, piece)| {
                for (k, texel) in piece.iter_mut().enumerate() {
                    *texel = rgb9e5(answer.ratio[c * PIECE + k]);
                }
            });
        let one = rgb9e5(Vec3::ONE);
        let of_cell = |&i: &u32| packed.get(i as usize).copied().unwrap_or(one);
        let map = packed_map(width, height, self.shown.iter().map(of_cell));
        let milliseconds = clock.elapsed().as_secs_f32() * 1e3;
        let mut out = b"UBLL".to_vec();
        out.extend(milliseconds.to_le_bytes());
        out.extend(answer.remainder.to_le_bytes());
        out.extend(answer.bounces.to_le_bytes());
        out.extend(map);
        out
    }
}

/// The one of some covered texels that is nearest to each cell, along rows and columns: what bilinear lookups at the
/// borders of charts meet.
fn nearest_covered(
    [width, height]: [usize; 2],
    cells: &[u32],
    texels: impl Iterator<Item = usize>,
) -> Vec<u32> {
    let mut shown = vec![u32::MAX; width * height];
    let mut open: VecDeque<usize> = VecDeque::new();
    for i in texels {
        let cell = cells[i];
        shown[cell as usize] = i as u32;
        open.push_back(cell as usize);
    }
    while let Some(cell) = open.pop_front() {
        let (x, y) = (cell % width, cell / width);
        let neighbours = [
            (x > 0).then(|| cell - 1),
            (x + 1 < width).then_some(cell + 1),
            (y > 0).then(|| cell - width),
            (y + 1 < height).then_some(cell + width),
        ];
        for next in neighbours.into_iter().flatten() {
            if shown[next] == u32::MAX {
                shown[next] = shown[cell];
                open.push_back(next);
            }
        }
    }
    shown
}

/// The edit of a request: `lights` as R_G_B per light, `classes` as ID_R_G_B, divided by minus
/// signs. `None` if a part is malformed.
#[must_use]
pub fn parse_edit(lights: Option<&str>, classes: Option<&str>) -> Option<LightEdit> {
    let items = |text: Option<&str>| -> Vec<String> {
        let given = text.filter(|t| !t.is_empty());
        given.map_or_else(Vec::new, |t| t.split('-').map(str::to_owned).collect())
    };
    let lights = items(lights)
        .iter()
        .map(|item| factor(item))
        .collect::<Option<Vec<Vec3>>>()?;
    let class = |item: &String| -> Option<(u16, Vec3)> {
        let (id, rest) = item.split_once('_')?;
        Some((id.parse().ok()?, factor(rest)?))
    };
    let classes = items(classes)
        .iter()
        .map(class)
        .collect::<Option<BTreeMap<u16, Vec3>>>()?;
    Some(LightEdit { lights, classes })
}

/// Three factors.
fn factor(text: &str) -> Option<Vec3> {
    let numbers: Vec<f32> = text
        .split('_')
        .map(|x| x.parse().ok().filter(|x| (0.0..=MOST_FACTOR).contains(x)))
        .collect::<Option<_>>()?;
    let factors: [f32; 3] = numbers.try_into().ok()?;
    Some(Vec3::from_array(factors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_are_read() {
        let edit = parse_edit(Some("1_0.5_0-2_2_2"), Some("7_0_1_0.25")).expect("an edit");
        assert_eq!(edit.lights, [Vec3::new(1.0, 0.5, 0.0), Vec3::splat(2.0)]);
        assert_eq!(edit.classes[&7], Vec3::new(0.0, 1.0, 0.25));
        assert_eq!(parse_edit(None, Some("")), Some(LightEdit::default()));
        assert_eq!(parse_edit(Some("1_1"), None), None);
    }

    #[test]
    fn every_cell_shows_the_nearest_texel() {
        assert_eq!(nearest_covered([4, 1], &[0, 3], 0..2), [0, 0, 1, 1]);
        assert_eq!(nearest_covered([4, 1], &[0, 3], 1..2), [1; 4]);
        assert_eq!(nearest_covered([2, 1], &[], 0..0), [u32::MAX; 2]);
    }
}
