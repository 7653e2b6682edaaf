//! Edits against closed forms.

use super::*;
use crate::core::geometry::Mesh;
use crate::core::image::Plane;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// A closed box, one chart per wall, whose walls all send out the same radiance: E = π L
/// everywhere.
fn furnace(albedo: f32, radiance: f32) -> Solution {
    let mut mesh = Mesh::default();
    let v = Vec3::new;
    let walls = [
        (v(0., 0., 0.), v(0., 0., 1.), v(1., 0., 0.)),
        (v(0., 1., 0.), v(1., 0., 0.), v(0., 0., 1.)),
        (v(0., 0., 0.), v(0., 1., 0.), v(0., 0., 1.)),
        (v(1., 0., 0.), v(0., 0., 1.), v(0., 1., 0.)),
        (v(0., 0., 0.), v(1., 0., 0.), v(0., 1., 0.)),
        (v(0., 0., 1.), v(0., 1., 0.), v(1., 0., 0.)),
    ];
    for (i, (corner, du, dv)) in walls.into_iter().enumerate() {
        let base = mesh.positions.len() as u32;
        let at = Vec2::new((i % 3) as f32, (i / 3) as f32) / 3.0;
        for (a, b) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(corner + du * a + dv * b);
            mesh.normals.push(du.cross(dv));
            mesh.uvs.push(at + Vec2::new(a, b) * 0.25 + 0.04);
        }
        mesh.triangles
            .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    let grey = |side: usize, x: f32| Plane::filled(side, side, Vec3::splat(x));
    let mut labels = Plane::filled(48, 48, 1u16);
    // the floor is class 2
    for y in 0..16 {
        for x in 0..16 {
            labels[(x, y)] = 2;
        }
    }
    Solution {
        mesh,
        origin: DVec3::ZERO,
        albedo: grey(48, albedo),
        roughness: Plane::filled(48, 48, 0.6),
        irradiance: grey(48, PI * radiance),
        radiance: grey(48, radiance),
        emission: grey(48, 0.0),
        confidence: Plane::filled(48, 48, Vec2::ZERO),
        metallic: None,
        transmission: None,
        irradiance_error: None,
        lamps: Vec::new(),
        portals: Vec::new(),
        camera_masks: Vec::new(),
        labels,
        rooms: Plane::filled(48, 48, 1),
        environment: Plane::filled(4, 2, Vec3::ZERO),
        reflectance: crate::core::brdf::Reflectance::Paper,
    }
}

fn list(text: &str) -> EditList {
    toml::from_str(text).expect("valid")
}

fn edited(solution: &Solution, text: &str) -> Result<Edited> {
    apply_edits(
        solution,
        &list(text),
        Path::new("."),
        &[(2, "floor".into())],
        0,
        &Progress::silent(),
    )
}

#[test]
fn bounced_light_follows_in_a_furnace() {
    // walls of albedo ½ that emit ½: L = 1, E = π. With albedo 0.6 in half of it: L' = ½/(1 − 0.6)
    // where all are 0.6
    let solution = furnace(0.5, 1.0);
    let out = edited(&solution, "[[edit]]\nset = {albedo = [0.6, 0.5, 0.5]}\n").expect("edits");
    let uv = solution.mesh.uv(0, 0.3, 0.3) * 48.0;
    let l = *out.solution.radiance.nearest(uv);
    let e = *out.solution.irradiance.nearest(uv);
    // the series is cut where a bounce brings less than one per cent
    assert!((l.x - 1.25).abs() < 0.03, "{l}");
    assert!((e.x / PI - 1.25).abs() < 0.03, "{e}");
    assert_eq!(
        (l.y, e.y / PI),
        (1.0, 1.0),
        "channels that were not edited stay to the bit"
    );
    assert!(out.bounces.len() > 1 && out.bounces.windows(2).all(|w| w[1] < w[0]));
    assert_eq!(out.solution.roughness.data, solution.roughness.data);
}

#[test]
fn metal_stays_metal_and_sends_out_no_diffuse_light() {
    let mut solution = furnace(0.5, 1.0);
    let floor = solution.mesh.uv(0, 0.3, 0.3) * 48.0;
    let paint = "[[edit]]\nclass = \"floor\"\nset = {albedo = [0.9, 0.7, 0.3]}\n";
    let plain = edited(&solution, paint).expect("edits").solution;
    assert!(
        plain.irradiance != solution.irradiance,
        "paint changes the light"
    );
    let metallic = solution.labels.map(|l| f32::from(*l == 2));
    solution.metallic = Some(metallic.clone());
    let metal = edited(&solution, paint).expect("edits").solution;
    assert_eq!(metal.metallic, Some(metallic));
    assert!((metal.albedo.nearest(floor).x - 0.9).abs() < 1e-6);
    assert_eq!(metal.irradiance, solution.irradiance);
}

#[test]
fn selections_mean_what_they_say() {
    let solution = furnace(0.5, 1.0);
    let floor = solution.mesh.uv(0, 0.3, 0.3) * 48.0;
    let wall = solution.mesh.uv(4, 0.3, 0.3) * 48.0;
    for text in [
        "class = \"floor\"",
        "class = \"2\"",
        "point = [0.5, 0.0, 0.5]",
    ] {
        let out = edited(
            &solution,
            &format!("[[edit]]\n{text}\nscale = {{albedo = [0.5, 0.5, 0.5], roughness = 0.5}}\n"),
        );
        let out = out.expect("edits").solution;
        assert_eq!(
            (out.albedo.nearest(floor).x, *out.roughness.nearest(floor)),
            (0.25, 0.3),
            "{text}"
        );
        assert_eq!(
            (out.albedo.nearest(wall).x, *out.roughness.nearest(wall)),
            (0.5, 0.6),
            "{text}"
        );
        assert!(
            out.irradiance.nearest(wall).x < solution.irradiance.nearest(wall).x,
            "the wall gets less light"
        );
    }
    for (text, expected) in [
        ("class = \"sofa\"", "there is no \"sofa\""),
        ("class = \"999\"", "no surface is of class 999"),
        ("room = 7", "no room 7"),
        ("point = [5, 5, 5]", "no surface near"),
    ] {
        let e = edited(
            &solution,
            &format!("[[edit]]\n{text}\nset = {{roughness = 0.1}}\n"),
        )
        .err()
        .expect("refused");
        assert!(
            e.exit_code() == 2 && e.to_string().contains(expected),
            "{e}"
        );
    }
}

#[test]
fn tint_keeps_the_luminance_and_textures_repeat() {
    let solution = furnace(0.4, 1.0);
    let floor = solution.mesh.uv(0, 0.3, 0.3) * 48.0;
    let out = edited(
        &solution,
        "[[edit]]\nclass = \"2\"\ntint = [1.0, 0.5, 0.25]\n",
    )
    .expect("edits")
    .solution;
    let a = *out.albedo.nearest(floor);
    assert!(
        (crate::core::math::luminance(a) - 0.4).abs() < 1e-3 && a.x > 1.5 * a.y,
        "{a}"
    );

    let folder = tempfile::tempdir().expect("temp");
    // black and white halves, one repetition per half metre: planar on the floor they follow x
    let picture = Plane {
        width: 8,
        height: 8,
        data: (0..64)
            .map(|i| Vec3::splat(if i % 8 < 4 { 0.1 } else { 0.9 }))
            .collect(),
    };
    crate::core::formats::write_rgb_float(folder.path().join("t.exr"), &picture).expect("writes");
    let text = "[[edit]]\nclass = \"2\"\ntexture = {albedo = \"t.exr\", size = 0.5, mapping = \"planar\"}\n";
    let out = apply_edits(
        &solution,
        &list(text),
        folder.path(),
        &[],
        0,
        &Progress::silent(),
    )
    .expect("edits")
    .solution;
    for x in [0.06f32, 0.19, 0.31, 0.44, 0.56, 0.69, 0.81, 0.94] {
        // on the floor, v of the chart runs along x
        let p = (Vec2::new(0.5, x) * 0.25 + 0.04) * 48.0;
        let expected = if (x / 0.5).fract() < 0.5 { 0.1 } else { 0.9 };
        let got = out.albedo.nearest(p).x;
        assert!((got - expected).abs() < 0.25, "x {x}: {got}");
    }
}

#[test]
fn a_folder_keeps_its_solution_and_knows_when_its_edits_are_stale() {
    let folder = tempfile::tempdir().expect("temp");
    let solution = furnace(0.5, 1.0);
    solution
        .save(folder.path(), &SaveOptions::default())
        .expect("saves");
    let quiet = Progress::silent();
    assert_eq!(
        load_edited(folder.path(), &quiet)
            .expect("no edits")
            .albedo
            .data[0],
        solution.albedo.data[0]
    );
    let write = |v: f32| {
        std::fs::write(
            folder.path().join(EDITS),
            format!("[[edit]]\nset = {{albedo = [{v}, {v}, {v}]}}\n"),
        )
        .expect("writes");
    };
    write(0.25);
    let first = load_edited(folder.path(), &quiet).expect("applies");
    assert!((first.albedo.data[0].x - 0.25).abs() < 1e-3);
    let again = load_edited(folder.path(), &quiet).expect("from edited/");
    assert!((again.albedo.data[0].x - 0.25).abs() < 1e-3);
    write(0.75);
    assert!(
        (load_edited(folder.path(), &quiet)
            .expect("stale")
            .albedo
            .data[0]
            .x
            - 0.75)
            .abs()
            < 1e-3
    );
    assert!(
        (Solution::load(folder.path())
            .expect("untouched")
            .albedo
            .data[0]
            .x
            - 0.5)
            .abs()
            < 1e-3
    );
    std::fs::write(
        folder.path().join(EDITS),
        "[[edit]]\nset = {albedo = [2, 0, 0]}\n",
    )
    .expect("writes");
    let e = load_edited(folder.path(), &quiet).expect_err("out of range");
    assert!(
        e.exit_code() == 2 && e.to_string().contains("edit[0].set.albedo"),
        "{e}"
    );
}

#[test]
fn pictures_stay_where_they_are_when_a_list_moves() {
    let text = "[[edit]]\nmask = \"m.png\"\n[edit.texture]\nalbedo = \"wood/a.png\"\nroughness = \"/srv/r.png\"\n";
    let mut list: EditList = toml::from_str(text).expect("a list");
    let folder = std::path::absolute("lists").expect("a folder");
    assert!(
        list.anchor(std::path::Path::new("lists/edits.toml"))
            .expect("anchors")
    );
    let files: Vec<_> = list.edits[0].files().cloned().collect();
    assert_eq!(
        files,
        [
            folder.join("m.png"),
            folder.join("wood/a.png"),
            "/srv/r.png".into()
        ]
    );
    let again = list.clone();
    assert!(
        !list
            .anchor(std::path::Path::new("edits.toml"))
            .expect("anchors")
    );
    assert_eq!(list, again);
}
