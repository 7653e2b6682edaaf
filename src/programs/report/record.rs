//! What a run did, measured: stages, notes, inputs, versions. The content of `manifest.json`.

use crate::alignment::Alignment;
use crate::core::formats::atomic_write;
use crate::core::memory::kibibytes;
use crate::core::progress::{Decision, Observer};
use crate::error::{Error, Result};
use crate::programs::export::ClassName;
use crate::scene::{Class, Scene, Split};
use crate::solution::check_generation;
use crate::verdict::Findings;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// One stage of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StageRecord {
    /// The stage's name.
    pub name: String,
    /// 0 for a stage of the run, 1 for a stage within one, …
    pub depth: usize,
    /// Elapsed time.
    pub wall_seconds: f64,
    /// Processor time of the whole process.
    pub cpu_seconds: f64,
    /// Rays traced.
    pub rays: u64,
}

/// Which program and libraries did the work.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Versions {
    /// unbake.
    pub unbake: String,
    /// Embree as found at run time (and at build time, if different).
    pub embree: String,
    /// OpenImageIO.
    pub openimageio: String,
}

/// The machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// Processor model as the kernel names it.
    pub cpu: String,
    /// Threads used.
    pub threads: usize,
    /// Main memory in bytes.
    pub memory_bytes: u64,
}

/// An input file and its content's hash.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// Path relative to the scene folder.
    pub path: String,
    /// Size.
    pub bytes: u64,
    /// BLAKE3 hash of the content, hexadecimal.
    pub blake3: String,
}

/// What was reconstructed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SceneSummary {
    /// Name of the scene's folder.
    pub name: String,
    /// Training views.
    pub training_views: usize,
    /// Held-out views.
    pub held_out_views: usize,
    /// Size of the first view.
    pub image_size: [usize; 2],
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Semantic classes.
    pub classes: usize,
    /// Their names: what `export --split` calls objects.
    pub class_names: Vec<ClassName>,
}

/// A run from its command to its result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunRecord {
    /// The command's arguments as typed.
    pub command: Vec<String>,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
    /// The scene.
    pub scene: SceneSummary,
    /// All options in effect.
    pub options: serde_json::Value,
    /// The seed.
    pub seed: u64,
    /// Elapsed time of the whole run.
    pub wall_seconds: f64,
    /// Processor time of the whole run.
    pub cpu_seconds: f64,
    /// Largest resident size of the process.
    pub peak_bytes: u64,
    /// Rays traced in all.
    pub rays: u64,
    /// The stages in order of their beginning.
    pub stages: Vec<StageRecord>,
    /// What the program chose and why, in order.
    pub decisions: Vec<Decision>,
    /// What it noticed, and warnings, in order.
    pub notes: Vec<String>,
    /// Every input file with its hash.
    pub inputs: Vec<InputFile>,
    /// What tells the solution that the run wrote from any other; empty in files of older versions.
    pub generation: String,
    /// What a reconstruction found of its own faults.
    pub findings: Option<Findings>,
    /// Whether photographs and mesh fitted, and what was corrected; verbs that read the scene again
    /// apply the same correction.
    pub alignment: Option<Alignment>,
}

impl SceneSummary {
    /// Counts what the scene brings.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let count = |split| scene.views.iter().filter(|v| v.split == split).count();
        let absolute = scene
            .folder
            .canonicalize()
            .unwrap_or_else(|_| scene.folder.clone());
        Self {
            name: absolute
                .file_name()
                .map(|n| n.to_string_lossy().into_owned())
                .unwrap_or_default(),
            training_views: count(Split::Train),
            held_out_views: count(Split::Test),
            image_size: scene
                .views
                .first()
                .map_or([0, 0], |v| [v.camera.width, v.camera.height]),
            triangles: scene.mesh.triangles.len(),
            classes: scene.classes.len(),
            class_names: class_names(scene),
        }
    }
}

/// Names of a scene's classes.
#[must_use]
pub fn class_names(scene: &Scene) -> Vec<ClassName> {
    let name = |c: &Class| ClassName {
        id: c.id,
        name: c.name.clone(),
    };
    scene.classes.iter().map(name).collect()
}

impl RunRecord {
    /// Takes over what the recorder has measured by now.
    pub fn measure(&mut self, recorder: &Recorder) {
        let RunRecord {
            stages,
            decisions,
            notes,
            wall_seconds,
            cpu_seconds,
            peak_bytes,
            rays,
            ..
        } = recorder.record();
        (self.stages, self.decisions, self.notes) = (stages, decisions, notes);
        (
            self.wall_seconds,
            self.cpu_seconds,
            self.peak_bytes,
            self.rays,
        ) = (wall_seconds, cpu_seconds, peak_bytes, rays);
    }

    /// Writes `manifest.json` into `folder`.
    ///
    /// # Errors
    /// If the folder cannot be written to.
    pub fn write_manifest(&self, folder: &Path) -> Result<()> {
        let path = folder.join("manifest.json");
        let json = serde_json::to_vec_pretty(self)
            .map_err(|e| Error::Failed(format!("manifest.json: {e}")))?;
        atomic_write(&path, &json)
    }

    /// The manifest beside a solution, if there is one.
    ///
    /// # Errors
    /// A manifest of another run than the solution's files.
    pub fn of_result(out: &Path) -> Result<Option<Self>> {
        let manifest = Self::read_manifest(out);
        if let Some(m) = &manifest {
            check_generation(out, "manifest.json", &m.generation)?;
        }
        Ok(manifest)
    }

    /// The names of the classes that the result in `out` was solved with; empty if it does not say.
    ///
    /// # Errors
    /// As [`Self::of_result`].
    pub fn class_names_of(out: &Path) -> Result<Vec<ClassName>> {
        Ok(Self::of_result(out)?.map_or_else(Vec::new, |m| m.scene.class_names))
    }

    /// Reads the `manifest.json` of an output folder; `None` where there is none that this version
    /// understands.
    #[must_use]
    pub fn read_manifest(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(folder.join("manifest.json")).ok()?).ok()
    }
}

/// Hashes every file a scene consists of: `transforms.json`, the mesh, images, labels and masks;
/// never anything under `gt/`.
///
/// # Errors
/// If a file cannot be read.
pub fn hash_inputs(scene: &Scene) -> Result<Vec<InputFile>> {
    use crate::core::parallel::prelude::*;
    let mut paths = scene.input_files();
    paths.retain(|p| p.is_file());
    paths
        .par_iter()
        .map(|path| {
            let mut hasher = blake3::Hasher::new();
            let read = std::fs::File::open(path).and_then(|file| {
                hasher.update_reader(file)?;
                Ok(hasher)
            });
            let hasher = read.map_err(|e| Error::input(path, format!("cannot be read ({e})")))?;
            Ok(InputFile {
                path: path
                    .strip_prefix(&scene.folder)
                    .unwrap_or(path)
                    .to_string_lossy()
                    .into_owned(),
                bytes: hasher.count(),
                blake3: hasher.finalize().to_hex().to_string(),
            })
        })
        .collect()
}

/// An observer that measures stages and keeps notes; tee it with whatever draws progress.
pub struct Recorder {
    start: Instant,
    cpu_start: f64,
    rays_start: u64,
    rays: fn() -> u64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    stages: Vec<StageRecord>,
    running: Vec<(usize, Instant, f64, u64)>,
    decisions: Vec<Decision>,
    notes: Vec<String>,
}

impl Recorder {
    /// Starts the clock; `rays` returns the number of rays the process has traced so far.
    #[must_use]
    pub fn new(rays: fn() -> u64) -> Self {
        Self {
            start: Instant::now(),
            cpu_start: cpu_seconds(),
            rays_start: rays(),
            rays,
            state: Mutex::default(),
        }
    }

    /// When the clock was started.
    #[must_use]
    pub fn started(&self) -> Instant {
        self.start
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What has been measured so far, with the rest of the record left for the caller to fill in.
    #[must_use]
    pub fn record(&self) -> RunRecord {
        let state = self.state();
        RunRecord {
            stages: state.stages.clone(),
            decisions: state.decisions.clone(),
            notes: state.notes.clone(),
            wall_seconds: self.start.elapsed().as_secs_f64(),
            cpu_seconds: cpu_seconds() - self.cpu_start,
            peak_bytes: peak_bytes(),
            rays: (self.rays)().saturating_sub(self.rays_start),
            machine: machine(),
            ..RunRecord::default()
        }
    }
}

impl Observer for Recorder {
    fn stage_started(&self, name: &str, _steps: u64) {
        let (cpu, rays) = (cpu_seconds(), (self.rays)());
        let mut state = self.state();
        let index = state.stages.len();
        let depth = state.running.len();
        state.stages.push(StageRecord {
            name: name.into(),
            depth,
            ..StageRecord::default()
        });
        state.running.push((index, Instant::now(), cpu, rays));
    }

    fn stage_advanced(&self, _done: u64) {}

    fn stage_finished(&self) {
        let (cpu, rays) = (cpu_seconds(), (self.rays)());
        let mut state = self.state();
        if let Some((index, start, cpu_before, rays_before)) = state.running.pop() {
            let stage = &mut state.stages[index];
            stage.wall_seconds = start.elapsed().as_secs_f64();
            stage.cpu_seconds = cpu - cpu_before;
            stage.rays = rays.saturating_sub(rays_before);
        }
    }

    fn note(&self, message: &str) {
        self.state().notes.push(message.into());
    }

    fn decided(&self, decision: &Decision) {
        self.state().decisions.push(decision.clone());
    }
}

/// Clock ticks per second of `/proc/<pid>/stat`: fixed at 100 by the kernel's user interface.
const TICKS_PER_SECOND: f64 = 100.0;

/// Processor time of this process, user and system, all threads; 0 where the kernel does not tell.
#[must_use]
pub fn cpu_seconds() -> f64 {
    let read = || {
        let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
        // the command's name may contain anything, so fields are counted after its closing
        // parenthesis
        let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(11);
        let user: f64 = fields.next()?.parse().ok()?;
        let system: f64 = fields.next()?.parse().ok()?;
        Some((user + system) / TICKS_PER_SECOND)
    };
    read().unwrap_or(0.0)
}

/// Largest resident size of this process so far, bytes; 0 where the kernel does not tell.
#[must_use]
pub fn peak_bytes() -> u64 {
    kibibytes("/proc/self/status", "VmHWM:").unwrap_or(0)
}

/// Lets [`peak_bytes`] count from now on, for a process that does one run after another; where the
/// kernel does not allow it, the peak stays that of the whole process.
pub fn restart_peak() {
    // proc(5): 5 resets the peak resident set size to the current one
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// The processor, the threads in use and the memory.
#[must_use]
pub fn machine() -> Machine {
    let cpu = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|text| {
            let line = text.lines().find(|l| l.starts_with("model name"))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        });
    Machine {
        cpu: cpu.unwrap_or_else(|| std::env::consts::ARCH.into()),
        threads: rayon::current_num_threads(),
        memory_bytes: kibibytes("/proc/meminfo", "MemTotal:").unwrap_or(0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::progress::Progress;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    static RAYS: AtomicU64 = AtomicU64::new(0);

    #[test]
    fn stages_nest_and_count_their_own_time_and_rays() {
        let recorder = Arc::new(Recorder::new(|| RAYS.load(Ordering::Relaxed)));
        let progress = Progress::new(recorder.clone());
        progress.stage("outer", 2, |p| {
            RAYS.fetch_add(5, Ordering::Relaxed);
            p.stage("inner", 1, |_| {
                RAYS.fetch_add(7, Ordering::Relaxed);
                std::thread::sleep(std::time::Duration::from_millis(20));
            });
            p.note("because");
            p.decide("light", "lamps", "they shine", false);
        });
        let record = recorder.record();
        let [outer, inner] = &record.stages[..] else {
            panic!("two stages")
        };
        assert_eq!(
            (outer.name.as_str(), outer.depth, outer.rays),
            ("outer", 0, 12)
        );
        assert_eq!(
            (inner.name.as_str(), inner.depth, inner.rays),
            ("inner", 1, 7)
        );
        assert!(inner.wall_seconds >= 0.02 && outer.wall_seconds >= inner.wall_seconds);
        assert_eq!(record.notes, ["because"]);
        assert_eq!(record.decisions[0].to_string(), "light: lamps (they shine)");
        assert!(record.peak_bytes > 1 << 20 && record.machine.memory_bytes > 0);
    }

    #[test]
    fn processor_time_grows_with_work() {
        let before = cpu_seconds();
        let start = Instant::now();
        let mut x = 1.0f64;
        while start.elapsed().as_millis() < 60 {
            x = (x * 1.000_001).sin() + 1.0;
        }
        assert!(x.is_finite() && cpu_seconds() > before);
    }

    #[test]
    fn the_manifest_reads_back() {
        let folder = tempfile::tempdir().expect("temp");
        let record = RunRecord {
            seed: 7,
            notes: vec!["a \"quoted\" note".into()],
            ..RunRecord::default()
        };
        record.write_manifest(folder.path()).expect("writes");
        assert_eq!(RunRecord::read_manifest(folder.path()), Some(record));
        assert_eq!(RunRecord::read_manifest(&folder.path().join("none")), None);
    }
}
