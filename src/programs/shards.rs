//! One scene solved by several processes over a folder: `OUT.shards/RUN/` holds the blocks, what the
//! run is of (`run.json`), a lock file for every process at work, and `finished` once a process
//! had all blocks. RUN is a hash of input, options, seed and program.

use crate::core::blocks::{BlockFolder, Shard};
use crate::core::formats::{atomic_write, read_input_text};
use crate::core::lock::{Claim, WorkLock, worker};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const PLAN: &str = "run.json";
const FINISHED: &str = "finished";
/// Ending of the lock files of processes at work.
const AT_WORK: &str = ".working";

/// What a run is of: enough to walk through it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The scene as an absolute path.
    pub scene: PathBuf,
    /// The configuration.
    pub config: serde_json::Value,
}

/// The folder of a run that several processes share.
#[derive(Clone, Debug)]
pub struct ShardedRun {
    out: PathBuf,
    root: PathBuf,
    key: String,
}

/// `OUT.shards`, beside `out`.
fn root_of(out: &Path) -> PathBuf {
    // (without a slash at the end)
    let out: PathBuf = out.components().collect();
    let mut name = out.into_os_string();
    name.push(".shards");
    name.into()
}

/// The runs that have a folder in `root`.
fn runs_in(root: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten();
    let folders = entries.filter(|e| e.path().is_dir());
    folders
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect()
}

impl ShardedRun {
    /// The folder of the run `key` into `out`, made if need be.
    ///
    /// # Errors
    /// It cannot be made, or blocks of another run lie there.
    pub fn begin(out: &Path, key: &str, plan: &Plan) -> Result<Self> {
        let run = Self {
            out: out.into(),
            root: root_of(out),
            key: key.into(),
        };
        let folder = run.folder();
        if let Some(other) = runs_in(&run.root).iter().find(|r| *r != key) {
            return Err(Error::input(
                &run.root,
                format!(
                    "holds the blocks of another run ({other:.12}…: other inputs, options, seed or program); finish it by `unbake merge {}`, or remove this folder",
                    out.display()
                ),
            ));
        }
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        let json = serde_json::to_vec_pretty(plan)
            .map_err(|e| Error::Failed(format!("{}: {e}", folder.display())))?;
        atomic_write(folder.join(PLAN), &json)?;
        Ok(run)
    }

    /// The run that was begun into `out`, and what it is of.
    ///
    /// # Errors
    /// There is none, or more than one, or its description cannot be read.
    pub fn find(out: &Path) -> Result<(Self, Plan)> {
        let root = root_of(out);
        let key = match &runs_in(&root)[..] {
            [key] => key.clone(),
            [] => {
                let message = format!(
                    "there are no blocks to merge; expected those of `unbake solve SCENE --out {} --shard I/N`",
                    out.display()
                );
                return Err(Error::input(&root, message));
            }
            several => {
                let message = format!(
                    "holds the blocks of {} runs; remove all folders but the one to merge",
                    several.len()
                );
                return Err(Error::input(&root, message));
            }
        };
        let run = Self {
            out: out.into(),
            root,
            key,
        };
        let path = run.folder().join(PLAN);
        let text = read_input_text(&path)?;
        let plan = serde_json::from_str(&text).map_err(|e| {
            let message = format!("is damaged ({e}); start a shard again, which writes it anew");
            Error::input(&path, message)
        })?;
        Ok((run, plan))
    }

    fn folder(&self) -> PathBuf {
        self.root.join(&self.key)
    }

    /// Refuses to go on if the run that `key` stands for is another.
    ///
    /// # Errors
    /// Inputs or program have changed.
    pub fn expect_key(&self, key: &str) -> Result<()> {
        if key == self.key {
            return Ok(());
        }
        Err(Error::input(
            &self.root,
            "the inputs or this program have changed since its blocks were computed; undo the change, or remove this folder and start the shards again",
        ))
    }

    /// The blocks, for process `shard`.
    ///
    /// # Errors
    /// Those of [`BlockFolder::open`].
    pub fn blocks(&self, shard: Shard) -> Result<BlockFolder> {
        BlockFolder::open(&self.folder(), &self.key, shard)
    }

    /// Says that this process is at work, until dropped.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn at_work(&self) -> Result<Claim> {
        WorkLock::claim(&self.folder().join(format!("{}{AT_WORK}", worker())))
    }

    /// Puts down that a process had all blocks.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn finish(&self) -> Result<()> {
        atomic_write(self.folder().join(FINISHED), worker().as_bytes())
    }

    /// Refuses to go on while no process has had all blocks.
    ///
    /// # Errors
    /// What is missing, and how to go on.
    pub fn expect_finished(&self) -> Result<()> {
        if self.folder().join(FINISHED).is_file() {
            return Ok(());
        }
        let calls = BlockFolder::state(&self.folder())?;
        let lacking: Vec<String> = calls
            .iter()
            .filter(|c| !c.missing.is_empty())
            .map(|c| {
                let (n, of) = (c.missing.len(), c.count);
                format!(
                    "  {}: {n} of {of} blocks, from number {}",
                    c.name, c.missing[0]
                )
            })
            .collect();
        let reached = calls.last().map_or("none", |c| c.name.as_str());
        let lacking = match lacking.is_empty() {
            true => "  nothing of what was begun".to_owned(),
            false => lacking.join("\n"),
        };
        Err(Error::input(
            &self.root,
            format!(
                "no shard has come to its end (last stage begun: {reached}). Missing:\n{lacking}\nstart a shard again, which goes on from there, or let `unbake merge {} --complete` compute the rest",
                self.out.display()
            ),
        ))
    }

    /// Removes the folder once no process is at work in it.
    pub fn remove(self) {
        let folder = self.folder();
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        for lock in entries.map(|e| e.path()) {
            if lock.to_string_lossy().ends_with(AT_WORK) {
                // they end soon: all blocks are there
                let _ = WorkLock::wait(&lock);
            }
        }
        // what will not go takes room and is refused by the next run with words
        let _ = std::fs::remove_dir_all(&folder);
        let _ = std::fs::remove_dir(&self.root);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        Plan {
            scene: "/scene".into(),
            config: serde_json::json!({"seed": 3}),
        }
    }

    #[test]
    fn a_run_is_found_again_and_another_is_refused() {
        let dir = tempfile::tempdir().expect("temp");
        let out = dir.path().join("out");
        let none = ShardedRun::find(&out).expect_err("none");
        assert!(none.to_string().contains("no blocks to merge"), "{none}");
        let run = ShardedRun::begin(&out, "aaa", &plan()).expect("begun");
        ShardedRun::begin(&out, "aaa", &plan()).expect("the same");
        let e = ShardedRun::begin(&out, "bbb", &plan()).expect_err("another");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("another run"),
            "{e}"
        );
        let (found, of) = ShardedRun::find(&out.join("")).expect("found");
        assert_eq!(of, plan());
        found.expect_key("aaa").expect("same");
        assert!(found.expect_key("bbb").is_err());
        let e = found.expect_finished().expect_err("not yet");
        assert!(e.to_string().contains("--complete"), "{e}");
        run.finish().expect("written");
        found.expect_finished().expect("finished");
        found.remove();
        assert_eq!(std::fs::read_dir(dir.path()).expect("lists").count(), 0);
    }
}
