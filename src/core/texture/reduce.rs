//! Smaller copies of an atlas whose charts stay apart: a texel is the mean of its own chart's texels
//! alone, where a box filter would mix charts that lie side by side.

use super::Texels;
use super::fill::{Texel, fill_uncovered};
use crate::core::geometry::{Mesh, charts};
use crate::core::image::{Plane, Wrap};
use crate::core::parallel::map_chunks;
use glam::Vec2;
use std::borrow::Cow;
use std::ops::Range;

/// Texels per piece of parallel work.
const CHUNK: usize = 4096;
/// Chart of a texel that no chart covers.
const NONE: u32 = u32::MAX;

/// The plane itself, or halved until both sides are at most `largest`, the charts of `mesh` kept apart.
#[must_use]
pub fn fitted<'a, T: Texel>(mesh: &Mesh, plane: &'a Plane<T>, largest: usize) -> Cow<'a, Plane<T>> {
    let (mut width, mut height) = (plane.width, plane.height);
    while width.max(height) > largest.max(1) {
        (width, height) = ((width / 2).max(1), (height / 2).max(1));
    }
    if (width, height) == (plane.width, plane.height) {
        return Cow::Borrowed(plane);
    }
    let reduction = AtlasReduction::new(mesh, plane.width, plane.height);
    Cow::Owned(reduction.reduced(plane, width, height))
}

/// Makes smaller copies of a mesh's textures of one size.
pub struct AtlasReduction<'a> {
    mesh: &'a Mesh,
    /// The chart of each triangle.
    charts: Vec<u32>,
    /// The chart in which each texel's centre lies.
    chart_at: Plane<u32>,
}

impl<'a> AtlasReduction<'a> {
    /// Of textures of `width × height` on the atlas of `mesh`.
    #[must_use]
    pub fn new(mesh: &'a Mesh, width: usize, height: usize) -> Self {
        let charts = charts(mesh);
        let texels = Texels::rasterize(mesh, width, height);
        let chart_of: Vec<u32> = (texels.point.iter().zip(&texels.interior))
            .map(|(p, inside)| match inside {
                true => charts[p.triangle as usize],
                false => NONE,
            })
            .collect();
        Self {
            mesh,
            charts,
            chart_at: texels.scatter(&chart_of, NONE),
        }
    }

    /// `plane`, which is of the size given to [`Self::new`], at `width × height`, neither of them larger than
    /// its own: every texel that a look-up on a chart can meet is the mean of those of the chart's texels
    /// that lie in it, or, where none does, what the chart has nearest to it; texels between charts are
    /// filled.
    #[must_use]
    pub fn reduced<T: Texel>(&self, plane: &Plane<T>, width: usize, height: usize) -> Plane<T> {
        let coarse = Texels::rasterize(self.mesh, width, height);
        let size = Vec2::new(plane.width as f32, plane.height as f32);
        let value = |i: usize| {
            let (cell, p) = (coarse.cell[i] as usize, coarse.point[i]);
            let chart = self.charts[p.triangle as usize];
            let columns = under(cell % width, width, plane.width);
            let rows = under(cell / width, height, plane.height);
            let (mut sum, mut count) = (T::default(), 0u32);
            for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
                if self.chart_at[(x, y)] == chart {
                    sum = sum + plane[(x, y)];
                    count += 1;
                }
            }
            match count {
                0 => plane.bilinear(
                    self.mesh.uv(p.triangle as usize, p.u, p.v) * size,
                    Wrap::Clamp,
                ),
                n => sum * (n as f32).recip(),
            }
        };
        let values = map_chunks(coarse.len(), CHUNK, |r| r.map(value).collect::<Vec<T>>());
        let covered = coarse.scatter(&vec![true; coarse.len()], false);
        fill_uncovered(&coarse.scatter(&values.concat(), T::default()), &covered)
    }
}

/// The texels of `large` that texel `i` of `small` covers, partly covered ones too.
fn under(i: usize, small: usize, large: usize) -> Range<usize> {
    i * large / small..((i + 1) * large).div_ceil(small)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two charts, two texels of 64 apart: left of the middle and right of it.
    fn two_charts() -> Mesh {
        let mut mesh = Mesh::default();
        for (k, (left, right)) in [(0.0, 31.0), (33.0, 64.0)].into_iter().enumerate() {
            let base = mesh.positions.len() as u32;
            for (x, y) in [(left, 0.0), (right, 0.0), (right, 64.0), (left, 64.0)] {
                mesh.positions.push(glam::Vec3::new(x, y, k as f32));
                mesh.normals.push(glam::Vec3::Z);
                mesh.uvs.push(Vec2::new(x, y) / 64.0);
            }
            mesh.triangles
                .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
        mesh
    }

    /// One chart is black, the other bright: neither has anything of the other at any size, to the edge.
    #[test]
    fn charts_side_by_side_do_not_mix() {
        let mesh = two_charts();
        let plane = Plane {
            width: 64,
            height: 64,
            data: (0..64 * 64)
                .map(|i| if i % 64 < 32 { 0.0f32 } else { 1.0 })
                .collect(),
        };
        let reduction = AtlasReduction::new(&mesh, 64, 64);
        for side in [32usize, 16, 8, 4] {
            let small = reduction.reduced(&plane, side, side);
            assert_eq!((small.width, small.height), (side, side));
            for (i, value) in small.data.iter().enumerate() {
                let expected = if i % side < side / 2 { 0.0 } else { 1.0 };
                assert_eq!(*value, expected, "{side}: {i}");
            }
        }
    }

    /// Away from edges it is the mean of what lies under a texel.
    #[test]
    fn inside_a_chart_it_is_the_mean() {
        let mesh = two_charts();
        let plane = Plane {
            width: 64,
            height: 64,
            data: (0..64 * 64).map(|i| (i % 64 + i / 64) as f32).collect(),
        };
        let small = AtlasReduction::new(&mesh, 64, 64).reduced(&plane, 16, 16);
        let expected = plane.half().half();
        for (x, y) in [(0, 0), (3, 5), (6, 15), (9, 1), (15, 15)] {
            assert!((small[(x, y)] - expected[(x, y)]).abs() < 1e-4, "{x} {y}");
        }
    }

    /// A texture whose size does not divide evenly, and one of a single texel.
    #[test]
    fn sizes_need_not_divide() {
        let mesh = two_charts();
        let plane = Plane::filled(65, 33, 2.5f32);
        for (w, h) in [(32, 16), (7, 3), (1, 1)] {
            let small = AtlasReduction::new(&mesh, 65, 33).reduced(&plane, w, h);
            assert!(small.data.iter().all(|v| (v - 2.5).abs() < 1e-6));
        }
    }
}
