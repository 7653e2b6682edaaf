//! `unbake prepare`: from what devices and programs export to a scene folder (docs/scene-format.md).
//!
//! One [`Importer`] per source, found by looking at the folder; it returns a [`Capture`] (posed
//! photographs, a surface, rooms) and writes into an [`Account`] what it read, converted and
//! ignored. What all sources share stands here once: rendering labels from the surface, resampling
//! photographs of lenses the solver does not model, the scene folder itself ([`write_scene`]).
//! Called by `cli`.

mod account;
mod capture;
mod colmap;
mod frame;
mod labels;
mod lens;
mod nerfstudio;
mod orient;
mod plan;
mod ply_out;
mod roomplan;
mod scan;
mod texir;
mod usda;
mod write;
mod zind;

pub use account::Account;
pub use capture::{
    Capture, Depth, LabelledMesh, Mask, Optics, Perspective, RoomOutline, Shot, Surface, Up,
};
pub use lens::{Distortion, Lens};
pub use write::write_scene;

use crate::core::progress::Progress;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How a capture becomes a scene.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Prepare")]
pub struct PrepareOptions {
    /// Mesh to use instead of the one that lies with the capture (.glb, .gltf, .obj, .ply), in the
    /// capture's own coordinates.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Metres per unit of the capture: every position is multiplied by it.
    #[arg(long, value_name = "METRES")]
    pub scale: Option<f64>,
    /// Axis that points up in the capture, where its files leave that open: y or z.
    #[arg(long, value_name = "AXIS")]
    pub up: Option<String>,
    /// Storey to take where a capture has several, by its name there.
    #[arg(long, value_name = "NAME")]
    pub floor: Option<String>,
    /// Every N-th photograph is held out, so that `unbake eval` can say how good novel views are;
    /// 0 trains on all. Captures of fewer than 16 photographs and those that state a split are left
    /// as they are.
    #[arg(long, value_name = "N", default_value_t = Self::default().hold_out)]
    pub hold_out: usize,
    /// Links the photographs instead of copying them: the scene then needs the capture to stay
    /// where it is.
    #[arg(long)]
    pub link: bool,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        Self {
            mesh: None,
            scale: None,
            up: None,
            floor: None,
            hold_out: 8,
            link: false,
        }
    }
}

/// Reads one kind of capture.
pub trait Importer: Sync {
    /// Its name on the command line.
    fn kind(&self) -> &'static str;

    /// What lies in such a folder, for the message that lists all sources.
    fn looks_like(&self) -> &'static str;

    /// Whether `path` (a folder or a file) is of this kind: a look at names and first bytes only.
    fn recognises(&self, path: &Path) -> bool;

    /// Reads the capture.
    ///
    /// # Errors
    /// [`Error::Input`] naming the file, the place in it and the way out.
    fn read(&self, path: &Path, options: &PrepareOptions, account: &mut Account)
    -> Result<Capture>;
}

/// All importers in the order in which they are asked; the more particular ones come first.
#[must_use]
pub fn importers() -> &'static [&'static dyn Importer] {
    &[
        &zind::Zind,
        &texir::TexIr,
        &colmap::Colmap,
        &nerfstudio::Nerfstudio,
        &roomplan::RoomPlan,
        &scan::Scan,
    ]
}

/// What [`prepare`] made.
#[derive(Clone, Debug, Serialize)]
pub struct Prepared {
    /// The importer's name.
    pub kind: &'static str,
    /// Posed photographs written.
    pub frames: usize,
    /// Triangles of the mesh; 0 without one.
    pub triangles: usize,
    /// Rooms the capture names; 0 where they are left to be found.
    pub rooms: usize,
    /// What was read, converted and ignored, one sentence each.
    pub notes: Vec<String>,
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
    let importer = match source {
        Some(name) => named(name)?,
        None => found(path)?,
    };
    let mut account = Account::default();
    let mut capture = progress.stage("reading the capture", 1, |_| {
        importer.read(path, options, &mut account)
    })?;
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

impl PrepareOptions {
    /// Refuses values that mean nothing.
    fn check(&self) -> Result<()> {
        if let Some(s) = self.scale.filter(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(Error::Usage(format!(
                "--scale {s}: expected a positive number of metres per unit"
            )));
        }
        match self.up.as_deref() {
            None | Some("y" | "z") => Ok(()),
            Some(other) => Err(Error::Usage(format!("--up {other}: expected y or z"))),
        }
    }
}

fn named(name: &str) -> Result<&'static dyn Importer> {
    importers()
        .iter()
        .find(|i| i.kind() == name)
        .copied()
        .ok_or_else(|| {
            let known: Vec<&str> = importers().iter().map(|i| i.kind()).collect();
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
                    "no capture known here; expected one of\n{}\nName the source before the folder if it looks different",
                    known.join("\n")
                ),
            )
        })
}

#[cfg(test)]
mod tests;
