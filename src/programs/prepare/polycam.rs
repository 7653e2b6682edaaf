//! Polycam's raw bundle (export "Raw data"): `keyframes/` with corrected images and cameras, depth
//! and confidence, and `raw.glb`.
//!
//! A camera file holds the upper three rows of camera-to-world as `t_00` to `t_23`, in ARKit's world
//! (metres, y up) with the camera's y up and its z backwards, and intrinsics in pixels. Depth images
//! are millimetres along the optical axis.

use super::account::Account;
use super::capture::{Capture, Depth, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, files_in, is_rotation, mesh_beside};
use super::lens::{Optics, Perspective};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use glam::{DMat3, DMat4};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Cameras with their images, the refined ones first.
const KEYFRAMES: [[&str; 2]; 2] = [
    ["corrected_cameras", "corrected_images"],
    ["cameras", "images"],
];
/// Metres per step of a depth image.
const DEPTH_STEP: f64 = 1e-3;
/// Meshes of the bundle.
const MESHES: [&str; 3] = ["raw.glb", "mesh.glb", "mesh.obj"];

/// The importer.
pub struct Polycam;

impl Importer for Polycam {
    fn kind(&self) -> &'static str {
        "polycam"
    }

    fn looks_like(&self) -> &'static str {
        "Polycam: a raw bundle with keyframes/cameras and keyframes/images"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected =
            "no keyframes/cameras with keyframes/images; export \"Raw data\" from Polycam";
        Located::new(path, cameras_in(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let (path, cameras) = (&located.named, &located.start);
        let images = images_of(cameras);
        let files = camera_files(cameras);
        let (mut shots, mut without) = (Vec::new(), 0usize);
        for file in &files {
            let stem = file
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let found = ["jpg", "png", "JPG"].map(|e| images.join(format!("{stem}.{e}")));
            let Some(image) = found.into_iter().find(|p| p.is_file()) else {
                without += 1;
                continue;
            };
            let text = read_input_text(file)?;
            let camera: Value = serde_json::from_str(&text)
                .map_err(|e| Error::input(file, format!("{e}; expected a camera of Polycam")))?;
            let mut shot = shot(&camera, stem, image).map_err(|m| Error::input(file, m))?;
            let depth = path
                .join("keyframes/depth")
                .join(format!("{}.png", shot.stem));
            shot.depth = depth.is_file().then_some(Depth {
                path: depth,
                metres_per_step: DEPTH_STEP,
                along_axis: true,
            });
            shots.push(shot);
        }
        if shots.is_empty() {
            return Err(Error::input(
                cameras,
                "holds no camera with an image; export the bundle again",
            ));
        }
        account.read(format!(
            "{}: {} posed photographs",
            cameras.display(),
            shots.len()
        ));
        if without > 0 {
            account.ignored(format!("{without} cameras without an image"));
        }
        account.ignored("confidence of depth, blur scores");
        let mesh = mesh_beside(path, &MESHES);
        if mesh.is_some() && path.join("mesh_info.json").is_file() {
            account.ignored(
                "mesh_info.json: the mesh is taken where it lies; `unbake check` says whether it fits the photographs, and --fix-alignment moves it",
            );
        }
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Y,
            ..Capture::default()
        })
    }
}

/// The folder of cameras that has its images beside it.
fn cameras_in(path: &Path) -> Option<PathBuf> {
    let folder = path.join("keyframes");
    let cameras = KEYFRAMES.map(|[cameras, _]| folder.join(cameras));
    cameras
        .into_iter()
        .find(|c| !camera_files(c).is_empty() && images_of(c).is_dir())
}

/// The files of a folder of cameras.
fn camera_files(cameras: &Path) -> Vec<PathBuf> {
    files_in(cameras, |p| p.extension().is_some_and(|e| e == "json"))
}

/// The folder of the images that belong to a folder of cameras.
fn images_of(cameras: &Path) -> PathBuf {
    let pair = KEYFRAMES.iter().find(|[name, _]| cameras.ends_with(name));
    cameras.with_file_name(pair.unwrap_or(&KEYFRAMES[1])[1])
}

fn shot(camera: &Value, stem: String, image: PathBuf) -> std::result::Result<Shot, String> {
    let number = |key: &str| {
        let n = camera
            .get(key)
            .and_then(Value::as_f64)
            .filter(|n| n.is_finite());
        n.ok_or_else(|| format!("{key}: expected a finite number"))
    };
    let mut rows = [0.0; 16];
    rows[15] = 1.0;
    for (i, row) in rows.chunks_exact_mut(4).take(3).enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = number(&format!("t_{i}{j}"))?;
        }
    }
    let pose = DMat4::from_cols_array(&rows).transpose();
    if !is_rotation(DMat3::from_mat4(pose)) {
        return Err("t_00 to t_22 are no rotation; export the bundle again".into());
    }
    let focal = [number("fx")?, number("fy")?];
    if focal.iter().any(|f| *f <= 0.0) {
        return Err("fx, fy: expected positive focal lengths".into());
    }
    let optics = Optics::Perspective(Perspective {
        focal,
        centre: [number("cx")?, number("cy")?],
        ..Perspective::default()
    });
    let mut shot = Shot::new(stem, image, pose, optics);
    shot.size = Some([number("width")? as usize, number("height")? as usize]);
    Ok(shot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn refined_cameras_come_first_and_bring_their_depth() {
        let dir = tempfile::tempdir().expect("temp");
        let at = |p: &str| dir.path().join(p);
        for folder in [
            "cameras",
            "images",
            "corrected_cameras",
            "corrected_images",
            "depth",
        ] {
            std::fs::create_dir_all(at("keyframes").join(folder)).expect("folder");
        }
        let camera = r#"{"t_00": 0, "t_01": 0, "t_02": 1, "t_03": 4, "t_10": 0, "t_11": 1, "t_12": 0, "t_13": 5,
            "t_20": -1, "t_21": 0, "t_22": 0, "t_23": 6, "fx": 700, "fy": 701, "cx": 512, "cy": 384,
            "width": 1024, "height": 768, "blur_score": 50}"#;
        for stem in ["12", "13"] {
            std::fs::write(
                at(&format!("keyframes/corrected_cameras/{stem}.json")),
                camera,
            )
            .expect("file");
        }
        std::fs::write(at("keyframes/corrected_images/12.jpg"), "").expect("file");
        std::fs::write(at("keyframes/depth/12.png"), "").expect("file");
        assert!(Polycam.recognises(dir.path()));
        let mut account = Account::default();
        let capture = Polycam
            .import(dir.path(), &PrepareOptions::default(), &mut account)
            .expect("reads");
        let [shot] = capture.shots.as_slice() else {
            panic!("one shot with an image")
        };
        let [x, y, z, place] = [0, 1, 2, 3].map(|i| shot.world_from_camera.col(i).truncate());
        assert_eq!((x, y, z), (DVec3::NEG_Z, DVec3::Y, DVec3::X));
        assert_eq!(place, DVec3::new(4.0, 5.0, 6.0));
        assert_eq!(shot.size, Some([1024, 768]));
        assert!(
            shot.depth
                .as_ref()
                .is_some_and(|d| d.along_axis && d.metres_per_step == 1e-3)
        );
        assert!(account.ignored.iter().any(|l| l.starts_with("1 cameras")));

        let damaged = camera.replace("\"t_00\": 0", "\"t_00\": 3");
        std::fs::write(at("keyframes/corrected_cameras/12.json"), damaged).expect("file");
        let e = Polycam.import(dir.path(), &PrepareOptions::default(), &mut account);
        assert!(
            e.expect_err("no rotation")
                .to_string()
                .contains("no rotation")
        );
    }
}
