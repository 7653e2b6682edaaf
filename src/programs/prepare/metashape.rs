//! Agisoft Metashape's camera file (File > Export > Export Cameras, `.xml`): sensors, cameras with
//! a camera-to-chunk matrix, and the transform of the chunk or component to the world.
//!
//! Axes are OpenCV's, panoramas look along +z in their middle; pixel centres lie at +0.5 and
//! cx, cy are offsets from the middle (Metashape user manual, appendix "Camera models"). Its p1 and
//! p2 are OpenCV's p2 and p1. A fisheye is equidistant with the same polynomials of the angle.

use super::account::Account;
use super::camera_axes::gl_from_cv;
use super::capture::{Capture, Shot, Surface, Up};
use super::importer::{
    Importer, Located, PrepareOptions, finite_numbers, mesh_beside, only_of_kind, photograph_named,
    stem_of,
};
use super::lens::{Distortion, Lens, Optics};
use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DVec3};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Folders of the photographs, from the file's folder.
const IMAGES: [&str; 4] = [".", "images", "photos", "../images"];
/// Labels come without an ending from most exports; merged brackets are taken before photographs.
const ENDINGS: [&str; 7] = ["exr", "hdr", "jpg", "JPG", "jpeg", "png", "PNG"];
/// Meshes as Metashape is asked for them, beside the file.
const MESHES: [&str; 6] = [
    "model.obj",
    "model.ply",
    "model.glb",
    "mesh.obj",
    "mesh.ply",
    "mesh.glb",
];
/// What a term of a lens that is not modelled may move, in pixels. Derived: half a pixel is what
/// resampling blurs.
const NEGLIGIBLE_PIXELS: f64 = 0.5;
/// Beyond this distance from the origin, coordinates are geocentric. Derived: a tenth of the Earth's
/// radius.
const GEOCENTRIC: f64 = 6e5;

type Reading<T> = std::result::Result<T, String>;

/// The importer.
pub struct Metashape;

impl Importer for Metashape {
    fn kind(&self) -> &'static str {
        "metashape"
    }

    fn looks_like(&self) -> &'static str {
        "Metashape: one .xml of exported cameras with the photographs"
    }

    fn locate(&self, path: &Path) -> Result<Located> {
        let expected = "no .xml of Metashape's cameras here, or several; name the file";
        Located::new(path, file_in(path), expected)
    }

    fn read(
        &self,
        located: &Located,
        _options: &PrepareOptions,
        account: &mut Account,
    ) -> Result<Capture> {
        let file = &located.start;
        let fail = |m: String| Error::input(file, m);
        let text = read_input_text(file)?;
        let document = Document::parse(&text)
            .map_err(|e| fail(format!("{e}; expected the XML of exported cameras")))?;
        let chunk = document.descendants().find(|n| n.has_tag_name("chunk"));
        let chunk = chunk.ok_or_else(|| fail("no chunk; export the cameras again".into()))?;
        let folder = located.folder();
        let chunk = Chunk {
            folder,
            sensors: by_id(chunk, "sensors", "sensor"),
            components: by_id(chunk, "components", "component"),
            transform: similarity(chunk).map_err(&fail)?,
            cameras: child(chunk, "cameras"),
        };
        let (mut shots, mut left_out) = (Vec::new(), 0usize);
        let cameras = chunk.cameras.into_iter().flat_map(|c| c.descendants());
        for camera in cameras.filter(|n| n.has_tag_name("camera")) {
            let label = camera.attribute("label").unwrap_or("");
            match chunk.shot(camera, label) {
                Ok(Some(shot)) => shots.push(shot),
                Ok(None) => left_out += 1,
                Err(m) => return Err(fail(format!("camera {label}: {m}"))),
            }
        }
        if shots.is_empty() {
            return Err(fail(
                "holds no aligned camera; align the photographs first".into(),
            ));
        }
        account.read(format!(
            "{}: {} aligned cameras",
            file.display(),
            shots.len()
        ));
        account.converted("poses from axes with y down to axes with y up");
        if left_out > 0 {
            account.ignored(format!(
                "{left_out} cameras that are disabled or not aligned"
            ));
        }
        let mesh = mesh_beside(folder, &MESHES);
        Ok(Capture {
            shots,
            surface: mesh.map(Surface::of_file),
            up: Up::Unknown,
            unit_unknown: !chunk.is_measured(),
            ..Capture::default()
        })
    }
}

/// The first chunk of the file.
struct Chunk<'a> {
    /// Folder of the file.
    folder: &'a Path,
    sensors: BTreeMap<String, Node<'a, 'a>>,
    components: BTreeMap<String, Node<'a, 'a>>,
    /// To the world.
    transform: Option<DMat4>,
    cameras: Option<Node<'a, 'a>>,
}

impl Chunk<'_> {
    /// With a transform, lengths come from markers, scale bars or positions.
    fn is_measured(&self) -> bool {
        let measured = |c: &Node<'_, '_>| child(*c, "transform").is_some();
        self.transform.is_some() || self.components.values().any(measured)
    }

    /// A camera's photograph with its pose; `None` where it is disabled or not aligned.
    fn shot(&self, camera: Node<'_, '_>, label: &str) -> Reading<Option<Shot>> {
        let disabled = matches!(camera.attribute("enabled"), Some("0" | "false"));
        let Some(matrix) = child(camera, "transform").filter(|_| !disabled) else {
            return Ok(None);
        };
        let matrix = <[f64; 16]>::try_from(numbers(matrix)?)
            .map_err(|_| "transform: expected 16 numbers".to_owned())?;
        let component = camera.attribute("component_id");
        let component = component.and_then(|c| self.components.get(c));
        let of_component = component.map(|c| similarity(*c)).transpose()?.flatten();
        let to_world = of_component.or(self.transform).unwrap_or(DMat4::IDENTITY);
        let pose = rigid(to_world * DMat4::from_cols_array(&matrix).transpose());
        if pose.w_axis.truncate().length() > GEOCENTRIC {
            return Err(
                "lies in geocentric coordinates; set the chunk to local coordinates (Reference pane, Settings) and export cameras and model again".into(),
            );
        }
        let sensor = camera.attribute("sensor_id");
        let sensor = sensor.and_then(|s| self.sensors.get(s));
        let (optics, size) = optics(*sensor.ok_or("its sensor is missing")?)?;
        let image = image_at(self.folder, label)
            .ok_or("the photograph was not found; put it beside the file or into images/")?;
        let mut shot = Shot::new(stem_of(label), image, pose, optics);
        shot.size = Some(size);
        Ok(Some(shot))
    }
}

/// The file itself, or the only one of a folder that Metashape wrote.
fn file_in(path: &Path) -> Option<PathBuf> {
    let ours = |p: &Path| {
        let xml = p.extension().is_some_and(|e| e.eq_ignore_ascii_case("xml"));
        xml && std::fs::File::open(p).is_ok_and(|f| {
            use std::io::Read;
            let mut head = String::new();
            let read = f.take(2048).read_to_string(&mut head);
            read.is_ok() && head.contains("<document") && head.contains("<chunk")
        })
    };
    only_of_kind(path, ours)
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|n| n.has_tag_name(name))
}

fn by_id<'a>(chunk: Node<'a, 'a>, list: &str, name: &str) -> BTreeMap<String, Node<'a, 'a>> {
    let all = child(chunk, list).into_iter().flat_map(|l| l.children());
    all.filter(|n| n.has_tag_name(name))
        .filter_map(|n| Some((n.attribute("id")?.to_owned(), n)))
        .collect()
}

fn numbers(node: Node<'_, '_>) -> Reading<Vec<f64>> {
    let all = finite_numbers(node.text().unwrap_or(""));
    all.ok_or_else(|| format!("{}: expected finite numbers", node.tag_name().name()))
}

/// The transform of a chunk or component: rotation by rows, translation, scale.
fn similarity(of: Node<'_, '_>) -> Reading<Option<DMat4>> {
    let Some(transform) = child(of, "transform") else {
        return Ok(None);
    };
    let part = |name: &str| child(transform, name).map_or(Ok(Vec::new()), numbers);
    let (rotation, translation, scale) = (part("rotation")?, part("translation")?, part("scale")?);
    let rotation = match <[f64; 9]>::try_from(rotation) {
        Ok(r) => DMat3::from_cols_array(&r).transpose(),
        Err(none) if none.is_empty() => DMat3::IDENTITY,
        Err(_) => return Err("transform: expected nine numbers of rotation".into()),
    };
    let translation = <[f64; 3]>::try_from(translation).map_or(DVec3::ZERO, DVec3::from_array);
    let scale = scale.first().copied().unwrap_or(1.0);
    if scale <= 0.0 {
        return Err("transform: expected a positive scale".into());
    }
    let mut all = DMat4::from_mat3(rotation * scale);
    all.w_axis = translation.extend(1.0);
    Ok(Some(all))
}

/// Camera-to-world without scale, from axes with y down to axes with y up.
fn rigid(pose: DMat4) -> DMat4 {
    let axis = |i: usize| pose.col(i).truncate().normalize_or_zero().extend(0.0);
    gl_from_cv(DMat4::from_cols(axis(0), axis(1), axis(2), pose.w_axis))
}

/// Projection and size of a sensor.
fn optics(sensor: Node<'_, '_>) -> Reading<(Optics, [usize; 2])> {
    // the adjusted calibration comes last where there are two
    let calibration = sensor.children().rfind(|n| n.has_tag_name("calibration"));
    let of = |n: Node<'_, '_>, key: &str| n.attribute(key).and_then(|t| t.parse::<f64>().ok());
    let resolution = calibration.and_then(|c| child(c, "resolution"));
    let resolution = resolution.or_else(|| child(sensor, "resolution"));
    let sides = resolution.and_then(|r| Some([of(r, "width")?, of(r, "height")?]));
    let sides = sides.filter(|s| s.iter().all(|s| *s >= 1.0));
    let [width, height] = sides.ok_or("its sensor states no resolution")?;
    let size = [width as usize, height as usize];
    let kind = calibration.and_then(|c| c.attribute("type"));
    let kind = kind.or_else(|| sensor.attribute("type")).unwrap_or("frame");
    if matches!(kind, "spherical" | "equirectangular") {
        return Ok((Optics::Panorama, size));
    }
    let calibration =
        calibration.ok_or("its sensor is not calibrated; align the photographs first")?;
    let term = |name: &str| -> Reading<f64> {
        match child(calibration, name) {
            Some(n) => numbers(n)?
                .first()
                .copied()
                .ok_or_else(|| format!("{name}: empty")),
            None => Ok(0.0),
        }
    };
    let f = term("f")?;
    if f <= 0.0 {
        return Err("its calibration has no focal length".into());
    }
    let [k1, k2, k3, k4] = [term("k1")?, term("k2")?, term("k3")?, term("k4")?];
    let [p1, p2, p3, p4] = [term("p1")?, term("p2")?, term("p3")?, term("p4")?];
    let focal = [f + term("b1")?, f];
    let centre = [0.5 * width + term("cx")?, 0.5 * height + term("cy")?];
    // what the corner moves by terms that no lens here has
    let corner = 0.5 * width.hypot(height) / f;
    let shear = term("b2")?.abs() * 0.5 * height / f;
    let decentring = (p1.hypot(p2) * 3.0 * corner.powi(2))
        * (p3.abs() + p4.abs() * corner.powi(2))
        * corner.powi(2)
        * f;
    let distortion = match kind {
        "frame" => Distortion::Rational([k1, k2, p2, p1, k3, 0.0, 0.0, 0.0]),
        "fisheye" | "equidistant_fisheye" => {
            Distortion::ThinPrismFisheye([k1, k2, p2, p1, k3, k4, 0.0, 0.0])
        }
        other => {
            return Err(format!(
                "its projection {other} is not known here (known: frame, fisheye, spherical); export undistorted photographs (File > Export > Undistort Photos)"
            ));
        }
    };
    let eighth = if kind == "frame" {
        k4.abs() * corner.powi(9) * f
    } else {
        0.0
    };
    if shear.max(decentring).max(eighth) > NEGLIGIBLE_PIXELS {
        return Err(
            "its b2, p3, p4 or k4 move pixels by more than half a one, and no lens here has them; optimise the cameras without them, or export undistorted photographs".into(),
        );
    }
    Ok((
        Optics::Distorted(Lens {
            distortion,
            focal,
            centre,
        }),
        size,
    ))
}

/// Labels are names of files, mostly without their ending.
fn image_at(folder: &Path, label: &str) -> Option<PathBuf> {
    let places = || IMAGES.iter().map(|p| folder.join(p));
    let with = |e: &&str| photograph_named(places(), &format!("{label}.{e}"));
    photograph_named(places(), label)
        .filter(|_| !label.is_empty())
        .or_else(|| ENDINGS.iter().find_map(with))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHUNK: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0"><chunk label="Chunk 1" enabled="true">
  <sensors next_id="2">
    <sensor id="0" label="frame" type="frame"><resolution width="400" height="300"/>
      <calibration type="frame" class="adjusted"><resolution width="400" height="300"/>
        <f>200</f><cx>2</cx><cy>-3</cy><k1>0.1</k1><p1>0.001</p1><p2>0.002</p2>EXTRA</calibration></sensor>
    <sensor id="1" label="theta" type="spherical"><resolution width="200" height="100"/></sensor>
  </sensors>
  <components next_id="1"><component id="0"><transform>
    <rotation>1 0 0 0 0 -1 0 1 0</rotation><translation>10 20 30</translation><scale>2</scale>
  </transform></component></components>
  <cameras next_id="3">
    <camera id="0" sensor_id="0" component_id="0" label="a"><transform>1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</transform></camera>
    <group id="0"><camera id="1" sensor_id="1" component_id="0" label="p.jpg"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera></group>
    <camera id="2" sensor_id="0" label="b"/>
  </cameras></chunk></document>"#;

    fn read(text: &str) -> (Result<Capture>, Account) {
        let dir = tempfile::tempdir().expect("temp");
        std::fs::create_dir(dir.path().join("images")).expect("folder");
        for name in ["a.JPG", "p.jpg"] {
            std::fs::write(dir.path().join("images").join(name), "").expect("image");
        }
        std::fs::write(dir.path().join("cameras.xml"), text).expect("file");
        let mut account = Account::default();
        let capture = Metashape.import(dir.path(), &PrepareOptions::default(), &mut account);
        (capture, account)
    }

    #[test]
    fn cameras_go_through_the_transform_of_their_component() {
        let (capture, account) = read(&CHUNK.replace("EXTRA", ""));
        let capture = capture.expect("reads");
        let [a, p] = capture.shots.as_slice() else {
            panic!("two aligned cameras")
        };
        // rows of the rotation: x stays, y is −z, z is y; then twice as large, then moved
        let place = a.world_from_camera.w_axis.truncate();
        assert_eq!(place, DVec3::new(12.0, 20.0 - 6.0, 30.0 + 4.0));
        let [x, y, z] = [0, 1, 2].map(|i| a.world_from_camera.col(i).truncate());
        assert_eq!((x, y, z), (DVec3::X, DVec3::NEG_Z, DVec3::Y));
        let Optics::Distorted(lens) = &a.optics else {
            panic!("{:?}", a.optics)
        };
        assert_eq!((lens.focal, lens.centre), ([200.0; 2], [202.0, 147.0]));
        let brown = Distortion::Rational([0.1, 0.0, 0.002, 0.001, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(lens.distortion, brown, "p1 and p2 change places");
        assert_eq!((&p.optics, p.size), (&Optics::Panorama, Some([200, 100])));
        assert!(!capture.unit_unknown);
        assert!(account.ignored.iter().any(|l| l.starts_with("1 cameras")));
    }

    #[test]
    fn what_no_lens_here_has_and_the_whole_earth_are_refused() {
        let refused = |from: &str, to: &str| {
            let (capture, _) = read(&CHUNK.replace(from, to));
            capture.expect_err("must be refused").to_string()
        };
        assert!(refused("EXTRA", "<b2>40</b2>").contains("b2"));
        assert!(refused("EXTRA", "<k4>0.5</k4>").contains("k4"));
        assert!(refused("<f>200</f>", "<f>nan</f>").contains("finite"));
        assert!(refused("10 20 30", "4e6 1e6 4e6").contains("geocentric"));
        assert!(refused("label=\"a\"", "label=\"c\"").contains("not found"));
        let (none, _) = read("<document><chunk/></document>");
        assert!(
            none.expect_err("empty")
                .to_string()
                .contains("no aligned camera")
        );
    }

    #[test]
    fn small_terms_are_left_out() {
        let (capture, _) = read(&CHUNK.replace("EXTRA", "<b2>0.1</b2><k4>1e-4</k4>"));
        assert!(capture.is_ok());
    }
}
