//! Variance-guided filtering of baked irradiance over the surface.
//!
//! Neighbouring texels of one smooth surface see almost the same light, so their samples can be shared. Non-local means with dual
//! buffers (Rousselle et al. 2012, "Adaptive Rendering with Non-Local Means Filtering"): the two halves of every texel's samples are
//! independent; weights come from one half and are applied to the other, and differences smaller than the noise do not count, so
//! that shadow edges stay where they exceed it. Only texels of the same plane (positions and normals in 3-D) are combined.

use super::Irradiance;
use crate::geometry::Mesh;
use crate::math::luminance;
use crate::texture::Texels;
use glam::Vec3;
use rayon::prelude::*;

/// Half width of the search window in texels.
const RADIUS: i32 = 10;
/// Within this distance every texel is used, beyond it every other one.
const DENSE: i32 = 3;
/// Damping of differences in units of their standard deviation (k of the paper).
const DAMPING: f32 = 1.0;
/// Texels whose estimated relative standard error is below this share of the target stay as they are.
const DONE: f32 = 0.5;

/// What the filter knows of a texel.
#[derive(Clone, Copy)]
struct Node {
    position: Vec3,
    normal: Vec3,
    /// Luminance of the two halves.
    half: [f32; 2],
    /// Variance of a half's luminance.
    variance: f32,
    /// World size of the texel.
    size: f32,
}

/// Replaces the values of `baked` (one per covered texel) by their filtered ones and updates their errors. `normal(i)` is the
/// shading normal of texel i. Texels already within `target` are left alone.
pub fn filter_irradiance(
    baked: &mut Irradiance,
    mesh: &Mesh,
    texels: &Texels,
    normal: impl Fn(usize) -> Vec3 + Sync,
    target: f32,
) {
    if texels.is_empty() {
        return;
    }
    let grid = Grid::new(texels);
    let mut nodes: Vec<Node> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let half = baked.halves[i].map(luminance);
            Node {
                position: texels.position(mesh, i),
                normal: normal(i),
                half,
                variance: 0.5 * (half[0] - half[1]).powi(2),
                size: texels.texel_area(mesh, texels.point[i].triangle as usize).sqrt(),
            }
        })
        .collect();
    // a single difference is a poor variance: the relative variance is averaged over the surface around
    let smooth: Vec<f32> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let (mut variance, mut square) = (0.0, 0.0);
            grid.for_neighbours(i, 3, |j| {
                if same_plane(&nodes[i], &nodes[j], 3.0) {
                    variance += nodes[j].variance;
                    square += (0.5 * (nodes[j].half[0] + nodes[j].half[1])).powi(2);
                }
            });
            let own = (0.5 * (nodes[i].half[0] + nodes[i].half[1])).powi(2);
            if square > 0.0 { variance / square * own } else { 0.0 }
        })
        .collect();
    for (n, v) in nodes.iter_mut().zip(smooth) {
        n.variance = v;
    }
    let filtered: Vec<(Vec3, [Vec3; 2])> =
        (0..texels.len()).into_par_iter().map(|i| filter_one(&grid, &nodes, baked, i, target)).collect();
    for (i, (value, halves)) in filtered.into_iter().enumerate() {
        baked.value[i] = value;
        baked.halves[i] = halves;
        let (a, b) = (luminance(halves[0]), luminance(halves[1]));
        baked.error[i] = if a + b > 0.0 { (a - b).abs() / (a + b) } else { 0.0 };
    }
}

fn filter_one(grid: &Grid, nodes: &[Node], baked: &Irradiance, i: usize, target: f32) -> (Vec3, [Vec3; 2]) {
    let n = &nodes[i];
    let mean = 0.5 * (n.half[0] + n.half[1]);
    if n.variance.sqrt() <= 0.71 * DONE * target * 2.0 * mean {
        return (baked.value[i], baked.halves[i]);
    }
    let mut sum = [Vec3::ZERO; 2];
    let mut total = [0.0f32; 2];
    grid.for_neighbours(i, RADIUS, |j| {
        let m = &nodes[j];
        if !same_plane(n, m, RADIUS as f32) {
            return;
        }
        for source in 0..2 {
            // weights from one half, values from the other
            let d = patch_distance(grid, nodes, i, j, source);
            let w = (-d).exp();
            sum[1 - source] += baked.halves[j][1 - source] * w;
            total[1 - source] += w;
        }
    });
    let halves = [0, 1].map(|k| if total[k] > 0.0 { sum[k] / total[k] } else { baked.halves[i][k] });
    (0.5 * (halves[0] + halves[1]), halves)
}

/// Mean squared difference of two 3×3 patches in units of the noise, less what noise alone explains.
fn patch_distance(grid: &Grid, nodes: &[Node], i: usize, j: usize, source: usize) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (dx, dy) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)] {
        let (Some(p), Some(q)) = (grid.at(i, dx, dy), grid.at(j, dx, dy)) else { continue };
        let (a, b) = (&nodes[p], &nodes[q]);
        let noise = a.variance + b.variance.min(a.variance);
        let difference = (a.half[source] - b.half[source]).powi(2) - noise;
        sum += difference / (f32::MIN_POSITIVE + DAMPING * DAMPING * (a.variance + b.variance) + 1e-6 * a.half[source].powi(2));
        count += 1.0;
    }
    (sum / count).max(0.0)
}

/// Whether two texels lie on one smooth surface, no farther apart than `reach` texels allow.
fn same_plane(a: &Node, b: &Node, reach: f32) -> bool {
    let step = b.position - a.position;
    let limit = 1.6 * reach * a.size.max(b.size);
    let distance = step.length();
    distance <= limit && a.normal.dot(b.normal) > 0.97 && a.normal.dot(step).abs() <= 0.12 * distance
}

/// Texel lookups by grid offset.
struct Grid {
    width: i32,
    height: i32,
    index: Vec<u32>,
    cell: Vec<u32>,
}

impl Grid {
    fn new(texels: &Texels) -> Self {
        let mut index = vec![u32::MAX; texels.width * texels.height];
        for (i, &c) in texels.cell.iter().enumerate() {
            index[c as usize] = i as u32;
        }
        Self { width: texels.width as i32, height: texels.height as i32, index, cell: texels.cell.clone() }
    }

    fn at(&self, i: usize, dx: i32, dy: i32) -> Option<usize> {
        let c = self.cell[i] as i32;
        let (x, y) = (c % self.width + dx, c / self.width + dy);
        if x < 0 || y < 0 || x >= self.width || y >= self.height {
            return None;
        }
        let j = self.index[(y * self.width + x) as usize];
        (j != u32::MAX).then_some(j as usize)
    }

    fn for_neighbours(&self, i: usize, radius: i32, mut f: impl FnMut(usize)) {
        let c = self.cell[i] as i32;
        let (x, y) = (c % self.width, c / self.width);
        for ny in (y - radius).max(0)..=(y + radius).min(self.height - 1) {
            for nx in (x - radius).max(0)..=(x + radius).min(self.width - 1) {
                let far = (nx - x).abs().max((ny - y).abs()) > DENSE;
                let j = self.index[(ny * self.width + nx) as usize];
                if j != u32::MAX && !(far && (nx ^ ny ^ x ^ y) & 1 == 1) {
                    f(j as usize);
                }
            }
        }
    }
}
