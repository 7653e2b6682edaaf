//! RealityScan (RealityCapture until 2025): the cameras that it exports as `.xmp` beside each photograph
//! (Alignment > Export > XMP Files), or as one `.csv` (Internal/External camera parameters).
//!
//! Lengths on the image are shares of its longer side, 0 in its middle: a point (x, y) of the plane at distance 1
//! lies at f·x + u. Focal lengths are of 35 mm film, 36 wide; the CSV's principal point, too. XMP states world-to-camera
//! by rows (x right, y down, z forward) and the camera's place; the CSV heading, pitch and roll of a camera
//! that looks down with north above (turns about z clockwise, x, y). z points up. Distortion is Brown's: k1 r² + k2 r⁴ + k3 r⁶,
//! t1 and t2 as OpenCV's p1 and p2 (RealityScan's "Camera Geometry" reference).

use super::account::Account;
use super::camera_axes::HALF_TURN;
use super::capture::{Capture, Shot, Surface, Up};
use super::importer::{
    Importer, Located, PrepareOptions, files_in, finite_numbers, is_rotation, mesh_beside,
    only_of_kind, photograph_named, stem_of,
};
use super::lens::{Distortion, Lens, Optics, Perspective};
use crate::core::formats::{image_info, read_input_text};
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DVec3};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Width of 35 mm film, millimetres.
const FILM: f64 = 36.0;
/// Folders of the photographs, from the file's folder.
const IMAGES: [&str; 4] = [".", "images", "photos", "../images"];
const ENDINGS: [&str; 8] = ["exr", "hdr", "jpg", "JPG", "jpeg", "png", "PNG", "tif"];
/// Columns that a pose needs.
const POSE: [&str; 6] = ["x", "y", "alt", "heading", "pitch", "roll"];
/// What an export without lenses lacks.
const EXPORT_AGAIN: &str = "export \"Internal/External camera parameters\" (.csv) or XMP files";

type Reading<T> = std::result::Result<T, String>;

/// The importer.
pub struct RealityScan;

impl Importer for RealityScan {
    fn kind(&self) -> &'static str {
        "realityscan"
    }

    fn looks_like(&self) -> &'static str {
        "RealityScan, RealityCapture: photographs with .xmp files, or a .csv of camera parameters"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no .csv of camera parameters (first columns #name, x, y, alt) and no .xmp with a pose beside photographs; \
                        export the cameras from RealityScan";
        let has_sidecars = || !sidecars(path).is_empty();
        let folder = || (path.is_dir() && has_sidecars()).then(|| path.to_path_buf());
        Located::new(path, table_in(path).or_else(folder), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let start = &located.start;
        let folder = if start.is_dir() {
            start.as_path()
        } else {
            located.folder()
        };
        let shots = match start.is_dir() {
            true => shots_of_sidecars(start)?,
            false => shots_of_table(start, folder, account)?,
        };
        account.read(format!(
            "{}: {} posed photographs",
            start.display(),
            shots.len()
        ));
        account.converted("poses from axes with y down to axes with y up");
        let mesh = mesh_beside(folder, &["mesh.obj", "model.obj", "mesh.ply", "model.ply"]);
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Z,
            unit_unknown: true,
            ..Capture::default()
        })
    }
}

/// The table of camera parameters: the file itself, or the only one of a folder.
fn table_in(path: &Path) -> Option<PathBuf> {
    let ours = |p: &Path| {
        let csv = p.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
        csv && read_input_text(p).is_ok_and(|t| header(&t).is_some())
    };
    only_of_kind(path, ours)
}

/// The number of the line of a table that names its columns, and their names.
fn header(text: &str) -> Option<(usize, Vec<String>)> {
    // before it may stand "#cameras 24"
    text.lines().take(3).enumerate().find_map(|(n, line)| {
        let names: Vec<String> = cells(line)
            .map(|c| c.trim_start_matches('#').to_ascii_lowercase())
            .collect();
        let has = |name: &&str| names.iter().any(|n| n == *name);
        (names.first().is_some_and(|n| n == "name") && POSE.iter().all(has)).then_some((n, names))
    })
}

fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(|c| c.trim().trim_matches('"'))
}

fn shots_of_table(file: &Path, folder: &Path, account: &mut Account) -> Result<Vec<Shot>> {
    let fail = |m: String| Error::input(file, m);
    let text = read_input_text(file)?;
    let (first, names) = header(&text).ok_or_else(|| {
        fail(format!(
            "names no columns {}; {EXPORT_AGAIN}",
            POSE.join(", ")
        ))
    })?;
    if !names.iter().any(|n| n == "f") {
        return Err(fail(format!(
            "has no column f (focal length); {EXPORT_AGAIN}"
        )));
    }
    let (mut shots, mut missing) = (Vec::new(), Vec::new());
    for (n, line) in text.lines().enumerate().skip(first + 1) {
        if line.trim().is_empty() {
            continue;
        }
        let at = |m: String| fail(format!("line {}: {m}", n + 1));
        let row = Row::of(&names, line).map_err(at)?;
        let folders = IMAGES.iter().map(|f| folder.join(f));
        let Some(image) = photograph_named(folders, row.name) else {
            missing.push(row.name.to_owned());
            continue;
        };
        let camera = row.camera().map_err(at)?;
        shots.push(camera.shot(stem_of(row.name), image).map_err(at)?);
    }
    if shots.is_empty() {
        return Err(fail(match missing.first() {
            Some(name) => format!(
                "{name} and all others were not found; put the photographs beside the file or into images/"
            ),
            None => "has no line of a camera; align the photographs first".into(),
        }));
    }
    if let Some(name) = missing.first() {
        account.ignored(format!(
            "{} cameras whose photograph was not found ({name})",
            missing.len()
        ));
    }
    Ok(shots)
}

/// A line of a table.
struct Row<'t> {
    name: &'t str,
    numbers: BTreeMap<&'t str, f64>,
}

impl<'t> Row<'t> {
    fn of(names: &'t [String], line: &'t str) -> Reading<Self> {
        let mut of_line = cells(line);
        let name = of_line.next().unwrap_or("");
        let mut numbers = BTreeMap::new();
        for (key, cell) in names[1..].iter().zip(of_line) {
            let number = cell.parse().ok().filter(|n: &f64| n.is_finite());
            match number {
                Some(number) => numbers.insert(key.as_str(), number),
                // (columns of one's own may hold words)
                None if !POSE.contains(&key.as_str()) && !Camera::TERMS.contains(&key.as_str()) => {
                    continue;
                }
                None => return Err(format!("{key} is {cell:?}; expected a finite number")),
            };
        }
        let absent = POSE
            .iter()
            .chain(&["f"])
            .find(|key| !numbers.contains_key(**key));
        match absent {
            Some(key) => Err(format!("ends before {key}; export the cameras again")),
            None => Ok(Self { name, numbers }),
        }
    }

    fn camera(&self) -> Reading<Camera> {
        let of = |key: &str| self.numbers.get(key).copied().unwrap_or(0.0);
        let angle = |key: &str| of(key).to_radians();
        let turn = DMat3::from_rotation_z(-angle("heading"))
            * DMat3::from_rotation_x(angle("pitch"))
            * DMat3::from_rotation_y(angle("roll"));
        let mut pose = DMat4::from_mat3(turn);
        pose.w_axis = DVec3::new(of("x"), of("y"), of("alt")).extend(1.0);
        Camera {
            pose,
            focal: of("f") / FILM,
            centre: [of("px") / FILM, of("py") / FILM],
            radial: ["k1", "k2", "k3", "k4"].map(of),
            tangential: ["t1", "t2"].map(of),
        }
        .checked()
    }
}

/// The `.xmp` files of a folder, and of its `images`, that hold a pose beside a photograph of their name.
fn sidecars(folder: &Path) -> Vec<(PathBuf, PathBuf)> {
    let xmp = |p: &Path| p.extension().is_some_and(|e| e.eq_ignore_ascii_case("xmp"));
    let all = IMAGES[..3]
        .iter()
        .flat_map(|f| files_in(&folder.join(f), xmp));
    let with_photograph = all.filter_map(|file| {
        let named = ENDINGS.iter().map(|e| file.with_extension(e));
        let image = named.into_iter().find(|p| p.is_file())?;
        Some((file, image))
    });
    let has_pose = |(file, _): &(PathBuf, PathBuf)| {
        read_input_text(file).is_ok_and(|t| t.contains("xcr:Rotation"))
    };
    with_photograph.filter(has_pose).collect()
}

fn shots_of_sidecars(folder: &Path) -> Result<Vec<Shot>> {
    let shot = |(file, image): (PathBuf, PathBuf)| {
        let fail = |m: String| Error::input(&file, m);
        let text = read_input_text(&file)?;
        let document = Document::parse(&text).map_err(|e| fail(format!("{e}; expected XMP")))?;
        let camera = camera_of_sidecar(&document).map_err(fail)?;
        let stem = image
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        camera.shot(stem, image).map_err(fail)
    };
    sidecars(folder).into_iter().map(shot).collect()
}

fn camera_of_sidecar(document: &Document<'_>) -> Reading<Camera> {
    let nodes = || document.descendants().filter(Node::is_element);
    // each stands as an attribute or as an element of its own
    let text = |key: &str| -> Option<String> {
        let attribute = |n: Node<'_, '_>| {
            let mut all = n.attributes();
            all.find(|a| a.name() == key).map(|a| a.value().to_owned())
        };
        let element = || {
            nodes()
                .find(|n| n.tag_name().name() == key)?
                .text()
                .map(str::to_owned)
        };
        nodes().find_map(attribute).or_else(element)
    };
    let numbers = |key: &str| -> Reading<Vec<f64>> {
        let text = text(key).unwrap_or_default();
        finite_numbers(&text).ok_or_else(|| format!("xcr:{key}: {text:?}; expected finite numbers"))
    };
    let number =
        |key: &str, usual: f64| Ok::<f64, String>(numbers(key)?.first().copied().unwrap_or(usual));
    let rotation = <[f64; 9]>::try_from(numbers("Rotation")?)
        .map_err(|_| "xcr:Rotation: expected nine numbers")?;
    let position = <[f64; 3]>::try_from(numbers("Position")?)
        .map_err(|_| "xcr:Position: expected three numbers")?;
    if number("Skew", 0.0)? != 0.0 || number("AspectRatio", 1.0)? != 1.0 {
        return Err(
            "xcr:Skew is not 0 or xcr:AspectRatio not 1, which no lens here has; align with square pixels"
                .into(),
        );
    }
    // rows of world-to-camera are columns of its inverse; y and z turn round
    let camera_from_world = DMat3::from_cols_array(&rotation);
    let axes = camera_from_world * DMat3::from_diagonal(HALF_TURN);
    let mut pose = DMat4::from_mat3(axes);
    pose.w_axis = DVec3::from_array(position).extend(1.0);
    let mut terms = numbers("DistortionCoeficients")?;
    terms.resize(6, 0.0);
    let model = text("DistortionModel").unwrap_or_default();
    let is_brown = model.starts_with("brown") || model == "perspective";
    if !is_brown && terms.iter().any(|t| *t != 0.0) {
        return Err(format!(
            "xcr:DistortionModel {model:?} is not read; choose Brown3 (Alignment settings, Distortion model), align and export again"
        ));
    }
    Camera {
        pose,
        focal: number("FocalLength35mm", 0.0)? / FILM,
        centre: [
            number("PrincipalPointU", 0.0)?,
            number("PrincipalPointV", 0.0)?,
        ],
        radial: [terms[0], terms[1], terms[2], terms[3]],
        tangential: [terms[4], terms[5]],
    }
    .checked()
}

/// A camera with lengths in shares of the image's longer side.
#[derive(Debug)]
struct Camera {
    /// Camera-to-world, OpenGL's axes.
    pose: DMat4,
    focal: f64,
    centre: [f64; 2],
    radial: [f64; 4],
    tangential: [f64; 2],
}

impl Camera {
    /// Columns of a table that say how a lens bends.
    const TERMS: [&'static str; 9] = ["f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2"];

    fn checked(self) -> Reading<Self> {
        if !is_rotation(DMat3::from_mat4(self.pose)) {
            return Err("the pose holds no rotation; export the cameras again".into());
        }
        if self.focal <= 0.0 {
            return Err("expected a positive focal length; align the photographs first".into());
        }
        if self.radial[3] != 0.0 {
            return Err("k4 is not read; choose Brown3 (Alignment settings, Distortion model), align and export again".into());
        }
        Ok(self)
    }

    fn shot(&self, stem: String, image: PathBuf) -> Reading<Shot> {
        let info = image_info(&image).map_err(|e| e.to_string())?;
        let (width, height) = (info.width as f64, info.height as f64);
        let side = width.max(height);
        let focal = [self.focal * side; 2];
        let centre = [
            0.5 * width + self.centre[0] * side,
            0.5 * height + self.centre[1] * side,
        ];
        let ([k1, k2, k3, _], [p1, p2]) = (self.radial, self.tangential);
        let optics = match k3 == 0.0 {
            true => Optics::Perspective(Perspective {
                focal,
                centre,
                radial: [k1, k2],
                tangential: [p1, p2],
            }),
            false => Optics::Distorted(Lens {
                distortion: Distortion::Rational([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
                focal,
                centre,
            }),
        };
        let mut shot = Shot::new(stem, image, self.pose, optics);
        shot.size = Some([info.width, info.height]);
        Ok(shot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";

    fn photograph(path: &Path) {
        crate::core::formats::write_png_rgb8(path, 40, 30, &[90; 3600]).expect("image");
    }

    fn import(dir: &Path, account: &mut Account) -> Result<Vec<Shot>> {
        let read = RealityScan.import(dir, &PrepareOptions::default(), account);
        read.map(|capture| capture.shots)
    }

    fn close(a: DVec3, b: DVec3) {
        assert!((a - b).length() < 1e-9, "{a} for {b}");
    }

    /// Axes of a camera in the world: right, up, backwards; its place.
    fn axes(shot: &Shot) -> [DVec3; 4] {
        [0, 1, 2, 3].map(|i| shot.world_from_camera.col(i).truncate())
    }

    #[test]
    fn a_table_states_angles_and_35_mm_lenses() {
        let dir = tempfile::tempdir().expect("temp");
        photograph(&dir.path().join("a b.png"));
        let table = dir.path().join("cameras.csv");
        // level towards the east; then straight down with north above
        let lines = "a b.png,1,2,3,90,90,0,18,0.9,-1.8,0.1,0.01,0,0,0.001,0.002\n                     gone.png,0,0,0,0,0,0,18,0,0,0,0,0,0,0,0\n                     a b.png,0,0,9,0,0,0,36,0,0,0,0,0.5,0,0,0\n";
        std::fs::write(&table, format!("#cameras 3\r\n{HEAD}\r\n{lines}")).expect("file");
        assert!(RealityScan.recognises(dir.path()) && RealityScan.recognises(&table));
        let mut account = Account::default();
        let shots = import(dir.path(), &mut account).expect("reads");
        let [east, down] = shots.as_slice() else {
            panic!("{} shots", shots.len())
        };
        let [right, up, back, place] = axes(east);
        close(right, DVec3::NEG_Y);
        close(up, DVec3::Z);
        close(back, DVec3::NEG_X);
        close(place, DVec3::new(1.0, 2.0, 3.0));
        let Optics::Perspective(p) = &east.optics else {
            panic!("{:?}", east.optics)
        };
        // half of the longer side; the middle, and a fortieth and a twentieth of that side beside it
        assert_eq!((p.focal, p.centre), ([20.0; 2], [21.0, 13.0]));
        assert_eq!((p.radial, p.tangential), ([0.1, 0.01], [0.001, 0.002]));
        let [right, up, back, _] = axes(down);
        close(right, DVec3::X);
        close(up, DVec3::Y);
        close(back, DVec3::Z);
        assert!(matches!(&down.optics, Optics::Distorted(l) if l.focal == [40.0; 2]));
        assert!(
            account.ignored.iter().any(|l| l.contains("gone.png")),
            "{account:?}"
        );
    }

    const XMP: &str = r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
        <rdf:Description xcr:Version="3" xcr:DistortionModel="brown3" xcr:FocalLength35mm="18" xcr:Skew="0" xcr:AspectRatio="1"
        xcr:PrincipalPointU="0.025" xcr:PrincipalPointV="-0.05" xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">
        <xcr:Rotation>0 -1 0 0 0 -1 1 0 0</xcr:Rotation><xcr:Position>1 2 3</xcr:Position>
        <xcr:DistortionCoeficients>0.1 0.01 0 0 0.001 0.002</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>"#;

    /// The camera of the table's first line as RealityScan's other export states it.
    #[test]
    fn sidecars_state_the_same_camera() {
        let dir = tempfile::tempdir().expect("temp");
        let images = dir.path().join("images");
        std::fs::create_dir(&images).expect("folder");
        photograph(&images.join("a.png"));
        photograph(&images.join("not aligned.png"));
        std::fs::write(images.join("a.xmp"), XMP).expect("file");
        let without = XMP.replace("xcr:Rotation", "xcr:Nothing");
        std::fs::write(images.join("not aligned.xmp"), without).expect("file");
        let shots = import(dir.path(), &mut Account::default()).expect("reads");
        let [shot] = shots.as_slice() else {
            panic!("{} shots", shots.len())
        };
        let [right, up, back, place] = axes(shot);
        assert_eq!([right, up, back], [DVec3::NEG_Y, DVec3::Z, DVec3::NEG_X]);
        assert_eq!(place, DVec3::new(1.0, 2.0, 3.0));
        let Optics::Perspective(p) = &shot.optics else {
            panic!("{:?}", shot.optics)
        };
        assert_eq!((p.focal, p.radial), ([20.0; 2], [0.1, 0.01]));
        assert!((p.centre[0] - 21.0).abs() < 1e-9 && (p.centre[1] - 13.0).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_read_is_named_with_the_way_out() {
        let dir = tempfile::tempdir().expect("temp");
        let image = dir.path().join("a.png");
        photograph(&image);
        let said = |name: &str, text: &str| {
            let file = dir.path().join(name);
            std::fs::write(&file, text).expect("file");
            let e = import(dir.path(), &mut Account::default()).expect_err("refused");
            std::fs::remove_file(file).expect("removed");
            e.to_string()
        };
        let row = |line: &str| said("c.csv", &format!("{HEAD}\n{line}\n"));
        assert!(row("a.png,0,0,zero,0,0,0,18").contains("line 2: alt"));
        assert!(row("a.png,0,0,0,0,0,0").contains("ends before f"));
        assert!(row("a.png,0,0,0,0,0,0,0").contains("focal length"));
        assert!(row("a.png,0,0,0,0,0,0,18,0,0,0,0,0,0.1,0,0").contains("Brown3"));
        assert!(row("b.png,0,0,0,0,0,0,18").contains("images/"));
        let without = HEAD.replace(",f,", ",focus,");
        assert!(said("c.csv", &format!("{without}\na.png\n")).contains("column f"));
        assert!(said("a.xmp", &XMP.replace("brown3", "division")).contains("Brown3"));
        assert!(said("a.xmp", &XMP.replace("0 -1 0 0 0 -1", "0 -1 0 0 0 -2")).contains("rotation"));
        assert!(said("a.xmp", &XMP.replace("1 2 3<", "1 2<")).contains("three numbers"));
        assert!(said("a.xmp", &XMP[..XMP.len() - 30]).contains("expected XMP"));
        assert!(!RealityScan.recognises(dir.path()));
    }
}
