//! Run-time dispatch to wider vector instructions, and hints to the cache.

/// Runs `f` compiled for AVX2 with fused multiply-add where the processor has them, for the baseline elsewhere. Only code inlined into
/// `f` profits: mark kernels `#[inline(always)]`. The bits are the same either way; `mul_add` is a slow library call on the baseline.
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

/// A computation too long for [`with_widest`]: the compiler would leave a long closure outside, compiled for the baseline. Mark
/// [`Self::run`] `#[inline(always)]`.
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

/// Asks the cache for `slice[index]`, which will be read soon; nothing happens if there is no such element.
#[inline(always)]
pub fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let address = slice.as_ptr().wrapping_add(index).cast::<i8>();
        // SAFETY: a prefetch reads nothing the program can see and never faults, whatever the address; SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, index);
}
