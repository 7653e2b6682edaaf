//! The atlas: rectangles packed on shelves at one texel density, and the textures painted into it.

use super::charts::Chart;
use super::pattern::Paint;
use crate::core::geometry::Mesh;
use crate::core::image::Plane;
use crate::core::parallel::map_chunks;
use crate::core::texture::{Shelves, shelves};
use glam::{Vec2, Vec3};

/// Texels between charts at 2048 texels; scales with the texture, never below 2.
const GAP_AT_2048: f32 = 4.0;

fn gap(side: usize) -> usize {
    (GAP_AT_2048 * side as f32 / 2048.0).ceil().max(2.0) as usize
}

/// Placed charts.
pub struct Atlas {
    /// Texels per side.
    pub side: usize,
    /// Texels per metre.
    pub density: f32,
    /// First texel of each chart.
    pub corners: Vec<[usize; 2]>,
}

/// Texels a chart of `metres` covers, at least one.
fn texels(metres: f32, density: f32) -> usize {
    (metres * density).ceil().max(1.0) as usize
}

impl Atlas {
    /// Packs charts at the highest density that fits.
    #[must_use]
    pub fn pack(charts: &[Chart], side: usize) -> Option<Self> {
        let gap = gap(side);
        let (mut low, mut high) = (0.0f32, side as f32);
        let mut best = None;
        for _ in 0..24 {
            let density = 0.5 * (low + high);
            match packed(charts, side, gap, density) {
                Some(corners) => {
                    best = Some(Self {
                        side,
                        density,
                        corners,
                    });
                    low = density;
                }
                None => high = density,
            }
        }
        best
    }

    /// Texels between charts.
    #[must_use]
    pub fn gap(&self) -> usize {
        gap(self.side)
    }

    /// Atlas coordinate of `metres` on chart `c`: texel centres sit at whole steps from the chart's
    /// corner, half a texel in.
    #[must_use]
    pub fn uv(&self, c: usize, metres: Vec2) -> Vec2 {
        let [x, y] = self.corners[c];
        (Vec2::new(x as f32, y as f32) + metres * self.density) / self.side as f32
    }

    /// One mesh of all charts with their atlas coordinates.
    #[must_use]
    pub fn mesh(&self, charts: &[Chart]) -> Mesh {
        let mut mesh = Mesh::default();
        for (c, chart) in charts.iter().enumerate() {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(&chart.positions);
            mesh.normals.extend(&chart.normals);
            mesh.uvs.extend(chart.uvs.iter().map(|&m| self.uv(c, m)));
            mesh.triangles
                .extend(chart.triangles.iter().map(|t| t.map(|i| i + base)));
        }
        mesh
    }

    /// Albedo (x, y, z) and roughness (w) of every texel; charts reach half the gap beyond their
    /// border.
    #[must_use]
    pub fn paint(&self, charts: &[Chart], paints: &[Paint]) -> Plane<glam::Vec4> {
        let ground = Vec3::splat(0.5).extend(0.5);
        self.fill(charts, ground, |c, metres| {
            let chart = &charts[c];
            let paint = &paints[chart.finish.material];
            let (albedo, roughness) = paint.look(metres, chart.size, c as u64);
            albedo.extend(roughness)
        })
    }

    /// The share of metal of every texel, laid out as [`Self::paint`].
    #[must_use]
    pub fn metal(&self, charts: &[Chart]) -> Plane<f32> {
        self.fill(charts, 0.0, |c, _| charts[c].finish.metallic)
    }

    /// The share of transmitted light of every texel, laid out as [`Self::paint`].
    #[must_use]
    pub fn transmission(&self, charts: &[Chart]) -> Plane<f32> {
        self.fill(charts, 0.0, |c, _| charts[c].finish.transmission)
    }

    /// A texture of the value of `at(chart, metres on it)`, `ground` between charts.
    fn fill<T: Copy + Send>(
        &self,
        charts: &[Chart],
        ground: T,
        at: impl Fn(usize, Vec2) -> T + Sync,
    ) -> Plane<T> {
        let margin = self.gap() as isize / 2;
        let painted = map_chunks(charts.len(), 1, |range| {
            let (c, chart) = (range.start, &charts[range.start]);
            let (w, h) = (
                texels(chart.size.x, self.density) as isize,
                texels(chart.size.y, self.density) as isize,
            );
            let mut block = Vec::with_capacity(((w + 2 * margin) * (h + 2 * margin)) as usize);
            for y in -margin..h + margin {
                for x in -margin..w + margin {
                    let metres = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / self.density;
                    block.push(at(c, metres));
                }
            }
            block
        });
        let mut texture = Plane::filled(self.side, self.side, ground);
        for (c, block) in painted.iter().enumerate() {
            let w = texels(charts[c].size.x, self.density) as isize + 2 * margin;
            let [x0, y0] = self.corners[c].map(|v| v as isize - margin);
            for (i, value) in block.iter().enumerate() {
                let (x, y) = (x0 + i as isize % w, y0 + i as isize / w);
                if x >= 0 && y >= 0 && x < self.side as isize && y < self.side as isize {
                    texture[(x as usize, y as usize)] = *value;
                }
            }
        }
        texture
    }
}

/// The charts on shelves; `None` if they do not fit.
fn packed(charts: &[Chart], side: usize, gap: usize, density: f32) -> Option<Vec<[usize; 2]>> {
    let sizes: Vec<[usize; 2]> = charts
        .iter()
        .map(|c| [texels(c.size.x, density), texels(c.size.y, density)])
        .collect();
    let widest = sizes.iter().map(|s| s[0]).max().unwrap_or(0);
    let Shelves { corners, height } = shelves(&sizes, side, gap);
    (widest + 2 * gap <= side && height <= side).then_some(corners)
}

#[cfg(test)]
mod tests {
    use super::super::charts::{Builder, Finish};
    use super::*;

    #[test]
    fn charts_keep_their_distance() {
        let mut b = Builder::new();
        let finish = Finish {
            material: 0,
            class: 1,
            emission: Vec3::ZERO,
            metallic: 0.0,
            transmission: 0.0,
        };
        for i in 0..60 {
            b.rect(
                Vec3::ZERO,
                Vec3::X * (0.05 + 0.04 * i as f32),
                Vec3::Y * (0.3 + 0.5 * (i % 5) as f32),
                finish,
            );
        }
        let atlas = Atlas::pack(&b.charts, 512).expect("fits");
        let mut owner = vec![0usize; 512 * 512];
        for (c, chart) in b.charts.iter().enumerate() {
            let [x0, y0] = atlas.corners[c];
            let (w, h) = (
                texels(chart.size.x, atlas.density),
                texels(chart.size.y, atlas.density),
            );
            // two texels of margin to the right and below: no other chart may begin there
            for y in y0..(y0 + h + 2).min(512) {
                for x in x0..(x0 + w + 2).min(512) {
                    assert_eq!(
                        std::mem::replace(&mut owner[y * 512 + x], c + 1),
                        0,
                        "charts overlap at {x},{y}"
                    );
                }
            }
        }
        let covered = owner.iter().filter(|&&o| o > 0).count();
        assert!(covered > 512 * 512 / 2, "packing wastes more than half");
    }
}
