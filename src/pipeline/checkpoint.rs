//! Resuming: what long stages computed lies in `OUT/.partial` until the run is complete.
//!
//! A run with the same inputs, options, seed and program finds it there and gives the same bits as
//! one that never stopped. A file is used only if its hash fits; anything else is computed again.
//! Nothing here can make a run fail: a disk without room is only noted. Files are written while the
//! next stage computes.

use crate::core::blocks::{Packed, opened, sealed};
use crate::core::formats::atomic_write;
use crate::core::progress::Progress;
use crate::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Name of the folder inside the output folder.
const FOLDER: &str = ".partial";

/// Where results of stages are kept; by default nowhere.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checkpoints {
    folder: Option<PathBuf>,
    writing: Arc<Writing>,
}

/// A file under way to the disk; whoever lets go of it last waits for it.
#[derive(Debug, Default)]
struct Writing(Mutex<Option<JoinHandle<Result<()>>>>);

impl PartialEq for Writing {
    /// What is under way changes nothing of where results are kept.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Writing {}

impl Writing {
    /// Begins to write; what was begun before is done ([`Self::wait`]).
    fn begin(&self, write: impl FnOnce() -> Result<()> + Send + 'static) -> Result<()> {
        let begun = std::thread::Builder::new().spawn(write);
        let begun = begun.map_err(|e| Error::Failed(format!("no thread to write it: {e}")))?;
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(begun);
        Ok(())
    }

    /// Waits for what was begun.
    fn wait(&self) -> Result<()> {
        let begun = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        let done = begun.map(JoinHandle::join);
        done.map_or(Ok(()), |d| d.unwrap_or(Ok(())))
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        // a file that failed is computed again by the run that misses it
        let _ = self.wait();
    }
}

impl Checkpoints {
    /// Results of the run `key` (a hash of everything it depends on) into the output folder `out`;
    /// those of other runs are removed.
    #[must_use]
    pub fn new(out: &Path, key: &str) -> Self {
        let all = out.join(FOLDER);
        let folder = all.join(key);
        if all.is_dir() && !folder.is_dir() {
            // of another run: no use to this one, and no harm if it stays
            let _ = std::fs::remove_dir_all(&all);
        }
        Self {
            folder: Some(folder),
            writing: Arc::default(),
        }
    }

    /// The kept result called `name`, or that of `compute`, which is then kept.
    pub fn reuse<T: Packed>(
        &self,
        name: &str,
        progress: &Progress,
        compute: impl FnOnce() -> T,
    ) -> T {
        let Some(folder) = &self.folder else {
            return compute();
        };
        let path = folder.join(name);
        if let Some(kept) = std::fs::read(&path)
            .ok()
            .and_then(|bytes| T::restored(&opened(name, &bytes)?))
        {
            progress.note(format!("{name}: taken over from the run that stopped"));
            return kept;
        }
        let value = compute();
        let (folder, bytes) = (folder.clone(), sealed(name, &value.columns()));
        let write = move || {
            std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
            atomic_write(&path, &bytes)
        };
        for done in [self.writing.wait(), self.writing.begin(write)] {
            if let Err(e) = done {
                progress.note(format!("results cannot be kept for a later run: {e}"));
            }
        }
        value
    }

    /// Removes what was kept: the run is complete.
    pub fn finish(&self) {
        // whether it was written makes no difference any more
        let _ = self.writing.wait();
        if let Some(all) = self.folder.as_ref().and_then(|f| f.parent()) {
            // a folder that will not go is found and removed by the next run
            let _ = std::fs::remove_dir_all(all);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::irradiance::Irradiance;
    use crate::observed::Fusion;
    use glam::Vec3;

    fn irradiance(x: f32) -> Irradiance {
        let v = Vec3::new(x, 2.0, 3.0);
        Irradiance {
            value: vec![v; 3],
            parts: vec![std::array::from_fn(|p| v * (p as f32 - 1.0)); 3],
            error: vec![0.1, 0.2, 0.3],
            rays: 9,
        }
    }

    fn same(a: &Irradiance, b: &Irradiance) -> bool {
        (&a.value, &a.parts, &a.error, a.rays) == (&b.value, &b.parts, &b.error, b.rays)
    }

    #[test]
    fn what_is_kept_comes_back_until_the_run_is_complete() {
        let dir = tempfile::tempdir().expect("temp");
        let p = Progress::silent();
        let run = Checkpoints::new(dir.path(), "key");
        assert!(same(
            &run.reuse("irradiance", &p, || irradiance(1.0)),
            &irradiance(1.0)
        ));
        drop(run);
        let again = Checkpoints::new(dir.path(), "key");
        assert!(same(
            &again.reuse("irradiance", &p, || panic!("kept")),
            &irradiance(1.0)
        ));
        // another run finds nothing, and removes what it cannot use
        let other = Checkpoints::new(dir.path(), "other");
        assert!(same(
            &other.reuse("irradiance", &p, || irradiance(5.0)),
            &irradiance(5.0)
        ));
        other.finish();
        assert_eq!(std::fs::read_dir(dir.path()).expect("lists").count(), 0);
    }

    #[test]
    fn damaged_files_are_computed_again() {
        let dir = tempfile::tempdir().expect("temp");
        let p = Progress::silent();
        let run = Checkpoints::new(dir.path(), "key");
        run.reuse("irradiance", &p, || irradiance(1.0));
        run.writing.wait().expect("written");
        let path = dir.path().join(FOLDER).join("key/irradiance");
        let whole = std::fs::read(&path).expect("kept");
        for (i, damaged) in [
            whole[..40].to_vec(),
            whole[..whole.len() - 1].to_vec(),
            Vec::new(),
        ]
        .into_iter()
        .enumerate()
        {
            std::fs::write(&path, damaged).expect("damage");
            assert!(same(
                &run.reuse("irradiance", &p, || irradiance(i as f32)),
                &irradiance(i as f32)
            ));
            run.writing.wait().expect("written");
        }
        let mut bit = whole.clone();
        bit[100] ^= 1;
        std::fs::write(&path, bit).expect("damage");
        assert!(same(
            &run.reuse("irradiance", &p, || irradiance(7.0)),
            &irradiance(7.0)
        ));
        // of another kind
        assert!(Fusion::restored(&opened("irradiance", &whole).expect("whole")).is_none());
    }

    #[test]
    fn a_run_that_ends_early_has_kept_what_it_had() {
        let dir = tempfile::tempdir().expect("temp");
        let p = Progress::silent();
        let run = Checkpoints::new(dir.path(), "key");
        for (name, x) in [("radiance", 1.0), ("irradiance", 2.0)] {
            run.clone().reuse(name, &p, || irradiance(x));
        }
        drop(run);
        let again = Checkpoints::new(dir.path(), "key");
        for (name, x) in [("radiance", 1.0), ("irradiance", 2.0)] {
            let kept = again.reuse(name, &p, || panic!("{name} was kept"));
            assert!(same(&kept, &irradiance(x)));
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_no_failure() {
        let dir = tempfile::tempdir().expect("temp");
        std::fs::write(dir.path().join(FOLDER), b"in the way").expect("file");
        let run = Checkpoints::new(dir.path(), "key");
        assert!(same(
            &run.reuse("irradiance", &Progress::silent(), || irradiance(1.0)),
            &irradiance(1.0)
        ));
    }
}
