//! A small baseline JPEG encoder (ITU-T T.81), so that a self-contained page of pictures stays a
//! few megabytes.
//!
//! YCbCr without chroma subsampling, the standard's example quantisation and Huffman tables (annex
//! K), quality as in the Independent JPEG Group's scale.

use std::f32::consts::PI;

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

/// Order in which the 64 coefficients of a block are coded (row-major index per position).
const ZIGZAG: [usize; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20,
    13, 6, 7, 14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59,
    52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
];

/// Table K.1, luminance, row-major.
const LUMINANCE: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113,
    92, 49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.2, chrominance, row-major.
const CHROMINANCE: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99,
    47, 66, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];

/// A Huffman table as the file states it: number of codes per length, symbols in order of their
/// codes.
struct HuffmanSpec {
    counts: [u8; 16],
    symbols: &'static [u8],
}

/// Table K.3: luminance, DC.
const DC_LUMINANCE: HuffmanSpec = HuffmanSpec {
    counts: [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
    symbols: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
};

/// Table K.5: luminance, AC. It serves chrominance as well: the standard leaves the choice free.
const AC_LUMINANCE: HuffmanSpec = HuffmanSpec {
    counts: [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d],
    symbols: &[
        0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61,
        0x07, 0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52,
        0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25,
        0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45,
        0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64,
        0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83,
        0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99,
        0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6,
        0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3,
        0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8,
        0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
    ],
};

/// Code and length per symbol.
type Codes = [(u16, u8); 256];

fn codes(spec: &HuffmanSpec) -> Codes {
    let mut table = [(0, 0); 256];
    let (mut code, mut next) = (0u16, spec.symbols.iter());
    for (length, count) in (1..).zip(spec.counts) {
        for symbol in next.by_ref().take(count.into()) {
            table[usize::from(*symbol)] = (code, length);
            code += 1;
        }
        code <<= 1;
    }
    table
}

/// Bits, most significant first, with a zero byte stuffed after every 0xff.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    pending: u32,
    count: u32,
}

impl Bits {
    fn put(&mut self, value: u16, length: u8) {
        self.pending = (self.pending << length) | u32::from(value);
        self.count += u32::from(length);
        while self.count >= 8 {
            let byte = (self.pending >> (self.count - 8)) as u8;
            self.bytes.push(byte);
            if byte == 0xff {
                self.bytes.push(0);
            }
            self.count -= 8;
            self.pending &= (1 << self.count) - 1;
        }
    }

    /// Category of `v` and its bits: T.81 F.1.2.1.
    fn magnitude(v: i32) -> (u8, u16) {
        let category = 32 - v.unsigned_abs().leading_zeros();
        let bits = if v < 0 { v - 1 } else { v } & ((1 << category) - 1);
        (category as u8, bits as u16)
    }

    /// One quantised block in zigzag order.
    fn block(&mut self, block: &[i32; 64], previous_dc: i32, dc: &Codes, ac: &Codes) {
        let (category, bits) = Self::magnitude(block[0] - previous_dc);
        self.put(dc[usize::from(category)].0, dc[usize::from(category)].1);
        self.put(bits, category);
        let mut zeros = 0;
        for &v in &block[1..] {
            if v == 0 {
                zeros += 1;
                continue;
            }
            while zeros > 15 {
                self.put(ac[0xf0].0, ac[0xf0].1);
                zeros -= 16;
            }
            let (category, bits) = Self::magnitude(v);
            let symbol = zeros << 4 | usize::from(category);
            self.put(ac[symbol].0, ac[symbol].1);
            self.put(bits, category);
            zeros = 0;
        }
        if zeros > 0 {
            self.put(ac[0].0, ac[0].1);
        }
    }
}

/// JPEG bytes of a picture at a quality of 1 to 100.
///
/// # Panics
/// If the picture's bytes do not match its size or a side is 0 or above 65,535.
#[must_use]
pub fn encode_jpeg(picture: &Picture, quality: u8) -> Vec<u8> {
    let (w, h) = (picture.width, picture.height);
    assert!(
        picture.rgb.len() == 3 * w * h && (1..=65_535).contains(&w) && (1..=65_535).contains(&h),
        "not a picture"
    );
    let quality = u16::from(quality.clamp(1, 100));
    let scale = if quality < 50 {
        5000 / quality
    } else {
        200 - 2 * quality
    };
    let scaled = |table: &[u16; 64]| {
        table.map(|q| ((u32::from(q) * u32::from(scale) + 50) / 100).clamp(1, 255) as u8)
    };
    let quantisers = [scaled(&LUMINANCE), scaled(&CHROMINANCE)];
    let mut out = header(w, h, &quantisers);

    let (dc, ac) = (codes(&DC_LUMINANCE), codes(&AC_LUMINANCE));
    let cosines = cosine_table();
    let mut bits = Bits::default();
    let mut previous = [0i32; 3];
    for by in (0..h).step_by(8) {
        for bx in (0..w).step_by(8) {
            let block: [[f32; 3]; 64] = std::array::from_fn(|i| {
                // blocks over the edge repeat the last row and column
                let (x, y) = ((bx + i % 8).min(w - 1), (by + i / 8).min(h - 1));
                let at = 3 * (y * w + x);
                let [r, g, b] =
                    [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]].map(f32::from);
                [
                    0.299 * r + 0.587 * g + 0.114 * b - 128.0,
                    -0.168_736 * r - 0.331_264 * g + 0.5 * b,
                    0.5 * r - 0.418_688 * g - 0.081_312 * b,
                ]
            });
            for c in 0..3 {
                let block = quantised_block(&block.map(|p| p[c]), &quantisers[c.min(1)], &cosines);
                bits.block(&block, previous[c], &dc, &ac);
                previous[c] = block[0];
            }
        }
    }
    bits.put(0x7f, 7); // pads the last byte with ones
    out.extend_from_slice(&bits.bytes);
    out.extend_from_slice(&[0xff, 0xd9]);
    out
}

/// Everything before the entropy-coded data.
fn header(w: usize, h: usize, quantisers: &[[u8; 64]; 2]) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8, 0xff, 0xe0, 0, 16];
    out.extend_from_slice(b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0");
    for (id, table) in quantisers.iter().enumerate() {
        out.extend_from_slice(&[0xff, 0xdb, 0, 67, id as u8]);
        out.extend(ZIGZAG.map(|z| table[z]));
    }
    let size = [(h >> 8) as u8, h as u8, (w >> 8) as u8, w as u8];
    out.extend_from_slice(&[0xff, 0xc0, 0, 17, 8]);
    out.extend_from_slice(&size);
    out.extend_from_slice(&[3, 1, 0x11, 0, 2, 0x11, 1, 3, 0x11, 1]);
    for (class, spec) in [(0x00, &DC_LUMINANCE), (0x10, &AC_LUMINANCE)] {
        let length = 19 + spec.symbols.len();
        out.extend_from_slice(&[0xff, 0xc4, (length >> 8) as u8, length as u8, class]);
        out.extend_from_slice(&spec.counts);
        out.extend_from_slice(spec.symbols);
    }
    out.extend_from_slice(&[0xff, 0xda, 0, 12, 3, 1, 0, 2, 0, 3, 0, 0, 63, 0]);
    out
}

/// `table[u][x]` = ½·c(u)·cos((2x+1)uπ/16), the one-dimensional transform of T.81 A.3.3.
fn cosine_table() -> [[f32; 8]; 8] {
    std::array::from_fn(|u| {
        let c = if u == 0 {
            std::f32::consts::FRAC_1_SQRT_2
        } else {
            1.0
        };
        std::array::from_fn(|x| 0.5 * c * ((2 * x + 1) as f32 * u as f32 * PI / 16.0).cos())
    })
}

/// Forward transform, quantisation and zigzag of one block.
fn quantised_block(
    samples: &[f32; 64],
    quantiser: &[u8; 64],
    cosines: &[[f32; 8]; 8],
) -> [i32; 64] {
    let mut rows = [0f32; 64];
    for y in 0..8 {
        for u in 0..8 {
            rows[8 * y + u] = (0..8).map(|x| samples[8 * y + x] * cosines[u][x]).sum();
        }
    }
    let coefficient =
        |u: usize, v: usize| -> f32 { (0..8).map(|y| rows[8 * y + u] * cosines[v][y]).sum() };
    ZIGZAG.map(|z| (coefficient(z % 8, z / 8) / f32::from(quantiser[z])).round() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::read_ldr;

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
            std::fs::write(&path, encode_jpeg(&picture, quality)).expect("writes");
            let back = read_ldr(&path).expect("decodes");
            assert_eq!((back.width, back.height), (w, h));
            let sum: f64 = back
                .data
                .iter()
                .zip(picture.rgb.chunks(3))
                .map(|(v, bytes)| {
                    (0..3)
                        .map(|c| {
                            (f64::from(crate::formats::srgb8_from_linear(v[c]))
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
        assert!(encode_jpeg(&picture, 85).len() < 20_000);
    }

    #[test]
    fn huffman_codes_are_prefix_free_and_complete_the_standards_examples() {
        let dc = codes(&DC_LUMINANCE);
        assert_eq!(
            (dc[0], dc[6], dc[11]),
            ((0b00, 2), (0b1110, 4), (0b1_1111_1110, 9))
        );
        let ac = codes(&AC_LUMINANCE);
        assert_eq!(
            (ac[0x00], ac[0xf0], ac[0x01]),
            ((0b1010, 4), (0b111_1111_1001, 11), (0b00, 2))
        );
    }
}
