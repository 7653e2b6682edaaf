//! Every key of `transforms.json` that means something here, and what becomes of it.
//!
//! Nothing in a scene's file is passed over in silence: a key is used, or known to change nothing
//! that a reconstruction needs, or refused because it would change geometry; any other is listed
//! with the nearest known one, since it is misspelt more often than not. `docs/scene-format.md` and
//! `docs/transforms.schema.json` are tested against this list.
//!
//! Called by `transforms`; keys of nerfstudio and instant-ngp after their own documentation.

use crate::error::printable;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// What becomes of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// It is read.
    Used,
    /// It says nothing that a reconstruction needs: other programs' settings.
    Passed,
    /// It changes geometry in a way not supported: refused unless it is zero, false or empty.
    Refused,
}

/// Where a key may stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// At the top of the file.
    Scene,
    /// In an entry of `frames`.
    Frame,
    /// In either; a frame's own value wins.
    Both,
    /// In an entry of `classes`.
    Class,
}

/// A key of `transforms.json`.
#[derive(Clone, Copy, Debug)]
pub struct KnownKey {
    /// Its name.
    pub name: &'static str,
    /// Where it may stand.
    pub place: Place,
    /// What becomes of it.
    pub meaning: Meaning,
}

const fn key(name: &'static str, place: Place, meaning: Meaning) -> KnownKey {
    KnownKey {
        name,
        place,
        meaning,
    }
}

use Meaning::{Passed, Refused, Used};
use Place::{Both, Class, Frame, Scene};

/// All of them.
pub const KNOWN_KEYS: &[KnownKey] = &[
    key("frames", Scene, Used),
    key("mesh_path", Scene, Used),
    key("classes", Scene, Used),
    key("train_filenames", Scene, Used),
    key("test_filenames", Scene, Used),
    key("rooms_path", Scene, Used),
    key("up_axis", Scene, Used),
    key("mesh_up_axis", Scene, Used),
    key("applied_transform", Scene, Used),
    key("applied_scale", Scene, Used),
    key("camera_model", Both, Used),
    key("color_space", Both, Used),
    key("w", Both, Used),
    key("h", Both, Used),
    key("fl_x", Both, Used),
    key("fl_y", Both, Used),
    key("cx", Both, Used),
    key("cy", Both, Used),
    key("k1", Both, Used),
    key("k2", Both, Used),
    key("p1", Both, Used),
    key("p2", Both, Used),
    key("camera_angle_x", Both, Used),
    key("camera_angle_y", Both, Used),
    key("file_path", Frame, Used),
    key("transform_matrix", Frame, Used),
    key("label_path", Frame, Used),
    key("mask_path", Frame, Used),
    key("exposure_ev", Frame, Used),
    key("id", Class, Used),
    key("name", Class, Used),
    key("kind", Class, Used),
    // lenses and shutters that are not modelled
    key("k3", Both, Refused),
    key("k4", Both, Refused),
    key("k5", Both, Refused),
    key("k6", Both, Refused),
    key("skew", Both, Refused),
    key("is_fisheye", Both, Refused),
    key("distortion_params", Both, Refused),
    key("rolling_shutter_offset", Both, Refused),
    key("rolling_shutter_time", Both, Refused),
    // depth images, other programs' clouds, crops of their training
    key("depth_file_path", Frame, Passed),
    key("depth_path", Frame, Passed),
    key("depth_unit_scale_factor", Scene, Passed),
    key("integer_depth_scale", Scene, Passed),
    key("enable_depth_loading", Scene, Passed),
    key("semantic_path", Frame, Passed),
    key("normal_path", Frame, Passed),
    key("ply_file_path", Scene, Passed),
    key("sparse_ply_file_path", Scene, Passed),
    key("aabb_scale", Scene, Passed),
    key("aabb", Scene, Passed),
    key("scene_box", Scene, Passed),
    key("scale", Scene, Passed),
    key("offset", Scene, Passed),
    key("from_na", Scene, Passed),
    key("orientation_override", Scene, Passed),
    key("auto_scale_poses_override", Scene, Passed),
    key("white_transparent", Scene, Passed),
    key("black_transparent", Scene, Passed),
    key("n_extra_learnable_dims", Scene, Passed),
    key("is_hdr", Scene, Passed),
    key("val_filenames", Scene, Passed),
    key("fps", Scene, Passed),
    key("version", Scene, Passed),
    key("generator", Scene, Passed),
    key("comment", Both, Passed),
    key("colmap_im_id", Frame, Passed),
    key("camera_id", Frame, Passed),
    key("sharpness", Frame, Passed),
    key("rotation", Frame, Passed),
    key("timestamp", Frame, Passed),
    key("time", Frame, Passed),
    key("color", Class, Passed),
    key("colour", Class, Passed),
];

/// The known key of this name that may stand at `place`.
fn known(name: &str, place: Place) -> Option<&'static KnownKey> {
    let fits = |k: &&KnownKey| {
        k.name == name && (k.place == place || (k.place == Both && matches!(place, Scene | Frame)))
    };
    KNOWN_KEYS.iter().find(fits)
}

/// What a user should know of the keys of a file, and what makes it unusable.
#[derive(Debug, Default)]
pub struct KeyFindings {
    /// Keys nobody knows, each with the nearest known one.
    pub warnings: Vec<String>,
    /// Those among them that are near a known one.
    pub misspelt: Vec<String>,
    /// Keys that would change geometry.
    pub issues: Vec<String>,
}

/// Looks at every key of a `transforms.json`; keys that occur in many frames are told once.
#[must_use]
pub fn examine(root: &Map<String, Value>) -> KeyFindings {
    let mut objects: Vec<(String, Place, &Map<String, Value>)> = vec![(String::new(), Scene, root)];
    for (list, place) in [("frames", Frame), ("classes", Class)] {
        let entries = root.get(list).and_then(Value::as_array);
        for (i, entry) in entries.into_iter().flatten().enumerate() {
            if let Value::Object(map) = entry {
                objects.push((format!("{list}[{i}]."), place, map));
            }
        }
    }
    let mut unknown: BTreeMap<(&str, usize), (String, usize)> = BTreeMap::new();
    let mut found = KeyFindings::default();
    for (at, place, map) in objects {
        for (name, value) in map {
            match known(name, place) {
                Some(k) if k.meaning == Refused && !is_nothing(value) => {
                    found.issues.push(refusal(&at, name));
                }
                Some(_) => {}
                // other programs' own notes
                None if name.starts_with('_') || name.starts_with("//") => {}
                None => {
                    let first = unknown.entry((name, place as usize));
                    first.or_insert_with(|| (at.clone(), 0)).1 += 1;
                }
            }
        }
    }
    for ((name, place), (at, times)) in unknown {
        let place = [Scene, Frame, Both, Class][place];
        let near = nearest(name, place);
        let said = warning(name, near, &at, times);
        found.misspelt.extend(near.map(|_| said.clone()));
        found.warnings.push(said);
    }
    found
}

fn warning(name: &str, near: Option<&str>, at: &str, times: usize) -> String {
    let often = match times {
        1 => String::new(),
        n => format!(" and {} more", n - 1),
    };
    let advice = match near {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => "it is ignored".to_owned(),
    };
    format!(
        "{at}{}{often}: no key known here; {advice}",
        printable(name)
    )
}

fn refusal(at: &str, name: &str) -> String {
    let cure = match name {
        "is_fisheye" | "k3" | "k4" | "k5" | "k6" | "skew" | "distortion_params" => {
            "only PINHOLE and OPENCV with k1, k2, p1, p2 are supported: undistort the images first"
        }
        _ => {
            "rolling shutters are not modelled: give rectified images, or remove the key if the camera stood still"
        }
    };
    format!("{at}{name}: {cure}")
}

/// Zero, false, empty or null.
fn is_nothing(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Number(n) => n.as_f64() == Some(0.0),
        Value::Array(list) => list.iter().all(is_nothing),
        Value::String(s) => s.is_empty(),
        _ => false,
    }
}

/// Other programs' words for keys, which letters alone would lead astray: COLMAP's, OpenCV's and
/// glTF's.
const OTHER_WORDS: [(&str, &str); 6] = [
    ("fx", "fl_x"),
    ("fy", "fl_y"),
    ("width", "w"),
    ("height", "h"),
    ("exposure", "exposure_ev"),
    ("xfov", "camera_angle_x"),
];

/// The known key that a misspelt one most likely means: at most a third of its letters away.
fn nearest(name: &str, place: Place) -> Option<&'static str> {
    let plain = |s: &str| s.to_lowercase().replace(['-', ' '], "_");
    let name = plain(name);
    let other = OTHER_WORDS.iter().find(|w| w.0 == name);
    if let Some((_, meant)) = other.filter(|_| place != Class) {
        return Some(meant);
    }
    let fits = |k: &&KnownKey| {
        k.meaning == Used
            && (k.place == place || (k.place == Both && matches!(place, Scene | Frame)))
    };
    let candidates = KNOWN_KEYS.iter().filter(fits);
    let (far, found) = candidates
        .map(|k| (distance(&name, k.name), k.name))
        .min()?;
    (far <= name.chars().count().max(3) / 3).then_some(found)
}

/// Edits that turn `a` into `b` (insert, delete, replace, swap neighbours): optimal string
/// alignment. Long names are cut: none of ours is longer.
pub(super) fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) =
        (a.chars().take(64).collect(), b.chars().take(64).collect());
    let mut rows = vec![vec![0usize; b.len() + 1]; a.len() + 1];
    for (i, row) in rows.iter_mut().enumerate() {
        row[0] = i;
    }
    rows[0] = (0..=b.len()).collect();
    for i in 1..=a.len() {
        for j in 1..=b.len() {
            let replace = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = replace.min(rows[i - 1][j] + 1).min(rows[i][j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            rows[i][j] = best;
        }
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn examined(value: &Value) -> KeyFindings {
        examine(value.as_object().expect("object"))
    }

    #[test]
    fn misspelt_keys_are_listed_once_with_the_nearest() {
        let frame = json!({"file_path": "a.exr", "lable_path": "a.png", "maskpath": "m.png"});
        let found = examined(
            &json!({"frames": [frame, frame, frame], "mesh-path": "m.glb",
            "completely_different": 1, "_note": 2, "classes": [{"id": 1, "Kind": "light"}]}),
        );
        let all = found.warnings.join("\n");
        for said in [
            "frames[0].lable_path and 2 more: no key known here; did you mean \"label_path\"?",
            "did you mean \"mask_path\"?",
            "mesh-path: no key known here; did you mean \"mesh_path\"?",
            "completely_different: no key known here; it is ignored",
            "classes[0].Kind: no key known here; did you mean \"kind\"?",
        ] {
            assert!(all.contains(said), "{said} in\n{all}");
        }
        assert_eq!((found.warnings.len(), found.issues.len()), (5, 0));
    }

    #[test]
    fn keys_that_change_geometry_are_refused_unless_they_say_nothing() {
        let harmless = json!({"is_fisheye": false, "k3": 0, "distortion_params": [0, 0.0]});
        assert!(examined(&harmless).issues.is_empty());
        let found = examined(&json!({"is_fisheye": true, "frames": [{"k4": 0.1}]}));
        assert_eq!(found.issues.len(), 2);
        assert!(found.issues[0].contains("is_fisheye") && found.issues[0].contains("undistort"));
        assert!(found.issues[1].starts_with("frames[0].k4"));
    }

    #[test]
    fn the_schema_has_the_keys_that_are_used_and_no_other() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/transforms.schema.json");
        let text = std::fs::read_to_string(path).expect("schema");
        let schema: Value = serde_json::from_str(&text).expect("JSON");
        for (place, object) in [
            (Scene, &schema),
            (Frame, &schema["$defs"]["frame"]),
            (Class, &schema["$defs"]["class"]),
        ] {
            let stated = object["properties"].as_object().expect("properties");
            let used = |k: &&KnownKey| {
                k.meaning == Used && (k.place == place || (k.place == Both && place != Class))
            };
            for k in KNOWN_KEYS.iter().filter(used) {
                let said = stated.get(k.name).map(ToString::to_string);
                assert!(
                    said.is_some_and(|s| s.contains("description")),
                    "{}",
                    k.name
                );
            }
            for name in stated.keys() {
                let known = known(name, place).is_some_and(|k| k.meaning == Used);
                assert!(known, "{name} is in the schema only");
            }
        }
    }

    #[test]
    fn names_of_the_list_are_unique_at_a_place() {
        for (i, a) in KNOWN_KEYS.iter().enumerate() {
            let twin = KNOWN_KEYS[i + 1..]
                .iter()
                .find(|b| a.name == b.name && a.place == b.place);
            assert!(twin.is_none(), "{}", a.name);
        }
        assert_eq!(distance("lable", "label"), 1, "a swap is one slip");
        assert_eq!(distance("", "abc"), 3);
    }
}
