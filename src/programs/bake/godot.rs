//! The lightmap for Godot: a folder for a project, whose `lit.tscn` shows the scene with its light.
//!
//! Godot finds a lightmap's surfaces by the paths of their nodes and their coordinates in the second set. It alters names that it
//! takes for hints, that stand twice or have other characters, so the scene's nodes get names that it keeps. Layout of the files:
//! Godot's own for text resources, `BakedLightmapData` (3.x) and `LightmapGIData` (4.x).

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
    let users = Users::of(&root);
    if users.skinned > 0 {
        notes.insert(format!(
            "{FOLDER}: {} skinned meshes have no lightmap there: Godot puts them below skeletons",
            users.skinned
        ));
    }
    atomic_write(folder.join("scene.glb"), &glb_of(&root, &document.bytes)?)?;
    let shown = irradiance.map(|e| *e * FRAC_1_PI);
    write_rgb_float(folder.join("lightmap.exr"), &shown)?;
    let texts = match version {
        GodotVersion::Three => three(&users.paths),
        GodotVersion::Four => four(&users.paths),
    };
    let [import, data, scene] = texts;
    for (name, text) in [
        ("lightmap.exr.import", import),
        ("lightmap.tres", data),
        ("lit.tscn", scene),
    ] {
        atomic_write(folder.join(name), text.as_bytes())?;
    }
    Ok(())
}

/// How to import the picture, the lightmap's resource, and the scene, for Godot 3.
fn three(paths: &[String]) -> [String; 3] {
    let users = joined(paths, |path| {
        format!("NodePath(\"{path}\"), ExtResource( 1 ), -1")
    });
    [
        "[remap]\n\nimporter=\"texture\"\ntype=\"StreamTexture\"\n\n[params]\n\ncompress/mode=3\nflags/repeat=0\nflags/filter=true\n\
         flags/mipmaps=false\nflags/srgb=0\nstream=false\nsize_limit=0\ndetect_3d=false\n"
            .to_owned(),
        format!(
            "[gd_resource type=\"BakedLightmapData\" load_steps=2 format=2]\n\n\
             [ext_resource path=\"lightmap.exr\" type=\"Texture\" id=1]\n\n[resource]\nuser_data = [ {users} ]\n"
        ),
        "[gd_scene load_steps=3 format=2]\n\n[ext_resource path=\"scene.glb\" type=\"PackedScene\" id=1]\n\
         [ext_resource path=\"lightmap.tres\" type=\"BakedLightmapData\" id=2]\n\n[node name=\"Lit\" type=\"Spatial\"]\n\n\
         [node name=\"Scene\" parent=\".\" instance=ExtResource( 1 )]\n\n[node name=\"Lightmap\" type=\"BakedLightmap\" parent=\".\"]\n\
         light_data = ExtResource( 2 )\n"
            .to_owned(),
    ]
}

/// The same for Godot 4.
fn four(paths: &[String]) -> [String; 3] {
    let users = joined(paths, |path| {
        format!("NodePath(\"{path}\"), Rect2(0, 0, 1, 1), 0, -1")
    });
    [
        "[remap]\n\nimporter=\"2d_array_texture\"\ntype=\"CompressedTexture2DArray\"\n\n[params]\n\ncompress/mode=3\n\
         compress/channel_pack=1\nmipmaps/generate=false\nslices/horizontal=1\nslices/vertical=1\n"
            .to_owned(),
        format!(
            "[gd_resource type=\"LightmapGIData\" load_steps=2 format=3]\n\n\
             [ext_resource type=\"CompressedTexture2DArray\" path=\"lightmap.exr\" id=\"1\"]\n\n[resource]\n\
             lightmap_textures = Array[TextureLayered]([ExtResource(\"1\")])\nuses_spherical_harmonics = false\nuser_data = [{users}]\n"
        ),
        "[gd_scene load_steps=3 format=3]\n\n[ext_resource type=\"PackedScene\" path=\"scene.glb\" id=\"1\"]\n\
         [ext_resource type=\"LightmapGIData\" path=\"lightmap.tres\" id=\"2\"]\n\n[node name=\"Lit\" type=\"Node3D\"]\n\n\
         [node name=\"Scene\" parent=\".\" instance=ExtResource(\"1\")]\n\n[node name=\"Lightmap\" type=\"LightmapGI\" parent=\".\"]\n\
         light_data = ExtResource(\"2\")\n"
            .to_owned(),
    ]
}

fn joined(paths: &[String], user: impl Fn(&String) -> String) -> String {
    paths.iter().map(user).collect::<Vec<_>>().join(", ")
}

/// Nodes with a lightmap, as seen from the node of the lightmap.
#[derive(Default)]
struct Users {
    paths: Vec<String>,
    /// Nodes with a mesh that have none.
    skinned: usize,
}

impl Users {
    fn of(root: &Value) -> Self {
        let mut out = Self::default();
        let mut open: Vec<(usize, String)> = top_nodes(root)
            .into_iter()
            .rev()
            .map(|n| (n, "../Scene".to_owned()))
            .collect();
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

/// The nodes at the top of the scene that is shown; of a file without scenes, those that are nobody's children.
fn top_nodes(root: &Value) -> Vec<usize> {
    let scene = root["scene"].as_u64().unwrap_or(0) as usize;
    if root["scenes"][scene].is_object() {
        return numbers(&root["scenes"][scene]["nodes"]).collect();
    }
    let nodes = root["nodes"].as_array().map_or(&[][..], Vec::as_slice);
    let children: BTreeSet<usize> = nodes.iter().flat_map(|n| numbers(&n["children"])).collect();
    (0..nodes.len()).filter(|n| !children.contains(n)).collect()
}

/// Gives all nodes names that Godot keeps: of letters, digits, spaces, `-` and `_`, no hints, each once.
fn name_nodes(root: &mut Value) {
    // what the importer calls the top itself
    let mut taken = BTreeSet::from(["scene".to_owned(), "lit".to_owned()]);
    for node in root["nodes"].as_array_mut().into_iter().flatten() {
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
    const LIGHTS: &str = "KHR_lights_punctual";
    let drop = |value: &mut Value| {
        let Some(extensions) = value["extensions"].as_object_mut() else {
            return;
        };
        extensions.remove(LIGHTS);
        if extensions.is_empty() {
            value.as_object_mut().map(|o| o.remove("extensions"));
        }
    };
    if root.get("extensions").is_some() {
        drop(root);
    }
    let nodes = root["nodes"].as_array_mut().into_iter().flatten();
    nodes
        .filter(|n| n.get("extensions").is_some())
        .for_each(drop);
    for key in ["extensionsUsed", "extensionsRequired"] {
        let Some(list) = root.get_mut(key).and_then(Value::as_array_mut) else {
            continue;
        };
        list.retain(|name| name != LIGHTS);
        if list.is_empty() {
            root.as_object_mut().map(|o| o.remove(key));
        }
    }
}

/// Exchanges the lightmap's set of coordinates with the second, the only one that Godot has beside the first.
fn lightmap_second(root: &mut Value, set: u32) {
    if set == 1 {
        return;
    }
    let [second, own] = ["TEXCOORD_1".to_owned(), format!("TEXCOORD_{set}")];
    for mesh in root["meshes"].as_array_mut().into_iter().flatten() {
        for primitive in mesh["primitives"].as_array_mut().into_iter().flatten() {
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
        let users = Users::of(&root);
        assert_eq!(
            users.paths,
            [
                "../Scene/room/wall",
                "../Scene/room/wall/picture",
                "../Scene/floor"
            ]
        );
        assert_eq!(users.skinned, 1);
        let root = json!({"nodes": [{"name": "a", "children": [1]}, {"name": "b", "mesh": 0}]});
        assert_eq!(Users::of(&root).paths, ["../Scene/a/b"]);
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
