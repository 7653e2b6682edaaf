//! The whole reconstruction on a small synthetic apartment, as it is and bent out of shape.

mod common;

use common::apartment::{SIDE, small_textures, write_apartment};
use glam::{DVec3, Vec3};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use unbake::Error;
use unbake::core::formats;
use unbake::core::image::Plane;
use unbake::core::progress::Progress;
use unbake::core::sampling::KeyedRng;
use unbake::irradiance::Estimator;
use unbake::pipeline::{
    Checkpoints, Fit, SolveOptions, Solved, observe, reconstruct, reconstruct_light,
};
use unbake::published::{PublishedOptions, PublishedStrategy, PublishedValues};
use unbake::scene::{LoadOptions, Scene, Split};
use unbake::solution::{SaveOptions, Solution};

/// The apartment, made once per run of this file's tests.
fn apartment() -> &'static Path {
    static SCENE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    &SCENE
        .get_or_init(|| {
            let dir = tempfile::tempdir().expect("temporary folder");
            let folder = dir.path().join("scene");
            write_apartment(&folder);
            (dir, folder)
        })
        .1
}

fn load() -> Scene {
    Scene::load(apartment(), &LoadOptions::default()).expect("usable")
}

/// Reconstructs and checks what must hold whatever the scene is.
fn solve(scene: &Scene) -> Solved {
    let solved = reconstruct(scene, &small_textures(), &Progress::silent()).expect("reconstructs");
    sane(&solved.solution);
    solved
}

fn sane(s: &Solution) {
    for (name, plane) in [
        ("albedo", &s.albedo),
        ("irradiance", &s.irradiance),
        ("radiance", &s.radiance),
        ("emission", &s.emission),
        ("environment", &s.environment),
    ] {
        assert!(
            plane
                .data
                .iter()
                .all(|v| v.is_finite() && v.min_element() >= 0.0),
            "{name} is finite and not negative"
        );
    }
    assert!(
        s.albedo.data.iter().all(|v| v.max_element() <= 1.0),
        "albedo above 1"
    );
    assert!(
        s.roughness.data.iter().all(|r| (0.01..=1.0).contains(r)),
        "roughness in its range"
    );
    assert!(s.metallic.is_none(), "no apartment here has metal");
    assert!(s.transmission.is_none(), "nor glass");
    assert!(
        s.confidence
            .data
            .iter()
            .all(|c| c.is_finite() && c.min_element() >= 0.0)
    );
    let dir = tempfile::tempdir().expect("temporary folder");
    s.save(dir.path(), &SaveOptions::default())
        .expect("can be written");
}

fn on_threads<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("pool")
        .install(f)
}

/// The reconstruction of the apartment as it is.
fn reference() -> &'static Solved {
    static SOLVED: OnceLock<Solved> = OnceLock::new();
    SOLVED.get_or_init(|| on_threads(3, || solve(&load())))
}

/// Median of |a − b| over observed texels, and the share of texels off by more than 0.02.
fn albedo_difference(a: &Solution, b: &Solution) -> (f32, f32) {
    let mut d: Vec<f32> = (0..a.albedo.data.len())
        .filter(|&i| a.confidence.data[i].x < 1e3 && b.confidence.data[i].x < 1e3)
        .map(|i| (a.albedo.data[i] - b.albedo.data[i]).abs().max_element())
        .collect();
    assert!(d.len() > 5_000, "{} texels observed in both", d.len());
    d.sort_by(f32::total_cmp);
    (
        d[d.len() / 2],
        d.iter().filter(|x| **x > 0.02).count() as f32 / d.len() as f32,
    )
}

fn roughness_difference(a: &Solution, b: &Solution) -> f32 {
    let d: f32 = a
        .roughness
        .data
        .iter()
        .zip(&b.roughness.data)
        .map(|(x, y)| (x - y).abs())
        .sum();
    d / a.roughness.data.len() as f32
}

/// Share of the texels whose roughness changes by more than 0.3: those of a class that is divided
/// in one solution and not in the other.
fn roughness_jumps(a: &Solution, b: &Solution) -> f32 {
    let both = a.roughness.data.iter().zip(&b.roughness.data);
    both.filter(|(x, y)| (*x - *y).abs() > 0.3).count() as f32 / a.roughness.data.len() as f32
}

/// A decision that hangs on rounding is no decision: photographs and poses changed by a millionth
/// change the materials by little, and no class by a lot.
#[test]
fn a_millionth_changes_little() {
    let mut scene = load();
    for (i, view) in scene.views.iter_mut().enumerate() {
        let by = if i % 2 == 0 { 1e-6 } else { -1e-6 };
        view.exposure_ev += by;
        view.camera.position += Vec3::splat(by);
    }
    let (a, b) = (&reference().solution, solve(&scene).solution);
    let (median, share) = albedo_difference(a, &b);
    let (jumps, mean) = (roughness_jumps(a, &b), roughness_difference(a, &b));
    println!("albedo {median}, {share} beyond 0.02; roughness {mean}, {jumps} beyond 0.3");
    assert!(a.albedo.data != b.albedo.data, "the change arrives");
    assert!(median < 5e-4 && share < 0.01, "albedo {median}, {share}");
    assert!(mean < 5e-3 && jumps < 2e-3, "roughness {mean}, {jumps}");
}

#[test]
fn materials_are_near_the_truth() {
    let s = &reference().solution;
    let truth = formats::read_rgb(apartment().join("gt/albedo_texture.exr")).expect("truth");
    let quantiles = |stated: f32| {
        let mut errors: Vec<f32> = (0..truth.data.len())
            .filter(|&i| {
                s.confidence.data[i].x < stated
                    && s.emission.data[i] == Vec3::ZERO
                    && truth.data[i] != Vec3::ZERO
            })
            .map(|i| (s.albedo.data[i] - truth.data[i]).abs().max_element())
            .collect();
        errors.sort_by(f32::total_cmp);
        let (n, median, tail) = (
            errors.len(),
            errors[errors.len() / 2],
            errors[errors.len() * 9 / 10],
        );
        println!("stated below {stated}: {n} texels, median {median:.3}, 90 % {tail:.3}");
        (n, median, tail)
    };
    // who says to be sure must be right; at 6 cm per texel most texels near edges mix two paints
    // and must say so
    let (n, median, tail) = quantiles(0.05);
    assert!(
        n > 3_000 && median < 0.06 && tail < 0.2,
        "{n} texels are certain, median error {median:.3}, 90 % below {tail:.3}"
    );
    let (n, median, tail) = quantiles(0.25);
    assert!(
        n > 8_000 && median < 0.18 && tail < 0.5,
        "{n} texels, median error {median:.3}, 90 % below {tail:.3}"
    );
    // the floor shows highlights, the wall hardly any: true values 0.28 and 0.75
    for (label, truth, bound) in [(3u16, 0.28f32, 0.12f32), (1, 0.75, 0.35)] {
        let r: Vec<f32> = s
            .labels
            .data
            .iter()
            .enumerate()
            .filter(|(_, l)| **l == label)
            .map(|(i, _)| s.roughness.data[i])
            .collect();
        let mean = r.iter().sum::<f32>() / r.len() as f32;
        println!("class {label}: {mean:.3}");
        assert!(
            (mean - truth).abs() < bound,
            "class {label}: roughness {mean:.3} against {truth}"
        );
    }
    assert!(
        s.emission.data.iter().any(|e| e.x > 20.0),
        "the lamps of radiance 48 are found"
    );
}

/// What no view sees is filled in with the light that it can reflect of what arrives there, by a
/// finer bake than the one that filled it, in shelves and below furniture as elsewhere; what single
/// texels have too much is little.
#[test]
fn unseen_texels_send_out_no_more_than_they_receive() {
    let scene = load();
    let options = SolveOptions {
        albedo_size: 2 * SIDE,
        irradiance_size: 2 * SIDE,
        irradiance_rays: 64,
        ..small_textures()
    };
    let surface = observe(&scene, &options, &Progress::silent()).expect("observed");
    let light = reconstruct_light(&surface, &options, &Progress::silent());
    let (mut sent, mut received, mut excess, mut count) = (0.0, 0.0, 0.0, 0);
    let unseen = |i: &usize| {
        surface.fusion.views[*i] == 0 && !light.emissive[surface.texels.point[*i].triangle as usize]
    };
    for i in (0..surface.texels.len()).filter(unseen) {
        let white = surface.texels.lookup(&scene.mesh, &light.irradiance, i) / std::f32::consts::PI;
        let radiance = light.radiance.data[surface.texels.cell[i] as usize];
        sent += f64::from(radiance.element_sum());
        received += f64::from(white.element_sum());
        excess += f64::from((radiance - white).max(Vec3::ZERO).element_sum());
        count += 1;
    }
    println!(
        "{count} unseen texels send {:.3} of what they receive, {:.4} of it in excess",
        sent / received,
        excess / received
    );
    assert!(
        count > 10_000 && sent < 0.75 * received && excess < 0.07 * received,
        "{sent} {received} {excess}"
    );
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let (a, b) = (
        &reference().solution,
        on_threads(1, || solve(&load())).solution,
    );
    let same = |x: &Plane<Vec3>, y: &Plane<Vec3>, name: &str| {
        let differ = x
            .data
            .iter()
            .zip(&y.data)
            .filter(|(p, q)| p.to_array().map(f32::to_bits) != q.to_array().map(f32::to_bits));
        assert_eq!(differ.count(), 0, "{name} differs");
    };
    same(&a.radiance, &b.radiance, "radiance");
    same(&a.irradiance, &b.irradiance, "irradiance");
    same(&a.emission, &b.emission, "emission");
    same(&a.environment, &b.environment, "environment");
    same(&a.albedo, &b.albedo, "albedo");
    assert_eq!(a.roughness, b.roughness);
    assert_eq!(a.confidence, b.confidence);
    assert_eq!((&a.labels, &a.rooms), (&b.labels, &b.rooms));
    assert_eq!(a.mesh, b.mesh);
}

/// The systems that the paper compares with: whole solutions that learn, with the same bits on any
/// number of threads.
#[test]
fn compared_systems_are_whole_solutions_with_the_same_bits_on_any_threads() {
    let scene = load();
    for strategy in [
        PublishedStrategy::Invrender,
        PublishedStrategy::Nvdiffrec,
        PublishedStrategy::Neilf,
        PublishedStrategy::NeilfStar,
        PublishedStrategy::Tsdr,
    ] {
        let method = PublishedOptions {
            epochs: 2,
            visit_pixels: 300,
            post_process: true,
            ..PublishedOptions::new(strategy, PublishedValues::Text)
        };
        let options = SolveOptions {
            albedo_size: 64,
            roughness_size: 64,
            irradiance_size: 64,
            irradiance_rays: 32,
            fit: Fit::default(),
            published: Some(method),
            ..SolveOptions::default()
        };
        let on = |threads| {
            on_threads(threads, || {
                reconstruct(&scene, &options, &Progress::silent())
                    .expect("reconstructs")
                    .solution
            })
        };
        let (a, b) = (on(1), on(3));
        sane(&a);
        let values: std::collections::BTreeSet<u32> =
            a.roughness.data.iter().map(|r| r.to_bits()).collect();
        assert!(values.len() > 50, "{strategy:?} learned nothing");
        assert!(a.albedo.data.contains(&Vec3::splat(0.9)), "the ceiling");
        assert_eq!(a.albedo, b.albedo, "{strategy:?}");
        assert_eq!(a.roughness, b.roughness, "{strategy:?}");
        assert_eq!(a.emission, b.emission, "{strategy:?}");
        let shines = a.emission.data.iter().any(|e| *e != Vec3::ZERO);
        assert_eq!(shines, strategy == PublishedStrategy::Tsdr);
    }
}

/// The paper's estimators and its field stand in for the default's light, less exactly.
#[test]
fn other_estimators_of_irradiance_are_whole_solutions() {
    let scene = load();
    let best = &reference().solution;
    let off = |other: &SolveOptions| {
        let solved = reconstruct(&scene, other, &Progress::silent())
            .expect("reconstructs")
            .solution;
        sane(&solved);
        let stated = solved.irradiance_error.as_ref().expect("is stated");
        assert!(
            stated.data.iter().all(|e| (0.0..=1e4).contains(e))
                && stated.data.iter().any(|e| *e > 0.0)
        );
        let pairs = || solved.irradiance.data.iter().zip(&best.irradiance.data);
        let square = |v: Vec3| f64::from(v.length_squared());
        (pairs().map(|(a, b)| square(*a - *b)).sum::<f64>()
            / pairs().map(|(_, b)| square(*b)).sum::<f64>())
        .sqrt()
    };
    let with = |irradiance_estimator| {
        off(&SolveOptions {
            irradiance_estimator,
            ..small_textures()
        })
    };
    let (uniform, cosine) = (with(Estimator::Uniform), with(Estimator::Cosine));
    let field = off(&SolveOptions {
        nirf: Some(2),
        ..small_textures()
    });
    assert!(
        cosine < 0.15 && uniform < 0.3 && field.is_finite(),
        "{cosine} {uniform} {field}"
    );
    assert!(
        cosine > 0.0 && uniform > 0.0 && field > cosine,
        "{cosine} {uniform} {field}"
    );
}

/// A million times darker or brighter photographs of the same room: the materials are the same to
/// the last bit, because powers of two scale floating-point numbers exactly and no threshold is
/// absolute.
#[test]
fn exposure_does_not_change_materials() {
    let a = &reference().solution;
    for ev in [-20.0f32, 20.0] {
        let mut scene = load();
        scene.views.iter_mut().for_each(|v| v.exposure_ev = ev);
        let b = solve(&scene).solution;
        let differ = a
            .albedo
            .data
            .iter()
            .zip(&b.albedo.data)
            .filter(|(x, y)| x != y)
            .count();
        let (median, share) = albedo_difference(a, &b);
        let roughness = roughness_difference(a, &b);
        println!(
            "2^{ev}: {differ} albedos differ, median {median}, share {share}; roughness {roughness}"
        );
        assert_eq!((differ, roughness), (0, 0.0), "2^{ev}");
        let gain = ev.exp2();
        assert!(
            a.irradiance
                .data
                .iter()
                .zip(&b.irradiance.data)
                .all(|(x, y)| *x * gain == *y),
            "irradiance scales"
        );
    }
}

/// The apartment with its mesh as text in f64 and its cameras, scaled and then moved; images and
/// labels as they were.
fn rewritten(scale: f64, shift: DVec3) -> TempDir {
    let (from, dir) = (apartment(), tempfile::tempdir().expect("temporary folder"));
    let scene = load();
    let mut text = String::new();
    let world = |p: Vec3| (p.as_dvec3() + scene.origin) * scale + shift;
    for p in &scene.mesh.positions {
        let p = world(*p);
        writeln!(text, "v {} {} {}", p.x, p.y, p.z).expect("text");
    }
    for t in &scene.mesh.uvs {
        writeln!(text, "vt {} {}", t.x, 1.0 - f64::from(t.y)).expect("text");
    }
    for n in &scene.mesh.normals {
        writeln!(text, "vn {} {} {}", n.x, n.y, n.z).expect("text");
    }
    for t in &scene.mesh.triangles {
        let c = t.map(|i| format!("{0}/{0}/{0}", i + 1));
        writeln!(text, "f {} {} {}", c[0], c[1], c[2]).expect("text");
    }
    std::fs::write(dir.path().join("mesh.obj"), text).expect("mesh");
    let mut json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(from.join("transforms.json")).expect("file"))
            .expect("JSON");
    json["mesh_path"] = "mesh.obj".into();
    json.as_object_mut().expect("object").remove("rooms_path");
    for frame in json["frames"].as_array_mut().expect("frames") {
        for (row, s) in shift.to_array().into_iter().enumerate() {
            let x = frame["transform_matrix"][row][3].as_f64().expect("number");
            frame["transform_matrix"][row][3] = (x * scale + s).into();
        }
    }
    std::fs::write(dir.path().join("transforms.json"), json.to_string()).expect("file");
    for name in ["images", "labels"] {
        std::os::unix::fs::symlink(from.join(name), dir.path().join(name)).expect("link");
    }
    dir
}

/// A place 10 km away changes no bit. Another scale changes roundings, hence which of two
/// coincident edges a ray meets, hence single samples: the materials move by a fraction of what
/// another seed moves them.
#[test]
fn scale_and_place_do_not_change_materials() {
    let solve_at = |scale: f64, shift: DVec3, seed: u64| {
        let dir = rewritten(scale, shift);
        let scene = Scene::load(dir.path(), &LoadOptions::default()).expect("usable");
        let o = SolveOptions {
            irradiance_rays: 256,
            emitter_samples: 256,
            irradiance_size: 64,
            seed,
            ..small_textures()
        };
        let solution = reconstruct(&scene, &o, &Progress::silent())
            .expect("reconstructs")
            .solution;
        sane(&solution);
        solution
    };
    let a = solve_at(1.0, DVec3::ZERO, 0);
    let far = solve_at(1.0, DVec3::new(10_000.0, -3_000.0, 7_000.0), 0);
    assert_eq!(
        (&a.albedo, &a.roughness),
        (&far.albedo, &far.roughness),
        "10 km away"
    );
    let (noise, noise_share) = albedo_difference(&a, &solve_at(1.0, DVec3::ZERO, 5));
    println!("another seed: median {noise}, {noise_share} beyond 0.02");
    // whether a class of dim corners counts as emitting may turn on a rounding; noise beside lamps
    // is large: the middle of all ratios tells whether light is lost or gained
    let light = |s: &Solution| {
        let ratios = a
            .irradiance
            .data
            .iter()
            .zip(&s.irradiance.data)
            .filter(|(x, _)| x.y > 0.0);
        let mut ratios: Vec<f32> = ratios.map(|(x, y)| y.y / x.y).collect();
        ratios.sort_by(f32::total_cmp);
        ratios[ratios.len() / 2]
    };
    for scale in [1e-3, 1e4] {
        let b = solve_at(scale, DVec3::new(scale, 0.0, 0.0), 0);
        let (median, share) = albedo_difference(&a, &b);
        let drift = light(&b) - 1.0;
        let roughness = roughness_difference(&a, &b);
        println!(
            "×{scale}: median {median}, {share} beyond 0.02, drift {drift}; roughness {roughness}"
        );
        // beyond the noise of the samples, roundings decide which pixels a texel at an edge is seen
        // in, which no seed changes: one and a half times what another seed does
        assert!(
            median < 1.5 * noise && share < 1.5 * noise_share,
            "×{scale}: much more than another seed changes"
        );
        assert!(drift.abs() < 0.03, "×{scale}: light drifts by {drift}");
    }
}

/// Architectural models have their windings outwards, merged ones anyhow.
#[test]
fn windings_do_not_change_materials() {
    let another_seed = SolveOptions {
        seed: 5,
        ..small_textures()
    };
    let again = reconstruct(&load(), &another_seed, &Progress::silent()).expect("reconstructs");
    let (_, chance) = albedo_difference(&reference().solution, &again.solution);
    let mut rng = KeyedRng::new(5, 1);
    for turned in [1.0, 0.5] {
        let mut scene = load();
        for corners in &mut scene.mesh.triangles {
            if rng.next_f32() < turned {
                corners.swap(1, 2);
            }
        }
        let solved = solve(&scene);
        let (median, off) = albedo_difference(&reference().solution, &solved.solution);
        println!("{turned}: median {median}, {off} beyond 0.02, {chance} with another seed");
        // of windings turned with their normals only roundings are left, which move single samples
        assert!(
            median < 2e-3 && off < 0.5 * chance,
            "{turned}: {median} {off} {chance}"
        );
        // and what nobody sees faces the same way: both meshes come out wound alike
        let (a, b) = (&reference().solution.mesh, &solved.solution.mesh);
        let away = (0..a.triangles.len())
            .filter(|&t| a.face_normal(t).dot(b.face_normal(t)) < 0.0)
            .count();
        assert!(50 * away < a.triangles.len(), "{turned}: {away} triangles");
    }
}

/// A run that stopped after its light was computed goes on from there, and nobody can tell.
#[test]
fn a_stopped_run_goes_on_with_the_same_bits() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let o = SolveOptions {
        checkpoints: Checkpoints::new(dir.path(), "run"),
        ..small_textures()
    };
    let scene = load();
    for _ in 0..2 {
        let again = reconstruct(&scene, &o, &Progress::silent())
            .expect("reconstructs")
            .solution;
        let a = &reference().solution;
        assert_eq!((&a.albedo, &a.roughness), (&again.albedo, &again.roughness));
        assert_eq!(
            (&a.irradiance, &a.radiance, &a.confidence),
            (&again.irradiance, &again.radiance, &again.confidence)
        );
        assert_eq!(
            std::fs::read_dir(dir.path().join(".partial/run"))
                .expect("kept")
                .count(),
            2,
            "radiance and irradiance"
        );
    }
    o.checkpoints.finish();
    assert_eq!(std::fs::read_dir(dir.path()).expect("lists").count(), 0);
}

#[test]
fn one_view_gives_what_it_saw() {
    let mut scene = load();
    let first = scene
        .views
        .iter()
        .position(|v| v.split == Split::Train)
        .expect("one");
    scene.views = vec![scene.views[first].clone()];
    let solved = solve(&scene);
    let certain = solved
        .solution
        .confidence
        .data
        .iter()
        .filter(|c| c.x < 1e3)
        .count();
    assert!(certain > 3_000, "{certain}");
    assert!(
        solved.solution.confidence.data.iter().any(|c| c.x >= 1e3),
        "what no view sees is marked"
    );
    // no point is seen twice: the roughness is the prior's, and is said to be
    assert!(solved.fits.iter().all(|f| f.points == 0));
}

/// Two photographs from the same place say no more than one: the answer must not pretend otherwise,
/// and must be finite.
#[test]
fn two_coincident_views() {
    let mut scene = load();
    let mut first = scene
        .views
        .iter()
        .find(|v| v.split == Split::Train)
        .expect("one")
        .clone();
    let mut views = vec![first.clone()];
    first.stem = "again".into();
    views.push(first);
    scene.views = views;
    let twice = solve(&scene).solution;
    scene.views.pop();
    let once = solve(&scene).solution;
    let (median, _) = albedo_difference(&once, &twice);
    assert!(median < 0.05, "median {median}");
}

#[test]
fn without_labels_and_with_one_class() {
    let mut scene = load();
    scene.views.iter_mut().for_each(|v| v.label_path = None);
    scene.classes.clear();
    scene.classes_declared = false;
    let bare = solve(&scene).solution;
    let mut segments: Vec<u16> = bare.labels.data.clone();
    segments.sort_unstable();
    segments.dedup();
    assert!(segments.len() > 5, "{} segments", segments.len());
    let apart = SolveOptions {
        segments: unbake::pipeline::Switch::Off,
        ..small_textures()
    };
    let alike = reconstruct(&scene, &apart, &Progress::silent())
        .expect("solved")
        .solution;
    assert!(alike.labels.data.iter().all(|l| *l == 0));
    let truth = formats::read_rgb(apartment().join("gt/albedo_texture.exr")).expect("truth");
    let error = |s: &Solution| {
        let mut e: Vec<f32> = (0..truth.data.len())
            .filter(|&i| s.confidence.data[i].x < 1.0 && truth.data[i] != Vec3::ZERO)
            .map(|i| (s.albedo.data[i] - truth.data[i]).abs().max_element())
            .collect();
        e.sort_by(f32::total_cmp);
        e[e.len() / 2]
    };
    println!(
        "median albedo error without labels {:.3}, all alike {:.3}",
        error(&bare),
        error(&alike)
    );
    assert!(error(&bare) < 0.3 && error(&alike) < 0.3);
    // one class for everything
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("one.png");
    formats::write_png16(&path, &Plane::filled(192, 96, 65_535u16)).expect("labels");
    scene
        .views
        .iter_mut()
        .for_each(|v| v.label_path = Some(path.clone()));
    let one = solve(&scene).solution;
    let named = one.labels.data.iter().filter(|l| **l == 65_535).count();
    assert!(
        named > one.labels.data.len() / 4,
        "{named} texels carry the only class there is"
    );
}

/// A scene whose label images are taken away and whose mesh has a material per class instead ends
/// near the labelled result.
#[test]
fn materials_of_the_mesh_take_the_place_of_label_images() {
    let labelled = load();
    let reference = solve(&labelled).solution;
    let dir = tempfile::tempdir().expect("temporary folder");
    let text = std::fs::read_to_string(apartment().join("transforms.json")).expect("scene");
    let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    for frame in json["frames"].as_array_mut().expect("frames") {
        let frame = frame.as_object_mut().expect("frame");
        frame.remove("label_path");
    }
    json.as_object_mut().expect("scene").remove("classes");
    json["mesh_path"] = "mesh.obj".into();
    std::fs::write(
        dir.path().join("mesh.obj"),
        by_material(&labelled, &reference),
    )
    .expect("mesh");
    std::fs::write(dir.path().join("transforms.json"), json.to_string()).expect("scene");
    for name in ["images", "rooms.png", "rooms.json"] {
        std::os::unix::fs::symlink(apartment().join(name), dir.path().join(name)).expect("link");
    }
    let scene = Scene::load(dir.path(), &LoadOptions::default()).expect("usable");
    assert!(
        scene.warnings.iter().any(|w| w.contains("materials as")),
        "{:?}",
        scene.warnings
    );
    let lamps: Vec<&str> = (scene.classes.iter().filter(|c| c.is_light))
        .map(|c| c.name.as_str())
        .collect();
    assert_eq!(lamps, ["lamp"], "known by its name");
    let named = solve(&scene).solution;
    let (median, _) = albedo_difference(&reference, &named);
    println!("median difference of the albedo: {median:.4}");
    assert!(median < 0.01, "{median}");
    let off = LoadOptions {
        mesh_classes: unbake::pipeline::Switch::Off,
        ..LoadOptions::default()
    };
    let without = Scene::load(dir.path(), &off).expect("usable");
    assert!(without.mesh_classes.is_none() && without.classes.is_empty());
}

/// The scene's mesh as OBJ, each triangle with the class as its material that most of its texels have.
fn by_material(scene: &Scene, solved: &Solution) -> String {
    let mesh = &scene.mesh;
    let mut text = String::new();
    for ((p, n), t) in mesh.positions.iter().zip(&mesh.normals).zip(&mesh.uvs) {
        let p = p.as_dvec3() + scene.origin;
        writeln!(
            text,
            "v {} {} {}\nvn {} {} {}\nvt {} {}",
            p.x,
            p.y,
            p.z,
            n.x,
            n.y,
            n.z,
            t.x,
            1.0 - t.y
        )
        .expect("text");
    }
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let id = solved.class_at(mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0));
        let name = scene.class(id).map_or("unknown", |c| c.name.as_str());
        let [a, b, c] = corners.map(|i| i + 1);
        writeln!(text, "usemtl {name}\nf {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").expect("text");
    }
    text
}

#[test]
fn black_photographs_are_refused() {
    let mut scene = load();
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("black.exr");
    formats::write_rgb_float(&path, &Plane::filled(192, 96, Vec3::ZERO)).expect("image");
    scene
        .views
        .iter_mut()
        .for_each(|v| v.image_path = path.clone());
    let e = reconstruct(&scene, &small_textures(), &Progress::silent()).map(|_| ());
    let e = e.expect_err("no light to reconstruct from");
    assert!(
        e.exit_code() == 2 && e.to_string().contains("every training image is black"),
        "{e}"
    );
}

#[test]
fn a_pixel_that_is_no_number_is_refused_or_ignored_on_request() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("nan.exr");
    let mut scene = load();
    let image = formats::read_rgb(&scene.views[0].image_path).expect("image");
    let value = |x: u32, y: u32| {
        if (x, y) == (100, 40) {
            f32::NAN
        } else {
            image[(x as usize, y as usize)].x
        }
    };
    std::fs::write(&path, common::raw_exr(192, 96, value)).expect("image");
    let view = scene
        .views
        .iter_mut()
        .find(|v| v.split == Split::Train)
        .expect("one");
    view.image_path = path.clone();
    let Err(error) = reconstruct(&scene, &small_textures(), &Progress::silent()) else {
        panic!("accepted NaN")
    };
    let text = error.to_string();
    assert_eq!(error.exit_code(), 2);
    assert!(
        text.contains("nan.exr")
            && text.contains("column 100, row 40")
            && text.contains("--clamp-nan"),
        "{text}"
    );
    scene.options.clamp_nan = true;
    solve(&scene);
}

/// Sizes that make no sense are refused before anything is computed; the smallest that does works.
#[test]
fn texture_sizes_from_nothing_to_one() {
    let scene = load();
    for change in [
        |o: &mut SolveOptions| o.albedo_size = 0,
        |o: &mut SolveOptions| o.roughness_size = 0,
        |o: &mut SolveOptions| o.irradiance_size = 0,
        |o: &mut SolveOptions| o.albedo_size = 1 << 20,
        |o: &mut SolveOptions| o.irradiance_error = f32::NAN,
        |o: &mut SolveOptions| o.irradiance_rays = u32::MAX,
    ] {
        let mut o = small_textures();
        change(&mut o);
        let refused = reconstruct(&scene, &o, &Progress::silent());
        assert!(matches!(refused, Err(Error::Usage(_))), "{o:?}");
    }
    let one = SolveOptions {
        albedo_size: 1,
        roughness_size: 1,
        irradiance_size: 1,
        ..small_textures()
    };
    sane(
        &reconstruct(&scene, &one, &Progress::silent())
            .expect("solves")
            .solution,
    );
    let odd = SolveOptions {
        albedo_size: 61,
        roughness_size: 7,
        irradiance_size: 3,
        ..small_textures()
    };
    sane(
        &reconstruct(&scene, &odd, &Progress::silent())
            .expect("solves")
            .solution,
    );
}

/// On the command line: damaged inputs are exit code 2 and leave nothing behind.
#[test]
fn damaged_inputs_leave_nothing_half_written() {
    let unbake = |scene: &Path, out: &Path| {
        std::process::Command::new(env!("CARGO_BIN_EXE_unbake"))
            .args([
                "solve",
                "--quiet",
                "--albedo-size",
                "64",
                "--roughness-size",
                "64",
                "--irradiance-size",
                "32",
            ])
            .arg(scene)
            .arg("-o")
            .arg(out)
            .output()
            .expect("the program starts")
    };
    type Spoil = fn(&common::SceneDir);
    let damage: [(&str, Spoil); 6] = [
        ("a.exr", |s| s.write("a.exr", b"no image")),
        ("a.exr", |s| {
            s.write(
                "a.exr",
                &common::raw_exr(32, 16, |x, y| if x == y { f32::INFINITY } else { 1.0 }),
            )
        }),
        ("a.png", |s| s.write("a.png", &[0x89, b'P', b'N', b'G'])),
        ("a.png", |s| {
            formats::write_png16(s.path("a.png"), &Plane::filled(32, 16, 9u16)).expect("labels")
        }),
        ("mesh.obj", |s| s.write("mesh.obj", b"v 0 0 0\nf 1 2 3\n")),
        ("transforms.json", |s| {
            s.write("transforms.json", b"{\"frames\": 3}")
        }),
    ];
    for (i, (file, spoil)) in damage.iter().enumerate() {
        let scene = common::SceneDir::box_room();
        spoil(&scene);
        let out_dir = tempfile::tempdir().expect("temporary folder");
        let out = out_dir.path().join("out");
        let run = unbake(scene.folder(), &out);
        let message = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{i} {file}: {message}");
        assert!(
            message.contains(file),
            "{i}: {message} does not name {file}"
        );
        let left = std::fs::read_dir(&out)
            .map(|d| d.map(|e| e.expect("entry").file_name()).collect::<Vec<_>>())
            .unwrap_or_default();
        assert!(left.is_empty(), "{i} {file}: {left:?} remains");
    }
    // the intact scene: whole, and an older solution survives a failed run
    let scene = common::SceneDir::box_room();
    let out_dir = tempfile::tempdir().expect("temporary folder");
    let run = unbake(scene.folder(), out_dir.path());
    assert_eq!(
        run.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let before = std::fs::read(out_dir.path().join("albedo.exr")).expect("albedo");
    scene.write("a.exr", b"no image");
    assert_eq!(
        unbake(scene.folder(), out_dir.path()).status.code(),
        Some(2)
    );
    assert_eq!(
        std::fs::read(out_dir.path().join("albedo.exr")).expect("albedo"),
        before
    );
    assert!(Solution::load(out_dir.path()).is_ok());
}
