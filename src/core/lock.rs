//! One writer per output folder: an advisory lock (`flock`) on the folder itself.
//!
//! Two runs into one folder would interleave their renames file by file, and one would remove what
//! the other keeps for resuming. Whoever holds the lock also clears what killed runs left behind:
//! hidden `.writing-*` folders and `.name.*.part` files.
//!
//! Pieces of work that several processes share (scenes of `unbake batch`, blocks of `unbake solve --shard`) have a lock file each, opened for
//! writing: over NFS the lock then is the server's and counts between machines.

use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// The right to write into an output folder; given up when dropped, or when the process dies.
#[derive(Debug)]
pub struct OutputLock {
    /// Holds the lock; `None` on a file system that has none.
    _held: Option<File>,
}

impl OutputLock {
    /// Makes `folder` if need be, takes its lock and removes what killed runs left in it and in the
    /// folders of `below` in it.
    ///
    /// # Errors
    /// The folder cannot be made or opened, or another process is writing into it.
    pub fn acquire(folder: &Path, below: &[&str]) -> Result<Self> {
        make_folder(folder)?;
        let open = File::open(folder).map_err(|e| Error::io(folder, e))?;
        let held = match open.try_lock() {
            Ok(()) => Some(open),
            Err(TryLockError::WouldBlock) => {
                return Err(Error::input(
                    folder,
                    "another run is writing into this folder; wait for it to end, or give another folder",
                ));
            }
            // some network file systems have no locks: no reason not to work there
            Err(TryLockError::Error(_)) => None,
        };
        if held.is_some() {
            clear(folder);
            below.iter().for_each(|name| clear(&folder.join(name)));
        }
        Ok(Self { _held: held })
    }
}

/// The right to a piece of work that several processes share; given up when dropped, or when the
/// process dies.
#[derive(Debug)]
pub struct WorkLock {
    _held: File,
}

/// What became of asking for a piece of work.
#[derive(Debug)]
pub enum Claim {
    /// It is ours as long as this lives.
    Ours(WorkLock),
    /// Another process has it.
    Theirs,
    /// The file system has no locks: nobody can tell.
    NoLocks,
}

impl WorkLock {
    /// Asks for the lock of `file`, which is made if need be, and stays; does not wait.
    ///
    /// # Errors
    /// The file cannot be made or opened.
    pub fn claim(file: &Path) -> Result<Claim> {
        let open = open_lock(file)?;
        Ok(match open.try_lock() {
            Ok(()) => Claim::Ours(Self { _held: open }),
            Err(TryLockError::WouldBlock) => Claim::Theirs,
            Err(TryLockError::Error(_)) => Claim::NoLocks,
        })
    }

    /// Waits for the lock of `file`; `None` where the file system has no locks.
    ///
    /// # Errors
    /// The file cannot be made or opened.
    pub fn wait(file: &Path) -> Result<Option<Self>> {
        let open = open_lock(file)?;
        Ok(open.lock().is_ok().then_some(Self { _held: open }))
    }

    /// Removes what killed runs left in a folder that this lock is for.
    pub fn clear(&self, folder: &Path) {
        clear(folder);
    }
}

/// Machine and process of this run, as others are told who has a piece of work.
#[must_use]
pub fn worker() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    format!("{}:{}", host.trim(), std::process::id())
}

fn open_lock(file: &Path) -> Result<File> {
    let mut options = File::options();
    options.write(true).create(true).truncate(false);
    options.open(file).map_err(|e| Error::io(file, e))
}

/// Creates a folder and those above it, with words for what may be in the way.
fn make_folder(folder: &Path) -> Result<()> {
    let dangling = folder.symlink_metadata().is_ok() && !folder.exists();
    if dangling {
        return Err(Error::input(
            folder,
            "is a link that leads nowhere; remove it or make the folder it names",
        ));
    }
    if folder.is_file() {
        return Err(Error::input(
            folder,
            "is a file where a folder is to be made; give another name",
        ));
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))
}

/// Removes left-overs; what cannot be removed stays, and does no harm but take room.
fn clear(folder: &Path) {
    for path in left_over(folder) {
        let _ = if path.is_dir() {
            std::fs::remove_dir_all(&path)
        } else {
            std::fs::remove_file(&path)
        };
    }
}

/// What killed runs left in a folder.
fn left_over(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    // the endings that `tempfile` gives, or process and count of older versions
    let ending = |s: &str| {
        let count = s
            .split_once('-')
            .is_some_and(|(a, b)| number(a) && number(b));
        count || number(s) || (s.len() == 6 && s.bytes().all(|b| b.is_ascii_alphanumeric()))
    };
    let is_left = |name: &str| -> bool {
        if let Some(end) = name.strip_prefix(".writing-") {
            return ending(end);
        }
        let part = |rest: &str| -> Option<bool> {
            let (name, end) = rest.strip_suffix(".part")?.rsplit_once('.')?;
            Some(!name.is_empty() && ending(end))
        };
        name.strip_prefix('.').and_then(part).unwrap_or(false)
    };
    entries
        .filter(|e| is_left(&e.file_name().to_string_lossy()))
        .map(|e| e.path())
        .collect()
}

fn number(s: &str) -> bool {
    !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_writer_at_a_time() {
        let dir = tempfile::tempdir().expect("temp");
        let out = dir.path().join("deep/out");
        let held = OutputLock::acquire(&out, &[]).expect("free");
        let e = OutputLock::acquire(&out, &[]).expect_err("taken");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("another run"),
            "{e}"
        );
        drop(held);
        OutputLock::acquire(&out, &[]).expect("free again");
    }

    #[test]
    fn a_piece_of_work_has_one_owner() {
        let dir = tempfile::tempdir().expect("temp");
        let file = dir.path().join("lock");
        let Claim::Ours(ours) = WorkLock::claim(&file).expect("made") else {
            panic!("free");
        };
        assert!(matches!(WorkLock::claim(&file), Ok(Claim::Theirs)));
        drop(ours);
        assert!(matches!(WorkLock::claim(&file), Ok(Claim::Ours(_))));
        assert!(WorkLock::wait(&file).expect("opens").is_some());
        assert!(WorkLock::claim(&dir.path().join("none/lock")).is_err());
    }

    #[test]
    fn rubbish_of_killed_runs_goes_and_nothing_else() {
        let dir = tempfile::tempdir().expect("temp");
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir_all(at(".writing-12/x")).expect("folder");
        std::fs::create_dir_all(at("eval/.writing-7")).expect("folder");
        std::fs::create_dir_all(at(".partial")).expect("folder");
        let rubbish = [".report.json.12-3.part", ".a.b.exr.Xy12zZ.part"];
        let kept = [
            "albedo.exr",
            ".part",
            ".x.part",
            ".writing-my-own",
            "a.1-2.part",
            ".1-2.part",
        ];
        for name in rubbish.iter().chain(&kept) {
            std::fs::write(at(name), b"x").expect("file");
        }
        OutputLock::acquire(dir.path(), &["eval"]).expect("free");
        assert!(!at(".writing-12").exists() && !at("eval/.writing-7").exists());
        assert!(rubbish.iter().all(|n| !at(n).exists()));
        assert!(kept.iter().all(|n| at(n).exists()) && at(".partial").exists());
    }

    #[test]
    fn what_is_in_the_way_is_named() {
        let dir = tempfile::tempdir().expect("temp");
        let link = dir.path().join("link");
        std::os::unix::fs::symlink(dir.path().join("nowhere"), &link).expect("link");
        let file = dir.path().join("file");
        std::fs::write(&file, b"x").expect("file");
        for (path, said) in [(&link, "leads nowhere"), (&file, "is a file")] {
            let e = OutputLock::acquire(path, &[]).expect_err("refused");
            assert!(e.exit_code() == 2 && e.to_string().contains(said), "{e}");
        }
    }
}
