//! A run: a scene read, tested for alignment, reconstructed, and written with its report and manifest;
//! and the same look at a scene without the reconstruction (`check`). Called by `unbake solve`,
//! `batch`, `merge`, `delight` and by the Python module.

mod check;
mod guard;
mod job;
mod record;
mod result;

pub use check::{CheckedScene, check_scene};
pub use guard::{keep_inputs, keep_results};
pub use job::{Job, SolvedJob, read_scene};
pub use result::{RunResult, SolvedRun};

use crate::alignment::AlignmentOptions;
use crate::core::progress::{Observer, Progress, Tee};
use crate::pipeline::{SolveOptions, SolveRequest};
use crate::programs::report::Recorder;
use crate::scene::LoadOptions;
use serde::Serialize;
use std::sync::Arc;

/// What is asked of a run: all that its result depends on besides the files.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RunRequest {
    /// How the scene is read.
    #[serde(rename = "scene")]
    pub load: LoadOptions,
    /// What is done about poses that do not fit the mesh.
    pub alignment: AlignmentOptions,
    /// How it is reconstructed.
    pub solve: SolveRequest,
    /// Key of every random number.
    #[serde(skip)]
    pub seed: u64,
}

/// A run under way: what is asked of it, and who watches.
#[derive(Clone)]
pub struct Run {
    /// What is asked.
    pub request: RunRequest,
    /// How it was asked, for the manifest: a command's arguments, or a call.
    pub command: Vec<String>,
    /// Where long work reports to.
    pub progress: Progress,
    /// Measures it.
    pub recorder: Arc<Recorder>,
}

impl Run {
    /// A run that begins now, watched by `others` besides its own recorder.
    #[must_use]
    pub fn new(request: RunRequest, command: Vec<String>, others: Vec<Arc<dyn Observer>>) -> Self {
        let recorder = Arc::new(Recorder::new(crate::core::trace::rays_traced));
        let mut observers: Vec<Arc<dyn Observer>> = vec![recorder.clone()];
        observers.extend(others);
        Self {
            request,
            command,
            progress: Progress::new(Arc::new(Tee(observers))),
            recorder,
        }
    }

    /// The numbers that the request gives, before anything is known of a scene.
    #[must_use]
    pub fn options(&self) -> SolveOptions {
        let request = &self.request;
        (request.solve).options(request.seed, self.recorder.started())
    }
}
