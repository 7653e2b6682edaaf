//! Measurements one can repeat: how fast the light is computed, what accuracy costs, how we stand
//! beside published times.
//!
//! Every command measures both sides of a comparison in the same process on the same machine,
//! repeats them in turn and reports medians; whatever is computed instead of measured (a long run
//! scaled up from a part of it) says so in its own field. Nothing here is asserted by a test: a
//! test machine is never quiet.

mod alignment;
mod child;
mod damage;
mod fixture;
mod growth;
mod irt;
mod irt_error;
mod irt_nirf;
mod irt_oidn;
mod irt_rates;
mod kernel;
mod light;
mod plot;
mod robustness;
mod scaling;
mod table_page;
mod table_rows;
mod tables;
mod tradeoff;
mod tsdr;

pub use alignment::{AlignmentBench, AlignmentFigures, bench_alignment};
pub use child::{Outcome, Runner, Workplace};
pub use damage::{CONDITIONS, Damage, write_damaged};
pub use fixture::BenchScene;
pub use growth::{Growth, TextureGrowth, ThreadGrowth, TriangleGrowth};
pub use irt::{IrtBench, IrtReport, bench_irt};
pub use irt_error::{ErrorPoint, Reference};
pub use irt_nirf::NirfReport;
pub use irt_oidn::OidnReport;
pub use irt_rates::{BatchRate, EstimatorRate, Rates};
pub use kernel::{KernelBench, KernelRates, KernelReport, bench_kernel};
pub use light::{ClassLevel, LightBench, LightReport, Met, bench_light};
pub use robustness::{RobustnessBench, RobustnessPoint, RobustnessReport, bench_robustness};
pub use scaling::{ScalingBench, bench_scaling};
pub use table_rows::{TableRow, TablesReport};
pub use tables::{TablesBench, bench_tables};
pub use tradeoff::{
    APPROXIMATIONS, Clock, KNOBS, NEEDS, PRESETS, TradePoint, TradeoffBench, TradeoffReport,
    bench_tradeoff,
};
pub use tsdr::{TsdrBench, TsdrReport, bench_tsdr};

use std::time::Instant;

/// Runs `f` and returns its result with the elapsed seconds.
pub(crate) fn timed<T>(f: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let out = f();
    (out, start.elapsed().as_secs_f64())
}

/// Median of a list; the mean of the middle two where their number is even, 0 of nothing.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 {
        0.0
    } else {
        0.5 * (values[(n - 1) / 2] + values[n / 2])
    }
}

/// Runs `tasks` in turn, `repetitions` times, and returns the median seconds of each: what disturbs
/// the machine disturbs all.
pub(crate) fn interleaved(repetitions: usize, tasks: &mut [Box<dyn FnMut() + '_>]) -> Vec<f64> {
    let mut seconds = vec![Vec::with_capacity(repetitions); tasks.len()];
    for _ in 0..repetitions.max(1) {
        for (task, s) in tasks.iter_mut().zip(&mut seconds) {
            s.push(timed(&mut **task).1);
        }
    }
    seconds.iter_mut().map(|s| median(s)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_odd_even_and_no_values() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(median(&mut []), 0.0);
    }

    #[test]
    fn tasks_take_turns() {
        let order = std::cell::RefCell::new(Vec::new());
        let mut tasks: Vec<Box<dyn FnMut()>> = vec![
            Box::new(|| order.borrow_mut().push('a')),
            Box::new(|| order.borrow_mut().push('b')),
        ];
        assert_eq!(interleaved(2, &mut tasks).len(), 2);
        drop(tasks);
        assert_eq!(order.into_inner(), ['a', 'b', 'a', 'b']);
    }
}
