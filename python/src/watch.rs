//! Long work beside Python: it runs on a thread of its own, while the calling thread lets Python's
//! other threads run, passes events on to callbacks, and hears Ctrl-C.

use crate::said::{exception, usage};
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;
use unbake::core::progress::{Observer, stoppable};
use unbake::{Error, Result};

/// How long the calling thread sleeps without events: Ctrl-C is heard and progress shown this often.
/// Derived: the longest delay that does not feel like one (Nielsen 1993, 0.1 s).
const TICK: Duration = Duration::from_millis(100);

/// The stack of working threads. Derived: that of a program's first thread on Linux, on which the same
/// work runs otherwise.
const STACK: usize = 8 << 20;

/// What the work reports.
enum Event {
    Started { name: String, steps: u64 },
    Finished,
    Note(String),
    End,
}

/// Stands between the work's threads and the calling one.
#[derive(Default)]
struct Watcher {
    events: Mutex<VecDeque<Event>>,
    rings: Condvar,
    done: AtomicU64,
    stop: AtomicBool,
}

impl Watcher {
    fn events(&self) -> MutexGuard<'_, VecDeque<Event>> {
        self.events.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, event: Event) {
        self.events().push_back(event);
        self.rings.notify_one();
    }

    /// The next event, or nothing for a tick.
    fn next(&self) -> Option<Event> {
        let waited = self
            .rings
            .wait_timeout_while(self.events(), TICK, |e| e.is_empty());
        let (mut events, _) = waited.unwrap_or_else(PoisonError::into_inner);
        events.pop_front()
    }
}

impl Observer for Watcher {
    fn stage_started(&self, name: &str, steps: u64) {
        self.done.store(0, Ordering::Relaxed);
        self.tell(Event::Started {
            name: name.to_owned(),
            steps,
        });
    }
    fn stage_advanced(&self, done: u64) {
        self.done.fetch_max(done, Ordering::Relaxed);
    }
    fn stage_finished(&self) {
        self.tell(Event::Finished);
    }
    fn note(&self, message: &str) {
        self.tell(Event::Note(message.to_owned()));
    }
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Who hears of the work, and on how many threads it runs.
#[derive(Default)]
pub(crate) struct Watch<'py> {
    /// Called with a stage's name, the steps done and all its steps.
    pub progress: Option<Bound<'py, PyAny>>,
    /// Called with sentences that a user should read.
    pub note: Option<Bound<'py, PyAny>>,
    /// Worker threads; `None` = all cores.
    pub threads: Option<usize>,
}

impl Watch<'_> {
    /// Runs `work`, which reports to the observer that it is given.
    pub(crate) fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(Arc<dyn Observer>) -> Result<T> + Send,
    ) -> PyResult<T> {
        let pool = self.pool(py)?;
        let watcher = Arc::new(Watcher::default());
        let task = || {
            let observer = watcher.clone();
            let result = stoppable(|| match &pool {
                Some(pool) => pool.install(|| work(observer)),
                None => work(observer),
            });
            watcher.tell(Event::End);
            result
        };
        let (heard, ended) = thread::scope(|scope| {
            let worker = thread::Builder::new()
                .name("unbake".into())
                .stack_size(STACK)
                .spawn_scoped(scope, task)
                .map_err(|e| {
                    exception(py, &Error::Failed(format!("cannot start a thread: {e}")))
                })?;
            let heard = self.listen(py, &watcher, || worker.is_finished());
            watcher.stop.store(heard.is_err(), Ordering::Relaxed);
            Ok::<_, PyErr>((heard, py.detach(|| worker.join())))
        })?;
        heard?;
        match ended {
            Ok(result) => result.map_err(|e| exception(py, &e)),
            Err(defect) => std::panic::resume_unwind(defect),
        }
    }

    fn pool(&self, py: Python<'_>) -> PyResult<Option<rayon::ThreadPool>> {
        let Some(threads) = self.threads else {
            return Ok(None);
        };
        if threads == 0 || threads > 4096 {
            let message = format!("threads={threads}: expected 1 to 4096, or None for every core");
            return Err(usage(py, message));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .stack_size(STACK)
            .build();
        pool.map(Some).map_err(|e| {
            let message = format!("cannot start {threads} threads: {e}");
            exception(py, &Error::Failed(message))
        })
    }

    /// Passes events on until the work ends, or an exception is raised here.
    fn listen(
        &self,
        py: Python<'_>,
        watcher: &Watcher,
        finished: impl Fn() -> bool,
    ) -> PyResult<()> {
        let mut stages: Vec<(String, u64)> = Vec::new();
        let mut shown = 0;
        loop {
            let event = py.detach(|| watcher.next());
            py.check_signals()?;
            match event {
                Some(Event::Started { name, steps }) => {
                    shown = 0;
                    self.show(&name, 0, steps)?;
                    stages.push((name, steps));
                }
                Some(Event::Finished) => {
                    if let Some((name, steps)) = stages.pop() {
                        self.show(&name, steps, steps)?;
                    }
                }
                Some(Event::Note(message)) => {
                    if let Some(note) = &self.note {
                        note.call1((message,))?;
                    }
                }
                Some(Event::End) => return Ok(()),
                None if finished() => return Ok(()),
                None => {
                    let done = watcher.done.load(Ordering::Relaxed);
                    if let Some((name, steps)) = stages.last().filter(|_| done > shown) {
                        shown = done;
                        self.show(name, done.min(*steps), *steps)?;
                    }
                }
            }
        }
    }

    fn show(&self, name: &str, done: u64, steps: u64) -> PyResult<()> {
        if let Some(progress) = &self.progress {
            progress.call1((name, done, steps))?;
        }
        Ok(())
    }
}
