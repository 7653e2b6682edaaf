//! A capture as large as those of professional cameras, from a small scene: `cargo run --release
//! --example large_capture SCENE OUT ENLARGE SUBDIVIDE`. Photographs and labels are enlarged ENLARGE times
//! along each side, triangles are cut into 4 SUBDIVIDE times over. Nothing new is to be seen on it: it
//! is for measuring memory and time. Called by `scripts/memory_growth`.

use glam::Vec3;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;
use unbake::core::formats;
use unbake::core::geometry::Mesh;
use unbake::core::image::Plane;
use unbake::programs::synth::mesh_glb;
use unbake::scene::{LoadOptions, Scene, View};
use unbake::{Error, Result};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |text: &String| text.parse::<usize>().ok();
    let [scene, out, enlarge, subdivide] = arguments.as_slice() else {
        return Err(usage());
    };
    let (Some(enlarge @ 1..=64), Some(subdivide @ 0..=8)) = (number(enlarge), number(subdivide))
    else {
        return Err(usage());
    };
    write(scene, Path::new(out), enlarge, subdivide)
}

fn usage() -> Error {
    Error::Usage("large_capture SCENE OUT ENLARGE (1 to 64) SUBDIVIDE (0 to 8)".into())
}

fn write(from: &str, out: &Path, enlarge: usize, subdivide: usize) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| Error::Failed(format!("{}: {e}", out.display()));
    let scene = Scene::load(from, &LoadOptions::default())?;
    for folder in ["images", "labels"] {
        std::fs::create_dir_all(out.join(folder)).map_err(|e| failed(&e))?;
    }
    let text = formats::read_input_text(&scene.folder.join("transforms.json"))?;
    let mut json: Value = serde_json::from_str(&text).map_err(|e| failed(&e))?;
    let root = json.as_object_mut().ok_or_else(|| failed(&"no object"))?;
    root.remove("rooms_path");
    root.insert("mesh_path".into(), json!("mesh.glb"));
    let frames = root["frames"].as_array_mut().into_iter().flatten();
    frames
        .zip(&scene.views)
        .par_bridge()
        .try_for_each(|(frame, view)| {
            let image = format!("images/{}.exr", view.stem);
            let large = enlarged(&scene.load_radiance(view)?, enlarge);
            formats::write_rgb_half(out.join(&image), &large)?;
            frame["file_path"] = json!(image);
            frame["w"] = json!(large.width);
            frame["h"] = json!(large.height);
            labels(&scene, view, out, enlarge, frame)
        })?;
    let mut mesh = scene.mesh.clone();
    for _ in 0..subdivide {
        mesh = subdivided(&mesh);
    }
    let origin = scene.origin.as_vec3();
    mesh.positions.iter_mut().for_each(|p| *p += origin);
    formats::atomic_write(out.join("mesh.glb"), &mesh_glb(&mesh)?)?;
    formats::atomic_write(out.join("transforms.json"), json.to_string().as_bytes())?;
    println!("{} triangles", mesh.triangles.len());
    Ok(())
}

fn labels(scene: &Scene, view: &View, out: &Path, enlarge: usize, frame: &mut Value) -> Result<()> {
    if let Some(labels) = scene.load_labels(view)? {
        let name = format!("labels/{}.png", view.stem);
        formats::write_png16(out.join(&name), &enlarged(&labels, enlarge))?;
        frame["label_path"] = json!(name);
    }
    Ok(())
}

/// Every pixel as a square of `by` × `by`.
fn enlarged<T: Copy>(plane: &Plane<T>, by: usize) -> Plane<T> {
    let (width, height) = (plane.width * by, plane.height * by);
    let at = |i: usize| plane[(i % width / by, i / width / by)];
    Plane {
        width,
        height,
        data: (0..width * height).map(at).collect(),
    }
}

/// Every triangle cut at the middles of its edges.
fn subdivided(mesh: &Mesh) -> Mesh {
    let mut fine = mesh.clone();
    let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
    let cut = |&[a, b, c]: &[u32; 3]| {
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (i, j) = (a as usize, b as usize);
                let of = |v: &[Vec3]| (v[i] + v[j]) * 0.5;
                fine.positions.push(of(&mesh.positions));
                fine.normals.push(of(&mesh.normals).normalize_or_zero());
                fine.uvs.push((mesh.uvs[i] + mesh.uvs[j]) * 0.5);
                (fine.uvs.len() - 1) as u32
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    };
    fine.triangles = mesh.triangles.iter().flat_map(cut).collect();
    fine
}
