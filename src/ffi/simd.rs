//! Run-time dispatch to wider vector instructions.

/// Runs `f` compiled for AVX2 where the processor has it, for the baseline elsewhere. Only code inlined into `f` profits: mark
/// kernels `#[inline(always)]`. Without explicit fused operations the bits are the same either way.
#[inline]
pub fn with_widest<R>(f: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: `avx2` needs exactly the feature tested on the line above.
        return unsafe { avx2(f) };
    }
    f()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<R>(f: impl FnOnce() -> R) -> R {
    f()
}
