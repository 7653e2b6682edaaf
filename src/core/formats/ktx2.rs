//! KTX 2.0 files of UASTC blocks, which `KHR_texture_basisu` of glTF embeds: header, index of levels,
//! data format descriptor, metadata, then the levels, smallest first (Khronos, *KTX File Format
//! Specification 2.0* and *Data Format Specification 1.3*, section of UASTC).

use crate::core::parallel::map_chunks;
use crate::error::{Error, Result};
use crate::ffi::basis::{BLOCK_BYTES, uastc_blocks};

/// A picture without transparency.
#[derive(Clone, Debug, PartialEq)]
pub struct Rgb8 {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue of each pixel, row-major from the top.
    pub rgb: Vec<u8>,
}

/// What the numbers of a picture mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Colours of Rec. 709 on the curve of sRGB.
    Srgb,
    /// Numbers that are no colours.
    Linear,
}

/// First bytes of every file.
const IDENTIFIER: [u8; 12] = *b"\xabKTX 20\xbb\r\n\x1a\n";
/// Bytes of the header and of the index up to the levels.
const HEADER: usize = 80;
/// Bytes of a level in the index.
const INDEX_ENTRY: usize = 24;
/// The colour model UASTC.
const UASTC: u8 = 166;
/// Rows of blocks that are encoded at a time (derived: a strip of the smallest texture worth more
/// than one thread).
const STRIP: usize = 16;

/// A file of a picture and its smaller copies, the largest first, each half the size (rounded down)
/// of the one before it.
///
/// # Errors
/// A side is longer than 65535 pixels.
pub fn encode_ktx2(levels: &[Rgb8], transfer: Transfer) -> Result<Vec<u8>> {
    let blocks: Vec<Vec<u8>> = levels.iter().map(level_blocks).collect::<Result<_>>()?;
    let (width, height) = levels.first().map_or((0, 0), |l| (l.width, l.height));
    let descriptor = descriptor(transfer);
    let metadata = metadata();
    let descriptor_at = HEADER + INDEX_ENTRY * levels.len();
    let metadata_at = descriptor_at + descriptor.len();
    let mut out = Vec::new();
    out.extend_from_slice(&IDENTIFIER);
    let counts = [0, 1, width, height, 0, 0, 1, levels.len(), 0];
    let places = [descriptor_at, descriptor.len(), metadata_at, metadata.len()];
    for number in counts.into_iter().chain(places) {
        out.extend_from_slice(&(number as u32).to_le_bytes());
    }
    // no data that levels share
    out.extend_from_slice(&[0; 16]);
    let mut at = metadata_at + metadata.len();
    let mut index = vec![0usize; levels.len()];
    for (place, level) in index.iter_mut().zip(&blocks).rev() {
        *place = at.next_multiple_of(BLOCK_BYTES);
        at = *place + level.len();
    }
    for (place, level) in index.iter().zip(&blocks) {
        for number in [*place, level.len(), level.len()] {
            out.extend_from_slice(&(number as u64).to_le_bytes());
        }
    }
    out.extend_from_slice(&descriptor);
    out.extend_from_slice(&metadata);
    for (place, level) in index.iter().zip(&blocks).rev() {
        out.resize(*place, 0);
        out.extend_from_slice(level);
    }
    Ok(out)
}

/// The blocks of a level, strip by strip on all threads.
fn level_blocks(level: &Rgb8) -> Result<Vec<u8>> {
    let row = 3 * level.width;
    let strips = map_chunks(level.height, 4 * STRIP, |rows| {
        let rgb = &level.rgb[row * rows.start..row * rows.end];
        uastc_blocks(level.width, rows.len(), rgb)
    });
    let strips: Option<Vec<Vec<u8>>> = strips.into_iter().collect();
    strips.map(|s| s.concat()).ok_or_else(|| {
        Error::Failed(format!(
            "a texture of {} × {} texels cannot be stored as KTX2; expected sides from 1 to 65535: lower --max-texture",
            level.width, level.height
        ))
    })
}

/// The data format descriptor: one block of one sample of three channels.
fn descriptor(transfer: Transfer) -> Vec<u8> {
    let (primaries, curve) = match transfer {
        Transfer::Srgb => (1, 2),
        Transfer::Linear => (0, 1),
    };
    let mut out = Vec::new();
    // size; vendor and type; version 2 and the block's size
    for word in [44u32, 0, 2 | 40 << 16] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    out.extend_from_slice(&[UASTC, primaries, curve, 0]);
    // blocks of 4 × 4, of 16 bytes
    out.extend_from_slice(&[3, 3, 0, 0, BLOCK_BYTES as u8, 0, 0, 0, 0, 0, 0, 0]);
    // the sample: bits 0 to 127, channel RGB; no place; from 0 to the largest number
    for word in [127u32 << 16, 0, 0, u32::MAX] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    out
}

/// Keys and values, in the order of the keys.
fn metadata() -> Vec<u8> {
    let mut out = Vec::new();
    for entry in [
        &b"KTXorientation\0rd\0"[..],
        concat!("KTXwriter\0unbake ", env!("CARGO_PKG_VERSION"), "\0").as_bytes(),
    ] {
        out.extend_from_slice(&(entry.len() as u32).to_le_bytes());
        out.extend_from_slice(entry);
        out.resize(out.len().next_multiple_of(4), 0);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Rgb8 {
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            [x as u8, 2 * (y as u8), 7]
        };
        Rgb8 {
            width,
            height,
            rgb: (0..width * height).flat_map(pixel).collect(),
        }
    }

    /// Another program's reader finds what was written.
    #[test]
    fn levels_and_meaning_are_read_back() {
        for transfer in [Transfer::Srgb, Transfer::Linear] {
            let levels = [picture(120, 72), picture(60, 36), picture(30, 18)];
            let bytes = encode_ktx2(&levels, transfer).expect("encodes");
            let file = ktx2::Reader::new(bytes.as_slice()).expect("valid");
            let header = file.header();
            assert_eq!(
                (header.pixel_width, header.pixel_height, header.level_count),
                (120, 72, 3)
            );
            assert_eq!(
                (header.format, header.supercompression_scheme),
                (None, None)
            );
            assert_eq!(file.color_model(), Some(ktx2::ColorModel::UASTC));
            let srgb = transfer == Transfer::Srgb;
            assert_eq!(
                file.transfer_function() == Some(ktx2::TransferFunction::SRGB),
                srgb
            );
            assert_eq!(
                file.transfer_function() == Some(ktx2::TransferFunction::Linear),
                !srgb
            );
            assert_eq!(
                file.color_primaries() == Some(ktx2::ColorPrimaries::BT709),
                srgb
            );
            assert!(file.writer().is_some_and(|w| w.starts_with("unbake")));
            let found: Vec<_> = file.levels().map(|l| l.data.to_vec()).collect();
            assert_eq!(found.len(), 3);
            for (level, data) in levels.iter().zip(&found) {
                // the strips of a level are the level
                let whole = uastc_blocks(level.width, level.height, &level.rgb);
                assert_eq!(Some(data), whole.as_ref());
            }
            // each level lies at a multiple of its block's size, the smallest first
            let place = |k: usize| {
                let at = HEADER + INDEX_ENTRY * k;
                u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
            };
            assert!(
                (0..3).all(|k| place(k) % 16 == 0) && place(2) < place(1) && place(1) < place(0)
            );
        }
    }

    #[test]
    fn sides_beyond_the_format_are_refused_in_words() {
        let wide = picture(65_536, 4);
        let e = encode_ktx2(&[wide], Transfer::Linear).expect_err("too wide");
        assert!(e.to_string().contains("--max-texture"), "{e}");
    }
}
