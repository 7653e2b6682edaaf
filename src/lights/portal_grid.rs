//! The scene's bounding box, slightly enlarged and divided into cells: where rays leave the scene.

use glam::Vec3;

/// Cells along the longest side of the box. Measured: ×½ albedo −0.3 dB, ×2 −0.05 dB (dining-room; docs/lab/irradiance.md).
const CELLS: f32 = 96.0;
/// Numbers that cells along a side may have. Derived: the power of two that holds [`CELLS`].
const SIDE: u32 = (CELLS as u32).next_power_of_two();

/// A box around the scene with its six faces divided into square-ish cells, numbered face by face.
#[derive(Clone, Debug)]
pub struct PortalGrid {
    lo: Vec3,
    hi: Vec3,
    /// Cells per axis.
    count: [u32; 3],
}

impl PortalGrid {
    /// The box around `lo..hi`.
    #[must_use]
    pub fn around(lo: Vec3, hi: Vec3) -> Self {
        let margin = Vec3::splat((hi - lo).max_element().max(f32::MIN_POSITIVE) * 1e-3);
        let (lo, hi) = (lo - margin, hi + margin);
        let size = hi - lo;
        let count = (size / size.max_element() * CELLS)
            .ceil()
            .to_array()
            .map(|c| (c as u32).max(1));
        Self { lo, hi, count }
    }

    /// Length of the box's diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f32 {
        (self.hi - self.lo).length()
    }

    /// Where a ray from inside leaves: (cell, distance, cosine to the face's outward normal);
    /// `None` from outside.
    #[must_use]
    #[inline]
    pub fn exit(&self, origin: Vec3, direction: Vec3) -> Option<(u32, f32, f32)> {
        if !self.contains(origin) {
            return None;
        }
        let direction = direction.to_array();
        let (lo, hi, from) = (self.lo.to_array(), self.hi.to_array(), origin.to_array());
        let distance = |a: usize| {
            let d = direction[a];
            let to = if d > 0.0 { hi[a] } else { lo[a] };
            if d.abs() > 1e-9 {
                (to - from[a]) / d
            } else {
                f32::INFINITY
            }
        };
        let all = [distance(0), distance(1), distance(2)];
        let axis = if all[0] <= all[1] && all[0] <= all[2] {
            0
        } else {
            2 - usize::from(all[1] <= all[2])
        };
        let t = all[axis];
        if !t.is_finite() {
            return None;
        }
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let index = |a: usize| {
            let x = (from[a] + direction[a] * t - lo[a]) / (hi[a] - lo[a]) * self.count[a] as f32;
            (x.max(0.0) as u32).min(self.count[a] - 1)
        };
        let face = 2 * axis as u32 + u32::from(direction[axis] > 0.0);
        Some((
            Self::number(face, index(b), index(c)),
            t.max(f32::MIN_POSITIVE),
            direction[axis].abs(),
        ))
    }

    /// Whether a point lies inside the box.
    #[must_use]
    #[inline]
    pub fn contains(&self, p: Vec3) -> bool {
        p.cmpge(self.lo).all() && p.cmple(self.hi).all()
    }

    /// Every cell's number is below this: that of the first cell of a seventh face.
    #[must_use]
    pub const fn numbers() -> usize {
        Self::number(6, 0, 0) as usize
    }

    /// The number of the cell in row `i` and column `j` of a face.
    pub(super) const fn number(face: u32, i: u32, j: u32) -> u32 {
        (face * SIDE + i) * SIDE + j
    }

    /// Face, row and column of a cell.
    pub(super) fn place(cell: u32) -> (u32, u32, u32) {
        (cell / (SIDE * SIDE), cell / SIDE % SIDE, cell % SIDE)
    }

    fn parts(&self, cell: u32) -> (usize, f32, usize, usize, u32, u32) {
        let (face, i, j) = Self::place(cell);
        let axis = (face / 2) as usize;
        let at = if face % 2 == 1 {
            self.hi[axis]
        } else {
            self.lo[axis]
        };
        (axis, at, (axis + 1) % 3, (axis + 2) % 3, i, j)
    }

    /// The point of a cell at `u` in [0, 1)².
    #[must_use]
    pub fn cell_point(&self, cell: u32, u: [f32; 2]) -> Vec3 {
        let (axis, at, b, c, i, j) = self.parts(cell);
        let mut p = Vec3::ZERO;
        p[axis] = at;
        p[b] = self.lo[b] + (self.hi[b] - self.lo[b]) * (i as f32 + u[0]) / self.count[b] as f32;
        p[c] = self.lo[c] + (self.hi[c] - self.lo[c]) * (j as f32 + u[1]) / self.count[c] as f32;
        p
    }

    /// The cells of the same face that touch a cell.
    pub fn around_cell(&self, cell: u32) -> impl Iterator<Item = u32> {
        let (_, _, b, c, i, j) = self.parts(cell);
        let (face, rows, columns) = (Self::place(cell).0, self.count[b], self.count[c]);
        let near = |x: u32, end: u32| x.saturating_sub(1)..(x + 2).min(end);
        let all = near(i, rows)
            .flat_map(move |i| near(j, columns).map(move |j| Self::number(face, i, j)));
        all.filter(move |c| *c != cell)
    }

    /// A cell as a parallelogram: corner, two edges, unit normal towards the inside.
    #[must_use]
    pub fn cell_frame(&self, cell: u32) -> [Vec3; 4] {
        let corner = self.cell_point(cell, [0.0, 0.0]);
        let (edge1, edge2) = (
            self.cell_point(cell, [1.0, 0.0]) - corner,
            self.cell_point(cell, [0.0, 1.0]) - corner,
        );
        let mut inwards = Vec3::ZERO;
        inwards[self.parts(cell).0] = if Self::place(cell).0 % 2 == 1 {
            -1.0
        } else {
            1.0
        };
        [corner, edge1, edge2, inwards]
    }

    /// Centre of a cell.
    #[must_use]
    pub fn cell_centre(&self, cell: u32) -> Vec3 {
        self.cell_point(cell, [0.5, 0.5])
    }

    /// Area of a cell, m².
    #[must_use]
    pub fn cell_area(&self, cell: u32) -> f32 {
        let (_, _, b, c, _, _) = self.parts(cell);
        let side = |a: usize| (self.hi[a] - self.lo[a]) / self.count[a] as f32;
        side(b) * side(c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_cell_are_found_again_as_exits() {
        let hull = PortalGrid::around(Vec3::new(-1.0, 0.0, 2.0), Vec3::new(4.0, 2.5, 5.0));
        let origin = Vec3::new(1.0, 1.2, 3.0);
        let mut seen = 0;
        for face in 0..6u32 {
            for (i, j) in [(0, 0), (7, 11), (20, 3)] {
                let cell = PortalGrid::number(face, i, j);
                let p = hull.cell_point(cell, [0.3, 0.8]);
                let d = (p - origin).normalize();
                let (found, t, cosine) = hull.exit(origin, d).expect("inside");
                assert_eq!(found, cell);
                assert!((origin + d * t - p).length() < 1e-4 && cosine > 0.0);
                let [corner, edge1, edge2, inwards] = hull.cell_frame(cell);
                assert!(
                    (corner + edge1 * 0.3 + edge2 * 0.8 - p).length() < 1e-5
                        && inwards.dot(d) < 0.0
                );
                let side = hull.cell_area(cell).sqrt();
                let around: Vec<u32> = hull.around_cell(cell).collect();
                assert_eq!(around.len(), if (i, j) == (0, 0) { 3 } else { 8 });
                assert!(
                    around
                        .iter()
                        .all(|c| (hull.cell_centre(*c) - hull.cell_centre(cell)).length()
                            < 1.6 * side)
                );
                seen += 1;
            }
        }
        assert_eq!(seen, 18);
        assert!(hull.exit(Vec3::splat(100.0), Vec3::X).is_none());
    }

    /// Areas as seen from inside: the solid angles of all cells sum to the sphere.
    #[test]
    fn cells_tile_the_sphere() {
        let hull = PortalGrid::around(Vec3::ZERO, Vec3::new(2.0, 1.0, 1.5));
        let origin = Vec3::new(0.7, 0.4, 0.6);
        let mut sum = 0.0f64;
        for face in 0..6u32 {
            let axis = (face / 2) as usize;
            for i in 0..hull.count[(axis + 1) % 3] {
                for j in 0..hull.count[(axis + 2) % 3] {
                    let cell = PortalGrid::number(face, i, j);
                    let d = hull.cell_centre(cell) - origin;
                    let t2 = d.length_squared();
                    sum += f64::from(hull.cell_area(cell) * d[axis].abs() / t2.sqrt() / t2);
                }
            }
        }
        assert!(
            (sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3,
            "{sum}"
        );
    }
}
