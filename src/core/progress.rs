//! Progress as events: the core says what happens, the command line draws it.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

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
        let out = f(self);
        self.observer.stage_finished();
        out
    }

    /// Counts `n` more finished steps of the current stage; callable from any thread.
    pub fn advance(&self, n: u64) {
        let done = self.done.fetch_add(n, Ordering::Relaxed) + n;
        self.observer.stage_advanced(done);
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
