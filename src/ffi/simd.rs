//! Run-time dispatch to wider vector instructions, and hints to the cache.

/// Numbers of 32 bits that the widest vector register in use holds. Derived: 256 bits.
pub const LANES: usize = 256 / 32;

/// Runs `f` compiled for AVX2 with fused multiply-add where the processor has them, for the
/// baseline elsewhere. Only code inlined into `f` profits: mark kernels `#[inline(always)]`. The
/// bits are the same either way; `mul_add` is a slow library call on the baseline.
#[inline]
pub fn with_widest<R>(f: impl FnOnce() -> R) -> R {
    run_widest(Closure(f))
}

struct Closure<F>(F);

impl<R, F: FnOnce() -> R> Kernel for Closure<F> {
    type Output = R;

    #[inline(always)]
    fn run(self) -> R {
        self.0()
    }
}

/// A computation too long for [`with_widest`]: the compiler would leave a long closure outside,
/// compiled for the baseline. Mark [`Self::run`] `#[inline(always)]`.
pub trait Kernel {
    /// What it computes.
    type Output;
    /// Computes it.
    fn run(self) -> Self::Output;
}

/// [`with_widest`] for a [`Kernel`].
#[inline]
pub fn run_widest<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: `avx2` needs exactly the features tested on the line above.
        return unsafe { avx2(kernel) };
    }
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

/// Asks the cache for `slice[index]`, which will be read soon; nothing happens if there is no such
/// element.
#[inline(always)]
pub fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let address = slice.as_ptr().wrapping_add(index).cast::<i8>();
        // SAFETY: a prefetch reads nothing the program can see and never faults, whatever the
        // address; SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, index);
}

/// The whole part of `x` within [0, last]; 0 for what is not a number. `last` is below 2³¹. Unlike
/// `as`, it takes one instruction.
#[inline(always)]
#[must_use]
pub fn floor_to_index(x: f32, last: f32) -> u32 {
    let x = x.max(0.0).min(last.min(2_147_483_520.0));
    // SAFETY: `max` and `min` give a number from 0 to the largest float below 2³¹, whatever `x` is;
    // if `last` is not a number `min` ignores it.
    unsafe { x.to_int_unchecked::<i32>() as u32 }
}

/// Rows become columns, in registers.
#[inline(always)]
#[must_use]
pub fn transpose4(rows: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{
            __m128, _mm_movehl_ps, _mm_movelh_ps, _mm_unpackhi_ps, _mm_unpacklo_ps,
        };
        let vector = |row: [f32; 4]| -> __m128 { bytemuck::cast(row) };
        let [a, b, c, d] = rows.map(vector);
        // SAFETY: SSE is part of x86-64.
        let columns = unsafe {
            let (ab_low, cd_low) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
            [
                _mm_movelh_ps(ab_low, cd_low),
                _mm_movehl_ps(cd_low, ab_low),
                _mm_movelh_ps(ab_high, cd_high),
                _mm_movehl_ps(cd_high, ab_high),
            ]
        };
        columns.map(bytemuck::cast)
    }
    #[cfg(not(target_arch = "x86_64"))]
    std::array::from_fn(|c| rows.map(|row| row[c]))
}

#[cfg(test)]
mod tests {
    use super::{floor_to_index, transpose4};

    #[test]
    fn whole_parts_stay_within_their_range() {
        let of = |x| floor_to_index(x, 7.0);
        assert_eq!(
            [-1.0, 0.0, 0.99, 3.0, 6.999, 7.5, 1e30].map(of),
            [0, 0, 0, 3, 6, 7, 7]
        );
        assert_eq!(
            [f32::NAN, f32::NEG_INFINITY, f32::INFINITY].map(of),
            [0, 0, 7]
        );
        assert_eq!(floor_to_index(f32::INFINITY, f32::INFINITY), 2_147_483_520);
    }

    #[test]
    fn rows_become_columns() {
        let rows: [[f32; 4]; 4] =
            std::array::from_fn(|r| std::array::from_fn(|c| (10 * r + c) as f32));
        let columns = transpose4(rows);
        assert!((0..16).all(|i| columns[i / 4][i % 4] == rows[i % 4][i / 4]));
    }
}
