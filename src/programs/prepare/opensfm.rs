//! OpenSfM's `reconstruction.json` (also OpenDroneMap's, in its folder `opensfm`): cameras with
//! normalised intrinsics, shots with an axis-angle rotation and a translation from world to camera.
//!
//! Camera axes are OpenCV's (x right, y down, z forward), panoramas look along +z in their middle
//! (OpenSfM documentation, "Geometric Models"). Lengths on the image are in units of its longer
//! side, from its middle. The world is z-up where positions or alignment said so, else open.

use super::account::Account;
use super::camera_axes::gl_from_cv;
use super::capture::{Capture, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, mesh_beside, photograph_named, stem_of};
use super::lens::{Distortion, Lens, Optics, Perspective};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const FILE: &str = "reconstruction.json";
/// Meshes that OpenDroneMap leaves, from the file's folder.
const MESHES: [&str; 3] = [
    "../odm_meshing/odm_mesh.ply",
    "../odm_texturing/odm_textured_model_geo.obj",
    "mesh.ply",
];
/// Folders of the photographs, from the file's folder.
const IMAGES: [&str; 4] = ["images", "../images", "../../images", "."];

/// A part of the scene whose shots fit together.
#[derive(Deserialize)]
struct Reconstruction {
    cameras: BTreeMap<String, CameraEntry>,
    shots: BTreeMap<String, ShotEntry>,
    reference_lla: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct CameraEntry {
    projection_type: String,
    #[serde(default)]
    width: f64,
    #[serde(default)]
    height: f64,
    focal: Option<f64>,
    focal_x: Option<f64>,
    focal_y: Option<f64>,
    #[serde(default)]
    c_x: f64,
    #[serde(default)]
    c_y: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    k4: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
}

#[derive(Deserialize)]
struct ShotEntry {
    rotation: [f64; 3],
    translation: [f64; 3],
    camera: String,
}

/// The importer.
pub struct OpenSfm;

impl Importer for OpenSfm {
    fn kind(&self) -> &'static str {
        "opensfm"
    }

    fn looks_like(&self) -> &'static str {
        "OpenSfM: reconstruction.json with images/ beside it (also OpenDroneMap's project)"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        Located::new(
            path,
            file_in(path),
            format!("no {FILE} here or in opensfm/"),
        )
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let (file, folder) = (&located.start, located.folder());
        let all: Vec<Reconstruction> = serde_json::from_str(&read_input_text(file)?)
            .map_err(|e| Error::input(file, format!("{e}; expected OpenSfM's JSON")))?;
        let largest = all.iter().max_by_key(|r| r.shots.len());
        let largest = largest.filter(|r| !r.shots.is_empty()).ok_or_else(|| {
            Error::input(
                file,
                "holds no posed photograph; run `opensfm reconstruct` again",
            )
        })?;
        let fail = |name: &str, m: &str| Error::input(file, format!("shots.{name}: {m}"));
        let mut shots = Vec::new();
        for (name, shot) in &largest.shots {
            let camera = largest.cameras.get(&shot.camera);
            let camera = camera.ok_or_else(|| fail(name, "its camera is not in cameras"))?;
            let optics = camera.optics().map_err(|m| fail(name, &m))?;
            let places = IMAGES.iter().map(|p| folder.join(p));
            let image = photograph_named(places, name).ok_or_else(|| {
                fail(
                    name,
                    "the photograph was not found; put it into images/ beside the file",
                )
            })?;
            let pose = shot
                .pose()
                .ok_or_else(|| fail(name, "its pose is not finite"))?;
            let mut read = Shot::new(stem_of(name), image, pose, optics);
            read.size = camera.size();
            shots.push(read);
        }
        account.read(format!(
            "{}: {} posed photographs",
            file.display(),
            shots.len()
        ));
        account.converted("poses from camera-from-world with y down to camera-to-world with y up");
        if all.len() > 1 {
            account.ignored(format!(
                "{} smaller reconstructions: their place relative to the largest is not known",
                all.len() - 1
            ));
        }
        account.ignored("sparse points, rigs (each shot has its own pose)");
        let mesh = mesh_beside(folder, &MESHES);
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Unknown,
            // positions of satellites give metres
            unit_unknown: largest.reference_lla.is_none(),
            ..Capture::default()
        })
    }
}

fn file_in(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return path.ends_with(FILE).then(|| path.to_path_buf());
    }
    let places = [path.join(FILE), path.join("opensfm").join(FILE)];
    places.into_iter().find(|p| p.is_file())
}

impl ShotEntry {
    /// Camera-to-world with y up.
    fn pose(&self) -> Option<DMat4> {
        let [axis, translation] = [self.rotation, self.translation].map(DVec3::from_array);
        let rotation = DQuat::from_scaled_axis(axis);
        let camera_from_world = DMat4::from_rotation_translation(rotation, translation);
        (axis.is_finite() && translation.is_finite())
            .then(|| gl_from_cv(camera_from_world.inverse()))
    }
}

impl CameraEntry {
    fn size(&self) -> Option<[usize; 2]> {
        let sides = [self.width, self.height];
        sides
            .iter()
            .all(|s| *s >= 1.0)
            .then(|| sides.map(|s| s as usize))
    }

    fn optics(&self) -> std::result::Result<Optics, String> {
        let kind = self.projection_type.as_str();
        if matches!(kind, "spherical" | "equirectangular") {
            return Ok(Optics::Panorama);
        }
        let unit = self.width.max(self.height);
        let focal = [self.focal_x.or(self.focal), self.focal_y.or(self.focal)];
        let [Some(fx), Some(fy)] = focal.map(|f| f.map(|f| f * unit).filter(|f| *f > 0.0)) else {
            return Err("its camera has no focal length or no size; export the model again".into());
        };
        let focal = [fx, fy];
        let centre = [
            0.5 * self.width + self.c_x * unit,
            0.5 * self.height + self.c_y * unit,
        ];
        let Self {
            k1,
            k2,
            k3,
            k4,
            p1,
            p2,
            ..
        } = *self;
        let lens = |distortion| {
            Ok(Optics::Distorted(Lens {
                distortion,
                focal,
                centre,
            }))
        };
        match kind {
            "perspective" | "simple_radial" | "radial" => Ok(Optics::Perspective(Perspective {
                focal,
                centre,
                radial: [k1, if kind == "simple_radial" { 0.0 } else { k2 }],
                tangential: [0.0; 2],
            })),
            "brown" => lens(Distortion::Rational([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0])),
            "fisheye" => lens(Distortion::Fisheye([k1, k2, 0.0, 0.0])),
            "fisheye_opencv" => lens(Distortion::Fisheye([k1, k2, k3, k4])),
            other => Err(format!(
                "its projection {other} is not known here (known: spherical, perspective, simple_radial, radial, brown, fisheye, fisheye_opencv); run `opensfm undistort` and give that folder"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shots_are_posed_from_world_to_camera_in_units_of_the_longer_side() {
        let dir = tempfile::tempdir().expect("temp");
        std::fs::create_dir(dir.path().join("images")).expect("folder");
        for name in ["a.jpg", "p.jpg"] {
            std::fs::write(dir.path().join("images").join(name), "").expect("image");
        }
        // a quarter turn about the camera's y (down): world x is seen along −z, world z along x
        let text = r#"[{"cameras": {}, "shots": {}}, {"cameras": {
            "c": {"projection_type": "brown", "width": 400, "height": 300, "focal_x": 0.5, "focal_y": 0.6,
                  "c_x": 0.01, "c_y": -0.02, "k1": 0.1, "k2": 0.01, "p1": 0.001, "p2": 0.002, "k3": 0.003},
            "s": {"projection_type": "spherical", "width": 200, "height": 100}},
            "shots": {
            "a.jpg": {"rotation": [0, 1.5707963267948966, 0], "translation": [1, 2, 3], "camera": "c"},
            "p.jpg": {"rotation": [0, 0, 0], "translation": [0, 0, -5], "camera": "s"}}}]"#;
        std::fs::write(dir.path().join(FILE), text).expect("file");
        assert!(OpenSfm.recognises(dir.path()));
        let mut account = Account::default();
        let capture = OpenSfm
            .import(dir.path(), &PrepareOptions::default(), &mut account)
            .expect("reads");
        let [a, p] = capture.shots.as_slice() else {
            panic!("two shots")
        };
        // C = −Rᵀ t
        let place = a.world_from_camera.w_axis.truncate();
        assert!(
            (place - DVec3::new(3.0, -2.0, -1.0)).length() < 1e-9,
            "{place}"
        );
        // forward is the world direction that R brings to +z
        let forward = -a.world_from_camera.z_axis.truncate();
        assert!((forward - DVec3::NEG_X).length() < 1e-9, "{forward}");
        let Optics::Distorted(lens) = &a.optics else {
            panic!("{:?}", a.optics)
        };
        assert_eq!((lens.focal, lens.centre), ([200.0, 240.0], [204.0, 142.0]));
        assert_eq!((&p.optics, p.size), (&Optics::Panorama, Some([200, 100])));
        assert_eq!(
            p.world_from_camera.w_axis.truncate(),
            DVec3::new(0.0, 0.0, 5.0)
        );
        assert_eq!(
            -p.world_from_camera.y_axis.truncate(),
            DVec3::Y,
            "down is y"
        );
        assert!(account.ignored.iter().any(|l| l.starts_with("1 smaller")));
    }

    #[test]
    fn what_is_missing_is_named() {
        let dir = tempfile::tempdir().expect("temp");
        let refused = |text: &str| {
            std::fs::write(dir.path().join(FILE), text).expect("file");
            OpenSfm
                .import(
                    dir.path(),
                    &PrepareOptions::default(),
                    &mut Account::default(),
                )
                .expect_err("must be refused")
                .to_string()
        };
        assert!(refused("[]").contains("no posed photograph"));
        assert!(refused("{").contains("OpenSfM's JSON"));
        let shot = r#"{"rotation": [0,0,0], "translation": [0,0,0], "camera": "c"}"#;
        let with = |camera: &str| {
            refused(&format!(
                r#"[{{"cameras": {{{camera}}}, "shots": {{"a.jpg": {shot}}}}}]"#
            ))
        };
        assert!(with("").contains("not in cameras"));
        assert!(
            with(r#""c": {"projection_type": "dual", "width": 4, "height": 3, "focal": 1}"#)
                .contains("dual")
        );
        assert!(with(r#""c": {"projection_type": "spherical"}"#).contains("not found"));
    }
}
