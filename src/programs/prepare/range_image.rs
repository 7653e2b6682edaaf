//! A depth image as `depth_mesh` and `creases` ask it: what its pixels see and how that is turned, and
//! what it says of a place.

use super::capture::Shot;
use super::frame::metres;
use super::labels::camera;
use super::lens::Optics;
use crate::core::formats;
use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, Wrap, bilinear_taps};
use crate::core::parallel::prelude::*;
use crate::error::Result;
use glam::{DVec3, Vec2, Vec3};

/// Cosine below which depth is too uncertain to count. Derived: 80°, where a pixel's footprint is
/// six times as long as it is wide.
const GRAZING: f32 = 0.17;
/// Depth up to which sensors are trusted, metres. Cited: lidar of phones reaches 5 m; four times that
/// for depth that programs make.
const FARTHEST: f32 = 20.0;

/// Stands for the depth of a pixel that has none among others that have: nobody has looked through there.
const GAP: f32 = -1.0;
/// Neighbours without depth, of eight, that a pixel looking through something has. Derived: the corner of an
/// opening has three.
const OPEN: usize = 3;

/// A depth image ready to be fused.
pub(super) struct RangeImage {
    /// At the image's size, relative to the capture's origin.
    pub camera: Camera,
    /// Metres along the ray; 0 = none; [`GAP`] where the sensor has failed.
    pub depth: Plane<f32>,
    /// Unit normals of what the pixels see, towards the camera; zero where grazing or unknown, or where
    /// the pixel is a mixture.
    normal: Plane<Vec3>,
    /// Pixels of the photograph along one of the depth image.
    pub finer: f32,
}

/// What an image says of a place.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Sight {
    /// The image sees through it.
    Empty,
    /// It lies behind what the image sees.
    Behind,
    /// The image looks there and has no depth all about.
    NoDepth,
}

/// What an image measures of a place.
#[derive(Clone, Copy)]
pub(super) struct Claim {
    pub of: Claimed,
    /// Unit direction from the place to the camera.
    pub to_camera: Vec3,
    /// As finely as the place is seen: over the square of its distance.
    pub weight: f32,
}

/// What a place is said to be.
#[derive(Clone, Copy)]
pub(super) enum Claimed {
    /// Near a surface.
    Surface {
        /// Metres from the place to it along its normal, positive before it.
        distance: f32,
        /// Unit, towards the camera.
        normal: Vec3,
        /// Whether all pixels around have depth.
        whole: bool,
    },
    /// Far before all surface.
    Clear,
    /// Without depth: before nothing as far as the image measures, or in a large gap of its measurements.
    Nothing,
}

/// A pixel near a place of an image.
#[derive(Clone, Copy)]
struct Tap {
    /// Share of it in between.
    weight: f32,
    /// Its depth, metres.
    depth: f32,
}

/// How a surface runs along a row or a column of pixels.
enum Course {
    /// From one pixel to the next but one, or half of that, metres.
    Along(Vec3),
    /// Neither pixel beside it sees the same surface.
    Alone,
    /// One sees something nearer, the other something farther: between an object and what is behind it a
    /// sensor's pixel measures neither.
    Between,
}

impl RangeImage {
    /// A shot's depth; `None` for shots without, and lenses whose depth cannot be placed.
    ///
    /// # Errors
    /// Depth that cannot be read.
    pub fn of(shot: &Shot, origin: DVec3) -> Result<Option<Self>> {
        let (Some(depth), false) = (&shot.depth, matches!(shot.optics, Optics::Distorted(_)))
        else {
            return Ok(None);
        };
        let size = match shot.size {
            Some(size) => size,
            None => formats::image_info(&shot.image).map(|i| [i.width, i.height])?,
        };
        let depth = metres(depth, &shot.optics, size)?;
        let camera = camera(&shot.world_from_camera, &shot.optics, size, origin);
        let finer = size[0] as f32 / depth.width as f32;
        Ok(Some(Self::new(camera, depth, finer)))
    }

    /// Of depth in metres along the rays of a camera; what is no depth in (0, [`FARTHEST`]] counts as none.
    pub fn new(camera: Camera, mut depth: Plane<f32>, finer: f32) -> Self {
        let fine = |d: f32| d.is_finite() && d > 0.0 && d <= FARTHEST;
        let clean = |d: &mut f32| *d = if fine(*d) { *d } else { 0.0 };
        depth.data.iter_mut().for_each(clean);
        let mut image = Self {
            camera: camera.resized(depth.width, depth.height),
            normal: Plane::filled(0, 0, Vec3::ZERO),
            depth,
            finer,
        };
        image.mark_gaps();
        let of_pixel = |i: usize| image.turned(i).unwrap_or(Vec3::ZERO);
        let normals = (0..image.depth.data.len()).into_par_iter().map(of_pixel);
        image.normal = Plane {
            data: normals.collect(),
            width: image.depth.width,
            height: image.depth.height,
        };
        image
    }

    /// Tells gaps of the measurements from what is looked through.
    fn mark_gaps(&mut self) {
        let image = &*self;
        let none = |i: usize| image.depth.data[i] <= 0.0;
        let gap = |i: &usize| {
            let around = (0..9).filter_map(|k| image.beside(*i, k % 3 - 1, k / 3 - 1));
            none(*i) && around.filter(|k| k != i && none(*k)).count() < OPEN
        };
        let pixels = (0..image.depth.data.len()).into_par_iter();
        let gaps: Vec<usize> = pixels.filter(gap).collect();
        gaps.into_iter().for_each(|i| self.depth.data[i] = GAP);
    }

    /// The middle of pixel `i`.
    pub fn pixel(&self, i: usize) -> Vec2 {
        let width = self.depth.width;
        Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5)
    }

    /// What pixel `i` sees.
    pub fn point(&self, i: usize) -> Option<Vec3> {
        let d = self.depth.data[i];
        (d > 0.0).then(|| self.camera.position + self.camera.direction(self.pixel(i)) * d)
    }

    /// How what pixel `i` sees is turned, where that is known.
    pub fn normal(&self, i: usize) -> Option<Vec3> {
        Some(self.normal.data[i]).filter(|n| *n != Vec3::ZERO)
    }

    /// The pixel `across` columns and `down` rows from pixel `i`; `None` beyond the border.
    pub fn beside(&self, i: usize, across: isize, down: isize) -> Option<usize> {
        let (w, h) = (self.depth.width as isize, self.depth.height as isize);
        let (x, y) = (i as isize % w + across, i as isize / w + down);
        let x = match self.wrap() {
            Wrap::Repeat => x.rem_euclid(w),
            Wrap::Clamp => x,
        };
        ((0..w).contains(&x) && (0..h).contains(&y)).then_some((y * w + x) as usize)
    }

    /// The pixel that sees a place, if any looks there.
    pub fn looking_at(&self, place: Vec3) -> Option<usize> {
        Some(self.at(self.camera.project(place)?))
    }

    fn at(&self, pixel: Vec2) -> usize {
        let (w, h) = (self.depth.width, self.depth.height);
        (pixel.y as usize).min(h - 1) * w + (pixel.x as usize).min(w - 1)
    }

    fn wrap(&self) -> Wrap {
        match self.camera.projection {
            Projection::Equirectangular => Wrap::Repeat,
            Projection::Pinhole(_) => Wrap::Clamp,
        }
    }

    /// What the image measures of a place, clear if more than `band` metres before what it sees; `None`
    /// where it does not look, or cannot tell.
    pub fn claim(&self, place: Vec3, band: f32) -> Option<Claim> {
        let pixel = self.camera.project(place)?;
        let back = self.camera.position - place;
        let along = back.length();
        let to_camera = back / along;
        let claim = |of: Claimed| Claim {
            of,
            to_camera,
            weight: 1.0 / (along * along),
        };
        let taps = self.depths(pixel);
        let seen = nearest(&taps);
        if seen <= 0.0 {
            return (seen > GAP).then(|| claim(Claimed::Nothing));
        }
        let depth = between(&taps, seen, self.slope(pixel))?;
        let normal = self.normal(self.at(pixel))?;
        // zero where the ray's depth is, near it as long as along the normal
        let distance = (depth - along) * normal.dot(to_camera).max(GRAZING);
        Some(claim(match distance < band {
            true => Claimed::Surface {
                distance,
                normal,
                whole: taps.iter().all(|t| t.depth > 0.0),
            },
            false => Claimed::Clear,
        }))
    }

    /// What the image says of a place about which it measures no distance; `None` where it does not look, or
    /// within `band` metres of what it sees.
    pub fn sight(&self, place: Vec3, band: f32) -> Option<Sight> {
        // at an outline the nearest pixel decides
        let depth = nearest(&self.depths(self.camera.project(place)?));
        let along = (place - self.camera.position).length();
        if depth <= 0.0 {
            return (depth > GAP).then_some(Sight::NoDepth);
        }
        match (along < depth - band, along > depth + band) {
            (true, _) => Some(Sight::Empty),
            (_, true) => Some(Sight::Behind),
            _ => None,
        }
    }

    /// The four pixels around a place of the image.
    fn depths(&self, pixel: Vec2) -> [Tap; 4] {
        let (w, h) = (self.depth.width, self.depth.height);
        bilinear_taps(w, h, pixel, self.wrap()).map(|(k, weight)| Tap {
            weight,
            depth: self.depth.data[k],
        })
    }

    /// Most that depth changes from one pixel to the next across a diagonal, on a surface that is seen as
    /// grazing as counts, as a share of the depth.
    fn slope(&self, pixel: Vec2) -> f32 {
        std::f32::consts::SQRT_2 * self.camera.pixel_angle(pixel) / GRAZING
    }

    /// The normal of what pixel `i` sees, by the pixels beside it that see the same surface; `None` where it
    /// is grazing or unknown, or the pixel is a mixture.
    fn turned(&self, i: usize) -> Option<Vec3> {
        let ray = (self.point(i)? - self.camera.position).normalize();
        let steps = |across: isize, down: isize| {
            [-2, -1, 1, 2].map(|k| self.beside(i, k * across, k * down))
        };
        let (across, down) = match (self.course(i, steps(1, 0)), self.course(i, steps(0, 1))) {
            (Course::Along(a), Course::Along(d)) => (a, d),
            // of a bar one pixel wide nobody says how it is turned: as towards the camera
            (Course::Along(a), Course::Alone) => (a, ray.cross(a)),
            (Course::Alone, Course::Along(d)) => (ray.cross(d), d),
            _ => return None,
        };
        let normal = across.cross(down).normalize_or_zero();
        let normal = normal * -normal.dot(ray).signum();
        (-normal.dot(ray) > GRAZING).then_some(normal)
    }

    /// How the surface runs at pixel `i`, by the two pixels `beside` it on either side, first to last.
    /// Of three neighbours in a row those that lie on a line: next to a crease they are on its one side
    /// (as essentially non-oscillating schemes choose theirs; Harten et al. 1987).
    fn course(&self, i: usize, beside: [Option<usize>; 4]) -> Course {
        let slope = self.slope(self.pixel(i));
        let depth = |k: usize| self.depth.data[k];
        let linked = |from: Option<usize>, to: Option<usize>| {
            let ends = from.zip(to);
            ends.is_some_and(|(a, b)| continues(depth(a), depth(b), slope))
        };
        let row = [beside[0], beside[1], Some(i), beside[2], beside[3]];
        let point = |k: usize| row[k].and_then(|p| self.point(p));
        let straight = |k: usize| {
            let whole = linked(row[k], row[k + 1]) && linked(row[k + 1], row[k + 2]);
            let [a, b, c] = [point(k)?, point(k + 1)?, point(k + 2)?];
            let along = c - a;
            let bend = (b - a).cross(along).length() / along.length_squared();
            whole.then_some((bend, along))
        };
        // (the middle first: of equals it is the one that stays)
        let three = [1, 0, 2].into_iter().filter_map(straight);
        let straightest = three.reduce(|a, b| if b.0 < a.0 { b } else { a });
        if let Some((_, along)) = straightest {
            return Course::Along(along);
        }
        for k in [1, 2] {
            if let (true, Some(from), Some(to)) =
                (linked(row[k], row[k + 1]), point(k), point(k + 1))
            {
                return Course::Along(to - from);
            }
        }
        let farther = |k: usize| row[k].map_or(0.0, depth);
        let [one, other] = [1, 3].map(|k| farther(k) <= 0.0 || farther(k) > depth(i));
        if one == other {
            Course::Alone
        } else {
            Course::Between
        }
    }
}

/// The depth of the nearest of the pixels around a place.
fn nearest(taps: &[Tap]) -> f32 {
    let heaviest = taps.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    heaviest.map_or(0.0, |t| t.depth)
}

/// Depth between the pixels' centres, of those that see the surface of depth `seen`: its inverse is linear on
/// planes.
fn between(taps: &[Tap], seen: f32, slope: f32) -> Option<f32> {
    let (mut inverse, mut whole) = (0.0, 0.0);
    for &Tap { weight, depth } in taps {
        if continues(depth, seen, slope) {
            inverse += weight / depth;
            whole += weight;
        }
    }
    (whole > 0.0).then(|| whole / inverse)
}

/// Whether two depths are of one surface that is seen less than grazing.
fn continues(depth: f32, other: f32, slope: f32) -> bool {
    depth > 0.0 && other > 0.0 && (depth - other).abs() <= slope * depth.max(other)
}
