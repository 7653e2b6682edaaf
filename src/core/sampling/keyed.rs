//! A small generator whose state is a hash of what is computed.

/// Mixes two 64-bit words (SplitMix64 finaliser; Steele et al. 2014).
#[must_use]
pub fn hash_u64(a: u64, b: u64) -> u64 {
    let mut z = a
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(b)
        .wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// PCG32 (O'Neill 2014) seeded in state and stream from a key.
#[derive(Clone, Debug)]
pub struct KeyedRng {
    state: u64,
    stream: u64,
}

impl KeyedRng {
    /// A generator for `(seed, key)`; equal arguments give equal numbers.
    #[must_use]
    pub fn new(seed: u64, key: u64) -> Self {
        let h = hash_u64(seed, key);
        Self {
            state: hash_u64(h, 1),
            stream: hash_u64(h, 2) | 1,
        }
    }

    /// The next 32 random bits.
    pub fn next_u32(&mut self) -> u32 {
        let old = self.state;
        self.state = old
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(self.stream);
        let xorshifted = (((old >> 18) ^ old) >> 27) as u32;
        xorshifted.rotate_right((old >> 59) as u32)
    }

    /// Uniform in [0, 1).
    pub fn next_f32(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform integer in `0..n`; 0 when `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((u64::from(self.next_u32()) * n as u64) >> 32) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_decide_the_numbers() {
        let draw = |s, k| {
            (0..4)
                .map({
                    let mut r = KeyedRng::new(s, k);
                    move |_| r.next_u32()
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }

    #[test]
    fn uniform_in_range_with_the_right_mean() {
        let mut r = KeyedRng::new(7, 7);
        let xs: Vec<f32> = (0..100_000).map(|_| r.next_f32()).collect();
        assert!(xs.iter().all(|x| (0.0..1.0).contains(x)));
        let mean = xs.iter().map(|&x| f64::from(x)).sum::<f64>() / 1e5;
        assert!((mean - 0.5).abs() < 5.0 * (1.0f64 / 12.0 / 1e5).sqrt());
        assert!((0..1000).all(|_| r.below(7) < 7));
    }
}
