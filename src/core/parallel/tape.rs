//! The tape of a run on one thread: every stretch of serial work and every piece of every parallel
//! loop, in order, with the processor time each took.
//!
//! A run is recorded by the thread that calls [`start`], which must be the only one that works
//! (`unbake solve --threads 1 --tape FILE`). Other threads, and every run without a tape, pass the
//! marks by: `fork` answers `false`.

use crate::ffi::clock::thread_nanoseconds;
use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};

/// Pieces that a recorded loop is divided into, where it has as many elements. Derived: at 128
/// threads, eight pieces each, so that the last to end leaves an eighth of a share idle at most.
pub const PIECES: usize = 1024;

/// A mark on the tape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mark {
    /// Work of so many seconds, without a loop.
    Work(f32),
    /// A parallel loop begins.
    Fork,
    /// A piece of the innermost loop begins.
    Piece,
    /// The innermost loop ends.
    Join,
    /// The stage of this number begins; the one before ends.
    Stage(u32),
}

/// A recorded run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tape {
    /// Names of the stages that the marks number.
    pub stages: Vec<String>,
    /// The marks in order.
    pub marks: Vec<Mark>,
}

/// A tape that runs.
struct Running {
    tape: Tape,
    /// Clock at the end of the last mark, nanoseconds.
    last: u64,
    /// What reading the clock costs, nanoseconds.
    reading: u64,
    /// Whether a piece of each open loop has begun.
    open: Vec<bool>,
}

static RECORDING: AtomicBool = AtomicBool::new(false);

thread_local! {
    static RUNNING: RefCell<Option<Running>> = const { RefCell::new(None) };
}

impl Running {
    /// Puts down the work since the last mark, then the mark.
    fn mark(&mut self, mark: Mark) {
        let worked = thread_nanoseconds().saturating_sub(self.last + self.reading);
        if worked > 0 {
            self.tape.marks.push(Mark::Work(worked as f32 * 1e-9));
        }
        self.tape.marks.push(mark);
        self.last = thread_nanoseconds();
    }
}

fn with<T: Default>(f: impl FnOnce(&mut Running) -> T) -> T {
    RUNNING.with_borrow_mut(|r| r.as_mut().map(f).unwrap_or_default())
}

/// Begins a tape on this thread.
pub fn start() {
    let mut readings: Vec<u64> = (0..101)
        .map(|_| {
            let before = thread_nanoseconds();
            thread_nanoseconds() - before
        })
        .collect();
    readings.sort_unstable();
    RUNNING.set(Some(Running {
        tape: Tape::default(),
        last: thread_nanoseconds(),
        reading: readings[50],
        open: Vec::new(),
    }));
    RECORDING.store(true, Ordering::Relaxed);
}

/// Ends the tape of this thread and returns it; `None` if there was none.
pub fn finish() -> Option<Tape> {
    RECORDING.store(false, Ordering::Relaxed);
    let mut running = RUNNING.take()?;
    running.mark(Mark::Stage(u32::MAX));
    running.tape.marks.pop();
    Some(running.tape)
}

/// A stage begins.
pub fn stage(name: &str) {
    if !RECORDING.load(Ordering::Relaxed) {
        return;
    }
    with(|r| {
        let known = r.tape.stages.iter().position(|s| s == name);
        let number = known.unwrap_or(r.tape.stages.len());
        if known.is_none() {
            r.tape.stages.push(name.to_owned());
        }
        r.mark(Mark::Stage(number as u32));
    });
}

/// A loop begins; whether its pieces and its end are to be marked. A loop that begins before the
/// one around it has begun a piece runs in step with it (`zip`) and is not marked.
pub(super) fn fork() -> bool {
    RECORDING.load(Ordering::Relaxed)
        && with(|r| {
            let own = r.open.last().is_none_or(|begun| *begun);
            if own {
                r.open.push(false);
                r.mark(Mark::Fork);
            }
            own
        })
}

/// A piece of the innermost loop begins.
pub(super) fn piece() {
    with(|r| {
        if let Some(begun) = r.open.last_mut() {
            *begun = true;
        }
        r.mark(Mark::Piece);
    });
}

/// The innermost loop ends.
pub(super) fn join() {
    with(|r| {
        r.open.pop();
        r.mark(Mark::Join);
    });
}

impl Tape {
    /// The tape as bytes: the names as a line of JSON, then eight bytes a mark.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = serde_json::to_vec(&self.stages).unwrap_or_default();
        out.push(b'\n');
        for mark in &self.marks {
            let (kind, value) = match *mark {
                Mark::Work(seconds) => (0u32, seconds.to_bits()),
                Mark::Fork => (1, 0),
                Mark::Piece => (2, 0),
                Mark::Join => (3, 0),
                Mark::Stage(number) => (4, number),
            };
            out.extend(kind.to_le_bytes());
            out.extend(value.to_le_bytes());
        }
        out
    }

    /// Reads [`Tape::to_bytes`]; `None` if the bytes are something else.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let line = bytes.iter().position(|b| *b == b'\n')?;
        let stages: Vec<String> = serde_json::from_slice(&bytes[..line]).ok()?;
        let (marks, rest) = bytes[line + 1..].as_chunks::<8>();
        let mark = |b: &[u8; 8]| {
            let value = u32::from_le_bytes([b[4], b[5], b[6], b[7]]);
            Some(match b[0] {
                0 => Mark::Work(f32::from_bits(value)),
                1 => Mark::Fork,
                2 => Mark::Piece,
                3 => Mark::Join,
                4 if (value as usize) < stages.len() => Mark::Stage(value),
                _ => return None,
            })
        };
        let marks = marks.iter().map(mark).collect::<Option<Vec<_>>>()?;
        rest.is_empty().then_some(Self { stages, marks })
    }
}

#[cfg(test)]
mod tests {
    use super::super::prelude::*;
    use super::*;

    fn recorded(f: impl FnOnce() + Send) -> Tape {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
        pool.build().expect("pool").install(|| {
            start();
            f();
            finish().expect("a tape")
        })
    }

    fn count(tape: &Tape, of: Mark) -> usize {
        tape.marks.iter().filter(|m| **m == of).count()
    }

    fn spin(n: usize) -> f64 {
        (0..n).fold(1.0, |x: f64, _| std::hint::black_box(x.sin() + 1.0))
    }

    /// One test for all: the switch is of the whole process, and tests run beside one another.
    #[test]
    fn loops_zipped_loops_and_loops_within_pieces_are_marked_once() {
        let tape = recorded(|| {
            stage("one");
            let a: Vec<f64> = (0..8usize).into_par_iter().map(|_| spin(20_000)).collect();
            stage("two");
            let b: Vec<f64> = a.par_iter().zip(a.par_iter()).map(|(x, y)| x + y).collect();
            stage("one");
            (0..2usize).into_par_iter().with_max_len(1).for_each(|_| {
                std::hint::black_box((0..4usize).into_par_iter().map(spin).sum::<f64>());
            });
            std::hint::black_box(b);
            super::super::join(|| spin(10), || spin(10));
        });
        assert_eq!(tape.stages, ["one", "two"]);
        assert_eq!(count(&tape, Mark::Stage(0)), 2);
        // the plain one, the zipped one, the outer one, two within it, the join
        assert_eq!(count(&tape, Mark::Fork), 6);
        assert_eq!(count(&tape, Mark::Join), 6);
        assert_eq!(count(&tape, Mark::Piece), 8 + 8 + 2 + 2 * 4 + 2);
        let first = tape.marks.iter().position(|m| *m == Mark::Stage(1));
        let of_one: f32 = tape.marks[..first.expect("stage two")]
            .iter()
            .map(|m| if let Mark::Work(s) = m { *s } else { 0.0 })
            .sum();
        assert!(of_one > 1e-4, "160,000 sines take more than {of_one} s");
        assert_eq!(Tape::from_bytes(&tape.to_bytes()), Some(tape.clone()));
        let mut cut = tape.to_bytes();
        cut.pop();
        assert_eq!(Tape::from_bytes(&cut), None);
        // without a tape nothing is marked
        assert!(!fork());
    }
}
