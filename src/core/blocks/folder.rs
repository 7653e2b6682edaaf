//! Blocks shared over a folder: every block has a file for its lock and one for its result.
//!
//! A process computes what it can lock and reads what others have written. Locks die with their process,
//! so a killed one costs only the blocks that it was at; results appear whole, sealed with the name
//! of run, stage and block. Processes need not run at the same time: one alone computes everything.

use super::packed::{Columns, opened, sealed};
use super::work::{Transport, Work};
use crate::core::formats::atomic_write;
use crate::core::lock::{Claim, WorkLock, worker};
use crate::core::parallel::prelude::*;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// How long a process sleeps before it looks again for a block that another is at. Derived: a tenth of
/// the time that the shortest blocks take.
const POLL: Duration = Duration::from_millis(20);
/// After how long it says whom it waits for, and how often again.
const PATIENCE: Duration = Duration::from_secs(60);
/// File with the number of blocks in the folder of a call.
const COUNT: &str = "blocks";

/// Which of several processes this is: it begins with other blocks than the others do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of this process, from 1.
    pub index: usize,
    /// Number of processes.
    pub of: usize,
}

impl FromStr for Shard {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let expected = || "expected I/N with I from 1 to N, such as 2/8".to_owned();
        let (index, of) = text.split_once('/').ok_or_else(expected)?;
        let number = |s: &str| s.parse::<usize>().map_err(|_| expected());
        let (index, of) = (number(index)?, number(of)?);
        match (1..=of).contains(&index) {
            true => Ok(Self { index, of }),
            false => Err(expected()),
        }
    }
}

/// The blocks of a run in a folder.
pub struct BlockFolder {
    folder: PathBuf,
    /// What the results are sealed with.
    run: String,
    shard: Shard,
    /// The stage, and how many calls there were.
    place: Mutex<(String, usize)>,
    /// Blocks computed here.
    computed: AtomicUsize,
    /// Whether it was said that the folder cannot be written to.
    complained: AtomicBool,
}

/// Blocks of a call and how many results lack.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallState {
    /// Number and stage of the call.
    pub name: String,
    /// Number of blocks.
    pub count: usize,
    /// Blocks without a result.
    pub missing: Vec<usize>,
}

/// What became of asking for a block.
enum Turn {
    Have(Columns),
    Elsewhere,
}

impl BlockFolder {
    /// The blocks of the run `run` (a hash of all that it depends on) in `folder`, which is made.
    ///
    /// # Errors
    /// The folder cannot be made or written to, or its file system has no locks.
    pub fn open(folder: &Path, run: &str, shard: Shard) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        // one's own file: that it cannot be locked means that nothing can
        let trial = folder.join(format!(".lock-{}", worker()));
        let claim = WorkLock::claim(&trial)?;
        let _ = std::fs::remove_file(&trial);
        if matches!(claim, Claim::NoLocks) {
            return Err(Error::input(
                folder,
                "the file system has no locks, so blocks cannot be shared out; put the result on another, or solve without --shard",
            ));
        }
        Ok(Self {
            folder: folder.into(),
            run: run.into(),
            shard,
            place: Mutex::new((String::from("start"), 0)),
            computed: AtomicUsize::new(0),
            complained: AtomicBool::new(false),
        })
    }

    /// Number of blocks that this process computed.
    #[must_use]
    pub fn computed(&self) -> usize {
        self.computed.load(Ordering::Relaxed)
    }

    /// The calls begun so far in `folder`, in order, and what they lack.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn state(folder: &Path) -> Result<Vec<CallState>> {
        let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
        let mut calls: Vec<CallState> = entries
            .flatten()
            .filter_map(|e| {
                let count = std::fs::read_to_string(e.path().join(COUNT)).ok()?;
                let count = count.trim().parse().ok()?;
                let lacks = |b: &usize| !e.path().join(result_name(*b)).is_file();
                Some(CallState {
                    name: e.file_name().to_string_lossy().into_owned(),
                    count,
                    missing: (0..count).filter(lacks).collect(),
                })
            })
            .collect();
        calls.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(calls)
    }

    /// Says once that blocks cannot be handed to others.
    fn complain(&self, work: &Work<'_>, e: &Error) {
        if !self.complained.swap(true, Ordering::Relaxed) {
            (work.note)(&format!(
                "blocks cannot be shared with other processes, each computes what it lacks: {e}"
            ));
        }
    }
}

fn result_name(block: usize) -> String {
    format!("{block:03}.block")
}

/// One call's blocks.
struct Call<'a> {
    of: &'a BlockFolder,
    work: &'a Work<'a>,
    folder: PathBuf,
    name: String,
}

impl Call<'_> {
    fn label(&self, block: usize) -> String {
        format!(
            "{}/{}/{block} of {}",
            self.of.run, self.name, self.work.count
        )
    }

    fn lock(&self, block: usize) -> PathBuf {
        self.folder.join(format!("{block:03}.lock"))
    }

    /// The result of a block if it is there and whole.
    fn read(&self, block: usize) -> Option<Columns> {
        let path = self.folder.join(result_name(block));
        let bytes = std::fs::read(&path).ok()?;
        let columns = opened(&self.label(block), &bytes);
        if columns.is_none() {
            (self.work.note)(&format!(
                "{}: is damaged; the block is computed again",
                path.display()
            ));
            // (whoever locks it next finds nothing)
            let _ = std::fs::remove_file(&path);
        }
        columns
    }

    /// The block as it is there, or as computed now; nothing where another process is at it.
    fn take(&self, block: usize) -> Turn {
        if let Some(columns) = self.read(block) {
            return Turn::Have(columns);
        }
        let held = match WorkLock::claim(&self.lock(block)) {
            Ok(Claim::Theirs) => return Turn::Elsewhere,
            Ok(Claim::Ours(lock)) => Some(lock),
            Ok(Claim::NoLocks) => None,
            Err(e) => {
                self.of.complain(self.work, &e);
                None
            }
        };
        // it may have come between the look and the lock
        if let Some(columns) = held.as_ref().and_then(|_| self.read(block)) {
            return Turn::Have(columns);
        }
        if held.is_some() {
            // for those who wait; without it they only do not know for whom
            let _ = std::fs::write(self.lock(block), worker());
        }
        self.of.computed.fetch_add(1, Ordering::Relaxed);
        let columns = (self.work.compute)(block);
        let bytes = sealed(&self.label(block), &columns);
        if let Err(e) = atomic_write(self.folder.join(result_name(block)), &bytes) {
            self.of.complain(self.work, &e);
        }
        Turn::Have(columns)
    }

    /// The block, waited for as long as another process is at it.
    fn wait(&self, block: usize) -> Columns {
        let mut said = Instant::now();
        loop {
            if let Turn::Have(columns) = self.take(block) {
                return columns;
            }
            if said.elapsed() > PATIENCE {
                let holder = std::fs::read_to_string(self.lock(block)).unwrap_or_default();
                (self.work.note)(&format!(
                    "waiting for block {block} of {}, which {holder} is at; if that process hangs, end it",
                    self.name
                ));
                said = Instant::now();
            }
            std::thread::sleep(POLL);
        }
    }
}

impl Transport for BlockFolder {
    fn enter(&self, stage: &str) {
        self.place.lock().unwrap_or_else(PoisonError::into_inner).0 = stage.into();
    }

    fn results(&self, work: &Work<'_>) -> Vec<Columns> {
        let name = {
            let mut place = self.place.lock().unwrap_or_else(PoisonError::into_inner);
            place.1 += 1;
            format!("{:03}-{}", place.1, place.0.replace([' ', '/'], "-"))
        };
        let folder = self.folder.join(&name);
        let made = std::fs::create_dir_all(&folder)
            .map_err(|e| Error::io(&folder, e))
            .and_then(|()| atomic_write(folder.join(COUNT), work.count.to_string().as_bytes()));
        if let Err(e) = made {
            self.complain(work, &e);
        }
        let call = Call {
            of: self,
            work,
            folder,
            name,
        };
        let found: Vec<OnceLock<Columns>> = (0..work.count).map(|_| OnceLock::new()).collect();
        let first = (self.shard.index - 1) * work.count / self.shard.of;
        (0..work.count)
            .into_par_iter()
            .with_max_len(1)
            .for_each(|k| {
                let block = (first + k) % work.count;
                if let Turn::Have(columns) = call.take(block) {
                    // nobody else in this process sets it
                    let _ = found[block].set(columns);
                }
            });
        let all = found.into_iter().enumerate();
        all.map(|(block, c)| c.into_inner().unwrap_or_else(|| call.wait(block)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const BLOCKS: usize = 13;

    fn one(block: usize) -> Columns {
        vec![vec![block as u8; block], b"end".to_vec()]
    }

    fn open(folder: &Path, run: &str, index: usize) -> BlockFolder {
        BlockFolder::open(folder, run, Shard { index, of: 3 }).expect("opened")
    }

    /// The results, the blocks computed for them, and what was said.
    fn results(of: &BlockFolder, slow: Duration) -> (Vec<Columns>, BTreeSet<usize>, Vec<String>) {
        let (computed, said) = (Mutex::new(BTreeSet::new()), Mutex::new(Vec::new()));
        of.enter("a stage");
        let all = of.results(&Work {
            count: BLOCKS,
            compute: &|block| {
                computed.lock().expect("held").insert(block);
                std::thread::sleep(slow);
                one(block)
            },
            note: &|text| said.lock().expect("held").push(text.to_owned()),
        });
        (
            all,
            computed.into_inner().expect("held"),
            said.into_inner().expect("held"),
        )
    }

    #[test]
    fn processes_share_the_blocks_and_all_have_all_results() {
        let dir = tempfile::tempdir().expect("temp");
        let slow = Duration::from_millis(10);
        let found: Vec<_> = std::thread::scope(|scope| {
            let work: Vec<_> = (1..=3)
                .map(|index| open(dir.path(), "run", index))
                .map(|shard| scope.spawn(move || results(&shard, slow)))
                .collect();
            work.into_iter().map(|w| w.join().expect("ran")).collect()
        });
        let expected: Vec<Columns> = (0..BLOCKS).map(one).collect();
        assert!(found.iter().all(|f| f.0 == expected && f.2.is_empty()));
        let computed: usize = found.iter().map(|f| f.1.len()).sum();
        assert_eq!(computed, BLOCKS, "each block once");
        // whoever comes later computes nothing
        let later = results(&open(dir.path(), "run", 2), slow);
        assert!(later.0 == expected && later.1.is_empty());
        let state = BlockFolder::state(dir.path()).expect("lists");
        assert_eq!((state[0].count, state[0].missing.len()), (BLOCKS, 0));
    }

    #[test]
    fn damaged_and_missing_blocks_are_computed_again_and_those_of_another_run_too() {
        let dir = tempfile::tempdir().expect("temp");
        let first = results(&open(dir.path(), "run", 1), Duration::ZERO);
        let call = dir.path().join("001-a-stage");
        std::fs::write(call.join(result_name(4)), b"not a block").expect("damage");
        std::fs::remove_file(call.join(result_name(7))).expect("there");
        // a whole block in the wrong place
        std::fs::copy(call.join(result_name(2)), call.join(result_name(9))).expect("copied");
        assert_eq!(
            BlockFolder::state(dir.path()).expect("lists")[0].missing,
            [7]
        );
        let again = results(&open(dir.path(), "run", 1), Duration::ZERO);
        assert_eq!(again.0, first.0);
        assert_eq!(again.1, BTreeSet::from([4, 7, 9]));
        assert!(again.2.len() == 2 && again.2.iter().all(|s| s.contains("is damaged")));
        let other = results(&open(dir.path(), "other", 1), Duration::ZERO);
        assert_eq!((other.0, other.1.len()), (first.0, BLOCKS));
    }

    #[test]
    fn a_folder_that_vanishes_costs_only_the_sharing() {
        let dir = tempfile::tempdir().expect("temp");
        let folder = dir.path().join("run");
        let of = open(&folder, "run", 1);
        std::fs::remove_dir_all(&folder).expect("there");
        std::fs::write(&folder, b"in the way").expect("file");
        let found = results(&of, Duration::ZERO);
        assert_eq!(found.0, (0..BLOCKS).map(one).collect::<Vec<_>>());
        assert!(
            found.2.len() == 1 && found.2[0].contains("cannot be shared"),
            "{:?}",
            found.2
        );
    }

    #[test]
    fn the_number_of_a_shard_lies_within_their_count() {
        assert_eq!("2/8".parse(), Ok(Shard { index: 2, of: 8 }));
        for wrong in ["0/8", "9/8", "1/0", "1", "a/2", "1/2/3", "-1/2", ""] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
