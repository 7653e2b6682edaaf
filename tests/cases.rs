//! The small cases of `../shared/cases`: inputs that people really have, each with the right
//! outcome. Skipped, with a message, where the folder is absent.

mod shared;

use shared::shared;
use unbake::scene::{CheckReport, LoadOptions, check};

/// What must come out of a case.
enum Outcome {
    /// The plain scene's figures: 12 triangles, 94.0 m², median 0.386, largest 12, no hole.
    Plain,
    /// Usable, with these triangles and area, and the plain scene's radiance.
    Mesh(usize, f64),
    /// Usable, with this in a warning.
    Warned(&'static str),
    /// Refused, with this in a problem.
    Refused(&'static str),
    /// Seen by the test of alignment, which `scene::check` has not: see [`ALIGNED`].
    Elsewhere,
}

use Outcome::{Elsewhere, Mesh, Plain, Refused, Warned};

/// Folder and outcome.
const CASES: &[(&str, Outcome)] = &[
    ("fc01-hdr-exposure", Plain),
    ("fc03-exr-rec2020", Plain),
    ("fc05-exr-alpha-nadir", Warned("alpha does not cover")),
    ("fc06-exr-multipart", Plain),
    ("fc09-exr-luminance-chroma", Plain),
    ("fc10-obj-polyline", Plain),
    ("fc11-obj-concave-ngon", Mesh(16, 100.0)),
    ("fc13-obj-bom", Plain),
    ("fc14-gltf-gpu-instancing", Mesh(20, 95.0)),
    ("fc16-obj-latin1", Plain),
    ("fc17-obj-continuation", Plain),
    (
        "fc20-obj-decimal-comma",
        Refused("is no number (decimal comma?)"),
    ),
    ("fc21-ply-tristrips", Plain),
    ("fc23-ply-wedge-uv", Plain),
    ("fc24-double-faces", Mesh(3888, 94.0)),
    ("fc26-mirrored-panoramas", Elsewhere),
    ("fc29-mesh-in-millimetres", Elsewhere),
    ("fc30-applied-transform", Plain),
    ("fc32-zup-poses-yup-glb", Plain),
    ("fc33-kind-Light", Plain),
    ("fc35-mask-all-zero", Refused("leaves no pixel")),
    ("fc36-mask-rgb", Plain),
    ("fc38-backslash-paths", Plain),
    ("fc40-camera-angle-no-size", Elsewhere),
    (
        "fc42-inf-lamps",
        Warned("infinite pixels lie on classes of kind light"),
    ),
    ("fc44-material-atlases", Warned("one atlas per material?")),
    ("fc45-hdr-xyze", Plain),
    ("fc47-is-fisheye", Refused("is_fisheye")),
    ("fc49-exr-htj2k", Refused("HTJ2K")),
    ("fc50-jpeg-exif-orientation", Warned("EXIF orientation 3")),
    ("fc52-check-after-failed-images", Refused("NaN or infinite")),
    ("fc53-outward-windings", Elsewhere),
    ("fc56-ground-plane", Warned("remove ground planes")),
];

/// What the whole program must say of the cases whose fault lies in how photographs and mesh belong
/// together: the refusal, or nothing where there is none.
const ALIGNED: &[(&str, &str)] = &[
    (
        "fc26-mirrored-panoramas",
        "panoramas mirrored left to right, labels not",
    ),
    ("fc29-mesh-in-millimetres", "mesh in millimetres"),
    // its pictures are panoramas that stand in for a pinhole camera's: no correction is offered
    (
        "fc40-camera-angle-no-size",
        "none of the usual mistakes explains it",
    ),
    ("fc50-jpeg-exif-orientation", "upside down, labels not"),
    ("fc53-outward-windings", ""),
];

/// `unbake check` on a folder of the cases: exit code, and what it says.
fn checked(folder: &std::path::Path, options: &[&str]) -> (Option<i32>, String) {
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_unbake"))
        .arg("check")
        .arg(folder)
        .args(options)
        .output()
        .expect("the program runs");
    (
        run.status.code(),
        String::from_utf8_lossy(&run.stdout).into_owned(),
    )
}

#[test]
fn the_program_ends_every_case_as_it_must() {
    let Some(folder) = shared("cases") else {
        return;
    };
    for (name, outcome) in CASES {
        let options: &[&str] = match *name {
            "fc42-inf-lamps" => &["--clamp-nan"],
            _ => &[],
        };
        let (code, said) = checked(&folder.join(name), options);
        let expected = ALIGNED.iter().find(|a| a.0 == *name).map(|a| a.1);
        let refusal = match (outcome, expected) {
            (_, Some(text)) => text,
            (Refused(text), None) => text,
            _ => "",
        };
        if refusal.is_empty() {
            // OpenImageIO from 2.5 on does not read luminance and chroma
            let chroma = *name == "fc09-exr-luminance-chroma";
            assert!(code == Some(0) || chroma, "{name}: {said}");
        } else {
            assert!(code == Some(2) && said.contains(refusal), "{name}: {said}");
        }
    }
}

#[test]
fn a_correction_that_leads_to_no_fit_is_not_applied() {
    let Some(folder) = shared("cases") else {
        return;
    };
    let path = folder.join("fc40-camera-angle-no-size");
    let (code, said) = checked(&path, &["--fix-alignment"]);
    assert!(code == Some(2) && !said.contains("corrected by"), "{said}");
}

/// 64 columns and an angle of view of 1.57: 32 / tan(0.785) pixels.
#[test]
fn an_angle_of_view_without_a_size_takes_the_images_own() {
    use unbake::core::geometry::Projection;
    let Some(folder) = shared("cases") else {
        return;
    };
    let path = folder.join("fc40-camera-angle-no-size");
    let scene = unbake::scene::Scene::load(path, &LoadOptions::default()).expect("loads");
    let Projection::Pinhole(lens) = scene.views[0].camera.projection else {
        panic!("a pinhole camera")
    };
    assert!(
        (lens.fl_x - 32.0 / 0.785f32.tan()).abs() < 0.05,
        "{}",
        lens.fl_x
    );
}

#[track_caller]
fn plain_figures(name: &str, report: &CheckReport, (triangles, area): (usize, f64)) {
    assert!(report.is_usable(), "{name}: {report}");
    let s = report.summary.as_ref().expect("understood");
    assert_eq!(s.mesh.triangles, triangles, "{name}");
    assert!(
        (s.mesh.area - area).abs() < 0.01 * area,
        "{name}: {} m²",
        s.mesh.area
    );
    // RGBE keeps 8 bits
    let near = |found: f32, right: f32| (found / right - 1.0).abs() < 0.01;
    assert!(
        near(s.radiance.median, 0.386),
        "{name}: median {}",
        s.radiance.median
    );
    assert!(near(s.radiance.max, 12.0), "{name}: max {}", s.radiance.max);
    assert!(s.hole_share < 1e-3, "{name}: holes {}", s.hole_share);
}

#[test]
fn every_case_has_its_outcome() {
    let Some(folder) = shared("cases") else {
        return;
    };
    for (name, outcome) in CASES {
        let path = folder.join(name);
        if !path.is_dir() {
            eprintln!("skipped: no {}", path.display());
            continue;
        }
        let options = LoadOptions {
            clamp_nan: *name == "fc42-inf-lamps",
            unwrap_resolution: 256,
            ..LoadOptions::default()
        };
        let report = check(&path, &options);
        // OpenImageIO from 2.5 on (Debian 13) wants halved chroma: refused by name there
        let decoded = unbake::core::formats::version().starts_with("2.4");
        let outcome = match *name {
            "fc09-exr-luminance-chroma" if !decoded => &Refused("luminance-chroma"),
            _ => outcome,
        };
        match outcome {
            Plain => plain_figures(name, &report, (12, 94.0)),
            Mesh(triangles, area) => plain_figures(name, &report, (*triangles, *area)),
            Warned(said) => {
                let all = report.warnings.join("\n");
                assert!(report.is_usable() && all.contains(said), "{name}: {report}");
            }
            Refused(said) => {
                let all = report.problems.join("\n");
                assert!(
                    report.exit_code() == 2 && all.contains(said),
                    "{name}: {report}"
                );
            }
            Elsewhere => {}
        }
    }
}

#[test]
fn after_images_that_failed_nothing_is_concluded_from_them() {
    let Some(folder) = shared("cases") else {
        return;
    };
    let report = check(
        folder.join("fc52-check-after-failed-images"),
        &LoadOptions::default(),
    );
    assert_eq!(report.problems.len(), 3, "{report}");
    let text = report.to_string();
    assert!(
        text.contains("unknown (3 views could not be read)"),
        "{text}"
    );
    assert!(
        !report.warnings.iter().any(|w| w.contains("label")),
        "{report}"
    );
}

#[test]
fn an_atlas_by_corner_is_used() {
    let Some(folder) = shared("cases") else {
        return;
    };
    let report = check(folder.join("fc23-ply-wedge-uv"), &LoadOptions::default());
    let summary = report.summary.expect("understood");
    assert!(summary.mesh.details.unwrapped.is_none());
}

#[test]
fn images_that_made_the_library_abort_are_refused() {
    let Some(folder) = shared("cases") else {
        return;
    };
    for name in ["exr-abort.exr", "exr-abort-two-bytes.exr"] {
        let path = folder.join("rel01-exr-abort").join(name);
        let e = unbake::core::formats::read_photograph(&path, None)
            .err()
            .expect("refused");
        assert!(
            e.exit_code() == 2 && e.to_string().contains("damaged"),
            "{e}"
        );
    }
}

/// The colours of fc03: floor 0.2, 0.2, 0.22, left wall 0.45, 0.3, 0.2 in linear Rec. 709.
#[test]
fn wide_primaries_become_rec709() {
    let Some(folder) = shared("cases") else {
        return;
    };
    let path = folder.join("fc03-exr-rec2020/0.exr");
    let image = unbake::core::formats::read_photograph(&path, None)
        .expect("read")
        .pixels;
    let has = |rgb: [f32; 3]| {
        let wanted = glam::Vec3::from_array(rgb);
        image
            .data
            .iter()
            .any(|p| (*p / wanted - 1.0).abs().max_element() < 0.02)
    };
    assert!(has([0.2, 0.2, 0.22]) && has([0.45, 0.3, 0.2]));
}
