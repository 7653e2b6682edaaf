//! 8-bit pictures in memory (PNG, WebP; JPEG to read), and the sRGB encoding.

use super::image_format::is_webp;
use super::{MAX_PIXELS, image_io};
use crate::error::{Error, Result};
use std::io::{Cursor, Write};

/// A display-referred picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture8 {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue and opacity, row-major from the top.
    pub rgba: Vec<[u8; 4]>,
}

/// The picture in the bytes of a PNG, JPEG or WebP file; without transparency it is opaque.
///
/// # Errors
/// The bytes are damaged or of another format; what is said has no name of a file.
pub fn decode_rgba8(bytes: &[u8]) -> std::result::Result<Picture8, String> {
    match bytes {
        b if b.starts_with(b"\x89PNG") => decode_png(b),
        [0xff, 0xd8, 0xff, ..] => decode_jpeg(bytes),
        b if is_webp(b) => decode_webp(b),
        _ => Err("no picture that is read: expected PNG, JPEG or WebP; export it as one".into()),
    }
}

fn damaged(e: &dyn std::fmt::Display) -> String {
    format!("damaged or cut short: {e}; export it again")
}

/// Refuses sizes that nothing can be allocated for.
fn fitting(width: u32, height: u32) -> std::result::Result<usize, String> {
    let pixels = (width as usize).checked_mul(height as usize);
    let fitting = pixels.filter(|n| (1..=MAX_PIXELS).contains(n));
    fitting.ok_or_else(|| {
        format!("{width} × {height} pixels; expected at most {MAX_PIXELS} in all: scale it down")
    })
}

fn decode_png(bytes: &[u8]) -> std::result::Result<Picture8, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    let t = png::Transformations::EXPAND | png::Transformations::STRIP_16;
    decoder.set_transformations(t);
    let header = decoder.read_header_info().map_err(|e| damaged(&e))?;
    fitting(header.width, header.height)?;
    let mut reader = decoder.read_info().map_err(|e| damaged(&e))?;
    let size = reader.output_buffer_size().ok_or("too large to be read")?;
    let mut data = vec![0; size];
    reader.next_frame(&mut data).map_err(|e| damaged(&e))?;
    let (color, _) = reader.output_color_type();
    let info = reader.info();
    let pixel = |p: &[u8]| match *p {
        [g] => [g, g, g, 255],
        [g, a] => [g, g, g, a],
        [r, g, b] => [r, g, b, 255],
        [r, g, b, a, ..] => [r, g, b, a],
        [] => [0; 4],
    };
    Ok(Picture8 {
        width: info.width as usize,
        height: info.height as usize,
        rgba: data.chunks_exact(color.samples()).map(pixel).collect(),
    })
}

/// JPEG is read by OpenImageIO, which reads files.
fn decode_jpeg(bytes: &[u8]) -> std::result::Result<Picture8, String> {
    let mut file = tempfile::NamedTempFile::new().map_err(|e| e.to_string())?;
    file.write_all(bytes).map_err(|e| e.to_string())?;
    let plane = image_io::read_jpeg(file.path()).map_err(|e| damaged(&e))?;
    let byte = |x: f32| (x * 255.0 + 0.5) as u8;
    let pixel = |p: &glam::Vec3| [byte(p.x), byte(p.y), byte(p.z), 255];
    Ok(Picture8 {
        width: plane.width,
        height: plane.height,
        rgba: plane.data.iter().map(pixel).collect(),
    })
}

fn decode_webp(bytes: &[u8]) -> std::result::Result<Picture8, String> {
    let mut decoder = image_webp::WebPDecoder::new(Cursor::new(bytes)).map_err(|e| damaged(&e))?;
    let (width, height) = decoder.dimensions();
    fitting(width, height)?;
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    let mut data = vec![0; decoder.output_buffer_size().ok_or("too large to be read")?];
    decoder.read_image(&mut data).map_err(|e| damaged(&e))?;
    let pixel = |p: &[u8]| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(255)];
    Ok(Picture8 {
        width: width as usize,
        height: height as usize,
        rgba: data.chunks_exact(channels).map(pixel).collect(),
    })
}

/// IEC 61966-2-1 encoding of a linear value to 8 bits; clips to [0, 1], NaN becomes 0.
#[must_use]
pub fn srgb8_from_linear(linear: f32) -> u8 {
    let x = if linear > 0.0 { linear.min(1.0) } else { 0.0 };
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0 + 0.5) as u8
}

/// PNG bytes of 8-bit RGB pixels, row-major.
///
/// # Errors
/// If the bytes do not match the size.
pub fn encode_rgb8(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>> {
    encode(
        width,
        height,
        rgb,
        png::ColorType::Rgb,
        png::BitDepth::Eight,
    )
}

/// PNG bytes of 8-bit grey pixels, row-major.
///
/// # Errors
/// If the bytes do not match the size.
pub fn encode_grey8(width: usize, height: usize, grey: &[u8]) -> Result<Vec<u8>> {
    let colour = png::ColorType::Grayscale;
    encode(width, height, grey, colour, png::BitDepth::Eight)
}

/// PNG bytes of 16-bit grey pixels, row-major.
///
/// # Errors
/// If the numbers do not match the size.
pub fn encode_grey16(width: usize, height: usize, grey: &[u16]) -> Result<Vec<u8>> {
    let bytes: Vec<u8> = grey.iter().flat_map(|v| v.to_be_bytes()).collect();
    let colour = png::ColorType::Grayscale;
    encode(width, height, &bytes, colour, png::BitDepth::Sixteen)
}

/// Lossless WebP bytes of 8-bit RGB pixels, row-major.
///
/// # Errors
/// A side of 0 pixels, or beyond the format's 16,384.
pub fn encode_webp8(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let failed = |e: &dyn std::fmt::Display| {
        Error::Failed(format!(
            "WebP encoding of {width} × {height} pixels failed: {e}"
        ))
    };
    let side = |n: usize| u32::try_from(n).map_err(|e| failed(&e));
    image_webp::WebPEncoder::new(&mut bytes)
        .encode(
            rgb,
            side(width)?,
            side(height)?,
            image_webp::ColorType::Rgb8,
        )
        .map_err(|e| failed(&e))?;
    Ok(bytes)
}

fn encode(
    width: usize,
    height: usize,
    pixels: &[u8],
    color: png::ColorType,
    depth: png::BitDepth,
) -> Result<Vec<u8>> {
    let side = |n: usize| {
        u32::try_from(n)
            .ok()
            .filter(|&n| n > 0)
            .ok_or_else(|| Error::Failed(format!("a PNG cannot have a side of {n} pixels")))
    };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(width)?, side(height)?);
    encoder.set_color(color);
    encoder.set_depth(depth);
    // textures are large and mostly smooth: the fast setting is within a few per cent of the best
    // one at a tenth of the time
    encoder.set_compression(png::Compression::Fast);
    let failed = |e: png::EncodingError| Error::Failed(format!("PNG encoding failed: {e}"));
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::math::linear_from_srgb;

    #[test]
    fn srgb_round_trips_every_byte_and_survives_nonsense() {
        for byte in 0..=255u8 {
            assert_eq!(
                srgb8_from_linear(linear_from_srgb(f32::from(byte) / 255.0)),
                byte
            );
        }
        assert_eq!(srgb8_from_linear(f32::NAN), 0);
        assert_eq!(srgb8_from_linear(-1.0), 0);
        assert_eq!(srgb8_from_linear(f32::INFINITY), 255);
        assert_eq!(srgb8_from_linear(0.214_041_14), 128);
    }

    #[test]
    fn png_decodes_to_the_same_pixels() {
        let pixels: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 29 % 256) as u8).collect();
        let bytes = encode_rgb8(7, 5, &pixels).expect("encodes");
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .expect("header");
        let mut back = vec![0; reader.output_buffer_size().expect("size")];
        reader.next_frame(&mut back).expect("pixels");
        assert_eq!(back, pixels);
        assert!(encode_grey8(0, 1, &[]).is_err());
    }

    #[test]
    fn webp_decodes_to_the_same_pixels() {
        let pixels: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 29 % 256) as u8).collect();
        let bytes = encode_webp8(7, 5, &pixels).expect("encodes");
        let mut decoder =
            image_webp::WebPDecoder::new(std::io::Cursor::new(bytes)).expect("header");
        let mut back = vec![0; decoder.output_buffer_size().expect("size")];
        decoder.read_image(&mut back).expect("pixels");
        assert_eq!((decoder.dimensions(), back), ((7, 5), pixels));
        assert!(encode_webp8(0, 1, &[]).is_err() && encode_webp8(20_000, 1, &[0; 60_000]).is_err());
    }
}
