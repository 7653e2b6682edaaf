//! Pixels of a view on demand: radiance, class ids and masks, checked as they are read.

use super::clipping::clipped_channels;
use super::input_error::as_input;
use super::{LdrImages, Mirror, Scene, View};
use crate::core::formats::{self, Photograph};
use crate::core::geometry::Projection;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::core::stats::median;
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use std::path::Path;

/// What was mended while an image was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PixelStats {
    /// NaN or infinite pixels; only under a mask or with `clamp_nan`.
    pub not_finite: usize,
    /// Pixels with a negative channel, which was set to 0 (ringing of a resampling filter, as a
    /// rule).
    pub negative: usize,
    /// Infinite pixels among those that are not finite: lamps beyond half precision, as a rule. They
    /// become as bright as the image's middle pixel, which any light is at least; other pixels that
    /// are not finite become black.
    pub infinite: usize,
    /// Pixels that reach exactly 1 in an image that nowhere goes beyond; 0 if they are no plateau.
    pub at_one: usize,
    /// The sRGB curve was undone, since the file's numbers are the levels of an 8-bit picture.
    pub eight_bit: bool,
}

/// Pixels at exactly 1 that make a plateau. Derived: a lamp of 4 × 4 pixels; one highlight may end
/// there by chance.
const PLATEAU: usize = 16;

/// Radiance that is taken for a slip: photographs in any unit lie within (measured: W/m² of the sun
/// 2e7, starlight in candelas 1e-8), and squares of it within single precision.
const DARKEST: f32 = 1e-16;
/// See [`DARKEST`].
const BRIGHTEST: f32 = 1e16;

impl Scene {
    /// The view's radiance, exposure applied. NaN and infinite pixels are an error unless masked
    /// (see [`Scene::load_mask`]).
    ///
    /// # Errors
    /// If the image cannot be read, does not fit the view, or holds such pixels.
    pub fn load_radiance(&self, view: &View) -> Result<RgbPlane> {
        self.load_radiance_with_stats(view).map(|(image, _)| image)
    }

    /// [`Scene::load_radiance`] with a count of what was mended.
    ///
    /// # Errors
    /// As [`Scene::load_radiance`].
    pub fn load_radiance_with_stats(&self, view: &View) -> Result<(RgbPlane, PixelStats)> {
        let path = &view.image_path;
        let photograph = self.read_image(view)?;
        let covered = photograph.covered();
        let Photograph {
            pixels: mut image,
            eight_bit,
            ..
        } = photograph;
        let gain = view.exposure_ev.exp2();
        let mut stats = PixelStats {
            at_one: at_one(&image),
            eight_bit,
            ..PixelStats::default()
        };
        let (mut bad, mut brightest) = (Vec::new(), 0f32);
        for (i, p) in image.data.iter_mut().enumerate() {
            let scaled = *p * gain;
            if !scaled.is_finite() {
                if p.is_finite() {
                    let (x, y) = (i % image.width, i / image.width);
                    return Err(Error::input(
                        path,
                        format!(
                            "pixel (column {x}, row {y}) overflows at exposure_ev {}; lower exposure_ev",
                            view.exposure_ev
                        ),
                    ));
                }
                bad.push(i);
                stats.infinite += usize::from(is_beyond(*p));
                *p = if is_beyond(*p) { scaled } else { Vec3::ZERO };
                continue;
            }
            brightest = brightest.max(scaled.max_element());
            stats.negative += usize::from(scaled.min_element() < 0.0);
            *p = scaled.max(Vec3::ZERO);
        }
        if !bad.is_empty() && !self.options.clamp_nan {
            let mask = joined(self.read_mask(view)?, covered);
            let seen: Vec<usize> = bad
                .iter()
                .copied()
                .filter(|&i| mask.as_ref().is_none_or(|m| m.data[i]))
                .collect();
            if let Some(first) = seen.first() {
                let (n, x, y) = (seen.len(), first % image.width, first / image.width);
                return Err(Error::input(
                    path,
                    format!(
                        "{n} of {} pixels are NaN or infinite (first at column {x}, row {y}); mend the image, mask them, or pass --clamp-nan to ignore them",
                        image.data.len()
                    ),
                ));
            }
        }
        stats.not_finite = bad.len();
        sane(path, &image, &stats, brightest)?;
        if stats.infinite > 0 {
            let finite = image.data.iter().filter(|p| p.is_finite());
            let middle = median(finite.map(|p| luminance(*p)).collect()).unwrap_or(0.0);
            for i in bad {
                image.data[i] = image.data[i].map(|v| if v.is_finite() { v } else { middle });
            }
        }
        Ok((image, stats))
    }

    /// Channels of the view's `image`, read with `stats`, that are at a ceiling: a bit for each, per
    /// pixel; `None` where it has none. Infinite channels are.
    ///
    /// # Errors
    /// The image cannot be read a second time.
    pub fn ceiling_bits(
        &self,
        view: &View,
        (image, stats): (&RgbPlane, &PixelStats),
    ) -> Result<Option<Plane<u8>>> {
        let clipped = clipped_channels(image, view.encoded_ceiling(stats));
        if stats.infinite == 0 {
            return Ok(clipped);
        }
        let infinite = self.read_image(view)?.pixels.map(|p| match is_beyond(*p) {
            true => (0..3).map(|c| u8::from(p[c].is_infinite()) << c).sum(),
            false => 0,
        });
        Ok(Some(match clipped {
            Some(mut bits) => {
                (bits.data.iter_mut().zip(&infinite.data)).for_each(|(b, i)| *b |= i);
                bits
            }
            None => infinite,
        }))
    }

    /// The view's class ids at the resolution of the file; `None` without labels. 0 is unlabelled.
    ///
    /// # Errors
    /// If the file cannot be read, does not fit the view, or names an undeclared class.
    pub fn load_labels(&self, view: &View) -> Result<Option<Plane<u16>>> {
        let Some(path) = &view.label_path else {
            return Ok(None);
        };
        let labels = formats::read_labels(path).map_err(|e| as_input(e, path, "label_path"))?;
        same_aspect_as_image(labels.width, labels.height, view, path, "label")?;
        if self.classes_declared {
            let known = self.known_ids();
            if let Some(i) = labels.data.iter().position(|&id| !known[id as usize]) {
                let (id, x, y) = (labels.data[i], i % labels.width, i / labels.width);
                let n = labels
                    .data
                    .iter()
                    .filter(|&&id| !known[id as usize])
                    .count();
                return Err(Error::input(
                    path,
                    format!(
                        "class id {id} (column {x}, row {y}; {n} pixels with undeclared ids) is not in classes; declare {{\"id\": {id}, ...}} in \
                         transforms.json, paint the pixels 0, or remove classes altogether"
                    ),
                ));
            }
        }
        Ok(Some(turned_back(labels, self.mirror == Mirror::All)))
    }

    /// Which pixels of the view may be used (`true`), at the image's size; `None` if all may.
    ///
    /// Joins the mask file, the camera's own mask, the image's alpha (pixels it does not wholly
    /// cover) and, with `clamp_nan`, the pixels that are not a number.
    ///
    /// # Errors
    /// If the file cannot be read or does not fit the view.
    pub fn load_mask(&self, view: &View) -> Result<Option<Plane<bool>>> {
        let mask = self.without_rig(view, self.read_mask(view)?);
        if !self.options.clamp_nan && !view.account.has_alpha {
            return Ok(mask);
        }
        let photograph = self.read_image(view)?;
        let mask = joined(mask, photograph.covered());
        if !self.options.clamp_nan {
            return Ok(mask);
        }
        let usable = (photograph.pixels).map(|p| p.is_finite() || is_beyond(*p));
        let usable = usable.data.contains(&false).then_some(usable);
        Ok(joined(mask, usable))
    }

    /// A mask without the pixels that show what the camera carries along.
    fn without_rig(&self, view: &View, mask: Option<Plane<bool>>) -> Option<Plane<bool>> {
        let c = &view.camera;
        let panorama = c.projection == Projection::Equirectangular;
        let rig = self
            .camera_masks
            .iter()
            .find(|m| m.covers(panorama, c.width, c.height));
        joined(mask, rig.map(|rig| rig.visible.clone()))
    }

    /// Whether each possible id is declared; 0 always is.
    fn known_ids(&self) -> Vec<bool> {
        let mut known = vec![false; 1 << 16];
        known[0] = true;
        self.classes
            .iter()
            .for_each(|c| known[c.id as usize] = true);
        known
    }

    /// The image as stored, turned the way the scene says.
    pub(super) fn read_image(&self, view: &View) -> Result<Photograph> {
        let path = &view.image_path;
        let linear = formats::image_info(path).map(|i| i.format.is_linear());
        let image = match linear {
            Ok(false) if self.options.ldr != LdrImages::Off => {
                formats::read_display_photograph(path, view.colour_space)
            }
            _ => formats::read_photograph(path, view.colour_space),
        };
        let photograph = image.map_err(|e| as_input(e, path, "file_path"))?;
        let image = &photograph.pixels;
        if (image.width, image.height) != (view.camera.width, view.camera.height) {
            return Err(Error::input(
                path,
                format!(
                    "the image is {}x{}, expected {}x{}; it changed since the scene was loaded, or w and h are wrong",
                    image.width, image.height, view.camera.width, view.camera.height
                ),
            ));
        }
        if self.mirror == Mirror::UpsideDown {
            return Ok(Photograph {
                pixels: half_turned(photograph.pixels),
                alpha: photograph.alpha.map(half_turned),
                ..photograph
            });
        }
        let mirrored = self.mirror != Mirror::None;
        Ok(Photograph {
            pixels: turned_back(photograph.pixels, mirrored),
            alpha: photograph.alpha.map(|a| turned_back(a, mirrored)),
            ..photograph
        })
    }

    /// The mask file, brought to the image's size.
    fn read_mask(&self, view: &View) -> Result<Option<Plane<bool>>> {
        let Some(path) = &view.mask_path else {
            return Ok(None);
        };
        let mask = formats::read_mask(path).map_err(|e| as_input(e, path, "mask_path"))?;
        let mask = turned_back(mask, self.mirror == Mirror::All);
        same_aspect_as_image(mask.width, mask.height, view, path, "mask")?;
        let (w, h) = (view.camera.width, view.camera.height);
        let scale = Vec2::new(mask.width as f32 / w as f32, mask.height as f32 / h as f32);
        let data = (0..w * h)
            .map(|i| *mask.nearest((Vec2::new((i % w) as f32, (i / w) as f32) + 0.5) * scale))
            .collect();
        Ok(Some(Plane {
            width: w,
            height: h,
            data,
        }))
    }
}

/// Whether a pixel is infinitely bright: a lower bound, as a clipped one is.
pub(super) fn is_beyond(p: Vec3) -> bool {
    !p.is_nan() && !p.is_finite() && p.min_element() > f32::NEG_INFINITY
}

/// The plane upside down.
fn half_turned<T>(mut plane: Plane<T>) -> Plane<T> {
    plane.data.reverse();
    plane
}

/// The plane, mirrored left to right if the file is.
fn turned_back<T>(mut plane: Plane<T>, mirrored: bool) -> Plane<T> {
    if mirrored {
        plane
            .data
            .chunks_exact_mut(plane.width.max(1))
            .for_each(<[T]>::reverse);
    }
    plane
}

/// The pixels that both masks keep; a mask that is none keeps all.
fn joined(mask: Option<Plane<bool>>, other: Option<Plane<bool>>) -> Option<Plane<bool>> {
    match (mask, other) {
        (Some(mut mask), Some(other)) => {
            let both = mask.data.iter_mut().zip(&other.data);
            both.for_each(|(m, o)| *m &= o);
            Some(mask)
        }
        (mask, other) => mask.or(other),
    }
}

/// The refusal of a scene whose training images are black throughout.
#[must_use]
pub fn all_black(scene: &Scene) -> Error {
    of_every_view(
        scene,
        "every training image is black: no light to reconstruct from; look at exposure_ev, or render the images again",
    )
}

/// The refusal of a scene whose training images are masked throughout.
#[must_use]
pub fn all_masked(scene: &Scene) -> Error {
    of_every_view(
        scene,
        "every pixel of every training image is masked: nothing to reconstruct from; masks are 0 where pixels are to be ignored, turn them round or leave them out",
    )
}

/// What is wrong with every training image, named by the first one.
fn of_every_view(scene: &Scene, message: &str) -> Error {
    let first = scene.train_views().next();
    Error::input(first.map_or(&scene.folder, |v| &v.image_path), message)
}

/// [`PixelStats::at_one`] of an image as stored.
fn at_one(image: &RgbPlane) -> usize {
    if image.data.iter().any(|p| p.max_element() > 1.0) {
        return 0;
    }
    let count = image.data.iter().filter(|p| p.max_element() == 1.0).count();
    if count < PLATEAU { 0 } else { count }
}

/// Refuses images of which nothing can be learnt: nothing finite, nothing but negative values, or
/// values that no photograph has.
fn sane(path: &Path, image: &RgbPlane, stats: &PixelStats, brightest: f32) -> Result<()> {
    let count = image.data.len();
    let refuse = |m: String| Err(Error::input(path, m));
    if stats.not_finite == count {
        return refuse(format!(
            "all {count} pixels are NaN or infinite; render or convert it again"
        ));
    }
    if brightest <= 0.0 && stats.negative > 0 {
        return refuse(format!(
            "no pixel is above 0, and {} are negative; render or convert it again",
            stats.negative
        ));
    }
    if brightest > 0.0 && !(DARKEST..=BRIGHTEST).contains(&brightest) {
        return refuse(format!(
            "its brightest value is {brightest:e}; expected radiance between {DARKEST:e} and {BRIGHTEST:e}: scale the images or set exposure_ev"
        ));
    }
    Ok(())
}

fn same_aspect_as_image(
    width: usize,
    height: usize,
    view: &View,
    path: &Path,
    what: &str,
) -> Result<()> {
    let (w, h) = (view.camera.width as f64, view.camera.height as f64);
    let (sw, sh) = (width as f64, height as f64);
    if width > 0
        && height > 0
        && ((sw * h / w - sh).abs() <= 0.5 + 1e-9 || (sh * w / h - sw).abs() <= 0.5 + 1e-9)
    {
        return Ok(());
    }
    Err(Error::input(
        path,
        format!(
            "the {what} image is {width}x{height}, its photograph {w}x{h}; the aspect must be the same"
        ),
    ))
}
