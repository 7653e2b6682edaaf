//! Evaluation against closed forms: a renderer whose errors are known exactly.

use super::*;
use crate::core::formats::{read_rgb, write_png16};
use crate::core::geometry::{Camera, Mesh, Projection};
use crate::scene::Class;
use glam::{DVec3, Mat3, Vec3};

const W: usize = 64;
const H: usize = 32;

/// Constant images with known offsets from the scene below.
struct Constant {
    radiance: f32,
    albedo: f32,
    roughness: f32,
}

impl ViewRenderer for Constant {
    fn render(&self, camera: &Camera) -> Result<RenderedView> {
        let (w, h) = (camera.width, camera.height);
        Ok(RenderedView {
            radiance: Plane::filled(w, h, Vec3::splat(self.radiance)),
            albedo: Plane::filled(w, h, Vec3::splat(self.albedo)),
            roughness: Plane::filled(w, h, self.roughness),
            metallic: Plane::filled(w, h, 0.0),
            transmission: Plane::filled(w, h, 0.0),
            labels: Plane::filled(w, h, 1),
            emission: Plane::filled(w, h, Vec3::ZERO),
            confidence: Plane::filled(w, h, glam::Vec2::splat(0.1)),
        })
    }

    /// Twice the photographs' working radiance, half a row of it black: a ceiling below 100 dB.
    fn reproject(&self, camera: &Camera) -> Result<Option<RgbPlane>> {
        let mut image = Plane::filled(camera.width, camera.height, Vec3::ONE);
        image.data[..W / 2].fill(Vec3::ZERO);
        Ok(Some(image))
    }
}

/// Photographs of radiance 0.25; true albedo 0.5 and roughness 0.1 in the left half (class 1); a
/// lamp (class 2) in the third quarter and nothing (label 0) in the last, where the truth is absurd
/// on purpose.
fn scene(folder: &Path, views: &[(&str, Split)]) -> Scene {
    for sub in ["gt/albedo", "gt/roughness"] {
        std::fs::create_dir_all(folder.join(sub)).expect("folder");
    }
    let label = |x: usize| {
        if x < W / 2 {
            1
        } else if x < 3 * W / 4 {
            2
        } else {
            0
        }
    };
    let labels = Plane {
        width: W,
        height: H,
        data: (0..W * H).map(|i| label(i % W)).collect(),
    };
    write_png16(folder.join("labels.png"), &labels).expect("labels");
    let views = views
        .iter()
        .map(|(stem, split)| {
            let image_path = folder.join(format!("{stem}.exr"));
            write_rgb_half(&image_path, &Plane::filled(W, H, Vec3::splat(0.25))).expect("image");
            let albedo = labels.map(|l| Vec3::splat(if *l == 1 { 0.5 } else { 0.9 }));
            write_rgb_half(folder.join(format!("gt/albedo/{stem}.exr")), &albedo).expect("albedo");
            let roughness = labels.map(|l| if *l == 1 { 0.125 } else { 1.0 });
            write_plane_half(folder.join(format!("gt/roughness/{stem}.exr")), &roughness)
                .expect("roughness");
            View {
                stem: (*stem).into(),
                camera: Camera {
                    projection: Projection::Equirectangular,
                    width: W,
                    height: H,
                    world_from_camera: Mat3::IDENTITY,
                    position: Vec3::ZERO,
                },
                image_path,
                label_path: Some(folder.join("labels.png")),
                mask_path: None,
                exposure_ev: 1.0,
                split: *split,
                colour_space: None,
                account: Default::default(),
            }
        })
        .collect();
    let classes = vec![
        Class {
            id: 1,
            name: "wall".into(),
            is_light: false,
        },
        Class {
            id: 2,
            name: "lamp".into(),
            is_light: true,
        },
    ];
    Scene::from_parts(folder.into(), DVec3::ZERO, Mesh::default(), classes, views)
}

fn run(
    scene: &Scene,
    renderer: &Constant,
    options: &EvalOptions,
    out: Option<&Path>,
) -> Evaluation {
    evaluate(
        scene,
        renderer,
        options,
        out,
        &Progress::silent(),
        &mut |_| {},
    )
    .expect("evaluates")
}

#[test]
fn every_figure_has_its_closed_form() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = scene(folder.path(), &[("a", Split::Test), ("b", Split::Train)]);
    let renderer = Constant {
        radiance: 0.4,
        albedo: 0.4,
        roughness: 0.325,
    };
    let e = run(&scene, &renderer, &EvalOptions::default(), None);
    assert!(e.train.is_none(), "training views only on request");
    let test = e.test.expect("held-out");
    // photograph 0.25 · 2^1 = 0.5
    let mse = (0.5f64.powf(1.0 / 2.2) - 0.4f64.powf(1.0 / 2.2)).powi(2);
    assert!((test.rendering.mse - mse).abs() < 1e-6);
    assert!((test.rendering.psnr_of_mean_mse - psnr(mse)).abs() < 1e-3);
    let m = test.materials.expect("truth");
    assert!(
        (m.albedo.linear.psnr_of_mean_mse - 20.0).abs() < 0.01,
        "lamp and void are left out"
    );
    assert!((m.albedo.fipt.psnr_of_mean_mse - 20.0).abs() < 0.01);
    assert!(
        m.albedo.texir.psnr_of_mean_mse > 60.0,
        "one scale explains a constant factor"
    );
    assert!((test.views[0].albedo_scale.expect("scale") - 1.25).abs() < 1e-3);
    assert!((m.roughness.linear.mean_psnr - psnr(0.04)).abs() < 0.01);
    // FIPT clamps the truth 0.125 to 0.2
    assert!((m.roughness.fipt.mean_psnr - psnr(0.125 * 0.125)).abs() < 0.01);
    assert!((m.roughness_median_absolute_error - 0.2).abs() < 1e-3);
    assert_eq!(m.classes.len(), 1);
    let wall = &m.classes[0];
    assert_eq!(
        (wall.name.as_str(), wall.pixels),
        ("wall", (W * H / 2) as u64)
    );
    assert!((wall.roughness_bias - 0.2).abs() < 1e-3 && (wall.albedo_bias[0] + 0.1).abs() < 1e-3);
}

#[test]
fn files_appear_and_the_json_reads_back() {
    let folder = tempfile::tempdir().expect("temp");
    let out = folder.path().join("out");
    let scene = scene(folder.path(), &[("a", Split::Test), ("b", Split::Train)]);
    let renderer = Constant {
        radiance: 0.5,
        albedo: 0.5,
        roughness: 0.125,
    };
    let e = run(
        &scene,
        &renderer,
        &EvalOptions {
            train: true,
            ..EvalOptions::default()
        },
        Some(&out),
    );
    let mut names: Vec<_> = std::fs::read_dir(out.join("eval"))
        .expect("lists")
        .map(|e| e.expect("entry").file_name())
        .collect();
    names.sort();
    let expected = [
        "a.albedo.exr",
        "a.render.exr",
        "a.roughness.exr",
        "b.albedo.exr",
        "b.render.exr",
        "b.roughness.exr",
        "metrics.json",
    ];
    assert_eq!(names, expected);
    let json = std::fs::read_to_string(out.join("eval/metrics.json")).expect("reads");
    assert_eq!(
        serde_json::from_str::<Evaluation>(&json).expect("parses"),
        e
    );
    let render = read_rgb(out.join("eval/a.render.exr")).expect("reads");
    assert_eq!(
        (render.width, render.height, render.data[5]),
        (W, H, Vec3::splat(0.5))
    );
    let perfect = e
        .train
        .as_ref()
        .expect("train")
        .materials
        .as_ref()
        .expect("truth")
        .albedo
        .linear
        .mean_psnr;
    assert!(
        (perfect - 100.0).abs() < 1e-9,
        "a perfect reconstruction scores the maximum: {perfect}"
    );
    let table = terminal_table(&e);
    assert!(
        table.contains("Held-out views (1 image)")
            && table.contains("Training views")
            && table.contains("wall")
    );
    assert!(table.lines().all(|l| l.chars().count() <= 100), "{table}");
}

#[test]
fn a_gain_per_view_and_the_ceiling_have_their_closed_forms() {
    let folder = tempfile::tempdir().expect("temp");
    let mut scene = scene(folder.path(), &[("a", Split::Test), ("b", Split::Test)]);
    // two photographs of the same place, one two stops brighter
    scene.views[1].exposure_ev = -1.0;
    let renderer = Constant {
        radiance: 0.25,
        albedo: 0.5,
        roughness: 0.125,
    };
    let e = run(&scene, &renderer, &EvalOptions::default(), None);
    let test = e.test.expect("held-out");
    let novel = e.novel_views.expect("held-out");
    assert_eq!(novel, test.gains);
    let gains: Vec<f64> = test.views.iter().map(|v| v.gain).collect();
    assert!(
        (gains[0] - 2.0).abs() < 1e-3 && (gains[1] - 0.5).abs() < 1e-3,
        "{gains:?}"
    );
    let error = |x: f64| (x.powf(1.0 / 2.2) - 0.25f64.powf(1.0 / 2.2)).powi(2);
    let mse = 0.5 * (error(0.5) + error(0.125));
    assert!((novel.mse / mse - 1.0).abs() < 1e-3 && (novel.psnr - psnr(mse)).abs() < 1e-2);
    assert!(novel.psnr_gain_per_view > 60.0 && novel.psnr_gain_per_channel > 60.0);
    // with its own gain all of the ceiling fits but the black half row
    let missing = (W / 2) as f64 / (W * H) as f64;
    let black = 0.5 * missing * (0.5f64.powf(2.0 / 2.2) + 0.125f64.powf(2.0 / 2.2));
    let ceiling = novel.ceiling_reprojected_psnr.expect("re-projected");
    assert!(
        (ceiling - psnr(black)).abs() < 0.01,
        "{ceiling} {}",
        psnr(black)
    );
    assert!(novel.ceiling_reprojected_psnr_as_is.expect("re-projected") < ceiling);
}

#[test]
fn without_held_out_views_training_views_are_scored_and_without_truth_only_images() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = scene(folder.path(), &[("a", Split::Train)]);
    std::fs::remove_dir_all(folder.path().join("gt")).expect("removes");
    let e = run(
        &scene,
        &Constant {
            radiance: 0.5,
            albedo: 0.0,
            roughness: 0.0,
        },
        &EvalOptions::default(),
        None,
    );
    assert!(e.test.is_none());
    assert!(e.train.expect("train").materials.is_none());
}

#[test]
fn a_nan_rendering_scores_as_the_largest_error_and_is_counted() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = scene(folder.path(), &[("a", Split::Test)]);
    let e = run(
        &scene,
        &Constant {
            radiance: f32::NAN,
            albedo: 0.5,
            roughness: 0.125,
        },
        &EvalOptions::default(),
        None,
    );
    let test = e.test.expect("test");
    assert!((test.rendering.mse - 1.0).abs() < 1e-12);
    assert_eq!(test.views[0].nonfinite_pixels, W * H);
}

/// Pixels truly of a kind, stated to be, and the shares found and wrong.
type Found = (u64, u64, f64, f64);

#[test]
fn metals_are_scored_where_the_truth_knows_them() {
    let found = |s: &SplitScores| -> Option<Found> {
        let m = s.metals.as_ref()?;
        Some((m.true_pixels, m.stated_pixels, m.found, m.wrong))
    };
    scored_where_the_truth_knows("metals", "metallic", found);
}

#[test]
fn panes_are_scored_where_the_truth_knows_them() {
    let found = |s: &SplitScores| -> Option<Found> {
        let p = s.panes.as_ref()?;
        Some((p.true_pixels, p.stated_pixels, p.found, p.wrong))
    };
    scored_where_the_truth_knows("panes", "transmission", found);
}

fn scored_where_the_truth_knows(
    kind: &str,
    truth: &str,
    found: impl Fn(&SplitScores) -> Option<Found>,
) {
    let folder = tempfile::tempdir().expect("temp");
    let scene = scene(folder.path(), &[("a", Split::Test)]);
    let renderer = Constant {
        radiance: 0.5,
        albedo: 0.5,
        roughness: 0.125,
    };
    let options = EvalOptions::default();
    let score = || run(&scene, &renderer, &options, None);
    let e = score();
    let json = serde_json::to_string(&e).expect("JSON");
    assert!(!json.contains(kind) && !terminal_table(&e).contains(kind));
    let path = folder.path().join("gt").join(truth).join("a.exr");
    std::fs::create_dir_all(path.parent().expect("folder")).expect("folder");
    // the scored half is of the kind, and nothing is said to be
    write_plane_half(&path, &Plane::filled(W, H, 1.0)).expect("truth");
    let e = score();
    let scores = e.test.as_ref().and_then(found).expect("scored");
    assert_eq!(scores, ((W * H / 2) as u64, 0, 0.0, 0.0));
    assert!(terminal_table(&e).contains("found 0.0 % of 1024 pixels"));
    assert!(
        e.protocols
            .iter()
            .any(|p| p.starts_with(&format!("{kind}:")))
    );
    write_plane_half(&path, &Plane::filled(8, 4, 1.0)).expect("truth");
    let view = &scene.views[0];
    let error = true_materials(&scene, view).expect_err("of another size");
    assert!(error.to_string().contains("8×4"), "{error}");
}

#[test]
fn ground_truth_of_another_size_is_refused() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = scene(folder.path(), &[("a", Split::Test)]);
    write_rgb_half(
        folder.path().join("gt/albedo/a.exr"),
        &Plane::filled(8, 4, Vec3::ONE),
    )
    .expect("writes");
    let renderer = Constant {
        radiance: 0.5,
        albedo: 0.5,
        roughness: 0.125,
    };
    let refused = |options: &EvalOptions| {
        let silent = Progress::silent();
        let error = evaluate(&scene, &renderer, options, None, &silent, &mut |_| {});
        let error = error.expect_err("refuses");
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    let error = refused(&EvalOptions::default());
    assert!(error.contains("8×4"), "{error}");
    for exposure in [f32::NAN, f32::INFINITY, -200.0] {
        let error = refused(&EvalOptions {
            exposure,
            ..EvalOptions::default()
        });
        assert!(error.contains("--exposure"), "{error}");
    }
    let error = refused(&EvalOptions {
        views: Some(0),
        ..EvalOptions::default()
    });
    assert!(error.contains("--views"), "{error}");
    let error = refused(&EvalOptions {
        supersampling: Some(0),
        ..EvalOptions::default()
    });
    assert!(error.contains("--supersampling"), "{error}");
}

#[test]
fn fewer_views_are_spread_evenly_over_the_held_out_ones() {
    let folder = tempfile::tempdir().expect("temp");
    let all = ["a", "b", "c", "d", "e", "f", "g"];
    let mut named: Vec<(&str, Split)> = all.iter().map(|n| (*n, Split::Test)).collect();
    named.insert(2, ("x", Split::Train));
    let scene = scene(folder.path(), &named);
    let of = |views| {
        let options = EvalOptions {
            views: Some(views),
            ..EvalOptions::default()
        };
        let scored = scored_views(&scene, &options, &Progress::silent()).expect("has views");
        scored.iter().map(|v| v.stem.clone()).collect::<Vec<_>>()
    };
    assert_eq!(of(1), ["a"]);
    assert_eq!(of(3), ["a", "d", "f"]);
    assert_eq!(of(9), all);
}
