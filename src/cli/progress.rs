//! Drawing progress: bars on a terminal, log lines in a pipe.

use crate::core::progress::Observer;
use crate::error::printable;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// "7.3 s", "2 min 05 s".
#[must_use]
pub fn seconds(elapsed: Duration) -> String {
    let s = elapsed.as_secs_f64();
    if s < 60.0 {
        format!("{s:.1} s")
    } else {
        format!(
            "{} min {:02} s",
            elapsed.as_secs() / 60,
            elapsed.as_secs() % 60
        )
    }
}

/// One bar per running stage on stderr; a finished stage leaves a line with its time.
pub struct Bars {
    all: MultiProgress,
    running: Mutex<Vec<(ProgressBar, String, Instant)>>,
}

impl Bars {
    /// Bars on stderr.
    #[must_use]
    pub fn new() -> Self {
        Self {
            all: MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10)),
            running: Mutex::default(),
        }
    }
}

impl Default for Bars {
    fn default() -> Self {
        Self::new()
    }
}

impl Observer for Bars {
    fn stage_started(&self, name: &str, steps: u64) {
        let bar = self.all.add(if steps > 1 {
            ProgressBar::new(steps)
        } else {
            ProgressBar::new_spinner()
        });
        let template = if steps > 1 {
            "  {msg:<28} {bar:32} {percent:>3} %  {eta:>6} left"
        } else {
            "  {msg:<28} {spinner} {elapsed}"
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("━╸─"));
        }
        bar.set_message(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        locked(&self.running).push((bar, name.to_owned(), Instant::now()));
    }

    fn stage_advanced(&self, done: u64) {
        if let Some((bar, ..)) = locked(&self.running).last() {
            bar.set_position(done);
        }
    }

    fn stage_finished(&self) {
        let (ended, depth) = {
            let mut running = locked(&self.running);
            (running.pop(), running.len())
        };
        if let Some((bar, name, start)) = ended {
            bar.finish_and_clear();
            self.all.remove(&bar);
            // a terminal that has gone away is no reason to stop computing
            let _ = self.all.println(format!(
                "  {:indent$}{name:<28} {:>12}",
                "",
                seconds(start.elapsed()),
                indent = 2 * depth
            ));
        }
    }

    fn note(&self, message: &str) {
        let _ = self.all.println(format!("  · {}", printable(message)));
    }
}

/// Plain lines on stderr: one when a stage ends, one every ten seconds while it runs.
pub struct LogLines {
    begin: Instant,
    running: Mutex<Vec<Running>>,
}

struct Running {
    name: String,
    steps: u64,
    start: Instant,
    last_line: Instant,
}

/// How often a long stage says how far it is.
const HEARTBEAT: Duration = Duration::from_secs(10);

impl LogLines {
    /// Lines on stderr.
    #[must_use]
    pub fn new() -> Self {
        Self {
            begin: Instant::now(),
            running: Mutex::default(),
        }
    }

    fn line(&self, text: &str) {
        // the reader of the pipe may have gone away: that is its right
        let _ = writeln!(
            std::io::stderr(),
            "[{:8.1} s] {text}",
            self.begin.elapsed().as_secs_f64()
        );
    }
}

impl Default for LogLines {
    fn default() -> Self {
        Self::new()
    }
}

impl Observer for LogLines {
    fn stage_started(&self, name: &str, steps: u64) {
        let now = Instant::now();
        locked(&self.running).push(Running {
            name: name.into(),
            steps,
            start: now,
            last_line: now,
        });
    }

    fn stage_advanced(&self, done: u64) {
        let text = {
            let mut running = locked(&self.running);
            let Some(stage) = running
                .last_mut()
                .filter(|s| s.steps > 0 && s.last_line.elapsed() >= HEARTBEAT)
            else {
                return;
            };
            stage.last_line = Instant::now();
            format!(
                "{}: {} %",
                stage.name,
                done.min(stage.steps) * 100 / stage.steps
            )
        };
        self.line(&text);
    }

    fn stage_finished(&self) {
        let ended = locked(&self.running).pop();
        if let Some(stage) = ended {
            self.line(&format!(
                "{}: {}",
                stage.name,
                seconds(stage.start.elapsed())
            ));
        }
    }

    fn note(&self, message: &str) {
        self.line(&format!("note: {}", printable(message)));
    }
}
