//! PNG: class and room ids in and out, pictures for the report, display-referred photographs in.

use super::image_format::{ImageFormat, ImageInfo, sniff};
use super::image_io::{self, GENERATION, Marked};
use super::{atomic_write, checked_size, open_regular, pixel_buffer};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::linear_from_srgb;
use crate::core::parallel::prelude::*;
use crate::ffi::oiio::Sample;
use crate::{Error, Result};
use glam::Vec3;
use png::{BitDepth, ColorType, Decoder, Encoder, Limits, Reader, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// What the library may allocate for itself: lines it works on, texts, colour profiles. Derived:
/// two lines of 16-bit RGBA of the widest panorama (2²⁸ pixels) take 0.4 MB; a colour profile has
/// at most a few MB.
const OWN_BYTES: usize = 64 << 20;

/// Opens a PNG and judges its size; nothing is allocated for pixels yet.
fn open(path: &Path, transform: Transformations) -> Result<Reader<BufReader<File>>> {
    let file = open_regular(path)?;
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), Limits { bytes: OWN_BYTES });
    decoder.set_transformations(transform);
    let header = decoder.read_header_info().map_err(|e| damaged(path, &e))?;
    checked_size(path, header.width.into(), header.height.into())?;
    decoder.read_info().map_err(|e| damaged(path, &e))
}

fn damaged(path: &Path, e: &png::DecodingError) -> Error {
    Error::input(
        path,
        format!("damaged or cut short: {e}; copy or export it again"),
    )
}

/// The bytes of the whole image, rows without padding between them.
fn pixels(path: &Path, reader: &mut Reader<BufReader<File>>) -> Result<Vec<u8>> {
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| Error::input(path, "too large to be read"))?;
    let mut bytes = pixel_buffer(path, size)?;
    reader
        .next_frame(&mut bytes)
        .map_err(|e| damaged(path, &e))?;
    Ok(bytes)
}

/// Size, channels and sample type of a PNG.
pub(super) fn info(path: &Path) -> Result<ImageInfo> {
    let reader = open(path, Transformations::IDENTITY)?;
    let info = reader.info();
    let sample = if info.bit_depth == BitDepth::Sixteen {
        Sample::U16
    } else {
        Sample::U8
    };
    Ok(ImageInfo {
        width: info.width as usize,
        height: info.height as usize,
        channels: info.color_type.samples(),
        format: ImageFormat::Png,
        sample,
    })
}

fn expect_png(path: &Path, what: &str) -> Result<()> {
    match sniff(path)? {
        ImageFormat::Png => Ok(()),
        other => Err(Error::input(
            path,
            format!("{what} expected as PNG, found {other:?}"),
        )),
    }
}

/// Reads ids: greyscale of up to 16 bits as stored (in three channels if they are all alike), or the
/// indices of a palette.
///
/// # Errors
/// If the file cannot be read, is no PNG, or has colours.
pub fn read_labels(path: impl AsRef<Path>) -> Result<Plane<u16>> {
    let path = path.as_ref();
    expect_png(path, "ids per pixel")?;
    let mut reader = open(path, Transformations::IDENTITY)?;
    let (color, depth) = (reader.info().color_type, reader.info().bit_depth);
    let samples = match color {
        ColorType::Grayscale | ColorType::Indexed => 1,
        ColorType::Rgb => 3,
        other => return Err(no_ids(path, other)),
    };
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let mut bytes = pixels(path, &mut reader)?;
    if samples > 1 {
        bytes = grey_of_rgb(&bytes, if depth == BitDepth::Sixteen { 2 } else { 1 })
            .ok_or_else(|| no_ids(path, color))?;
    }
    let data = match depth {
        BitDepth::Sixteen => bytes
            .chunks_exact(2)
            .map(|b| u16::from_be_bytes([b[0], b[1]]))
            .collect(),
        BitDepth::Eight => bytes.iter().map(|&b| b.into()).collect(),
        // Several ids per byte, the leftmost in the highest bits, rows padded to bytes.
        packed => {
            let bits = packed as usize;
            let (per_byte, mask) = (8 / bits, (1u16 << bits) - 1);
            let line = width.div_ceil(per_byte);
            let id = |i: usize| {
                let (x, y) = (i % width, i / width);
                u16::from(bytes[y * line + x / per_byte]) >> (8 - bits * (x % per_byte + 1)) & mask
            };
            (0..width * height).map(id).collect()
        }
    };
    Plane::from_data(width, height, data)
        .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
}

/// One channel of an image of three whose channels are all alike, as editors save greyscale; `None`
/// where they differ. `size` is the bytes of a sample.
fn grey_of_rgb(bytes: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut grey = Vec::with_capacity(bytes.len() / 3);
    for pixel in bytes.chunks_exact(3 * size) {
        let (r, rest) = pixel.split_at(size);
        if rest[..size] != *r || rest[size..] != *r {
            return None;
        }
        grey.extend_from_slice(r);
    }
    Some(grey)
}

fn no_ids(path: &Path, found: ColorType) -> Error {
    Error::input(
        path,
        format!(
            "ids expected in one channel (greyscale of 8 or 16 bits, or a palette), found {found:?}: save it as greyscale"
        ),
    )
}

/// Reads a mask: `true` where a pixel is to be kept.
///
/// Any number of channels: a pixel is kept if one of its colour channels (or its palette index) is
/// not 0 and it is not fully transparent.
///
/// # Errors
/// If the file cannot be read or is damaged.
pub fn read_mask(path: impl AsRef<Path>) -> Result<Plane<bool>> {
    let path = path.as_ref();
    expect_png(path, "a mask")?;
    let mut reader = open(path, Transformations::IDENTITY)?;
    let (color, depth) = (reader.info().color_type, reader.info().bit_depth);
    if matches!(color, ColorType::Grayscale | ColorType::Indexed) {
        return read_labels(path).map(|ids| ids.map(|id| *id != 0));
    }
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let bytes = pixels(path, &mut reader)?;
    let sample = if depth == BitDepth::Sixteen { 2 } else { 1 };
    let alpha = matches!(color, ColorType::GrayscaleAlpha | ColorType::Rgba);
    let keeps = |p: &[u8]| {
        let (colour, a) = p.split_at(p.len() - if alpha { sample } else { 0 });
        colour.iter().any(|v| *v != 0) && (a.is_empty() || a.iter().any(|v| *v != 0))
    };
    let data = bytes.chunks_exact(color.samples() * sample).map(keeps);
    Plane::from_data(width, height, data.collect())
        .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
}

/// Writes ids as a 16-bit greyscale PNG.
///
/// # Errors
/// If the file system refuses.
pub fn write_png16(path: impl AsRef<Path>, plane: &Plane<u16>) -> Result<()> {
    Marked("").png16(path.as_ref(), plane)
}

impl Marked<'_> {
    /// As [`write_png16`].
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn png16(&self, path: &Path, plane: &Plane<u16>) -> Result<()> {
        let bytes: Vec<u8> = plane.data.iter().flat_map(|v| v.to_be_bytes()).collect();
        let pixels = Pixels {
            width: plane.width,
            height: plane.height,
            color: ColorType::Grayscale,
            depth: BitDepth::Sixteen,
            bytes: &bytes,
        };
        write_png(path, &pixels, self.0)
    }
}

/// The mark of the set that a PNG belongs to, if it has one.
///
/// # Errors
/// It cannot be read.
pub(super) fn mark(path: &Path) -> Result<Option<String>> {
    let reader = open(path, Transformations::IDENTITY)?;
    let texts = &reader.info().uncompressed_latin1_text;
    let own = texts.iter().find(|t| t.keyword == GENERATION);
    Ok(own.map(|t| t.text.clone()))
}

/// Writes 8-bit greyscale.
///
/// # Errors
/// If the file system refuses.
pub fn write_png8(path: impl AsRef<Path>, plane: &Plane<u8>) -> Result<()> {
    let pixels = Pixels {
        width: plane.width,
        height: plane.height,
        color: ColorType::Grayscale,
        depth: BitDepth::Eight,
        bytes: &plane.data,
    };
    write_png(path.as_ref(), &pixels, "")
}

/// Writes 8-bit RGB, three bytes per pixel.
///
/// # Errors
/// If the file system refuses, or the bytes do not match the size.
pub fn write_png_rgb8(
    path: impl AsRef<Path>,
    width: usize,
    height: usize,
    rgb: &[u8],
) -> Result<()> {
    let pixels = Pixels {
        width,
        height,
        color: ColorType::Rgb,
        depth: BitDepth::Eight,
        bytes: rgb,
    };
    write_png(path.as_ref(), &pixels, "")
}

/// What a PNG's image data hold: rows from the top, samples in big-endian order.
struct Pixels<'a> {
    width: usize,
    height: usize,
    color: ColorType,
    depth: BitDepth,
    bytes: &'a [u8],
}

fn write_png(path: &Path, pixels: &Pixels<'_>, mark: &str) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| {
        Error::Failed(format!("{}: could not be written: {e}", path.display()))
    };
    let (Ok(w), Ok(h)) = (u32::try_from(pixels.width), u32::try_from(pixels.height)) else {
        return Err(failed(&format!(
            "{} × {} pixels are too many",
            pixels.width, pixels.height
        )));
    };
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, w, h);
    encoder.set_color(pixels.color);
    encoder.set_depth(pixels.depth);
    if !mark.is_empty() {
        encoder
            .add_text_chunk(GENERATION.into(), mark.into())
            .map_err(|e| failed(&e))?;
    }
    let mut writer = encoder.write_header().map_err(|e| failed(&e))?;
    writer
        .write_image_data(pixels.bytes)
        .map_err(|e| failed(&e))?;
    writer.finish().map_err(|e| failed(&e))?;
    atomic_write(path, &file)
}

/// Reads a display-referred PNG or JPEG and undoes the sRGB curve; transparency and colour profiles
/// are ignored.
///
/// # Errors
/// If the file cannot be read, is damaged, or is of another format.
pub fn read_ldr(path: impl AsRef<Path>) -> Result<RgbPlane> {
    let path = path.as_ref();
    match sniff(path)? {
        ImageFormat::Png => read_ldr_png(path),
        ImageFormat::Jpeg => {
            let image = image_io::open(path, ImageFormat::Jpeg)?;
            let channels = if image.size().2 < 3 {
                [0; 3]
            } else {
                [0, 1, 2]
            };
            let mut plane = image_io::read_rgb_channels(path, image, channels)?;
            plane
                .data
                .par_iter_mut()
                .for_each(|p| *p = p.map(linear_from_srgb));
            Ok(plane)
        }
        _ => Err(Error::input(
            path,
            "scene-linear where a display-referred PNG or JPEG is expected; leave out --ldr",
        )),
    }
}

fn read_ldr_png(path: &Path) -> Result<RgbPlane> {
    let mut reader = open(path, Transformations::EXPAND)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let (color, depth) = reader.output_color_type();
    let bytes = pixels(path, &mut reader)?;
    let samples = color.samples();
    let wide = depth == BitDepth::Sixteen;
    let steps = if wide { 65535 } else { 255 };
    let curve: Vec<f32> = (0..=steps)
        .map(|v| linear_from_srgb(v as f32 / steps as f32))
        .collect();
    let pixel = |p: &[u8]| {
        let value = |c: usize| {
            let c = if samples < 3 { 0 } else { c };
            curve[if wide {
                usize::from(u16::from_be_bytes([p[2 * c], p[2 * c + 1]]))
            } else {
                usize::from(p[c])
            }]
        };
        Vec3::new(value(0), value(1), value(2))
    };
    let data = bytes
        .par_chunks_exact(samples * if wide { 2 } else { 1 })
        .map(pixel)
        .collect();
    Plane::from_data(width, height, data)
        .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
}
