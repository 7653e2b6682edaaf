//! The lightmap for Godot: a folder for a project, whose `lit.tscn` shows the scene with its light.
//!
//! Godot finds a lightmap's surfaces by the paths of their nodes and their coordinates in the second set. It alters names that it
//! takes for hints, that stand twice or have other characters, so the scene's nodes get names that it keeps. Layout of the files:
//! Godot's own for text resources, `BakedLightmapData` (3.x) and `LightmapGIData` (4.x).

use super::document::{forget_extensions, list, remove_extensions};
use super::options::GodotVersion;
use super::output::LitDocument;
use crate::core::formats::{atomic_write, glb_of, write_rgb_float};
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use serde_json::Value;
use std::collections::BTreeSet;
use std::f32::consts::FRAC_1_PI;
use std::path::Path;

/// The folder.
pub(super) const FOLDER: &str = "godot";
/// What lies in it.
pub(super) const FILES: [&str; 5] = [
    "scene.glb",
    "lightmap.exr",
    "lightmap.exr.import",
    "lightmap.tres",
    "lit.tscn",
];
/// Ends of names, after `-` or `_`, by which Godot's importer makes other nodes of them.
const HINTS: [&str; 11] = [
    "noimp",
    "col",
    "convcol",
    "colonly",
    "convcolonly",
    "navmesh",
    "occ",
    "occonly",
    "rigid",
    "vehicle",
    "wheel",
];

/// Writes the folder into `out`: `scene.glb` without its lights, which are baked, `lightmap.exr` (E/π, which Godot multiplies by
/// the base colour), how to import it, `lightmap.tres` and `lit.tscn`. Adds to the notes what has no lightmap there.
///
/// # Errors
/// Writing fails.
pub(super) fn write_godot(
    out: &Path,
    version: GodotVersion,
    document: &LitDocument,
    irradiance: &RgbPlane,
    notes: &mut BTreeSet<String>,
) -> Result<()> {
    let folder = out.join(FOLDER);
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let mut root = document.root.clone();
    name_nodes(&mut root);
    without_lights(&mut root);
    lightmap_second(&mut root, document.shown.tex_coord);
    let users = Users::of(&root, &document.top_nodes);
    if users.skinned > 0 {
        notes.insert(format!(
            "{FOLDER}: {} skinned meshes have no lightmap there: Godot puts them below skeletons",
            users.skinned
        ));
    }
    let [scene, lightmap, text_files @ ..] = FILES;
    atomic_write(folder.join(scene), &glb_of(&root, &document.bytes)?)?;
    let shown = irradiance.map(|e| *e * FRAC_1_PI);
    write_rgb_float(folder.join(lightmap), &shown)?;
    let texts = Texts::of(version, &users.paths);
    let texts = [texts.import, &*texts.lightmap, texts.scene];
    for (name, text) in text_files.into_iter().zip(texts) {
        atomic_write(folder.join(name), text.as_bytes())?;
    }
    Ok(())
}

/// What Godot reads as text.
struct Texts {
    /// How to import the picture.
    import: &'static str,
    /// The lightmap's resource.
    lightmap: String,
    /// The scene.
    scene: &'static str,
}

impl Texts {
    fn of(version: GodotVersion, paths: &[String]) -> Self {
        let users = |one: &dyn Fn(&String) -> String| {
            let all: Vec<String> = paths.iter().map(one).collect();
            all.join(", ")
        };
        match version {
            GodotVersion::Three => {
                let users = users(&|path| format!("NodePath(\"{path}\"), ExtResource( 1 ), -1"));
                Self {
                    import: include_str!("godot/3/lightmap.exr.import"),
                    lightmap: format!(
                        "[gd_resource type=\"BakedLightmapData\" load_steps=2 format=2]\n\n\
                         [ext_resource path=\"lightmap.exr\" type=\"Texture\" id=1]\n\n[resource]\nuser_data = [ {users} ]\n"
                    ),
                    scene: include_str!("godot/3/lit.tscn"),
                }
            }
            GodotVersion::Four => {
                let users =
                    users(&|path| format!("NodePath(\"{path}\"), Rect2(0, 0, 1, 1), 0, -1"));
                Self {
                    import: include_str!("godot/4/lightmap.exr.import"),
                    lightmap: format!(
                        "[gd_resource type=\"LightmapGIData\" load_steps=2 format=3]\n\n\
                         [ext_resource type=\"CompressedTexture2DArray\" path=\"lightmap.exr\" id=\"1\"]\n\n[resource]\n\
                         lightmap_textures = Array[TextureLayered]([ExtResource(\"1\")])\nuses_spherical_harmonics = false\nuser_data = [{users}]\n"
                    ),
                    scene: include_str!("godot/4/lit.tscn"),
                }
            }
        }
    }
}

/// Nodes with a lightmap, as seen from the node of the lightmap.
#[derive(Default)]
struct Users {
    paths: Vec<String>,
    /// Nodes with a mesh that have none.
    skinned: usize,
}

impl Users {
    fn of(root: &Value, top_nodes: &[usize]) -> Self {
        let mut out = Self::default();
        let top = top_nodes.iter().rev();
        let mut open: Vec<(usize, String)> = top.map(|&n| (n, "../Scene".to_owned())).collect();
        // a node that is its own descendant would never end
        let mut seen = BTreeSet::new();
        while let Some((number, parent)) = open.pop() {
            let node = &root["nodes"][number];
            if node.is_null() || !seen.insert(number) {
                continue;
            }
            let path = format!("{parent}/{}", node["name"].as_str().unwrap_or_default());
            if !node["skin"].is_null() {
                out.skinned += 1;
            } else if !node["mesh"].is_null() {
                out.paths.push(path.clone());
            }
            open.extend(numbers(&node["children"]).rev().map(|c| (c, path.clone())));
        }
        out
    }
}

fn numbers(list: &Value) -> impl DoubleEndedIterator<Item = usize> + '_ {
    list.as_array()
        .into_iter()
        .flatten()
        .filter_map(|n| n.as_u64().map(|n| n as usize))
}

/// Gives all nodes names that Godot keeps: of letters, digits, spaces, `-` and `_`, no hints, each once.
fn name_nodes(root: &mut Value) {
    // what the importer calls the top itself
    let mut taken = BTreeSet::from(["scene".to_owned(), "lit".to_owned()]);
    for node in list(root, "nodes") {
        let wanted = kept_name(node["name"].as_str().unwrap_or_default());
        let name = (1..)
            .map(|n| match n {
                1 => wanted.clone(),
                _ => format!("{wanted} {n}"),
            })
            .find(|name| taken.insert(name.to_lowercase()));
        node["name"] = name.into();
    }
}

fn kept_name(name: &str) -> String {
    let safe = |c: char| c.is_ascii_alphanumeric() || matches!(c, ' ' | '-' | '_');
    let name: String = name
        .chars()
        .map(|c| if safe(c) { c } else { '_' })
        .collect();
    let name = name.trim();
    if name.is_empty() {
        return "Node".to_owned();
    }
    match name.rsplit_once(['-', '_']) {
        Some((rest, end)) if HINTS.contains(&end.to_lowercase().as_str()) => {
            format!("{rest} {end}")
        }
        _ => name.to_owned(),
    }
}

/// Takes the lights out.
fn without_lights(root: &mut Value) {
    const LIGHTS: [&str; 1] = ["KHR_lights_punctual"];
    remove_extensions(root, &LIGHTS);
    list(root, "nodes").for_each(|node| remove_extensions(node, &LIGHTS));
    forget_extensions(root, &LIGHTS);
}

/// Exchanges the lightmap's set of coordinates with the second, the only one that Godot has beside the first.
fn lightmap_second(root: &mut Value, set: u32) {
    if set == 1 {
        return;
    }
    let [second, own] = ["TEXCOORD_1".to_owned(), format!("TEXCOORD_{set}")];
    for mesh in list(root, "meshes") {
        for primitive in list(mesh, "primitives") {
            if let Some(attributes) = primitive["attributes"].as_object_mut() {
                let before = [attributes.remove(&second), attributes.remove(&own)];
                let [second_before, own_before] = before;
                let after = [(second.clone(), own_before), (own.clone(), second_before)];
                attributes.extend(after.into_iter().filter_map(|(k, v)| Some((k, v?))));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn names_are_kept_by_godot_and_stand_once() {
        let mut root = json!({"nodes": [
            {"name": "a/b.c"}, {"name": "A_B_C"}, {"name": ""}, {}, {"name": "table-col"}, {"name": "Scene"}, {"name": "Tür"},
        ]});
        name_nodes(&mut root);
        let names: Vec<&str> = (0..7)
            .map(|i| root["nodes"][i]["name"].as_str().expect("name"))
            .collect();
        assert_eq!(
            names,
            [
                "a_b_c",
                "A_B_C 2",
                "Node",
                "Node 2",
                "table col",
                "Scene 2",
                "T_r"
            ]
        );
    }

    #[test]
    fn users_are_the_meshes_of_the_scene_by_their_paths() {
        let root = json!({
            "scene": 0,
            "scenes": [{"nodes": [0, 4]}],
            "nodes": [
                {"name": "room", "children": [1, 2]},
                {"name": "wall", "mesh": 0, "children": [3]},
                {"name": "doll", "mesh": 1, "skin": 0},
                {"name": "picture", "mesh": 2},
                {"name": "floor", "mesh": 3, "children": [4]},
                {"name": "elsewhere", "mesh": 4},
            ],
        });
        let users = Users::of(&root, &[0, 4]);
        assert_eq!(
            users.paths,
            [
                "../Scene/room/wall",
                "../Scene/room/wall/picture",
                "../Scene/floor"
            ]
        );
        assert_eq!(users.skinned, 1);
    }

    #[test]
    fn lights_go_and_the_lightmap_comes_second() {
        let mut root = json!({
            "extensionsUsed": ["KHR_lights_punctual"],
            "extensions": {"KHR_lights_punctual": {"lights": []}},
            "nodes": [{"extensions": {"KHR_lights_punctual": {"light": 0}, "OTHER": {}}}],
            "meshes": [{"primitives": [{"attributes": {"TEXCOORD_0": 0, "TEXCOORD_1": 1, "TEXCOORD_2": 2}}]}],
        });
        without_lights(&mut root);
        lightmap_second(&mut root, 2);
        assert!(root.get("extensions").is_none() && root.get("extensionsUsed").is_none());
        assert_eq!(root["nodes"][0]["extensions"], json!({"OTHER": {}}));
        assert_eq!(
            root["meshes"][0]["primitives"][0]["attributes"],
            json!({"TEXCOORD_0": 0, "TEXCOORD_1": 2, "TEXCOORD_2": 1})
        );
    }
}
