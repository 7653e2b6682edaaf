//! Pictures of a report as baseline JPEG without chroma subsampling, so that a self-contained page
//! of pictures stays a few megabytes and coloured edges stay sharp.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// Quality of the pictures of pages: artefacts stay invisible at the size at which they are shown.
pub const QUALITY: u8 = 86;

/// An 8-bit sRGB picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 · width · height` bytes, row-major.
    pub rgb: Vec<u8>,
}

/// JPEG bytes of a picture at a quality of 1 to 100 (the Independent JPEG Group's scale).
///
/// # Errors
/// If the picture's bytes do not match its size or a side is 0 or above 65,535.
pub fn encode_jpeg(picture: &Picture, quality: u8) -> crate::Result<Vec<u8>> {
    let failed = |why: String| {
        let (w, h) = (picture.width, picture.height);
        crate::Error::Failed(format!("a picture of {w}x{h} pixels as JPEG: {why}"))
    };
    let side = |n: usize| u16::try_from(n).map_err(|e| failed(e.to_string()));
    let (width, height) = (side(picture.width)?, side(picture.height)?);
    let mut out = Vec::new();
    let mut encoder = Encoder::new(&mut out, quality.clamp(1, 100));
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    encoder
        .encode(&picture.rgb, width, height, ColorType::Rgb)
        .map_err(|e| failed(e.to_string()))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::formats::read_ldr;

    #[test]
    fn an_independent_decoder_reads_back_nearly_the_same_picture() {
        let folder = tempfile::tempdir().expect("temp");
        // sizes that are not multiples of eight; smooth colour with an edge
        let (w, h) = (83, 45);
        let rgb: Vec<u8> = (0..w * h)
            .flat_map(|i| {
                let (x, y) = (i % w, i / w);
                if x + y > 70 {
                    [250, 240, 230]
                } else {
                    [(x * 3) as u8, (y * 5) as u8, ((x + y) * 2) as u8]
                }
            })
            .collect();
        let picture = Picture {
            width: w,
            height: h,
            rgb,
        };
        for (quality, allowed) in [(95, 3.0), (60, 9.0)] {
            let path = folder.path().join("picture.jpg");
            std::fs::write(&path, encode_jpeg(&picture, quality).expect("encodes"))
                .expect("writes");
            let back = read_ldr(&path).expect("decodes");
            assert_eq!((back.width, back.height), (w, h));
            let sum: f64 = back
                .data
                .iter()
                .zip(picture.rgb.chunks(3))
                .map(|(v, bytes)| {
                    (0..3)
                        .map(|c| {
                            (f64::from(crate::core::formats::srgb8_from_linear(v[c]))
                                - f64::from(bytes[c]))
                            .powi(2)
                        })
                        .sum::<f64>()
                })
                .sum();
            let rms = (sum / (3 * w * h) as f64).sqrt();
            assert!(rms < allowed, "quality {quality}: rms {rms}");
        }
    }

    #[test]
    fn smooth_pictures_become_small() {
        let picture = Picture {
            width: 512,
            height: 256,
            rgb: (0..512 * 256).flat_map(|i| [(i / 1024) as u8; 3]).collect(),
        };
        assert!(encode_jpeg(&picture, 85).expect("encodes").len() < 20_000);
    }

    #[test]
    fn a_picture_that_is_none_is_an_error() {
        let picture = |width, height, bytes| Picture {
            width,
            height,
            rgb: vec![0; bytes],
        };
        for wrong in [
            picture(8, 8, 100),
            picture(0, 8, 0),
            picture(70_000, 1, 210_000),
        ] {
            let error = encode_jpeg(&wrong, 85).expect_err("refused");
            assert!(error.to_string().contains("pixels as JPEG"), "{error}");
        }
    }
}
