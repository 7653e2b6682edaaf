//! Flat surface that views see clean: where neighbours on the atlas are neighbours in space, of one
//! class and in one plane, and no edge is near. What varies there from texel to texel is texture or
//! noise: errors of the light are smooth. Called by the albedo palette.

use crate::core::geometry::{Mesh, SMOOTH};
use crate::core::stats::ENOUGH;
use crate::core::texture::Texels;
use glam::Vec3;

/// Distance of the texels compared: nearer ones share their noise.
/// Measured: ×½ albedo within two errors −3 %, ×2 albedo −0.9 dB (docs/constants.md).
pub(super) const LAG: i64 = 2;
/// Flat texels from which texture and noise of a class are known: of those that share their noise with others one in
/// [`LAG`]² is independent.
pub(super) const ENOUGH_FLAT: usize = ENOUGH * (LAG * LAG) as usize;

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

    /// As [`Self::at`], if that texel is of the class and in the plane of texel `i`, whichever way triangles are wound.
    pub(super) fn alike(&self, i: usize, dx: i64, dy: i64) -> Option<usize> {
        self.at(i, dx, dy).filter(|&j| {
            self.labels[j] == self.labels[i] && self.normal(j).dot(self.normal(i)).abs() > SMOOTH
        })
    }

    /// Whether texel `i` is clean and like all that it is compared with, [`LAG`] away.
    pub(super) fn is_flat(&self, i: usize) -> bool {
        self.reaches(i, LAG)
    }

    /// Whether what texel `i` is compared with lies on flat surface too: no edge is near.
    pub(super) fn is_far_from_edges(&self, i: usize) -> bool {
        self.reaches(i, LAG + LAG)
    }

    /// Whether texel `i` is clean and all around it, this many cells far, is like it.
    fn reaches(&self, i: usize, reach: i64) -> bool {
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
