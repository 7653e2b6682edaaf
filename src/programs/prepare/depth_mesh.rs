//! A mesh from depth images, for captures that bring none: their signed distances are
//! averaged on a grid of voxels (Curless and Levoy 1996, "A Volumetric Method for Building Complex
//! Models from Range Images"), and the surface is where the mean is zero; at outlines, where images
//! speak of different surfaces, it is where half of them, by how finely they see, look past. What every
//! image sees only behind something is taken for solid (their section 4, hole filling): so a lamp seen
//! from below has an upper side, from which it shines as well, and no light leaks in behind a cupboard.
//! Where an image looks and has no depth (a window), nothing is closed. The surface is put on its creases
//! (`creases`) and decimated to what the photographs resolve. Called by `write`.

use super::account::Account;
use super::capture::{LabelledMesh, Shot};
use super::creases::creased;
use super::range_image::{Claim, Claimed, RangeImage, Sight};
use super::surface_nets::{Sample, surface_net};
use crate::core::formats::{RawMesh, grouped};
use crate::core::geometry::{Mesh, pieces};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::median;
use crate::error::{Error, Result};
use crate::ffi::meshopt;
use glam::{IVec3, Vec2, Vec3};
use std::collections::{BTreeMap, BTreeSet};

/// Voxels along a side of a block: blocks are allocated whole where surface is.
const BLOCK: i32 = 8;
/// Voxels before and behind the surface whose distance is kept. Derived: the surface is found between
/// neighbours, and noise of depth is about a voxel, the pixels' own spacing.
const BAND: f32 = 4.0;
/// Voxels along the diagonal of what the depth shows at most. Derived: a room of 7 m has voxels of
/// 1 cm, and a surface of 150 m² some ten million of them within the band.
const FINEST: f32 = 700.0;
/// Pixels of all images whose spacing is asked.
const ASKED: usize = 20_000;
/// Pieces of fewer triangles before decimation are noise. Derived: a disc of five voxels' radius.
const SMALLEST: usize = 150;
/// Error of the decimated surface, in pixels of the photographs. Derived: a quarter of a pixel moves no
/// texel by more than the photographs' own registration; and in voxels, below the noise of depth.
const UNSEEN_ERROR: f32 = 0.25;
const NOISE: f32 = 0.1;
/// The surface that the shots' depth shows; `None` where none has depth.
///
/// # Errors
/// Depth that cannot be read, or shows no surface.
pub fn mesh_of_depth(
    shots: &[Shot],
    account: &mut Account,
    progress: &Progress,
) -> Result<Option<LabelledMesh>> {
    let with: Vec<&Shot> = shots.iter().filter(|s| s.depth.is_some()).collect();
    let Some(first) = with.first() else {
        return Ok(None);
    };
    let origin = first.world_from_camera.w_axis.truncate();
    let ranges = progress.stage("depth images", with.len() as u64, |p| {
        let read = |s: &&Shot| {
            p.advance(1);
            RangeImage::of(s, origin)
        };
        with.par_iter().map(read).collect::<Result<Vec<_>>>()
    })?;
    let ranges: Vec<RangeImage> = ranges.into_iter().flatten().collect();
    let Some(grid) = Grid::of(&ranges) else {
        let path = first.depth.as_ref().map_or(&first.image, |d| &d.path);
        return Err(Error::input(
            path,
            "none of the depth images shows a surface; expected metres (EXR) or millimetres (16-bit PNG). Give a mesh with --mesh",
        ));
    };
    let voxels = progress.stage("fusing the depth", 1, |_| grid.fused(&ranges));
    let known: Vec<IVec3> = voxels.keys().map(|k| IVec3::from_array(*k)).collect();
    let net = progress.stage("surface", 1, |_| {
        surface_net(&known, |p| voxels.get(&p.to_array()).copied())
    });
    let fused = 2 * net.squares.len();
    let error = (UNSEEN_ERROR * grid.resolved).max(NOISE * grid.voxel);
    let (places, triangles) = progress.stage("creases", 1, |_| creased(&net, &ranges, grid.voxel));
    let mesh = progress.stage("decimation", 1, |_| {
        decimated(places, triangles, &grid, error)
    });
    account.converted(format!(
        "no mesh: surface from {} depth images, voxels of {:.1} cm, {} triangles, decimated to {} at {:.0} mm; what all of them see only behind something is closed",
        ranges.len(),
        100.0 * grid.voxel,
        grouped(fused),
        grouped(mesh.triangles.len()),
        1000.0 * error
    ));
    if mesh.triangles.is_empty() {
        return Err(Error::input(
            &first.image,
            "its depth and that of the others never agree on a surface; check units and poses, or give a mesh with --mesh",
        ));
    }
    Ok(Some(LabelledMesh {
        mesh: RawMesh {
            positions: (mesh.positions.iter())
                .map(|p| p.as_dvec3() + origin)
                .collect(),
            triangles: mesh.triangles,
            ..RawMesh::default()
        },
        classes: Vec::new(),
    }))
}

/// The grid that distances are averaged on.
struct Grid {
    /// What the depth shows lies between these, metres.
    bounds: [Vec3; 2],
    /// Side of a voxel, metres.
    voxel: f32,
    /// What a pixel of the photographs is wide on the surface, metres.
    resolved: f32,
}

impl Grid {
    /// As fine as the depth images' pixels, within [`FINEST`]; `None` where they show nothing.
    fn of(ranges: &[RangeImage]) -> Option<Self> {
        let total: usize = ranges.iter().map(|r| r.depth.data.len()).sum();
        let step = (total / ASKED).max(1);
        let (mut spacing, mut resolved) = (Vec::new(), Vec::new());
        let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for r in ranges {
            for i in (0..r.depth.data.len()).step_by(step) {
                let Some(p) = r.point(i) else { continue };
                (lo, hi) = (lo.min(p), hi.max(p));
                let side = r.depth.data[i] * r.camera.pixel_angle(r.pixel(i));
                spacing.push(side);
                resolved.push(side / r.finer);
            }
        }
        let voxel = median(spacing)?.max((hi - lo).length() / FINEST);
        (voxel > 0.0).then_some(Self {
            bounds: [lo, hi],
            voxel,
            resolved: median(resolved)?,
        })
    }

    fn block_of(&self, place: Vec3) -> [i32; 3] {
        let side = self.voxel * BLOCK as f32;
        (place / side).floor().as_ivec3().to_array()
    }

    /// What is known of every voxel near the surface.
    fn fused(&self, ranges: &[RangeImage]) -> BTreeMap<[i32; 3], Sample> {
        let mut blocks = self.blocks(ranges);
        blocks.extend(self.frontier(ranges));
        let blocks: Vec<[i32; 3]> = blocks.into_iter().collect();
        let fuse = |b: &[i32; 3]| {
            let first = IVec3::from_array(*b) * BLOCK;
            let voxels = (0..BLOCK.pow(3))
                .map(move |k| first + IVec3::new(k / BLOCK / BLOCK, k / BLOCK % BLOCK, k % BLOCK));
            let value = |v: IVec3| {
                let value = self
                    .measured(v, ranges)
                    .or_else(|| self.graded(v, ranges))?;
                Some((v.to_array(), value))
            };
            voxels.filter_map(value).collect::<Vec<_>>()
        };
        let fused: Vec<Vec<([i32; 3], Sample)>> = blocks.par_iter().map(fuse).collect();
        fused.into_iter().flatten().collect()
    }

    /// Blocks within the band of what any pixel sees.
    fn blocks(&self, ranges: &[RangeImage]) -> BTreeSet<[i32; 3]> {
        let of_image = |r: &RangeImage| {
            let mut blocks = BTreeSet::new();
            for p in (0..r.depth.data.len()).filter_map(|i| r.point(i)) {
                let ray = (p - r.camera.position).normalize_or_zero();
                let reach = BAND * self.voxel;
                blocks.extend([-reach, 0.0, reach].map(|t| self.block_of(p + ray * t)));
            }
            blocks
        };
        let found: Vec<BTreeSet<[i32; 3]>> = ranges.par_iter().map(of_image).collect();
        found.into_iter().flatten().collect()
    }

    /// Blocks that what is seen through and what is hidden share.
    fn frontier(&self, ranges: &[RangeImage]) -> Vec<[i32; 3]> {
        let [lo, hi] = self.bounds.map(|p| IVec3::from_array(self.block_of(p)));
        let size = (hi - lo + 1).as_usizevec3();
        let block = |k: usize| {
            let at = [k / size.y / size.z, k / size.z % size.y, k % size.z];
            lo + IVec3::from_array(at.map(|v| v as i32))
        };
        let shared = |b: &IVec3| {
            // its corners, and halfway between them
            let at = (0..27).map(|k| IVec3::new(k / 9, k / 3 % 3, k % 3) * (BLOCK / 2));
            let sights = at.map(|o| self.sight((*b * BLOCK + o).as_vec3(), ranges));
            let found: Vec<Sight> = sights.flatten().collect();
            found.contains(&Sight::Empty) && found.contains(&Sight::Behind)
        };
        let all = (0..size.x * size.y * size.z).into_par_iter().map(block);
        all.filter(shared).map(|b| b.to_array()).collect()
    }

    /// What the images together say of a place, in voxels: empty if one sees through it, hidden if it lies
    /// behind something for all that look; `None` if nobody says.
    fn sight(&self, place: Vec3, ranges: &[RangeImage]) -> Option<Sight> {
        let band = BAND * self.voxel;
        let mut together = None;
        for sight in (ranges.iter()).filter_map(|r| r.sight(place * self.voxel, band)) {
            match sight {
                Sight::Empty => return Some(Sight::Empty),
                Sight::Behind if together.is_none() => together = Some(Sight::Behind),
                Sight::Behind => {}
                Sight::NoDepth => together = Some(Sight::NoDepth),
            }
        }
        together
    }

    /// A distance where none was measured: the mean over the places around, so that the frontier of what
    /// is hidden runs smoothly between voxels.
    fn graded(&self, voxel: IVec3, ranges: &[RangeImage]) -> Option<Sample> {
        let (mut sum, mut count) = (0.0, 0.0);
        for k in 0..8 {
            let corner = IVec3::new(k / 4, k / 2 % 2, k % 2) * 2 - 1;
            match self.sight((voxel + corner).as_vec3(), ranges) {
                Some(Sight::Empty) => sum += BAND,
                Some(Sight::Behind) => sum -= BAND,
                Some(Sight::NoDepth) => return None,
                // beside something that is seen too grazing to be measured
                None => continue,
            }
            count += 1.0;
        }
        (count > 0.0).then(|| Sample {
            distance: sum / count,
            inside: 0.5 - 0.5 * sum / count / BAND,
        })
    }

    /// What the images that measure a voxel say together; `None` where none does.
    fn measured(&self, voxel: IVec3, ranges: &[RangeImage]) -> Option<Sample> {
        let place = voxel.as_vec3() * self.voxel;
        let claims: Vec<Claim> = (ranges.iter())
            .filter_map(|r| r.claim(place, BAND * self.voxel))
            .collect();
        let (mut before, mut behind) = (Votes::default(), Votes::default());
        let (mut facing, mut whole_pixel) = (Vec3::ZERO, false);
        for claim in &claims {
            if let Claimed::Surface {
                distance,
                normal,
                whole,
            } = claim.of
            {
                let voxels = distance / self.voxel;
                // (nothing is left of a distance behind by the band)
                if voxels <= -BAND {
                    continue;
                }
                let squarely = normal.dot(claim.to_camera).max(0.0);
                let weight = claim.weight * squarely;
                let vote = weight * squarely;
                match voxels < 0.0 {
                    true => behind.add(voxels, weight * trust(voxels), vote * solid(voxels)),
                    false => before.add(voxels, weight, vote),
                }
                facing += normal * weight;
                whole_pixel |= whole && voxels.abs() <= 1.0;
            }
        }
        let facing = facing.normalize_or_zero();
        for claim in &claims {
            // a pixel is the longer on the surface the more it grazes it, and its outline as uncertain
            let squarely = match facing == Vec3::ZERO {
                true => 1.0,
                false => facing.dot(claim.to_camera),
            };
            let vote = claim.weight * squarely * squarely;
            match claim.of {
                Claimed::Clear => before.add(BAND, claim.weight, vote),
                // what has no depth has been looked through or past; on a surface a sensor has gaps
                Claimed::Nothing if !whole_pixel => before.add(BAND, claim.weight, vote),
                _ => {}
            }
        }
        if before.weight + behind.weight <= 0.0 {
            return None;
        }
        let inside = behind.votes / (before.votes + behind.votes);
        let mean = (before.sum + behind.sum) / (before.weight + behind.weight);
        // where the mean of different surfaces' distances is on the other side of them than most are,
        // those that are most
        let distance = match (inside > 0.5, mean < 0.0) {
            (true, false) => behind.sum / behind.weight,
            (false, true) => before.sum / before.weight,
            _ => mean,
        };
        Some(Sample { distance, inside })
    }
}

/// Distances of one sign.
#[derive(Default)]
struct Votes {
    /// Of the distances times their weights, voxels.
    sum: f32,
    weight: f32,
    /// Weights as evidence for this sign.
    votes: f32,
}

impl Votes {
    fn add(&mut self, distance: f32, weight: f32, votes: f32) {
        self.sum += distance * weight;
        self.weight += weight;
        self.votes += votes;
    }
}

/// What a distance behind a surface weighs in a mean, in voxels: by more than a voxel it may be another's, or
/// nobody's, and gives way to an image that sees through; behind by the band it says nothing (the
/// drop-off of Oleynikova et al. 2017, "Voxblox").
fn trust(distance: f32) -> f32 {
    ((BAND + distance) / (BAND - 1.0)).clamp(0.0, 1.0)
}

/// What a place behind a surface weighs as evidence for something solid, in voxels: within the noise of a
/// voxel it is the surface; farther behind nobody has looked, and whoever looks through is right.
fn solid(distance: f32) -> f32 {
    (2.0 + distance).clamp(1e-3, 1.0)
}

/// The surface in metres without specks, and with no more triangles than an error of `error` metres
/// asks for.
fn decimated(mut places: Vec<Vec3>, triangles: Vec<[u32; 3]>, grid: &Grid, error: f32) -> Mesh {
    places.iter_mut().for_each(|p| *p *= grid.voxel);
    let mut mesh = Mesh {
        positions: places,
        triangles,
        ..Mesh::default()
    };
    let piece = pieces(&mesh);
    let mut size: BTreeMap<u32, usize> = BTreeMap::new();
    piece.iter().for_each(|p| *size.entry(*p).or_default() += 1);
    let kept = (mesh.triangles.iter().zip(&piece)).filter(|(_, p)| size[p] >= SMALLEST);
    mesh.triangles = kept.map(|(t, _)| *t).collect();
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let fewer = meshopt::simplified(&indices, &mesh.positions, error);
    mesh.triangles = fewer.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let all: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    // (parts copy normals and texture coordinates, of which there are none yet)
    mesh.normals = vec![Vec3::ZERO; mesh.positions.len()];
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    mesh.part(&all)
}
