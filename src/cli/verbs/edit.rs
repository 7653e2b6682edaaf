//! `unbake edit`.

use crate::cli::context::Context;
use crate::cli::inputs::read_scene;
use crate::core::lock::OutputLock;
use crate::error::{Error, Result};
use crate::programs::edit::{EDITED, EDITS, EditList, apply_to_folder};
use crate::programs::report::RunRecord;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// `unbake edit`.
pub(crate) fn edit(
    out: &Path,
    edits: Option<&Path>,
    scene: Option<&Path>,
    clear: bool,
    context: &Context,
) -> Result<()> {
    let list = out.join(EDITS);
    if clear {
        for (path, removed) in [
            (&list, std::fs::remove_file(&list)),
            (&out.join(EDITED), std::fs::remove_dir_all(out.join(EDITED))),
        ] {
            if let Err(e) = removed
                && e.kind() != std::io::ErrorKind::NotFound
            {
                return Err(Error::io(path, e));
            }
        }
        return context.result(
            &format!("{}: no edits any more\n", out.display()),
            &json!({"out": out, "edits": 0}),
        );
    }
    let _lock = OutputLock::acquire(out, &[EDITED])?;
    let before = std::fs::read(&list).ok();
    if let Some(file) = edits {
        let mut taken = EditList::read(file)?;
        if taken.anchor(file)? {
            taken.save(&list)?;
        } else {
            let text = std::fs::read(file).map_err(|e| Error::io(file, e))?;
            crate::core::formats::atomic_write(&list, &text)?;
        }
    } else if !list.is_file() {
        return Err(Error::Usage(format!(
            "{} does not exist: give the edits with --edits FILE",
            list.display()
        )));
    }
    let done = apply_list(out, &list, scene, context).map_err(|e| match (e, edits) {
        // the copy is taken away again: what is wrong stands in the file given
        (Error::Input { path, message }, Some(file)) if path == list => Error::input(file, message),
        (e, _) => e,
    });
    if done.is_err() && edits.is_some() {
        // a list that cannot be applied must not stand in the way of the next `render`
        match before {
            Some(bytes) => crate::core::formats::atomic_write(&list, &bytes)?,
            None => std::fs::remove_file(&list).map_err(|e| Error::io(&list, e))?,
        }
    }
    done
}

fn apply_list(out: &Path, list: &Path, scene: Option<&Path>, context: &Context) -> Result<()> {
    let classes: Vec<(u16, String)> = match scene {
        Some(path) => read_scene(path, context)?
            .classes
            .into_iter()
            .map(|c| (c.id, c.name))
            .collect(),
        None => {
            let names = RunRecord::class_names_of(out)?.into_iter();
            names.map(|c| (c.id, c.name)).collect()
        }
    };
    // names are turned into ids once, so that the list can be applied where the scene is not at
    // hand
    let mut resolved = EditList::read(list)?;
    if resolved.name_classes(&classes) {
        resolved.save(list)?;
    }
    let clock = Instant::now();
    let edited = apply_to_folder(out, &classes, context.seed(), &context.progress)?;
    let mut text = String::new();
    for (i, n) in edited.texels.iter().enumerate() {
        text.push_str(&format!("edit {i}: {n} texels\n"));
    }
    let bounces: Vec<String> = edited
        .bounces
        .iter()
        .map(|b| format!("{:.2} %", 100.0 * b))
        .collect();
    text.push_str(&format!(
        "light followed over {} bounces (change of irradiance {}), {:.1} s\n{}\n",
        bounces.len(),
        bounces.join(", "),
        clock.elapsed().as_secs_f64(),
        out.join(EDITED).display()
    ));
    context.result(
        &text,
        &json!({"out": out, "texels": edited.texels, "bounces": edited.bounces}),
    )
}
