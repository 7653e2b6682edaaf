//! No verb may overwrite what it reads: an output folder in which an input lies is refused.

use crate::error::{Error, Result};
use crate::programs::report::{InputFile, RunRecord};
use crate::solution::FILES;
use std::path::{Path, PathBuf};

/// What makes a folder a scene.
const SCENE: &str = "transforms.json";
/// What makes a folder a result.
const RESULT: &str = FILES[0];

/// Refuses `out` if it is `scene`'s folder or any of `inputs` lies directly in it.
///
/// Names do not count, only the folder: later versions write other names. Inputs in folders below
/// are safe, since outputs there have folders of their own.
///
/// # Errors
/// An input lies in `out`, or another scene; the message names it.
pub fn keep_inputs(out: &Path, scene: &Path, inputs: &[PathBuf]) -> Result<()> {
    // what does not exist yet holds nothing
    let Ok(out_really) = out.canonicalize() else {
        return Ok(());
    };
    if scene.canonicalize().is_ok_and(|s| s == out_really) {
        return Err(Error::Usage(format!(
            "{}: is the scene itself; give another output folder",
            out.display()
        )));
    }
    if out.join(SCENE).is_file() {
        return Err(Error::Usage(format!(
            "{}: holds {SCENE}, which makes it a scene; give another output folder",
            out.display()
        )));
    }
    // a link is safe where it leads and where it lies
    let in_out = |p: &PathBuf| {
        let lies = p.parent().and_then(|f| f.canonicalize().ok());
        let leads = p.canonicalize().ok();
        let leads = leads.as_deref().and_then(Path::parent);
        lies.as_deref() == Some(&out_really) || leads == Some(&out_really)
    };
    match inputs.iter().find(|p| in_out(p)) {
        None => Ok(()),
        Some(input) => Err(Error::Usage(format!(
            "{}: holds {}, which is read; give another output folder",
            out.display(),
            input.display()
        ))),
    }
}

/// Refuses `out` if a result of `solve` lies in it, for verbs that write something else: what they
/// write has names of a result's files.
///
/// # Errors
/// A result lies in `out`.
pub fn keep_results(out: &Path) -> Result<()> {
    // `scene.glb` alone may be an earlier export
    match out.join(RESULT).is_file() {
        false => Ok(()),
        true => Err(Error::Usage(format!(
            "{}: holds {RESULT}, which makes it a result of solve; give another output folder",
            out.display()
        ))),
    }
}

/// Refuses `out` if the result of another scene lies in it: one that shares no file with `inputs`.
///
/// # Errors
/// Another scene's result lies in `out`; the message names it.
pub fn keep_other_results(out: &Path, inputs: &[InputFile]) -> Result<()> {
    let Some(record) = RunRecord::read_manifest(out).filter(|_| out.join(RESULT).is_file()) else {
        return Ok(());
    };
    let shared = |file: &InputFile| inputs.iter().any(|i| i.blake3 == file.blake3);
    match record.inputs.is_empty() || record.inputs.iter().any(shared) {
        true => Ok(()),
        false => Err(Error::Usage(format!(
            "{}: holds the result of another scene ({:?}: none of its files is among those given); give another output folder, or remove this one",
            out.display(),
            record.scene.name
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_that_hold_inputs_are_refused() {
        let dir = tempfile::tempdir().expect("temp");
        let scene = dir.path().join("s");
        std::fs::create_dir_all(scene.join("images")).expect("folders");
        let image = scene.join("images/a.exr");
        std::fs::write(&image, b"x").expect("file");
        let linked = dir.path().join("linked");
        std::os::unix::fs::symlink(scene.join("images"), &linked).expect("link");
        let inputs = [image];
        for out in [
            scene.clone(),
            scene.join("./images/.."),
            scene.join("images"),
            linked,
        ] {
            assert!(
                keep_inputs(&out, &scene, &inputs).is_err(),
                "{}",
                out.display()
            );
        }
        for out in [scene.join("out"), dir.path().to_path_buf()] {
            assert!(
                keep_inputs(&out, &scene, &inputs).is_ok(),
                "{}",
                out.display()
            );
        }
    }

    #[test]
    fn a_link_to_an_input_elsewhere_protects_both_places() {
        let dir = tempfile::tempdir().expect("temp");
        let (scene, store) = (dir.path().join("s"), dir.path().join("store"));
        std::fs::create_dir_all(&scene).expect("folder");
        std::fs::create_dir_all(&store).expect("folder");
        std::fs::write(store.join("a.exr"), b"x").expect("file");
        let image = scene.join("a.exr");
        std::os::unix::fs::symlink(store.join("a.exr"), &image).expect("link");
        assert!(keep_inputs(&store, &scene, std::slice::from_ref(&image)).is_err());
    }

    #[test]
    fn other_scenes_and_results_are_kept() {
        let dir = tempfile::tempdir().expect("temp");
        let folder = |name: &str, file: &str| {
            let folder = dir.path().join(name);
            std::fs::create_dir_all(&folder).expect("folder");
            std::fs::write(folder.join(file), b"x").expect("file");
            folder
        };
        let (scene, other) = (folder("s", SCENE), folder("t", SCENE));
        let (result, export) = (folder("r", RESULT), folder("e", "scene.glb"));
        assert!(keep_inputs(&other, &scene, &[]).is_err());
        assert!(keep_results(&result).is_err());
        for out in [&result, &export] {
            assert!(keep_inputs(out, &scene, &[]).is_ok());
        }
        assert!(keep_results(&export).is_ok() && keep_results(&dir.path().join("new")).is_ok());
    }

    /// A run may be repeated into its folder, with some files changed, too; a run of another scene may not.
    #[test]
    fn the_result_of_another_scene_is_kept() {
        let dir = tempfile::tempdir().expect("temp");
        let file = |hash: &str| InputFile {
            blake3: hash.into(),
            ..InputFile::default()
        };
        let out = dir.path();
        assert!(keep_other_results(out, &[file("a")]).is_ok());
        let record = RunRecord {
            inputs: vec![file("a"), file("b")],
            ..RunRecord::default()
        };
        let text = serde_json::to_vec(&record).expect("a record");
        std::fs::write(out.join("manifest.json"), text).expect("writes");
        std::fs::write(out.join(RESULT), b"x").expect("writes");
        assert!(keep_other_results(out, &[file("b"), file("c")]).is_ok());
        let e = keep_other_results(out, &[file("c")]).expect_err("another scene");
        assert!(e.exit_code() == 2 && e.to_string().contains("another scene"));
    }
}
