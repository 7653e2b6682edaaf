//! What is known of a scene of a batch, and whether its result still holds.
//!
//! A finished scene stays finished as long as options, seed and program (its key), its output files
//! and its inputs are the same. Inputs are compared as `make` does, by size and time, and by their
//! hashes where the time has changed.

use crate::core::formats::{MOST_DATA, read_input};
use crate::core::lock::worker;
use crate::programs::report::{InputFile, RunRecord};
use crate::solution::FILES;
use crate::verdict::{Level, Verdict};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// What became of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Nobody has begun.
    #[default]
    Waiting,
    /// Somebody has begun: at work, or stopped before the end.
    Started,
    /// The result is there.
    Finished,
    /// It ended with an error.
    Failed,
}

/// What is known of a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SceneRecord {
    /// What became of it.
    pub state: State,
    /// How often it was begun.
    pub attempts: u32,
    /// Machine and process that had it last.
    pub worker: String,
    /// The verdict in one word.
    pub verdict: Option<Level>,
    /// Expected error in albedo: root mean square over the seen surface.
    pub expected_error: Option<f64>,
    /// Elapsed time of the last attempt.
    pub seconds: Option<f64>,
    /// Largest resident size in that time, bytes.
    pub peak_bytes: Option<u64>,
    /// The error, or the heaviest reason against the result.
    pub message: String,
    /// Hash of options, seed and program.
    pub key: String,
    /// Mark of the result's files.
    pub generation: String,
    /// Times of the manifest's inputs, nanoseconds since 1970; 0 = not known.
    pub input_times: Vec<u64>,
}

impl SceneRecord {
    /// The scene was begun (again) by this process, with the options of `key`.
    #[must_use]
    pub fn begun(before: &Self, key: &str) -> Self {
        Self {
            state: State::Started,
            attempts: before.attempts.saturating_add(1),
            worker: worker(),
            key: key.into(),
            ..Self::default()
        }
    }

    /// The scene ended with an error after so many seconds.
    #[must_use]
    pub fn failed(self, message: String, seconds: f64) -> Self {
        Self {
            state: State::Failed,
            message,
            seconds: Some(seconds),
            ..self
        }
    }

    /// The scene was solved: `run` began at `start` and read `scene`.
    #[must_use]
    pub fn finished(
        self,
        run: &RunRecord,
        verdict: &Verdict,
        scene: &Path,
        start: SystemTime,
    ) -> Self {
        let start = nanoseconds(start);
        // what changed after the beginning may not be what was read
        let time = |input: &InputFile| match modified(&folder_of(scene).join(&input.path)) {
            Some(t) if t < start => t,
            _ => 0,
        };
        let first = verdict.reasons.first();
        Self {
            state: State::Finished,
            verdict: Some(verdict.level),
            expected_error: Some(verdict.expected_error),
            seconds: Some(run.wall_seconds),
            peak_bytes: Some(run.peak_bytes),
            message: first.map_or_else(String::new, |r| r.what.clone()),
            generation: run.generation.clone(),
            input_times: run.inputs.iter().map(time).collect(),
            ..self
        }
    }

    /// Whether the result in `out` is what solving `scene` with the options of `key` would give.
    #[must_use]
    pub fn still_holds(&self, key: &str, scene: &Path, out: &Path) -> bool {
        let manifest = || RunRecord::read_manifest(out).filter(|m| m.generation == self.generation);
        if self.state != State::Finished || self.key != key || self.generation.is_empty() {
            return false;
        }
        let (Some(manifest), true) = (manifest(), FILES.iter().all(|f| out.join(f).is_file()))
        else {
            return false;
        };
        let times = self.input_times.iter().chain(std::iter::repeat(&0));
        let folder = folder_of(scene);
        let mut inputs = manifest.inputs.iter().zip(times);
        inputs.all(|(input, time)| unchanged(&folder.join(&input.path), input, *time))
    }
}

/// A scene's folder, whichever way it was named.
fn folder_of(scene: &Path) -> &Path {
    match scene.is_file() {
        true => scene.parent().unwrap_or(scene),
        false => scene,
    }
}

fn nanoseconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH)
        .map_or(0, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX))
}

fn modified(path: &Path) -> Option<u64> {
    Some(nanoseconds(std::fs::metadata(path).ok()?.modified().ok()?))
}

fn unchanged(path: &Path, input: &InputFile, time: u64) -> bool {
    let same_size = std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() == input.bytes);
    let same_bytes = || {
        read_input(path, MOST_DATA)
            .is_ok_and(|bytes| blake3::hash(&bytes).to_hex().as_str() == input.blake3)
    };
    same_size && ((time > 0 && modified(path) == Some(time)) || same_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;
    use std::time::Duration;

    /// A scene of one input and its result, and what the board knows of it.
    fn solved(dir: &Path) -> (SceneRecord, PathBuf, PathBuf) {
        let (scene, out) = (dir.join("scene"), dir.join("out"));
        for folder in [&scene, &out] {
            std::fs::create_dir_all(folder).expect("folder");
        }
        std::fs::write(scene.join("mesh.ply"), b"mesh").expect("input");
        for name in FILES {
            std::fs::write(out.join(name), b"x").expect("output");
        }
        let run = RunRecord {
            generation: "g".into(),
            inputs: vec![InputFile {
                path: "mesh.ply".into(),
                bytes: 4,
                blake3: blake3::hash(b"mesh").to_hex().to_string(),
            }],
            ..RunRecord::default()
        };
        run.write_manifest(&out).expect("manifest");
        let later = SystemTime::now() + Duration::from_secs(60);
        let record = SceneRecord::begun(&SceneRecord::default(), "key").finished(
            &run,
            &Verdict::default(),
            &scene,
            later,
        );
        (record, scene, out)
    }

    #[test]
    fn a_result_holds_until_options_inputs_or_outputs_change() {
        let dir = tempfile::tempdir().expect("temp");
        let (record, scene, out) = solved(dir.path());
        assert_eq!((record.attempts, record.input_times.len()), (1, 1));
        assert!(record.input_times[0] > 0 && record.still_holds("key", &scene, &out));
        assert!(!record.still_holds("other", &scene, &out));
        // the same bytes at another time, then others of the same length
        let mesh = scene.join("mesh.ply");
        let touch = |bytes: &[u8]| {
            std::fs::write(&mesh, bytes).expect("input");
            let time = SystemTime::now() + Duration::from_secs(5);
            let file = std::fs::File::options().write(true).open(&mesh);
            file.and_then(|f| f.set_modified(time)).expect("time");
        };
        touch(b"mesh");
        assert!(record.still_holds("key", &scene, &out));
        touch(b"mosh");
        assert!(!record.still_holds("key", &scene, &out));
        touch(b"mesh");
        std::fs::remove_file(out.join(FILES[0])).expect("there");
        assert!(!record.still_holds("key", &scene, &out));
    }

    #[test]
    fn inputs_that_changed_during_the_run_are_hashed() {
        let dir = tempfile::tempdir().expect("temp");
        let (_, scene, out) = solved(dir.path());
        let run = RunRecord::read_manifest(&out).expect("written");
        let record = SceneRecord::begun(&SceneRecord::default(), "key");
        let record = record.finished(&run, &Verdict::default(), &scene, UNIX_EPOCH);
        assert_eq!(record.input_times, [0]);
        assert!(record.still_holds("key", &scene, &out));
        std::fs::write(scene.join("mesh.ply"), b"mosh").expect("input");
        assert!(!record.still_holds("key", &scene, &out));
    }
}
