//! Resuming: what long stages computed lies in `OUT/.partial` until the run is complete.
//!
//! A run with the same inputs, options, seed and program finds it there and gives the same bits as
//! one that never stopped. A file is used only if its hash fits; anything else is computed again.
//! Nothing here can make a run fail: a disk without room is only noted.

use crate::core::formats::atomic_write;
use crate::core::progress::Progress;
use crate::irradiance::Irradiance;
use crate::observed::Fusion;
use bytemuck::{NoUninit, Pod};
use std::path::{Path, PathBuf};

/// Name of the folder inside the output folder.
const FOLDER: &str = ".partial";

/// Where results of stages are kept; by default nowhere.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checkpoints {
    folder: Option<PathBuf>,
}

/// A result that can be kept: columns of plain numbers.
pub trait Kept: Sized {
    /// The columns as bytes.
    fn columns(&self) -> Vec<Vec<u8>>;
    /// The result of `columns`; `None` if they are not its own.
    fn restored(columns: &[Vec<u8>]) -> Option<Self>;
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
        }
    }

    /// The kept result called `name`, or that of `compute`, which is then kept.
    pub fn reuse<T: Kept>(
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
            .and_then(|bytes| T::restored(&unpacked(&bytes)?))
        {
            progress.note(format!("{name}: taken over from the run that stopped"));
            return kept;
        }
        let value = compute();
        let written = std::fs::create_dir_all(folder)
            .map_err(|e| crate::Error::io(folder, e))
            .and_then(|()| atomic_write(&path, &packed(&value.columns())));
        if let Err(e) = written {
            progress.note(format!("{name} cannot be kept for a later run: {e}"));
        }
        value
    }

    /// Removes what was kept: the run is complete.
    pub fn finish(&self) {
        if let Some(all) = self.folder.as_ref().and_then(|f| f.parent()) {
            // a folder that will not go is found and removed by the next run
            let _ = std::fs::remove_dir_all(all);
        }
    }
}

/// Hash of the content, number of columns, then each column with its length.
fn packed(columns: &[Vec<u8>]) -> Vec<u8> {
    let mut body = (columns.len() as u64).to_le_bytes().to_vec();
    for c in columns {
        body.extend((c.len() as u64).to_le_bytes());
        body.extend(c);
    }
    let mut out = blake3::hash(&body).as_bytes().to_vec();
    out.extend(body);
    out
}

fn unpacked(bytes: &[u8]) -> Option<Vec<Vec<u8>>> {
    let (hash, body) = bytes.split_at_checked(blake3::OUT_LEN)?;
    if blake3::hash(body).as_bytes() != hash {
        return None;
    }
    let number = |at: &mut &[u8]| -> Option<usize> {
        let (n, rest) = at.split_at_checked(8)?;
        *at = rest;
        usize::try_from(u64::from_le_bytes(n.try_into().ok()?)).ok()
    };
    let mut rest = body;
    let count = number(&mut rest)?;
    (0..count)
        .map(|_| {
            let length = number(&mut rest)?;
            let (column, after) = rest.split_at_checked(length)?;
            rest = after;
            Some(column.to_vec())
        })
        .collect()
}

fn column<T: NoUninit>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}

fn values<T: Pod>(column: &[u8]) -> Option<Vec<T>> {
    let size = size_of::<T>();
    column.len().is_multiple_of(size).then(|| {
        column
            .chunks_exact(size)
            .map(bytemuck::pod_read_unaligned)
            .collect()
    })
}

impl Kept for Fusion {
    fn columns(&self) -> Vec<Vec<u8>> {
        let Self {
            radiance,
            clean,
            peak,
            views,
            label,
            floor,
        } = self;
        let clean: Vec<u8> = clean.iter().map(|c| u8::from(*c)).collect();
        vec![
            column(radiance),
            clean,
            column(peak),
            views.clone(),
            column(label),
            column(floor),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [radiance, clean, peak, views, label, floor] = columns else {
            return None;
        };
        Some(Self {
            radiance: values(radiance)?,
            clean: clean.iter().map(|c| *c != 0).collect(),
            peak: values(peak)?,
            views: views.clone(),
            label: values(label)?,
            floor: values(floor)?,
        })
    }
}

impl Kept for Irradiance {
    fn columns(&self) -> Vec<Vec<u8>> {
        let Self {
            value,
            parts,
            error,
            rays,
        } = self;
        vec![
            column(value),
            column(parts),
            column(error),
            column(&[*rays]),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [value, parts, error, rays] = columns else {
            return None;
        };
        let rays = values(rays)?.first().copied()?;
        Some(Self {
            value: values(value)?,
            parts: values(parts)?,
            error: values(error)?,
            rays,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        }
        let mut bit = whole.clone();
        bit[100] ^= 1;
        std::fs::write(&path, bit).expect("damage");
        assert!(same(
            &run.reuse("irradiance", &p, || irradiance(7.0)),
            &irradiance(7.0)
        ));
        // of another kind
        assert!(Fusion::restored(&unpacked(&whole).expect("whole")).is_none());
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
