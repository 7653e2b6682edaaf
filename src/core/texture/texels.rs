//! Texel rasterisation: for every texel that a bilinear lookup on the mesh can touch, the nearest
//! point of its chart.
//!
//! A texel belongs to the triangle that contains its centre; texels just outside a chart (within
//! one texel, the reach of a bilinear lookup) take the closest point of the nearest triangle, so
//! that lookups at chart borders need neither masks nor padding. Everything later runs over this
//! compact list, not over the square image.

use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use glam::{Vec2, Vec3};

/// Rows per band of the rasteriser; bands run in parallel.
const BAND: usize = 32;

/// A point on the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Triangle index.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
}

/// The covered texels of an atlas of `width × height`, in row-major order.
#[derive(Clone, Debug)]
pub struct Texels {
    /// Texture width.
    pub width: usize,
    /// Texture height.
    pub height: usize,
    /// Row-major position in the texture (`row · width + column`) of each covered texel, ascending.
    pub cell: Vec<u32>,
    /// Surface point of each covered texel.
    pub point: Vec<SurfacePoint>,
    /// Whether the texel's centre lies inside its triangle (false: border texel, clamped to the
    /// chart).
    pub interior: Vec<bool>,
}

impl Texels {
    /// Rasterises the charts of `mesh` at `width × height`. Triangles whose atlas coordinates are
    /// not finite are left out.
    #[must_use]
    pub fn rasterize(mesh: &Mesh, width: usize, height: usize) -> Self {
        let size = Vec2::new(width as f32, height as f32);
        let bands = height.div_ceil(BAND);
        let mut bins: Vec<Vec<u32>> = vec![Vec::new(); bands];
        for t in 0..mesh.triangles.len() {
            let uv = mesh.corner_uvs(t).map(|p| p * size);
            if !uv.iter().all(|p| p.is_finite()) {
                continue;
            }
            let lo = uv[0].y.min(uv[1].y).min(uv[2].y) - 1.5;
            let hi = uv[0].y.max(uv[1].y).max(uv[2].y) + 1.5;
            if hi < 0.0 || lo >= height as f32 {
                continue;
            }
            let first = (lo.max(0.0) as usize) / BAND;
            let last = ((hi as usize).min(height - 1)) / BAND;
            for bin in &mut bins[first..=last] {
                bin.push(t as u32);
            }
        }
        let parts: Vec<Band> = bins
            .par_iter()
            .enumerate()
            .map(|(b, bin)| {
                Band::rasterize(
                    mesh,
                    width,
                    b * BAND..((b + 1) * BAND).min(height),
                    size,
                    bin,
                )
            })
            .collect();
        let mut out = Self {
            width,
            height,
            cell: Vec::new(),
            point: Vec::new(),
            interior: Vec::new(),
        };
        let total = parts.iter().map(|p| p.cell.len()).sum();
        out.cell.reserve_exact(total);
        out.point.reserve_exact(total);
        out.interior.reserve_exact(total);
        for p in parts {
            out.cell.extend(p.cell);
            out.point.extend(p.point);
            out.interior.extend(p.interior);
        }
        out
    }

    /// Number of covered texels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cell.len()
    }

    /// Whether no texel is covered.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cell.is_empty()
    }

    /// World position of texel `i`.
    #[must_use]
    pub fn position(&self, mesh: &Mesh, i: usize) -> Vec3 {
        let p = self.point[i];
        mesh.position(p.triangle as usize, p.u, p.v)
    }

    /// The value at texel `i` of a texture of the same atlas, of any resolution.
    #[must_use]
    pub fn lookup(&self, mesh: &Mesh, plane: &RgbPlane, i: usize) -> Vec3 {
        let p = self.point[i];
        let size = Vec2::new(plane.width as f32, plane.height as f32);
        plane.bilinear(mesh.uv(p.triangle as usize, p.u, p.v) * size, Wrap::Clamp)
    }

    /// Barycentrics (u, v) of texel `i` for rays that start there: a thousandth of the triangle off
    /// its border. A point exactly on the edge between floor and wall lies in the wall's plane, and
    /// half of its rays would leave the room.
    #[must_use]
    pub fn ray_point(&self, i: usize) -> (f32, f32) {
        const INSIDE: f32 = 1e-3;
        let p = self.point[i];
        let w = [1.0 - p.u - p.v, p.u, p.v].map(|b| b.max(INSIDE));
        let sum = w[0] + w[1] + w[2];
        (w[1] / sum, w[2] / sum)
    }

    /// Spreads one value per covered texel over a texture; uncovered texels get `empty`.
    #[must_use]
    pub fn scatter<T: Copy>(&self, values: &[T], empty: T) -> Plane<T> {
        let mut plane = Plane::filled(self.width, self.height, empty);
        for (&c, &v) in self.cell.iter().zip(values) {
            plane.data[c as usize] = v;
        }
        plane
    }

    /// The number of the covered texel at every place of the texture; `u32::MAX` where none is.
    #[must_use]
    pub fn numbers(&self) -> Plane<u32> {
        let all: Vec<u32> = (0..self.len() as u32).collect();
        self.scatter(&all, u32::MAX)
    }

    /// World area of covered texel `i`, m².
    #[must_use]
    pub fn area(&self, mesh: &Mesh, i: usize) -> f32 {
        self.texel_area(mesh, self.point[i].triangle as usize)
    }

    /// World area that one texel of triangle `t` covers, m².
    #[must_use]
    pub fn texel_area(&self, mesh: &Mesh, t: usize) -> f32 {
        let texels = mesh.chart_area(t) * (self.width * self.height) as f32;
        if texels > 0.0 {
            mesh.area(t) / texels
        } else {
            0.0
        }
    }
}

#[derive(Default)]
struct Band {
    cell: Vec<u32>,
    point: Vec<SurfacePoint>,
    interior: Vec<bool>,
}

impl Band {
    fn rasterize(
        mesh: &Mesh,
        width: usize,
        rows: std::ops::Range<usize>,
        size: Vec2,
        triangles: &[u32],
    ) -> Self {
        const NONE: u32 = u32::MAX;
        if triangles.is_empty() {
            return Self::default();
        }
        let n = rows.len() * width;
        let mut best = vec![f32::INFINITY; n];
        let mut point = vec![
            SurfacePoint {
                triangle: NONE,
                u: 0.0,
                v: 0.0
            };
            n
        ];
        for &t in triangles {
            let uv = mesh.corner_uvs(t as usize).map(|p| p * size);
            let lo = uv[0].min(uv[1]).min(uv[2]) - 1.5;
            let hi = uv[0].max(uv[1]).max(uv[2]) + 0.5;
            let columns = (lo.x.max(0.0) as usize)..(((hi.x.max(-1.0) + 1.0) as usize).min(width));
            let band = (lo.y.max(0.0) as usize).max(rows.start)
                ..(((hi.y.max(-1.0) + 1.0) as usize).min(rows.end));
            for y in band {
                for x in columns.clone() {
                    let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    let (u, v, nearest) = closest_on_triangle(uv, centre);
                    let offset = (nearest - centre).abs();
                    if offset.max_element() >= 1.0 {
                        continue;
                    }
                    let d2 = offset.length_squared();
                    let i = (y - rows.start) * width + x;
                    if d2 < best[i] {
                        best[i] = d2;
                        point[i] = SurfacePoint { triangle: t, u, v };
                    }
                }
            }
        }
        let mut out = Self::default();
        for (i, p) in point.into_iter().enumerate() {
            if p.triangle != NONE {
                out.cell.push((rows.start * width + i) as u32);
                out.point.push(p);
                out.interior.push(best[i] <= 1e-12);
            }
        }
        out
    }
}

/// Closest point of a triangle to `p` in the plane, with barycentrics (u, v) of corners 1 and 2
/// (Ericson 2005, Real-Time Collision Detection, §5.1.5). A triangle of zero area acts as its
/// edges.
fn closest_on_triangle([a, b, c]: [Vec2; 3], p: Vec2) -> (f32, f32, Vec2) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let area = ab.perp_dot(ac);
    if area.abs() > 1e-12 {
        let u = ap.perp_dot(ac) / area;
        let v = ab.perp_dot(ap) / area;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
            return (u, v, p);
        }
    }
    let edge = |s: Vec2, e: Vec2| {
        let d = e - s;
        let t = ((p - s).dot(d) / d.length_squared().max(1e-20)).clamp(0.0, 1.0);
        (t, s + d * t)
    };
    let ((t0, p0), (t1, p1), (t2, p2)) = (edge(a, b), edge(b, c), edge(c, a));
    let d = [
        p0.distance_squared(p),
        p1.distance_squared(p),
        p2.distance_squared(p),
    ];
    if d[0] <= d[1] && d[0] <= d[2] {
        (t0, 0.0, p0)
    } else if d[1] <= d[2] {
        (1.0 - t1, t1, p1)
    } else {
        (0.0, 1.0 - t2, p2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(lo: f32, hi: f32) -> Mesh {
        let uvs = vec![
            Vec2::new(lo, lo),
            Vec2::new(hi, lo),
            Vec2::new(hi, hi),
            Vec2::new(lo, hi),
        ];
        let mut mesh = Mesh {
            positions: uvs
                .iter()
                .map(|p| Vec3::new(p.x * 4.0, 0.0, p.y * 4.0))
                .collect(),
            uvs,
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            normals: vec![],
        };
        mesh.compute_normals();
        mesh
    }

    #[test]
    fn centres_inside_map_to_their_own_position_and_borders_clamp() {
        let mesh = quad(0.25, 0.75);
        let t = Texels::rasterize(&mesh, 16, 16);
        assert_eq!(t.len(), 100, "8×8 inside plus a ring of one texel");
        assert_eq!(t.interior.iter().filter(|i| **i).count(), 64);
        for i in 0..t.len() {
            let (x, y) = (t.cell[i] % 16, t.cell[i] / 16);
            let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / 16.0;
            let clamped = centre.clamp(Vec2::splat(0.25), Vec2::splat(0.75));
            let p = t.position(&mesh, i);
            assert!((Vec2::new(p.x, p.z) / 4.0 - clamped).length() < 1e-5);
        }
        assert!((t.texel_area(&mesh, 0) - 16.0 / 256.0).abs() < 1e-6);
    }

    #[test]
    fn every_bilinear_tap_on_a_chart_is_covered() {
        let mesh = quad(0.131, 0.622);
        let t = Texels::rasterize(&mesh, 37, 23);
        let covered = t.scatter(&vec![true; t.len()], false);
        for i in 0..50 {
            for j in 0..50 {
                let uv = Vec2::new(
                    0.131 + 0.491 * i as f32 / 49.0,
                    0.131 + 0.491 * j as f32 / 49.0,
                );
                for (k, w) in crate::core::image::bilinear_taps(
                    37,
                    23,
                    uv * Vec2::new(37.0, 23.0),
                    crate::core::image::Wrap::Clamp,
                ) {
                    assert!(w < 1e-4 || covered.data[k]);
                }
            }
        }
    }

    #[test]
    fn degenerate_and_hostile_charts_are_harmless() {
        let mut mesh = quad(0.5, 0.5);
        assert!(Texels::rasterize(&mesh, 8, 8).len() <= 4);
        mesh.uvs[0] = Vec2::new(f32::NAN, 0.0);
        assert_eq!(Texels::rasterize(&mesh, 8, 8).len(), 0);
        let far = quad(-3.0, 5.0);
        assert_eq!(Texels::rasterize(&far, 8, 8).len(), 64);
        assert_eq!(Texels::rasterize(&quad(0.0, 1.0), 1, 1).len(), 1);
    }
}
