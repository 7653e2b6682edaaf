//! `--tape FILE`: a run on one thread, recorded piece by piece for `unbake bench scaling`.

use crate::core::formats::{Aside, atomic_write};
use crate::core::parallel::tape;
use crate::core::progress::Observer;
use crate::error::{Error, Result};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Name of what a run does outside of its stages.
const BETWEEN: &str = "between the stages";

/// Marks the run's own stages; stages within stages are theirs.
#[derive(Default)]
pub(super) struct StageMarks {
    depth: AtomicUsize,
}

impl Observer for StageMarks {
    fn stage_started(&self, name: &str, _steps: u64) {
        if self.depth.fetch_add(1, Ordering::Relaxed) == 0 {
            tape::stage(name);
        }
    }
    fn stage_advanced(&self, _done: u64) {}
    fn stage_finished(&self) {
        if self.depth.fetch_sub(1, Ordering::Relaxed) == 1 {
            tape::stage(BETWEEN);
        }
    }
    fn note(&self, _message: &str) {}
}

/// Starts the tape on this thread, which becomes the only one that works.
pub(super) fn start(file: &Path, threads: Option<usize>) -> Result<()> {
    if threads != Some(1) {
        return Err(Error::Usage(
            "--tape records one thread: add `--threads 1`".into(),
        ));
    }
    drop(Aside::new(file)?);
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()
        .map_err(|e| Error::Failed(format!("cannot use this thread alone: {e}")))?;
    tape::start();
    tape::stage(BETWEEN);
    Ok(())
}

/// Writes the tape of a run that did not fail.
pub(super) fn write(file: &Path) -> Result<()> {
    tape::finish().map_or(Ok(()), |tape| atomic_write(file, &tape.to_bytes()))
}
