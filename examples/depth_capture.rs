//! A capture of poses, photographs, labels and depth in the layout of nerfstudio, of a scene that has a
//! mesh: `cargo run --release --example depth_capture SCENE OUT`. Depth is exact, of the training views
//! alone, metres along the ray; mesh and rooms are left out. Called by `scripts/from_depth`.

use serde_json::{Value, json};
use std::path::Path;
use unbake::core::formats;
use unbake::core::trace::EmbreeTracer;
use unbake::gbuffer::ViewBuffer;
use unbake::scene::{LoadOptions, Scene, Split};
use unbake::{Error, Result};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(Error::Usage("depth_capture SCENE OUT".into()));
    };
    let scene = Scene::load(scene, &LoadOptions::default())?;
    write(&scene, Path::new(&out))
}

fn write(scene: &Scene, out: &Path) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| Error::Failed(format!("{}: {e}", out.display()));
    std::fs::create_dir_all(out.join("depth")).map_err(|e| failed(&e))?;
    let folder = std::path::absolute(&scene.folder).map_err(|e| failed(&e))?;
    let from = folder.join("transforms.json");
    let text = formats::read_input_text(&from)?;
    let mut json: Value = serde_json::from_str(&text).map_err(|e| failed(&e))?;
    let root = json.as_object_mut().ok_or_else(|| failed(&"no object"))?;
    for key in ["mesh_path", "rooms_path"] {
        root.remove(key);
    }
    let tracer = EmbreeTracer::new(&scene.mesh)?;
    for frame in root["frames"].as_array_mut().into_iter().flatten() {
        let named = |key: &str| frame.get(key).and_then(Value::as_str).map(str::to_owned);
        let image = named("file_path").ok_or_else(|| failed(&"a frame without file_path"))?;
        for file in [Some(image.clone()), named("label_path"), named("mask_path")] {
            link(&folder, out, file).map_err(|e| failed(&e))?;
        }
        let mut views = scene.views.iter().filter(|v| v.split == Split::Train);
        let Some(view) = views.find(|v| v.image_path.ends_with(&image)) else {
            continue;
        };
        let mut depth = ViewBuffer::trace(&view.camera, &tracer).distance;
        let none = |d: &mut f32| *d = if d.is_finite() { *d } else { 0.0 };
        depth.data.iter_mut().for_each(none);
        let name = format!("depth/{}.exr", view.stem);
        formats::write_plane_float(out.join(&name), &depth)?;
        frame["depth_file_path"] = json!(name);
    }
    formats::atomic_write(out.join("transforms.json"), json.to_string().as_bytes())
}

/// A link to a file of the scene at the same place of the capture.
fn link(scene: &Path, out: &Path, file: Option<String>) -> std::io::Result<()> {
    let Some(file) = file else { return Ok(()) };
    let place = out.join(&file);
    place.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    match place.exists() {
        true => Ok(()),
        false => std::os::unix::fs::symlink(scene.join(&file), place),
    }
}
