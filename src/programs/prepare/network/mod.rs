//! Depth and labels by networks that the user brings as ONNX files: what a photograph shows goes tile by tile
//! (`tiles`) through a network (`model`, run by `engine`), and comes back as what captures bring themselves: depth images
//! (`depth`, brought to one scale by `fit`) and label images (`semantic`). Called by `write`, once positions are metres.

mod depth;
#[cfg(feature = "onnx")]
mod engine;
mod engine_types;
mod fit;
mod model;
#[cfg(not(feature = "onnx"))]
mod no_engine;
mod options;
mod semantic;
mod tiles;

#[cfg(test)]
mod fit_tests;

pub use options::{DepthFit, DepthValues, NetworkOptions, PanoramaTiles};

use super::account::Account;
use super::capture::{Capture, Surface};
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use model::Model;
use std::path::Path;
use tempfile::TempDir;

/// Gives the capture's photographs depth and labels by the networks of `options`. The files lie in the folder that is
/// returned, and go with it; `None` where no network is asked. `meshed` says that there is a mesh: then depth is of no use.
///
/// # Errors
/// [`Error::Usage`] for settings that mean nothing or a program built without networks, [`Error::Input`] for a file that is
/// no usable network, a photograph that cannot be read, or depths that nothing brings to one scale.
pub(super) fn predict(
    capture: &mut Capture,
    meshed: bool,
    options: &NetworkOptions,
    account: &mut Account,
    progress: &Progress,
) -> Result<Option<TempDir>> {
    if options.semantic_names.is_some() && options.semantic_model.is_none() {
        return Err(Error::Usage(
            "--semantic-names: names the classes of a network; give it with --semantic-model"
                .into(),
        ));
    }
    if options.depth_model.is_none() && options.semantic_model.is_none() {
        return Ok(None);
    }
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    match &options.depth_model {
        Some(_) if meshed => account.ignored(
            "--depth-model: the capture has a mesh, which is better than depth by a network; take the mesh away to use it",
        ),
        Some(path) => {
            let mut model = load(path, options, account)?;
            depth::predict(&mut capture.shots, &mut model, options, folder.path(), account, progress)?;
        }
        None => {}
    }
    if let Some(path) = &options.semantic_model {
        let mut model = load(path, options, account)?;
        semantic::predict(
            capture,
            &mut model,
            options,
            folder.path(),
            account,
            progress,
        )?;
        if let Some(Surface::Built(mesh)) = &mut capture.surface {
            mesh.classes.clear();
        }
    }
    Ok(Some(folder))
}

/// Reads a network and says so.
fn load(path: &Path, options: &NetworkOptions, account: &mut Account) -> Result<Model> {
    let model = Model::load(path, options)?;
    account.read(format!(
        "network {}, input {}",
        path.display(),
        model.input()
    ));
    Ok(model)
}
