//! Posed cameras: equirectangular panoramas and pinhole images with OpenCV distortion.
//!
//! Axes are OpenGL's: x right, y up, looking down −z. Pixel centres lie at +0.5.

use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Pinhole intrinsics in pixels with OpenCV's radial-tangential distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    /// Focal length along x.
    pub fl_x: f32,
    /// Focal length along y.
    pub fl_y: f32,
    /// Principal point, column.
    pub cx: f32,
    /// Principal point, row.
    pub cy: f32,
    /// Radial coefficients k1, k2.
    pub k: [f32; 2],
    /// Tangential coefficients p1, p2.
    pub p: [f32; 2],
}

impl Lens {
    /// A lens without distortion, its axis through the middle of the image, with a horizontal angle
    /// of view in degrees.
    #[must_use]
    pub fn centred(width: usize, height: usize, degrees: f32) -> Self {
        let focal = 0.5 * width as f32 / (0.5 * degrees.to_radians()).tan();
        Self {
            fl_x: focal,
            fl_y: focal,
            cx: 0.5 * width as f32,
            cy: 0.5 * height as f32,
            ..Self::default()
        }
    }
}

/// How directions map to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Full panorama: docs/scene-format.md.
    Equirectangular,
    /// Perspective image.
    Pinhole(Lens),
}

/// A posed camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Projection model.
    pub projection: Projection,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Rotation from camera to world; columns are the camera's right, up and backward axes.
    pub world_from_camera: Mat3,
    /// Camera centre in world coordinates, metres relative to the scene's origin.
    pub position: Vec3,
}

impl Camera {
    /// The same camera at another image size with the same aspect.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (
            width as f32 / self.width as f32,
            height as f32 / self.height as f32,
        );
        let projection = match self.projection {
            Projection::Equirectangular => Projection::Equirectangular,
            Projection::Pinhole(l) => Projection::Pinhole(Lens {
                fl_x: l.fl_x * sx,
                fl_y: l.fl_y * sy,
                cx: l.cx * sx,
                cy: l.cy * sy,
                ..l
            }),
        };
        Self {
            projection,
            width,
            height,
            ..*self
        }
    }

    /// Unit world direction through continuous pixel coordinates.
    #[must_use]
    pub fn direction(&self, pixel: Vec2) -> Vec3 {
        match self.projection {
            Projection::Equirectangular => {
                self.on_sphere(self.azimuth(pixel.x), self.polar(pixel.y))
            }
            Projection::Pinhole(l) => {
                let distorted = Vec2::new((pixel.x - l.cx) / l.fl_x, (pixel.y - l.cy) / l.fl_y);
                let p = undistort(distorted, &l);
                (self.world_from_camera * Vec3::new(p.x, -p.y, -1.0)).normalize()
            }
        }
    }

    /// Sine and cosine of a panorama's azimuth at a column.
    fn azimuth(&self, x: f32) -> (f32, f32) {
        (TAU * (x / self.width as f32 - 0.5)).sin_cos()
    }

    /// Sine and cosine of a panorama's angle from the vertical at a row.
    fn polar(&self, y: f32) -> (f32, f32) {
        (PI * y / self.height as f32).sin_cos()
    }

    /// World direction of a panorama from sines and cosines of its angles.
    fn on_sphere(&self, azimuth: (f32, f32), polar: (f32, f32)) -> Vec3 {
        let d = Vec3::new(azimuth.0 * polar.0, polar.1, -azimuth.1 * polar.0);
        (self.world_from_camera * d).normalize()
    }

    /// Continuous pixel coordinates of a world point; `None` where the camera cannot see it (behind
    /// a pinhole camera, outside its frame, or the camera centre itself).
    #[must_use]
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        let d = self.world_from_camera.transpose() * (point - self.position);
        let length = d.length();
        if length.is_nan() || length <= 0.0 {
            return None;
        }
        match self.projection {
            Projection::Equirectangular => {
                let lambda = d.x.atan2(-d.z);
                let theta = (d.x * d.x + d.z * d.z).sqrt().atan2(d.y);
                Some(Vec2::new(
                    (lambda / TAU + 0.5) * self.width as f32,
                    theta / PI * self.height as f32,
                ))
            }
            Projection::Pinhole(l) => {
                if d.z >= -1e-6 * length {
                    return None;
                }
                let p = distort(Vec2::new(d.x / -d.z, -d.y / -d.z), &l);
                let pixel = Vec2::new(p.x * l.fl_x + l.cx, p.y * l.fl_y + l.cy);
                let inside = pixel.x >= 0.0
                    && pixel.y >= 0.0
                    && pixel.x < self.width as f32
                    && pixel.y < self.height as f32;
                inside.then_some(pixel)
            }
        }
    }

    /// Angle subtended by one pixel at continuous pixel coordinates, radians (square root of its
    /// solid angle).
    #[must_use]
    pub fn pixel_angle(&self, pixel: Vec2) -> f32 {
        self.pixel_solid_angle(pixel).sqrt()
    }

    /// Solid angle of the pixel at continuous pixel coordinates, steradians.
    #[must_use]
    pub fn pixel_solid_angle(&self, pixel: Vec2) -> f32 {
        match self.projection {
            Projection::Equirectangular => {
                let theta = PI * pixel.y / self.height as f32;
                let floor = 0.5 * PI / self.height as f32;
                (TAU / self.width as f32) * (PI / self.height as f32) * theta.sin().max(floor.sin())
            }
            Projection::Pinhole(l) => {
                let p = Vec2::new((pixel.x - l.cx) / l.fl_x, (pixel.y - l.cy) / l.fl_y);
                (1.0 + p.length_squared()).powf(-1.5) / (l.fl_x * l.fl_y).abs()
            }
        }
    }
}

/// Directions through the points of a grid laid over an image, of one point per pixel: a panorama's
/// angles are those of its rows and columns, whose sines are taken once.
#[derive(Clone, Debug)]
pub struct DirectionGrid {
    camera: Camera,
    /// Where in their pixels the points lie, (0, 0) to (1, 1).
    place: Vec2,
    /// Sine and cosine of the azimuth per column; none for pinhole cameras.
    azimuth: Vec<(f32, f32)>,
    /// Sine and cosine of the polar angle per row; none for pinhole cameras.
    polar: Vec<(f32, f32)>,
}

impl DirectionGrid {
    /// The grid of the points that lie at `place` in their pixels.
    #[must_use]
    pub fn new(camera: &Camera, place: Vec2) -> Self {
        let (columns, rows) = match camera.projection {
            Projection::Equirectangular => (camera.width, camera.height),
            Projection::Pinhole(_) => (0, 0),
        };
        Self {
            camera: *camera,
            place,
            azimuth: (0..columns)
                .map(|x| camera.azimuth(x as f32 + place.x))
                .collect(),
            polar: (0..rows)
                .map(|y| camera.polar(y as f32 + place.y))
                .collect(),
        }
    }

    /// Unit world direction through the point in a pixel: that of [`Camera::direction`], to the bit.
    #[must_use]
    #[inline]
    pub fn direction(&self, x: usize, y: usize) -> Vec3 {
        match (self.azimuth.get(x), self.polar.get(y)) {
            (Some(a), Some(p)) => self.camera.on_sphere(*a, *p),
            _ => self
                .camera
                .direction(Vec2::new(x as f32, y as f32) + self.place),
        }
    }
}

/// OpenCV's radial-tangential model (first two coefficients of each).
fn distort(p: Vec2, l: &Lens) -> Vec2 {
    let r2 = p.length_squared();
    let radial = 1.0 + r2 * (l.k[0] + r2 * l.k[1]);
    Vec2::new(
        p.x * radial + 2.0 * l.p[0] * p.x * p.y + l.p[1] * (r2 + 2.0 * p.x * p.x),
        p.y * radial + l.p[0] * (r2 + 2.0 * p.y * p.y) + 2.0 * l.p[1] * p.x * p.y,
    )
}

/// Inverse of [`distort`] by fixed-point iteration (as OpenCV's `undistortPoints`); exact without
/// coefficients.
fn undistort(target: Vec2, l: &Lens) -> Vec2 {
    if l.k == [0.0; 2] && l.p == [0.0; 2] {
        return target;
    }
    let mut p = target;
    for _ in 0..20 {
        let next = p + (target - distort(p, l));
        if next == p {
            break;
        }
        p = next;
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotation() -> Mat3 {
        Mat3::from_euler(glam::EulerRot::YXZ, 0.7, -0.3, 0.2)
    }

    #[test]
    fn a_grid_has_the_directions_of_its_camera_to_the_bit() {
        let lens = Lens {
            k: [0.1, -0.02],
            ..Lens::centred(31, 17, 80.0)
        };
        for projection in [Projection::Equirectangular, Projection::Pinhole(lens)] {
            let camera = Camera {
                projection,
                width: 31,
                height: 17,
                world_from_camera: rotation(),
                position: Vec3::ZERO,
            };
            for place in [Vec2::splat(0.5), Vec2::new(0.125, 0.875)] {
                let grid = DirectionGrid::new(&camera, place);
                for (x, y) in (0..17).flat_map(|y| (0..31).map(move |x| (x, y))) {
                    let pixel = Vec2::new(x as f32, y as f32) + place;
                    assert_eq!(grid.direction(x, y), camera.direction(pixel));
                }
            }
        }
    }

    #[test]
    fn project_inverts_direction_for_both_models() {
        let lens = Lens {
            fl_x: 300.0,
            fl_y: 310.0,
            cx: 161.0,
            cy: 118.0,
            k: [-0.05, 0.01],
            p: [0.001, -0.002],
        };
        for projection in [Projection::Equirectangular, Projection::Pinhole(lens)] {
            let c = Camera {
                projection,
                width: 320,
                height: 240,
                world_from_camera: rotation(),
                position: Vec3::new(1.0, 2.0, 3.0),
            };
            for y in 1..24 {
                for x in 1..32 {
                    let pixel = Vec2::new(x as f32 * 10.0 + 0.3, y as f32 * 10.0 - 0.2);
                    let back = c
                        .project(c.position + c.direction(pixel) * 4.0)
                        .expect("visible");
                    assert!(
                        (back - pixel).length() < 2e-2,
                        "{projection:?} {pixel} {back}"
                    );
                }
            }
        }
    }

    #[test]
    fn panorama_axes_follow_the_contract() {
        let c = Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        assert!(
            (c.direction(Vec2::new(4.0, 2.0)) - Vec3::NEG_Z).length() < 1e-6,
            "centre looks down -z"
        );
        assert!(
            (c.direction(Vec2::new(6.0, 2.0)) - Vec3::X).length() < 1e-6,
            "right of centre is +x"
        );
        assert!(
            (c.direction(Vec2::new(4.0, 0.0)) - Vec3::Y).length() < 1e-6,
            "row 0 is up"
        );
    }

    #[test]
    fn solid_angles_of_a_panorama_sum_to_the_sphere() {
        let c = Camera {
            projection: Projection::Equirectangular,
            width: 64,
            height: 32,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        let sum: f32 = (0..32)
            .map(|y| 64.0 * c.pixel_solid_angle(Vec2::new(0.5, y as f32 + 0.5)))
            .sum();
        assert!((sum / (4.0 * PI) - 1.0).abs() < 2e-3);
    }
}
