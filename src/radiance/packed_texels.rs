//! Radiance in eight bytes a texel, in tiles of a cache line per row: what rays from one place meet
//! lies close together in memory.
//!
//! Three mantissas of 17 bits and a sign share an exponent: a brightest channel keeps all but
//! 8·10⁻⁶ of its value, where half floats of the same size would lose 5·10⁻⁴ and end at 65,504.
//! Signs are for differences of light.

use crate::core::image::RgbPlane;
use crate::core::parallel::prelude::*;
use crate::ffi::simd::prefetch;
use glam::Vec3;

/// Texels of a cache line.
const LINE: usize = 8;
/// Rows of a tile; it is [`LINE`] wide.
const ROWS: usize = 8;
/// Bits of a channel's mantissa, sign included.
const BITS: u32 = 18;

/// Texels of one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
struct Line([u64; LINE]);

/// Radiances by address.
#[derive(Clone, Debug)]
pub(crate) struct PackedTexels {
    lines: Vec<Line>,
}

/// Where a plane's texels lie.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tiles {
    first: u32,
    /// Texels in the tiles that lie side by side.
    row: u32,
}

impl Tiles {
    /// Address of the texel in column `x` of row `y`.
    #[inline(always)]
    pub(crate) fn address(&self, x: u32, y: u32) -> u32 {
        const W: u32 = LINE as u32;
        const H: u32 = ROWS as u32;
        self.first + y / H * self.row + x / W * (W * H) + y % H * W + x % W
    }
}

impl Tiles {
    /// What an address here exceeds that of the same texel of `other`, a plane as large, by
    /// (wrapping around).
    #[inline(always)]
    pub(crate) fn since(&self, other: &Self) -> u32 {
        self.first.wrapping_sub(other.first)
    }
}

impl PackedTexels {
    /// Address of a texel that is black.
    pub(crate) const BLACK: u32 = 0;

    /// Nothing but [`Self::BLACK`].
    pub(crate) fn new() -> Self {
        Self {
            lines: vec![Line::default()],
        }
    }

    /// Adds a plane, tile by tile.
    pub(crate) fn push_plane(&mut self, plane: &RgbPlane) -> Tiles {
        let columns = plane.width.div_ceil(LINE);
        let line = |i: usize| {
            // line, tile, row of tiles
            let (tile, y) = (i / ROWS, i / ROWS / columns * ROWS + i % ROWS);
            let x = tile % columns * LINE;
            let texel = |k: usize| {
                if x + k < plane.width && y < plane.height {
                    pack(plane[(x + k, y)])
                } else {
                    0
                }
            };
            Line(std::array::from_fn(texel))
        };
        let tiles = Tiles {
            first: self.end(),
            row: (columns * LINE * ROWS) as u32,
        };
        self.lines.par_extend(
            (0..columns * plane.height.next_multiple_of(ROWS))
                .into_par_iter()
                .map(line),
        );
        tiles
    }

    /// Adds texels one after the other; returns the first one's address.
    pub(crate) fn push_list(&mut self, texels: &[Vec3]) -> u32 {
        let first = self.end();
        self.lines.extend(
            texels
                .chunks(LINE)
                .map(|t| Line(std::array::from_fn(|k| t.get(k).map_or(0, |v| pack(*v))))),
        );
        first
    }

    fn end(&self) -> u32 {
        (self.lines.len() * LINE) as u32
    }

    /// The radiance at an address.
    #[inline(always)]
    pub(crate) fn get(&self, address: u32) -> Vec3 {
        unpack(self.lines[address as usize / LINE].0[address as usize % LINE])
    }

    /// Tells the cache that [`Self::get`] will be asked for soon.
    #[inline(always)]
    pub(crate) fn expect(&self, address: u32) {
        prefetch(&self.lines, address as usize / LINE);
    }
}

/// Red, green and blue from the lowest bits on, then the exponent of the last bit's worth, as a
/// float's. What is not a number counts as zero.
fn pack(radiance: Vec3) -> u64 {
    let v = radiance.to_array().map(|x| {
        if x.is_nan() {
            0.0
        } else {
            x.clamp(-f32::MAX, f32::MAX)
        }
    });
    let most = v.iter().fold(0.0f32, |most, x| most.max(x.abs()));
    let exponent = (most.to_bits() >> 23) as i32 - (BITS as i32 - 2);
    // below: too dim to be told from black (10⁻³³)
    if exponent <= 0 {
        return 0;
    }
    let mantissas = |exponent: i32| {
        // in double precision the quotient is exact
        let worth = f64::from(f32::from_bits((exponent as u32) << 23));
        v.map(|x| (f64::from(x) / worth).round_ties_even() as i64)
    };
    let overflows = |m: &[i64; 3]| m.iter().any(|m| m.abs() >> (BITS - 1) > 0);
    let (mut m, mut e) = (mantissas(exponent), exponent);
    if overflows(&m) {
        e += 1;
        m = mantissas(e);
    }
    let [r, g, b] = m.map(|m| m as u64 & ((1 << BITS) - 1));
    r | g << BITS | b << (2 * BITS) | (e as u64) << (3 * BITS)
}

#[inline(always)]
fn unpack(texel: u64) -> Vec3 {
    // to the upper end and back: the sign comes along
    let channel = |c: u32| ((texel << (64 - (c + 1) * BITS)) as i64 >> (64 - BITS)) as i32 as f32;
    Vec3::new(channel(0), channel(1), channel(2))
        * f32::from_bits((texel >> (3 * BITS)) as u32 * (1 << 23))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::core::sampling::KeyedRng;

    #[test]
    fn a_brightest_channel_keeps_17_bits_and_the_others_as_much_of_it() {
        let mut rng = KeyedRng::new(3, 1);
        for exponent in -90..127 {
            for _ in 0..100 {
                let v = Vec3::from_array(std::array::from_fn(|_| 2.0 * rng.next_f32() - 1.0))
                    * 2f32.powi(exponent);
                let error = (unpack(pack(v)) - v).abs().max_element();
                assert!(error <= v.abs().max_element() * 2f32.powi(-17), "{v}");
            }
        }
    }

    #[test]
    fn round_numbers_are_exact_and_extremes_stay_in_range() {
        for v in [
            Vec3::ONE,
            Vec3::new(1.0, 0.5, 0.25),
            Vec3::splat(1e5),
            Vec3::ZERO,
            Vec3::new(65_536.0, 0.0, -3.0),
        ] {
            assert_eq!(unpack(pack(v)), v);
        }
        // rounds up to a mantissa of one bit more
        let nearly = Vec3::splat(1.0 - f32::EPSILON / 2.0);
        assert_eq!(unpack(pack(nearly)), Vec3::ONE);
        assert_eq!(unpack(pack(Vec3::new(f32::NAN, -1.0, 1e-45))), Vec3::NEG_Y);
        for v in [Vec3::splat(f32::MAX), Vec3::splat(f32::INFINITY)] {
            assert!(unpack(pack(v)).min_element() >= 0.99 * f32::MAX);
        }
    }

    #[test]
    fn texels_are_found_where_they_were_put() {
        let mut texels = PackedTexels::new();
        let list = texels.push_list(&(0..11).map(|i| Vec3::splat(i as f32)).collect::<Vec<_>>());
        let planes = [(13, 21), (8, 8), (1, 1), (64, 3)].map(|(width, height)| {
            let data = (0..width * height)
                .map(|i| Vec3::new(i as f32, 1.0, width as f32))
                .collect();
            let plane = Plane {
                width,
                height,
                data,
            };
            (texels.push_plane(&plane), plane)
        });
        assert_eq!(texels.get(PackedTexels::BLACK), Vec3::ZERO);
        assert!((0..11).all(|i| texels.get(list + i) == Vec3::splat(i as f32)));
        for (tiles, plane) in planes {
            for (y, x) in (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| (y, x))) {
                let address = tiles.address(x as u32, y as u32);
                texels.expect(address);
                assert_eq!(texels.get(address), plane[(x, y)], "{x}, {y}");
            }
        }
    }
}
