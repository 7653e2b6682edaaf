//! A mesh from depth images, for captures that bring none: their signed distances are
//! averaged on a grid of voxels (Curless and Levoy 1996, "A Volumetric Method for Building Complex
//! Models from Range Images"), and the surface is where the mean is zero. What every image sees only
//! behind something is taken for solid (their section 4, hole filling): so a lamp seen from below has
//! an upper side, from which it shines as well, and no light leaks in behind a cupboard. Where an image
//! looks and has no depth (a window), nothing is closed. The surface is then decimated to what the
//! photographs resolve. Called by `write`.

use super::account::Account;
use super::capture::{LabelledMesh, Shot};
use super::frame::metres;
use super::labels::camera;
use super::lens::Optics;
use super::surface_nets::{Net, surface_net};
use crate::core::formats::{self, RawMesh, grouped};
use crate::core::geometry::{Camera, Mesh, Projection, pieces};
use crate::core::image::{Plane, Wrap, bilinear_taps};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::median;
use crate::error::{Error, Result};
use crate::ffi::meshopt;
use glam::{DVec3, IVec3, Vec2, Vec3};
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
/// Cosine below which depth is too uncertain to count. Derived: 80°, where a pixel's footprint is
/// six times as long as it is wide.
const GRAZING: f32 = 0.17;
/// Depth up to which sensors are trusted, metres. Cited: lidar of phones reaches 5 m; four times that
/// for depth that programs make.
const FARTHEST: f32 = 20.0;

/// A depth image ready to be fused.
struct Range {
    /// At the image's size, relative to the capture's origin.
    camera: Camera,
    /// Metres along the ray; 0 = none.
    depth: Plane<f32>,
    /// Pixels of the photograph along one of the depth image.
    finer: f32,
}

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
            range_of(s, origin)
        };
        with.par_iter().map(read).collect::<Result<Vec<_>>>()
    })?;
    let ranges: Vec<Range> = ranges.into_iter().flatten().collect();
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
    let fused = net.triangles.len();
    let error = (UNSEEN_ERROR * grid.resolved).max(NOISE * grid.voxel);
    let mesh = progress.stage("decimation", 1, |_| decimated(&net, &grid, error));
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

/// A shot's depth; `None` for lenses whose depth cannot be placed.
fn range_of(shot: &Shot, origin: DVec3) -> Result<Option<Range>> {
    let (Some(depth), false) = (&shot.depth, matches!(shot.optics, Optics::Distorted(_))) else {
        return Ok(None);
    };
    let size = match shot.size {
        Some(size) => size,
        None => formats::image_info(&shot.image).map(|i| [i.width, i.height])?,
    };
    let mut depth = metres(depth, &shot.optics, size)?;
    let fine = |d: f32| d.is_finite() && d > 0.0 && d <= FARTHEST;
    let clean = |d: &mut f32| *d = if fine(*d) { *d } else { 0.0 };
    depth.data.iter_mut().for_each(clean);
    let camera = camera(&shot.world_from_camera, &shot.optics, size, origin);
    Ok(Some(Range {
        finer: size[0] as f32 / depth.width as f32,
        camera: camera.resized(depth.width, depth.height),
        depth,
    }))
}

impl Range {
    fn pixel(&self, i: usize) -> Vec2 {
        let width = self.depth.width;
        Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5)
    }

    /// What pixel `i` sees.
    fn point(&self, i: usize) -> Option<Vec3> {
        let d = self.depth.data[i];
        (d > 0.0).then(|| self.camera.position + self.camera.direction(self.pixel(i)) * d)
    }

    /// Distance from a place to the surface, metres, positive before it, and its weight: as squarely
    /// and as near as the surface is seen.
    fn distance(&self, place: Vec3) -> Option<(f32, f32)> {
        let pixel = self.camera.project(place)?;
        let depth = self.depth_at(pixel)?;
        let cosine = self.cosine(pixel)?;
        let along = (place - self.camera.position).length();
        // zero where the ray's depth is, near it as long as along the normal
        Some(((depth - along) * cosine, cosine / (depth * depth)))
    }

    /// What the image says of a place about which it measures no distance; `None` where it does not look, or
    /// within `band` metres of what it sees.
    fn sight(&self, place: Vec3, band: f32) -> Option<Sight> {
        // at an outline the nearest pixel decides
        let depth = nearest(&self.depths(self.camera.project(place)?));
        let along = (place - self.camera.position).length();
        if depth <= 0.0 {
            return Some(Sight::NoDepth);
        }
        match (along < depth - band, along > depth + band) {
            (true, _) => Some(Sight::Empty),
            (_, true) => Some(Sight::Behind),
            _ => None,
        }
    }

    /// The four pixels around a place of the image: weight and depth.
    fn depths(&self, pixel: Vec2) -> [(f32, f32); 4] {
        let (w, h) = (self.depth.width, self.depth.height);
        let wrap = match self.camera.projection {
            Projection::Equirectangular => Wrap::Repeat,
            Projection::Pinhole(_) => Wrap::Clamp,
        };
        bilinear_taps(w, h, pixel, wrap).map(|(k, weight)| (weight, self.depth.data[k]))
    }

    /// Depth between the pixels' centres, of those that see what the nearest one sees: its inverse is linear
    /// on planes.
    fn depth_at(&self, pixel: Vec2) -> Option<f32> {
        let taps = self.depths(pixel);
        let (seen, slope) = (nearest(&taps), self.slope(pixel));
        let (mut inverse, mut whole) = (0.0, 0.0);
        for (weight, depth) in taps {
            if continues(depth, seen, slope) {
                inverse += weight / depth;
                whole += weight;
            }
        }
        (whole > 0.0).then(|| whole / inverse)
    }

    /// Most that depth changes from one pixel to the next across a diagonal, on a surface that is seen as
    /// grazing as counts, as a share of the depth.
    fn slope(&self, pixel: Vec2) -> f32 {
        std::f32::consts::SQRT_2 * self.camera.pixel_angle(pixel) / GRAZING
    }

    /// Cosine between the ray through a pixel and the surface there, by the pixels beside it that see the same
    /// surface; `None` where it is grazing or unknown, or the pixel is a mixture.
    fn cosine(&self, pixel: Vec2) -> Option<f32> {
        let (w, h) = (self.depth.width, self.depth.height);
        let (x, y) = ((pixel.x as usize).min(w - 1), (pixel.y as usize).min(h - 1));
        let index = |x: usize, y: usize| y.min(h - 1) * w + x.min(w - 1);
        let at = index(x, y);
        let slope = self.slope(self.pixel(at));
        let course = |after, before| self.course(at, [after, before], slope);
        let across = course(index(x + 1, y), index(x.saturating_sub(1), y));
        let down = course(index(x, y + 1), index(x, y.saturating_sub(1)));
        let ray = self.camera.direction(pixel);
        // of a bar one pixel wide nobody says how it is turned: as towards the camera
        let (across, down) = match (across, down) {
            (Course::Along(a), Course::Along(d)) => (a, d),
            (Course::Along(a), Course::Alone) => (a, ray.cross(a)),
            (Course::Alone, Course::Along(d)) => (ray.cross(d), d),
            _ => return None,
        };
        let cosine = across.cross(down).normalize_or_zero().dot(ray).abs();
        (cosine > GRAZING).then_some(cosine)
    }

    /// How the surface runs at pixel `at`, by those `beside` it, after and before, that see the same one.
    fn course(&self, at: usize, beside: [usize; 2], slope: f32) -> Course {
        let depth = |i: usize| self.depth.data[i];
        let [from, to] = match beside.map(|i| continues(depth(i), depth(at), slope)) {
            [true, true] => [beside[1], beside[0]],
            [true, false] => [at, beside[0]],
            [false, true] => [beside[1], at],
            [false, false] => {
                let [one, other] = beside.map(|i| depth(i) <= 0.0 || depth(i) > depth(at));
                return if one == other {
                    Course::Alone
                } else {
                    Course::Between
                };
            }
        };
        let ends = self.point(to).zip(self.point(from));
        ends.map_or(Course::Between, |(to, from)| Course::Along(to - from))
    }
}

/// How a surface runs from pixel to pixel.
enum Course {
    /// From one pixel to the next but one, or half of that, metres.
    Along(Vec3),
    /// Neither pixel beside it sees the same surface.
    Alone,
    /// One sees something nearer, the other something farther: between an object and what is behind it a
    /// sensor's pixel measures neither.
    Between,
}

/// The depth of the nearest of the pixels around a place: weight and depth.
fn nearest(taps: &[(f32, f32)]) -> f32 {
    let heaviest = taps.iter().max_by(|a, b| a.0.total_cmp(&b.0));
    heaviest.map_or(0.0, |(_, depth)| *depth)
}

/// Whether two depths are of one surface that is seen less than grazing.
fn continues(depth: f32, other: f32, slope: f32) -> bool {
    depth > 0.0 && other > 0.0 && (depth - other).abs() <= slope * depth.max(other)
}

/// What an image says of a place.
#[derive(Clone, Copy, PartialEq)]
enum Sight {
    /// The image sees through it.
    Empty,
    /// It lies behind what the image sees.
    Behind,
    /// The image looks there and has no depth.
    NoDepth,
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
    fn of(ranges: &[Range]) -> Option<Self> {
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

    /// Mean distance of every voxel near the surface, in voxels.
    fn fused(&self, ranges: &[Range]) -> BTreeMap<[i32; 3], f32> {
        let mut blocks = self.blocks(ranges);
        blocks.extend(self.frontier(ranges));
        let blocks: Vec<[i32; 3]> = blocks.into_iter().collect();
        let fuse = |b: &[i32; 3]| {
            let first = IVec3::from_array(*b) * BLOCK;
            let voxels = (0..BLOCK.pow(3))
                .map(move |k| first + IVec3::new(k / BLOCK / BLOCK, k / BLOCK % BLOCK, k % BLOCK));
            let value = |v: IVec3| {
                let value = self.mean(v, ranges).or_else(|| self.graded(v, ranges))?;
                Some((v.to_array(), value))
            };
            voxels.filter_map(value).collect::<Vec<_>>()
        };
        let fused: Vec<Vec<([i32; 3], f32)>> = blocks.par_iter().map(fuse).collect();
        fused.into_iter().flatten().collect()
    }

    /// Blocks within the band of what any pixel sees.
    fn blocks(&self, ranges: &[Range]) -> BTreeSet<[i32; 3]> {
        let of_image = |r: &Range| {
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
    fn frontier(&self, ranges: &[Range]) -> Vec<[i32; 3]> {
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
    fn sight(&self, place: Vec3, ranges: &[Range]) -> Option<Sight> {
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
    fn graded(&self, voxel: IVec3, ranges: &[Range]) -> Option<f32> {
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
        (count > 0.0).then(|| sum / count)
    }

    fn mean(&self, voxel: IVec3, ranges: &[Range]) -> Option<f32> {
        let place = voxel.as_vec3() * self.voxel;
        let (mut sum, mut whole) = (0.0f32, 0.0f32);
        for (distance, weight) in ranges.iter().filter_map(|r| r.distance(place)) {
            let voxels = distance / self.voxel;
            let weight = weight * trust(voxels);
            if weight > 0.0 {
                sum += voxels.min(BAND) * weight;
                whole += weight;
            }
        }
        (whole > 0.0).then(|| sum / whole)
    }
}

/// What a distance weighs, in voxels: behind a surface by more than a voxel it may be another's, or nobody's,
/// and gives way to an image that sees through; behind by the band it says nothing (the drop-off of
/// Oleynikova et al. 2017, "Voxblox").
fn trust(distance: f32) -> f32 {
    ((BAND + distance) / (BAND - 1.0)).clamp(0.0, 1.0)
}

/// The surface in metres without specks, and with no more triangles than an error of `error` metres
/// asks for.
fn decimated(net: &Net, grid: &Grid, error: f32) -> Mesh {
    let mut mesh = Mesh {
        positions: net.positions.iter().map(|p| *p * grid.voxel).collect(),
        triangles: net.triangles.clone(),
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
