//! What every importer is and is given.

use super::account::Account;
use super::capture::Capture;
use super::folder::extension;
use super::network::NetworkOptions;
use crate::error::{Error, Result};
use glam::DMat3;
use serde::{Deserialize, Serialize};
use std::io::Read;
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
    /// Exposure times of brackets without EXIF, in the order of the file names: "1/4,1/15,1/60".
    #[arg(long, value_name = "TIMES")]
    pub exposure_times: Option<String>,
    /// Links the photographs instead of copying them: the scene then needs the capture to stay
    /// where it is.
    #[arg(long)]
    pub link: bool,
    /// Networks that see depth and classes in photographs.
    #[command(flatten)]
    pub networks: NetworkOptions,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        Self {
            mesh: None,
            scale: None,
            up: None,
            floor: None,
            hold_out: 8,
            exposure_times: None,
            link: false,
            networks: NetworkOptions::default(),
        }
    }
}

/// What was made.
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

/// Reads one kind of capture.
pub trait Importer: Sync {
    /// Its name on the command line.
    fn kind(&self) -> &'static str;

    /// What lies in such a folder, for the message that lists all sources.
    fn looks_like(&self) -> &'static str;

    /// Where reading begins in `path` (a folder or a file): a look at names and first bytes only.
    ///
    /// # Errors
    /// [`Error::Input`] with what was expected there.
    fn locate(&self, path: &Path) -> Result<Located>;

    /// Whether `path` is of this kind.
    fn recognises(&self, path: &Path) -> bool {
        self.locate(path).is_ok()
    }

    /// Reads what [`Self::locate`] found.
    ///
    /// # Errors
    /// [`Error::Input`] naming the file, the place in it and the way out.
    fn read(
        &self,
        located: &Located,
        options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture>;

    /// Locates the capture in `path` and reads it.
    ///
    /// # Errors
    /// As [`Self::locate`] and [`Self::read`].
    fn import(
        &self,
        path: &Path,
        options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        self.read(&self.locate(path)?, options, account)
    }
}

/// A capture that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Located {
    /// The folder or file as the user named it.
    pub named: PathBuf,
    /// The file or folder that reading begins with.
    pub start: PathBuf,
}

impl Located {
    /// What was found at `named`, or the refusal that says what was `expected` there.
    pub(super) fn new(
        named: &Path,
        start: Option<PathBuf>,
        expected: impl Into<String>,
    ) -> Result<Self> {
        let start = start.ok_or_else(|| Error::input(named, expected.into()))?;
        Ok(Self {
            named: named.to_path_buf(),
            start,
        })
    }

    /// The folder of the file that reading begins with.
    pub(super) fn folder(&self) -> &Path {
        self.start.parent().unwrap_or(Path::new("."))
    }
}

impl PrepareOptions {
    /// Refuses values that mean nothing.
    pub(super) fn check(&self) -> Result<()> {
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

/// The name of what is written for a photograph: its folders become part of it, so that equal file
/// names of rigs stay apart.
pub(super) fn stem_of(name: &str) -> String {
    let path = Path::new(name).with_extension("");
    path.to_string_lossy().replace(['/', '\\'], "_")
}

/// A photograph by its name, in the first of these folders that has it.
pub(super) fn photograph_named(
    folders: impl IntoIterator<Item = PathBuf>,
    name: &str,
) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    folders
        .into_iter()
        .map(|f| f.join(&name))
        .find(|p| p.is_file())
}

/// The mesh that lies with a capture: under the first of these names that is there, else the only one
/// in the folder.
pub(super) fn mesh_beside(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    let named = names.iter().map(|m| folder.join(m)).find(|m| m.is_file());
    named.or_else(|| {
        let mut found = meshes(folder);
        found.retain(|m| has_faces(m));
        found.pop().filter(|_| found.is_empty())
    })
}

/// Meshes in a folder, or the file itself if it is one.
pub(super) fn meshes(path: &Path) -> Vec<PathBuf> {
    let is_mesh = |p: &Path| MESH_ENDINGS.contains(&extension(p).as_str());
    of_kind(path, is_mesh)
}

/// Photographs in a folder.
pub(super) fn pictures(path: &Path) -> Vec<PathBuf> {
    let endings = ["jpg", "jpeg", "png", "exr", "hdr", "heic"];
    files_in(path, |p| endings.contains(&extension(p).as_str()))
}

/// The file itself if it is of a kind, or those in a folder that are.
pub(super) fn of_kind(path: &Path, is: impl Fn(&Path) -> bool) -> Vec<PathBuf> {
    if path.is_file() {
        return Vec::from_iter(is(path).then(|| path.to_path_buf()));
    }
    files_in(path, is)
}

/// The file itself if it is of a kind, or the only one in a folder that is.
pub(super) fn only_of_kind(path: &Path, is: impl Fn(&Path) -> bool) -> Option<PathBuf> {
    match of_kind(path, is).as_slice() {
        [only] => Some(only.clone()),
        _ => None,
    }
}

/// Numbers that stand in words; `None` where a word is none, or not finite.
pub(super) fn finite_numbers(text: &str) -> Option<Vec<f64>> {
    let each = |w: &str| w.parse().ok().filter(|n: &f64| n.is_finite());
    text.split_ascii_whitespace().map(each).collect()
}

/// What lies in a folder and is of a kind, in the order of the names.
pub(super) fn files_in(folder: &Path, is: impl Fn(&Path) -> bool) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|e| e.path()).filter(|p| is(p)).collect();
    files.sort();
    files
}

/// Endings of meshes the program reads.
const MESH_ENDINGS: [&str; 4] = ["glb", "gltf", "obj", "ply"];

/// Whether a file is more than a cloud of points, which only PLY may be: its header says.
fn has_faces(mesh: &Path) -> bool {
    if extension(mesh) != "ply" {
        return true;
    }
    let mut header = Vec::new();
    let opened = std::fs::File::open(mesh);
    let read = opened.and_then(|f| f.take(LONGEST_HEADER).read_to_end(&mut header));
    let text = String::from_utf8_lossy(&header);
    let count = |line: &str| {
        line.strip_prefix("element face ")?
            .trim()
            .parse::<u64>()
            .ok()
    };
    read.is_ok() && text.lines().filter_map(count).any(|n| n > 0)
}

/// Bytes within which a PLY header names its elements.
const LONGEST_HEADER: u64 = 1 << 16;

/// Whether a matrix is a rotation, to a thousandth: what files state with a few digits.
pub(super) fn is_rotation(m: DMat3) -> bool {
    (m.transpose() * m).abs_diff_eq(DMat3::IDENTITY, 1e-3) && m.determinant() > 0.0
}
