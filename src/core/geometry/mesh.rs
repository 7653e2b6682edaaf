//! An indexed triangle mesh with one atlas.

use glam::{Vec2, Vec3};

/// The corners of the bounding box of some points, lowest first; zero without any.
#[must_use]
pub fn bounds(points: &[Vec3]) -> (Vec3, Vec3) {
    points
        .iter()
        .fold(None, |b: Option<(Vec3, Vec3)>, &p| {
            Some(b.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))))
        })
        .unwrap_or((Vec3::ZERO, Vec3::ZERO))
}

/// The eight corners of a box: bit k of a corner's number says on which side of axis k it lies.
#[must_use]
pub fn box_corners(low: Vec3, high: Vec3) -> [Vec3; 8] {
    std::array::from_fn(|corner| {
        let side = |k: usize| [low[k], high[k]][corner >> k & 1];
        Vec3::new(side(0), side(1), side(2))
    })
}

/// The corners of each side of a box, as [`box_corners`] numbers them, counter-clockwise from
/// outside: low and high x, then y, then z.
pub const BOX_SIDES: [[u32; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// Indexed triangles; `positions`, `normals` and `uvs` have equal length.
///
/// Positions are in metres relative to [`crate::scene::Scene::origin`]; `uvs` has v = 0 at texture
/// row 0 (glTF).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals.
    pub normals: Vec<Vec3>,
    /// Atlas coordinates in [0, 1].
    pub uvs: Vec<Vec2>,
    /// Vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// A triangle whose height is this small against its longest edge has no direction in f32.
const DEGENERATE: f32 = 1e-7;

/// A position or direction as a key of maps: equal for equal vectors, -0 being 0.
#[must_use]
pub fn vector_key(p: Vec3) -> [u32; 3] {
    (p + Vec3::ZERO).to_array().map(f32::to_bits)
}

/// Unit normal of a triangle by its winding; `None` if its corners' precision cannot tell that it has
/// an area.
#[must_use]
pub fn triangle_normal([a, b, c]: [Vec3; 3]) -> Option<Vec3> {
    let longest = (b - a)
        .length_squared()
        .max((c - a).length_squared())
        .max((c - b).length_squared());
    let cross = (b - a).cross(c - a);
    let has_area = cross.length() > DEGENERATE * longest;
    cross.try_normalize().filter(|_| has_area)
}

impl Mesh {
    /// The three corner positions of triangle `t`.
    #[must_use]
    pub fn corners(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].map(|i| self.positions[i as usize])
    }

    /// Key of triangle `t`: equal for triangles with the same three corners, whatever their winding.
    #[must_use]
    pub fn corner_key(&self, t: usize) -> [[u32; 3]; 3] {
        let mut corners = self.corners(t).map(vector_key);
        corners.sort_unstable();
        corners
    }

    /// The three atlas coordinates of triangle `t`.
    #[must_use]
    pub fn corner_uvs(&self, t: usize) -> [Vec2; 3] {
        self.triangles[t].map(|i| self.uvs[i as usize])
    }

    /// Area of triangle `t` in the atlas, as a share of the unit square.
    #[must_use]
    pub fn chart_area(&self, t: usize) -> f32 {
        let [a, b, c] = self.corner_uvs(t);
        0.5 * (b - a).perp_dot(c - a).abs()
    }

    /// Share of the atlas that charts cover, from 0.01 to 1; what lies on top of another counts twice.
    #[must_use]
    pub fn covered_share(&self) -> f64 {
        let areas = (0..self.triangles.len()).map(|t| f64::from(self.chart_area(t)));
        let finite = areas.filter(|a| a.is_finite());
        finite.sum::<f64>().clamp(0.01, 1.0)
    }

    /// Unnormalised geometric normal: length is twice the area, direction by the winding.
    #[must_use]
    pub fn double_area_normal(&self, t: usize) -> Vec3 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(c - a)
    }

    /// Unit geometric normal; zero for a triangle of zero area.
    #[must_use]
    pub fn face_normal(&self, t: usize) -> Vec3 {
        self.double_area_normal(t).normalize_or_zero()
    }

    /// Area of triangle `t` in m².
    #[must_use]
    pub fn area(&self, t: usize) -> f32 {
        0.5 * self.double_area_normal(t).length()
    }

    /// Position at barycentrics (u, v): `(1−u−v)·a + u·b + v·c`, Embree's convention.
    #[must_use]
    pub fn position(&self, t: usize, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.corners(t);
        a + (b - a) * u + (c - a) * v
    }

    /// Barycentrics (u, v) of the point of triangle `t`'s plane nearest to `p`, clamped to the
    /// triangle; (0, 0) if its area is zero.
    #[must_use]
    pub fn barycentrics(&self, t: usize, p: Vec3) -> (f32, f32) {
        let [a, b, c] = self.corners(t);
        let (e1, e2, d) = (b - a, c - a, p - a);
        let (d11, d12, d22) = (e1.dot(e1), e1.dot(e2), e2.dot(e2));
        let det = d11 * d22 - d12 * d12;
        if det.is_nan() || det <= 0.0 {
            return (0.0, 0.0);
        }
        let (p1, p2) = (d.dot(e1), d.dot(e2));
        let u = ((d22 * p1 - d12 * p2) / det).clamp(0.0, 1.0);
        let v = ((d11 * p2 - d12 * p1) / det).clamp(0.0, 1.0 - u);
        (u, v)
    }

    /// Atlas coordinate at barycentrics (u, v).
    #[must_use]
    pub fn uv(&self, t: usize, u: f32, v: f32) -> Vec2 {
        let [a, b, c] = self.corner_uvs(t);
        a + (b - a) * u + (c - a) * v
    }

    /// Interpolated unit shading normal at barycentrics (u, v), on the side of the geometric
    /// normal; falls back to the geometric normal where vertex normals cancel.
    #[must_use]
    pub fn shading_normal(&self, t: usize, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.triangles[t].map(|i| self.normals[i as usize]);
        let face = self.face_normal(t);
        let n = (a + (b - a) * u + (c - a) * v).normalize_or(face);
        if n.dot(face) < 0.0 { -n } else { n }
    }

    /// Bounding box `(min, max)`; zero for an empty mesh.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        bounds(&self.positions)
    }

    /// Some triangles, in the order given, with only the vertices they use, in the order of their
    /// first use.
    #[must_use]
    pub fn part(&self, triangles: &[u32]) -> Self {
        self.of_corners(triangles.iter().map(|&t| self.triangles[t as usize]))
    }

    /// A mesh of triangles between vertices of this one, with only the vertices they use, in the
    /// order of their first use.
    #[must_use]
    pub fn of_corners(&self, triangles: impl Iterator<Item = [u32; 3]>) -> Self {
        let mut new_index = vec![u32::MAX; self.positions.len()];
        let mut out = Self::default();
        for corners in triangles {
            let corners = corners.map(|i| {
                let i = i as usize;
                if new_index[i] == u32::MAX {
                    new_index[i] = out.positions.len() as u32;
                    out.positions.push(self.positions[i]);
                    out.normals.push(self.normals[i]);
                    out.uvs.push(self.uvs[i]);
                }
                new_index[i]
            });
            out.triangles.push(corners);
        }
        out
    }

    /// Replaces the vertex normals by area-weighted means of the adjacent faces.
    pub fn compute_normals(&mut self) {
        let mut normals = vec![Vec3::ZERO; self.positions.len()];
        for t in 0..self.triangles.len() {
            let n = self.double_area_normal(t);
            for i in self.triangles[t] {
                normals[i as usize] += n;
            }
        }
        self.normals = normals
            .into_iter()
            .map(|n| n.normalize_or(Vec3::Y))
            .collect();
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Adds a closed box of twelve triangles, its faces turned `outwards` or into it.
    pub(crate) fn add_box(mesh: &mut Mesh, low: Vec3, high: Vec3, outwards: bool) {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(box_corners(low, high));
        mesh.normals.extend([Vec3::Y; 8]);
        mesh.uvs.extend([Vec2::ZERO; 8]);
        for [a, b, c, d] in BOX_SIDES.map(|f| f.map(|i| first + i)) {
            for [a, b, c] in [[a, b, c], [a, c, d]] {
                let turned = if outwards { [a, b, c] } else { [a, c, b] };
                mesh.triangles.push(turned);
            }
        }
    }

    #[test]
    fn a_box_has_its_volume_on_the_side_its_faces_turn_from() {
        let (low, high) = (Vec3::new(-1.0, 2.0, 0.5), Vec3::new(1.0, 2.5, 3.5));
        for (outwards, sign) in [(true, 1.0), (false, -1.0)] {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, low, high, outwards);
            assert_eq!(mesh.bounds(), (low, high));
            let six = (0..12).map(|t| mesh.corners(t)[0].dot(mesh.double_area_normal(t)));
            assert!((six.sum::<f32>() / 6.0 - sign * 3.0).abs() < 1e-5);
        }
        assert_eq!(bounds(&[]), (Vec3::ZERO, Vec3::ZERO));
    }
}
