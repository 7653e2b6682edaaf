//! Apple RoomPlan's parametric export: a USDZ of boxes and meshes whose prims are named after what
//! they are (`Wall3`, `Door0`, `Sofa1`): a mesh with a class per triangle. Files of USD by modelling
//! programs are read in the same way.
//!
//! `usd_files` finds the layers, `usda` and `usdc` read them, `usd_stage` composes them, `usd_mesh`
//! draws what they hold.

use super::account::Account;
use super::capture::{Capture, Surface, Up};
use super::folder::extension;
use super::importer::{Importer, Located, PrepareOptions, of_kind};
use super::usd_layer::Value;
use super::usd_mesh::Drawing;
use super::usd_stage::Stage;
use crate::error::{Error, Result};
use crate::scene::Class;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The importer.
pub struct RoomPlan;

impl Importer for RoomPlan {
    fn kind(&self) -> &'static str {
        "roomplan"
    }

    fn looks_like(&self) -> &'static str {
        "RoomPlan: a .usdz (or .usda, .usdc) of walls, doors, windows and furniture"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no .usdz, .usda or .usdc here, or several; name the file";
        Located::new(path, usd_file(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let file = &located.start;
        let stage = Stage::open(file)?;
        let metres = (stage.metadata("metersPerUnit")?)
            .and_then(|v| v.number())
            .filter(|m| m.is_finite() && *m > 0.0)
            .unwrap_or(0.01);
        let mut drawing = Drawing::new(&stage, file, metres);
        drawing.all()?;
        if drawing.mesh.mesh.triangles.is_empty() {
            return Err(Error::input(
                file,
                match drawing.hidden.is_empty() {
                    true => "holds no Mesh and no Cube; export the room again",
                    false => {
                        "all its meshes and boxes are invisible, inactive, or of purpose guide or proxy; export them visible"
                    }
                },
            ));
        }
        describe(&drawing, file, account);
        let up = stage.metadata("upAxis")?;
        let z_up = up.as_ref().and_then(Value::text) == Some("Z");
        let mut classes: Vec<Class> = drawing.classes.into_values().collect();
        classes.sort_by_key(|c| c.id);
        Ok(Capture {
            surface: Some(Surface::Built(drawing.mesh)),
            classes,
            up: if z_up { Up::Z } else { Up::Y },
            ..Capture::default()
        })
    }
}

/// What was read and what was left out.
fn describe(drawing: &Drawing<'_>, file: &Path, account: &mut Account) {
    let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
    for class in &drawing.mesh.classes {
        *counts.entry(*class).or_default() += 1;
    }
    let classes = (drawing.classes.values())
        .map(|c| format!("{} ({})", c.name, counts.get(&c.id).unwrap_or(&0)))
        .collect::<Vec<_>>();
    account.read(format!(
        "{}: {} triangles of {}",
        file.display(),
        drawing.mesh.mesh.triangles.len(),
        classes.join(", ")
    ));
    account.converted("classes from the names of prims; boxes to twelve triangles each");
    if drawing.copies > 0 {
        account.converted(format!(
            "{} copies by point instancers to triangles of their own",
            drawing.copies
        ));
    }
    if drawing.moving > 0 {
        account.converted(format!(
            "{} prims that change in time, as their first sample has them",
            drawing.moving
        ));
    }
    for (reason, count) in &drawing.hidden {
        account.ignored(format!("{count} prims that are {reason}"));
    }
    for (kind, count) in &drawing.skipped {
        account.ignored(format!("{count} prims of type {kind}"));
    }
    account.ignored("colours of the drawing; RoomPlan draws no ceiling");
}

/// The file itself, or the only one of its kind in a folder.
fn usd_file(path: &Path) -> Option<PathBuf> {
    let endings = ["usdz", "usda", "usdc", "usd"];
    let found = of_kind(path, |p| endings.contains(&extension(p).as_str()));
    match found.as_slice() {
        [only] => Some(only.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::programs::prepare::{LabelledMesh, usdc};
    use glam::DVec3;

    #[test]
    fn boxes_face_outwards_under_their_transforms() {
        let dir = tempfile::tempdir().expect("folder");
        let at = |n: &str| dir.path().join(n);
        std::fs::write(
            at("Room.usda"),
            "#usda 1.0\n(\n metersPerUnit = 1\n upAxis = \"Y\"\n)\ndef Xform \"Room\" {\n def Xform \"g\" ( references = @./Wall.usda@ ) {\n double3 xformOp:translate = (10, 0, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]\n }\n}\n",
        )
        .expect("file");
        std::fs::write(
            at("Wall.usda"),
            "#usda 1.0\n(\n defaultPrim = \"Wall7\"\n)\ndef Xform \"Wall7\" {\n def Cube \"Wall7\" {\n double size = 1\n double3 xformOp:scale = (2, 3, 0.5)\n uniform token[] xformOpOrder = [\"xformOp:scale\"]\n }\n}\n",
        )
        .expect("file");
        let mut account = Account::default();
        let capture = RoomPlan
            .import(&at("Room.usda"), &PrepareOptions::default(), &mut account)
            .expect("read");
        assert_eq!(capture.classes[0].name, "wall");
        let Some(Surface::Built(m)) = capture.surface else {
            panic!("a surface")
        };
        let volume: f64 = m
            .mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| m.mesh.positions[i as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!((volume - 3.0).abs() < 1e-9, "{volume}");
        let middle = m.mesh.positions.iter().sum::<DVec3>() / m.mesh.positions.len() as f64;
        assert!((middle - DVec3::new(10.0, 0.0, 0.0)).length() < 1e-9);
    }

    fn room(form: &str) -> LabelledMesh {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd");
        let mut account = Account::default();
        let capture = RoomPlan
            .import(
                &folder.join(format!("room.{form}")),
                &PrepareOptions::default(),
                &mut account,
            )
            .expect(form);
        let names: Vec<&str> = capture.classes.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["wall", "door", "floor", "sofa"], "{form}");
        match capture.surface {
            Some(Surface::Built(mesh)) => mesh,
            other => panic!("{form}: {other:?}"),
        }
    }

    #[test]
    fn text_binary_and_archive_hold_the_same_room() {
        let text = room("usda");
        assert_eq!(text.mesh.triangles.len(), 12 + 12 + 50 + 12);
        for form in ["usdc", "usdz"] {
            let other = room(form);
            assert_eq!(text.mesh.triangles, other.mesh.triangles, "{form}");
            assert_eq!(text.classes, other.classes, "{form}");
            for (a, b) in text.mesh.positions.iter().zip(&other.mesh.positions) {
                assert!((*a - *b).length() < 1e-6, "{form}: {a} {b}");
            }
        }
    }

    #[test]
    fn damaged_binary_layers_are_survived() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/usd/room.usdc");
        let whole = std::fs::read(file).expect("file");
        for at in 0..whole.len() {
            let _ = usdc::parse(&whole[..at]);
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[at] ^= flip;
                let _ = usdc::parse(&damaged);
            }
        }
        assert!(usdc::parse(&whole[..whole.len() - 1]).is_err_and(|e| e.contains("damaged")));
    }
}
