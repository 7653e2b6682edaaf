//! COLMAP sparse models, text and binary: cameras of every model up to 4.1, poses per image
//! (rigs included: `images` states each image's own pose), and the dense mesh beside them.
//!
//! COLMAP's poses are camera-from-world with OpenCV axes (x right, y down, z forward); its world
//! has neither a unit nor an up of its own.

use super::account::Account;
use super::camera_axes::gl_from_cv;
use super::capture::{Capture, Shot, Surface, Up};
use super::colmap_files::{CameraEntry, ImageEntry, MODEL_NAMES, Model, sparse_points};
use super::importer::{Importer, Located, PrepareOptions, photograph_named, stem_of};
use super::lens::{Distortion, Lens};
use super::lens::{Optics, Perspective};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where programs put a sparse model below the folder a user names.
const MODELS: [&str; 8] = [
    "",
    "sparse/0",
    "sparse",
    "colmap/sparse/0",
    "dense/sparse",
    "dense/0/sparse",
    "dslr/colmap",
    "colmap",
];
/// Where the photographs lie, from the model's folder upwards.
const IMAGES: [&str; 7] = [
    "images",
    "../images",
    "../../images",
    "../../../images",
    "../resized_undistorted_images",
    "../resized_images",
    ".",
];
/// Meshes of COLMAP's dense pipeline, from the model's folder upwards.
const MESHES: [&str; 8] = [
    "meshed-poisson.ply",
    "meshed-delaunay.ply",
    "../meshed-poisson.ply",
    "../meshed-delaunay.ply",
    "../../dense/meshed-poisson.ply",
    "../../dense/0/meshed-poisson.ply",
    "../dense/meshed-poisson.ply",
    "../../dense/meshed-delaunay.ply",
];
/// The importer.
pub struct Colmap;

impl Importer for Colmap {
    fn kind(&self) -> &'static str {
        "colmap"
    }

    fn looks_like(&self) -> &'static str {
        "COLMAP: cameras.bin and images.bin (or .txt), here or in sparse/0"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no cameras.bin (or .txt) with images.bin (or .txt), here or in sparse/0; give the folder of a COLMAP model";
        Located::new(path, model_folder(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let folder = &located.start;
        let Model {
            cameras,
            images,
            form,
        } = Model::read(folder)?;
        tell_other_models(folder, images.len(), account);
        let mut shots = Vec::new();
        for image in &images {
            let Some(camera) = cameras.get(&image.camera) else {
                return Err(Error::input(
                    folder,
                    format!(
                        "image {} names camera {}, which cameras does not hold; export the model again",
                        image.name, image.camera
                    ),
                ));
            };
            let optics = optics(camera).map_err(|m| Error::input(folder, m))?;
            let file = find_image(&located.named, folder, &image.name)?;
            let mut shot = Shot::new(
                stem_of(&image.name),
                file,
                gl_from_cv(image.camera_from_world.inverse()),
                optics,
            );
            shot.size = Some(camera.size);
            shots.push(shot);
        }
        // sparse points hold the scale of depth that a network sees
        let points = match options.networks.depth_model {
            Some(_) => add_points(folder, &images, &mut shots)?,
            None => 0,
        };
        if shots.is_empty() {
            return Err(Error::input(folder, "the model holds no image with a pose"));
        }
        account.read(format!(
            "{} ({form}): {} cameras ({}), {} posed images",
            folder.display(),
            cameras.len(),
            models_used(&cameras),
            shots.len()
        ));
        account.converted("poses from camera-from-world with y down to camera-to-world with y up");
        match points {
            0 => account.ignored("sparse points, observations, rigs (each image has its own pose)"),
            n => {
                account.read(format!(
                    "{n} sparse points, for the scale of the network's depth"
                ));
                account.ignored("observations, rigs (each image has its own pose)");
            }
        }
        let mesh = MESHES.iter().map(|m| folder.join(m)).find(|m| m.is_file());
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Unknown,
            unit_unknown: true,
            ..Capture::default()
        })
    }
}

fn model_folder(path: &Path) -> Option<PathBuf> {
    let has = |f: &Path, e: &str| {
        f.join(format!("cameras.{e}")).is_file() && f.join(format!("images.{e}")).is_file()
    };
    MODELS
        .iter()
        .map(|m| {
            if m.is_empty() {
                path.to_path_buf()
            } else {
                path.join(m)
            }
        })
        .find(|f| has(f, "bin") || has(f, "txt"))
}

/// Says which other models COLMAP left beside this one: it numbers them where it could not join all
/// images, and the largest need not be the first.
fn tell_other_models(folder: &Path, images: usize, account: &mut Account) {
    let numbered = folder.file_name().and_then(|n| n.to_str());
    if numbered.is_none_or(|n| n.parse::<u32>().is_err()) {
        return;
    }
    let others = std::fs::read_dir(folder.with_file_name(""))
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path())
        .filter(|p| p != folder && model_folder(p).is_some_and(|m| m == *p));
    let mut names: Vec<String> = others.map(|p| p.display().to_string()).collect();
    if names.is_empty() {
        return;
    }
    names.sort();
    account.ignored(format!(
        "other models of this reconstruction ({}); {} with {images} images was taken, name the folder of another if it has more",
        names.join(", "),
        folder.display()
    ));
}

fn models_used(cameras: &BTreeMap<u32, CameraEntry>) -> String {
    let mut names: Vec<&str> = cameras.values().map(|c| c.model.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names.join(", ")
}

fn find_image(root: &Path, model: &Path, name: &str) -> Result<PathBuf> {
    let places = IMAGES
        .iter()
        .map(|place| model.join(place))
        .chain([root.join("images"), root.to_path_buf()]);
    let found = photograph_named(places, name);
    found.ok_or_else(|| {
        Error::input(
            model,
            format!("the photograph {name} was not found; put the images into a folder images/ beside the model"),
        )
    })
}

/// The optics of a camera entry, or why there are none.
fn optics(camera: &CameraEntry) -> std::result::Result<Optics, String> {
    let p = &camera.parameters;
    let known = MODEL_NAMES.iter().find(|m| m.0 == camera.model);
    let Some(&(_, count)) = known else {
        let names: Vec<&str> = MODEL_NAMES.iter().map(|m| m.0).collect();
        return Err(format!(
            "camera model {} is not known here (known: {}); undistort the images with `colmap image_undistorter`",
            camera.model,
            names.join(", ")
        ));
    };
    if p.len() != count || p.iter().any(|x| !x.is_finite()) {
        return Err(format!(
            "camera model {} has {} parameters, expected {count} finite ones; export the model again",
            camera.model,
            p.len()
        ));
    }
    if camera.model == "EQUIRECTANGULAR" {
        return Ok(Optics::Panorama);
    }
    let one_focal = camera.model.starts_with("SIMPLE_") || camera.model.starts_with("RADIAL");
    let (focal, rest) = if one_focal {
        ([p[0], p[0]], &p[1..])
    } else {
        ([p[0], p[1]], &p[2..])
    };
    let (centre, c) = ([rest[0], rest[1]], &rest[2..]);
    if focal[0] <= 0.0 || focal[1] <= 0.0 {
        return Err(format!(
            "camera model {}: focal lengths {focal:?}; expected positive pixels",
            camera.model
        ));
    }
    let perspective = |radial: [f64; 2], tangential: [f64; 2]| {
        Optics::Perspective(Perspective {
            focal,
            centre,
            radial,
            tangential,
        })
    };
    let distortion = match camera.model.as_str() {
        "SIMPLE_PINHOLE" | "PINHOLE" => return Ok(perspective([0.0; 2], [0.0; 2])),
        "SIMPLE_RADIAL" => return Ok(perspective([c[0], 0.0], [0.0; 2])),
        "RADIAL" => return Ok(perspective([c[0], c[1]], [0.0; 2])),
        "OPENCV" => return Ok(perspective([c[0], c[1]], [c[2], c[3]])),
        "FULL_OPENCV" => Distortion::Rational(padded(c)),
        "FOV" => Distortion::FieldOfView(c[0]),
        "SIMPLE_DIVISION" | "DIVISION" => Distortion::Division(c[0]),
        "EUCM" => Distortion::Unified(padded(c)),
        "THIN_PRISM_FISHEYE" => Distortion::ThinPrismFisheye(padded(c)),
        "RAD_TAN_THIN_PRISM_FISHEYE" => Distortion::RadTanThinPrismFisheye(padded(c)),
        // SIMPLE_FISHEYE, FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, OPENCV_FISHEYE
        _ => Distortion::Fisheye(padded(c)),
    };
    Ok(Optics::Distorted(Lens {
        distortion,
        focal,
        centre,
    }))
}

fn padded<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

/// Gives every photograph the points it shows; how many points there are.
fn add_points(folder: &Path, images: &[ImageEntry], shots: &mut [Shot]) -> Result<usize> {
    let points = sparse_points(folder)?;
    for (image, shot) in images.iter().zip(shots) {
        let camera_from_world = shot.world_from_camera.inverse();
        let seen = points.iter().filter(|p| p.seen_by.contains(&image.id));
        shot.points = seen
            .map(|p| camera_from_world.transform_point3(p.place))
            .collect();
    }
    Ok(points.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, DVec3};

    #[test]
    fn other_models_of_a_reconstruction_are_named() {
        let dir = tempfile::tempdir().expect("folder");
        for model in ["sparse/0", "sparse/1", "sparse/notes"] {
            let folder = dir.path().join(model);
            std::fs::create_dir_all(&folder).expect("folder");
            if model != "sparse/notes" {
                std::fs::write(folder.join("cameras.txt"), "").expect("file");
                std::fs::write(folder.join("images.txt"), "").expect("file");
            }
        }
        let mut account = Account::default();
        tell_other_models(&dir.path().join("sparse/0"), 3, &mut account);
        let [told] = account.ignored.as_slice() else {
            panic!("{:?}", account.ignored)
        };
        assert!(
            told.contains("sparse/1") && !told.contains("notes"),
            "{told}"
        );
    }

    #[test]
    fn a_level_camera_of_a_y_down_world_stands_upright() {
        // COLMAP's first camera: at the origin, looking along +z, its up along −y
        let world_from_camera = gl_from_cv(DMat4::IDENTITY);
        assert_eq!(world_from_camera.transform_vector3(DVec3::NEG_Z), DVec3::Z);
        assert_eq!(world_from_camera.transform_vector3(DVec3::Y), DVec3::NEG_Y);
    }

    #[test]
    fn unknown_models_are_refused_by_name() {
        let camera = |model: &str, n: usize| CameraEntry {
            model: model.into(),
            size: [64, 48],
            parameters: vec![10.0; n],
        };
        assert!(optics(&camera("MEI", 6)).is_err_and(|m| m.contains("MEI")));
        assert!(optics(&camera("OPENCV", 7)).is_err_and(|m| m.contains("expected 8")));
        for (model, count) in MODEL_NAMES {
            assert!(optics(&camera(model, count)).is_ok(), "{model}");
        }
    }
}
