//! `unbake export`.

use crate::cli::context::Context;
use crate::cli::frames::FrameSource;
use crate::cli::inputs::{read_scene, read_solution};
use crate::error::Result;
use crate::programs::export::{ClassName, Exported, Lightings, Split, export_lightings};
use crate::programs::report::{RunRecord, class_names};
use crate::programs::run::keep_inputs;
use crate::solution::Solution;
use serde_json::json;
use std::path::Path;

/// `unbake export`.
pub(crate) fn export(
    out: &Path,
    places: &FrameSource,
    lightings: Option<&Path>,
    context: &Context,
) -> Result<()> {
    let options = &context.config.export;
    let solution = read_solution(out, &context.progress)?;
    let cameras = match lightings {
        None => places.frames(out, &options.frames, &solution, context)?,
        Some(_) => Vec::new(),
    };
    let classes = match options.formats.split {
        Split::None => Vec::new(),
        Split::Classes | Split::Objects => names_of_classes(out, places, context)?,
    };
    let (folder, _lock) = places.folder(out, "export")?;
    let exported = Exported {
        solution: &solution,
        classes: &classes,
        cameras: &cameras,
    };
    let files = match lightings {
        None => context.progress.stage("exporting", 1, |_| {
            crate::programs::export::export(&folder, &exported, &options.formats)
        })?,
        Some(list) => {
            let list = read_lightings(list, out, &folder, &solution, context)?;
            let formats = &options.formats;
            export_lightings(&folder, &exported, &list, formats, &context.progress)?
        }
    };
    let text = format!("{}: {}\n", folder.display(), files.join(" "));
    context.result(&text, &json!({"folder": folder, "files": files}))
}

/// The lightings of a file, none of whose inputs lies where the files go.
fn read_lightings(
    list: &Path,
    out: &Path,
    folder: &Path,
    solution: &Solution,
    context: &Context,
) -> Result<Lightings> {
    let mut read = Lightings::read(list, &solution.lamps, context.seed())?;
    let mut inputs = vec![list.to_path_buf()];
    for named in &mut read.list {
        inputs.extend(named.lighting.files().map(|f| f.clone()));
    }
    keep_inputs(folder, out, &inputs)?;
    Ok(read)
}

/// The names of the classes as the run wrote them down; of older results, those of the scene that
/// is given.
fn names_of_classes(out: &Path, places: &FrameSource, context: &Context) -> Result<Vec<ClassName>> {
    let written = RunRecord::class_names_of(out)?;
    match &places.scene {
        Some(scene) if written.is_empty() => Ok(class_names(&read_scene(scene, context)?)),
        None if written.is_empty() => {
            context.progress.note(
                "manifest.json has no names of classes (it is older, or missing): objects are called \"class 7\"; \
                 give --scene SCENE for their names",
            );
            Ok(written)
        }
        _ => Ok(written),
    }
}
