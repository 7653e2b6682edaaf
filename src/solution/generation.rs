//! The generation of an output folder: a mark in each of its files by which a mixture of two runs is
//! refused (a kill between two renames leaves one). Called by whatever reads such a folder.

use crate::core::formats::generation_mark;
use crate::error::{Error, Result};
use std::path::Path;

/// The texture whose mark stands for the folder's.
const MARKED: &str = "albedo.exr";

/// The refusal of a file that another run wrote than the rest of its folder.
pub(super) fn other_run(path: &Path) -> Error {
    Error::input(
        path,
        "is of another run than scene.glb: a run was stopped while it wrote, or files were mixed. Run `unbake solve` again",
    )
}

/// Refuses a file beside a solution (a manifest) that says it is of `generation`, where the
/// solution's textures are of another. Without a mark on either side nothing is known, and nothing
/// refused.
///
/// # Errors
/// The file is of another run, or the textures cannot be read.
pub fn check_generation(folder: &Path, name: &str, generation: &str) -> Result<()> {
    let texture = folder.join(MARKED);
    if generation.is_empty() || !texture.is_file() {
        return Ok(());
    }
    match generation_mark(&texture)? {
        Some(mark) if mark != generation => Err(other_run(&folder.join(name))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::SaveOptions;
    use crate::solution::tests::small_solution;

    #[test]
    fn a_manifest_of_another_run_is_refused() {
        let folder = tempfile::tempdir().expect("temp");
        let check = |generation: &str| check_generation(folder.path(), "manifest.json", generation);
        check("anything").expect("no solution, nothing to contradict");
        let own = small_solution()
            .save(folder.path(), &SaveOptions::default())
            .expect("saves");
        check(&own).expect("its own");
        check("").expect("a manifest of an older version");
        let e = check("0123").expect_err("another's");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("manifest.json"),
            "{e}"
        );
    }
}
