//! `unbake bench kernel`: evaluations per second of the GGX kernel beside the scalar reference and
//! what the machine can do.
//!
//! The limits are measured in the same run with the same instruction set: multiplications and
//! additions on registers, divisions on registers, and memory traffic of seven streams. An
//! evaluation (value and derivative) takes [`OPERATIONS`] simple operations and [`DIVISIONS`]
//! divisions and, beyond the caches, [`BYTES`] bytes; the limit is the slower of the two units,
//! which can overlap.

use super::interleaved;
use crate::core::brdf::{SpecularChunk, specular_chunk, specular_d_roughness};
use crate::core::sampling::KeyedRng;
use crate::ffi::simd::with_widest;
use crate::programs::report::{Machine, Versions, machine};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::hint::black_box;

/// Multiplications, additions and integer operations of one evaluation in the kernel's source.
pub const OPERATIONS: f64 = 56.0;
/// Divisions of one evaluation.
pub const DIVISIONS: f64 = 4.0;
/// Bytes moved per evaluation beyond the caches: five numbers read, two written, and two fetched
/// before they are overwritten.
pub const BYTES: f64 = 36.0;

/// Evaluations per slice that stay in the second-level cache.
const CACHED: usize = 8192;
/// Evaluations per thread that do not fit into any cache.
const STREAMED: usize = 1 << 21;
/// Independent chains of the throughput loops: enough registers to hide latency.
const LANES: usize = 96;

/// What `unbake bench kernel` can be told.
#[derive(clap::Args, Clone, Debug)]
pub struct KernelBench {
    /// Rounds of each loop; medians are reported.
    #[arg(long, value_name = "N", default_value_t = 9)]
    pub rounds: usize,
}

/// Rates with one number of threads.
#[derive(Clone, Debug, Serialize)]
pub struct KernelRates {
    /// Threads.
    pub threads: usize,
    /// Kernel, data in cache: evaluations per second.
    pub cached_per_second: f64,
    /// Kernel, data in memory: evaluations per second.
    pub streamed_per_second: f64,
    /// Scalar f32 reference, data in cache: evaluations per second.
    pub scalar_per_second: f64,
    /// Kernel over scalar reference, in cache.
    pub over_scalar: f64,
    /// Multiplications and additions per second on registers.
    pub operations_per_second: f64,
    /// Divisions per second on registers.
    pub divisions_per_second: f64,
    /// Bytes per second of a copying loop over as many streams.
    pub bytes_per_second: f64,
    /// Evaluations per second that the arithmetic units allow.
    pub arithmetic_limit: f64,
    /// Evaluations per second that memory allows.
    pub memory_limit: f64,
    /// Cached rate as a share of the arithmetic limit.
    pub share_of_arithmetic: f64,
    /// Streamed rate as a share of the lower of both limits.
    pub share_of_streamed_limit: f64,
}

/// Everything `unbake bench kernel` measures.
#[derive(Clone, Debug, Serialize)]
pub struct KernelReport {
    /// On one thread and on all.
    pub rates: Vec<KernelRates>,
    /// Instruction set the kernel ran with.
    pub instructions: String,
    /// Operations counted per evaluation.
    pub operations: f64,
    /// Divisions counted per evaluation.
    pub divisions: f64,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
}

/// Inputs and outputs of one thread.
struct Buffers {
    input: [Vec<f32>; 5],
    value: Vec<f32>,
    slope: Vec<f32>,
}

impl Buffers {
    fn new(n: usize, key: u64) -> Self {
        let mut rng = KeyedRng::new(5, key);
        let input = std::array::from_fn(|_| (0..n).map(|_| 0.01 + 0.98 * rng.next_f32()).collect());
        Self {
            input,
            value: vec![0.0; n],
            slope: vec![0.0; n],
        }
    }

    fn kernel(&mut self) {
        let [n_l, n_v, sin2_nh, v_h, roughness] = &self.input;
        specular_chunk(
            SpecularChunk {
                n_l,
                n_v,
                sin2_nh,
                v_h,
                roughness,
            },
            &mut self.value,
            &mut self.slope,
        );
        black_box(&mut self.value);
    }

    fn scalar(&mut self) {
        let [a, b, c, d, r] = &self.input;
        for i in 0..self.value.len() {
            (self.value[i], self.slope[i]) = specular_d_roughness(a[i], b[i], c[i], d[i], r[i]);
        }
        black_box(&mut self.value);
    }

    /// The kernel's traffic without its arithmetic.
    fn copy(&mut self) {
        let n = self.value.len();
        let [a, b, c, d, r] = self.input.each_ref().map(|v| &v[..n]);
        let (value, slope) = (&mut self.value[..n], &mut self.slope[..n]);
        with_widest(
            #[inline(always)]
            || {
                for i in 0..n {
                    value[i] = a[i] + b[i] + c[i];
                    slope[i] = d[i] + r[i];
                }
            },
        );
        black_box(&mut self.value);
    }
}

/// `rounds` of a multiplication and an addition on every lane.
fn multiply_add(rounds: usize) {
    let (a, b) = (black_box(0.999_9f32), black_box(1e-4f32));
    black_box(with_widest(
        #[inline(always)]
        || {
            // inside the closure, so that the lanes live in registers
            let mut x = [0.5f32; LANES];
            for _ in 0..rounds {
                for v in &mut x {
                    *v = *v * a + b;
                }
            }
            x
        },
    ));
}

/// `rounds` of a division on every lane.
fn divide(rounds: usize) {
    let a = black_box(1.1f32);
    black_box(with_widest(
        #[inline(always)]
        || {
            let mut x = [1.0f32; LANES];
            for _ in 0..rounds {
                for v in &mut x {
                    *v = a / *v;
                }
            }
            x
        },
    ));
}

/// Runs the benchmark on one thread and on all threads of the pool.
///
/// # Errors
/// Threads that cannot be started.
pub fn bench_kernel(bench: &KernelBench) -> crate::Result<KernelReport> {
    let all = rayon::current_num_threads();
    let mut rates = vec![measure(1, bench.rounds)?];
    if all > 1 {
        rates.push(measure(all, bench.rounds)?);
    }
    Ok(KernelReport {
        rates,
        instructions: instructions().to_owned(),
        operations: OPERATIONS,
        divisions: DIVISIONS,
        versions: Versions::current(),
        machine: machine(),
    })
}

fn instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") {
        return "AVX2";
    }
    "baseline"
}

fn measure(threads: usize, rounds: usize) -> crate::Result<KernelRates> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| crate::Error::Failed(format!("cannot start {threads} threads: {e}")))?;
    let make = |n| {
        (0..threads)
            .map(|k| Buffers::new(n, k as u64))
            .collect::<Vec<_>>()
    };
    let (mut small, mut scalar, mut large, mut copied) =
        (make(CACHED), make(CACHED), make(STREAMED), make(STREAMED));
    const REPEAT: usize = 64;
    const STEPS: usize = 40_000;
    let each = |buffers: &mut Vec<Buffers>, times: usize, f: fn(&mut Buffers)| {
        pool.install(|| {
            buffers
                .par_iter_mut()
                .for_each(|b| (0..times).for_each(|_| f(b)))
        });
    };
    let registers =
        |f: fn(usize)| pool.install(|| (0..threads).into_par_iter().for_each(|_| f(STEPS)));
    let mut tasks: Vec<Box<dyn FnMut()>> = vec![
        Box::new(|| each(&mut small, REPEAT, Buffers::kernel)),
        Box::new(|| each(&mut scalar, REPEAT / 8, Buffers::scalar)),
        Box::new(|| each(&mut large, 1, Buffers::kernel)),
        Box::new(|| each(&mut copied, 1, Buffers::copy)),
        Box::new(|| registers(multiply_add)),
        Box::new(|| registers(divide)),
    ];
    let seconds = interleaved(rounds, &mut tasks);
    let rate = |count: usize, s: f64| (threads * count) as f64 / s;
    let cached = rate(CACHED * REPEAT, seconds[0]);
    let scalar = rate(CACHED * (REPEAT / 8), seconds[1]);
    let streamed = rate(STREAMED, seconds[2]);
    let bytes = rate(STREAMED, seconds[3]) * BYTES;
    let operations = rate(2 * LANES * STEPS, seconds[4]);
    let divisions = rate(LANES * STEPS, seconds[5]);
    // divider and multiplier are different units and overlap
    let arithmetic_limit = (operations / OPERATIONS).min(divisions / DIVISIONS);
    let memory_limit = bytes / BYTES;
    Ok(KernelRates {
        threads,
        cached_per_second: cached,
        streamed_per_second: streamed,
        scalar_per_second: scalar,
        over_scalar: cached / scalar,
        operations_per_second: operations,
        divisions_per_second: divisions,
        bytes_per_second: bytes,
        arithmetic_limit,
        memory_limit,
        share_of_arithmetic: cached / arithmetic_limit,
        share_of_streamed_limit: streamed / arithmetic_limit.min(memory_limit),
    })
}

impl KernelReport {
    /// The table of the terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!(
            "GGX value and derivative in R, f32, {}; {} simple operations and {} divisions each; {}\n",
            self.instructions, self.operations, self.divisions, self.machine.cpu
        );
        for r in &self.rates {
            // writing to a string cannot fail
            let _ = writeln!(
                out,
                "{} thread{}:\n  kernel, in cache   {:>8.1} M/s   {:.1} times the scalar reference ({:.1} M/s), {:.0} % of the arithmetic limit\n  \
                 kernel, in memory  {:>8.1} M/s   {:.0} % of the lower limit\n  \
                 limits: {:.1} M/s by arithmetic ({:.1} G operations/s, {:.2} G divisions/s), {:.1} M/s by memory ({:.1} GB/s)",
                r.threads,
                if r.threads == 1 { "" } else { "s" },
                r.cached_per_second * 1e-6,
                r.over_scalar,
                r.scalar_per_second * 1e-6,
                100.0 * r.share_of_arithmetic,
                r.streamed_per_second * 1e-6,
                100.0 * r.share_of_streamed_limit,
                r.arithmetic_limit * 1e-6,
                r.operations_per_second * 1e-9,
                r.divisions_per_second * 1e-9,
                r.memory_limit * 1e-6,
                r.bytes_per_second * 1e-9
            );
        }
        out
    }
}
