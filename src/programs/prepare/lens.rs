//! Lenses the solver does not model itself: COLMAP's camera models up to 4.1 and OpenCV's fisheye,
//! as functions from directions to pixels, and photographs resampled from them.
//!
//! A view of at most 120° becomes a perspective image without distortion, a wider one a panorama
//! of which a mask keeps what the lens saw. Formulas: COLMAP's documentation of its models (Kannala
//! & Brandt 2006 for fisheyes, Devernay & Faugeras 2001 for FOV, Khomutenko 2016 for EUCM), checked
//! against pycolmap 4.2. Camera axes here are OpenCV's: x right, y down, z forward.

use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::prelude::*;
use glam::{DVec2, DVec3, Vec2, Vec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Half the angle of view up to which a perspective image serves (derived: at 60° a pixel at the
/// rim covers a quarter of the angle of one in the middle).
const WIDEST_HALF_ANGLE: f64 = PI / 3.0;
/// Columns of a resampled panorama at most.
const MOST_COLUMNS: f64 = 8192.0;
/// Steps in which the profile of a lens is searched for its last angle.
const PROFILE_STEPS: usize = 900;

/// How a photograph maps directions to pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum Optics {
    /// Full panorama of docs/scene-format.md.
    Panorama,
    /// Perspective with OpenCV's k1 k2 p1 p2: what the solver models itself.
    Perspective(Perspective),
    /// Any other lens: the writer resamples the photograph.
    Distorted(Lens),
}

/// Intrinsics in pixels of the photograph's own size, pixel centres at +0.5.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Perspective {
    /// Focal lengths along x and y.
    pub focal: [f64; 2],
    /// Principal point.
    pub centre: [f64; 2],
    /// k1, k2.
    pub radial: [f64; 2],
    /// p1, p2.
    pub tangential: [f64; 2],
}

/// How a lens bends light, without focal length and principal point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// k1 k2 p1 p2 k3 k4 k5 k6: `FULL_OPENCV`.
    Rational([f64; 8]),
    /// ω of the FOV model.
    FieldOfView(f64),
    /// k of the division model.
    Division(f64),
    /// Equidistant with θ's polynomial k1 to k4: `OPENCV_FISHEYE` and its shorter forms.
    Fisheye([f64; 4]),
    /// k1 k2 p1 p2 k3 k4 sx1 sy1.
    ThinPrismFisheye([f64; 8]),
    /// k0 to k5, p0 p1, s0 to s3.
    RadTanThinPrismFisheye([f64; 12]),
    /// α, β of the extended unified camera model.
    Unified([f64; 2]),
}

/// A lens with its intrinsics, pixel centres at +0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// How it bends light.
    pub distortion: Distortion,
    /// Focal lengths along x and y, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub centre: [f64; 2],
}

impl Distortion {
    /// The point on the normalised image plane for a direction; `None` where the model has none.
    fn plane(&self, d: DVec3) -> Option<DVec2> {
        let flat = d.truncate();
        let r = flat.length();
        let angle = r.atan2(d.z);
        // direction on the plane times `radius`
        let along = |radius: f64| if r > 0.0 { flat * (radius / r) } else { flat };
        let p = match *self {
            Self::Rational(_) | Self::FieldOfView(_) | Self::Division(_) if d.z <= 0.0 => {
                return None;
            }
            Self::Rational(c) => rational(flat / d.z, &c),
            Self::FieldOfView(w) if w.abs() < 1e-8 => flat / d.z,
            Self::FieldOfView(w) => along((2.0 * (r / d.z) * (0.5 * w).tan()).atan() / w),
            Self::Division(k) => {
                let u = r / d.z;
                let root = 1.0 - 4.0 * k * u * u;
                if root < 0.0 {
                    return None;
                }
                // the form without cancellation of (1 − √root) / (2 k u)
                along(2.0 * u / (1.0 + root.sqrt()))
            }
            Self::Fisheye(k) => along(angle * odd_polynomial(angle, &k)),
            Self::ThinPrismFisheye([k1, k2, p1, p2, k3, k4, sx, sy]) => {
                let u = along(angle);
                let r2 = u.length_squared();
                let radial = odd_polynomial(r2.sqrt(), &[k1, k2, k3, k4]);
                let prism = DVec2::new(sx, sy) * r2;
                u * radial + tangential(u, p1, p2) + prism
            }
            Self::RadTanThinPrismFisheye(c) => {
                let u = along(angle * odd_polynomial(angle, &c[..6]));
                let (p, r2) = (DVec2::new(c[6], c[7]), u.length_squared());
                let prism = DVec2::new(c[8] * r2 + c[9] * r2 * r2, c[10] * r2 + c[11] * r2 * r2);
                u + u * (2.0 * u.dot(p)) + p * r2 + prism
            }
            Self::Unified([alpha, beta]) => {
                let depth = (beta * r * r + d.z * d.z).sqrt();
                let denominator = alpha * depth + (1.0 - alpha) * d.z;
                if denominator <= 1e-9 * d.length() {
                    return None;
                }
                flat / denominator
            }
        };
        p.is_finite().then_some(p)
    }
}

/// 1 + c₁x² + c₂x⁴ + …
fn odd_polynomial(x: f64, c: &[f64]) -> f64 {
    1.0 + x * x * c.iter().rev().fold(0.0, |sum, c| c + x * x * sum)
}

fn tangential(u: DVec2, p1: f64, p2: f64) -> DVec2 {
    let r2 = u.length_squared();
    DVec2::new(
        2.0 * p1 * u.x * u.y + p2 * (r2 + 2.0 * u.x * u.x),
        2.0 * p2 * u.x * u.y + p1 * (r2 + 2.0 * u.y * u.y),
    )
}

fn rational(u: DVec2, &[k1, k2, p1, p2, k3, k4, k5, k6]: &[f64; 8]) -> DVec2 {
    let r = u.length();
    u * (odd_polynomial(r, &[k1, k2, k3]) / odd_polynomial(r, &[k4, k5, k6]))
        + tangential(u, p1, p2)
}

impl Lens {
    /// Continuous pixel coordinates of a direction (x right, y down, z forward).
    #[must_use]
    pub fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let p = self.distortion.plane(direction)?;
        Some(p * DVec2::from(self.focal) + DVec2::from(self.centre))
    }

    /// The angle from the axis up to which the model is one to one: beyond, polynomials fold back
    /// and would show the scene twice.
    fn last_angle(&self) -> f64 {
        let radius = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let at = |a: f64| {
                let d = DVec3::new(sin * a.cos(), sin * a.sin(), cos);
                self.distortion.plane(d).map(|p| p.length())
            };
            // along both axes and diagonals: the weakest counts
            (0..4)
                .map(|i| at(f64::from(i) * PI / 4.0 + PI / 8.0))
                .try_fold(f64::INFINITY, |m, r| r.map(|r| m.min(r)))
        };
        let mut last = 0.0;
        for i in 1..PROFILE_STEPS {
            let angle = PI * i as f64 / PROFILE_STEPS as f64;
            match radius(angle) {
                Some(r) if r > last => last = r,
                _ => return PI * (i - 1) as f64 / PROFILE_STEPS as f64,
            }
        }
        PI
    }

    /// The largest angle from the axis that the image of this size shows.
    fn half_angle(&self, size: [usize; 2]) -> f64 {
        let limit = self.last_angle();
        let inside = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            (0..32).any(|i| {
                let a = TAU * f64::from(i) / 32.0;
                let d = DVec3::new(sin * a.cos(), sin * a.sin(), cos);
                self.pixel(d).is_some_and(|p| within(p, size))
            })
        };
        (0..PROFILE_STEPS)
            .map(|i| limit * (PROFILE_STEPS - i) as f64 / PROFILE_STEPS as f64)
            .find(|&angle| inside(angle))
            .unwrap_or(0.0)
    }

    /// What photographs of this lens and size become.
    #[must_use]
    pub fn target(&self, size: [usize; 2]) -> Target {
        let last_angle = self.last_angle();
        if self.half_angle(size).max(1e-3) > WIDEST_HALF_ANGLE {
            let columns = (TAU * self.focal[0].abs().max(1.0)).min(MOST_COLUMNS);
            let height = ((0.5 * columns).ceil() as usize).max(2);
            return Target {
                optics: Optics::Panorama,
                size: [2 * height, height],
                last_angle,
            };
        }
        Target {
            optics: Optics::Perspective(Perspective {
                focal: self.focal,
                centre: self.centre,
                ..Perspective::default()
            }),
            size,
            last_angle,
        }
    }
}

fn within(p: DVec2, [w, h]: [usize; 2]) -> bool {
    p.x >= 0.0 && p.y >= 0.0 && p.x < w as f64 && p.y < h as f64
}

/// The image a photograph is resampled to.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Its projection: perspective without distortion, or panorama.
    pub optics: Optics,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Directions further from the axis are not shown.
    last_angle: f64,
}

impl Target {
    /// Direction of a pixel's centre: x right, y down, z forward.
    fn direction(&self, x: usize, y: usize) -> DVec3 {
        let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
        match &self.optics {
            Optics::Perspective(p) => DVec3::new(
                (x - p.centre[0]) / p.focal[0],
                (y - p.centre[1]) / p.focal[1],
                1.0,
            ),
            _ => {
                let lambda = TAU * (x / self.size[0] as f64 - 0.5);
                let latitude = PI * (y / self.size[1] as f64) - FRAC_PI_2;
                DVec3::new(
                    lambda.sin() * latitude.cos(),
                    latitude.sin(),
                    lambda.cos() * latitude.cos(),
                )
            }
        }
    }

    /// Where every pixel looks in the photograph; `None` where the lens saw nothing.
    fn map<T: Send>(
        &self,
        lens: &Lens,
        size: [usize; 2],
        f: impl Fn(Option<Vec2>) -> T + Sync,
    ) -> Plane<T> {
        let [width, height] = self.size;
        let pixel = |i: usize| {
            let d = self.direction(i % width, i / width);
            let angle = d.truncate().length().atan2(d.z);
            let seen = (angle < self.last_angle)
                .then(|| lens.pixel(d))
                .flatten()
                .filter(|&p| within(p, size));
            f(seen.map(|p| p.as_vec2()))
        };
        Plane {
            width,
            height,
            data: (0..width * height).into_par_iter().map(pixel).collect(),
        }
    }

    /// The photograph, bilinear, 0 where nothing was seen.
    #[must_use]
    pub fn resample(&self, lens: &Lens, photograph: &RgbPlane) -> RgbPlane {
        let size = [photograph.width, photograph.height];
        self.map(lens, size, |p| {
            p.map_or(Vec3::ZERO, |p| photograph.bilinear(p, Wrap::Clamp))
        })
    }

    /// 255 where the lens saw something (and `mask` keeps it), 0 elsewhere.
    #[must_use]
    pub fn mask(&self, lens: &Lens, size: [usize; 2], mask: Option<&Plane<bool>>) -> Plane<u8> {
        self.map(lens, size, |p| {
            let kept = |p: Vec2| {
                mask.is_none_or(|m| {
                    let scale = Vec2::new(
                        m.width as f32 / size[0] as f32,
                        m.height as f32 / size[1] as f32,
                    );
                    *m.nearest(p * scale)
                })
            };
            if p.is_some_and(kept) { 255 } else { 0 }
        })
    }

    /// Ids of the nearest pixel, 0 where nothing was seen.
    #[must_use]
    pub fn labels(&self, lens: &Lens, size: [usize; 2], labels: &Plane<u16>) -> Plane<u16> {
        let scale = Vec2::new(
            labels.width as f32 / size[0] as f32,
            labels.height as f32 / size[1] as f32,
        );
        self.map(lens, size, |p| p.map_or(0, |p| *labels.nearest(p * scale)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(distortion: Distortion) -> Lens {
        Lens {
            distortion,
            focal: [500.0, 510.0],
            centre: [320.0, 240.0],
        }
    }

    /// Pixels of (0.3, −0.2, 1) and (−0.7, 0.1, 0.8), written by pycolmap 4.2.1
    /// (`Camera.img_from_cam`; scripts/check_import compares the running program with it).
    #[test]
    fn every_model_agrees_with_pycolmap() {
        let cases = [
            (
                Distortion::RadTanThinPrismFisheye([
                    0.01, 0.02, -0.01, 0.003, 0.001, -0.002, 0.004, -0.003, 0.002, -0.001, 0.0015,
                    0.0005,
                ]),
                [465.02749452, 141.5332055],
                [-37.914712, 292.03015508],
            ),
            (
                Distortion::FieldOfView(0.8),
                [473.89202071, 135.35342591],
                [-77.11511739, 297.86534568],
            ),
            (
                Distortion::Division(-0.15),
                [467.18380074, 139.91501549],
                [-75.58393346, 297.6422303],
            ),
            (
                Distortion::Unified([0.6, 1.1]),
                [464.02759774, 142.06123354],
                [-39.15016689, 292.33331003],
            ),
            (
                Distortion::ThinPrismFisheye([
                    0.01, 0.02, 0.004, -0.003, -0.01, 0.003, 0.002, -0.001,
                ]),
                [463.64586838, 142.46331019],
                [-43.78788598, 293.77255214],
            ),
        ];
        for (distortion, first, second) in cases {
            let l = lens(distortion);
            for (d, expected) in [
                (DVec3::new(0.3, -0.2, 1.0), first),
                (DVec3::new(-0.7, 0.1, 0.8), second),
            ] {
                let p = l.pixel(d).expect("in front");
                assert!(
                    (p - DVec2::from(expected)).length() < 1e-6,
                    "{distortion:?}: {p}"
                );
            }
        }
    }

    #[test]
    fn models_without_distortion_are_pinholes_or_equidistant() {
        let d = DVec3::new(0.3, -0.2, 1.0);
        let pinhole = DVec2::new(0.3 * 500.0 + 320.0, -0.2 * 510.0 + 240.0);
        for flat in [
            Distortion::Rational([0.0; 8]),
            Distortion::FieldOfView(0.0),
            Distortion::Division(0.0),
            Distortion::Unified([0.0, 1.0]),
        ] {
            assert!((lens(flat).pixel(d).expect("seen") - pinhole).length() < 1e-9);
        }
        let fisheye = lens(Distortion::Fisheye([0.0; 4]));
        let side = fisheye
            .pixel(DVec3::new(1.0, 0.0, 0.0))
            .expect("90° off the axis");
        assert!((side.x - 320.0 - 500.0 * FRAC_PI_2).abs() < 1e-9);
    }

    /// A photograph painted with its own directions keeps them through resampling.
    #[test]
    fn resampling_keeps_directions() {
        for (distortion, panorama) in [
            (
                Distortion::Rational([-0.2, 0.05, 0.001, -0.001, 0.0, 0.0, 0.0, 0.0]),
                false,
            ),
            (Distortion::Fisheye([0.02, -0.01, 0.0, 0.0]), true),
        ] {
            let size = [640, 480];
            let l = Lens {
                distortion,
                focal: if panorama { [200.0; 2] } else { [500.0; 2] },
                centre: [320.0, 240.0],
            };
            let target = l.target(size);
            assert_eq!(target.optics == Optics::Panorama, panorama);
            // pixel coordinates as colours: then the value read is the place looked at
            let data = (0..640 * 480)
                .map(|i| Vec3::new((i % 640) as f32 + 0.5, (i / 640) as f32 + 0.5, 1.0))
                .collect();
            let photograph = Plane {
                width: 640,
                height: 480,
                data,
            };
            let image = target.resample(&l, &photograph);
            let mask = target.mask(&l, size, None);
            let (mut seen, mut worst) = (0, 0.0f64);
            for y in 0..image.height {
                for x in 0..image.width {
                    let p = l.pixel(target.direction(x, y));
                    let inner =
                        p.filter(|p| (1.0..639.0).contains(&p.x) && (1.0..479.0).contains(&p.y));
                    if let Some(p) = inner.filter(|_| mask[(x, y)] > 0) {
                        seen += 1;
                        let got = image[(x, y)].truncate().as_dvec2();
                        worst = worst.max((got - p).length());
                    }
                }
            }
            assert!(seen > 50_000 && worst < 1e-2, "{seen} pixels, {worst}");
        }
    }

    #[test]
    fn a_polynomial_that_folds_back_shows_nothing_twice() {
        // θ(1 − θ²/3) grows up to θ = 1 rad only
        let l = lens(Distortion::Fisheye([-1.0 / 3.0, 0.0, 0.0, 0.0]));
        assert!((l.last_angle() - 1.0).abs() < 0.01, "{}", l.last_angle());
    }
}
