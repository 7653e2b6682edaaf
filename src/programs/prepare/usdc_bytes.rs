//! Bytes of a binary USD file: blocks of LZ4, and integers as differences in one, two or four bytes
//! (OpenUSD, `pxr/usd/sdf`: integerCoding, fastCompression). Called by `usdc` and `usdc_tables`.
//!
//! Nothing is allocated that the file's own bytes could not stand for.

/// Most numbers, names and paths in all: a room has thousands. Derived: 2²⁶ take 2 GiB as values.
pub const MOST_VALUES: u64 = 1 << 26;
/// Bytes that one byte of an LZ4 block can become (the format's largest match length per byte).
const LZ4_EXPANSION: usize = 255;

/// What was read, or what was expected.
pub type Reading<T> = Result<T, String>;

/// An error that says what is damaged.
pub fn damaged<T>(what: &str) -> Reading<T> {
    Err(format!(
        "damaged binary USD ({what}); copy the file again or convert it to text (`usdcat -o out.usda`)"
    ))
}

/// Bytes with a place in them.
#[derive(Clone, Copy)]
pub struct Bytes<'a> {
    /// The whole file or section.
    pub all: &'a [u8],
    /// The place of the next byte.
    pub at: usize,
}

impl<'a> Bytes<'a> {
    /// The next `count` bytes.
    pub fn take(&mut self, count: u64) -> Reading<&'a [u8]> {
        let end = usize::try_from(count)
            .ok()
            .and_then(|n| self.at.checked_add(n));
        match end.and_then(|e| self.all.get(self.at..e)) {
            Some(found) => {
                self.at += found.len();
                Ok(found)
            }
            None => damaged("it ends early"),
        }
    }

    /// The next `N` bytes.
    pub fn array<const N: usize>(&mut self) -> Reading<[u8; N]> {
        let found = self.take(N as u64)?;
        found.try_into().or_else(|_| damaged("it ends early"))
    }

    /// The next four bytes.
    pub fn u32(&mut self) -> Reading<u32> {
        self.array().map(u32::from_le_bytes)
    }

    /// The next eight bytes.
    pub fn u64(&mut self) -> Reading<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Goes on where the next number says, counted from that number: behind what the values in
    /// between have written.
    pub fn jump(&mut self) -> Reading<()> {
        let start = self.at;
        let offset = usize::try_from(self.u64()?).ok();
        match offset.and_then(|o| start.checked_add(o)) {
            Some(at) => {
                self.at = at;
                Ok(())
            }
            None => damaged("a distance"),
        }
    }

    /// A block of at most `most` bytes, its packed length before it.
    pub fn packed(&mut self, most: usize) -> Reading<Vec<u8>> {
        let length = self.u64()?;
        unpack(self.take(length)?, most)
    }

    /// `count` integers of four bytes, packed.
    pub fn integers(&mut self, count: u64) -> Reading<Vec<u32>> {
        let wide = self.packed_integers(count, Width::Four)?;
        Ok(wide.into_iter().map(|i| i as u32).collect())
    }

    /// `count` integers of eight bytes, packed.
    pub fn wide_integers(&mut self, count: u64) -> Reading<Vec<i64>> {
        self.packed_integers(count, Width::Eight)
    }

    fn packed_integers(&mut self, count: u64, width: Width) -> Reading<Vec<i64>> {
        let length = self.u64()?;
        unpack_integers(self.take(length)?, count, width)
    }
}

/// Bytes of an integer that is packed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Width {
    Four,
    Eight,
}

/// LZ4 blocks behind a number of chunks; 0 = one block without lengths.
fn unpack(packed: &[u8], most: usize) -> Reading<Vec<u8>> {
    let Some((&chunks, mut rest)) = packed.split_first() else {
        return damaged("an empty block");
    };
    let mut out = Vec::new();
    for chunk in 0..usize::from(chunks).max(1) {
        let block = if chunks == 0 {
            rest
        } else {
            let mut bytes = Bytes { all: rest, at: 0 };
            let length = bytes.u32()?;
            let block = bytes.take(u64::from(length))?;
            rest = &rest[bytes.at..];
            block
        };
        let room = block.len().saturating_mul(LZ4_EXPANSION).saturating_add(64);
        let start = out.len();
        out.resize(start + room.min(most - start), 0);
        match lz4_flex::block::decompress_into(block, &mut out[start..]) {
            Ok(n) => out.truncate(start + n),
            Err(_) => return damaged(&format!("block {chunk} is no LZ4")),
        }
    }
    Ok(out)
}

/// Integers as differences: the most frequent one first, then two bits each that say whether it is
/// that one or stored in a quarter, a half or
/// all of their bytes.
fn unpack_integers(packed: &[u8], count: u64, width: Width) -> Reading<Vec<i64>> {
    if count > MOST_VALUES {
        return damaged("too many numbers");
    }
    let count = count as usize;
    let codes = count.div_ceil(4);
    let [least, middle, most] = match width {
        Width::Four => [1, 2, 4],
        Width::Eight => [2, 4, 8],
    };
    let plain = unpack(packed, most as usize * (1 + count) + codes)?;
    let mut bytes = Bytes { all: &plain, at: 0 };
    if count == 0 {
        return Ok(Vec::new());
    }
    let common = signed(bytes.take(most)?);
    let codes = bytes.take(codes as u64)?;
    let mut previous = 0i64;
    let mut out = Vec::with_capacity(count);
    for i in 0..count {
        let difference = match codes[i / 4] >> (2 * (i % 4)) & 3 {
            0 => common,
            1 => signed(bytes.take(least)?),
            2 => signed(bytes.take(middle)?),
            _ => signed(bytes.take(most)?),
        };
        previous = previous.wrapping_add(difference);
        out.push(previous);
    }
    Ok(out)
}

/// A whole number of at most eight bytes, the lowest first.
fn signed(bytes: &[u8]) -> i64 {
    let unused = 64 - 8 * bytes.len().clamp(1, 8) as u32;
    let bits = (bytes.iter().take(8).rev()).fold(0i64, |n, b| n << 8 | i64::from(*b));
    bits << unused >> unused
}

/// A number of `width` bytes.
pub fn number(b: &[u8], float: bool, signed: bool) -> f64 {
    match (b, float) {
        (&[a], _) if signed => f64::from(a as i8),
        (&[a], _) => f64::from(a),
        (&[a, b], _) => half::f16::from_le_bytes([a, b]).to_f64(),
        (&[a, b, c, d], true) => f64::from(f32::from_le_bytes([a, b, c, d])),
        (&[a, b, c, d], false) if signed => f64::from(i32::from_le_bytes([a, b, c, d])),
        (&[a, b, c, d], false) => f64::from(u32::from_le_bytes([a, b, c, d])),
        (b, float) => match b.try_into().map(u64::from_le_bytes) {
            Ok(bits) if float => f64::from_bits(bits),
            Ok(bits) if signed => bits as i64 as f64,
            Ok(bits) => bits as f64,
            Err(_) => f64::NAN,
        },
    }
}
