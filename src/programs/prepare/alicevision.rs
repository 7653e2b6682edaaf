//! AliceVision's and Meshroom's `.sfm` (JSON): views, intrinsics in pixels, poses as a rotation and
//! a centre.
//!
//! The nine numbers of a rotation are the columns of world-to-camera one after the other (Eigen's
//! order), which are the rows of camera-to-world; axes are OpenCV's. Numbers stand as text. The
//! principal point is one in pixels in old files, an offset from the middle in new ones: whichever
//! reading lies nearer the middle is meant (AliceVision, sfmDataIO/jsonIO).

use super::account::Account;
use super::camera_axes::HALF_TURN;
use super::capture::{Capture, Shot, Surface, Up};
use super::folder::extension;
use super::importer::{
    Importer, Located, PrepareOptions, is_rotation, mesh_beside, of_kind, photograph_named, stem_of,
};
use super::lens::{Distortion, Lens, Optics, Perspective};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Meshes of Meshroom's pipeline beside the file or in folders next to its own.
const MESHES: [&str; 4] = [
    "texturedMesh.obj",
    "mesh.obj",
    "mesh.ply",
    "../texturedMesh.obj",
];
/// Folders of the photographs, from the file's folder, where their stated path is gone.
const IMAGES: [&str; 3] = [".", "images", "../images"];

type Reading<T> = std::result::Result<T, String>;

/// The importer.
pub struct AliceVision;

impl Importer for AliceVision {
    fn kind(&self) -> &'static str {
        "alicevision"
    }

    fn looks_like(&self) -> &'static str {
        "AliceVision, Meshroom: one .sfm file (cameras.sfm, sfm.sfm)"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no .sfm file here, or several; name the file";
        Located::new(path, file_in(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let file = &located.start;
        let root: Value = serde_json::from_str(&read_input_text(file)?).map_err(|e| {
            Error::input(
                file,
                format!(
                    "{e}; expected AliceVision's JSON (export .abc as .sfm with ConvertSfMFormat)"
                ),
            )
        })?;
        let fail = |m: String| Error::input(file, m);
        let intrinsics = by_id(&root, "intrinsics", "intrinsicId");
        let poses = by_id(&root, "poses", "poseId");
        let rigs = by_id(&root, "rigs", "rigId");
        let folder = located.folder();
        let (mut shots, mut unposed) = (Vec::new(), 0usize);
        for (i, view) in list(&root, "views").iter().enumerate() {
            let place = |m: String| fail(format!("views[{i}]: {m}"));
            let pose = id(view, "poseId").and_then(|p| poses.get(&p));
            let Some(pose) = pose else {
                unposed += 1;
                continue;
            };
            let intrinsic = id(view, "intrinsicId").and_then(|k| intrinsics.get(&k));
            let intrinsic = intrinsic
                .ok_or_else(|| place("its intrinsics are missing; export the file again".into()))?;
            let pose = pose_of(view, pose, &rigs).map_err(&place)?;
            let (optics, size) = optics(intrinsic).map_err(&place)?;
            let stated = view.get("path").and_then(Value::as_str).unwrap_or("");
            let image = image_at(folder, stated).ok_or_else(|| {
                place(format!(
                    "the photograph {stated} was not found there or beside the file"
                ))
            })?;
            let name = image
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let mut shot = Shot::new(stem_of(&name), image, pose, optics);
            shot.size = Some(size);
            shots.push(shot);
        }
        if shots.is_empty() {
            return Err(fail(
                "holds no view with a pose; run StructureFromMotion again".into(),
            ));
        }
        account.read(format!(
            "{}: {} posed photographs",
            file.display(),
            shots.len()
        ));
        account.converted("poses from axes with y down to axes with y up");
        if unposed > 0 {
            account.ignored(format!("{unposed} views without a pose"));
        }
        account.ignored("landmarks");
        Ok(Capture {
            shots,
            surface: surface_beside(folder, &root, account),
            up: Up::Unknown,
            unit_unknown: true,
            ..Capture::default()
        })
    }
}

/// The mesh beside a file, in the axes of its poses.
fn surface_beside(folder: &Path, root: &Value, account: &mut Account) -> Option<Surface> {
    let path = mesh_beside(folder, &MESHES)?;
    let world_from_file = if meshes_are_y_up(root) {
        account.converted(
            "the mesh from axes with y up, in which Meshroom writes it since 2021, to those of the poses",
        );
        DMat4::from_scale(HALF_TURN)
    } else {
        DMat4::IDENTITY
    };
    Some(Surface::File {
        path,
        world_from_file,
    })
}

/// Whether meshes have their y and z turned against the poses: since files of version 1.2.3
/// (AliceVision, pull request 1030).
fn meshes_are_y_up(root: &Value) -> bool {
    let version = numbers(root, "version").unwrap_or_default();
    version.as_slice() >= [1.0, 2.0, 3.0].as_slice()
}

fn file_in(path: &Path) -> Option<PathBuf> {
    let found = of_kind(path, |p| extension(p) == "sfm");
    // Meshroom leaves the poses beside the whole model: cameras.sfm and sfm.sfm
    let named = found.iter().find(|p| p.ends_with("cameras.sfm"));
    match (named, found.as_slice()) {
        (Some(named), _) => Some(named.clone()),
        (None, [only]) => Some(only.clone()),
        _ => None,
    }
}

fn list<'a>(root: &'a Value, key: &str) -> &'a [Value] {
    root.get(key)
        .and_then(Value::as_array)
        .map_or(&[], Vec::as_slice)
}

/// A number that may stand as text.
fn number(value: &Value) -> Option<f64> {
    let n = match value {
        Value::String(t) => t.trim().parse().ok(),
        other => other.as_f64(),
    };
    n.filter(|n| n.is_finite())
}

/// Numbers of a list; a single one is a list of itself.
fn numbers(of: &Value, key: &str) -> Reading<Vec<f64>> {
    let all = match of.get(key) {
        None => return Ok(Vec::new()),
        Some(Value::Array(all)) => all.iter().map(number).collect(),
        Some(one) => number(one).map(|n| vec![n]),
    };
    all.ok_or_else(|| format!("{key}: expected finite numbers"))
}

/// Ids are texts of large integers.
fn id(of: &Value, key: &str) -> Option<String> {
    match of.get(key)? {
        Value::String(t) => Some(t.clone()),
        other => Some(other.to_string()),
    }
}

fn by_id<'a>(root: &'a Value, key: &str, name: &str) -> BTreeMap<String, &'a Value> {
    let entries = list(root, key).iter();
    entries.filter_map(|v| Some((id(v, name)?, v))).collect()
}

/// A view's pose: its own, or its place on a rig that has one.
fn pose_of(view: &Value, pose: &Value, rigs: &BTreeMap<String, &Value>) -> Reading<DMat4> {
    let to_gl = DMat4::from_scale(HALF_TURN);
    let of_pose = world_from_camera(pose.pointer("/pose/transform"))?;
    // (4294967295 stands for none)
    let rig = id(view, "rigId").and_then(|r| rigs.get(&r));
    let alone = view.get("isPoseIndependent").is_some_and(|v| match v {
        Value::String(t) => t == "true" || t == "1",
        other => other.as_bool().unwrap_or(true),
    });
    let Some(rig) = rig.filter(|_| !alone) else {
        return Ok(of_pose * to_gl);
    };
    let place = id(view, "subPoseId").and_then(|k| k.parse::<usize>().ok());
    let sub_pose = place.and_then(|k| list(rig, "subPoses").get(k));
    let sub_pose = sub_pose.ok_or("its rig has no such subPoseId; export the file again")?;
    let rig_from_camera = world_from_camera(sub_pose.get("pose"))?;
    Ok(of_pose * rig_from_camera * to_gl)
}

/// A pose with AliceVision's axes.
fn world_from_camera(transform: Option<&Value>) -> Reading<DMat4> {
    let transform = transform.unwrap_or(&Value::Null);
    let (rotation, centre) = (
        numbers(transform, "rotation")?,
        numbers(transform, "center")?,
    );
    let (Ok(rotation), Ok(centre)) = (
        <[f64; 9]>::try_from(rotation.as_slice()),
        <[f64; 3]>::try_from(centre.as_slice()),
    ) else {
        return Err("its pose needs nine numbers of rotation and three of center".into());
    };
    let camera_from_world = DMat3::from_cols_array(&rotation);
    if !is_rotation(camera_from_world) {
        return Err("its rotation is none; export the file again".into());
    }
    let mut pose = DMat4::from_mat3(camera_from_world.transpose());
    pose.w_axis = DVec3::from_array(centre).extend(1.0);
    Ok(pose)
}

/// Projection and size of an intrinsic.
fn optics(of: &Value) -> Reading<(Optics, [usize; 2])> {
    let one = |key: &str| of.get(key).and_then(number);
    let sides = one("width")
        .zip(one("height"))
        .filter(|(w, h)| *w >= 1.0 && *h >= 1.0);
    let (width, height) = sides.ok_or("its intrinsics state no size")?;
    let kind = of.get("type").and_then(Value::as_str).unwrap_or("");
    let size = [width as usize, height as usize];
    if matches!(kind, "equirectangular" | "spherical") {
        return Ok((Optics::Panorama, size));
    }
    let focal = focal(of, width)?;
    let middle = [0.5 * width, 0.5 * height];
    let point = numbers(of, "principalPoint")?;
    let centre = match point.as_slice() {
        [x, y] if (x - middle[0]).abs() < x.abs() => [*x, *y],
        [x, y] => [middle[0] + x, middle[1] + y],
        _ => middle,
    };
    let k = numbers(of, "distortionParams")?;
    let k = |i: usize| k.get(i).copied().unwrap_or(0.0);
    let lens = |distortion| {
        Optics::Distorted(Lens {
            distortion,
            focal,
            centre,
        })
    };
    let flat = |radial| {
        Optics::Perspective(Perspective {
            focal,
            centre,
            radial,
            tangential: [0.0; 2],
        })
    };
    let name = of
        .get("distortionType")
        .and_then(Value::as_str)
        .unwrap_or(kind);
    let optics = match name {
        "pinhole" | "none" => flat([0.0; 2]),
        "radial1" | "radialk1" => flat([k(0), 0.0]),
        "radial3" | "radialk3" => lens(Distortion::Rational([
            k(0),
            k(1),
            0.0,
            0.0,
            k(2),
            0.0,
            0.0,
            0.0,
        ])),
        "brown" => lens(Distortion::Rational([
            k(0),
            k(1),
            k(3),
            k(4),
            k(2),
            0.0,
            0.0,
            0.0,
        ])),
        "fisheye4" | "fisheye" => lens(Distortion::Fisheye([k(0), k(1), k(2), k(3)])),
        other => {
            return Err(format!(
                "its lens {other} is not known here (known: pinhole, radial1, radial3, brown, fisheye4); undistort with PrepareDenseScene and give its folder"
            ));
        }
    };
    Ok((optics, size))
}

/// Focal lengths in pixels: stated so before version 1.2.2, in millimetres on the sensor since.
fn focal(of: &Value, width: f64) -> Reading<[f64; 2]> {
    let one = |key: &str| of.get(key).and_then(number);
    let pixels = numbers(of, "pxFocalLength")?;
    let from_sensor = || {
        let ratio = one("pixelRatio").filter(|r| *r > 0.0).unwrap_or(1.0);
        let fx = one("focalLength")? / one("sensorWidth").filter(|s| *s > 0.0)? * width;
        Some([fx, fx * ratio])
    };
    let focal = match pixels.as_slice() {
        [f] => Some([*f, *f]),
        [fx, fy, ..] => Some([*fx, *fy]),
        [] => from_sensor(),
    };
    let positive = focal.filter(|f| f.iter().all(|f| *f > 0.0));
    positive.ok_or_else(|| "its intrinsics state no focal length".into())
}

/// The photograph at its stated path, or beside the file where that is gone.
fn image_at(folder: &Path, stated: &str) -> Option<PathBuf> {
    let plain = folder.join(stated);
    if !stated.is_empty() && plain.is_file() {
        return Some(plain);
    }
    let name = stated
        .rsplit(['/', '\\'])
        .next()
        .filter(|n| !n.is_empty())?;
    photograph_named(IMAGES.iter().map(|p| folder.join(p)), name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Capture> {
        let dir = tempfile::tempdir().expect("temp");
        std::fs::write(dir.path().join("a.jpg"), "").expect("image");
        std::fs::write(dir.path().join("cameras.sfm"), text).expect("file");
        std::fs::write(dir.path().join("sfm.sfm"), "{}").expect("file");
        assert!(AliceVision.recognises(dir.path()));
        AliceVision.import(
            dir.path(),
            &PrepareOptions::default(),
            &mut Account::default(),
        )
    }

    fn file(intrinsic: &str) -> String {
        // rows of camera-to-world: the camera's x, y, z are the world's −z, y, x
        format!(
            r#"{{"version": ["1", "2", "6"],
            "views": [{{"viewId": "7", "poseId": "7", "intrinsicId": "42", "path": "/gone/a.jpg"}},
                      {{"viewId": "8", "poseId": "8", "intrinsicId": "42", "path": "/gone/b.jpg"}}],
            "intrinsics": [{{"intrinsicId": "42", "width": "400", "height": "300", {intrinsic}}}],
            "poses": [{{"poseId": "7", "pose": {{"transform": {{
                "rotation": ["0", "0", "1", "0", "1", "0", "-1", "0", "0"],
                "center": ["1", "2", "3"]}}, "locked": "0"}}}}]}}"#
        )
    }

    #[test]
    fn rotations_are_columns_and_centres_are_places() {
        let new = file(
            r#""type": "radial3", "sensorWidth": "36", "focalLength": "18", "pixelRatio": "1",
            "principalPoint": ["2", "-3"], "distortionParams": ["0.1", "0.02", "0.003"]"#,
        );
        let capture = read(&new).expect("reads");
        let [shot] = capture.shots.as_slice() else {
            panic!("one shot with a pose")
        };
        let [x, y, z, centre] = [0, 1, 2, 3].map(|i| shot.world_from_camera.col(i).truncate());
        assert_eq!(centre, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(x, DVec3::NEG_Z);
        assert_eq!((-y, -z), (DVec3::Y, DVec3::X));
        let Optics::Distorted(lens) = &shot.optics else {
            panic!("{:?}", shot.optics)
        };
        assert_eq!((lens.focal, lens.centre), ([200.0; 2], [202.0, 147.0]));
        let old = file(
            r#""type": "radial1", "pxFocalLength": "210", "principalPoint": ["202", "147"],
            "distortionParams": ["0.1"]"#,
        );
        let capture = read(&old).expect("reads");
        let Optics::Perspective(p) = &capture.shots[0].optics else {
            panic!("{:?}", capture.shots[0].optics)
        };
        assert_eq!(
            (p.focal, p.centre, p.radial),
            ([210.0; 2], [202.0, 147.0], [0.1, 0.0])
        );
    }

    #[test]
    fn cameras_of_a_rig_stand_where_it_holds_them() {
        // the rig as the pose above; its second camera half a metre along the rig's x
        let rig = r#""rigId": "5", "subPoseId": "1", "intrinsicId": "42", "path": "/gone/a.jpg""#;
        let rigs = r#""rigs": [{"rigId": "5", "subPoses": [{"status": "constant"},
            {"status": "estimated", "pose": {"rotation": ["1", "0", "0", "0", "1", "0", "0", "0", "1"],
                "center": ["0.5", "0", "0"]}}]}],
            "views": ["#;
        let text = file(r#""type": "pinhole", "pxFocalLength": "210""#)
            .replace(r#""intrinsicId": "42", "path": "/gone/a.jpg""#, rig)
            .replace(r#""views": ["#, rigs);
        let pose = read(&text).expect("reads").shots[0].world_from_camera;
        assert_eq!(pose.w_axis.truncate(), DVec3::new(1.0, 2.0, 2.5));
        let missing = text.replace(r#""subPoseId": "1""#, r#""subPoseId": "2""#);
        let refused = read(&missing).expect_err("no third camera").to_string();
        assert!(refused.contains("subPoseId"), "{refused}");
    }

    #[test]
    fn meshes_of_newer_files_are_turned_into_the_world_of_the_poses() {
        let surface = |version: &str| {
            let dir = tempfile::tempdir().expect("temp");
            let text = file(r#""type": "pinhole", "pxFocalLength": "210""#)
                .replace(r#"["1", "2", "6"]"#, version);
            std::fs::write(dir.path().join("a.jpg"), "").expect("image");
            std::fs::write(dir.path().join("mesh.obj"), "").expect("mesh");
            std::fs::write(dir.path().join("cameras.sfm"), text).expect("file");
            let options = PrepareOptions::default();
            let capture = AliceVision.import(dir.path(), &options, &mut Account::default());
            match capture.expect("reads").surface {
                Some(Surface::File {
                    world_from_file, ..
                }) => world_from_file,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(surface(r#"["1", "2", "2"]"#), DMat4::IDENTITY);
        assert_eq!(surface(r#"["1", "2", "3"]"#), DMat4::from_scale(HALF_TURN));
        assert_eq!(surface(r#"["1", "10", "0"]"#), DMat4::from_scale(HALF_TURN));
    }

    #[test]
    fn what_is_missing_is_named() {
        let refused = |text: &str| read(text).expect_err("must be refused").to_string();
        assert!(refused("{}").contains("no view with a pose"));
        assert!(refused("[").contains("AliceVision's JSON"));
        assert!(refused(&file(r#""type": "pinhole""#)).contains("focal length"));
        let strange = file(r#""type": "3deanamorphic4", "pxFocalLength": "9""#);
        assert!(refused(&strange).contains("3deanamorphic4"));
    }
}
