//! Openings to the outside of a mesh, found by rays: triangles on its bounding box through which
//! the environment is seen.
//!
//! Portals only steer the sampling of the environment. One that is too large costs samples, one
//! that is missed costs noise; neither changes what is rendered on average.

use super::PortalGrid;
use super::grouping::MAX_LAMPS;
use crate::core::geometry::Mesh;
use crate::core::math::Frame;
use crate::core::parallel::map_chunks;
use crate::core::sampling::{SobolSequence, square_to_cosine_hemisphere};
use crate::core::trace::{Hit, Ray, Tracer};
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

/// Surface points from which openings are looked for.
/// Measured: ×½ roughness within two errors +55 %, ×2 albedo +0.1 dB (docs/constants.md).
pub(super) const PROBES: usize = 16_384;
/// Rays from each.
/// Measured: ×½ little, ×2 albedo +0.2 dB (docs/constants.md).
const RAYS: u32 = 32;
/// Cells along a rectangle's side beyond which it is cut, so that from everywhere only the visible
/// parts need be sampled. Measured: pieces of half the side take noise from 4.46 to 4.34 % (docs/lab/irradiance.md).
const LONGEST: u32 = 32;

/// A face of the box and ranges of its cells.
#[derive(Clone, Debug)]
struct Patch {
    face: u32,
    cells: Vec<[u32; 2]>,
}

impl Patch {
    fn bounds(&self) -> [[u32; 2]; 2] {
        self.cells.iter().fold([[u32::MAX; 2], [0; 2]], |b, c| {
            [
                [b[0][0].min(c[0]), b[0][1].min(c[1])],
                [b[1][0].max(c[0]), b[1][1].max(c[1])],
            ]
        })
    }

    /// Whether at least as many of the cells of its rectangle are open as not.
    fn is_mostly_open(&self) -> bool {
        let [lo, hi] = self.bounds();
        let all = ((hi[0] - lo[0] + 1) * (hi[1] - lo[1] + 1)) as usize;
        2 * self.cells.len() >= all
    }

    fn too_long(&self) -> bool {
        let [lo, hi] = self.bounds();
        (hi[0] - lo[0]).max(hi[1] - lo[1]) >= LONGEST
    }

    fn cut(self) -> [Self; 2] {
        let [lo, hi] = self.bounds();
        let axis = usize::from(hi[1] - lo[1] > hi[0] - lo[0]);
        let middle = (lo[axis] + hi[axis]).div_ceil(2);
        let (a, b) = self.cells.into_iter().partition(|c| c[axis] < middle);
        [
            Self {
                face: self.face,
                cells: a,
            },
            Self {
                face: self.face,
                cells: b,
            },
        ]
    }
}

/// A ray that left the scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exit {
    /// The cell of the grid through which it left.
    pub cell: u32,
    /// Its direction.
    pub direction: Vec3,
}

/// Where cosine-distributed rays from surface points (position, unit normal) leave the scene, in
/// the order of the points.
pub(super) fn find_exits(
    hull: &PortalGrid,
    tracer: &dyn Tracer,
    probes: &[(Vec3, Vec3)],
) -> Vec<Exit> {
    let offset = hull.diagonal() * 1e-5;
    let found = map_chunks(probes.len(), 64, |range| {
        let mut rays = Vec::new();
        for k in range {
            let (p, n) = probes[k];
            let frame = Frame::from_normal(n);
            let sequence = SobolSequence::new(0x907_7a1, k as u64);
            for j in 0..RAYS {
                let d = frame.world_from_local(square_to_cosine_hemisphere(sequence.point2(j)));
                rays.push(Ray::new(p + n * offset, d, f32::INFINITY));
            }
        }
        let mut hits = vec![Hit::miss(); rays.len()];
        tracer.closest(&rays, &mut hits);
        let exits = rays.iter().zip(&hits).filter(|(_, h)| !h.is_hit());
        exits
            .filter_map(|(r, _)| {
                let direction = Vec3::from_array(r.direction);
                let (cell, _, _) = hull.exit(Vec3::from_array(r.origin), direction)?;
                Some(Exit { cell, direction })
            })
            .collect::<Vec<Exit>>()
    });
    found.into_iter().flatten().collect()
}

/// The portals of a mesh; none if no ray escapes.
#[must_use]
pub fn find_portals(mesh: &Mesh, tracer: &dyn Tracer) -> Vec<[Vec3; 3]> {
    let (lo, hi) = mesh.bounds();
    let hull = PortalGrid::around(lo, hi);
    let stride = (mesh.triangles.len() / PROBES).max(1);
    let probes: Vec<(Vec3, Vec3)> = (0..mesh.triangles.len())
        .step_by(stride)
        .map(|t| (mesh.position(t, 1.0 / 3.0, 1.0 / 3.0), mesh.face_normal(t)))
        .collect();
    let exits = find_exits(&hull, tracer, &probes);
    let cells: BTreeSet<u32> = exits.iter().map(|e| e.cell).collect();
    let corner = |face: u32, c: [u32; 2], u: [f32; 2]| {
        hull.cell_point(PortalGrid::number(face, c[0], c[1]), u)
    };
    let mut out = Vec::new();
    for p in rectangles(patches(&cells)) {
        let [lo, hi] = p.bounds();
        let a = corner(p.face, lo, [0.0, 0.0]);
        let b = corner(p.face, [hi[0], lo[1]], [1.0, 0.0]);
        let c = corner(p.face, hi, [1.0, 1.0]);
        let d = corner(p.face, [lo[0], hi[1]], [0.0, 1.0]);
        out.extend([[a, b, c], [a, c, d]]);
    }
    out
}

/// Connected open cells of each face.
fn patches(cells: &BTreeSet<u32>) -> Vec<Patch> {
    let mut open: BTreeMap<(u32, u32, u32), bool> = cells
        .iter()
        .map(|c| (PortalGrid::place(*c), false))
        .collect();
    let keys: Vec<_> = open.keys().copied().collect();
    let mut out = Vec::new();
    for key in keys {
        let mut stack = vec![key];
        let mut patch = Patch {
            face: key.0,
            cells: Vec::new(),
        };
        while let Some((f, i, j)) = stack.pop() {
            match open.get_mut(&(f, i, j)) {
                Some(seen) if !*seen => *seen = true,
                _ => continue,
            }
            patch.cells.push([i, j]);
            for (di, dj) in [
                (0, 1),
                (1, 0),
                (1, 1),
                (1, -1),
                (0, -1),
                (-1, 0),
                (-1, -1),
                (-1, 1),
            ] {
                stack.extend(
                    i.checked_add_signed(di)
                        .zip(j.checked_add_signed(dj))
                        .map(|(i, j)| (f, i, j)),
                );
            }
        }
        if !patch.cells.is_empty() {
            out.push(patch);
        }
    }
    out
}

/// Cuts patches that are mostly holes until there are as many as may be.
fn rectangles(mut patches: Vec<Patch>) -> Vec<Patch> {
    patches.sort_by_key(|p| std::cmp::Reverse(p.cells.len()));
    patches.truncate(MAX_LAMPS);
    while patches.len() < MAX_LAMPS {
        let unfit = |p: &Patch| p.cells.len() > 1 && (!p.is_mostly_open() || p.too_long());
        // the largest first: there the cut gains most
        let worst = (0..patches.len())
            .filter(|&i| unfit(&patches[i]))
            .max_by_key(|&i| (patches[i].cells.len(), i));
        let Some(i) = worst else { break };
        let [a, b] = patches.swap_remove(i).cut();
        patches.extend([a, b].into_iter().filter(|p| !p.cells.is_empty()));
    }
    patches
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::EmbreeTracer;

    /// A box of one-metre sides whose wall at x = 1 has a hole.
    fn box_with_window() -> Mesh {
        let mut mesh = Mesh::default();
        let mut quad = |c: [Vec3; 4]| {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(c);
            mesh.triangles
                .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        };
        let v = Vec3::new;
        // wound so that normals look inwards; each wall of many small quads gives enough probes
        let n = 8;
        let s = 1.0 / n as f32;
        for i in 0..n {
            for j in 0..n {
                let (a, b) = (i as f32 * s, j as f32 * s);
                quad([
                    v(a, 0.0, b),
                    v(a, 0.0, b + s),
                    v(a + s, 0.0, b + s),
                    v(a + s, 0.0, b),
                ]);
                quad([
                    v(a, 1.0, b),
                    v(a + s, 1.0, b),
                    v(a + s, 1.0, b + s),
                    v(a, 1.0, b + s),
                ]);
                quad([
                    v(0.0, a, b),
                    v(0.0, a + s, b),
                    v(0.0, a + s, b + s),
                    v(0.0, a, b + s),
                ]);
                quad([
                    v(a, b, 0.0),
                    v(a + s, b, 0.0),
                    v(a + s, b + s, 0.0),
                    v(a, b + s, 0.0),
                ]);
                quad([
                    v(a, b, 1.0),
                    v(a, b + s, 1.0),
                    v(a + s, b + s, 1.0),
                    v(a + s, b, 1.0),
                ]);
                let window = (2..5).contains(&i) && (3..6).contains(&j);
                if !window {
                    quad([
                        v(1.0, a, b),
                        v(1.0, a, b + s),
                        v(1.0, a + s, b + s),
                        v(1.0, a + s, b),
                    ]);
                }
            }
        }
        mesh.uvs = vec![glam::Vec2::ZERO; mesh.positions.len()];
        mesh.compute_normals();
        mesh
    }

    #[test]
    fn the_window_is_found_and_nothing_else() {
        let mesh = box_with_window();
        let tracer = EmbreeTracer::new(&mesh).expect("embree");
        let portals = find_portals(&mesh, &tracer);
        assert!(!portals.is_empty());
        let all: Vec<Vec3> = portals.iter().flatten().copied().collect();
        let lo = all.iter().copied().reduce(Vec3::min).expect("some");
        let hi = all.iter().copied().reduce(Vec3::max).expect("some");
        assert!(
            (lo.x - 1.0).abs() < 0.01 && (hi.x - 1.0).abs() < 0.01,
            "{lo} {hi}"
        );
        let near = |a: f32, b: f32| (a - b).abs() < 0.04;
        assert!(
            near(lo.y, 0.25) && near(hi.y, 0.625) && near(lo.z, 0.375) && near(hi.z, 0.75),
            "{lo} {hi}"
        );
    }
}
