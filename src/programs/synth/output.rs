//! Writing the scene folder: aside first, then moved into place.

use super::apartment::Apartment;
use super::catalogue::{CLASSES, METALS, PANES, metallic, transmission};
use super::glb;
use super::options::{SynthOptions, SynthSummary};
use super::views::SynthView;
use crate::core::formats;
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::parallel::prelude::*;
use crate::error::{Error, Result};
use crate::render::Frame;
use crate::scene::StagedScene;
use glam::{Vec3, Vec4};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metres per cell of the room grid.
const ROOM_CELL: f32 = 0.05;
/// File that marks a folder as ours: it may be replaced.
const MARK: &str = "synth.json";

/// A scene folder under construction.
pub struct FolderWriter {
    folder: StagedScene,
    /// Whether the scene has metals.
    metals: bool,
    /// Whether it has panes.
    panes: bool,
}

/// What the scene's files describe.
pub struct Described<'a> {
    /// Options of the run.
    pub options: &'a SynthOptions,
    /// Plan and materials.
    pub apartment: &'a Apartment,
    /// Packed mesh.
    pub mesh: &'a Mesh,
    /// Albedo and roughness.
    pub texture: &'a Plane<Vec4>,
    /// Share of metal, where there is any.
    pub metallic: Option<&'a Plane<f32>>,
    /// Share of transmitted light, where there are panes.
    pub transmission: Option<&'a Plane<f32>>,
    /// Cameras.
    pub views: &'a [SynthView],
}

impl FolderWriter {
    /// Begins a folder; refuses to replace one that `unbake synth` did not write.
    ///
    /// # Errors
    /// If the folder holds something else or cannot be written to.
    pub fn new(target: &Path, options: &SynthOptions) -> Result<Self> {
        let mut folders = vec![
            "images",
            "labels",
            "gt/albedo",
            "gt/roughness",
            "gt/emission",
        ];
        if options.fittings {
            folders.push("gt/metallic");
        }
        if options.panes {
            folders.push("gt/transmission");
        }
        let folder = StagedScene::new(target, "synth", MARK, &folders)?;
        Ok(Self {
            folder,
            metals: options.fittings,
            panes: options.panes,
        })
    }

    /// A place in the folder under construction.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.at(name)
    }

    /// Writes a view's image, labels and ground truth.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn view(&self, stem: &str, frame: &Frame, image: &RgbPlane) -> Result<()> {
        // emission counts where the pixel's centre is on a lamp: a pixel that a lamp only touches
        // has another class
        let lamp = |label: u16| CLASSES.iter().any(|c| c.0 == label && c.2);
        let emits = |(e, l): (&Vec3, &u16)| if lamp(*l) { *e } else { Vec3::ZERO };
        let emitted = frame
            .emission
            .data
            .iter()
            .zip(&frame.label.data)
            .map(emits)
            .collect();
        let emission = Plane {
            width: frame.label.width,
            height: frame.label.height,
            data: emitted,
        };
        let files: [&(dyn Fn() -> Result<usize> + Sync); 5] = [
            &|| formats::write_rgb_half(self.path(format!("images/{stem}.exr")), image),
            &|| {
                formats::write_png16(self.path(format!("labels/{stem}.png")), &frame.label)
                    .map(|()| 0)
            },
            &|| {
                formats::write_rgb_half(
                    self.path(format!("gt/albedo/{stem}.exr")),
                    &frame.class_albedo,
                )
            },
            &|| {
                formats::write_plane_half(
                    self.path(format!("gt/roughness/{stem}.exr")),
                    &frame.class_roughness,
                )
            },
            &|| formats::write_rgb_half(self.path(format!("gt/emission/{stem}.exr")), &emission),
        ];
        files.par_iter().try_for_each(|write| write().map(drop))?;
        if self.metals {
            let path = self.path(format!("gt/metallic/{stem}.exr"));
            formats::write_plane_half(path, &frame.class_metallic)?;
        }
        if self.panes {
            let path = self.path(format!("gt/transmission/{stem}.exr"));
            formats::write_plane_half(path, &frame.class_transmission)?;
        }
        Ok(())
    }

    /// Writes everything that is not a view's.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn scene(&self, d: &Described<'_>) -> Result<()> {
        self.folder.write("mesh.glb", &glb::glb(d.mesh)?)?;
        formats::write_rgb_half(
            self.path("gt/albedo_texture.exr"),
            &d.texture.map(|t| t.truncate()),
        )?;
        formats::write_plane_half(
            self.path("gt/roughness_texture.exr"),
            &d.texture.map(|t| t.w),
        )?;
        if let Some(metallic) = d.metallic {
            formats::write_plane_half(self.path("gt/metallic_texture.exr"), metallic)?;
        }
        if let Some(transmission) = d.transmission {
            formats::write_plane_half(self.path("gt/transmission_texture.exr"), transmission)?;
        }
        self.folder.write_json("gt/materials.json", &materials(d))?;
        let (grid, place) = rooms(d);
        formats::write_png16(self.path("rooms.png"), &grid)?;
        self.folder.write_json("rooms.json", &place)?;
        self.folder.write_json("transforms.json", &transforms(d))
    }

    /// Moves the finished folder into place.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn finish(self, summary: &SynthSummary) -> Result<()> {
        let text =
            serde_json::to_value(summary).map_err(|e| Error::Failed(format!("{MARK}: {e}")))?;
        self.folder.write_json(MARK, &text)?;
        self.folder.publish()
    }
}

fn transforms(d: &Described<'_>) -> Value {
    let file = |v: &SynthView| format!("images/{}.exr", v.stem);
    let frame = |v: &SynthView| {
        let (m, p) = (v.camera.world_from_camera, v.camera.position);
        let row = |k: usize| [m.x_axis[k], m.y_axis[k], m.z_axis[k], p[k]].map(f64::from);
        json!({
            "file_path": file(v),
            "label_path": format!("labels/{}.png", v.stem),
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        })
    };
    let classes: Vec<Value> = CLASSES
        .iter()
        .filter(|c| d.options.fittings || !METALS.contains(&c.0))
        .filter(|c| d.options.panes || !PANES.contains(&c.0))
        .map(|&(id, name, light)| json!({"id": id, "name": name, "kind": if light { "light" } else { "surface" }}))
        .collect();
    let names = |held_out: bool| {
        d.views
            .iter()
            .filter(|v| v.held_out == held_out)
            .map(file)
            .collect::<Vec<String>>()
    };
    json!({
        "camera_model": "EQUIRECTANGULAR",
        "w": d.options.width,
        "h": d.options.width / 2,
        "mesh_path": "mesh.glb",
        "rooms_path": "rooms.png",
        "classes": classes,
        "train_filenames": names(false),
        "test_filenames": names(true),
        "frames": d.views.iter().map(frame).collect::<Vec<Value>>(),
    })
}

/// Room ids per floor cell: a doorway belongs half to either side.
fn rooms(d: &Described<'_>) -> (Plane<u16>, Value) {
    let (low, high) = d.mesh.bounds();
    let columns = ((high.x - low.x) / ROOM_CELL).ceil().max(1.0) as usize;
    let rows = ((high.z - low.z) / ROOM_CELL).ceil().max(1.0) as usize;
    let id = |i: usize| {
        let x = low.x + ((i % columns) as f32 + 0.5) * ROOM_CELL;
        let gap = |x0: f32, x1: f32| (x0 - x).max(x - x1).max(0.0);
        let distance = |r: &super::plan::Room| gap(r.x, r.x + r.size.x);
        let nearest = d
            .apartment
            .rooms
            .iter()
            .enumerate()
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        nearest.map_or(0, |(k, _)| k as u16 + 1)
    };
    let grid = Plane {
        width: columns,
        height: rows,
        data: (0..columns * rows).map(id).collect(),
    };
    (
        grid,
        json!({"cell": ROOM_CELL, "x_min": low.x, "z_min": low.z}),
    )
}

/// Per class: area-weighted mean albedo and roughness of its surfaces, and the paints used.
fn materials(d: &Described<'_>) -> Value {
    let mut sums: BTreeMap<u16, (Vec4, f32, Vec<usize>, f32)> = BTreeMap::new();
    let mut triangle = 0;
    for chart in &d.apartment.charts {
        let entry = sums.entry(chart.finish.class).or_default();
        entry.3 = entry.3.max(chart.finish.emission.max_element());
        if !entry.2.contains(&chart.finish.material) {
            entry.2.push(chart.finish.material);
        }
        for _ in &chart.triangles {
            let p = d.mesh.uv(triangle, 1.0 / 3.0, 1.0 / 3.0) * d.texture.width as f32;
            let area = d.mesh.area(triangle);
            entry.0 += *d.texture.nearest(p) * area;
            entry.1 += area;
            triangle += 1;
        }
    }
    let mut out = serde_json::Map::new();
    for (class, (sum, area, paints, emission)) in sums {
        let mean = sum / area.max(1e-12);
        let name = CLASSES.iter().find(|c| c.0 == class).map_or("?", |c| c.1);
        let rough: Vec<f32> = paints
            .iter()
            .map(|&p| d.apartment.paints[p].roughness)
            .collect();
        let mut value = json!({
            "id": class,
            "albedo": mean.truncate().to_array(),
            "rough": mean.w,
            "paints": paints.len(),
            "paint_roughness": [rough.iter().copied().fold(1.0, f32::min), rough.iter().copied().fold(0.0, f32::max)],
            "emission": emission,
        });
        if d.options.fittings {
            value["metallic"] = json!(metallic(class));
        }
        if d.options.panes {
            value["transmission"] = json!(transmission(class));
        }
        out.insert(name.to_string(), value);
    }
    Value::Object(out)
}
