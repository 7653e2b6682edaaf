//! PNG: class and room ids in and out, pictures for the report, display-referred photographs in.

use super::encoding::Encoding;
use super::image_format::{ImageFormat, ImageInfo, sniff};
use super::image_io::{GENERATION, Marked};
use super::{atomic_write, checked_size, open_regular, pixel_buffer};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::colour::ColourSpace;
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
/// indices of a palette; the greys of a palette that has nothing else, as programs write that make
/// files smaller.
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
    let mut data: Vec<u16> = match depth {
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
    if let Some(palette) = &reader.info().palette {
        let greys = greys_of_palette(palette, &data);
        if let Some(greys) = greys {
            data.iter_mut().for_each(|id| *id = greys[usize::from(*id)]);
        }
    }
    Plane::from_data(width, height, data)
        .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
}

/// What the entries of a palette stand for if they are all grey and those in use differ: the
/// palette of a greyscale image, in whatever order. `None` for palettes of colours, whose indices
/// are the ids (Pascal VOC and the like), and for those that tell nothing apart.
fn greys_of_palette(palette: &[u8], used: &[u16]) -> Option<Vec<u16>> {
    let entries = palette.chunks_exact(3);
    let greys: Vec<u16> = entries
        .map(|p| (p[0] == p[1] && p[1] == p[2]).then_some(u16::from(p[0])))
        .collect::<Option<_>>()?;
    let mut index_of = [None; 256];
    for index in used {
        let grey = *greys.get(usize::from(*index))?;
        let first = index_of[usize::from(grey)].get_or_insert(*index);
        if first != index {
            return None;
        }
    }
    Some(greys)
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
/// Any number of channels: a pixel is kept if its colour is not black (that of its entry in a
/// palette) and it is not fully transparent.
///
/// # Errors
/// If the file cannot be read or is damaged.
pub fn read_mask(path: impl AsRef<Path>) -> Result<Plane<bool>> {
    let path = path.as_ref();
    expect_png(path, "a mask")?;
    let mut reader = open(path, Transformations::EXPAND)?;
    let (color, depth) = reader.output_color_type();
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let bytes = pixels(path, &mut reader)?;
    let sample = if depth == BitDepth::Sixteen { 2 } else { 1 };
    let keeps = |p: &[u8]| {
        let (colour, a) = p.split_at(p.len() - if has_alpha(color) { sample } else { 0 });
        colour.iter().any(|v| *v != 0) && (a.is_empty() || a.iter().any(|v| *v != 0))
    };
    let data = bytes.chunks_exact(color.samples() * sample).map(keeps);
    Plane::from_data(width, height, data.collect())
        .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
}

fn has_alpha(color: ColorType) -> bool {
    matches!(color, ColorType::GrayscaleAlpha | ColorType::Rgba)
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

/// What a PNG says of its values.
pub(super) struct PngSays {
    /// How they encode light.
    pub encoding: Encoding,
    /// Some pixels may be transparent.
    pub has_alpha: bool,
}

/// What the header of a PNG says, or the scene in its place.
///
/// # Errors
/// As [`info`]; or its values are encoded in a way that is not read.
pub(super) fn says(path: &Path, space: Option<ColourSpace>) -> Result<PngSays> {
    let reader = open(path, Transformations::EXPAND)?;
    Ok(PngSays {
        encoding: encoding(path, reader.info(), space)?,
        has_alpha: has_alpha(reader.output_color_type().0),
    })
}

fn encoding(path: &Path, info: &png::Info<'_>, space: Option<ColourSpace>) -> Result<Encoding> {
    match space {
        Some(space) => Ok(Encoding::declared(space)),
        None => Encoding::of_png(info).map_err(|e| Error::input(path, e)),
    }
}

/// A picture as light.
pub(super) struct PngPicture {
    /// Linear Rec. 709.
    pub pixels: RgbPlane,
    /// How much of each pixel is there, where the file says so; colours are not weighted with it.
    pub alpha: Option<Plane<f32>>,
}

/// Reads a display-referred PNG.
///
/// # Errors
/// As [`says`], or the pixels are damaged.
pub(super) fn read_picture(path: &Path, space: Option<ColourSpace>) -> Result<PngPicture> {
    let mut reader = open(path, Transformations::EXPAND)?;
    let encoding = encoding(path, reader.info(), space)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let (color, depth) = reader.output_color_type();
    let bytes = pixels(path, &mut reader)?;
    let samples = color.samples();
    let wide = depth == BitDepth::Sixteen;
    let steps = if wide { 65535 } else { 255 };
    let curves = [0, 1, 2].map(|c| -> Vec<f32> {
        let light = |v: usize| encoding.curves[c].light(v as f32 / steps as f32);
        (0..=steps).map(light).collect()
    });
    let stored = |p: &[u8], i: usize| match wide {
        true => usize::from(u16::from_be_bytes([p[2 * i], p[2 * i + 1]])),
        false => usize::from(p[i]),
    };
    let pixel = |p: &[u8]| {
        let value = |c: usize| curves[c][stored(p, if samples < 3 { 0 } else { c })];
        Vec3::new(value(0), value(1), value(2))
    };
    let rows = || bytes.par_chunks_exact(samples * if wide { 2 } else { 1 });
    let plane = |data| {
        Plane::from_data(width, height, data)
            .ok_or_else(|| Error::input(path, "fewer pixels than its header states"))
    };
    let mut pixels = plane(rows().map(pixel).collect())?;
    encoding.convert(&mut pixels);
    let alpha = has_alpha(color).then(|| {
        let covered = |p: &[u8]| stored(p, samples - 1) as f32 / steps as f32;
        Plane {
            width,
            height,
            data: rows().map(covered).collect(),
        }
    });
    Ok(PngPicture { pixels, alpha })
}
