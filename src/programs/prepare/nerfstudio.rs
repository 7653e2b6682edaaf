//! nerfstudio's `transforms.json` in full: intrinsics per frame, applied transform and scale, all
//! its lenses, masks, depth, splits. What a scene folder adds (labels, mesh, rooms, classes) goes
//! through.
//!
//! `applied_transform` and `applied_scale` are what was done to the poses since the program that
//! found them; they are undone, because meshes lie in that program's coordinates. Depth images are
//! steps of `depth_unit_scale_factor` (1 mm) along the optical axis.

use super::account::Account;
use super::capture::{Capture, Depth, Mask, RoomIds, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions};
use super::lens::{Distortion, Lens};
use super::lens::{Optics, Perspective};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use crate::scene::transforms::y_up_from_z_up;
use crate::scene::{self, Class, read_rooms};
use glam::{DMat3, DMat4, DVec2, DVec3};
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const FILE: &str = "transforms.json";
/// Blender's and the first NeRF scenes: a file of its own for every part of the split.
const TRAIN: &str = "transforms_train.json";
const TEST: &str = "transforms_test.json";
/// nerfstudio's default: millimetres.
const DEPTH_STEP: f64 = 1e-3;
/// Endings tried for a `file_path` without one (the first NeRF scenes).
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];
/// Meshes that programs leave beside the file.
const MESHES: [&str; 6] = [
    "mesh.ply",
    "mesh.glb",
    "mesh.obj",
    "mesh_info.ply",
    "scene.glb",
    "poly.ply",
];
/// What this importer understands; every other key is named in the account.
const KNOWN: [&str; 40] = [
    "camera_model",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "k1",
    "k2",
    "k3",
    "k4",
    "p1",
    "p2",
    "camera_angle_x",
    "camera_angle_y",
    "is_fisheye",
    "applied_transform",
    "applied_scale",
    "orientation_override",
    "frames",
    "train_filenames",
    "test_filenames",
    "val_filenames",
    "mesh_path",
    "classes",
    "up_axis",
    "depth_unit_scale_factor",
    "file_path",
    "mask_path",
    "depth_file_path",
    "transform_matrix",
    "label_path",
    "exposure_ev",
    "rooms_path",
    "color_space",
    "mesh_up_axis",
    "colmap_im_id",
    "sharpness",
    "ply_file_path",
    "aabb_scale",
];

/// The importer.
pub struct Nerfstudio;

/// A frame's key, else the file's.
struct Keys<'a> {
    file: &'a Map<String, Value>,
    frame: &'a Map<String, Value>,
}

impl Keys<'_> {
    fn get(&self, key: &str) -> Option<&Value> {
        let own = self.frame.get(key).or_else(|| self.file.get(key));
        own.filter(|v| !v.is_null())
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.get(key)?.as_f64().filter(|x| x.is_finite())
    }

    fn text(&self, key: &str) -> Option<&str> {
        self.get(key)?.as_str()
    }
}

impl Importer for Nerfstudio {
    fn kind(&self) -> &'static str {
        "nerfstudio"
    }

    fn looks_like(&self) -> &'static str {
        "nerfstudio: transforms.json with the images it names"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        // a file of another name is taken where the source is named
        let files = match path.is_dir() {
            true => vec![path.join(FILE), path.join(TRAIN)],
            false => vec![path.to_path_buf()],
        };
        let expected = format!("no {FILE} here; give its folder or the file");
        let file = files.into_iter().find(|f| f.is_file());
        Located::new(path, file, expected)
    }

    fn recognises(&self, path: &Path) -> bool {
        let is_ours = |l: Located| l.start.ends_with(FILE) || l.start.ends_with(TRAIN);
        self.locate(path).is_ok_and(is_ours)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let (file, folder) = (&located.start, located.folder());
        let main = Document::read(file)?;
        let mut shots = main.shots(folder, account)?;
        let held_out = folder.join(TEST);
        let test = match file.ends_with(TRAIN) && held_out.is_file() {
            true => Some(Document::read(&held_out)?).filter(Document::has_frames),
            false => None,
        };
        if let Some(test) = test {
            let mut test = test.shots(folder, account)?;
            shots.iter_mut().for_each(|s| s.held_out = Some(false));
            test.iter_mut().for_each(|s| s.held_out = Some(true));
            shots.append(&mut test);
        }
        let root = &main.root;
        if root.contains_key("ply_file_path") {
            account.ignored("the sparse point cloud (ply_file_path)");
        }
        let text = |key: &str| root.get(key).and_then(Value::as_str);
        let mesh = text("mesh_path")
            .map(|m| folder.join(m))
            .or_else(|| MESHES.iter().map(|m| folder.join(m)).find(|m| m.is_file()));
        let is_z = |axis: &str| matches!(axis, "z" | "Z" | "+z");
        let (up, mesh_up) = (text("up_axis").map(is_z), text("mesh_up_axis").map(is_z));
        let up = up.or(mesh_up.map(|_| false));
        let world_from_file = match mesh_up.zip(up) {
            Some((true, false)) => DMat4::from_mat3(y_up_from_z_up()),
            Some((false, true)) => DMat4::from_mat3(y_up_from_z_up().transpose()),
            _ => DMat4::IDENTITY,
        };
        let rooms = text("rooms_path").map(|p| read_rooms(&folder.join(p), DVec3::ZERO));
        Ok(Capture {
            shots,
            surface: mesh.map(|path| Surface::File {
                path,
                world_from_file,
            }),
            classes: classes(root),
            room_grid: rooms.transpose()?.map(|grid| RoomIds {
                cells: grid.cells,
                cell: f64::from(grid.cell),
                min: DVec2::new(f64::from(grid.x_min), f64::from(grid.z_min)),
            }),
            up: match up {
                Some(true) => Up::Z,
                Some(false) => Up::Y,
                None => Up::Unknown,
            },
            ..Capture::default()
        })
    }
}

/// A file of frames.
struct Document {
    file: PathBuf,
    root: Map<String, Value>,
}

impl Document {
    fn read(file: &Path) -> Result<Self> {
        let text = read_input_text(file)?;
        let root: Value = serde_json::from_str(&text)
            .map_err(|e| Error::input(file, format!("{e}; expected nerfstudio's JSON")))?;
        let Value::Object(root) = root else {
            return Err(Error::input(file, NO_FRAMES));
        };
        Ok(Self {
            file: file.to_path_buf(),
            root,
        })
    }

    fn has_frames(&self) -> bool {
        let frames = self.root.get("frames").and_then(Value::as_array);
        frames.is_some_and(|f| !f.is_empty())
    }

    /// The frames as shots, whose files lie in `folder`.
    fn shots(&self, folder: &Path, account: &mut Account) -> Result<Vec<Shot>> {
        let (file, root) = (&self.file, &self.root);
        let frames = root
            .get("frames")
            .and_then(Value::as_array)
            .filter(|f| !f.is_empty())
            .ok_or_else(|| Error::input(file, NO_FRAMES))?;
        let undo = undo_applied(root).map_err(|m| Error::input(file, m))?;
        let mut shots = Vec::new();
        for (i, frame) in frames.iter().enumerate() {
            let fail = |m: String| Error::input(file, format!("frames[{i}]: {m}"));
            let frame = frame
                .as_object()
                .ok_or_else(|| fail("expected an object".into()))?;
            let keys = Keys { file: root, frame };
            let mut shot = shot(&keys, folder).map_err(fail)?;
            let pose = rigid(undo.of(shot.world_from_camera));
            shot.world_from_camera = pose.map_err(|m| fail(format!("transform_matrix: {m}")))?;
            shots.push(shot);
        }
        split(root, frames, folder, &mut shots, account);
        account.read(format!("{}: {} posed images", file.display(), shots.len()));
        undo.tell(account);
        let of_frames = frames
            .iter()
            .filter_map(Value::as_object)
            .flat_map(Map::keys);
        let strange: BTreeSet<&str> = root
            .keys()
            .chain(of_frames)
            .map(String::as_str)
            .filter(|k| !KNOWN.contains(k))
            .collect();
        if !strange.is_empty() {
            let list: Vec<&str> = strange.into_iter().collect();
            account.ignored(format!("keys {}", list.join(", ")));
        }
        Ok(shots)
    }
}

const NO_FRAMES: &str = "frames: missing or empty; expected a list of posed images";

/// A pose whose turn is the rotation next to what the file states, or why there is none.
fn rigid(pose: DMat4) -> std::result::Result<DMat4, String> {
    let mut out = DMat4::from_mat3(scene::rigid(DMat3::from_mat4(pose))?);
    out.w_axis = pose.w_axis;
    Ok(out)
}

/// The inverse of what was applied to the poses.
struct Undo {
    transform: Option<DMat4>,
    scale: Option<f64>,
}

impl Undo {
    fn of(&self, pose: DMat4) -> DMat4 {
        let mut pose = pose;
        if let Some(s) = self.scale {
            pose.w_axis = (pose.w_axis.truncate() / s).extend(1.0);
        }
        let Some(transform) = self.transform else {
            return pose;
        };
        // what scales the world moves cameras and does not turn them
        let size = DMat3::from_mat4(transform).determinant().abs().cbrt();
        let mut undone = transform * pose;
        for axis in [&mut undone.x_axis, &mut undone.y_axis, &mut undone.z_axis] {
            *axis /= size;
        }
        undone
    }

    fn tell(&self, account: &mut Account) {
        if self.transform.is_some() || self.scale.is_some() {
            account.converted(
                "applied_transform and applied_scale were undone: the poses are in the coordinates of the program that found them, where its mesh lies",
            );
        }
    }
}

fn undo_applied(root: &Map<String, Value>) -> std::result::Result<Undo, String> {
    let scale = match root.get("applied_scale").filter(|v| !v.is_null()) {
        None => None,
        Some(v) => Some(
            v.as_f64()
                .filter(|s| s.is_finite() && *s > 0.0)
                .ok_or("applied_scale: expected a positive number")?,
        ),
    };
    let transform = match root.get("applied_transform").filter(|v| !v.is_null()) {
        None => None,
        Some(v) => {
            let m = matrix(v).ok_or("applied_transform: expected 3 or 4 rows of 4 numbers")?;
            if DMat3::from_mat4(m).determinant().abs() < 1e-9 {
                return Err("applied_transform: is singular; remove it".into());
            }
            Some(m.inverse()).filter(|m| *m != DMat4::IDENTITY)
        }
    };
    Ok(Undo {
        transform,
        scale: scale.filter(|s| *s != 1.0),
    })
}

/// A 3×4 or 4×4 matrix by rows.
fn matrix(value: &Value) -> Option<DMat4> {
    let rows = value.as_array().filter(|r| r.len() == 3 || r.len() == 4)?;
    let mut m = [0.0; 16];
    m[15] = 1.0;
    for (i, row) in rows.iter().enumerate() {
        let row = row.as_array().filter(|r| r.len() == 4)?;
        for (j, x) in row.iter().enumerate() {
            m[4 * i + j] = x.as_f64().filter(|x| x.is_finite())?;
        }
    }
    Some(DMat4::from_cols_array(&m).transpose())
}

fn shot(keys: &Keys<'_>, folder: &Path) -> std::result::Result<Shot, String> {
    let name = keys.frame.get("file_path").and_then(Value::as_str);
    let name = name.ok_or("file_path: missing; name the frame's image")?;
    let pose = keys.frame.get("transform_matrix").and_then(matrix);
    let pose = pose.ok_or("transform_matrix: expected 4 rows of 4 finite numbers")?;
    let image = image_file(folder, name)
        .ok_or_else(|| format!("file_path: {name} was not found beside transforms.json"))?;
    let size = keys.number("w").zip(keys.number("h"));
    let size = size.map(|(w, h)| [w as usize, h as usize]);
    let stated = |key: &str| {
        keys.frame
            .get(key)
            .and_then(Value::as_str)
            .map(|p| folder.join(p))
    };
    let stem = image.file_stem().map(|s| s.to_string_lossy().into_owned());
    let optics = optics(keys, &image, size)?;
    let mut shot = Shot::new(stem.unwrap_or_default(), image, pose, optics);
    shot.size = size;
    shot.labels = stated("label_path");
    shot.mask = stated("mask_path").map(Mask::File);
    shot.exposure_ev = keys.frame.get("exposure_ev").and_then(Value::as_f64);
    shot.color_space = keys.text("color_space").map(Into::into);
    shot.depth = stated("depth_file_path").map(|path| {
        let exr = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("exr"));
        Depth {
            path,
            metres_per_step: keys.number("depth_unit_scale_factor").unwrap_or(DEPTH_STEP),
            // EXR is the scene folder's own form: along the ray
            along_axis: !exr,
        }
    });
    Ok(shot)
}

fn image_file(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = folder.join(name.replace('\\', "/"));
    if plain.is_file() {
        return Some(plain);
    }
    let with = |e: &&str| PathBuf::from(format!("{}.{e}", plain.display()));
    ENDINGS.iter().map(with).find(|p| p.is_file())
}

fn optics(
    keys: &Keys<'_>,
    image: &Path,
    size: Option<[usize; 2]>,
) -> std::result::Result<Optics, String> {
    let model = keys.text("camera_model").unwrap_or("").to_ascii_uppercase();
    let model = model.as_str();
    if model == "EQUIRECTANGULAR" {
        return Ok(Optics::Panorama);
    }
    let size = match size {
        Some(s) => s,
        None => crate::core::formats::image_info(image)
            .map(|i| [i.width, i.height])
            .map_err(|e| e.to_string())?,
    };
    let from_angle = |key: &str, side: usize| {
        keys.number(key)
            .map(|a| 0.5 * side as f64 / (0.5 * a).tan())
    };
    let fl_x = keys
        .number("fl_x")
        .or_else(|| from_angle("camera_angle_x", size[0]))
        .filter(|f| *f > 0.0)
        .ok_or("fl_x: missing; a camera needs its focal length in pixels, or camera_angle_x")?;
    let fl_y = keys
        .number("fl_y")
        .or_else(|| from_angle("camera_angle_y", size[1]))
        .filter(|f| *f > 0.0)
        .unwrap_or(fl_x);
    let focal = [fl_x, fl_y];
    let half = size.map(|s| 0.5 * s as f64);
    let centre = [
        keys.number("cx").unwrap_or(half[0]),
        keys.number("cy").unwrap_or(half[1]),
    ];
    let [k1, k2, k3, k4, p1, p2] =
        ["k1", "k2", "k3", "k4", "p1", "p2"].map(|k| keys.number(k).unwrap_or(0.0));
    let fisheye = keys.get("is_fisheye").and_then(Value::as_bool) == Some(true);
    let distorted = |distortion| {
        Ok(Optics::Distorted(Lens {
            distortion,
            focal,
            centre,
        }))
    };
    match model {
        "OPENCV_FISHEYE" => distorted(Distortion::Fisheye([k1, k2, k3, k4])),
        "" | "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" if fisheye => {
            distorted(Distortion::Fisheye([k1, k2, k3, k4]))
        }
        "FULL_OPENCV" => distorted(Distortion::Rational([
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            keys.number("k5").unwrap_or(0.0),
            keys.number("k6").unwrap_or(0.0),
        ])),
        "" | "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" => {
            if k3 != 0.0 || k4 != 0.0 {
                // OpenCV's five or eight coefficients: k3 is the sixth power, k4 divides
                return distorted(Distortion::Rational([k1, k2, p1, p2, k3, k4, 0.0, 0.0]));
            }
            Ok(Optics::Perspective(Perspective {
                focal,
                centre,
                radial: [k1, k2],
                tangential: [p1, p2],
            }))
        }
        other => Err(format!(
            "camera_model: {other} is not known here; expected EQUIRECTANGULAR, PINHOLE, OPENCV, OPENCV_FISHEYE, FULL_OPENCV. Undistort the images first"
        )),
    }
}

/// Held-out frames: those of test and validation lists that are not trained on. Names are compared as
/// places, since a list may be relative where the frames are not.
fn split(
    root: &Map<String, Value>,
    frames: &[Value],
    folder: &Path,
    shots: &mut [Shot],
    account: &mut Account,
) {
    // without the dots of a path
    let place = |n: &str| -> PathBuf { folder.join(n).components().collect() };
    let list = |key: &str| -> Option<BTreeSet<PathBuf>> {
        let names = root.get(key)?.as_array()?.iter();
        Some(names.filter_map(Value::as_str).map(place).collect())
    };
    let (train, test, val) = (
        list("train_filenames"),
        list("test_filenames"),
        list("val_filenames"),
    );
    if train.is_none() && test.is_none() && val.is_none() {
        return;
    }
    let held_out = |frame: &Value| {
        let name = frame.get("file_path").and_then(Value::as_str);
        let name = place(name.unwrap_or_default());
        let in_list = |l: &Option<BTreeSet<PathBuf>>| l.as_ref().is_some_and(|l| l.contains(&name));
        match &train {
            Some(t) => !t.contains(&name),
            None => in_list(&test) || in_list(&val),
        }
    };
    let held_out: Vec<bool> = frames.iter().map(held_out).collect();
    if !held_out.contains(&false) {
        account.ignored("train_filenames, test_filenames, val_filenames: they leave no frame to reconstruct from; all are taken");
        return;
    }
    for (shot, held_out) in shots.iter_mut().zip(held_out) {
        shot.held_out = Some(held_out);
    }
}

fn classes(root: &Map<String, Value>) -> Vec<Class> {
    let list = root.get("classes").and_then(Value::as_array);
    let class = |v: &Value| {
        let id = v.get("id")?.as_u64()?;
        Some(Class {
            id: u16::try_from(id).ok().filter(|&id| id > 0)?,
            name: v
                .get("name")
                .and_then(Value::as_str)
                .unwrap_or("class")
                .into(),
            is_light: v.get("kind").and_then(Value::as_str) == Some("light"),
        })
    };
    list.into_iter().flatten().filter_map(class).collect()
}
