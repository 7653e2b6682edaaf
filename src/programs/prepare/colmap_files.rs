//! The files of COLMAP's sparse models, text and binary: `cameras`, `images` and `points3D`, as its
//! documentation describes them. Called by `colmap`.

use crate::core::formats::{MOST_DATA, read_input, read_input_text};
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Most parameters a camera may state.
const MOST_PARAMETERS: usize = 16;

/// Name and number of parameters of every model, by its id.
pub const MODEL_NAMES: [(&str, usize); 18] = [
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
pub struct CameraEntry {
    /// Name of the lens model.
    pub model: String,
    /// Columns and rows.
    pub size: [usize; 2],
    /// As many as the model has.
    pub parameters: Vec<f64>,
}

/// One image with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageEntry {
    /// Its number.
    pub id: u32,
    /// Its file, from the folder of the images.
    pub name: String,
    /// Number of its camera.
    pub camera: u32,
    /// OpenCV axes.
    pub camera_from_world: DMat4,
}

/// Cameras and images of a model.
pub struct Model {
    /// By their number.
    pub cameras: BTreeMap<u32, CameraEntry>,
    /// In the file's order.
    pub images: Vec<ImageEntry>,
    /// `binary` or `text`.
    pub form: &'static str,
}

impl Model {
    /// Reads the model in a folder.
    ///
    /// # Errors
    /// One of its files is missing or damaged.
    pub fn read(folder: &Path) -> Result<Self> {
        if folder.join("cameras.bin").is_file() {
            return Ok(Self {
                cameras: binary_cameras(&folder.join("cameras.bin"))?,
                images: binary_images(&folder.join("images.bin"))?,
                form: "binary",
            });
        }
        Ok(Self {
            cameras: text_cameras(&folder.join("cameras.txt"))?,
            images: text_images(&folder.join("images.txt"))?,
            form: "text",
        })
    }
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
pub struct SparsePoint {
    /// Where it is, units of the model.
    pub place: DVec3,
    /// Ids of the images that show it.
    pub seen_by: BTreeSet<u32>,
}

/// The points of a model; none where it has no such file.
///
/// # Errors
/// The file is damaged.
pub fn sparse_points(folder: &Path) -> Result<Vec<SparsePoint>> {
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
}
