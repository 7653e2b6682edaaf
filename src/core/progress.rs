//! Progress as events: the core says what happens, the command line draws it.

use super::blocks::{Columns, Division, Packed, Transport, Work};
use super::parallel;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A choice that the program made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Decision {
    /// What there was to choose.
    pub what: String,
    /// What was chosen.
    pub decided: String,
    /// The evidence, or the option that forced it.
    pub why: String,
    /// Whether an option forced it.
    pub forced: bool,
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} ({}{})",
            self.what,
            self.decided,
            if self.forced { "forced: " } else { "" },
            self.why
        )
    }
}

/// Receives what a long computation reports. Implementations must be cheap and thread-safe.
pub trait Observer: Send + Sync {
    /// A stage of `steps` steps begins.
    fn stage_started(&self, name: &str, steps: u64);
    /// `done` steps of the current stage are finished.
    fn stage_advanced(&self, done: u64);
    /// The current stage ended.
    fn stage_finished(&self);
    /// A sentence the user should read: something found, or a warning.
    fn note(&self, message: &str);
    /// A choice and its reason.
    fn decided(&self, decision: &Decision) {
        self.note(&decision.to_string());
    }
    /// Whether the work is to stop; asked at the beginning of stages and at every advance. Only for
    /// work under [`stoppable`].
    fn stopped(&self) -> bool {
        false
    }
}

/// Passes every event on to several observers; any of them may stop the work.
pub struct Tee(pub Vec<Arc<dyn Observer>>);

impl Observer for Tee {
    fn stage_started(&self, name: &str, steps: u64) {
        self.0.iter().for_each(|o| o.stage_started(name, steps));
    }
    fn stage_advanced(&self, done: u64) {
        self.0.iter().for_each(|o| o.stage_advanced(done));
    }
    fn stage_finished(&self) {
        self.0.iter().for_each(|o| o.stage_finished());
    }
    fn note(&self, message: &str) {
        self.0.iter().for_each(|o| o.note(message));
    }
    fn decided(&self, decision: &Decision) {
        self.0.iter().for_each(|o| o.decided(decision));
    }
    fn stopped(&self) -> bool {
        self.0.iter().any(|o| o.stopped())
    }
}

/// What work unwinds with that its observer stopped: a payload of its own, so that it is told from
/// a defect. Unwinding leaves every loop and thread of a computation, most of which cannot fail,
/// and drops what it holds: files in the making, locks.
struct Stop;

/// Runs `work`, which its observer may stop.
///
/// # Errors
/// Those of `work`, and [`Error::Stopped`].
pub fn stoppable<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(result) => result,
        Err(payload) if payload.is::<Stop>() => Err(Error::Stopped),
        Err(defect) => resume_unwind(defect),
    }
}

/// A handle on an observer, passed down to everything that takes long.
#[derive(Clone)]
pub struct Progress {
    observer: Arc<dyn Observer>,
    done: Arc<AtomicU64>,
    /// Other processes that share the work.
    others: Option<Arc<dyn Transport>>,
}

struct Silent;
impl Observer for Silent {
    fn stage_started(&self, _: &str, _: u64) {}
    fn stage_advanced(&self, _: u64) {}
    fn stage_finished(&self) {}
    fn note(&self, _: &str) {}
}

impl Progress {
    /// Reports to `observer`.
    #[must_use]
    pub fn new(observer: Arc<dyn Observer>) -> Self {
        Self {
            observer,
            done: Arc::default(),
            others: None,
        }
    }

    /// The same, the work being shared with other processes.
    #[must_use]
    pub fn shared(&self, others: Arc<dyn Transport>) -> Self {
        Self {
            others: Some(others),
            ..self.clone()
        }
    }

    /// Reports to nobody.
    #[must_use]
    pub fn silent() -> Self {
        Self::new(Arc::new(Silent))
    }

    /// Runs `f` as a named stage of `steps` steps.
    pub fn stage<T>(&self, name: &str, steps: u64, f: impl FnOnce(&Self) -> T) -> T {
        self.done.store(0, Ordering::Relaxed);
        self.observer.stage_started(name, steps);
        self.leave_if_stopped();
        if let Some(others) = &self.others {
            others.enter(name);
        }
        let out = f(self);
        self.observer.stage_finished();
        out
    }

    /// Counts `n` more finished steps of the current stage; callable from any thread.
    pub fn advance(&self, n: u64) {
        let done = self.done.fetch_add(n, Ordering::Relaxed) + n;
        self.observer.stage_advanced(done);
        self.leave_if_stopped();
    }

    fn leave_if_stopped(&self) {
        if self.observer.stopped() {
            resume_unwind(Box::new(Stop));
        }
    }

    /// The results of `compute` for consecutive runs that cover `0..len`, in order. Alone, it is one
    /// run; processes that share the work divide it into blocks of `unit` elements or more. `compute`
    /// must give for two runs what it gives for both as one, and advances the stage by an element of
    /// its range at a time.
    pub fn share<T: Packed>(
        &self,
        len: usize,
        unit: usize,
        compute: impl Fn(Range<usize>) -> T + Sync,
    ) -> Vec<T> {
        let division = Division::new(len, unit);
        let Some(others) = self.others.as_ref().filter(|_| division.count() > 1) else {
            return vec![compute(0..len)];
        };
        let own: Vec<AtomicBool> = (0..division.count())
            .map(|_| AtomicBool::new(false))
            .collect();
        let results = others.results(&Work {
            count: division.count(),
            compute: &|block| {
                own[block].store(true, Ordering::Relaxed);
                compute(division.range(block)).columns()
            },
            note: &|said| self.note(said),
        });
        let result = |(block, columns): (usize, Columns)| {
            let range = division.range(block);
            if !own[block].load(Ordering::Relaxed) {
                self.advance(range.len() as u64);
            }
            T::restored(&columns).unwrap_or_else(|| compute(range))
        };
        results.into_iter().enumerate().map(result).collect()
    }

    /// The results of `compute` for chunks that cover `0..len`, in order, by all threads and, in
    /// blocks of `block` chunks or more, by all processes that share the work.
    pub fn map_chunks<T: Packed + Send>(
        &self,
        len: usize,
        chunk: usize,
        block: usize,
        compute: impl Fn(Range<usize>) -> T + Sync + Send,
    ) -> Vec<T> {
        let run = |run: Range<usize>| {
            parallel::map_chunks(run.len(), chunk, |r| {
                compute(run.start + r.start..run.start + r.end)
            })
        };
        let runs = self.share(len, chunk.saturating_mul(block), run);
        runs.into_iter().flatten().collect()
    }

    /// Something the user should know, or a warning.
    pub fn note(&self, message: impl AsRef<str>) {
        self.observer.note(message.as_ref());
    }

    /// A choice and its reason.
    pub fn decide(
        &self,
        what: &str,
        decided: impl Into<String>,
        why: impl Into<String>,
        forced: bool,
    ) {
        self.observer.decided(&Decision {
            what: what.to_owned(),
            decided: decided.into(),
            why: why.into(),
            forced,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parallel::prelude::*;

    /// Stops the work after so many steps.
    struct Patience(u64, AtomicU64);
    impl Observer for Patience {
        fn stage_started(&self, _: &str, _: u64) {}
        fn stage_advanced(&self, done: u64) {
            self.1.fetch_max(done, Ordering::Relaxed);
        }
        fn stage_finished(&self) {}
        fn note(&self, _: &str) {}
        fn stopped(&self) -> bool {
            self.1.load(Ordering::Relaxed) >= self.0
        }
    }

    fn count(patience: u64, steps: u64) -> Result<u64> {
        let observer: Arc<dyn Observer> = Arc::new(Patience(patience, AtomicU64::new(0)));
        let progress = Progress::new(Arc::new(Tee(vec![Arc::new(Silent), observer])));
        stoppable(|| {
            let sum = progress.stage("counting", steps, |p| {
                let step = |_| {
                    p.advance(1);
                    1
                };
                (0..steps as usize).into_par_iter().map(step).sum::<u64>()
            });
            Ok(sum)
        })
    }

    #[test]
    fn an_observer_stops_the_work_of_all_threads() {
        assert_eq!(count(u64::MAX, 10_000).expect("nobody stops it"), 10_000);
        assert!(matches!(count(50, 10_000), Err(Error::Stopped)));
        assert!(matches!(count(0, 10_000), Err(Error::Stopped)));
    }

    #[test]
    fn a_defect_is_no_stop() {
        let caught = catch_unwind(|| stoppable::<()>(|| resume_unwind(Box::new("defect"))));
        assert!(caught.is_err_and(|payload| payload.is::<&str>()));
    }
}
