//! What is written down of a run: its inputs, options and versions.

use super::{Run, RunRequest};
use crate::error::{Error, Result};
use crate::pipeline::SolveOptions;
use crate::programs::report::{InputFile, RunRecord, SceneSummary, Versions};
use crate::scene::Scene;
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::sync::OnceLock;

/// A hash of everything the result depends on: inputs, options, seed and this very program.
pub(super) fn run_key(inputs: &[InputFile], options: &SolveOptions, run: &Run) -> Result<String> {
    let program = program_hash()?;
    let all = json!([
        inputs,
        options_of(run, options)?,
        run.request.seed,
        Versions::current(),
        program
    ]);
    Ok(blake3::hash(all.to_string().as_bytes())
        .to_hex()
        .to_string())
}

/// A hash of the file that this code was loaded from, computed once.
fn program_hash() -> Result<&'static str> {
    static HASH: OnceLock<String> = OnceLock::new();
    if let Some(hash) = HASH.get() {
        return Ok(hash);
    }
    let program = own_library()
        .map_or_else(std::env::current_exe, Ok)
        .and_then(std::fs::read)
        .map_err(|e| Error::Failed(format!("reading this program: {e}")))?;
    let mut hash = blake3::Hasher::new();
    let hash = hash.update_rayon(&program).finalize().to_hex().to_string();
    Ok(HASH.get_or_init(|| hash))
}

/// The file whose mapping holds this very function (`proc_pid_maps(5)`): the program, or a library
/// that another program loaded, such as a module of Python. `None` where the kernel does not tell.
fn own_library() -> Option<PathBuf> {
    let here = own_library as fn() -> Option<PathBuf> as usize;
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    let holds = |line: &&str| {
        let range = line.split(' ').next().and_then(|r| r.split_once('-'));
        let bound = |text: &str| usize::from_str_radix(text, 16).ok();
        let range = range.and_then(|(low, high)| Some(bound(low)?..bound(high)?));
        range.is_some_and(|r| r.contains(&here))
    };
    let line = maps.lines().find(holds)?;
    Some(PathBuf::from(&line[line.find('/')?..])).filter(|p| p.is_file())
}

/// Options as asked for and in effect.
#[derive(Serialize)]
struct Options<'a> {
    #[serde(flatten)]
    asked: &'a RunRequest,
    effective: &'a SolveOptions,
}

fn options_of(run: &Run, effective: &SolveOptions) -> Result<serde_json::Value> {
    let asked = &run.request;
    serde_json::to_value(Options { asked, effective })
        .map_err(|e| Error::Failed(format!("options: {e}")))
}

impl Run {
    /// What has been measured so far, with what is known about the run besides.
    ///
    /// # Errors
    /// Options that cannot be written down.
    pub fn record(
        &self,
        scene: &Scene,
        inputs: Vec<InputFile>,
        options: &SolveOptions,
    ) -> Result<RunRecord> {
        Ok(RunRecord {
            command: self.command.clone(),
            versions: Versions::current(),
            scene: SceneSummary::of(scene),
            options: options_of(self, options)?,
            seed: self.request.seed,
            inputs,
            ..self.recorder.record()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_of_a_test_lies_in_its_executable() {
        let found = own_library().expect("a kernel with /proc");
        let exe = std::env::current_exe().expect("a test has a file");
        assert_eq!(found.canonicalize().ok(), exe.canonicalize().ok());
    }
}
