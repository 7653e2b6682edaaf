//! What an importer hands over: posed photographs, a surface, rooms, in one world of metres.

use super::lens::Optics;
use crate::core::formats::RawMesh;
use crate::core::image::Plane;
use crate::scene::Class;
use glam::{DMat4, DVec2, DVec3};
use std::path::PathBuf;

/// Pixels to ignore.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Mask {
    /// A grey image, 0 = ignore.
    File(PathBuf),
    /// The fourth channel of a PNG, 0 = ignore.
    Alpha(PathBuf),
}

/// Depth that came with a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    /// EXR of metres, or a grey PNG of steps.
    pub path: PathBuf,
    /// Metres per step of a PNG.
    pub metres_per_step: f64,
    /// Measured along the optical axis instead of along the ray.
    pub along_axis: bool,
}

/// A posed photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Name of everything written for it; made unique by the writer.
    pub stem: String,
    /// The photograph.
    pub image: PathBuf,
    /// Camera-to-world, OpenGL axes, the world of the capture.
    pub world_from_camera: DMat4,
    /// Projection.
    pub optics: Optics,
    /// Columns and rows the intrinsics refer to; checked against the file where known.
    pub size: Option<[usize; 2]>,
    /// Class ids per pixel that came with the capture.
    pub labels: Option<PathBuf>,
    /// Pixels to ignore.
    pub mask: Option<Mask>,
    /// Depth that came with the capture.
    pub depth: Option<Depth>,
    /// Points of the surface that the photograph shows, in the camera's axes (OpenGL), units of the capture.
    pub points: Vec<DVec3>,
    /// Working radiance = image · 2^ev.
    pub exposure_ev: Option<f64>,
    /// Primaries of the photograph where its file does not say: a name of docs/scene-format.md.
    pub color_space: Option<String>,
    /// Stated split of the capture: held out or not.
    pub held_out: Option<bool>,
}

impl Shot {
    /// A shot with nothing but image, pose and projection.
    #[must_use]
    pub fn new(
        stem: impl Into<String>,
        image: PathBuf,
        world_from_camera: DMat4,
        optics: Optics,
    ) -> Self {
        Self {
            stem: stem.into(),
            image,
            world_from_camera,
            optics,
            size: None,
            labels: None,
            mask: None,
            depth: None,
            points: Vec::new(),
            exposure_ev: None,
            color_space: None,
            held_out: None,
        }
    }
}

/// Triangles with a class each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LabelledMesh {
    /// Geometry in the world of the capture.
    pub mesh: RawMesh,
    /// Class id per triangle, 0 = none; empty where the capture knows none at all.
    pub classes: Vec<u16>,
}

/// The capture's geometry.
#[derive(Clone, Debug, PartialEq)]
pub enum Surface {
    /// A file the scene can use as it is; `world_from_file` brings it into the world of the
    /// capture.
    File {
        /// Mesh file.
        path: PathBuf,
        /// A similarity; the identity leaves the file as it is.
        world_from_file: DMat4,
    },
    /// Made or decoded by the importer.
    Built(LabelledMesh),
}

impl Surface {
    /// A mesh file that lies in the world of the capture.
    #[must_use]
    pub fn of_file(path: PathBuf) -> Self {
        Self::File {
            path,
            world_from_file: DMat4::IDENTITY,
        }
    }
}

/// A room on the plan.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomOutline {
    /// Name for people.
    pub name: String,
    /// Closed polygon in world (x, z) of a y-up world, (x, −y) of a z-up one.
    pub corners: Vec<DVec2>,
}

/// A grid of room ids (1 = the first outline) and where it lies.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomIds {
    /// Ids, 0 outside.
    pub cells: Plane<u16>,
    /// Metres per cell.
    pub cell: f64,
    /// World x of the first column, world z of the first row.
    pub min: DVec2,
}

/// Which axis of the capture's world points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// y, as in a scene folder.
    #[default]
    Y,
    /// z.
    Z,
    /// The source leaves it open: found from the photographs (`orient`).
    Unknown,
}

/// All an importer found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    /// Photographs in the capture's order.
    pub shots: Vec<Shot>,
    /// Geometry, if any.
    pub surface: Option<Surface>,
    /// Classes of labels or surface; empty = none declared.
    pub classes: Vec<Class>,
    /// Rooms, if the capture names them.
    pub rooms: Vec<RoomOutline>,
    /// Rooms the capture has as a grid of ids (world x, z; y up).
    pub room_grid: Option<RoomIds>,
    /// Which axis points up.
    pub up: Up,
    /// The source's unit is no metre but arbitrary.
    pub unit_unknown: bool,
}
