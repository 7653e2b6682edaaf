//! Basis Universal's encoder (crate `basis-universal`, which builds the library's sources): 8-bit
//! pictures as UASTC blocks, which graphics cards' own formats are made of when a file is loaded.
//! Called by `core::formats::ktx2`.

use basis_universal::{
    BasisTextureFormat, Compressor, CompressorParams, UASTC_QUALITY_DEFAULT, encoder_init,
};

/// Bytes of a block of 4 × 4 pixels.
pub const BLOCK_BYTES: usize = 16;
/// Where a .basis file says where its list of slices is.
const SLICES_AT: usize = 65;
/// Where an entry of this list says where the slice's bytes are, and how many.
const BYTES_AT: usize = 13;

/// The UASTC blocks of a picture (RGB, 8 bits a channel, rows from above), row by row; at the right
/// and lower edge they repeat the last pixels. `None` where the sizes do not fit.
#[must_use]
pub fn uastc_blocks(width: usize, height: usize, rgb: &[u8]) -> Option<Vec<u8>> {
    let file = basis_file(width, height, rgb)?;
    let blocks = width.div_ceil(4) * height.div_ceil(4);
    slice(&file)
        .filter(|s| s.len() == blocks * BLOCK_BYTES)
        .map(<[u8]>::to_vec)
}

/// A .basis file of a picture, which the library writes its blocks into.
fn basis_file(width: usize, height: usize, rgb: &[u8]) -> Option<Vec<u8>> {
    // the file's numbers have 16 bits
    let side = |n: usize| u16::try_from(n).ok().filter(|n| *n > 0).map(u32::from);
    let (w, h) = (side(width)?, side(height)?);
    if rgb.len() != 3 * width * height {
        return None;
    }
    encoder_init();
    let mut params = CompressorParams::new();
    params.set_basis_format(BasisTextureFormat::UASTC4x4);
    params.set_uastc_quality_level(UASTC_QUALITY_DEFAULT);
    params.set_rdo_uastc(None);
    params.set_generate_mipmaps(false);
    params.set_print_status_to_stdout(false);
    params.source_image_mut(0).init(rgb, w, h, 3);
    let mut compressor = Compressor::new(1);
    // SAFETY: one image of the size that its pixels have (tested above), options of the list that
    // the library offers.
    let done = unsafe { compressor.init(&params) && compressor.process().is_ok() };
    done.then(|| compressor.basis_file().to_vec())
}

/// The bytes of the first slice of a .basis file.
fn slice(file: &[u8]) -> Option<&[u8]> {
    let number = |at: usize| {
        let word = file.get(at..at.checked_add(4)?)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(word)).ok()
    };
    let entry = number(SLICES_AT)?;
    let first = number(entry + BYTES_AT)?;
    file.get(first..first.checked_add(number(entry + BYTES_AT + 4)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use basis_universal::{TranscodeParameters, Transcoder, TranscoderTextureFormat};

    /// The pixels (RGB) of a file, as the library decodes them.
    fn decoded(file: &[u8]) -> Vec<u8> {
        let mut transcoder = Transcoder::new();
        transcoder.prepare_transcoding(file).expect("readable");
        let parameters = TranscodeParameters {
            image_index: 0,
            level_index: 0,
            decode_flags: None,
            output_row_pitch_in_blocks_or_pixels: None,
            output_rows_in_pixels: None,
        };
        let format = TranscoderTextureFormat::RGBA32;
        let pixels = transcoder.transcode_image_level(file, format, parameters);
        let pixels = pixels.expect("decodes");
        pixels
            .as_chunks::<4>()
            .0
            .iter()
            .flat_map(|p| p[..3].to_vec())
            .collect()
    }

    #[test]
    fn pictures_come_back_nearly_as_they_were() {
        for (width, height) in [(16, 16), (4, 4), (1, 1), (6, 9), (64, 4)] {
            let pixel = |i: usize| {
                let (x, y) = (i % width, i / width);
                [(3 * x) as u8, (90 + 5 * y) as u8, (200 - x - y) as u8]
            };
            let rgb: Vec<u8> = (0..width * height).flat_map(pixel).collect();
            let blocks = uastc_blocks(width, height, &rgb);
            assert_eq!(blocks, uastc_blocks(width, height, &rgb));
            assert!(blocks.is_some());
            let back = decoded(&basis_file(width, height, &rgb).expect("encodes"));
            assert_eq!(back.len(), rgb.len());
            let off = |(a, b): (&u8, &u8)| a.abs_diff(*b);
            let worst = rgb.iter().zip(&back).map(off).max();
            assert!(worst <= Some(4), "{width} {height}: {worst:?}");
        }
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert!(uastc_blocks(0, 4, &[]).is_none());
        assert!(uastc_blocks(4, 4, &[0; 47]).is_none());
        assert!(uastc_blocks(70_000, 1, &[0; 210_000]).is_none());
        assert!(slice(&[0; 10]).is_none());
        assert!(slice(&[0xff; 100]).is_none());
    }
}
