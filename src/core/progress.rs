//! Progress as events: the core says what happens, the command line draws it.

use super::blocks::{Columns, Division, Packed, Transport, Work};
use super::parallel;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;
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
