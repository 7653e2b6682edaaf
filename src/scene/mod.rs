//! Validated input: mesh, views, labels, rooms.

mod check;
mod check_text;
mod clipping;
mod closets;
mod frame_account;
mod frame_change;
mod input_error;
pub mod known_keys;
mod load;
mod mesh_classes;
mod mesh_prep;
mod pixels;
mod recorded_light;
mod rigid;
mod rooms;
mod scan;
mod staged;
pub mod transforms;
mod unwrap;
mod wall_ends;
mod wall_map;
mod words;

pub use check::{
    CheckReport, ClassShare, ImageKind, MeshSummary, RadianceRange, RoomSummary, Summary, check,
    check_loaded, check_scene, load_for_check,
};
pub use clipping::clipped_channels;
pub use frame_account::{EIGHT_BIT, FrameAccount, Shortfall};
pub use mesh_classes::{ClassesByName, MeshClasses};
pub use mesh_prep::{MeshStats, PreparedMesh, atlas_overlap, prepare_mesh};
pub use pixels::{PixelStats, all_black, all_masked};
pub use recorded_light::RecordedLight;
pub(crate) use rigid::rigid;
pub use rooms::{find_rooms, floor_plan, read_rooms};
pub use scan::{Scan, ScanColour, ScanColours, ScanOptions};
pub use staged::StagedScene;
pub use unwrap::{UnwrapStats, unwrap_mesh};
pub use words::is_lamp;

use crate::core::formats::ImageAccount;
use crate::core::geometry::{Camera, Mesh};
use crate::core::image::{CameraMask, Plane};
use crate::core::math::colour::ColourSpace;
use crate::core::memory::{Decoding, machine_bytes, parse_bytes};
use crate::core::switch::Switch;
use glam::DVec3;
use std::path::PathBuf;

/// Whether display-referred photographs are taken.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum LdrImages {
    /// As sRGB, whose brightest values are lower bounds; a note says so.
    #[default]
    Auto,
    /// The same.
    On,
    /// Refused.
    Off,
}

/// How a scene is read.
#[derive(clap::Args, Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Scene")]
pub struct LoadOptions {
    /// Display-referred photographs (PNG, JPEG): auto = taken as sRGB whose brightest values are
    /// lower bounds of the light, off = refused.
    #[arg(long, value_name = "WHEN", num_args = 0..=1, default_missing_value = "on", default_value = "auto")]
    pub ldr: LdrImages,
    /// Ignore NaN pixels and take infinite ones for clipped light, instead of refusing the image.
    #[arg(long)]
    pub clamp_nan: bool,
    /// Classes that the mesh names by its materials, objects or numbers, where no photograph has
    /// labels: auto = where the names tell surfaces apart, on = whatever they are, off = never.
    #[arg(long, value_name = "WHEN", num_args = 0..=1, default_missing_value = "on", default_value = "auto")]
    pub mesh_classes: Switch,
    /// Make a new atlas even if the mesh brings one.
    #[arg(long)]
    pub unwrap: bool,
    /// Side of the atlas, in texels, for which an own atlas is laid out.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().unwrap_resolution)]
    pub unwrap_resolution: u32,
    /// Texels kept free around every chart of an own atlas.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().unwrap_padding)]
    pub unwrap_padding: u32,
    /// Main memory to stay within, such as 16GiB (in a file: bytes): `solve` reduces photographs until
    /// all of it fits, or is refused at the start; everything else only decodes fewer photographs at
    /// once [default: the machine's].
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    pub memory: Option<u64>,
    /// Problems reported in full before the rest is only counted.
    #[arg(long, value_name = "N", default_value_t = Self::default().max_issues)]
    pub max_issues: usize,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            ldr: LdrImages::Auto,
            clamp_nan: false,
            mesh_classes: Switch::Auto,
            unwrap: false,
            unwrap_resolution: 2048,
            unwrap_padding: 2,
            memory: None,
            max_issues: 50,
        }
    }
}

impl LoadOptions {
    /// Bytes of main memory that may be used: what was asked for, or what the machine has; `None`
    /// where its kernel does not tell.
    #[must_use]
    pub fn memory_limit(&self) -> Option<u64> {
        self.memory.or_else(machine_bytes)
    }
}

/// A semantic class.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Class {
    /// Id in the label images; 0 is "unlabelled" and never a class.
    pub id: u16,
    /// Name for people.
    pub name: String,
    /// Known to emit light (`kind` = `light`).
    pub is_light: bool,
}

impl Class {
    /// The words of its name, lower case: "ChromeBSDF" is "chrome" and "bsdf".
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        words::words(&self.name)
    }

    /// Whether its name is that of a pane that daylight comes through: "window" or "skylight" as a
    /// word, without a word for what holds or covers one ("window_frame", "window blind").
    #[must_use]
    pub fn is_window(&self) -> bool {
        const PANES: [&str; 4] = ["window", "windows", "skylight", "windowpane"];
        const PARTS: [&str; 10] = [
            "frame", "sill", "blind", "blinds", "shutter", "curtain", "handle", "seat", "casing",
            "box",
        ];
        let name = self.name.to_lowercase();
        let words = || name.split(|c: char| !c.is_alphabetic());
        words().any(|w| PANES.contains(&w)) && !words().any(|w| PARTS.contains(&w))
    }
}

/// Which pixels are mirrored left to right or upside down, and turned back as they are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mirror {
    /// None.
    #[default]
    None,
    /// The photographs alone; label images and masks are right.
    Images,
    /// Photographs, labels and masks.
    All,
    /// The photographs alone are turned by half a turn, as an EXIF orientation of 3 would undo.
    UpsideDown,
}

/// What a view is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Reconstruction sees it.
    Train,
    /// Held out for evaluation.
    Test,
}

/// A posed photograph; pixels are read on demand.
#[derive(Clone, Debug)]
pub struct View {
    /// File stem of the image, unique in the scene: the name of everything written for this view.
    pub stem: String,
    /// Pose and projection at the image's size, position relative to [`Scene::origin`].
    pub camera: Camera,
    /// Scene-linear radiance image.
    pub image_path: PathBuf,
    /// Class ids, if given.
    pub label_path: Option<PathBuf>,
    /// 0 = ignore the pixel, if given.
    pub mask_path: Option<PathBuf>,
    /// Working radiance = image · 2^exposure_ev.
    pub exposure_ev: f32,
    /// Training or held out.
    pub split: Split,
    /// The colour space that `transforms.json` states; `None` if the file is to be asked.
    pub colour_space: Option<ColourSpace>,
    /// How the image is understood.
    pub account: ImageAccount,
}

fn decoding(views: &[View], options: &LoadOptions) -> Decoding {
    let pixels = |v: &View| v.camera.width * v.camera.height;
    let largest = views.iter().map(pixels).max().unwrap_or(0);
    Decoding::within(options.memory_limit().unwrap_or(0), largest)
}

/// Room ids on a floor plan: `cells[(column, row)]` covers x = x_min + column·cell, z = z_min +
/// row·cell; 0 = outside.
#[derive(Clone, Debug)]
pub struct RoomGrid {
    /// Room ids.
    pub cells: Plane<u16>,
    /// Metres per cell.
    pub cell: f32,
    /// World x of the grid's first column, relative to [`Scene::origin`].
    pub x_min: f32,
    /// World z of the grid's first row, relative to [`Scene::origin`].
    pub z_min: f32,
}

/// A validated scene. The world is y-up; positions are relative to `origin` so that f32 keeps its
/// precision far from zero.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The scene's folder.
    pub folder: PathBuf,
    /// File coordinates (y-up) of the internal coordinate origin: centre of the mesh's bounding
    /// box.
    pub origin: DVec3,
    /// Geometry with one atlas.
    pub mesh: Mesh,
    /// Classes by ascending id; derived from the label images where the file names none.
    pub classes: Vec<Class>,
    /// All views, training and held out, in file order.
    pub views: Vec<View>,
    /// Rooms, if the scene brings them.
    pub rooms: Option<RoomGrid>,
    /// `classes` were declared by the file: other ids in label images are errors.
    pub classes_declared: bool,
    /// The mesh's own classes, where no photograph has labels.
    pub mesh_classes: Option<MeshClasses>,
    /// What was found and done while the mesh was made usable.
    pub mesh_stats: MeshStats,
    /// The file's world is z up: poses and mesh were turned on loading.
    pub z_up: bool,
    /// Which pixels are mirrored or upside down in their files.
    pub mirror: Mirror,
    /// What a user should know although the scene is usable.
    pub warnings: Vec<String>,
    /// What the cameras carry along, where a reconstruction found it: masked in all views of the
    /// kind and size.
    pub camera_masks: Vec<CameraMask>,
    /// How the scene was read; pixels are read the same way.
    pub options: LoadOptions,
    /// What was read besides the views' files: `transforms.json`, the mesh, the grid of rooms.
    pub files: Vec<PathBuf>,
}

impl Scene {
    /// A scene made in memory: no images on disk beyond those the views name, nothing to warn of.
    #[must_use]
    pub fn from_parts(
        folder: PathBuf,
        origin: DVec3,
        mesh: Mesh,
        classes: Vec<Class>,
        views: Vec<View>,
    ) -> Self {
        Self {
            folder,
            origin,
            mesh,
            classes_declared: !classes.is_empty(),
            classes,
            views,
            rooms: None,
            mesh_classes: None,
            mesh_stats: MeshStats::default(),
            z_up: false,
            mirror: Mirror::None,
            warnings: Vec::new(),
            camera_masks: Vec::new(),
            options: LoadOptions::default(),
            files: Vec::new(),
        }
    }

    /// Every file the scene was read from, images, labels and masks included; never ground truth.
    /// Sorted, each once.
    #[must_use]
    pub fn input_files(&self) -> Vec<PathBuf> {
        let of_view = |v: &View| {
            let side = [&v.label_path, &v.mask_path];
            std::iter::once(v.image_path.clone())
                .chain(side.into_iter().flatten().cloned())
                .collect::<Vec<_>>()
        };
        let mut files: Vec<PathBuf> = self.views.iter().flat_map(of_view).collect();
        files.extend(self.files.iter().cloned());
        files.sort();
        files.dedup();
        files
    }

    /// How many photographs are decoded at once.
    #[must_use]
    pub fn decoding(&self) -> Decoding {
        decoding(&self.views, &self.options)
    }

    /// Training views in file order.
    pub fn train_views(&self) -> impl Iterator<Item = &View> {
        self.views.iter().filter(|v| v.split == Split::Train)
    }

    /// Held-out views in file order.
    pub fn test_views(&self) -> impl Iterator<Item = &View> {
        self.views.iter().filter(|v| v.split == Split::Test)
    }

    /// The class of an id.
    #[must_use]
    pub fn class(&self, id: u16) -> Option<&Class> {
        self.classes
            .binary_search_by_key(&id, |c| c.id)
            .ok()
            .map(|i| &self.classes[i])
    }

    /// What a class is called: its name, or what [`unnamed_class`] says.
    #[must_use]
    pub fn class_name(&self, id: u16) -> String {
        self.class(id)
            .map_or_else(|| unnamed_class(id), |c| c.name.clone())
    }
}

/// What a class is called that has no name.
#[must_use]
pub fn unnamed_class(id: u16) -> String {
    match id {
        0 => "unlabelled".into(),
        id => format!("class {id}"),
    }
}
