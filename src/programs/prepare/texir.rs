//! TexIR's release layout (CVPR 2023): `vrproc/` with HDR panoramas, poses, semantic images, one
//! mesh with an atlas, and the room grid.
//!
//! Conventions (read off the authors' code): poses are camera-to-world with OpenCV axes (right,
//! down, forward); panoramas as in docs/scene-format.md; working radiance = image · 2ᵉ, e = 5 (3 for scenes
//! 1 and 7); alpha of `panoImage_orig.jpg` (a PNG by content) is a mask.

use super::account::Account;
use super::camera_axes::gl_from_cv;
use super::capture::RoomIds;
use super::capture::{Capture, Mask, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions};
use super::lens::Optics;
use crate::core::formats;
use crate::error::{Error, Result};
use crate::scene::Class;
use glam::{DMat4, DVec2};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The exposure of all released scenes but two.
const EXPOSURE_EV: f64 = 5.0;

/// The importer.
pub struct TexIr;

impl Importer for TexIr {
    fn kind(&self) -> &'static str {
        "texir"
    }

    fn looks_like(&self) -> &'static str {
        "TexIR's release: vrproc/ with info/, hdr/, derived/, hdr_texture/"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no vrproc/info/aligned.txt; give the folder that holds vrproc";
        Located::new(path, root(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let root = &located.start;
        let facts = read_facts(&root.join("info/classes.json"));
        let ev = facts.get("exposure_power").and_then(Value::as_f64);
        let mut shots = Vec::new();
        for (ids, poses, held_out) in [
            ("aligned.txt", "final_extrinsics.txt", false),
            ("novel.txt", "novel_extrinsics.txt", true),
        ] {
            if root.join("info").join(ids).is_file() {
                let ids = read_ids(&root.join("info").join(ids))?;
                let poses = read_poses(&root.join("info").join(poses), ids.len())?;
                for (id, pose) in ids.iter().zip(poses) {
                    let mut shot = view(root, id, pose);
                    shot.exposure_ev = Some(ev.unwrap_or(EXPOSURE_EV));
                    shot.held_out = Some(held_out);
                    shots.push(shot);
                }
            }
        }
        let mesh = root.join("hdr_texture/out1.obj");
        account.read(format!(
            "{}: {} panoramas, of which {} are held out",
            root.display(),
            shots.len(),
            shots.iter().filter(|s| s.held_out == Some(true)).count()
        ));
        account.converted("poses from OpenCV to OpenGL axes");
        account.converted(format!(
            "working radiance is the image times 2^{} (the release's exposure; scenes 1 and 7 have 3)",
            ev.unwrap_or(EXPOSURE_EV)
        ));
        account.ignored("the baked textures (radiance, irradiance, index map) and true materials; class 0 counts as unlabelled");
        Ok(Capture {
            shots,
            surface: Some(mesh).filter(|m| m.is_file()).map(Surface::of_file),
            classes: classes(&facts),
            room_grid: room_grid(root, account)?,
            up: Up::Unknown,
            ..Capture::default()
        })
    }
}

fn root(path: &Path) -> Option<PathBuf> {
    [path.join("vrproc"), path.to_path_buf()]
        .into_iter()
        .find(|p| p.join("info/aligned.txt").is_file() && p.join("hdr").is_dir())
}

/// What a class file says, if there is one.
fn read_facts(path: &Path) -> Value {
    formats::read_input_text(path)
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or(Value::Null)
}

fn classes(facts: &Value) -> Vec<Class> {
    let Some(map) = facts.get("classes").and_then(Value::as_object) else {
        return Vec::new();
    };
    let mut classes: Vec<Class> = map
        .iter()
        .filter_map(|(id, names)| {
            let id = id.parse().ok().filter(|&id: &u16| id > 0)?;
            let name = match names {
                Value::Array(list) => list.first()?.as_str()?,
                other => other.as_str()?,
            };
            Some(Class {
                id,
                name: name.into(),
                is_light: false,
            })
        })
        .collect();
    classes.sort_by_key(|c| c.id);
    classes
}

fn read_ids(path: &Path) -> Result<Vec<String>> {
    Ok(formats::read_input_text(path)?
        .split_whitespace()
        .map(Into::into)
        .collect())
}

fn read_poses(path: &Path, count: usize) -> Result<Vec<DMat4>> {
    let text = formats::read_input_text(path)?;
    let fail = |m: String| {
        Error::input(
            path,
            format!("{m}; expected the number of views, then 4 lines of 4 numbers each"),
        )
    };
    let mut words = text.split_whitespace();
    let stated: usize = words
        .next()
        .and_then(|w| w.parse().ok())
        .ok_or_else(|| fail("line 1: no number".into()))?;
    if stated != count {
        return Err(fail(format!("{stated} poses for {count} views")));
    }
    let numbers: Vec<f64> = words
        .map(|w| w.parse::<f64>().ok().filter(|x| x.is_finite()))
        .collect::<Option<_>>()
        .ok_or_else(|| fail("something that is no finite number".into()))?;
    if numbers.len() != 16 * count {
        return Err(fail(format!("{} numbers for {count} views", numbers.len())));
    }
    let pose = |rows: &[f64]| {
        let mut m = [0.0; 16];
        m.copy_from_slice(rows);
        gl_from_cv(DMat4::from_cols_array(&m).transpose())
    };
    Ok(numbers.chunks_exact(16).map(pose).collect())
}

fn view(root: &Path, id: &str, pose: DMat4) -> Shot {
    let derived = root.join("derived").join(id);
    let existing = |name: &str| Some(derived.join(name)).filter(|p| p.is_file());
    let mut shot = Shot::new(
        id,
        root.join("hdr").join(id).join("ccm.hdr"),
        pose,
        Optics::Panorama,
    );
    shot.labels = existing("panoImage_gray.png");
    // only a PNG can carry the mask, whatever its name
    shot.mask = existing("panoImage_orig.jpg")
        .filter(|p| formats::image_info(p).is_ok_and(|i| i.format == formats::ImageFormat::Png))
        .map(Mask::Alpha);
    shot
}

fn room_grid(root: &Path, account: &mut Account) -> Result<Option<RoomIds>> {
    let meta = root.join("roomseg/originOccupancyGrid_f0.meta");
    let picture = root.join("roomseg/roomSegs_uchar_f0.png");
    if !meta.is_file() || !picture.is_file() {
        return Ok(None);
    }
    let numbers: Vec<f64> = formats::read_input_text(&meta)?
        .split_whitespace()
        .filter_map(|w| w.parse().ok())
        .collect();
    let [cell, _, _, x, z, ..] = numbers[..] else {
        return Err(Error::input(
            &meta,
            "expected scale, width, height, x_min, z_min",
        ));
    };
    match formats::read_labels(&picture) {
        Ok(cells) if cell.is_finite() && cell > 0.0 && x.is_finite() && z.is_finite() => {
            Ok(Some(RoomIds {
                cells,
                cell,
                min: DVec2::new(x, z),
            }))
        }
        Ok(_) => Err(Error::input(
            &meta,
            "expected a positive scale and finite corners",
        )),
        Err(e) => {
            account.ignored(format!("the room grid: {e}"));
            Ok(None)
        }
    }
}
