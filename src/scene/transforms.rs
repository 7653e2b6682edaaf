//! `transforms.json`: nerfstudio's keys and this program's additions, checked key by key.
//!
//! Everything wrong is collected, each message naming the frame and the key, so that one run shows
//! all there is to mend.

use super::known_keys::{distance, examine};
use super::rigid::rigid;
use super::{Class, frame_change::AppliedChange, unnamed_class};
use crate::core::geometry::{Lens, Projection};
use crate::core::math::colour::ColourSpace;
use crate::error::printable;
use glam::{DMat3, DVec3};
use serde_json::{Map, Value};

/// Pinhole intrinsics as the file gives them, in pixels of `w` × `h`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// `fl_x`, `fl_y`; `None` where the angles of view are given instead.
    pub focal: Option<[f64; 2]>,
    /// `camera_angle_x`, `camera_angle_y`: whole horizontal and vertical angle of view, radians.
    pub angle: [Option<f64>; 2],
    /// `cx`, `cy`; the image centre where absent.
    pub centre: Option<[f64; 2]>,
    /// `k1`, `k2`.
    pub k: [f64; 2],
    /// `p1`, `p2`.
    pub p: [f64; 2],
}

impl Intrinsics {
    /// Focal lengths in pixels of an image of this size.
    fn focal_in(&self, width: usize, height: usize) -> [f64; 2] {
        let of = |side: usize, angle: f64| 0.5 * side as f64 / (0.5 * angle).tan();
        self.focal.unwrap_or_else(|| {
            let [x, y] = self.angle;
            let fl_x = x.map(|a| of(width, a));
            let fl_y = y.map(|a| of(height, a));
            // square pixels where one angle is given
            let [x, y] = [fl_x.or(fl_y), fl_y.or(fl_x)];
            [x.unwrap_or(1.0), y.unwrap_or(1.0)]
        })
    }
}

impl Model {
    /// The projection onto an image of this size.
    #[must_use]
    pub fn projection(&self, width: usize, height: usize) -> Projection {
        let Self::Pinhole(i) = self else {
            return Projection::Equirectangular;
        };
        let [cx, cy] = i
            .centre
            .unwrap_or([0.5 * width as f64, 0.5 * height as f64]);
        let [fl_x, fl_y] = i.focal_in(width, height).map(|x| x as f32);
        Projection::Pinhole(Lens {
            fl_x,
            fl_y,
            cx: cx as f32,
            cy: cy as f32,
            k: i.k.map(|x| x as f32),
            p: i.p.map(|x| x as f32),
        })
    }
}

/// The projection a frame asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// `EQUIRECTANGULAR`.
    Equirectangular,
    /// `PINHOLE` or `OPENCV`.
    Pinhole(Intrinsics),
}

/// One entry of `frames`.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Position in the file's `frames`.
    pub index: usize,
    /// Radiance image, relative to the scene's folder.
    pub file_path: String,
    /// Class ids.
    pub label_path: Option<String>,
    /// 0 = ignore.
    pub mask_path: Option<String>,
    /// Camera-to-world rotation, made exactly orthonormal, in the y-up world.
    pub rotation: DMat3,
    /// Camera centre in the y-up world.
    pub position: DVec3,
    /// Projection.
    pub model: Model,
    /// `w`, `h` if stated.
    pub size: Option<[usize; 2]>,
    /// Working radiance = image · 2^ev; `None` if the key is absent.
    pub exposure_ev: Option<f32>,
    /// `color_space` of the frame or the scene, where the file itself is not to be asked.
    pub colour_space: Option<ColourSpace>,
}

/// The content of `transforms.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Transforms {
    /// Mesh, relative to the scene's folder.
    pub mesh_path: String,
    /// Frames in file order.
    pub frames: Vec<Frame>,
    /// `file_path` of all frames, damaged ones included: what the split may name.
    pub names: Vec<String>,
    /// Declared classes, ascending ids; `None` if the key is absent.
    pub classes: Option<Vec<Class>>,
    /// `train_filenames`.
    pub train: Option<Vec<String>>,
    /// `test_filenames`.
    pub test: Option<Vec<String>>,
    /// `rooms_path`.
    pub rooms_path: Option<String>,
    /// The file's world is z-up: meshes and rooms have to be turned like the poses already are.
    pub z_up: bool,
    /// `mesh_up_axis`: the same for the mesh alone; `None` if the key is absent.
    pub mesh_z_up: Option<bool>,
    /// Keys that are misspelt, each with the one that is meant; they are among the warnings.
    pub misspelt: Vec<String>,
    /// What a user should know of the file although it can be used.
    pub warnings: Vec<String>,
}

/// Turns z-up coordinates into y-up ones: (x, y, z) → (x, z, −y).
#[must_use]
pub fn y_up_from_z_up() -> DMat3 {
    DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y)
}

/// What `classes[].kind` may say.
pub const CLASS_KINDS: [&str; 2] = ["surface", "light"];

/// Reads the text of a `transforms.json`; on failure every problem found, each naming its place and
/// the cure.
///
/// # Errors
/// All problems, each naming its place and the cure.
pub fn parse_transforms(text: &str) -> Result<Transforms, Vec<String>> {
    match parse_usable(text)? {
        (transforms, issues) if issues.is_empty() => Ok(transforms),
        (_, issues) => Err(issues),
    }
}

/// What can be used of a `transforms.json` and the problems of the rest, so that the files of
/// intact frames can be checked in the same run; `Err` if the text is no JSON object.
pub(super) fn parse_usable(text: &str) -> Result<(Transforms, Vec<String>), Vec<String>> {
    let root: Value = serde_json::from_str(text).map_err(|e| {
        vec![format!(
            "line {}, column {}: not valid JSON ({e}); mend the file at that place",
            e.line(),
            e.column()
        )]
    })?;
    let Value::Object(root) = root else {
        return Err(vec![
            "the file must hold one JSON object {\"frames\": [...], ...}".into(),
        ]);
    };
    let mut issues = Vec::new();
    let globals = Keys {
        map: &root,
        place: String::new(),
    };
    let z_up = up_is_z(&globals, "up_axis", &mut issues).unwrap_or(false);
    let mesh_z_up = up_is_z(&globals, "mesh_up_axis", &mut issues);
    let keys = examine(&root);
    issues.extend(keys.issues);
    let mut warnings = keys.warnings;
    let change = AppliedChange::read(&root).unwrap_or_else(|e| {
        issues.push(e);
        AppliedChange::default()
    });
    warnings.extend(change.note());
    let world = FileWorld { z_up, change };
    let mesh_path = globals.text("mesh_path", &mut issues).unwrap_or_else(|| {
        if !root.contains_key("mesh_path") {
            issues
                .push("mesh_path: missing; add the path of the scene's .glb, .gltf, .obj or .ply, relative to this file".into());
        }
        String::new()
    });
    let frames = frames(&globals, &world, &mut issues);
    let classes = root
        .get("classes")
        .filter(|v| !v.is_null())
        .map(|v| classes(v, &mut issues));
    let train = globals.names("train_filenames", &mut issues);
    let test = globals.names("test_filenames", &mut issues);
    let rooms_path = globals.text("rooms_path", &mut issues);
    let names = frame_names(&root);
    Ok((
        Transforms {
            mesh_path,
            frames,
            names,
            classes,
            train,
            test,
            rooms_path,
            z_up,
            mesh_z_up,
            misspelt: keys.misspelt,
            warnings,
        },
        issues,
    ))
}

/// Whether the axis that `key` names points up as z does; `None` if the key is absent or wrong.
fn up_is_z(keys: &Keys<'_>, key: &str, issues: &mut Vec<String>) -> Option<bool> {
    match keys.text(key, issues)?.as_str() {
        "y" | "Y" | "+y" => Some(false),
        "z" | "Z" | "+z" => Some(true),
        other => {
            issues.push(format!("{key}: \"{other}\"; expected \"y\" or \"z\""));
            None
        }
    }
}

/// The frames that can be used.
fn frames(keys: &Keys<'_>, world: &FileWorld, issues: &mut Vec<String>) -> Vec<Frame> {
    let mut frames = Vec::new();
    match keys.map.get("frames") {
        Some(Value::Array(entries)) if entries.is_empty() => issues.push("frames: empty; list at least one posed image (a scan without photographs: `unbake delight MESH`)".into()),
        Some(Value::Array(entries)) => {
            for (index, entry) in entries.iter().enumerate() {
                match entry {
                    Value::Object(map) => frames.extend(frame(index, map, keys, world, issues)),
                    _ => issues.push(format!("frames[{index}]: expected an object with file_path and transform_matrix")),
                }
            }
        }
        Some(_) => issues.push("frames: expected a list".into()),
        None => issues.push("frames: missing; list the posed images as [{\"file_path\": ..., \"transform_matrix\": ...}]".into()),
    }
    frames
}

/// The images that frames name, usable or not.
fn frame_names(root: &Map<String, Value>) -> Vec<String> {
    let named = |entry: &Value| {
        entry
            .get("file_path")
            .and_then(Value::as_str)
            .map(str::to_owned)
    };
    root.get("frames")
        .and_then(Value::as_array)
        .into_iter()
        .flatten()
        .filter_map(named)
        .collect()
}

/// How the file's coordinates become the world's.
struct FileWorld {
    z_up: bool,
    change: AppliedChange,
}

/// Typed access to an object's keys with messages that name the place.
struct Keys<'a> {
    map: &'a Map<String, Value>,
    place: String,
}

impl Keys<'_> {
    fn at(&self, key: &str) -> String {
        if self.place.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.place)
        }
    }

    fn text(&self, key: &str, issues: &mut Vec<String>) -> Option<String> {
        match self.map.get(key)? {
            Value::Null => None,
            // names are only shown; paths have to be opened
            Value::String(s) if s.contains(char::is_control) && key == "name" => {
                Some(printable(s).into_owned())
            }
            Value::String(s) if s.contains(char::is_control) => {
                issues.push(format!(
                    "{}: \"{}\" contains a control character; rename it",
                    self.at(key),
                    printable(s)
                ));
                None
            }
            Value::String(s) if !s.is_empty() => Some(s.clone()),
            other => {
                issues.push(format!(
                    "{}: expected a non-empty text, found {}",
                    self.at(key),
                    shown(other)
                ));
                None
            }
        }
    }

    fn number(&self, key: &str, issues: &mut Vec<String>) -> Option<f64> {
        match self.map.get(key)? {
            Value::Null => None,
            v => match v.as_f64().filter(|n| n.is_finite()) {
                Some(n) => Some(n),
                None => {
                    issues.push(format!(
                        "{}: expected a finite number, found {}",
                        self.at(key),
                        shown(v)
                    ));
                    None
                }
            },
        }
    }

    fn names(&self, key: &str, issues: &mut Vec<String>) -> Option<Vec<String>> {
        match self.map.get(key)? {
            Value::Null => None,
            Value::Array(list) if list.iter().all(Value::is_string) => Some(
                list.iter()
                    .filter_map(|v| v.as_str().map(str::to_owned))
                    .collect(),
            ),
            other => {
                issues.push(format!(
                    "{}: expected a list of file names, found {}",
                    self.at(key),
                    shown(other)
                ));
                None
            }
        }
    }
}

/// A value short enough for a message.
fn shown(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((cut, _)) => format!("{}...", &text[..cut]),
        None => text,
    }
}

fn frame(
    index: usize,
    map: &Map<String, Value>,
    globals: &Keys<'_>,
    world: &FileWorld,
    issues: &mut Vec<String>,
) -> Option<Frame> {
    let before = issues.len();
    let mut keys = Keys {
        map,
        place: format!("frames[{index}]"),
    };
    let file_path = keys.text("file_path", issues);
    match &file_path {
        Some(name) => keys.place = format!("frames[{index}] ({name})"),
        None if issues.len() == before => issues.push(format!(
            "frames[{index}].file_path: missing; name the frame's image"
        )),
        None => {}
    }
    let pose = match map.get("transform_matrix") {
        Some(v) => match pose(v, world) {
            Ok(p) => Some(p),
            Err(m) => {
                issues.push(format!("{}: {m}", keys.at("transform_matrix")));
                None
            }
        },
        None => {
            issues.push(format!(
                "{}: missing; give the 4x4 camera-to-world matrix",
                keys.at("transform_matrix")
            ));
            None
        }
    };
    let size = size(&keys, globals, issues);
    let model = model(&keys, globals, issues);
    let colour_space = colour_space(&keys, globals, issues);
    let exposure = keys.number("exposure_ev", issues);
    if let Some(exposure) = exposure.filter(|e| e.abs() > 60.0) {
        issues.push(format!(
            "{}: {exposure} stops; expected a value between -60 and 60",
            keys.at("exposure_ev")
        ));
    }
    let label_path = keys.text("label_path", issues);
    let mask_path = keys.text("mask_path", issues);
    let (rotation, position) = pose?;
    let frame = Frame {
        index,
        file_path: file_path?,
        label_path,
        mask_path,
        rotation,
        position,
        model: model?,
        size,
        exposure_ev: exposure.map(|e| e as f32),
        colour_space,
    };
    (issues.len() == before).then_some(frame)
}

/// The frame's own colour space, else the scene's.
fn colour_space(
    keys: &Keys<'_>,
    globals: &Keys<'_>,
    issues: &mut Vec<String>,
) -> Option<ColourSpace> {
    let name = keys
        .text("color_space", issues)
        .or_else(|| globals.text("color_space", &mut Vec::new()))?;
    let found = ColourSpace::named(&name);
    if found.is_none() {
        let known: Vec<&str> = ColourSpace::NAMES.iter().map(|n| n.0).collect();
        issues.push(format!(
            "{}: \"{name}\"; expected one of {}",
            keys.at("color_space"),
            known.join(", ")
        ));
    }
    found
}

/// A frame's own value of a number, else the global one.
fn inherited(
    keys: &Keys<'_>,
    globals: &Keys<'_>,
    key: &str,
    issues: &mut Vec<String>,
) -> Option<f64> {
    keys.number(key, issues)
        .or_else(|| globals.number(key, &mut Vec::new()))
}

fn size(keys: &Keys<'_>, globals: &Keys<'_>, issues: &mut Vec<String>) -> Option<[usize; 2]> {
    let mut side = |key: &str| -> Option<usize> {
        let n = inherited(keys, globals, key, issues)?;
        if (1.0..=65_536.0).contains(&n) && n.fract() == 0.0 {
            Some(n as usize)
        } else {
            issues.push(format!(
                "{}: {n} pixels; expected a whole number from 1 to 65536",
                keys.at(key)
            ));
            None
        }
    };
    let (w, h) = (side("w"), side("h"));
    Some([w?, h?])
}

fn model(keys: &Keys<'_>, globals: &Keys<'_>, issues: &mut Vec<String>) -> Option<Model> {
    let name = keys
        .text("camera_model", issues)
        .or_else(|| globals.text("camera_model", &mut Vec::new()));
    let given = |key: &str| inherited(keys, globals, key, &mut Vec::new()).is_some();
    let pinhole = ["fl_x", "camera_angle_x", "camera_angle_y"]
        .into_iter()
        .any(given);
    match name.as_deref() {
        Some("EQUIRECTANGULAR") => return Some(Model::Equirectangular),
        Some("PINHOLE" | "OPENCV") => {}
        None if pinhole => {}
        None => {
            issues.push(format!(
                "{}: missing; state EQUIRECTANGULAR, PINHOLE or OPENCV, globally or per frame",
                keys.at("camera_model")
            ));
            return None;
        }
        Some(other) => {
            issues.push(format!(
                "{}: \"{other}\" is not supported; expected EQUIRECTANGULAR, PINHOLE or OPENCV (undistort fisheye images first)",
                keys.at("camera_model")
            ));
            return None;
        }
    }
    let mut get = |key: &str| inherited(keys, globals, key, issues);
    let (fl_x, fl_y) = (get("fl_x"), get("fl_y"));
    let angle = [get("camera_angle_x"), get("camera_angle_y")];
    let (cx, cy) = (get("cx"), get("cy"));
    let coefficients = ["k1", "k2", "p1", "p2"].map(|k| get(k).unwrap_or(0.0));
    let focal = fl_x.map(|x| [x, fl_y.unwrap_or(x)]);
    if let Some([x, y]) = focal.filter(|f| f[0].min(f[1]) <= 0.0 || !(f[0] + f[1]).is_finite()) {
        issues.push(format!(
            "{}: focal lengths {x}, {y}; expected positive pixels",
            keys.at("fl_x")
        ));
        return None;
    }
    // the older NeRF form states angles of view instead of focal lengths
    let angles: Vec<f64> = angle.iter().flatten().copied().collect();
    let usable = |a: &f64| (1e-3..std::f64::consts::PI - 1e-3).contains(a);
    if focal.is_none() && (angles.is_empty() || !angles.iter().all(usable)) {
        issues.push(format!(
            "{}: missing; a pinhole camera needs its focal length in pixels, or camera_angle_x in radians (0 to pi)",
            keys.at("fl_x")
        ));
        return None;
    }
    if name.as_deref() == Some("PINHOLE") && coefficients.iter().any(|&c| c != 0.0) {
        issues.push(format!(
            "{}: PINHOLE with distortion coefficients; state OPENCV or remove k1 k2 p1 p2",
            keys.at("camera_model")
        ));
        return None;
    }
    let [k1, k2, p1, p2] = coefficients;
    Some(Model::Pinhole(Intrinsics {
        focal,
        angle,
        centre: cx.zip(cy).map(|(x, y)| [x, y]),
        k: [k1, k2],
        p: [p1, p2],
    }))
}

/// Rotation (exactly orthonormal) and position of a 4×4 or 3×4 camera-to-world matrix.
fn pose(value: &Value, world: &FileWorld) -> Result<(DMat3, DVec3), String> {
    let shape = || "expected 4 rows of 4 finite numbers".to_owned();
    let rows = value
        .as_array()
        .filter(|r| r.len() == 4 || r.len() == 3)
        .ok_or_else(shape)?;
    let mut m = [[0.0f64; 4]; 4];
    m[3][3] = 1.0;
    for (row, target) in rows.iter().zip(&mut m) {
        let row = row.as_array().filter(|r| r.len() == 4).ok_or_else(shape)?;
        for (v, t) in row.iter().zip(target.iter_mut()) {
            *t = v.as_f64().filter(|x| x.is_finite()).ok_or_else(shape)?;
        }
    }
    if m[3][..3].iter().any(|x| x.abs() > 1e-6) || (m[3][3] - 1.0).abs() > 1e-6 {
        return Err(format!(
            "the last row is {:?}, expected [0, 0, 0, 1]; store the matrix by rows (transpose it)",
            m[3]
        ));
    }
    let column = |j: usize| DVec3::new(m[0][j], m[1][j], m[2][j]);
    let rotation = rigid(DMat3::from_cols(column(0), column(1), column(2)))?;
    let (rotation, position) = world.change.undone(rotation, column(3));
    if position.abs().max_element() > 1e9 {
        return Err(format!(
            "the camera lies at {position}, over 1e9 m from the origin; one unit is one metre"
        ));
    }
    Ok(if world.z_up {
        (y_up_from_z_up() * rotation, y_up_from_z_up() * position)
    } else {
        (rotation, position)
    })
}

fn classes(value: &Value, issues: &mut Vec<String>) -> Vec<Class> {
    let Value::Array(list) = value else {
        issues.push(format!(
            "classes: expected a list of {{id, name, kind}}, found {}",
            shown(value)
        ));
        return Vec::new();
    };
    let mut classes: Vec<Class> = Vec::with_capacity(list.len());
    for (i, entry) in list.iter().enumerate() {
        let Value::Object(map) = entry else {
            issues.push(format!(
                "classes[{i}]: expected {{id, name, kind}}, found {}",
                shown(entry)
            ));
            continue;
        };
        let keys = Keys {
            map,
            place: format!("classes[{i}]"),
        };
        let Some(id) = map
            .get("id")
            .and_then(Value::as_u64)
            .and_then(|n| u16::try_from(n).ok())
            .filter(|&n| n > 0)
        else {
            issues.push(format!(
                "classes[{i}].id: expected a whole number from 1 to 65535 (0 means unlabelled)"
            ));
            continue;
        };
        if let Some(other) = classes.iter().find(|c| c.id == id) {
            issues.push(format!(
                "classes[{i}].id: {id} is already taken by \"{}\"; give every class its own id",
                other.name
            ));
            continue;
        }
        let name = keys
            .text("name", issues)
            .unwrap_or_else(|| unnamed_class(id));
        let is_light = is_light(&keys, issues);
        classes.push(Class { id, name, is_light });
    }
    classes.sort_by_key(|c| c.id);
    classes
}

/// Whether a class is of kind `light`; capitals do not count, other words than the known ones are
/// an issue.
fn is_light(keys: &Keys<'_>, issues: &mut Vec<String>) -> bool {
    let Some(kind) = keys.text("kind", issues) else {
        return false;
    };
    let kind = kind.trim().to_lowercase();
    if !CLASS_KINDS.contains(&kind.as_str()) {
        let near = CLASS_KINDS.iter().filter(|k| distance(&kind, k) <= 2);
        let near = near.map(|k| format!(": did you mean \"{k}\"?"));
        issues.push(format!(
            "{}: \"{kind}\" is not one of {}{}",
            keys.at("kind"),
            CLASS_KINDS.join(", "),
            near.take(1).collect::<String>()
        ));
    }
    kind == "light"
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: &str = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";

    fn with_frame(globals: &str, frame: &str) -> Result<Transforms, Vec<String>> {
        parse_transforms(&format!(
            r#"{{"mesh_path":"m.glb",{globals}"frames":[{{"file_path":"a.exr",{frame}}}]}}"#
        ))
    }

    fn with_matrix(matrix: &str) -> Result<Transforms, Vec<String>> {
        with_frame(
            r#""camera_model":"EQUIRECTANGULAR","#,
            &format!(r#""transform_matrix":{matrix}"#),
        )
    }

    #[test]
    fn a_minimal_file_is_understood() {
        let t = with_matrix(IDENTITY).expect("valid");
        assert_eq!(t.frames[0].position, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(t.frames[0].model, Model::Equirectangular);
        assert!(t.classes.is_none() && t.train.is_none());
    }

    #[test]
    fn z_up_turns_poses_so_that_up_is_y() {
        // a level camera of a z-up world looks along +y: its up axis is world z
        let matrix = "[[1,0,0,1],[0,0,-1,2],[0,1,0,3],[0,0,0,1]]";
        let t = with_frame(
            r#""camera_model":"EQUIRECTANGULAR","up_axis":"z","#,
            &format!(r#""transform_matrix":{matrix}"#),
        )
        .expect("valid");
        let f = &t.frames[0];
        assert!(
            (f.rotation * DVec3::Y - DVec3::Y).length() < 1e-12,
            "up stays up"
        );
        assert_eq!(f.position, DVec3::new(1.0, 3.0, -2.0));
        assert!((f.rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn bad_poses_say_what_is_wrong() {
        let cases = [
            ("[[0,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]", "singular"),
            ("[[-1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]", "mirrored"),
            (
                "[[2,0,0,1],[0,2,0,2],[0,0,2,3],[0,0,0,1]]",
                "scaled by 2.000000",
            ),
            ("[[1,0.5,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]", "not rigid"),
            ("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[1,2,3,1]]", "by rows"),
            ("[[1,0,0],[0,1,0],[0,0,1]]", "4 rows of 4"),
            ("[[1,0,0,null],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "finite"),
            (
                "[[1,0,0,1e300],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
                "one unit is one metre",
            ),
            ("\"x\"", "4 rows of 4"),
        ];
        for (matrix, expected) in cases {
            let issues = with_matrix(matrix).expect_err(matrix);
            assert!(
                issues[0].contains("frames[0] (a.exr).transform_matrix")
                    && issues[0].contains(expected),
                "{issues:?}"
            );
        }
        assert!(
            with_matrix("[[0.9999,0,0,1],[0,1.0001,0,2],[0,0,1,3],[0,0,0,1]]").is_ok(),
            "rounding is mended"
        );
    }

    #[test]
    fn intrinsics_are_global_or_per_frame() {
        let pose = format!(r#""transform_matrix":{IDENTITY}"#);
        let t = with_frame(
            r#""camera_model":"OPENCV","fl_x":100,"fl_y":110,"w":64,"h":48,"k1":0.1,"#,
            &format!(r#""fl_x":120,"cx":30,"cy":20,{pose}"#),
        );
        let Model::Pinhole(i) = t.expect("valid").frames[0].model else {
            panic!("pinhole")
        };
        assert_eq!(
            (i.focal, i.centre, i.k),
            (Some([120.0, 110.0]), Some([30.0, 20.0]), [0.1, 0.0])
        );
        for (globals, expected) in [
            (r#""camera_model":"OPENCV_FISHEYE","#, "undistort"),
            ("", "camera_model: missing"),
            (r#""camera_model":"PINHOLE","#, "fl_x: missing"),
            (r#""camera_model":"PINHOLE","fl_x":-3,"#, "positive"),
            (
                r#""camera_model":"EQUIRECTANGULAR","w":1e9,"h":2,"#,
                "whole number",
            ),
            (
                r#""camera_model":"EQUIRECTANGULAR","w":0,"h":2,"#,
                "whole number",
            ),
        ] {
            let issues = with_frame(globals, &pose).expect_err(globals);
            assert!(
                issues.iter().any(|i| i.contains(expected)),
                "{globals}: {issues:?}"
            );
        }
    }

    #[test]
    fn everything_wrong_is_reported_at_once() {
        let issues = parse_transforms(
            r#"{"up_axis":"w","frames":[{"file_path":3},{},[1]],"classes":[{"id":0},{"id":5},{"id":5},{"id":70000},7],"train_filenames":"all","rooms_path":[]}"#,
        )
        .expect_err("all wrong");
        for place in [
            "up_axis",
            "mesh_path",
            "frames[0]",
            "frames[1]",
            "frames[2]",
            "classes[0]",
            "classes[2]",
            "classes[3]",
            "classes[4]",
            "train_filenames",
            "rooms_path",
        ] {
            assert!(
                issues.iter().any(|i| i.starts_with(place)),
                "{place} in {issues:#?}"
            );
        }
    }

    #[test]
    fn other_texts_are_errors_and_never_panics() {
        let deep = "[".repeat(100_000);
        for text in [
            "",
            "{",
            "[]",
            "null",
            "\u{feff}{}",
            "{\"frames\":{}}",
            "{\"frames\":[{\"file_path\":\"a\\u0000b\"}]}",
            &deep,
            "PK\u{3}\u{4}",
        ] {
            assert!(parse_transforms(text).is_err());
        }
    }
}
