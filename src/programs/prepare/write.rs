//! The scene folder of a capture: made aside, then renamed into place whole.

use super::account::Account;
use super::capture::{Capture, LabelledMesh, Shot, Surface, Up};
use super::depth_mesh::mesh_of_depth;
use super::folder::{MARK, SceneFolder, extension};
use super::frame::FrameWriter;
use super::importer::PrepareOptions;
use super::labels::LabelSource;
use super::lens::Optics;
use super::network;
use super::plan::room_ids;
use super::ply_out::write_ply;
use crate::core::formats;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::scene::{Class, ClassesByName};
use glam::{DMat3, DMat4, DVec3};
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Captures with fewer photographs keep them all for training.
const FEWEST_TO_HOLD_OUT: usize = 16;

/// Figures of a scene folder that was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Frames.
    pub frames: usize,
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Rooms of the grid.
    pub rooms: usize,
}

/// Writes `capture` as the scene folder `out`; what is changed on the way goes into `account`.
///
/// # Errors
/// [`Error::Input`] where `out` holds something else or a photograph cannot be used, [`Error::Io`]
/// where writing fails; then `out` is as it was.
pub fn write_scene(
    mut capture: Capture,
    out: &Path,
    options: &PrepareOptions,
    account: &mut Account,
    progress: &Progress,
) -> Result<Written> {
    let folder = SceneFolder::new(out)?;
    rescale(&mut capture, options.scale, account);
    unique_stems(&mut capture.shots);
    hold_out(&mut capture.shots, options.hold_out, account);
    let meshed = capture.surface.is_some();
    // (what the networks see goes with this, once it is copied)
    let _seen = network::predict(&mut capture, meshed, &options.networks, account, progress)?;
    let mesh = match mesh_of(&mut capture, account)? {
        None => mesh_of_depth(&capture.shots, account, progress)?.map(SceneMesh::Decoded),
        given => given,
    };
    let written = mesh.as_ref().map(|mesh| write_mesh(&folder, mesh));
    let (mesh_name, triangles) = written.unwrap_or(Ok((None, 0)))?;
    let source = match &mesh {
        Some(SceneMesh::Decoded(m)) if m.classes.iter().any(|&c| c > 0) => {
            Some(LabelSource::new(m)?)
        }
        _ => None,
    };
    let steps = capture.shots.len() as u64;
    let frames: Vec<Result<Value>> = progress.stage("writing the frames", steps, |progress| {
        let writer = FrameWriter {
            folder: &folder,
            labels: source.as_ref(),
            link: options.link,
        };
        let one = |shot: &Shot| {
            let frame = writer.write(shot);
            progress.advance(1);
            frame
        };
        capture.shots.par_iter().map(one).collect()
    });
    let (frames, failed): (Vec<_>, Vec<_>) = frames.into_iter().partition(Result::is_ok);
    let mut failed: Vec<Error> = failed.into_iter().filter_map(Result::err).collect();
    match failed.len() {
        0 => {}
        1 => return Err(failed.swap_remove(0)),
        _ => return Err(Error::Inputs(failed)),
    }
    let frames: Vec<Value> = frames.into_iter().flatten().collect();
    tell_resampled(&capture.shots, account);
    let rooms = write_rooms(&folder, &capture)?;
    if source.is_some() && !frames.is_empty() {
        account.converted("labels per pixel were rendered from the classes of the surface");
    }
    if mesh.is_none() {
        account.ignored(
            "nothing, but there is no mesh. Give one with --mesh, then run `unbake prepare` again",
        );
    }
    if frames.is_empty() {
        account.ignored(
            "nothing, but there are no photographs: the folder holds geometry and classes only. Add posed images to its transforms.json; where there will be none, `unbake delight` takes the mesh's own colours as the light",
        );
    }
    let scene = transforms(&capture, frames, mesh_name.as_deref(), rooms > 0);
    folder.write_json("transforms.json", &scene)?;
    folder.write_json(MARK, &json!({"account": account}))?;
    folder.publish()?;
    Ok(Written {
        frames: capture.shots.len(),
        triangles,
        rooms,
    })
}

/// Says how many photographs were resampled.
fn tell_resampled(shots: &[Shot], account: &mut Account) {
    let beyond = |s: &&Shot| matches!(s.optics, Optics::Distorted(_));
    let resampled = shots.iter().filter(beyond).count();
    if resampled > 0 {
        account.converted(format!(
            "{resampled} photographs of lenses beyond OpenCV's k1 k2 p1 p2 were resampled without distortion, with masks"
        ));
    }
}

fn rescale(capture: &mut Capture, scale: Option<f64>, account: &mut Account) {
    let Some(s) = scale.filter(|&s| s != 1.0) else {
        return;
    };
    for shot in &mut capture.shots {
        shot.world_from_camera.w_axis = (shot.world_from_camera.w_axis.truncate() * s).extend(1.0);
        shot.points.iter_mut().for_each(|p| *p *= s);
    }
    match &mut capture.surface {
        Some(Surface::File {
            world_from_file, ..
        }) => *world_from_file = DMat4::from_scale(DVec3::splat(s)) * *world_from_file,
        Some(Surface::Built(m)) => m.mesh.positions.iter_mut().for_each(|p| *p *= s),
        None => {}
    }
    if let Some(grid) = &mut capture.room_grid {
        grid.cell *= s;
        grid.min *= s;
    }
    for room in &mut capture.rooms {
        room.corners.iter_mut().for_each(|c| *c *= s);
    }
    account.converted(format!("all lengths were multiplied by {s} (--scale)"));
}

/// Stems name everything written for a view: characters other programs dislike go, and a second
/// one of a name gets a number.
fn unique_stems(shots: &mut [Shot]) {
    let mut taken = BTreeSet::new();
    for shot in shots {
        let plain: String = shot
            .stem
            .chars()
            .map(|c| {
                if c.is_alphanumeric() || "-_.".contains(c) {
                    c
                } else {
                    '_'
                }
            })
            .collect();
        let plain = if plain.is_empty() {
            "view".into()
        } else {
            plain
        };
        let free = (2..)
            .map(|n| format!("{plain}_{n}"))
            .find(|s| !taken.contains(s));
        let stem = match taken.contains(&plain) {
            true => free.unwrap_or(plain),
            false => plain,
        };
        taken.insert(stem.clone());
        shot.stem = stem;
    }
}

/// Chooses held-out frames where the capture states none.
fn hold_out(shots: &mut [Shot], every: usize, account: &mut Account) {
    let stated = shots.iter().any(|s| s.held_out.is_some());
    if stated || every == 0 || shots.len() < FEWEST_TO_HOLD_OUT {
        return;
    }
    // in the middle of each group, so that neighbours on both sides are trained on
    let first = (every - 1) / 2;
    for (i, shot) in shots.iter_mut().enumerate() {
        shot.held_out = Some(i % every == first);
    }
    let count = shots.iter().filter(|s| s.held_out == Some(true)).count();
    account.converted(format!(
        "{count} of {} photographs are held out (--hold-out {every}); --hold-out 0 trains on all",
        shots.len()
    ));
}

/// The mesh on its way into the folder.
enum SceneMesh {
    /// Copied as it is.
    Copied(PathBuf),
    /// Written as PLY.
    Decoded(LabelledMesh),
}

/// The capture's mesh.
fn mesh_of(capture: &mut Capture, account: &mut Account) -> Result<Option<SceneMesh>> {
    let unlabelled = capture.shots.iter().all(|s| s.labels.is_none());
    let Some(surface) = capture.surface.clone() else {
        return Ok(None);
    };
    let (path, world_from_file) = match surface {
        Surface::Built(mesh) => return Ok(Some(SceneMesh::Decoded(mesh))),
        Surface::File {
            path,
            world_from_file,
        } => (path, world_from_file),
    };
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    let alone = ["glb", "ply", "obj"].contains(&extension.to_ascii_lowercase().as_str());
    if alone && world_from_file == DMat4::IDENTITY {
        account.read(format!("mesh {}", path.display()));
        let named = ClassesByName::of(&formats::read_mesh(&path)?);
        account_names(named.as_ref().filter(|_| unlabelled), account);
        return Ok(Some(SceneMesh::Copied(path)));
    }
    let mut mesh = formats::read_mesh(&path)?;
    account.read(format!("mesh {}", path.display()));
    let named = ClassesByName::of(&mesh).filter(|_| unlabelled && capture.classes.is_empty());
    account_names(named.as_ref(), account);
    if world_from_file != DMat4::IDENTITY {
        let turn = DMat3::from_mat4(world_from_file);
        mesh.positions
            .iter_mut()
            .for_each(|p| *p = world_from_file.transform_point3(*p));
        let turn = turn.inverse().transpose().as_mat3();
        mesh.normals
            .iter_mut()
            .for_each(|n| *n = (turn * *n).normalize_or_zero());
        account.converted("the mesh was turned and scaled into the world of the poses");
    }
    let classes = named.map_or_else(Vec::new, |named| {
        capture.classes = named.classes;
        named.mesh.of_triangle
    });
    Ok(Some(SceneMesh::Decoded(LabelledMesh { mesh, classes })))
}

/// Says what the mesh's names are taken for.
fn account_names(named: Option<&ClassesByName>, account: &mut Account) {
    if let Some(named) = named {
        account.read(format!(
            "without label images the mesh's {}",
            named.account()
        ));
    }
}

/// The content of `transforms.json`.
fn transforms(capture: &Capture, frames: Vec<Value>, mesh: Option<&str>, rooms: bool) -> Value {
    let mut scene = Map::new();
    let panoramas = capture.shots.iter().all(|s| s.optics == Optics::Panorama);
    if panoramas && !capture.shots.is_empty() {
        scene.insert("camera_model".into(), json!("EQUIRECTANGULAR"));
    }
    scene.insert(
        "up_axis".into(),
        json!(if capture.up == Up::Z { "z" } else { "y" }),
    );
    if let Some(mesh) = mesh {
        scene.insert("mesh_path".into(), json!(mesh));
    }
    if !capture.classes.is_empty() {
        let class = |c: &Class| json!({"id": c.id, "name": c.name, "kind": if c.is_light { "light" } else { "surface" }});
        let classes: Vec<Value> = capture.classes.iter().map(class).collect();
        scene.insert("classes".into(), json!(classes));
    }
    if rooms {
        scene.insert("rooms_path".into(), json!("rooms.png"));
    }
    if capture.shots.iter().any(|s| s.held_out == Some(true)) {
        let of = |held_out: bool| -> Vec<&Value> {
            frames
                .iter()
                .zip(&capture.shots)
                .filter(|(_, s)| s.held_out.unwrap_or(false) == held_out)
                .map(|(f, _)| &f["file_path"])
                .collect()
        };
        scene.insert("train_filenames".into(), json!(of(false)));
        scene.insert("test_filenames".into(), json!(of(true)));
    }
    scene.insert("frames".into(), Value::Array(frames));
    Value::Object(scene)
}

/// Writes the mesh; its name and number of triangles.
fn write_mesh(folder: &SceneFolder, mesh: &SceneMesh) -> Result<(Option<String>, usize)> {
    match mesh {
        SceneMesh::Decoded(m) => {
            write_ply(&folder.at("mesh.ply"), m)?;
            Ok((Some("mesh.ply".into()), m.mesh.triangles.len()))
        }
        SceneMesh::Copied(path) => {
            let triangles = formats::read_mesh(path)?.triangles.len();
            let name = format!("mesh.{}", extension(path));
            folder.take(path, &name, false)?;
            Ok((Some(name), triangles))
        }
    }
}

/// Writes the grid of room ids; the number of rooms.
fn write_rooms(folder: &SceneFolder, capture: &Capture) -> Result<usize> {
    let Some(ids) = room_ids(&capture.rooms).or_else(|| capture.room_grid.clone()) else {
        return Ok(0);
    };
    formats::write_png16(folder.at("rooms.png"), &ids.cells)?;
    let names: Vec<&str> = capture.rooms.iter().map(|r| r.name.as_str()).collect();
    folder.write_json(
        "rooms.json",
        &json!({"cell": ids.cell, "x_min": ids.min.x, "z_min": ids.min.y, "names": names}),
    )?;
    let mut found: Vec<u16> = ids.cells.data.clone();
    found.sort_unstable();
    found.dedup();
    Ok(found.iter().filter(|&&id| id > 0).count())
}
