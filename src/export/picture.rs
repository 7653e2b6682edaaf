//! 8-bit PNG in memory, and the sRGB transfer function.

use crate::error::{Error, Result};

/// IEC 61966-2-1 encoding of a linear value to 8 bits; clips to [0, 1], NaN becomes 0.
#[must_use]
pub fn srgb8_from_linear(linear: f32) -> u8 {
    let x = if linear > 0.0 { linear.min(1.0) } else { 0.0 };
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}

/// Inverse of the sRGB encoding on [0, 1].
#[must_use]
pub fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// PNG bytes of 8-bit RGB pixels, row-major.
pub fn encode_rgb8(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>> {
    encode(width, height, rgb, png::ColorType::Rgb)
}

/// PNG bytes of 8-bit grey pixels, row-major.
pub fn encode_grey8(width: usize, height: usize, grey: &[u8]) -> Result<Vec<u8>> {
    encode(width, height, grey, png::ColorType::Grayscale)
}

fn encode(width: usize, height: usize, pixels: &[u8], color: png::ColorType) -> Result<Vec<u8>> {
    let side = |n: usize| {
        u32::try_from(n).ok().filter(|&n| n > 0).ok_or_else(|| Error::Failed(format!("a PNG cannot have a side of {n} pixels")))
    };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(width)?, side(height)?);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    // textures are large and mostly smooth: the fast setting is within a few per cent of the best one at a tenth of the time
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

    #[test]
    fn srgb_round_trips_every_byte_and_survives_nonsense() {
        for byte in 0..=255u8 {
            assert_eq!(srgb8_from_linear(linear_from_srgb(f32::from(byte) / 255.0)), byte);
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
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("header");
        let mut back = vec![0; reader.output_buffer_size().expect("size")];
        reader.next_frame(&mut back).expect("pixels");
        assert_eq!(back, pixels);
        assert!(encode_grey8(0, 1, &[]).is_err());
    }
}
