//! What the report shows: photographs, re-renderings, error maps and textures as 8-bit pictures.

use super::jpeg::Picture;
use crate::core::formats::srgb8_from_linear;
use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::metrics::{masked_mse, masked_ssim, psnr};
use crate::core::parallel::prelude::*;
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::error::Result;
use crate::programs::evaluate::{GroundTruth, comparable};
use crate::render::RenderedView;
use crate::scene::{Scene, Split, View};
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use std::ops::{Add, Mul};

/// Largest width of a photograph and its re-rendering in the report.
const VIEW_WIDTH: usize = 1024;
/// Width at which a view is rendered for the report alone.
const RENDER_WIDTH: usize = 768;
/// Largest width of the smaller pictures of a view.
const DETAIL_WIDTH: usize = 640;
/// Largest side of a texture in the report.
const MAP_SIDE: usize = 1024;
/// Error at which the error map saturates: mean absolute difference of the tone-mapped channels.
pub(super) const ERROR_RANGE: f32 = 0.2;
/// Standard errors the confidence map spans, on a logarithmic scale.
pub(super) const CONFIDENCE_RANGE: (f32, f32) = (1e-3, 1.0);
/// At and above this a confidence is "unobserved" (docs/outputs.md).
const UNOBSERVED: f32 = 1e3;

/// A picture with its caption.
#[derive(Clone, Debug)]
pub struct Captioned {
    /// What it shows.
    pub caption: String,
    /// The pixels.
    pub picture: Picture,
}

/// Everything the report shows of one view.
#[derive(Clone, Debug)]
pub struct ViewPictures {
    /// The view's file stem.
    pub stem: String,
    /// Training or held out.
    pub split: Split,
    /// PSNR of the re-rendering, dB.
    pub psnr: f64,
    /// SSIM of the re-rendering.
    pub ssim: f64,
    /// Photograph and re-rendering come first.
    pub pictures: Vec<Captioned>,
}

/// Turns views into pictures: holds the ray structure with which textures are shown from the
/// cameras.
pub struct Photographer<'a> {
    scene: &'a Scene,
    solution: &'a Solution,
    tracer: EmbreeTracer,
    gain: f32,
    irradiance_gain: f32,
}

impl<'a> Photographer<'a> {
    /// Prepares for the views of `scene`; the exposure of all pictures is chosen from its first
    /// photograph.
    ///
    /// # Errors
    /// If the ray structure cannot be built or the first photograph cannot be read.
    pub fn new(scene: &'a Scene, solution: &'a Solution) -> Result<Self> {
        let gain = match scene.views.first() {
            Some(view) => display_gain(&scene.load_radiance(view)?),
            None => 1.0,
        };
        // the texels of lamps and sills would leave the rooms dark
        let irradiance_gain = gain_at(&solution.irradiance, 0.7);
        Ok(Self {
            scene,
            solution,
            tracer: EmbreeTracer::new(&solution.mesh)?,
            gain,
            irradiance_gain,
        })
    }

    /// The exposure of all radiance pictures, in stops.
    #[must_use]
    pub fn exposure(&self) -> f32 {
        self.gain.log2()
    }

    /// The pictures of one view from its rendering (at any size of the view's aspect).
    ///
    /// # Errors
    /// If the photograph or its labels cannot be read.
    pub fn view(
        &self,
        view: &View,
        rendered: &RenderedView,
        truth: Option<&GroundTruth>,
    ) -> Result<ViewPictures> {
        let (photograph, valid) = crate::programs::evaluate::photograph(self.scene, view)?;
        let (w, h) = (rendered.radiance.width, rendered.radiance.height);
        let (photograph, valid) =
            crate::programs::evaluate::protocol::box_average(&photograph, &valid, w, h);
        let (a, b, counted) = comparable(&photograph, &valid, &rendered.radiance, 0.0);
        let mse = masked_mse(&a, &b, &counted).unwrap_or(1.0);
        let error = plane_of(&a, |i| {
            if counted.data[i] {
                (a.data[i] - b.data[i]).abs().element_sum() / 3.0
            } else {
                0.0
            }
        });
        let mut pictures = vec![
            captioned(
                "photograph",
                exposed(&shrunk(&photograph, VIEW_WIDTH), self.gain),
            ),
            captioned(
                "re-rendering",
                exposed(&shrunk(&rendered.radiance, VIEW_WIDTH), self.gain),
            ),
            captioned("error of the re-rendering", error_map(&error)),
            captioned("albedo", colour(&shrunk(&rendered.albedo, DETAIL_WIDTH))),
            captioned(
                "roughness",
                grey(&shrunk(&rendered.roughness, DETAIL_WIDTH)),
            ),
            captioned(
                "irradiance",
                self.irradiance(&view.camera, w.min(DETAIL_WIDTH)),
            ),
        ];
        if let Some(truth) = truth.filter(|t| t.albedo.data.len() == w * h) {
            pictures.extend(beside_truth(rendered, truth));
        }
        Ok(ViewPictures {
            stem: view.stem.clone(),
            split: view.split,
            psnr: psnr(mse),
            ssim: masked_ssim(&a, &b, &counted).unwrap_or(1.0),
            pictures,
        })
    }

    /// The first photograph of each camera that carries something along, with that in magenta.
    ///
    /// # Errors
    /// Unreadable photographs.
    pub fn camera_masks(&self) -> Result<Vec<Captioned>> {
        let mut pictures = Vec::new();
        for mask in &self.solution.camera_masks {
            let of_mask = |v: &&View| {
                let panorama = v.camera.projection == Projection::Equirectangular;
                mask.covers(panorama, v.camera.width, v.camera.height)
            };
            let Some(view) = self.scene.views.iter().find(of_mask) else {
                continue;
            };
            let mut image = self.scene.load_radiance(view)?;
            let marked = image.data.iter_mut().zip(&mask.visible.data);
            let marked = marked.filter(|(_, visible)| !**visible);
            marked.for_each(|(pixel, _)| *pixel = Vec3::new(1.0, 0.0, 1.0) / self.gain);
            let share = 100.0 * mask.masked_share();
            pictures.push(Captioned {
                caption: format!("{}: what the camera carries along, {share:.1} %", view.stem),
                picture: exposed(&shrunk(&image, VIEW_WIDTH), self.gain),
            });
        }
        Ok(pictures)
    }

    /// The textures as they lie on the atlas.
    #[must_use]
    pub fn atlas(&self) -> Vec<Captioned> {
        let s = self.solution;
        let sized = |name: &str, w: usize, h: usize| format!("{name}, {w} × {h}");
        let map = |name: &str, w: usize, h: usize, picture| Captioned {
            caption: sized(name, w, h),
            picture,
        };
        let light = |name: &str, plane: &RgbPlane, gain: f32| Captioned {
            caption: format!(
                "{}, at {:+.1} EV",
                sized(name, plane.width, plane.height),
                gain.log2()
            ),
            picture: exposed(&shrunk(plane, MAP_SIDE), gain),
        };
        let (low, high) = CONFIDENCE_RANGE;
        let error = |v: f32| {
            if v >= UNOBSERVED {
                return [96, 96, 104];
            }
            inferno((v.max(low) / low).ln() / (high / low).ln())
        };
        let mut maps = vec![
            map(
                "albedo",
                s.albedo.width,
                s.albedo.height,
                colour(&shrunk(&s.albedo, MAP_SIDE)),
            ),
            map(
                "roughness",
                s.roughness.width,
                s.roughness.height,
                grey(&shrunk(&s.roughness, MAP_SIDE)),
            ),
            light("irradiance", &s.irradiance, self.irradiance_gain),
            light("radiance", &s.radiance, self.gain),
            light("emission", &s.emission, display_gain(&s.emission)),
            map(
                "standard error of albedo",
                s.confidence.width,
                s.confidence.height,
                coloured(&picked(&s.confidence, MAP_SIDE), |c| error(c.x)),
            ),
            map(
                "standard error of roughness",
                s.confidence.width,
                s.confidence.height,
                coloured(&picked(&s.confidence, MAP_SIDE), |c| error(c.y)),
            ),
            map(
                "classes",
                s.labels.width,
                s.labels.height,
                coloured(&picked(&s.labels, MAP_SIDE), |l| identity(*l)),
            ),
            map(
                "rooms",
                s.rooms.width,
                s.rooms.height,
                coloured(&picked(&s.rooms, MAP_SIDE), |l| identity(*l)),
            ),
            light(
                "environment (where no geometry is)",
                &s.environment,
                display_gain(&s.environment),
            ),
        ];
        for (title, share) in [
            ("share of transmitted light", &s.transmission),
            ("share of metal", &s.metallic),
        ] {
            if let Some(share) = share {
                let shown = grey(&shrunk(share, MAP_SIDE));
                maps.insert(2, map(title, share.width, share.height, shown));
            }
        }
        maps
    }

    /// The irradiance texture seen from a camera.
    fn irradiance(&self, camera: &Camera, width: usize) -> Picture {
        let height = (camera.height * width / camera.width.max(1)).max(1);
        let camera = camera.resized(width, height);
        let rays: Vec<Ray> = (0..width * height)
            .map(|i| {
                let pixel = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
                Ray::new(camera.position, camera.direction(pixel), f32::INFINITY)
            })
            .collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        let irradiance = &self.solution.irradiance;
        let size = Vec2::new(irradiance.width as f32, irradiance.height as f32);
        let seen = |hit: &Hit| {
            if !hit.is_hit() {
                return Vec3::ZERO;
            }
            irradiance.bilinear(
                self.solution.mesh.uv(hit.triangle as usize, hit.u, hit.v) * size,
                Wrap::Clamp,
            )
        };
        exposed(
            &Plane {
                width,
                height,
                data: hits.iter().map(seen).collect(),
            },
            self.irradiance_gain,
        )
    }
}

fn captioned(caption: &str, picture: Picture) -> Captioned {
    Captioned {
        caption: caption.into(),
        picture,
    }
}

/// A plane as large as another, of what its pixels are by their number.
fn plane_of<T>(like: &Plane<T>, value: impl Fn(usize) -> f32) -> Plane<f32> {
    Plane {
        width: like.width,
        height: like.height,
        data: (0..like.data.len()).map(value).collect(),
    }
}

/// The true materials and the errors of those rendered, where the rendering shows a surface.
fn beside_truth(rendered: &RenderedView, truth: &GroundTruth) -> [Captioned; 4] {
    let seen = |i: usize, error: f32| {
        if rendered.labels.data[i] == 0 {
            0.0
        } else {
            error
        }
    };
    let albedo = plane_of(&rendered.albedo, |i| {
        let difference = rendered.albedo.data[i] - truth.albedo.data[i];
        seen(i, difference.abs().element_sum() / 3.0)
    });
    let roughness = plane_of(&rendered.roughness, |i| {
        seen(
            i,
            (rendered.roughness.data[i] - truth.roughness.data[i]).abs(),
        )
    });
    [
        captioned("error of albedo", error_map(&shrunk(&albedo, DETAIL_WIDTH))),
        captioned("true albedo", colour(&shrunk(&truth.albedo, DETAIL_WIDTH))),
        captioned(
            "true roughness",
            grey(&shrunk(&truth.roughness, DETAIL_WIDTH)),
        ),
        captioned(
            "error of roughness",
            error_map(&shrunk(&roughness, DETAIL_WIDTH)),
        ),
    ]
}

/// Up to `count` views of a split, evenly spread over it.
#[must_use]
pub fn spread(scene: &Scene, split: Split, count: usize) -> Vec<&View> {
    let all: Vec<&View> = scene.views.iter().filter(|v| v.split == split).collect();
    let count = count.min(all.len());
    (0..count).map(|i| all[i * all.len() / count]).collect()
}

/// The camera of a view at the size at which reports show it.
#[must_use]
pub fn report_camera(view: &View, solution: &Solution) -> Camera {
    let (w, h) = (view.camera.width, view.camera.height);
    let width = w.min(RENDER_WIDTH).min(solution.albedo.width);
    if width == w {
        view.camera
    } else {
        view.camera.resized(width, (h * width / w).max(1))
    }
}

/// The exposure at which the brightest twentieth of what is not black clips.
#[must_use]
pub fn display_gain(image: &RgbPlane) -> f32 {
    gain_at(image, 0.95)
}

/// The exposure that brings a quantile of what is not black to white.
fn gain_at(image: &RgbPlane, quantile: f64) -> f32 {
    let mut peaks: Vec<f32> = image
        .data
        .iter()
        .map(|v| v.max_element())
        .filter(|v| v.is_finite() && *v > 0.0)
        .collect();
    if peaks.is_empty() {
        return 1.0;
    }
    let at = ((peaks.len() - 1) as f64 * quantile) as usize;
    let (_, value, _) = peaks.select_nth_unstable_by(at, f32::total_cmp);
    1.0 / *value
}

/// Halved until neither side exceeds `side`.
#[must_use]
pub fn shrunk<T>(plane: &Plane<T>, side: usize) -> Plane<T>
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T>,
{
    let mut out = plane.clone();
    while out.width.max(out.height) > side {
        out = out.half();
    }
    out
}

/// Every n-th texel, for values that have no mean (ids) or whose mean would mislead (1e4 =
/// unobserved).
fn picked<T: Clone>(plane: &Plane<T>, side: usize) -> Plane<T> {
    let step = plane.width.max(plane.height).div_ceil(side).max(1);
    let (w, h) = ((plane.width / step).max(1), (plane.height / step).max(1));
    Plane {
        width: w,
        height: h,
        data: (0..w * h)
            .map(|i| plane[(i % w * step, i / w * step)].clone())
            .collect(),
    }
}

fn coloured<T: Sync>(plane: &Plane<T>, f: impl Fn(&T) -> [u8; 3] + Sync + Send) -> Picture {
    Picture {
        width: plane.width,
        height: plane.height,
        rgb: plane
            .data
            .par_iter()
            .map(f)
            .collect::<Vec<_>>()
            .into_flattened(),
    }
}

/// Radiance times a gain, in sRGB.
#[must_use]
pub fn exposed(plane: &RgbPlane, gain: f32) -> Picture {
    coloured(plane, |v| (*v * gain).to_array().map(srgb8_from_linear))
}

fn error_map(plane: &Plane<f32>) -> Picture {
    coloured(plane, |e| inferno(e / ERROR_RANGE))
}

/// Reflectance in sRGB.
#[must_use]
pub fn colour(plane: &RgbPlane) -> Picture {
    coloured(plane, |v| v.to_array().map(srgb8_from_linear))
}

/// Roughness as grey, 0 black and 1 white, without a transfer curve: the grey one sees is the
/// number.
#[must_use]
pub fn grey(plane: &Plane<f32>) -> Picture {
    coloured(plane, |r| [(r.clamp(0.0, 1.0) * 255.0 + 0.5) as u8; 3])
}

/// Stops of a dark-to-light colour scale whose lightness grows evenly ("inferno").
const INFERNO: [[f32; 3]; 9] = [
    [0.0, 0.0, 4.0],
    [32.0, 12.0, 74.0],
    [87.0, 16.0, 110.0],
    [137.0, 34.0, 106.0],
    [188.0, 55.0, 84.0],
    [227.0, 89.0, 51.0],
    [249.0, 140.0, 10.0],
    [249.0, 201.0, 50.0],
    [252.0, 255.0, 164.0],
];

/// Colour of a value in [0, 1]; values outside take the ends.
pub(super) fn inferno(t: f32) -> [u8; 3] {
    let at = if t > 0.0 { t.min(1.0) } else { 0.0 } * (INFERNO.len() - 1) as f32;
    let i = (at as usize).min(INFERNO.len() - 2);
    let f = at - i as f32;
    std::array::from_fn(|c| (INFERNO[i][c] * (1.0 - f) + INFERNO[i + 1][c] * f + 0.5) as u8)
}

/// A colour of its own for every id; 0 is dark grey. Hues step by the golden ratio, so that
/// neighbours differ.
fn identity(id: u16) -> [u8; 3] {
    if id == 0 {
        return [40, 40, 44];
    }
    let hue = (f32::from(id) * 0.618_034).fract() * 6.0;
    let value = [0.95, 0.75, 0.6][usize::from(id / 7 % 3)];
    let channel = |offset: f32| {
        let k = (offset + hue) % 6.0;
        value * (1.0 - 0.6 * k.min(4.0 - k).clamp(0.0, 1.0))
    };
    [5.0, 3.0, 1.0].map(|o| (channel(o) * 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_scale_starts_dark_ends_light_and_survives_nonsense() {
        assert_eq!(inferno(0.0), [0, 0, 4]);
        assert_eq!(inferno(1.0), [252, 255, 164]);
        assert_eq!(inferno(f32::NAN), inferno(0.0));
        let light = |t: f32| inferno(t).iter().map(|c| u32::from(*c)).sum::<u32>();
        assert!((0..8).all(|i| light(i as f32 / 8.0) < light((i + 1) as f32 / 8.0)));
    }

    #[test]
    fn gain_brings_the_brightest_twentieth_to_white() {
        let image = Plane {
            width: 100,
            height: 1,
            data: (1..=100).map(|i| Vec3::splat(i as f32)).collect(),
        };
        assert!((display_gain(&image) - 1.0 / 95.0).abs() < 1e-6);
        assert!(
            (display_gain(&Plane::filled(3, 3, Vec3::ZERO)) - 1.0).abs() < 1e-9,
            "a black scene"
        );
    }

    #[test]
    fn neighbouring_ids_look_different() {
        for id in 1..200u16 {
            let (a, b) = (identity(id), identity(id + 1));
            assert!(
                a.iter()
                    .zip(b)
                    .map(|(x, y)| x.abs_diff(y) as u32)
                    .sum::<u32>()
                    > 30,
                "{id}"
            );
        }
    }
}
