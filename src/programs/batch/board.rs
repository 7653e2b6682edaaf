//! Who works on which scene: `DIR/.batch/NAME/` holds a lock that dies with its process and
//! `state.json`, which only the lock's owner writes.

use super::list::Item;
use super::record::SceneRecord;
use super::table::Table;
use crate::core::formats::atomic_write;
use crate::core::lock::{Claim, WorkLock};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The output folder of a batch.
#[derive(Clone, Debug)]
pub struct Board {
    out: PathBuf,
    own: PathBuf,
}

impl Board {
    /// Makes the folder if need be.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn open(out: &Path) -> Result<Self> {
        if out.exists() && !out.is_dir() {
            let message = "is a file where a folder is to be made; give another name";
            return Err(Error::input(out, message));
        }
        let own = out.join(".batch");
        std::fs::create_dir_all(&own).map_err(|e| Error::io(&own, e))?;
        Ok(Self {
            out: out.into(),
            own,
        })
    }

    /// The folder of a scene's result.
    #[must_use]
    pub fn result(&self, item: &Item) -> PathBuf {
        self.out.join(&item.name)
    }

    fn desk(&self, item: &Item) -> PathBuf {
        self.own.join(&item.name)
    }

    /// Asks for a scene; does not wait.
    ///
    /// # Errors
    /// The board cannot be written to.
    pub fn claim(&self, item: &Item) -> Result<Claim> {
        let desk = self.desk(item);
        std::fs::create_dir_all(&desk).map_err(|e| Error::io(&desk, e))?;
        let claim = WorkLock::claim(&desk.join("lock"))?;
        if let Claim::Ours(lock) = &claim {
            lock.clear(&desk);
        }
        Ok(claim)
    }

    /// What is known of a scene; nothing where the file is missing or damaged.
    #[must_use]
    pub fn record(&self, item: &Item) -> SceneRecord {
        let bytes = std::fs::read(self.desk(item).join("state.json")).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    /// Puts down what became of a scene; for whoever has claimed it.
    ///
    /// # Errors
    /// The board cannot be written to.
    pub fn put(&self, item: &Item, record: &SceneRecord) -> Result<()> {
        let path = self.desk(item).join("state.json");
        let json = serde_json::to_vec_pretty(record)
            .map_err(|e| Error::Failed(format!("{}: {e}", path.display())))?;
        atomic_write(&path, &json)
    }

    /// Writes `batch.json` and `batch.md` of all scenes, one process at a time.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn merge(&self, list: &Path, items: &[Item]) -> Result<Table> {
        let lock = WorkLock::wait(&self.own.join("merge.lock"))?;
        if let Some(lock) = &lock {
            lock.clear(&self.out);
        }
        let records: Vec<SceneRecord> = items.iter().map(|i| self.record(i)).collect();
        let table = Table::new(list, items, records);
        let json = format!("{:#}\n", table.json());
        atomic_write(self.out.join("batch.json"), json.as_bytes())?;
        atomic_write(self.out.join("batch.md"), table.markdown().as_bytes())?;
        Ok(table)
    }
}
