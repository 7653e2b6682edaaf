//! The processor time of one thread: what a piece of work costs, however busy the machine is.

use std::ffi::{c_int, c_long};

/// `CLOCK_THREAD_CPUTIME_ID` of Linux (`include/uapi/linux/time.h`).
const THREAD_CPU_TIME: c_int = 3;

#[repr(C)]
#[derive(Default)]
struct Timespec {
    seconds: i64,
    nanoseconds: c_long,
}

unsafe extern "C" {
    fn clock_gettime(clock: c_int, time: *mut Timespec) -> c_int;
}

/// Nanoseconds that the calling thread has run so far, user and system; 0 where the kernel does
/// not tell.
#[must_use]
pub fn thread_nanoseconds() -> u64 {
    let mut time = Timespec::default();
    // SAFETY: the pointer is to a live structure of the layout that 64-bit Linux documents
    // (clock_gettime(2)); the call writes to it and keeps nothing.
    let failed = unsafe { clock_gettime(THREAD_CPU_TIME, &raw mut time) } != 0;
    if failed {
        return 0;
    }
    time.seconds as u64 * 1_000_000_000 + time.nanoseconds as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_sleeps_spends_nothing_and_one_that_works_does() {
        let before = thread_nanoseconds();
        std::thread::sleep(std::time::Duration::from_millis(30));
        let slept = thread_nanoseconds();
        let mut x = 1.0f64;
        for _ in 0..2_000_000 {
            x = std::hint::black_box((x * 1.000_001).sin() + 1.0);
        }
        let worked = thread_nanoseconds();
        assert!(x.is_finite());
        assert!(slept - before < 20_000_000, "{} ns asleep", slept - before);
        assert!(worked - slept > 1_000_000, "{} ns of work", worked - slept);
    }
}
