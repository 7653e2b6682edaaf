//! Floating-point images: OpenEXR and Radiance HDR in, OpenEXR (ZIP) out.
//!
//! Values are scene-linear and returned as stored. A file's format is told by its first bytes,
//! never by its name, and its size is judged before anything is allocated for it.

use super::exr_header::{self, ExrPart};
use super::image_format::{ImageFormat, sniff};
use super::whole::Aside;
use super::{checked_size, hdr, jpeg_header, open_regular, pixel_buffer};
use crate::core::image::{Plane, RgbPlane};
use crate::core::parallel::prelude::*;
use crate::ffi::oiio::{self, OpenImage, Samples};
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use half::f16;
use half::slice::HalfFloatSliceExt;
use std::ffi::CStr;
use std::path::Path;

/// Largest finite half-precision value.
const HALF_MAX: f32 = 65504.0;

/// Smallest value that half precision holds to its full 11 bits: 2⁻¹⁴ (derived).
const HALF_NORMAL: f32 = 6.103_515_6e-5;

/// Share of the lit values that may lose precision before radiance is written in single precision.
/// Derived: at most one in a hundred keeps sums and quantiles right to a per cent.
const MAY_UNDERFLOW: f64 = 0.01;

/// Channels a file may have before it is called damaged.
const MAX_CHANNELS: i32 = 1024;

/// Opens an image after judging its header; the size is then within limits.
pub(super) fn open(path: &Path, format: ImageFormat) -> Result<OpenImage> {
    open_part(path, format, 0)
}

/// The parts of an OpenEXR file by its header, judged.
pub(super) fn exr_parts(path: &Path) -> Result<Vec<ExrPart>> {
    let file = open_regular(path)?;
    let bytes = file.metadata().map_or(0, |m| m.len());
    exr_header::vetted(file, bytes).map_err(|e| refused(path, &e))
}

/// [`open`] for one part of a multi-part file, counted from 0.
pub(super) fn open_part(path: &Path, format: ImageFormat, part: usize) -> Result<OpenImage> {
    if format == ImageFormat::Exr {
        let parts = exr_parts(path)?;
        for part in &parts {
            checked_size(path, part.size.0, part.size.1)?;
        }
        if let Some(why) = parts.get(part).and_then(ExrPart::sampled_apart) {
            return Err(Error::input(path, why));
        }
    }
    if format == ImageFormat::Jpeg {
        jpeg_header::read(path)?.supported(path)?;
    }
    crate::ffi::oiio::version().map_err(Error::Native)?;
    let image = OpenImage::open(path, format.reader(), part)
        .map_err(|e| Error::input(path, damaged(&e)))?;
    let (w, h, c) = image.size();
    checked_size(path, w.into(), h.into())?;
    let refuse = |what: &str| Err(Error::input(path, what.to_string()));
    if !(1..=MAX_CHANNELS).contains(&c) {
        return Err(Error::input(
            path,
            format!("its header states {c} channels; expected 1 to {MAX_CHANNELS}"),
        ));
    }
    if !image.is_flat() {
        return refuse("a deep or volume image; expected a flat one: save it flattened");
    }
    if !image.is_uncropped() {
        return refuse(
            "its data window differs from its display window; expected every pixel: save it uncropped",
        );
    }
    Ok(image)
}

/// What is wrong with a file whose pixels cannot be read.
pub(super) fn damaged(reason: &str) -> String {
    format!("damaged or cut short: {reason}; copy, render or download it again")
}

/// The refusal of an OpenEXR file by its header: one that is whole needs no other copy.
fn refused(path: &Path, why: &exr_header::Refusal) -> Error {
    let message = match why {
        exr_header::Refusal::Damaged(reason) => damaged(reason),
        exr_header::Refusal::Unsupported(reason) => reason.clone(),
    };
    Error::input(path, message)
}

/// Opens `path` as linear radiance.
fn open_linear(path: &Path) -> Result<OpenImage> {
    match sniff(path)? {
        format if format.is_linear() => open(path, format),
        _ => Err(Error::input(
            path,
            "a display-referred PNG or JPEG where scene-linear OpenEXR or Radiance HDR is expected; --ldr accepts it as an approximation",
        )),
    }
}

/// The three channels that hold red, green and blue in a file of one's own kind: by name, else the
/// first three; one channel serves as all three.
fn rgb_channels(image: &OpenImage) -> [usize; 3] {
    let count = image.size().2 as usize;
    let find =
        |wanted: &str| (0..count).find(|c| image.channel_name(*c).eq_ignore_ascii_case(wanted));
    match (find("R"), find("G"), find("B")) {
        (Some(r), Some(g), Some(b)) => [r, g, b],
        _ if count >= 3 => [0, 1, 2],
        _ => [0; 3],
    }
}

/// Reads an OpenEXR or Radiance HDR image as linear RGB: channels R, G, B by name, else the first
/// three; one channel is grey.
///
/// # Errors
/// If the file cannot be read, is damaged, or is of another format.
pub fn read_rgb(path: impl AsRef<Path>) -> Result<RgbPlane> {
    let path = path.as_ref();
    if sniff(path)? == ImageFormat::Hdr {
        return hdr::read(path).map(|(plane, _)| plane);
    }
    let image = open_linear(path)?;
    let channels = rgb_channels(&image);
    read_rgb_channels(path, image, channels)
}

/// Reads a JPEG as stored, values from 0 to 1.
///
/// # Errors
/// If the file cannot be read, or does not hold all of its picture.
pub(super) fn read_jpeg(path: &Path) -> Result<RgbPlane> {
    let image = open(path, ImageFormat::Jpeg)?;
    oiio::whole_jpeg(path).map_err(|e| Error::input(path, damaged(&e)))?;
    let channels = if image.size().2 < 3 {
        [0; 3]
    } else {
        [0, 1, 2]
    };
    read_rgb_channels(path, image, channels)
}

/// Reads three channels of an open image.
pub(super) fn read_rgb_channels(
    path: &Path,
    mut image: OpenImage,
    [r, g, b]: [usize; 3],
) -> Result<RgbPlane> {
    let (w, h, _) = image.size();
    let (width, height) = (w as usize, h as usize);
    let mut data: Vec<Vec3> = pixel_buffer(path, width * height)?;
    let floats: &mut [f32] = bytemuck::cast_slice_mut(&mut data);
    let bad = |e: String| Error::input(path, damaged(&e));
    if (g, b) == (r + 1, r + 2) {
        image.read(r..r + 3, floats, 0, 3).map_err(bad)?;
    } else if (g, b) == (r, r) {
        image.read(r..r + 1, floats, 0, 3).map_err(bad)?;
        data.par_iter_mut().for_each(|p| *p = Vec3::splat(p.x));
    } else {
        for (offset, c) in [r, g, b].into_iter().enumerate() {
            image.read(c..c + 1, floats, offset, 3).map_err(bad)?;
        }
    }
    Ok(Plane {
        width,
        height,
        data,
    })
}

/// Reads one channel of an open image.
pub(super) fn read_channel(path: &Path, image: &mut OpenImage, c: usize) -> Result<Plane<f32>> {
    let (w, h, _) = image.size();
    let (width, height) = (w as usize, h as usize);
    let mut data = pixel_buffer(path, width * height)?;
    image
        .read(c..c + 1, &mut data, 0, 1)
        .map_err(|e| Error::input(path, damaged(&e)))?;
    Ok(Plane {
        width,
        height,
        data,
    })
}

/// Reads the first channel of an OpenEXR or Radiance HDR image.
///
/// # Errors
/// If the file cannot be read, is damaged, or is of another format.
pub fn read_plane(path: impl AsRef<Path>) -> Result<Plane<f32>> {
    let path = path.as_ref();
    if sniff(path)? == ImageFormat::Hdr {
        return hdr::read(path).map(|(plane, _)| plane.map(|p| p.x));
    }
    read_channel(path, &mut open_linear(path)?, 0)
}

/// Reads the first two channels of an OpenEXR image.
///
/// # Errors
/// If the file cannot be read, is damaged, or has fewer channels.
pub fn read_two_channels(path: impl AsRef<Path>) -> Result<Plane<Vec2>> {
    let path = path.as_ref();
    let mut image = open_linear(path)?;
    let (w, h, c) = image.size();
    if c < 2 {
        return Err(Error::input(path, "one channel where two are expected"));
    }
    let (width, height) = (w as usize, h as usize);
    let mut data: Vec<Vec2> = pixel_buffer(path, width * height)?;
    image
        .read(0..2, bytemuck::cast_slice_mut(&mut data), 0, 2)
        .map_err(|e| Error::input(path, damaged(&e)))?;
    Ok(Plane {
        width,
        height,
        data,
    })
}

const RGB: &[&CStr] = &[c"R", c"G", c"B"];
const GREY: &[&CStr] = &[c"Y"];
const TWO: &[&CStr] = &[c"R", c"G"];

/// Writes linear RGB in half precision. Returns how many values beyond ±65,504 were clamped; values
/// that are not finite are an error and nothing is written.
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_rgb_half(path: impl AsRef<Path>, plane: &RgbPlane) -> Result<usize> {
    Marked("").rgb_half(path.as_ref(), plane)
}

/// Writes linear RGB in single precision; values that are not finite are an error.
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_rgb_float(path: impl AsRef<Path>, plane: &RgbPlane) -> Result<()> {
    Marked("").rgb_float(path.as_ref(), plane)
}

/// Writes one channel in half precision; as [`write_rgb_half`].
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_plane_half(path: impl AsRef<Path>, plane: &Plane<f32>) -> Result<usize> {
    Marked("").plane_half(path.as_ref(), plane)
}

/// Writes one channel in single precision; values that are not finite are an error.
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_plane_float(path: impl AsRef<Path>, plane: &Plane<f32>) -> Result<()> {
    write_float(path.as_ref(), &Layout::of(plane, GREY, ""), &plane.data)
}

/// Writes two channels, called R and G, in half precision; as [`write_rgb_half`].
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_two_channels_half(path: impl AsRef<Path>, plane: &Plane<Vec2>) -> Result<usize> {
    Marked("").two_channels_half(path.as_ref(), plane)
}

/// Writes two channels, called R and G, in single precision; values that are not finite are an
/// error.
///
/// # Errors
/// If the file system refuses, or a value is not finite.
pub fn write_two_channels_float(path: impl AsRef<Path>, plane: &Plane<Vec2>) -> Result<()> {
    let layout = Layout::of(plane, TWO, "");
    write_float(path.as_ref(), &layout, bytemuck::cast_slice(&plane.data))
}

/// Name of the text attribute that tells which files belong together.
pub(super) const GENERATION: &str = "unbake:generation";

/// Writers of files that carry a mark of the set they belong to; no mark if it is empty.
pub struct Marked<'a>(pub &'a str);

impl Marked<'_> {
    /// As [`write_rgb_half`].
    ///
    /// # Errors
    /// A value is not finite, or the file cannot be written.
    pub fn rgb_half(&self, path: &Path, plane: &RgbPlane) -> Result<usize> {
        let layout = Layout::of(plane, RGB, self.0);
        write_half(path, &layout, bytemuck::cast_slice(&plane.data))
    }

    /// As [`write_rgb_float`].
    ///
    /// # Errors
    /// As [`Self::rgb_half`].
    pub fn rgb_float(&self, path: &Path, plane: &RgbPlane) -> Result<()> {
        let layout = Layout::of(plane, RGB, self.0);
        write_float(path, &layout, bytemuck::cast_slice(&plane.data))
    }

    /// Linear RGB in half precision where it can hold the values; in single precision where some
    /// exceed 65,504, or more than a few of those that are not 0 lie below what half holds precisely.
    ///
    /// # Errors
    /// As [`Self::rgb_half`].
    pub fn radiance(&self, path: &Path, plane: &RgbPlane) -> Result<()> {
        let values = || plane.data.iter().flat_map(|v| v.abs().to_array());
        let lit = values().filter(|v| *v > 0.0).count();
        let faint = values().filter(|v| *v > 0.0 && *v < HALF_NORMAL).count();
        if values().any(|v| v > HALF_MAX) || faint as f64 > MAY_UNDERFLOW * lit as f64 {
            self.rgb_float(path, plane)
        } else {
            self.rgb_half(path, plane).map(drop)
        }
    }

    /// As [`write_plane_half`].
    ///
    /// # Errors
    /// As [`Self::rgb_half`].
    pub fn plane_half(&self, path: &Path, plane: &Plane<f32>) -> Result<usize> {
        write_half(path, &Layout::of(plane, GREY, self.0), &plane.data)
    }

    /// As [`write_two_channels_half`].
    ///
    /// # Errors
    /// As [`Self::rgb_half`].
    pub fn two_channels_half(&self, path: &Path, plane: &Plane<Vec2>) -> Result<usize> {
        let layout = Layout::of(plane, TWO, self.0);
        write_half(path, &layout, bytemuck::cast_slice(&plane.data))
    }
}

/// Size, channels and mark of an OpenEXR file to write.
struct Layout<'a> {
    width: usize,
    height: usize,
    names: &'a [&'a CStr],
    mark: &'a str,
}

impl<'a> Layout<'a> {
    fn of<T>(plane: &Plane<T>, names: &'a [&'a CStr], mark: &'a str) -> Self {
        Self {
            width: plane.width,
            height: plane.height,
            names,
            mark,
        }
    }
}

/// Samples per piece of a parallel conversion.
const PIECE: usize = 1 << 16;

fn write_half(path: &Path, layout: &Layout<'_>, values: &[f32]) -> Result<usize> {
    let mut halves = vec![f16::ZERO; values.len()];
    let clamped = halves
        .par_chunks_mut(PIECE)
        .zip(values.par_chunks(PIECE))
        .map(|(out, piece)| {
            let beyond = piece.iter().filter(|v| v.abs() > HALF_MAX).count();
            if beyond == 0 {
                out.convert_from_f32_slice(piece);
            } else {
                let held: Vec<f32> = piece.iter().map(|v| v.clamp(-HALF_MAX, HALF_MAX)).collect();
                out.convert_from_f32_slice(&held);
            }
            beyond
        })
        .sum();
    write(path, layout, values, Samples::Half(&halves))?;
    Ok(clamped)
}

fn write_float(path: &Path, layout: &Layout<'_>, values: &[f32]) -> Result<()> {
    write(path, layout, values, Samples::Float(values))
}

/// Refuses values that are not finite, then writes aside and renames.
fn write(path: &Path, layout: &Layout<'_>, values: &[f32], samples: Samples) -> Result<()> {
    let Layout {
        width,
        height,
        names,
        mark,
    } = *layout;
    let bad: usize = values
        .par_chunks(PIECE)
        .map(|piece| piece.iter().filter(|v| !v.is_finite()).count())
        .sum();
    if let Some(first) = (bad > 0)
        .then(|| values.iter().position(|v| !v.is_finite()))
        .flatten()
    {
        let (pixel, channel) = (
            first / names.len(),
            names[first % names.len()].to_string_lossy(),
        );
        let (column, row) = (pixel % width.max(1), pixel / width.max(1));
        return Err(Error::Failed(format!(
            "{}: not written: {bad} of {} values are not finite (first: {} in channel {channel} at column {column}, row {row})",
            path.display(),
            values.len(),
            values[first]
        )));
    }
    let aside = Aside::new(path)?;
    let size = (width, height);
    oiio::write(aside.path(), size, names, samples, mark).map_err(|e| {
        Error::Failed(format!(
            "{}: could not be written (is the disk full?): {e}",
            path.display()
        ))
    })?;
    aside.finish()
}
