//! Tiles: the images in which a photograph is shown to a network, and how what it gives for them is
//! put together, weighted by a tent that falls to a tile's border.
//!
//! A panorama goes whole to a network made for panoramas, once as it is and once turned by half, so
//! that the seam of each lies in the middle of the other; to others in perspective tiles over the
//! sphere. A perspective photograph is scaled until it covers the input as tightly as it can and cut
//! along its longer side (the sliding window of segmentation toolboxes: MMSegmentation's
//! `test_cfg = dict(mode="slide", crop_size=512, stride=341)`), since a network sees in a whole room
//! what it cannot in a piece of wall.

use super::engine_types::Shape;
use super::options::PanoramaTiles;
use crate::core::geometry::{Camera, Lens, Projection};
use glam::{Mat3, Vec2, Vec3};

/// Share of a tile that the next one sees too, at least. Cited: a third in the sliding window above.
const OVERLAP: f32 = 1.0 / 3.0;
/// Longer side of what goes into a network that takes any size. Cited: 1024 columns for panoramas (Jiang et
/// al. 2021, "UniFuse"), and the size within which segmentation toolboxes test.
const LONGEST: usize = 1024;
/// Side of a perspective tile for a network that takes any size. Cited: the crop of the sliding window.
const SIDE: usize = 512;
/// Sides of networks of any size are multiples of it. Cited: the coarsest level of common backbones is
/// halved five times (He et al. 2016).
const MULTIPLE: usize = 32;
/// Angle of view of a perspective tile's shorter side, degrees. Derived: cameras of data sets of rooms see 60 to 90.
const VIEW: f32 = 90.0;
/// Elevation of a row of tiles, degrees, and tiles round it. Derived: steps of 60° along the horizon are an
/// overlap of a third; at 60° four reach from the poles to 15°, and leave no gap (a test asks every pixel).
const ROWS: [(f32, usize); 3] = [(0.0, 6), (60.0, 4), (-60.0, 4)];

/// An image for a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tile {
    /// Columns and rows.
    pub size: [usize; 2],
    /// The photograph's camera; pixels of lenses that it has no projection for are used, directions not.
    pub photo: Camera,
    place: Place,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// A rectangle of the photograph: where it begins, and pixels of the photograph along one of the tile.
    Part { corner: Vec2, step: Vec2 },
    /// A perspective image of a panorama.
    Turned(Camera),
}

/// Tiles of a photograph for a network.
pub(super) fn tiles_of(
    photo: &Camera,
    shape: Shape,
    panoramas: Option<PanoramaTiles>,
) -> Vec<Tile> {
    let panoramic = shape.width == shape.height.map(|h| 2 * h) && shape.width.is_some();
    let whole = match panoramas {
        Some(stated) => stated == PanoramaTiles::Whole,
        None => panoramic,
    };
    match photo.projection {
        Projection::Equirectangular if whole => {
            let size = match (shape.width, shape.height) {
                (Some(w), Some(h)) => [w, h],
                _ => rounded([photo.width, photo.height]),
            };
            let turned = |corner: f32| Tile::part(photo, size, [corner, 0.0], [1.0, 1.0]);
            vec![turned(0.0), turned(0.5)]
        }
        Projection::Equirectangular => over_the_sphere(photo, shape),
        Projection::Pinhole(_) => along(photo, shape),
    }
}

/// Tiles of a photograph of which only pixels count.
fn along(photo: &Camera, shape: Shape) -> Vec<Tile> {
    let (Some(width), Some(height)) = (shape.width, shape.height) else {
        let size = rounded([photo.width, photo.height]);
        return vec![Tile::part(photo, size, [0.0; 2], [1.0; 2])];
    };
    let sides = Vec2::new(photo.width as f32, photo.height as f32);
    let size = Vec2::new(width as f32, height as f32);
    let scaled = sides * (size / sides).max_element();
    // shares of the photograph; less than a pixel over is stretched
    let seen = |k: usize| match scaled[k] - size[k] < 1.0 {
        true => 1.0,
        false => size[k] / scaled[k],
    };
    let share = [seen(0), seen(1)];
    let begins = |share: f32| {
        let gap = 1.0 - share;
        let steps = (gap / ((1.0 - OVERLAP) * share)).ceil();
        (0..=steps as usize).map(move |i| gap * i as f32 / steps.max(1.0))
    };
    (begins(share[1]))
        .flat_map(|y| begins(share[0]).map(move |x| [x, y]))
        .map(|corner| Tile::part(photo, [width, height], corner, share))
        .collect()
}

fn over_the_sphere(photo: &Camera, shape: Shape) -> Vec<Tile> {
    let (width, height) = (shape.width.unwrap_or(SIDE), shape.height.unwrap_or(SIDE));
    // the angle belongs to the shorter side
    let short = Lens::centred(width.min(height), height, VIEW);
    let lens = Lens {
        cx: 0.5 * width as f32,
        ..short
    };
    let mut tiles = Vec::new();
    for (elevation, count) in ROWS {
        for k in 0..count {
            let azimuth = std::f32::consts::TAU * k as f32 / count as f32;
            let turn =
                Mat3::from_rotation_y(azimuth) * Mat3::from_rotation_x(elevation.to_radians());
            let camera = Camera {
                projection: Projection::Pinhole(lens),
                width,
                height,
                world_from_camera: photo.world_from_camera * turn,
                position: photo.position,
            };
            tiles.push(Tile {
                size: [width, height],
                photo: *photo,
                place: Place::Turned(camera),
            });
        }
    }
    tiles
}

/// A size of about the same aspect that a network of any size takes.
fn rounded(sides: [usize; 2]) -> [usize; 2] {
    let longest = sides[0].max(sides[1]).max(1);
    let shrink = (LONGEST as f64 / longest as f64).min(1.0);
    sides.map(|s| ((s as f64 * shrink / MULTIPLE as f64).round() as usize).max(1) * MULTIPLE)
}

impl Tile {
    /// A part of a photograph: corner and extent as shares of its sides.
    fn part(photo: &Camera, size: [usize; 2], corner: [f32; 2], share: [f32; 2]) -> Self {
        let sides = Vec2::new(photo.width as f32, photo.height as f32);
        let step = sides * Vec2::from(share) / Vec2::new(size[0] as f32, size[1] as f32);
        Self {
            size,
            photo: *photo,
            place: Place::Part {
                corner: sides * Vec2::from(corner),
                step,
            },
        }
    }

    /// The place in the photograph that a place of the tile shows.
    pub fn photo_pixel(&self, pixel: Vec2) -> Option<Vec2> {
        match &self.place {
            Place::Part { corner, step } => {
                let mut p = *corner + pixel * *step;
                if self.photo.projection == Projection::Equirectangular {
                    p.x = p.x.rem_euclid(self.photo.width as f32);
                }
                Some(p)
            }
            Place::Turned(camera) => {
                let seen = camera.position + camera.direction(pixel);
                self.photo.project(seen)
            }
        }
    }

    /// The place in the tile that shows a place of the photograph; `None` outside it.
    pub fn tile_pixel(&self, photo_pixel: Vec2) -> Option<Vec2> {
        match &self.place {
            Place::Part { corner, step } => {
                let mut p = photo_pixel - *corner;
                if self.photo.projection == Projection::Equirectangular {
                    p.x = p.x.rem_euclid(self.photo.width as f32);
                }
                let p = p / *step;
                let inside = p.cmpge(Vec2::ZERO).all() && p.cmple(self.sides()).all();
                inside.then_some(p)
            }
            Place::Turned(camera) => {
                camera.project(camera.position + self.photo.direction(photo_pixel))
            }
        }
    }

    /// Unit direction in the world through a place of the tile.
    pub fn direction(&self, pixel: Vec2) -> Option<Vec3> {
        match &self.place {
            Place::Part { .. } => Some(self.photo.direction(self.photo_pixel(pixel)?)),
            Place::Turned(camera) => Some(camera.direction(pixel)),
        }
    }

    /// The place in the tile of a point of the world.
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        match &self.place {
            Place::Part { .. } => self.tile_pixel(self.photo.project(point)?),
            Place::Turned(camera) => camera.project(point),
        }
    }

    /// Length of a ray from the camera that goes one along the tile's optical axis; 1 in whole panoramas,
    /// which have none.
    pub fn along_axis(&self, direction: Vec3) -> f32 {
        let camera = match &self.place {
            Place::Turned(camera) => camera,
            Place::Part { .. } => &self.photo,
        };
        match camera.projection {
            Projection::Equirectangular => 1.0,
            // below zero only outside of the image
            Projection::Pinhole(_) => {
                1.0 / (-camera.world_from_camera.z_axis.dot(direction)).max(1e-3)
            }
        }
    }

    /// Whether the tile has an optical axis.
    pub fn is_perspective(&self) -> bool {
        matches!(self.place, Place::Turned(_))
            || matches!(self.photo.projection, Projection::Pinhole(_))
    }

    /// Pixels of the photograph along one of the tile, in its middle.
    pub fn step(&self) -> f32 {
        match &self.place {
            Place::Part { step, .. } => step.min_element(),
            Place::Turned(camera) => {
                // on the horizon a panorama's pixels are square
                let pixel = std::f32::consts::TAU / self.photo.width as f32;
                camera.pixel_angle(0.5 * self.sides()) / pixel
            }
        }
    }

    /// What a place of the tile weighs: 1 in the middle, nearly nothing at the border.
    pub fn weight(&self, pixel: Vec2) -> f32 {
        let half = 0.5 * self.sides();
        // (a quarter of a pixel at the border itself: somebody must speak for the photograph's)
        let tent = (half - (pixel - half).abs()).max(Vec2::splat(0.25)) / half;
        tent.x * tent.y
    }

    fn sides(&self) -> Vec2 {
        Vec2::new(self.size[0] as f32, self.size[1] as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panorama(width: usize) -> Camera {
        Camera {
            projection: Projection::Equirectangular,
            width,
            height: width / 2,
            world_from_camera: Mat3::from_rotation_y(0.7),
            position: Vec3::new(1.0, 2.0, 3.0),
        }
    }

    fn pinhole(width: usize, height: usize) -> Camera {
        Camera {
            projection: Projection::Pinhole(Lens::centred(width, height, 70.0)),
            width,
            height,
            world_from_camera: Mat3::from_rotation_x(0.2),
            position: Vec3::ZERO,
        }
    }

    fn fixed(width: usize, height: usize) -> Shape {
        Shape {
            width: Some(width),
            height: Some(height),
        }
    }

    const ANY: Shape = Shape {
        width: None,
        height: None,
    };

    /// Every pixel of the photograph is in a tile, and comes back from there; at the middle of a tile's border
    /// another one weighs more.
    fn covers(photo: &Camera, tiles: &[Tile]) {
        for y in 0..photo.height {
            for x in 0..photo.width {
                let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let found = tiles.iter().filter_map(|t| Some((t, t.tile_pixel(pixel)?)));
                let mut seen = 0;
                for (tile, at) in found {
                    let back = tile.photo_pixel(at).expect("seen");
                    assert!((back - pixel).length() < 0.02, "{pixel} {back}");
                    assert!(tile.weight(at) > 0.0);
                    seen += 1;
                }
                assert!(seen > 0, "{pixel}");
            }
        }
        for tile in tiles.iter().filter(|_| tiles.len() > 1) {
            let edge = Vec2::new(tile.size[0] as f32 - 0.01, 0.5 * tile.size[1] as f32);
            let Some(pixel) = tile.photo_pixel(edge) else {
                continue;
            };
            let at_photo_border = pixel.x > photo.width as f32 - 1.0;
            let others = tiles.iter().filter(|t| *t != tile);
            let most = others.filter_map(|t| Some(t.weight(t.tile_pixel(pixel)?)));
            let most = most.fold(0.0, f32::max);
            assert!(most > 2.0 * tile.weight(edge) || at_photo_border, "{most}");
        }
    }

    #[test]
    fn tiles_cover_a_photograph_and_overlap() {
        let photo = panorama(128);
        let sphere = tiles_of(&photo, fixed(64, 64), None);
        assert_eq!(sphere.len(), 14);
        covers(&photo, &sphere);
        covers(&photo, &tiles_of(&photo, fixed(96, 64), None));
        let whole = tiles_of(&photo, fixed(64, 32), None);
        assert_eq!(whole.len(), 2);
        covers(&photo, &whole);
        assert_eq!(
            tiles_of(&photo, fixed(64, 32), Some(PanoramaTiles::Perspective)).len(),
            14
        );
        assert_eq!(tiles_of(&photo, ANY, Some(PanoramaTiles::Whole)).len(), 2);
        let photo = pinhole(160, 90);
        // 114 scaled columns, tiles of 64 with 21 in common
        let slid = tiles_of(&photo, fixed(64, 64), None);
        assert_eq!(slid.len(), 3);
        covers(&photo, &slid);
        covers(&photo, &tiles_of(&photo, ANY, None));
        assert_eq!(tiles_of(&photo, fixed(320, 180), None).len(), 1);
        assert_eq!(
            tiles_of(&pinhole(2000, 1500), ANY, None)[0].size,
            [1024, 768]
        );
    }

    #[test]
    fn the_seam_of_a_panorama_is_the_middle_of_the_turned_one() {
        let photo = panorama(128);
        let whole = tiles_of(&photo, fixed(64, 32), None);
        let seam = Vec2::new(0.0, 32.0);
        assert!(whole[0].weight(whole[0].tile_pixel(seam).expect("seen")) < 0.02);
        assert!(whole[1].weight(whole[1].tile_pixel(seam).expect("seen")) > 0.98);
    }

    #[test]
    fn a_tile_sees_along_its_axis() {
        let photo = panorama(256);
        let tile = tiles_of(&photo, fixed(64, 64), None)[1];
        let middle = tile.direction(Vec2::splat(32.0)).expect("seen");
        assert!((tile.along_axis(middle) - 1.0).abs() < 1e-4);
        // at the middle of a border of a view of 90° a ray is √2 long
        let border = tile.direction(Vec2::new(64.0, 32.0)).expect("seen");
        assert!((tile.along_axis(border) - 2f32.sqrt()).abs() < 1e-3);
        let seen = photo.position + 3.0 * border;
        let at = tile.project(seen - 0.01 * border.any_orthonormal_vector());
        assert!(at.is_none_or(|p| (p - Vec2::new(64.0, 32.0)).length() < 1.0));
    }
}
