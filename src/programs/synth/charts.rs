//! Solid shapes as charts: patches of surface that know their own flat size in metres.
//!
//! Because every shape is built from parametrised patches, the atlas needs no unwrapping: a chart's
//! texture coordinates are its metres, and packing is packing of rectangles. Patches are
//! tessellated to [`CELL`], because the renderer caches irradiance at vertices.

use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Largest edge of a tessellated flat patch, metres.
pub const CELL: f32 = 0.2;

/// What a patch is made of: index into the apartment's materials, and its own random key.
#[derive(Clone, Copy, Debug)]
pub struct Finish {
    /// Index of the material.
    pub material: usize,
    /// Class id.
    pub class: u16,
    /// Emitted radiance.
    pub emission: Vec3,
    /// Share of metal.
    pub metallic: f32,
    /// Share of light that goes straight through.
    pub transmission: f32,
}

/// A patch with its own rectangle of the atlas.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Extent of `uvs`, metres.
    pub size: Vec2,
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals.
    pub normals: Vec<Vec3>,
    /// Metres within the chart.
    pub uvs: Vec<Vec2>,
    /// Vertex indices within the chart.
    pub triangles: Vec<[u32; 3]>,
    /// Material, class, emission, metal, glass.
    pub finish: Finish,
}

/// Collects charts, placing them by a yaw and a translation.
#[derive(Default)]
pub struct Builder {
    /// Everything built so far.
    pub charts: Vec<Chart>,
    rotation: Mat3,
    translation: Vec3,
}

/// A flat panel: corner and two edges; the normal is their cross product.
pub type Panel = (Vec3, Vec3, Vec3);

impl Builder {
    /// An empty builder at the origin.
    #[must_use]
    pub fn new() -> Self {
        Self {
            charts: Vec::new(),
            rotation: Mat3::IDENTITY,
            translation: Vec3::ZERO,
        }
    }

    /// Builds what `f` builds, turned by `yaw` about y and moved by `translation` (relative to the
    /// current placement).
    pub fn at<T>(&mut self, translation: Vec3, yaw: f32, f: impl FnOnce(&mut Self) -> T) -> T {
        let saved = (self.rotation, self.translation);
        self.translation += self.rotation * translation;
        self.rotation *= Mat3::from_rotation_y(yaw);
        let out = f(self);
        (self.rotation, self.translation) = saved;
        out
    }

    /// World position of a local point.
    #[must_use]
    pub fn world(&self, p: Vec3) -> Vec3 {
        self.rotation * p + self.translation
    }

    /// Panels side by side in one chart; all have the height of the first.
    pub fn panels(&mut self, panels: &[Panel], finish: Finish) {
        let mut chart = Chart {
            size: Vec2::ZERO,
            positions: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            triangles: Vec::new(),
            finish,
        };
        for &(corner, du, dv) in panels {
            let normal = du.cross(dv).normalize_or_zero();
            let size = Vec2::new(du.length(), dv.length());
            if normal == Vec3::ZERO {
                continue;
            }
            let shift = Vec2::new(chart.size.x, 0.0);
            let (nu, nv) = (
                (size.x / CELL).ceil().max(1.0) as u32,
                (size.y / CELL).ceil().max(1.0) as u32,
            );
            self.grid(&mut chart, nu, nv, |s, t| {
                (
                    corner + du * s + dv * t,
                    normal,
                    shift + size * Vec2::new(s, t),
                )
            });
            chart.size = Vec2::new(chart.size.x + size.x, chart.size.y.max(size.y));
        }
        if !chart.triangles.is_empty() {
            self.charts.push(chart);
        }
    }

    /// One flat rectangle.
    pub fn rect(&mut self, corner: Vec3, du: Vec3, dv: Vec3, finish: Finish) {
        self.panels(&[(corner, du, dv)], finish);
    }

    /// One flat rectangle whose normal points to the side of `facing`, whatever the order of its
    /// edges.
    pub fn rect_facing(&mut self, corner: Vec3, du: Vec3, dv: Vec3, facing: Vec3, finish: Finish) {
        let (du, dv) = if du.cross(dv).dot(facing) < 0.0 {
            (dv, du)
        } else {
            (du, dv)
        };
        self.rect(corner, du, dv, finish);
    }

    /// A box; `bottom` says whether its underside can be seen.
    pub fn cuboid(&mut self, low: Vec3, high: Vec3, bottom: bool, finish: Finish) {
        let d = high - low;
        let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let sides = [
            (at(low.x, low.y, high.z), x, y),
            (at(high.x, low.y, high.z), -z, y),
            (at(high.x, low.y, low.z), -x, y),
            (at(low.x, low.y, low.z), z, y),
        ];
        self.panels(&sides, finish);
        self.rect(at(low.x, high.y, high.z), x, -z, finish);
        if bottom {
            self.rect(low, x, z, finish);
        }
    }

    /// A surface of revolution about the vertical through `base`. The profile runs along (radius,
    /// height) with the outside on its right when going up; its normals are smooth.
    pub fn lathe(&mut self, base: Vec3, profile: &[Vec2], around: u32, finish: Finish) {
        let mut lengths = vec![0.0f32];
        for w in profile.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + w[0].distance(w[1]));
        }
        let total = lengths[lengths.len() - 1];
        let widest = profile.iter().fold(0.0f32, |m, p| m.max(p.x));
        let last = profile.len() - 1;
        let size = Vec2::new(TAU * widest, total);
        self.patch(around, last as u32, size, finish, |s, t| {
            let i = ((t * last as f32).round() as usize).min(last);
            let tangent = profile[(i + 1).min(last)] - profile[i.saturating_sub(1)];
            let (sin, cos) = (TAU * s).sin_cos();
            let p = profile[i];
            let n = Vec3::new(tangent.y * cos, -tangent.x, tangent.y * sin).normalize_or(Vec3::Y);
            (
                base + Vec3::new(p.x * cos, p.y, p.x * sin),
                n,
                Vec2::new(s * size.x, lengths[i]),
            )
        });
    }

    /// An upright cylinder with its caps.
    pub fn cylinder(
        &mut self,
        base: Vec3,
        radius: f32,
        height: f32,
        around: u32,
        bottom: bool,
        finish: Finish,
    ) {
        let rows = (height / CELL).ceil().max(1.0) as usize;
        let side: Vec<Vec2> = (0..=rows)
            .map(|i| Vec2::new(radius, height * i as f32 / rows as f32))
            .collect();
        self.lathe(base, &side, around, finish);
        self.lathe(
            base,
            &[Vec2::new(radius, height), Vec2::new(0.0, height)],
            around,
            finish,
        );
        if bottom {
            self.lathe(base, &[Vec2::ZERO, Vec2::new(radius, 0.0)], around, finish);
        }
    }

    /// A sphere.
    pub fn sphere(&mut self, centre: Vec3, radius: f32, rows: u32, finish: Finish) {
        let profile: Vec<Vec2> = (0..=rows)
            .map(|i| {
                let a = PI * i as f32 / rows as f32;
                Vec2::new(radius * a.sin().max(0.0), -radius * a.cos())
            })
            .collect();
        self.lathe(centre, &profile, 2 * rows, finish);
    }

    /// A rounded block: superellipsoid with the given half sizes; `squareness` 1 is an ellipsoid,
    /// smaller is boxier.
    pub fn cushion(&mut self, centre: Vec3, half: Vec3, squareness: f32, finish: Finish) {
        // small ones are seen small
        let (nu, nv) = if half.max_element() < 0.15 {
            (16, 8)
        } else {
            (24, 12)
        };
        let size = Vec2::new(
            4.0 * (half.x + half.z) * 0.9,
            2.0 * (half.y + half.x.min(half.z)) * 0.9,
        );
        let e = squareness;
        let pow = |x: f32, p: f32| x.signum() * x.abs().powf(p);
        self.patch(nu, nv, size, finish, |s, t| {
            let (latitude, longitude) = (PI * (t - 0.5), TAU * s);
            let (sl, cl) = (latitude.sin(), latitude.cos().max(0.0));
            let (so, co) = longitude.sin_cos();
            let p = Vec3::new(pow(cl, e) * pow(co, e), pow(sl, e), pow(cl, e) * pow(so, e));
            let n = Vec3::new(
                pow(cl, 2.0 - e) * pow(co, 2.0 - e),
                pow(sl, 2.0 - e),
                pow(cl, 2.0 - e) * pow(so, 2.0 - e),
            ) / half;
            (
                centre + p * half,
                n.normalize_or(Vec3::Y * sl.signum()),
                Vec2::new(s, t) * size,
            )
        });
    }

    fn patch(
        &mut self,
        nu: u32,
        nv: u32,
        size: Vec2,
        finish: Finish,
        f: impl Fn(f32, f32) -> (Vec3, Vec3, Vec2),
    ) {
        let mut chart = Chart {
            size,
            positions: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            triangles: Vec::new(),
            finish,
        };
        self.grid(&mut chart, nu, nv, f);
        if !chart.triangles.is_empty() {
            self.charts.push(chart);
        }
    }

    fn grid(
        &self,
        chart: &mut Chart,
        nu: u32,
        nv: u32,
        f: impl Fn(f32, f32) -> (Vec3, Vec3, Vec2),
    ) {
        let base = chart.positions.len() as u32;
        for j in 0..=nv {
            for i in 0..=nu {
                let (p, n, uv) = f(i as f32 / nu as f32, j as f32 / nv as f32);
                chart.positions.push(self.world(p));
                chart.normals.push(self.rotation * n);
                chart.uvs.push(uv);
            }
        }
        for j in 0..nv {
            for i in 0..nu {
                let a = base + j * (nu + 1) + i;
                let (b, c, d) = (a + 1, a + nu + 2, a + nu + 1);
                for t in [[a, b, c], [a, c, d]] {
                    let [p, q, r] = t.map(|k| chart.positions[k as usize]);
                    let face = (q - p).cross(r - p);
                    // poles collapse one of the two triangles of a cell
                    if face.length_squared() > 1e-14 {
                        let n: Vec3 = t.iter().map(|&k| chart.normals[k as usize]).sum();
                        chart.triangles.push(if face.dot(n) >= 0.0 {
                            t
                        } else {
                            [t[0], t[2], t[1]]
                        });
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finish() -> Finish {
        Finish {
            material: 0,
            class: 1,
            emission: Vec3::ZERO,
            metallic: 0.0,
            transmission: 0.0,
        }
    }

    fn area(charts: &[Chart]) -> f32 {
        let face = |c: &Chart, t: &[u32; 3]| {
            let [p, q, r] = t.map(|k| c.positions[k as usize]);
            0.5 * (q - p).cross(r - p).length()
        };
        charts
            .iter()
            .map(|c| c.triangles.iter().map(|t| face(c, t)).sum::<f32>())
            .sum()
    }

    /// Volume by the divergence theorem: right only if every face is wound outwards and nothing is
    /// missing.
    fn volume(charts: &[Chart]) -> f32 {
        let cone = |c: &Chart, t: &[u32; 3]| {
            let [p, q, r] = t.map(|k| c.positions[k as usize]);
            p.dot(q.cross(r)) / 6.0
        };
        charts
            .iter()
            .map(|c| c.triangles.iter().map(|t| cone(c, t)).sum::<f32>())
            .sum()
    }

    #[test]
    fn shapes_are_closed_and_wound_outwards() {
        let mut b = Builder::new();
        b.at(Vec3::new(3.0, 1.0, -2.0), 0.7, |b| {
            b.cuboid(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), true, finish())
        });
        assert!((volume(&b.charts) - 6.0).abs() < 1e-3 && (area(&b.charts) - 22.0).abs() < 1e-3);
        let mut b = Builder::new();
        b.cylinder(Vec3::new(1.0, 0.0, 0.0), 0.5, 2.0, 96, true, finish());
        assert!((volume(&b.charts) / (PI * 0.5) - 1.0).abs() < 2e-3);
        let mut b = Builder::new();
        b.sphere(Vec3::splat(0.3), 0.5, 48, finish());
        assert!((volume(&b.charts) / (PI / 6.0) - 1.0).abs() < 4e-3);
        assert!(
            b.charts[0]
                .normals
                .iter()
                .zip(&b.charts[0].positions)
                .all(|(n, p)| n.dot(*p - Vec3::splat(0.3)) > 0.49)
        );
        let mut b = Builder::new();
        b.cushion(Vec3::ZERO, Vec3::new(0.5, 0.2, 0.4), 0.4, finish());
        let v = volume(&b.charts);
        assert!(v > 0.6 * 0.32 && v < 0.32, "{v}");
    }

    #[test]
    fn texture_coordinates_stay_inside_the_chart() {
        let mut b = Builder::new();
        b.cuboid(Vec3::ZERO, Vec3::new(1.0, 0.5, 0.2), true, finish());
        b.cylinder(Vec3::ZERO, 0.3, 1.0, 24, true, finish());
        b.cushion(Vec3::ZERO, Vec3::ONE, 0.5, finish());
        for c in &b.charts {
            assert!(
                c.uvs
                    .iter()
                    .all(|uv| uv.min_element() >= 0.0 && (c.size - *uv).min_element() >= -1e-4)
            );
        }
    }
}
