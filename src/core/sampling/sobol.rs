//! Owen-scrambled Sobol' points by hashing (Burley 2020, "Practical Hash-based Owen Scrambling",
//! JCGT 9(4)) and the Hammersley set of the paper.

/// Direction numbers of Sobol' dimensions 0..3 as 32-bit generator columns (Joe & Kuo 2008,
/// new-joe-kuo-6.21201).
const DIRECTIONS: [[u32; 32]; 4] = [
    directions(0, 0, [1, 0, 0]),
    directions(1, 0, [1, 0, 0]),
    directions(2, 1, [1, 3, 0]),
    directions(3, 1, [1, 3, 1]),
];

const fn directions(degree: usize, a: u32, m: [u32; 3]) -> [u32; 32] {
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        v[i] = if degree == 0 {
            1 << (31 - i)
        } else if i < degree {
            m[i] << (31 - i)
        } else {
            let mut x = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if (a >> (degree - 1 - k)) & 1 == 1 {
                    x ^= v[i - k];
                }
                k += 1;
            }
            x
        };
        i += 1;
    }
    v
}

/// Columns summed for every value of each byte of the index: the shuffled indices below have all
/// their bits in use, and a loop over bits would mispredict half of its branches.
static BYTES: [[[u32; 256]; 4]; 4] = byte_tables();

const fn byte_tables() -> [[[u32; 256]; 4]; 4] {
    let mut tables = [[[0u32; 256]; 4]; 4];
    let mut dimension = 0;
    while dimension < 4 {
        let mut byte = 0;
        while byte < 4 {
            let mut value = 1;
            while value < 256usize {
                // the value without its lowest bit, and the column of that bit
                let bit = value.trailing_zeros() as usize;
                tables[dimension][byte][value] = tables[dimension][byte][value & (value - 1)]
                    ^ DIRECTIONS[dimension][8 * byte + bit];
                value += 1;
            }
            byte += 1;
        }
        dimension += 1;
    }
    tables
}

#[inline]
fn sobol(index: u32, dimension: usize) -> u32 {
    let t = &BYTES[dimension];
    let [a, b, c, d] = index.to_le_bytes().map(usize::from);
    t[0][a] ^ t[1][b] ^ t[2][c] ^ t[3][d]
}

/// Laine–Karras permutation with the constants of Burley's listing 3.
#[inline(always)]
fn laine_karras(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x
}

fn owen_scramble(x: u32, seed: u32) -> u32 {
    laine_karras(x.reverse_bits(), seed).reverse_bits()
}

#[inline]
fn hash_dimension(seed: u32, dimension: u32) -> u32 {
    let mut h = seed ^ dimension.wrapping_mul(0x9E37_79B9);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// An Owen-scrambled, shuffled Sobol' sequence in up to four dimensions, one scramble per key.
#[derive(Clone, Copy, Debug)]
pub struct SobolSequence {
    seed: u32,
}

impl SobolSequence {
    /// The sequence of a key (what is being sampled: texel, pass).
    #[must_use]
    pub fn new(seed: u64, key: u64) -> Self {
        Self {
            seed: super::hash_u64(seed, key) as u32,
        }
    }

    /// Point `index` in dimensions 0 and 1, in [0, 1)².
    #[must_use]
    pub fn point2(&self, index: u32) -> [f32; 2] {
        let i = owen_scramble(index, hash_dimension(self.seed, 77));
        [self.value(i, 0), self.value(i, 1)]
    }

    /// Point `index` in three dimensions, in [0, 1)³.
    #[must_use]
    pub fn point3(&self, index: u32) -> [f32; 3] {
        let i = owen_scramble(index, hash_dimension(self.seed, 77));
        std::array::from_fn(|d| self.value(i, d))
    }

    /// Point `index` in four dimensions, in [0, 1)⁴.
    #[must_use]
    pub fn point4(&self, index: u32) -> [f32; 4] {
        let i = owen_scramble(index, hash_dimension(self.seed, 77));
        std::array::from_fn(|d| self.value(i, d))
    }

    fn value(&self, shuffled: u32, dimension: usize) -> f32 {
        let x = owen_scramble(
            sobol(shuffled, dimension),
            hash_dimension(self.seed, dimension as u32),
        );
        (x >> 8) as f32 * (1.0 / 16_777_216.0)
    }
}

/// Points `begin..end` of the unscrambled sequence in three dimensions. Whoever draws the same
/// points under many keys shares them, and per key only the scrambling is left, which runs in
/// vector registers.
#[derive(Clone, Debug)]
pub struct SobolBlock {
    /// Bit-reversed values per dimension.
    reversed: [Vec<u32>; 3],
}

impl SobolBlock {
    /// The points `begin..end`.
    #[must_use]
    pub fn new(begin: u32, end: u32) -> Self {
        Self {
            reversed: std::array::from_fn(|d| {
                (begin..end).map(|i| sobol(i, d).reverse_bits()).collect()
            }),
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.reversed[0].len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.reversed[0].is_empty()
    }

    /// Coordinates in [0, 1) of all points in one dimension, scrambled for `sequence`; `out.len()
    /// == self.len()`. Aligned blocks of 2^m points hold the points of [`SobolSequence::point2`],
    /// but not in its shuffled order: use them for one sum, not side by side with another sequence.
    #[inline(always)]
    pub fn fill(&self, sequence: &SobolSequence, dimension: usize, out: &mut [f32]) {
        let seed = hash_dimension(sequence.seed, dimension as u32);
        // shuffling moves an aligned block to the one that index 0 moves to; the sequence is linear
        // over bits
        let block = sobol(
            owen_scramble(0, hash_dimension(sequence.seed, 77)),
            dimension,
        )
        .reverse_bits();
        for (value, &raw) in out.iter_mut().zip(&self.reversed[dimension]) {
            // 24 bits: a signed conversion is exact, and the one vector units have
            *value = (laine_karras(raw ^ block, seed).reverse_bits() >> 8) as i32 as f32
                * (1.0 / 16_777_216.0);
        }
    }
}

/// Van der Corput radical inverse in base 2, in [0, 1).
#[must_use]
pub fn radical_inverse_base2(i: u32) -> f32 {
    (i.reverse_bits() >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Point `i` of the `n`-point Hammersley set (i/n, radical inverse), as the authors use (method
/// §3.1).
#[must_use]
pub fn hammersley(i: u32, n: u32) -> [f32; 2] {
    [i as f32 / n as f32, radical_inverse_base2(i)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every elementary interval of a (0, m, 2)-net in base 2 holds one point, scrambled or not.
    #[test]
    fn byte_tables_equal_the_sum_of_columns() {
        for index in [0, 1, 2, 0x80, 0x1234_5678, 0xdead_beef, u32::MAX] {
            for (dimension, columns) in DIRECTIONS.iter().enumerate() {
                let sum = (0..32)
                    .filter(|b| index >> b & 1 == 1)
                    .fold(0, |x, b| x ^ columns[b]);
                assert_eq!(sobol(index, dimension), sum);
            }
        }
    }

    #[test]
    fn first_two_dimensions_are_a_net() {
        for key in 0..8 {
            let s = SobolSequence::new(3, key);
            let m = 8u32;
            let points: Vec<[f32; 2]> = (0..1 << m).map(|i| s.point2(i)).collect();
            for a in 0..=m {
                let (nx, ny) = (1usize << a, 1usize << (m - a));
                let mut seen = vec![false; nx * ny];
                for p in &points {
                    let cell = (p[1] * ny as f32) as usize * nx + (p[0] * nx as f32) as usize;
                    assert!(
                        !std::mem::replace(&mut seen[cell], true),
                        "interval {nx}×{ny} hit twice, key {key}"
                    );
                }
            }
        }
    }

    #[test]
    fn blocks_are_nets_whose_halves_are_nets() {
        for key in 0..8 {
            let s = SobolSequence::new(5, key);
            for (begin, end) in [(0u32, 64u32), (0, 32), (32, 64), (64, 128)] {
                let block = SobolBlock::new(begin, end);
                let n = block.len();
                let [mut x, mut y] = [vec![0.0; n], vec![0.0; n]];
                block.fill(&s, 0, &mut x);
                block.fill(&s, 1, &mut y);
                let m = n.trailing_zeros();
                let mut points: Vec<[f32; 2]> = x.iter().zip(&y).map(|(x, y)| [*x, *y]).collect();
                let mut shuffled: Vec<[f32; 2]> = (begin..end).map(|i| s.point2(i)).collect();
                for list in [&mut points, &mut shuffled] {
                    list.sort_by(|a, b| a[0].total_cmp(&b[0]));
                }
                assert_eq!(points, shuffled, "the same points, {begin}..{end}");
                for a in 0..=m {
                    let (nx, ny) = (1usize << a, n >> a);
                    let mut seen = vec![false; n];
                    for k in 0..n {
                        let cell = (y[k] * ny as f32) as usize * nx + (x[k] * nx as f32) as usize;
                        assert!(
                            !std::mem::replace(&mut seen[cell], true),
                            "{begin}..{end}, interval {nx}×{ny} hit twice, key {key}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn all_four_dimensions_are_stratified_and_uncorrelated_between_keys() {
        let n = 1024;
        for key in 0..4 {
            let s = SobolSequence::new(1, key);
            for d in 0..4 {
                let mut seen = vec![false; n];
                for i in 0..n as u32 {
                    let c = (s.point4(i)[d] * n as f32) as usize;
                    assert!(!std::mem::replace(&mut seen[c], true), "dimension {d}");
                }
            }
        }
        let (a, b) = (SobolSequence::new(1, 1), SobolSequence::new(1, 2));
        let r: f64 = (0..4096)
            .map(|i| f64::from((a.point2(i)[0] - 0.5) * (b.point2(i)[0] - 0.5)))
            .sum::<f64>()
            / 4096.0
            * 12.0;
        assert!(r.abs() < 0.1, "correlation {r}");
    }
}
