//! COLMAP sparse models, text and binary: cameras of every model up to 4.1, poses per image
//! (rigs included: `images` states each image's own pose), and the dense mesh beside them.
//!
//! COLMAP's poses are camera-from-world with OpenCV axes (x right, y down, z forward); its world
//! has neither a unit nor an up of its own.

use super::account::Account;
use super::capture::{Capture, Shot, Surface, Up};
use super::importer::{Importer, Located, PrepareOptions, photograph_named, stem_of};
use super::lens::{Distortion, Lens};
use super::lens::{Optics, Perspective};
use crate::core::formats::{MOST_DATA, read_input, read_input_text};
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};
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
/// Most parameters a camera may state.
const MOST_PARAMETERS: usize = 16;

/// Name and number of parameters of every model, by its id.
const MODEL_NAMES: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// One line of `cameras`.
#[derive(Clone, Debug, PartialEq)]
struct CameraEntry {
    model: String,
    size: [usize; 2],
    parameters: Vec<f64>,
}

/// One image with its pose.
#[derive(Clone, Debug, PartialEq)]
struct ImageEntry {
    id: u32,
    name: String,
    camera: u32,
    camera_from_world: DMat4,
}

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
        let (cameras, images, how) = if folder.join("cameras.bin").is_file() {
            (
                binary_cameras(&folder.join("cameras.bin"))?,
                binary_images(&folder.join("images.bin"))?,
                "binary",
            )
        } else {
            (
                text_cameras(&folder.join("cameras.txt"))?,
                text_images(&folder.join("images.txt"))?,
                "text",
            )
        };
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
                gl_world_from_camera(image.camera_from_world),
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
            "{} ({how}): {} cameras ({}), {} posed images",
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
            surface: mesh.map(|path| Surface::File {
                path,
                world_from_file: DMat4::IDENTITY,
            }),
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

/// OpenGL camera-to-world of an OpenCV camera-from-world.
pub fn gl_world_from_camera(camera_from_world: DMat4) -> DMat4 {
    camera_from_world.inverse() * DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0))
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

fn pose(q: [f64; 4], t: [f64; 3]) -> Option<DMat4> {
    let [w, x, y, z] = q;
    let q = DQuat::from_xyzw(x, y, z, w);
    let usable = q.is_finite() && q.length_squared() > 1e-12 && t.iter().all(|x| x.is_finite());
    usable.then(|| {
        let r = DMat3::from_quat(q.normalize());
        DMat4::from_translation(DVec3::from(t)) * DMat4::from_mat3(r)
    })
}

/// The words of every line that is no comment, with its number.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, l)| (i + 1, l.trim_end_matches('\r')))
        .filter(|(_, l)| !l.starts_with('#'))
}

fn text_cameras(path: &Path) -> Result<BTreeMap<u32, CameraEntry>> {
    let text = read_input_text(path)?;
    let mut cameras = BTreeMap::new();
    for (number, line) in lines(&text).filter(|(_, l)| !l.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let entry = || -> Option<(u32, CameraEntry)> {
            let parameters = words.get(4..)?.iter().map(|w| w.parse().ok());
            Some((
                words.first()?.parse().ok()?,
                CameraEntry {
                    model: (*words.get(1)?).into(),
                    size: [words.get(2)?.parse().ok()?, words.get(3)?.parse().ok()?],
                    parameters: parameters.collect::<Option<Vec<f64>>>()?,
                },
            ))
        };
        let (id, camera) = entry().ok_or_else(|| {
            Error::input(
                path,
                format!("line {number}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...; export the model again"),
            )
        })?;
        cameras.insert(id, camera);
    }
    Ok(cameras)
}

fn text_images(path: &Path) -> Result<Vec<ImageEntry>> {
    let text = read_input_text(path)?;
    let mut images = Vec::new();
    let mut rows = lines(&text)
        .skip_while(|(_, l)| l.trim().is_empty())
        .peekable();
    // two lines an image: the pose, then its points, which may be empty, and which files written by
    // hand leave out
    while let Some((number, line)) = rows.next() {
        if line.trim().is_empty() {
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        let entry = || -> Option<ImageEntry> {
            let n: Vec<f64> = words
                .get(1..8)?
                .iter()
                .map(|w| w.parse().ok())
                .collect::<Option<_>>()?;
            Some(ImageEntry {
                id: words.first()?.parse().ok()?,
                name: after_words(line, 9)?.into(),
                camera: words.get(8)?.parse().ok()?,
                camera_from_world: pose([n[0], n[1], n[2], n[3]], [n[4], n[5], n[6]])?,
            })
        };
        images.push(entry().ok_or_else(|| {
            Error::input(
                path,
                format!("line {number}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; export the model again"),
            )
        })?);
        rows.next_if(|(_, l)| are_points(l));
    }
    Ok(images)
}

/// Whether a line lists points of an image: X Y POINT3D_ID each, or nothing.
fn are_points(line: &str) -> bool {
    let numbers: Option<Vec<f64>> = line.split_whitespace().map(|w| w.parse().ok()).collect();
    numbers.is_some_and(|n| n.len().is_multiple_of(3))
}

/// The rest of a line after its first `count` words, as it stands: names may hold blanks.
fn after_words(line: &str, count: usize) -> Option<&str> {
    let mut rest = line.trim();
    for _ in 0..count {
        let end = rest.find(char::is_whitespace)?;
        rest = rest[end..].trim_start();
    }
    (!rest.is_empty()).then_some(rest)
}

/// Little-endian bytes with a place for messages.
struct Bytes<'a> {
    path: &'a Path,
    data: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let end = self.at.checked_add(count).filter(|&e| e <= self.data.len());
        let end = end.ok_or_else(|| {
            Error::input(
                self.path,
                format!(
                    "ends at byte {} where {count} more are expected; copy the model again",
                    self.data.len()
                ),
            )
        })?;
        let taken = &self.data[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut a = [0; N];
        a.copy_from_slice(self.take(N)?);
        Ok(a)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    /// A count of elements of at least `size` bytes each: more than the file can hold is damage.
    fn count(&mut self, size: usize) -> Result<usize> {
        let n = self.u64()?;
        let most = (self.data.len() - self.at) / size;
        usize::try_from(n)
            .ok()
            .filter(|&n| n <= most)
            .ok_or_else(|| {
                Error::input(
                    self.path,
                    format!(
                        "byte {}: {n} elements in the rest of the file; at most {most} fit. Copy the model again",
                        self.at - 8
                    ),
                )
            })
    }
}

fn binary_cameras(path: &Path) -> Result<BTreeMap<u32, CameraEntry>> {
    let data = read_input(path, MOST_DATA)?;
    let mut bytes = Bytes {
        path,
        data: &data,
        at: 0,
    };
    let mut cameras = BTreeMap::new();
    for _ in 0..bytes.count(24)? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let (w, h) = (bytes.u64()?, bytes.u64()?);
        let Some(&(name, count)) = MODEL_NAMES.get(model as usize) else {
            return Err(Error::input(
                path,
                format!(
                    "camera {id} has model {model}; known are 0 to {} ({}). Undistort the images with `colmap image_undistorter`",
                    MODEL_NAMES.len() - 1,
                    MODEL_NAMES.map(|m| m.0).join(", ")
                ),
            ));
        };
        debug_assert!(count <= MOST_PARAMETERS);
        let parameters = (0..count)
            .map(|_| bytes.f64())
            .collect::<Result<Vec<f64>>>()?;
        let side = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
        cameras.insert(
            id,
            CameraEntry {
                model: name.into(),
                size: [side(w), side(h)],
                parameters,
            },
        );
    }
    Ok(cameras)
}

fn binary_images(path: &Path) -> Result<Vec<ImageEntry>> {
    let data = read_input(path, MOST_DATA)?;
    let mut bytes = Bytes {
        path,
        data: &data,
        at: 0,
    };
    let mut images = Vec::new();
    for _ in 0..bytes.count(64)? {
        let id = bytes.u32()?;
        let mut n = [0.0; 7];
        for x in &mut n {
            *x = bytes.f64()?;
        }
        let camera = bytes.u32()?;
        let rest = &data[bytes.at..];
        let length = rest.iter().position(|&b| b == 0).ok_or_else(|| {
            Error::input(
                path,
                format!("image {id}: its name does not end; copy the model again"),
            )
        })?;
        let name = String::from_utf8_lossy(bytes.take(length)?).into_owned();
        bytes.take(1)?;
        let points = bytes.count(24)?;
        bytes.take(24 * points)?;
        let camera_from_world =
            pose([n[0], n[1], n[2], n[3]], [n[4], n[5], n[6]]).ok_or_else(|| {
                Error::input(
                    path,
                    format!(
                        "image {id} ({name}): its pose is not finite; remove it from the model"
                    ),
                )
            })?;
        images.push(ImageEntry {
            id,
            name,
            camera,
            camera_from_world,
        });
    }
    Ok(images)
}

/// A point of the sparse model.
#[derive(Clone, Debug, PartialEq)]
struct SparsePoint {
    place: DVec3,
    /// Ids of the images that show it.
    seen_by: BTreeSet<u32>,
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

/// The points of a model; none where it has no such file.
fn sparse_points(folder: &Path) -> Result<Vec<SparsePoint>> {
    let file = |e: &str| Some(folder.join(format!("points3D.{e}"))).filter(|p| p.is_file());
    match (file("bin"), file("txt")) {
        (Some(path), _) => binary_points(&path),
        (None, Some(path)) => text_points(&path),
        (None, None) => Ok(Vec::new()),
    }
}

fn binary_points(path: &Path) -> Result<Vec<SparsePoint>> {
    let data = read_input(path, MOST_DATA)?;
    let mut bytes = Bytes {
        path,
        data: &data,
        at: 0,
    };
    let mut points = Vec::new();
    for _ in 0..bytes.count(51)? {
        // id, place, colour, error, then pairs of image and number of its point
        bytes.u64()?;
        let place = [bytes.f64()?, bytes.f64()?, bytes.f64()?];
        bytes.take(3 + 8)?;
        let count = bytes.count(8)?;
        let track = bytes.take(8 * count)?.chunks_exact(8);
        let seen_by = track.map(|t| u32::from_le_bytes([t[0], t[1], t[2], t[3]]));
        points.push(SparsePoint {
            place: DVec3::from(place),
            seen_by: seen_by.collect(),
        });
    }
    points.retain(|p| p.place.is_finite());
    Ok(points)
}

fn text_points(path: &Path) -> Result<Vec<SparsePoint>> {
    let text = read_input_text(path)?;
    let mut points = Vec::new();
    for (number, line) in lines(&text).filter(|(_, l)| !l.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let coordinate = |k: usize| words.get(k)?.parse().ok().filter(|x: &f64| x.is_finite());
        let point = || -> Option<SparsePoint> {
            let track = words.get(8..)?.iter().step_by(2).map(|w| w.parse().ok());
            Some(SparsePoint {
                place: DVec3::new(coordinate(1)?, coordinate(2)?, coordinate(3)?),
                seen_by: track.collect::<Option<_>>()?,
            })
        };
        points.push(point().ok_or_else(|| {
            Error::input(
                path,
                format!("line {number}: expected POINT3D_ID X Y Z R G B ERROR, then pairs IMAGE_ID POINT2D_IDX; export the model again"),
            )
        })?);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The binary form of a text model, as COLMAP's documentation describes it.
    fn to_binary(
        cameras: &BTreeMap<u32, CameraEntry>,
        images: &[(ImageEntry, [f64; 7])],
    ) -> [Vec<u8>; 2] {
        let mut c = (cameras.len() as u64).to_le_bytes().to_vec();
        for (id, camera) in cameras {
            let model = MODEL_NAMES
                .iter()
                .position(|m| m.0 == camera.model)
                .expect("known");
            c.extend(id.to_le_bytes());
            c.extend((model as u32).to_le_bytes());
            c.extend(camera.size.iter().flat_map(|s| (*s as u64).to_le_bytes()));
            c.extend(camera.parameters.iter().flat_map(|p| p.to_le_bytes()));
        }
        let mut i = (images.len() as u64).to_le_bytes().to_vec();
        for (image, pose) in images {
            i.extend(image.id.to_le_bytes());
            i.extend(pose.iter().flat_map(|p| p.to_le_bytes()));
            i.extend(image.camera.to_le_bytes());
            i.extend(image.name.as_bytes());
            i.push(0);
            i.extend(1u64.to_le_bytes());
            i.extend([0u8; 24]);
        }
        [c, i]
    }

    const CAMERAS: &str = "# a comment\n1 OPENCV 640 480 500 510 320 240 0.1 -0.02 0.001 0.002\n7 EQUIRECTANGULAR 64 32 64 32\n";
    const IMAGES_TXT: &str = "# two lines an image\n1 0.5 0.5 0.5 0.5 1 2 3 7 a b/pano 1.png\n10 20 -1\n2 1 0 0 0 0 0 -4 1 c.jpg\n\n";

    #[test]
    fn images_without_a_line_of_points_are_all_read_and_names_stand_as_they_are() {
        let dir = tempfile::tempdir().expect("folder");
        let file = dir.path().join("images.txt");
        let text = "1 1 0 0 0 0 0 1 1 a.jpg\n2 1 0 0 0 0 0 2 1 two  blanks.jpg\n\n3 1 0 0 0 0 0 3 1 000012\n4 5 -1\n4 1 0 0 0 0 0 4 1 d.jpg";
        std::fs::write(&file, text).expect("file");
        let images = text_images(&file).expect("images");
        let names: Vec<&str> = images.iter().map(|i| i.name.as_str()).collect();
        assert_eq!(names, ["a.jpg", "two  blanks.jpg", "000012", "d.jpg"]);
    }

    #[test]
    fn other_models_of_a_reconstruction_are_named() {
        let dir = tempfile::tempdir().expect("folder");
        for model in ["sparse/0", "sparse/1", "sparse/notes"] {
            let folder = dir.path().join(model);
            std::fs::create_dir_all(&folder).expect("folder");
            if model != "sparse/notes" {
                std::fs::write(folder.join("cameras.txt"), CAMERAS).expect("file");
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
    fn text_and_binary_say_the_same_and_damage_is_an_error() {
        let dir = tempfile::tempdir().expect("folder");
        let at = |n: &str| dir.path().join(n);
        std::fs::write(at("cameras.txt"), CAMERAS).expect("file");
        std::fs::write(at("images.txt"), IMAGES_TXT).expect("file");
        let cameras = text_cameras(&at("cameras.txt")).expect("cameras");
        let images = text_images(&at("images.txt")).expect("images");
        assert_eq!(images[0].name, "a b/pano 1.png");
        assert_eq!((images.len(), images[1].camera), (2, 1));
        let poses = [
            [0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 3.0],
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -4.0],
        ];
        let both: Vec<_> = images.iter().cloned().zip(poses).collect();
        let [c, i] = to_binary(&cameras, &both);
        std::fs::write(at("cameras.bin"), &c).expect("file");
        std::fs::write(at("images.bin"), &i).expect("file");
        assert_eq!(
            binary_cameras(&at("cameras.bin")).expect("cameras"),
            cameras
        );
        assert_eq!(binary_images(&at("images.bin")).expect("images"), images);
        for n in 0..i.len() {
            std::fs::write(at("cut.bin"), &i[..n]).expect("file");
            assert!(
                binary_images(&at("cut.bin")).is_err_and(|e| e.exit_code() == 2),
                "{n}"
            );
        }
        for n in 0..c.len() {
            std::fs::write(at("cut.bin"), &c[..n]).expect("file");
            assert!(binary_cameras(&at("cut.bin")).is_err(), "{n}");
        }
        let mut hostile = i.clone();
        hostile[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        std::fs::write(at("cut.bin"), &hostile).expect("file");
        assert!(binary_images(&at("cut.bin")).is_err());
        for (text, line) in [
            ("1 OPENCV 640\n", "line 1"),
            ("1 OPENCV a 480 5\n", "line 1"),
        ] {
            std::fs::write(at("cameras.txt"), text).expect("file");
            assert!(text_cameras(&at("cameras.txt")).is_err_and(|e| e.to_string().contains(line)));
        }
    }

    #[test]
    fn sparse_points_are_read_from_text_and_binary() {
        let dir = tempfile::tempdir().expect("folder");
        let at = |n: &str| dir.path().join(n);
        assert_eq!(sparse_points(dir.path()).expect("none"), []);
        let text =
            "# id, place, colour, error, track\n5 1 2 -3.5 9 9 9 0.4 1 0 2 7\n6 0 0 1 9 9 9 0.4\n";
        std::fs::write(at("points3D.txt"), text).expect("file");
        let points = sparse_points(dir.path()).expect("points");
        let first = SparsePoint {
            place: DVec3::new(1.0, 2.0, -3.5),
            seen_by: BTreeSet::from([1, 2]),
        };
        assert_eq!((points.len(), &points[0]), (2, &first));
        let mut b = 2u64.to_le_bytes().to_vec();
        for (id, point) in [5u64, 6].into_iter().zip(&points) {
            b.extend(id.to_le_bytes());
            b.extend(point.place.to_array().iter().flat_map(|x| x.to_le_bytes()));
            b.extend([9; 3]);
            b.extend(0.4f64.to_le_bytes());
            b.extend((point.seen_by.len() as u64).to_le_bytes());
            let track = point.seen_by.iter().flat_map(|i| [*i, 0]);
            b.extend(track.flat_map(|i: u32| i.to_le_bytes()));
        }
        std::fs::write(at("points3D.bin"), &b).expect("file");
        assert_eq!(sparse_points(dir.path()).expect("points"), points);
        for n in 0..b.len() {
            std::fs::write(at("points3D.bin"), &b[..n]).expect("file");
            assert!(
                sparse_points(dir.path()).is_err_and(|e| e.exit_code() == 2),
                "{n}"
            );
        }
        std::fs::remove_file(at("points3D.bin")).expect("file");
        std::fs::write(at("points3D.txt"), "1 2 3\n").expect("file");
        let e = sparse_points(dir.path()).expect_err("short");
        assert!(e.to_string().contains("line 1"), "{e}");
    }

    #[test]
    fn a_level_camera_of_a_y_down_world_stands_upright() {
        // COLMAP's first camera: at the origin, looking along +z, its up along −y
        let world_from_camera = gl_world_from_camera(DMat4::IDENTITY);
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
