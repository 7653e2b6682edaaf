//! Material edits: a small list in `edits.toml`, applied to a copy of the solution; the light
//! follows.
//!
//! An edit chooses surfaces (class, room, a picked point, a mask on the atlas) and changes their
//! albedo and roughness. The output folder of `unbake solve` keeps its textures; the list lies
//! beside them in `edits.toml` and the edited solution, complete, in `edited/`. What reads a
//! solution for display reads the edited one through [`load_edited`], which makes it again if the
//! list has changed.

mod apply;
mod list;
mod rebake;
mod select;

pub use apply::{Edited, apply_edits};
pub use list::{EDITS, Edit, EditList, Mapping, Paint, TextureSet};
pub use rebake::{Bounces, follow_light};
pub use select::{Selection, Selector};

use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::solution::{SaveOptions, Solution};
use std::path::{Path, PathBuf};

/// Folder of the edited solution in an output folder.
pub const EDITED: &str = "edited";
/// File in it that tells from which list and solution it was made.
const STAMP: &str = "edits.stamp";

/// The solution in `folder` with its edits, if there are any.
///
/// # Errors
/// The solution or its list of edits cannot be used.
pub fn load_edited(folder: &Path, progress: &Progress) -> Result<Solution> {
    let list = folder.join(EDITS);
    if !list.is_file() {
        return Solution::load(folder);
    }
    let edited = folder.join(EDITED);
    if std::fs::read_to_string(edited.join(STAMP)).is_ok_and(|s| Some(s) == stamp(folder).ok()) {
        return Solution::load(&edited);
    }
    progress.note(format!(
        "{}: changed since the edited solution was made; applying it",
        list.display()
    ));
    apply_to_folder(folder, &[], 0, progress).map(|e| e.solution)
}

/// Applies `edits.toml` of an output folder and writes the edited solution whole into `edited/`.
///
/// # Errors
/// The solution, its list, or a texture named there cannot be used; writing fails.
pub fn apply_to_folder(
    folder: &Path,
    classes: &[(u16, String)],
    seed: u64,
    progress: &Progress,
) -> Result<Edited> {
    let list = EditList::read(&folder.join(EDITS))?;
    let solution = Solution::load(folder)?;
    let edited = apply_edits(&solution, &list, folder, classes, seed, progress)?;
    let to = folder.join(EDITED);
    progress.stage("writing the edited solution", 1, |_| {
        edited.solution.save(&to, &SaveOptions::default())
    })?;
    let path = to.join(STAMP);
    std::fs::write(&path, stamp(folder)?).map_err(|e| Error::io(&path, e))?;
    Ok(edited)
}

/// What the edited solution depends on: the list, the textures it names, and the solution (by the
/// size and time of its last file).
fn stamp(folder: &Path) -> Result<String> {
    let path = folder.join(EDITS);
    let text = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
    let mut hash = blake3::Hasher::new();
    hash.update(&text);
    let list = EditList::read(&path)?;
    let named = list.edits.iter().flat_map(Edit::files);
    let files: Vec<PathBuf> = named
        .map(|f| folder.join(f))
        .chain([folder.join("scene.glb")])
        .collect();
    for file in files {
        let meta = std::fs::metadata(&file).map_err(|e| {
            Error::input(
                &file,
                format!(
                    "cannot be read ({e}); it is needed to apply {}",
                    path.display()
                ),
            )
        })?;
        let time = meta
            .modified()
            .ok()
            .and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
        hash.update(&meta.len().to_le_bytes());
        hash.update(&time.map_or(0, |t| t.as_nanos()).to_le_bytes());
    }
    Ok(hash.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests;
