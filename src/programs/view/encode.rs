//! Textures for the browser: eight bits or a shared exponent per texel, with mips, in one
//! gzip-compressed block.
//!
//! WebGL 2 filters all of these formats without extensions, phones included. A block is a header of
//! 16 bytes (`UBTX`, width, height as u32, format, levels, two zeros; little-endian) followed by
//! the levels from the finest to the coarsest, rows without padding.

use crate::core::image::{Plane, RgbPlane};
use crate::core::math::srgb_from_linear;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::{Vec2, Vec3};
use std::borrow::Cow;
use std::io::Write;
use std::ops::{Add, Mul};

/// Longest sides a client may ask for.
pub const CAPS: [usize; 3] = [1024, 2048, 4096];

/// Mips below the base level: charts are small, coarser levels would mix neighbours on the atlas.
const LEVELS: usize = 4;

/// Standard errors are shown from 10^-4 to 10; 255 marks texels that no view saw.
const CONFIDENCE_DECADES: (f32, f32) = (-4.0, 1.0);

/// How the texels of a block are stored; the number is that of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// RGB in sRGB, alpha 255.
    Srgb8 = 0,
    /// One channel of eight bits.
    R8 = 1,
    /// Two channels of eight bits.
    Rg8 = 2,
    /// Nine bits each and a shared exponent of five.
    Rgb9E5 = 3,
    /// Two channels of sixteen bits, integers.
    Rg16Ui = 4,
}

/// A positive colour with a shared exponent: red in the lowest nine bits, the exponent in the
/// highest five.
#[must_use]
pub fn rgb9e5(colour: Vec3) -> u32 {
    const BIAS: i32 = 15;
    const MANTISSA: i32 = 9;
    /// 511/512 · 2^16.
    const LARGEST: f32 = 65_408.0;
    let c = colour
        .to_array()
        .map(|x| if x > 0.0 { x.min(LARGEST) } else { 0.0 });
    let max = c[0].max(c[1]).max(c[2]);
    // unbiased exponent of the largest channel; denormals are far below the smallest representable
    // value
    let floor_log2 = (max.to_bits() >> 23) as i32 - 127;
    let mut exponent = floor_log2.max(-BIAS - 1) + 1 + BIAS;
    let unit = |e: i32| ((e - BIAS - MANTISSA) as f32).exp2();
    if (max / unit(exponent)).round() as i32 == 1 << MANTISSA {
        exponent += 1;
    }
    let [r, g, b] = c.map(|x| (x / unit(exponent)).round() as u32);
    r | g << 9 | b << 18 | (exponent as u32) << 27
}

/// Gzip at a speed that a local connection does not wait for.
#[must_use]
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::fast());
    // writing to memory cannot fail
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// The plane halved until its longest side is at most `cap`.
pub fn capped<T>(plane: &Plane<T>, cap: usize) -> Cow<'_, Plane<T>>
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T>,
{
    let mut out = Cow::Borrowed(plane);
    while out.width.max(out.height) > cap {
        out = Cow::Owned(out.half());
    }
    out
}

/// A block with mips; `texel` encodes one value.
fn block<T, const N: usize>(
    base: &Plane<T>,
    format: Format,
    levels: usize,
    texel: impl Fn(&T) -> [u8; N],
) -> Vec<u8>
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T>,
{
    let count = (0..levels.max(1))
        .take_while(|l| *l == 0 || base.width.min(base.height) >> l > 0)
        .count();
    let mut bytes = header(base.width, base.height, format, count);
    bytes.reserve(base.data.len() * N * 4 / 3);
    let mut level = Cow::Borrowed(base);
    for l in 0..count {
        if l > 0 {
            level = Cow::Owned(level.half());
        }
        bytes.extend(level.data.iter().flat_map(&texel));
    }
    bytes
}

fn header(width: usize, height: usize, format: Format, levels: usize) -> Vec<u8> {
    let mut bytes = b"UBTX".to_vec();
    // sizes are at most the largest image the program reads, 2^28 pixels
    bytes.extend((width as u32).to_le_bytes());
    bytes.extend((height as u32).to_le_bytes());
    bytes.extend([format as u8, levels as u8, 0, 0]);
    bytes
}

fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Albedo: sRGB; alpha is the share that is no metal, linear.
#[must_use]
pub fn albedo(plane: &RgbPlane, metallic: Option<&Plane<f32>>, cap: usize) -> Vec<u8> {
    let texel = |colour: Vec3, diffuse: f32| {
        let [r, g, b] = colour
            .to_array()
            .map(|x| byte(srgb_from_linear(x.clamp(0.0, 1.0))));
        [r, g, b, byte(diffuse)]
    };
    let Some(metallic) = metallic else {
        let plane = capped(plane, cap);
        return block(&plane, Format::Srgb8, LEVELS, |v| texel(*v, 1.0));
    };
    let texels = plane.data.iter().zip(&metallic.data);
    let both = Plane {
        width: plane.width,
        height: plane.height,
        data: texels.map(|(colour, m)| colour.extend(1.0 - m)).collect(),
    };
    block(&capped(&both, cap), Format::Srgb8, LEVELS, |v| {
        texel(v.truncate(), v.w)
    })
}

/// Roughness: eight bits; with panes a second channel, the share of transmitted light.
#[must_use]
pub fn roughness(plane: &Plane<f32>, transmission: Option<&Plane<f32>>, cap: usize) -> Vec<u8> {
    let Some(transmission) = transmission else {
        return block(&capped(plane, cap), Format::R8, LEVELS, |r| [byte(*r)]);
    };
    let transmission = transmission.resampled(plane.width, plane.height);
    let texels = plane.data.iter().zip(&transmission.data);
    let both = Plane {
        width: plane.width,
        height: plane.height,
        data: texels.map(|(r, t)| Vec2::new(*r, *t)).collect(),
    };
    block(&capped(&both, cap), Format::Rg8, LEVELS, |v| {
        [byte(v.x), byte(v.y)]
    })
}

/// Radiance, irradiance, emission, photographs: `scale` times the value with a shared exponent.
#[must_use]
pub fn radiometric(plane: &RgbPlane, cap: usize, scale: f32) -> Vec<u8> {
    block(&capped(plane, cap), Format::Rgb9E5, LEVELS, |v| {
        rgb9e5(*v * scale).to_le_bytes()
    })
}

/// A map of texels that are packed already ([`rgb9e5`]), row by row, without mips.
#[must_use]
pub fn packed_map(width: usize, height: usize, texels: impl Iterator<Item = u32>) -> Vec<u8> {
    let mut bytes = header(width, height, Format::Rgb9E5, 1);
    bytes.reserve(4 * width * height);
    bytes.extend(texels.flat_map(u32::to_le_bytes));
    bytes
}

/// Standard errors on a logarithmic scale, without mips (the mark of unobserved texels must not be
/// mixed).
#[must_use]
pub fn confidence(plane: &Plane<Vec2>, cap: usize) -> Vec<u8> {
    let plane = thinned(plane, cap);
    let (low, high) = CONFIDENCE_DECADES;
    let code = |e: f32| {
        if e >= 100.0 {
            255
        } else {
            (((e.max(1e-9).log10() - low) / (high - low)).clamp(0.0, 1.0) * 254.0) as u8
        }
    };
    block(&plane, Format::Rg8, 1, |v| [code(v.x), code(v.y)])
}

/// Class and room ids, without mips.
#[must_use]
pub fn ids(labels: &Plane<u16>, rooms: &Plane<u16>, cap: usize) -> Vec<u8> {
    let labels = thinned(labels, cap);
    let (w, h) = (labels.width, labels.height);
    let mut bytes = header(w, h, Format::Rg16Ui, 1);
    for y in 0..h {
        for x in 0..w {
            let at = Vec2::new(
                (x as f32 + 0.5) / w as f32 * rooms.width as f32,
                (y as f32 + 0.5) / h as f32 * rooms.height as f32,
            );
            bytes.extend(labels[(x, y)].to_le_bytes());
            bytes.extend(rooms.nearest(at).to_le_bytes());
        }
    }
    bytes
}

/// Every n-th texel, for values that cannot be averaged.
fn thinned<T: Copy>(plane: &Plane<T>, cap: usize) -> Cow<'_, Plane<T>> {
    let step = plane.width.max(plane.height).div_ceil(cap.max(1));
    if step <= 1 {
        return Cow::Borrowed(plane);
    }
    let (width, height) = ((plane.width / step).max(1), (plane.height / step).max(1));
    let at = |i: usize| {
        plane[(
            (i % width * step).min(plane.width - 1),
            (i / width * step).min(plane.height - 1),
        )]
    };
    Cow::Owned(Plane {
        width,
        height,
        data: (0..width * height).map(at).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(code: u32) -> Vec3 {
        let unit = ((code >> 27) as f32 - 24.0).exp2();
        Vec3::new(
            (code & 511) as f32,
            (code >> 9 & 511) as f32,
            (code >> 18 & 511) as f32,
        ) * unit
    }

    #[test]
    fn alpha_is_what_is_no_metal() {
        let plane = Plane::filled(2, 1, Vec3::ONE);
        let metallic = Plane {
            width: 2,
            height: 1,
            data: vec![1.0, 0.2],
        };
        let alphas = |metallic: Option<&Plane<f32>>| {
            let bytes = albedo(&plane, metallic, 1024);
            let texels = &bytes[header(2, 1, Format::Srgb8, 1).len()..];
            [texels[3], texels[7]]
        };
        assert_eq!(alphas(None), [255, 255]);
        assert_eq!(alphas(Some(&metallic)), [0, 204]);
    }

    #[test]
    fn shared_exponent_keeps_the_largest_channel_to_one_part_in_512() {
        for i in -20..16 {
            for f in [1.0f32, 1.1, 1.37, 1.5, 1.99, 1.9999] {
                let x = f * (i as f32).exp2();
                let v = Vec3::new(x, x * 0.5, x * 0.01);
                let back = decoded(rgb9e5(v));
                if i >= -15 {
                    assert!((back.x / x - 1.0).abs() <= 1.0 / 512.0, "{x} {back}");
                    assert!((back - v).abs().max_element() <= x / 512.0);
                } else {
                    assert!(
                        (back - v).abs().max_element() <= 2f32.powi(-24),
                        "{x} {back}"
                    );
                }
            }
        }
        assert_eq!(decoded(rgb9e5(Vec3::ZERO)), Vec3::ZERO);
        assert_eq!(
            decoded(rgb9e5(Vec3::new(f32::NAN, -1.0, 1e9))),
            Vec3::new(0.0, 0.0, 65_408.0)
        );
        assert_eq!(
            decoded(rgb9e5(Vec3::splat(f32::INFINITY))),
            Vec3::splat(65_408.0)
        );
    }

    #[test]
    fn blocks_say_their_size_and_hold_it() {
        let plane = Plane {
            width: 64,
            height: 32,
            data: vec![Vec3::splat(0.5); 64 * 32],
        };
        let bytes = albedo(&plane, None, 1024);
        assert_eq!(&bytes[..16], b"UBTX\x40\0\0\0\x20\0\0\0\x00\x04\0\0");
        assert_eq!(bytes.len(), 16 + 4 * (64 * 32 + 32 * 16 + 16 * 8 + 8 * 4));
        assert_eq!(bytes[16..20], [188, 188, 188, 255]);
        let small = radiometric(&plane, 16, 2.0);
        assert_eq!(
            (small[4], small[8], small[12]),
            (16, 8, Format::Rgb9E5 as u8)
        );
        assert_eq!(
            decoded(u32::from_le_bytes(small[16..20].try_into().expect("4"))),
            Vec3::ONE
        );
        let one = roughness(&Plane::filled(1, 1, 0.2f32), None, 1024);
        assert_eq!(one.len(), 17);
        // a pane beside a wall, in a map of half the size
        let glass = Plane {
            width: 2,
            height: 1,
            data: vec![1.0, 0.0],
        };
        let two = roughness(&Plane::filled(4, 1, 0.2), Some(&glass), 1024);
        assert_eq!(two[12], Format::Rg8 as u8);
        assert_eq!(two[16..24], [51, 255, 51, 191, 51, 64, 51, 0]);
    }

    #[test]
    fn ids_and_unobserved_texels_are_not_averaged() {
        let labels = Plane {
            width: 4,
            height: 4,
            data: (0..16).map(|i| i * 4000).collect(),
        };
        let bytes = ids(&labels, &Plane::filled(1, 1, 7), 2);
        assert_eq!((bytes[4], bytes[8], bytes.len()), (2, 2, 16 + 16));
        assert_eq!(
            bytes[16..24],
            [0, 0, 7, 0, 0x40, 0x1f, 7, 0],
            "labels 0 and 8000, room 7"
        );
        let errors = confidence(
            &Plane {
                width: 2,
                height: 1,
                data: vec![Vec2::new(1e-4, 10.0), Vec2::splat(1e4)],
            },
            1024,
        );
        assert_eq!(errors[16..], [0, 254, 255, 255]);
    }

    #[test]
    fn gzip_unpacks_to_the_same() {
        use std::io::Read;
        let data: Vec<u8> = (0..10_000u32).flat_map(|i| (i / 7).to_le_bytes()).collect();
        let mut back = Vec::new();
        flate2::read::GzDecoder::new(&gzip(&data)[..])
            .read_to_end(&mut back)
            .expect("unpacks");
        assert_eq!(back, data);
    }
}
