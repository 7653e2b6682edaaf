//! 3D Scanner App ("All data" of a LiDAR scan): `frame_00000.json` with `frame_00000.jpg` and
//! `depth_00000.png` for some frames of a scan, and its mesh.
//!
//! A frame's file states camera-to-world by rows (`cameraPoseARFrame`: ARKit's world, metres, y up;
//! the camera's y up and its z backwards) and the 3 × 3 intrinsics by rows, in pixels of the
//! photograph as it is stored. Depth images are millimetres along the optical axis. Most frames
//! have no photograph.

use super::account::Account;
use super::capture::{Capture, Depth, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, files_in, is_rotation, mesh_beside};
use super::lens::{Optics, Perspective};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use glam::{DMat3, DMat4};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Metres per step of a depth image.
const DEPTH_STEP: f64 = 1e-3;
/// Meshes of the app, the textured one first.
const MESHES: [&str; 5] = [
    "textured_output.obj",
    "textured_output.glb",
    "export_refined.obj",
    "export.obj",
    "mesh.obj",
];

/// The importer.
pub struct ScannerApp;

impl Importer for ScannerApp {
    fn kind(&self) -> &'static str {
        "scanner-app"
    }

    fn looks_like(&self) -> &'static str {
        "3D Scanner App: frame_00000.json and frame_00000.jpg (export \"All data\")"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no frame_*.json with frame_*.jpg; export \"All data\" from 3D Scanner App";
        let has_frames = frames(path).iter().any(|f| photograph(f).is_some());
        Located::new(path, has_frames.then(|| path.to_path_buf()), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let folder = &located.start;
        let files = frames(folder);
        let mut shots = Vec::new();
        for file in &files {
            let Some(image) = photograph(file) else {
                continue;
            };
            let frame: Value = serde_json::from_str(&read_input_text(file)?)
                .map_err(|e| Error::input(file, format!("{e}; expected a frame's JSON")))?;
            let mut shot = shot(&frame, image).map_err(|m| Error::input(file, m))?;
            let depth = folder.join(shot.stem.replacen("frame_", "depth_", 1) + ".png");
            shot.depth = depth.is_file().then_some(Depth {
                path: depth,
                metres_per_step: DEPTH_STEP,
                along_axis: true,
            });
            shots.push(shot);
        }
        account.read(format!(
            "{}: {} posed photographs",
            folder.display(),
            shots.len()
        ));
        if files.len() > shots.len() {
            account.ignored(format!(
                "{} frames without a photograph",
                files.len() - shots.len()
            ));
        }
        account.ignored("confidence of depth, quality of motion");
        let mesh = mesh_beside(folder, &MESHES);
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Y,
            ..Capture::default()
        })
    }
}

/// The files of frames in a folder.
fn frames(folder: &Path) -> Vec<PathBuf> {
    files_in(folder, |p| {
        let name = p.file_name().and_then(|n| n.to_str()).unwrap_or("");
        name.starts_with("frame_") && name.ends_with(".json")
    })
}

/// The photograph of a frame.
fn photograph(file: &Path) -> Option<PathBuf> {
    let endings = ["jpg", "jpeg", "png", "JPG"];
    let named = endings.map(|e| file.with_extension(e));
    named.into_iter().find(|p| p.is_file())
}

fn shot(frame: &Value, image: PathBuf) -> std::result::Result<Shot, String> {
    let numbers = |key: &str, count: usize| -> std::result::Result<Vec<f64>, String> {
        let all = frame.get(key).and_then(Value::as_array);
        let all = all.map(|v| v.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>());
        all.flatten()
            .filter(|n| n.len() == count && n.iter().all(|x| x.is_finite()))
            .ok_or_else(|| format!("{key}: expected {count} finite numbers"))
    };
    let pose = numbers("cameraPoseARFrame", 16)?;
    let pose = DMat4::from_cols_slice(&pose).transpose();
    if !is_rotation(DMat3::from_mat4(pose)) {
        return Err("cameraPoseARFrame holds no rotation; export the scan again".into());
    }
    let intrinsics = numbers("intrinsics", 9)?;
    let focal = [intrinsics[0], intrinsics[4]];
    if focal.iter().any(|f| *f <= 0.0) {
        return Err("intrinsics: expected positive focal lengths".into());
    }
    let optics = Optics::Perspective(Perspective {
        focal,
        centre: [intrinsics[2], intrinsics[5]],
        ..Perspective::default()
    });
    let stem = image.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Shot::new(stem, image.clone(), pose, optics))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn poses_stand_by_rows_and_frames_without_a_photograph_are_left_out() {
        let dir = tempfile::tempdir().expect("temp");
        let at = |p: &str| dir.path().join(p);
        // the camera's x, y, z are the world's −z, y, x
        let frame = r#"{"cameraPoseARFrame": [0, 0, 1, 4, 0, 1, 0, 5, -1, 0, 0, 6, 0, 0, 0, 1],
            "intrinsics": [700, 0, 512, 0, 701, 384, 0, 0, 1], "frame_index": 3, "motionQuality": 1}"#;
        for n in ["00003", "00004"] {
            std::fs::write(at(&format!("frame_{n}.json")), frame).expect("file");
        }
        assert!(!ScannerApp.recognises(dir.path()));
        std::fs::write(at("frame_00003.jpg"), "").expect("file");
        std::fs::write(at("depth_00003.png"), "").expect("file");
        std::fs::write(at("textured_output.obj"), "").expect("file");
        assert!(ScannerApp.recognises(dir.path()));
        let mut account = Account::default();
        let import = |account: &mut Account| {
            ScannerApp.import(dir.path(), &PrepareOptions::default(), account)
        };
        let capture = import(&mut account).expect("reads");
        let [shot] = capture.shots.as_slice() else {
            panic!("one shot with an image")
        };
        let [x, y, z, place] = [0, 1, 2, 3].map(|i| shot.world_from_camera.col(i).truncate());
        assert_eq!((x, y, z), (DVec3::NEG_Z, DVec3::Y, DVec3::X));
        assert_eq!(place, DVec3::new(4.0, 5.0, 6.0));
        let Optics::Perspective(p) = &shot.optics else {
            panic!("{:?}", shot.optics)
        };
        assert_eq!((p.focal, p.centre), ([700.0, 701.0], [512.0, 384.0]));
        assert!(shot.depth.as_ref().is_some_and(|d| d.along_axis));
        assert!(capture.surface.is_some());
        assert!(account.ignored.iter().any(|l| l.starts_with("1 frames")));

        let damaged = frame.replace("[0, 0, 1, 4,", "[2, 0, 1, 4,");
        std::fs::write(at("frame_00003.json"), damaged).expect("file");
        let refused = import(&mut Account::default()).expect_err("no rotation");
        assert!(refused.to_string().contains("no rotation"), "{refused}");
    }
}
