//! Progress as events: the core says what happens, the command line draws it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Receives what a long computation reports. Implementations must be cheap and thread-safe.
pub trait Observer: Send + Sync {
    /// A stage of `steps` steps begins.
    fn stage_started(&self, name: &str, steps: u64);
    /// `done` steps of the current stage are finished.
    fn stage_advanced(&self, done: u64);
    /// The current stage ended.
    fn stage_finished(&self);
    /// A sentence the user should read: a decision and its reason, or a warning.
    fn note(&self, message: &str);
}

/// A handle on an observer, passed down to everything that takes long.
#[derive(Clone)]
pub struct Progress {
    observer: Arc<dyn Observer>,
    done: Arc<AtomicU64>,
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
        Self { observer, done: Arc::default() }
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
        let out = f(self);
        self.observer.stage_finished();
        out
    }

    /// Counts `n` more finished steps of the current stage; callable from any thread.
    pub fn advance(&self, n: u64) {
        let done = self.done.fetch_add(n, Ordering::Relaxed) + n;
        self.observer.stage_advanced(done);
    }

    /// A decision and its reason, or a warning.
    pub fn note(&self, message: impl AsRef<str>) {
        self.observer.note(message.as_ref());
    }
}
