//! Validated input: mesh, views, labels, rooms.

use crate::geometry::{Camera, Mesh};
use crate::image::Plane;
use glam::DVec3;
use std::path::PathBuf;

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
}

/// Room ids on a floor plan: `cells[(column, row)]` covers x = x_min + column·cell, z = z_min + row·cell; 0 = outside.
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

/// A validated scene. The world is y-up; positions are relative to `origin` so that f32 keeps its precision far from zero.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The scene's folder.
    pub folder: PathBuf,
    /// File coordinates (y-up) of the internal coordinate origin: centre of the mesh's bounding box.
    pub origin: DVec3,
    /// Geometry with one atlas.
    pub mesh: Mesh,
    /// Classes by ascending id; derived from the label images where the file names none.
    pub classes: Vec<Class>,
    /// All views, training and held out, in file order.
    pub views: Vec<View>,
    /// Rooms, if the scene brings them.
    pub rooms: Option<RoomGrid>,
}
