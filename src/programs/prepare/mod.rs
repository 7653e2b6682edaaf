//! `unbake prepare`: from what devices and programs export to a scene folder (docs/scene-format.md).
//!
//! One [`Importer`] per source, found by looking at the folder; it returns a [`Capture`] (posed
//! photographs, a surface, rooms) and writes into an [`Account`] what it read, converted and
//! ignored. What all sources share stands here once: rendering labels from the surface, resampling
//! photographs of lenses the solver does not model, the scene folder itself ([`write_scene`]).
//! Called by `cli`.

mod account;
mod alicevision;
mod brackets;
mod camera_axes;
mod capture;
mod colmap;
mod colmap_files;
mod creases;
mod depth_mesh;
mod floor_plan;
mod folder;
mod frame;
mod importer;
mod labels;
mod lens;
mod metashape;
mod nerfstudio;
mod network;
mod opensfm;
mod orient;
mod plan;
mod ply_out;
mod polycam;
mod range_image;
mod realityscan;
mod roomplan;
mod scan;
mod scanner_app;
mod surface_nets;
mod texir;
mod usd_files;
mod usd_layer;
mod usd_mesh;
mod usd_stage;
#[cfg(test)]
mod usd_tests;
mod usd_xform;
mod usda;
mod usdc;
mod usdc_bytes;
mod usdc_kinds;
mod usdc_tables;
mod write;
mod zind;

pub use account::Account;
pub use capture::{Capture, Depth, LabelledMesh, Mask, RoomIds, RoomOutline, Shot, Surface, Up};
pub use floor_plan::{ROOMS, write_floor_plan};
pub use importer::{Importer, Located, PrepareOptions, Prepared};
pub use lens::{Distortion, Lens, Optics, Perspective};
pub use network::{DepthFit, DepthValues, NetworkOptions, PanoramaTiles};
pub use write::write_scene;

use crate::core::progress::Progress;
use crate::error::{Error, Result};
use std::path::Path;

/// All importers in the order in which they are asked; the more particular ones come first.
#[must_use]
pub fn importers() -> &'static [&'static dyn Importer] {
    &[
        &zind::Zind,
        &texir::TexIr,
        // (ns-process-data leaves COLMAP's model beside its own file)
        &nerfstudio::Nerfstudio,
        &colmap::Colmap,
        &opensfm::OpenSfm,
        &alicevision::AliceVision,
        &metashape::Metashape,
        &realityscan::RealityScan,
        &polycam::Polycam,
        &scanner_app::ScannerApp,
        &roomplan::RoomPlan,
        &scan::Scan,
    ]
}

/// Reads the capture at `path` and writes the scene folder `out`; without `source` the kind is
/// found by looking.
///
/// # Errors
/// [`Error::Usage`] for an unknown source, [`Error::Input`] for what cannot be read.
pub fn prepare(
    source: Option<&str>,
    path: &Path,
    out: &Path,
    options: &PrepareOptions,
    progress: &Progress,
) -> Result<Prepared> {
    options.check()?;
    let is_bracket = || looked_at(path).is_none() && brackets::recognises(path);
    if source == Some(brackets::KIND) || (source.is_none() && is_bracket()) {
        return brackets::run(path, out, options, progress);
    }
    let importer = match source {
        Some(name) => named(name)?,
        None => found(path)?,
    };
    let mut account = Account::default();
    if source.is_none() {
        tell_others(importer, path, &mut account);
    }
    let mut capture = progress.stage("reading the capture", 1, |_| {
        importer.import(path, options, &mut account)
    })?;
    // what is given by hand lies in the capture's coordinates, and turns with them
    if let Some(path) = &options.mesh {
        capture.surface = Some(Surface::of_file(path.clone()));
    }
    orient::orient(&mut capture, options, &mut account);
    let written = write_scene(capture, out, options, &mut account, progress)?;
    Ok(Prepared {
        kind: importer.kind(),
        frames: written.frames,
        triangles: written.triangles,
        rooms: written.rooms,
        notes: account.lines(),
    })
}

/// Says what else `path` could be read as.
fn tell_others(taken: &dyn Importer, path: &Path, account: &mut Account) {
    let others = importers()
        .iter()
        .map(|i| (i.kind(), i.recognises(path)))
        // a mesh lies beside most captures
        .filter(|(kind, here)| *here && *kind != taken.kind() && *kind != scan::Scan.kind());
    for (kind, _) in others {
        account.ignored(format!(
            "what \"{kind}\" would read here ({} was taken); name it before the folder to take it",
            taken.kind()
        ));
    }
}

fn named(name: &str) -> Result<&'static dyn Importer> {
    importers()
        .iter()
        .find(|i| i.kind() == name)
        .copied()
        .ok_or_else(|| {
            let mut known: Vec<&str> = importers().iter().map(|i| i.kind()).collect();
            known.push(brackets::KIND);
            Error::Usage(format!(
                "\"{name}\" is no source known here; expected one of {}, or leave it out",
                known.join(", ")
            ))
        })
}

fn looked_at(path: &Path) -> Option<&'static dyn Importer> {
    importers().iter().find(|i| i.recognises(path)).copied()
}

fn found(path: &Path) -> Result<&'static dyn Importer> {
    if !path.exists() {
        return Err(Error::input(path, "no such file or folder"));
    }
    looked_at(path).ok_or_else(|| {
        let known: Vec<String> = importers()
            .iter()
            .map(|i| format!("  {:<12} {}", i.kind(), i.looks_like()))
            .collect();
        Error::input(
            path,
            format!(
                "no capture known here{}; expected one of\n{}\n  brackets     photographs of several exposures (EXIF)\nName the source before the folder if it looks different",
                what_is_missing(path),
                known.join("\n")
            ),
        )
    })
}

/// What nearly makes a capture of a folder, for the message.
fn what_is_missing(path: &Path) -> String {
    match (importer::meshes(path).len(), importer::pictures(path).len()) {
        (meshes @ 2.., _) => format!(" ({meshes} meshes: name the file of one)"),
        (_, n @ 1..) => format!(
            " ({n} images without poses: have a photogrammetry program find them first, see docs/bring-your-own.md)"
        ),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests;
