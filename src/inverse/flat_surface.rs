//! Flat surface that views see clean: where neighbours on the atlas are neighbours in space, of one
//! class and in one plane, and no edge is near. What varies there from texel to texel is texture or
//! noise: errors of the light are smooth. Called by the albedo palette.

use crate::core::geometry::Mesh;
use crate::core::stats::ENOUGH;
use crate::core::texture::Texels;
use glam::Vec3;

/// Texels around one that must be flat and clean for it to tell of texture and noise.
/// Measured: ×½ albedo −0.1 dB, ×2 albedo +0.1 dB (docs/constants.md).
pub(super) const FLAT_AROUND: i64 = 4;
/// Distance of the texels compared: nearer ones share their noise.
/// Measured: ×½ albedo within two errors −3 %, ×2 albedo −0.9 dB (docs/constants.md).
pub(super) const LAG: i64 = 2;
/// Such texels from which texture and noise of a class are known. Derived: what differs between a texel and the four
/// around it is theirs too; about one in four is independent.
pub(super) const ENOUGH_FLAT: usize = 4 * ENOUGH;
/// Cosine between normals of one plane, whichever way its triangles are wound.
/// Measured: ×½ same bits, ×2 (no two planes are alike) albedo −0.9 dB (docs/constants.md).
const COPLANAR: f32 = 0.999;

/// The atlas, asked for neighbours.
pub(super) struct FlatSurface<'a> {
    mesh: &'a Mesh,
    texels: &'a Texels,
    labels: &'a [u16],
    /// Covered and clean texel of each cell; `u32::MAX` where there is none.
    cells: Vec<u32>,
}

impl<'a> FlatSurface<'a> {
    pub(super) fn new(
        mesh: &'a Mesh,
        texels: &'a Texels,
        labels: &'a [u16],
        is_clean: impl Fn(usize) -> bool,
    ) -> Self {
        let mut cells = vec![u32::MAX; texels.width * texels.height];
        for (i, c) in texels.cell.iter().enumerate() {
            if is_clean(i) {
                cells[*c as usize] = i as u32;
            }
        }
        Self {
            mesh,
            texels,
            labels,
            cells,
        }
    }

    /// Width of the atlas in cells.
    pub(super) const fn width(&self) -> usize {
        self.texels.width
    }

    fn normal(&self, i: usize) -> Vec3 {
        self.mesh
            .face_normal(self.texels.point[i].triangle as usize)
    }

    /// The clean texel this many cells from texel `i`, if there is one.
    pub(super) fn at(&self, i: usize, dx: i64, dy: i64) -> Option<usize> {
        let (w, h) = (self.texels.width as i64, self.texels.height as i64);
        let cell = i64::from(self.texels.cell[i]);
        let (x, y) = (cell % w + dx, cell / w + dy);
        if x < 0 || y < 0 || x >= w || y >= h {
            return None;
        }
        let found = self.cells[(y * w + x) as usize];
        (found != u32::MAX).then_some(found as usize)
    }

    /// As [`Self::at`], if that texel is of the class and in the plane of texel `i`.
    pub(super) fn alike(&self, i: usize, dx: i64, dy: i64) -> Option<usize> {
        self.at(i, dx, dy).filter(|&j| {
            self.labels[j] == self.labels[i] && self.normal(j).dot(self.normal(i)).abs() > COPLANAR
        })
    }

    /// Whether texel `i` is clean and all around it, this many cells far, is like it.
    pub(super) fn reaches(&self, i: usize, reach: i64) -> bool {
        self.at(i, 0, 0).is_some()
            && (1..=reach).all(|r| {
                [
                    (r, 0),
                    (-r, 0),
                    (0, r),
                    (0, -r),
                    (r, r),
                    (-r, r),
                    (r, -r),
                    (-r, -r),
                ]
                .iter()
                .all(|&(dx, dy)| self.alike(i, dx, dy).is_some())
            })
    }
}
