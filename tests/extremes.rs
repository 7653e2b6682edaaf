//! One table of extremes with their expected outcomes: kernels, radiances, textures and meshes that
//! real scenes do contain.

mod common;

use common::lit::{Lit, box_quads, mesh_of, quad, receivers_on};
use glam::{Vec2, Vec3};
use proptest::prelude::*;
use unbake::core::brdf::{Material, ggx_d, specular, specular_d_roughness};
use unbake::core::formats;
use unbake::core::geometry::Mesh;
use unbake::core::image::{Plane, Wrap};
use unbake::core::math::Real;
use unbake::core::progress::Progress;
use unbake::core::texture::{MipChain, Texels, fill_uncovered};
use unbake::irradiance::{IrradianceOptions, bake_irradiance};
use unbake::lights::{EmissionEvidence, detect_emissive};
use unbake::pipeline::{SolveOptions, Switch, reconstruct};
use unbake::radiance::Environment;
use unbake::scene::{LoadOptions, Scene};

/// (name, n·l, n·v, ‖n×h‖², v·h, R, largest relative error in f32 of value and of slope against
/// R/value)
const KERNEL: &[(&str, f64, f64, f64, f64, f64, f64)] = &[
    ("peak, R at its lower clamp", 1.0, 1.0, 0.0, 1.0, 0.01, 1e-6),
    ("peak, R at its upper clamp", 1.0, 1.0, 0.0, 1.0, 0.8, 1e-6),
    ("peak, R = 1", 1.0, 1.0, 0.0, 1.0, 1.0, 1e-6),
    (
        "1e-5 off the peak at α = 1e-4",
        0.9,
        0.9,
        1e-10,
        0.9,
        0.01,
        2e-6,
    ),
    ("on the flank, s = α²", 0.9, 0.9, 1e-8, 0.9, 0.01, 2e-6),
    (
        "far off the peak at α = 1e-4",
        0.5,
        0.9,
        0.1,
        0.8,
        0.01,
        2e-6,
    ),
    ("grazing view", 0.5, 1e-5, 0.3, 0.4, 0.3, 2e-6),
    ("grazing light", 1e-5, 0.5, 0.3, 0.4, 0.3, 2e-6),
    ("both grazing, mirror", 1e-5, 1e-5, 0.0, 1e-5, 0.01, 2e-6),
    ("both grazing, R = 1", 1e-5, 1e-5, 0.0, 1e-5, 1.0, 2e-6),
    ("light on the horizon", 0.0, 0.5, 0.4, 0.3, 0.8, 2e-6),
    ("half vector on the horizon", 0.1, 0.1, 1.0, 0.0, 0.5, 2e-6),
];

#[test]
fn the_kernel_keeps_its_digits_in_single_precision() {
    for &(name, n_l, n_v, s, v_h, r, bound) in KERNEL {
        // the reference gets the inputs that f32 can hold, so that only the arithmetic is judged
        let f = [n_l, n_v, s, v_h, r].map(|x| x as f32);
        let d = f.map(f64::from);
        let (v32, s32) = specular_d_roughness(f[0], f[1], f[2], f[3], f[4]);
        let (v64, s64) = specular_d_roughness(d[0], d[1], d[2], d[3], d[4]);
        assert!(
            v32.is_finite() && s32.is_finite() && v32 >= 0.0,
            "{name}: {v32} {s32}"
        );
        let value_error = (f64::from(v32) - v64).abs() / v64.max(1e-300);
        let slope_error = (f64::from(s32) - s64).abs() / s64.abs().max(v64 / d[4]);
        assert!(
            value_error < bound && slope_error < 2.0 * bound,
            "{name}: D off by {value_error:.1e}, dD/dR by {slope_error:.1e}"
        );
        let d_error = (f64::from(ggx_d(f[2], f[4] * f[4])) / ggx_d(d[2], d[4] * d[4]) - 1.0).abs();
        assert!(d_error < 2e-6, "{name}: distribution off by {d_error:.1e}");
    }
}

/// A material of any roughness a file may hold, 0 and NaN included, evaluates to something finite
/// that is not negative.
#[test]
fn materials_of_any_roughness_and_albedo_are_finite() {
    let n = Vec3::Y;
    for roughness in [0.0f32, 1e-9, 0.01, 0.8, 1.0, 7.0, -1.0, f32::NAN] {
        for albedo in [0.0f32, 1.0, 0.5] {
            let m = Material {
                albedo: Vec3::splat(albedo),
                roughness,
            };
            for c in [1.0f32, 1e-2, 1e-5, 0.0] {
                let v = Vec3::new((1.0 - c * c).sqrt(), c, 0.0);
                for l in [v, Vec3::new(-v.x, v.y, 0.0), Vec3::Y] {
                    let f = m.eval(n, v, l);
                    assert!(
                        f.is_finite() && f.min_element() >= 0.0,
                        "R {roughness} A {albedo} cos {c}: {f}"
                    );
                }
                for u in [[0.0f32, 0.0], [0.999_999_9, 0.999_999_9], [0.5, 0.0]] {
                    if let Some(s) = m.sample(n, v, 0.05, u) {
                        assert!(s.weight.is_finite() && s.pdf > 0.0 && s.direction.is_finite());
                    }
                }
            }
        }
    }
}

/// From starlight to a sun of 1e9: the irradiance of the same room is the same times the radiance.
#[test]
fn radiance_from_a_millionth_to_a_sun() {
    for radiance in [1e-6f32, 1.0, 1e6, 1e9] {
        let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
        quads.push(quad(
            [1.5, 2.9, 1.5],
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            radiance,
            true,
        ));
        let lit = Lit::new(&quads, Environment::black());
        let receivers = receivers_on(&quads[0], 6);
        let out = bake_irradiance(
            &lit.bake(),
            receivers.len(),
            |i| receivers[i],
            &IrradianceOptions::default(),
            &Progress::silent(),
        );
        let mean = out.value.iter().map(|e| f64::from(e.x)).sum::<f64>()
            / receivers.len() as f64
            / f64::from(radiance);
        assert!((0.06..0.1).contains(&mean), "radiance {radiance:e}: {mean}");
    }
}

#[test]
fn values_beyond_half_precision_are_said_to_be_clamped() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("sun.exr");
    let sun = Plane {
        width: 3,
        height: 1,
        data: vec![Vec3::splat(1e9), Vec3::splat(65_504.0), Vec3::splat(1e-8)],
    };
    let clamped = formats::write_rgb_half(&path, &sun).expect("writes");
    let back = formats::read_rgb(&path).expect("reads");
    assert!(
        back.data.iter().all(|v| v.is_finite()),
        "no infinity in the file: {:?}",
        back.data
    );
    assert_eq!((back.data[0].x, back.data[1].x), (65_504.0, 65_504.0));
    assert!(clamped > 0, "the writer counts what it clamped");
    formats::write_rgb_float(&path, &sun).expect("writes");
    assert_eq!(formats::read_rgb(&path).expect("reads"), sun);
    let broken = sun.map(|v| *v * f32::NAN);
    assert!(
        formats::write_rgb_half(&path, &broken).is_err(),
        "NaN is never written"
    );
    assert_eq!(
        formats::read_rgb(&path).expect("the old file is intact"),
        sun
    );
}

#[test]
fn sixty_five_thousand_classes() {
    let evidence = |i: u32| EmissionEvidence {
        triangle: i,
        label: (i + 1) as u16,
        floor: if i % 1000 == 7 { 50.0 } else { 0.5 },
        white: 1.0,
        observed: true,
    };
    let texels: Vec<EmissionEvidence> = (0..65_535).map(evidence).collect();
    let found = detect_emissive(65_535, &texels, &vec![false; 65_535]);
    assert!((0..65_535).all(|i| found[i as usize] == (i % 1000 == 7)));
    let dir = tempfile::tempdir().expect("temporary folder");
    let labels = Plane {
        width: 256,
        height: 256,
        data: (0..=u16::MAX).collect::<Vec<u16>>(),
    };
    formats::write_png16(dir.path().join("l.png"), &labels).expect("writes");
    assert_eq!(
        formats::read_labels(dir.path().join("l.png")).expect("reads"),
        labels
    );
}

fn soup(positions: Vec<Vec3>, uvs: Vec<Vec2>, triangles: Vec<[u32; 3]>) -> Mesh {
    let mut mesh = Mesh {
        positions,
        uvs,
        triangles,
        normals: vec![],
    };
    mesh.compute_normals();
    mesh
}

/// (name, mesh, covered texels at 16²: least and most)
fn meshes() -> Vec<(&'static str, Mesh, [usize; 2])> {
    let p = |x: f32, y: f32| Vec3::new(x, 0.0, y);
    let at = Vec2::new;
    let square = || vec![p(0.0, 0.0), p(1.0, 0.0), p(1.0, 1.0), p(0.0, 1.0)];
    let full = || vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
    vec![
        ("nothing", Mesh::default(), [0, 0]),
        (
            "a sliver",
            soup(
                vec![p(0.0, 0.0), p(1.0, 1e-7), p(2.0, 0.0)],
                vec![at(0.1, 0.5), at(0.5, 0.500_001), at(0.9, 0.5)],
                vec![[0, 1, 2]],
            ),
            [10, 48],
        ),
        (
            "a chart without area",
            soup(square(), vec![at(0.5, 0.5); 4], vec![[0, 1, 2], [0, 2, 3]]),
            [0, 4],
        ),
        (
            "charts on one another",
            soup(
                square(),
                full(),
                vec![[0, 1, 2], [0, 2, 3], [0, 1, 2], [2, 1, 0]],
            ),
            [256, 256],
        ),
        (
            "three triangles at one edge",
            soup(
                [square(), vec![Vec3::Y]].concat(),
                [full(), vec![at(0.5, 0.2)]].concat(),
                vec![[0, 1, 2], [0, 2, 3], [0, 2, 4]],
            ),
            [256, 256],
        ),
        (
            "inverted",
            soup(square(), full(), vec![[0, 2, 1], [0, 3, 2]]),
            [256, 256],
        ),
        (
            "a triangle of one point",
            soup(
                vec![p(0.3, 0.3); 3],
                vec![at(0.2, 0.2), at(0.8, 0.2), at(0.2, 0.8)],
                vec![[0, 1, 2]],
            ),
            [40, 120],
        ),
        (
            "far outside the atlas",
            soup(
                square(),
                full().iter().map(|u| *u * 1e9 - 5e8).collect(),
                vec![[0, 1, 2], [0, 2, 3]],
            ),
            [0, 256],
        ),
        (
            "atlas of NaN",
            soup(square(), vec![Vec2::NAN; 4], vec![[0, 1, 2], [0, 2, 3]]),
            [0, 0],
        ),
        (
            "positions of NaN",
            soup(vec![Vec3::NAN; 4], full(), vec![[0, 1, 2], [0, 2, 3]]),
            [256, 256],
        ),
    ]
}

#[test]
fn meshes_of_every_kind_of_wrong_are_rasterised() {
    for (name, mesh, [least, most]) in meshes() {
        let texels = Texels::rasterize(&mesh, 16, 16);
        assert!(
            (least..=most).contains(&texels.len()),
            "{name}: {} texels",
            texels.len()
        );
        assert!(
            texels.cell.windows(2).all(|w| w[0] < w[1]),
            "{name}: cells ascend, each once"
        );
        for i in 0..texels.len() {
            let (u, v) = texels.ray_point(i);
            assert!(u > 0.0 && v > 0.0 && u + v < 1.0, "{name}: {u} {v}");
            let area = texels.texel_area(&mesh, texels.point[i].triangle as usize);
            assert!(
                name.contains("NaN") || (area.is_finite() && area >= 0.0),
                "{name}: {area}"
            );
        }
        for (w, h) in [(1, 1), (1, 7), (3, 1)] {
            let small = Texels::rasterize(&mesh, w, h);
            assert!(small.len() <= w * h, "{name} at {w}×{h}");
        }
    }
}

#[test]
fn textures_of_one_texel() {
    let one = Plane::filled(1, 1, Vec3::splat(0.3));
    let chain = MipChain::new(one.clone(), 9);
    assert_eq!(chain.level_count(), 1);
    for uv in [
        Vec2::ZERO,
        Vec2::ONE,
        Vec2::splat(0.5),
        Vec2::splat(-3.0),
        Vec2::splat(1e20),
        Vec2::NAN,
    ] {
        assert_eq!(chain.lookup(uv, 1e9), Vec3::splat(0.3), "{uv}");
        assert_eq!(*one.nearest(uv), Vec3::splat(0.3));
    }
    assert!(
        (chain.bilinear(Vec2::splat(0.2)) - Vec3::splat(0.3))
            .abs()
            .max_element()
            < 1e-6
    );
    assert_eq!(fill_uncovered(&one, &Plane::filled(1, 1, false)), one);
    assert!(
        (one.bilinear(Vec2::splat(40.0), Wrap::Repeat) - Vec3::splat(0.3))
            .abs()
            .max_element()
            < 1e-6
    );
}

/// The largest texture the options allow, with a chart in two opposite corners: memory and time
/// follow the charts, not the square.
#[test]
fn a_texture_of_sixteen_thousand() {
    const SIDE: usize = 16_384;
    let texel = |x: f32, y: f32| Vec2::new(x, y) / SIDE as f32;
    let last = SIDE as f32;
    let uvs = vec![
        texel(0.0, 0.0),
        texel(9.0, 0.0),
        texel(9.0, 9.0),
        texel(last - 9.0, last - 9.0),
        texel(last, last - 9.0),
        texel(last, last),
    ];
    let mesh = soup(
        uvs.iter().map(|p| Vec3::new(p.x, 0.0, p.y)).collect(),
        uvs,
        vec![[0, 2, 1], [3, 5, 4]],
    );
    let texels = Texels::rasterize(&mesh, SIDE, SIDE);
    assert!((80..200).contains(&texels.len()), "{}", texels.len());
    assert_eq!(texels.cell.first(), Some(&0));
    assert_eq!(
        texels.cell.last(),
        Some(&(u32::try_from(SIDE * SIDE - 1).expect("fits"))),
        "the last texel is a 28-bit number"
    );
    for i in 0..texels.len() {
        let (x, y) = (
            texels.cell[i] as usize % SIDE,
            texels.cell[i] as usize / SIDE,
        );
        let p = texels.position(&mesh, i) * SIDE as f32;
        assert!(
            (p.x - x as f32 - 0.5).abs() < 1.01 && (p.z - y as f32 - 0.5).abs() < 1.01,
            "({x}, {y}) lies at {p}"
        );
    }
}

/// One scene, one formula, two precisions: a room with a lamp, its walls seen by cameras.
/// Irradiance by quadrature, specular reflection, albedo from what a camera would see, and the
/// roughness derivative, in f32 against f64.
#[test]
fn the_same_scene_in_single_and_double_precision() {
    fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }
    fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    }
    fn towards<T: Real>(from: [T; 3], to: [T; 3]) -> ([T; 3], T) {
        let d = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
        let length = dot(d, d).sqrt();
        (d.map(|x| x / length), length)
    }
    /// (irradiance, specular radiance, its derivative in R, albedo recovered from diffuse +
    /// specular)
    fn look<T: Real>(point: [f64; 3], camera: [f64; 3], roughness: f64) -> [T; 4] {
        const STEPS: usize = 64;
        let lit = |v: [f64; 3]| v.map(T::lit);
        let (p, n, lamp_normal) = (lit(point), lit([0.0, 1.0, 0.0]), lit([0.0, -1.0, 0.0]));
        let (v, _) = towards(p, lit(camera));
        let r = T::lit(roughness);
        let (mut e, mut s, mut ds) = (T::lit(0.0), T::lit(0.0), T::lit(0.0));
        for i in 0..STEPS * STEPS {
            let at = |k: usize| 1.5 + (k as f64 + 0.5) / STEPS as f64;
            let (l, distance) = towards(p, lit([at(i % STEPS), 2.9, at(i / STEPS)]));
            let n_l = dot(n, l).max(T::lit(0.0));
            let weight = T::lit(40.0) * n_l * (-dot(lamp_normal, l))
                / (distance.sq() * T::lit((STEPS * STEPS) as f64));
            let half = [v[0] + l[0], v[1] + l[1], v[2] + l[2]];
            let length = dot(half, half).sqrt();
            let h = half.map(|x| x / length);
            let nxh = cross(n, h);
            let (f, df) = specular_d_roughness(n_l, dot(n, v), dot(nxh, nxh), dot(v, h), r);
            e = e + weight;
            s = s + weight * f;
            ds = ds + weight * df;
        }
        let pi = T::lit(std::f64::consts::PI);
        let seen = T::lit(0.37) * e / pi + s;
        [e, s, ds, (seen - s) * pi / e]
    }
    let mut worst = [0.0f64; 4];
    for (i, point) in [
        [1.0, 0.0, 1.0],
        [2.0, 0.0, 2.0],
        [3.9, 0.0, 0.1],
        [2.0, 0.0, 4.9],
    ]
    .into_iter()
    .enumerate()
    {
        for camera in [[2.0, 1.5, 2.5], [0.3, 0.02, 0.4], [3.0, 2.0, 3.0]] {
            for roughness in [0.03, 0.1, 0.3, 0.8] {
                let (single, double) = (
                    look::<f32>(point, camera, roughness),
                    look::<f64>(point, camera, roughness),
                );
                let scale = [
                    double[0],
                    double[1],
                    double[2].abs().max(double[1] / roughness),
                    double[3],
                ];
                for k in 0..4 {
                    let error = (f64::from(single[k]) - double[k]).abs() / scale[k].max(1e-30);
                    assert!(
                        error.is_finite(),
                        "point {i} R {roughness}: {single:?} {double:?}"
                    );
                    worst[k] = worst[k].max(error);
                }
            }
        }
    }
    println!(
        "f32 against f64: irradiance {:.1e}, specular {:.1e}, its derivative {:.1e}, albedo {:.1e}",
        worst[0], worst[1], worst[2], worst[3]
    );
    // 4,096 terms summed in f32: a few hundred roundings of 6e-8; a highlight's tail multiplies the
    // rounding of its half vector
    assert!(worst[0] < 1e-5 && worst[3] < 1e-4, "{worst:?}");
    assert!(worst[1] < 1e-3 && worst[2] < 1e-3, "{worst:?}");
}

/// A million charts of one texel each, and as many triangles: linear, not quadratic.
#[test]
fn a_million_tiny_charts_in_bounded_time() {
    const N: usize = 1000;
    let mut mesh = Mesh::default();
    for i in 0..N * N {
        let corner = Vec2::new((i % N) as f32, (i / N) as f32);
        let base = mesh.positions.len() as u32;
        for offset in [
            Vec2::new(0.2, 0.2),
            Vec2::new(0.8, 0.2),
            Vec2::new(0.2, 0.8),
        ] {
            let p = corner + offset;
            mesh.positions.push(Vec3::new(p.x, 0.0, p.y));
            mesh.uvs.push(p / N as f32);
            mesh.normals.push(Vec3::Y);
        }
        mesh.triangles.push([base, base + 2, base + 1]);
    }
    let start = std::time::Instant::now();
    let texels = Texels::rasterize(&mesh, N, N);
    let filled = fill_uncovered(
        &texels.scatter(&vec![1.0f32; texels.len()], 0.0),
        &texels.scatter(&vec![true; texels.len()], false),
    );
    let seconds = start.elapsed().as_secs_f64();
    assert_eq!(texels.len(), N * N);
    assert!(filled.data.iter().all(|v| *v == 1.0));
    assert!(seconds < 20.0, "{seconds:.1} s");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Helmholtz: view and light may be exchanged; nothing is negative; no view sees more than a
    /// mirror sends.
    #[test]
    fn the_lobe_is_reciprocal_and_finite(n_l in 0.0f32..=1.0, n_v in 0.0f32..=1.0, s in 0.0f32..=1.0, v_h in 0.0f32..=1.0, r in 0.001f32..=1.0) {
        let f = specular(n_l, n_v, s, v_h, r);
        prop_assert!(f.is_finite() && f >= 0.0);
        let g = specular(n_v, n_l, s, v_h, r);
        prop_assert!((f - g).abs() <= 1e-6 * f.max(1e-30));
    }

    /// In a closed box of any shape, place and constant radiance, E = πL at any point of any wall.
    #[test]
    fn any_box_is_a_furnace(
        size in prop::array::uniform3(0.01f32..50.0),
        place in prop::array::uniform3(-20.0f32..20.0),
        radiance in 1e-4f32..1e4,
        wall in 0usize..6,
        at in prop::array::uniform2(0.02f32..0.98),
    ) {
        let lo = Vec3::from(place);
        let quads = box_quads(lo, lo + Vec3::from(size), radiance);
        let lit = Lit::new(&quads, Environment::black());
        let q = quads[wall];
        let receiver = unbake::irradiance::Receiver { position: q.at(at[0], at[1]), normal: q.normal(), face_normal: q.normal(), key: 7 };
        let out = bake_irradiance(&lit.bake(), 1, |_| receiver, &IrradianceOptions::default(), &Progress::silent());
        let relative = out.value[0].x / (std::f32::consts::PI * radiance);
        prop_assert!((relative - 1.0).abs() < 1e-4, "{relative}");
    }

    /// Every texel of a random triangle is its nearest point; centres inside map to themselves.
    #[test]
    fn rasterised_texels_lie_on_their_triangle(uv in prop::array::uniform6(-0.2f32..1.2), side in 1usize..40) {
        let uvs = vec![Vec2::new(uv[0], uv[1]), Vec2::new(uv[2], uv[3]), Vec2::new(uv[4], uv[5])];
        let mesh = soup(uvs.iter().map(|p| Vec3::new(p.x, p.y, 0.0)).collect(), uvs, vec![[0, 1, 2]]);
        let texels = Texels::rasterize(&mesh, side, side);
        for i in 0..texels.len() {
            let c = texels.cell[i] as usize;
            let centre = (Vec2::new((c % side) as f32, (c / side) as f32) + 0.5) / side as f32;
            let p = texels.position(&mesh, i);
            let offset = (Vec2::new(p.x, p.y) - centre).abs().max_element() * side as f32;
            prop_assert!(offset <= 1.001, "{offset} texels off");
            prop_assert!(!texels.interior[i] || offset < 0.02, "inside, yet {offset} texels off");
        }
    }

    /// Filling keeps what is covered and invents nothing beyond its range.
    #[test]
    fn filling_stays_in_range(values in prop::collection::vec((0.0f32..10.0, any::<bool>()), 1..200), width in 1usize..20) {
        let height = values.len().div_ceil(width);
        let mut plane = Plane::filled(width, height, 0.0f32);
        let mut covered = Plane::filled(width, height, false);
        for (i, (v, c)) in values.iter().enumerate() {
            plane.data[i] = if *c { *v } else { -1.0 };
            covered.data[i] = *c;
        }
        let filled = fill_uncovered(&plane, &covered);
        let kept: Vec<f32> = plane.data.iter().zip(&covered.data).filter(|(_, c)| **c).map(|(v, _)| *v).collect();
        if !kept.is_empty() {
            let (lo, hi) = kept.iter().fold((f32::MAX, f32::MIN), |b, v| (b.0.min(*v), b.1.max(*v)));
            prop_assert!(filled.data.iter().all(|v| *v >= lo - 1e-4 && *v <= hi + 1e-4));
            prop_assert!(plane.data.iter().zip(&covered.data).zip(&filled.data).all(|((v, c), f)| !c || v == f));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the photographs of a room hold and whatever is asked for: the result is finite, in
    /// range and whole.
    #[test]
    fn any_photographs_and_options_give_finite_materials(
        pixels in prop::collection::vec(prop_oneof![Just(0.0f32), 1e-6f32..1.0, 1.0f32..1e6], 64),
        sizes in prop::array::uniform3(1usize..80),
        rays in prop::array::uniform4(0u32..12),
        forced in prop::array::uniform4(0usize..3),
        reduction in 1usize..5,
        rounds in 1u32..4,
        labelled in any::<bool>(),
        seed in any::<u64>(),
    ) {
        let dir = room_of_noise(&pixels, labelled);
        let scene = Scene::load(dir.folder(), &LoadOptions::default()).expect("usable");
        let switch = |k: usize| [Switch::Auto, Switch::On, Switch::Off][forced[k]];
        let options = SolveOptions {
            albedo_size: sizes[0],
            roughness_size: sizes[1],
            irradiance_size: sizes[2],
            photo_reduction: reduction,
            irradiance_rays: rays[0],
            emitter_samples: rays[1],
            irradiance_rounds: rounds,
            irradiance_filter: forced[0] != 1,
            prefilter: forced[1] != 1,
            evidence_points: 20,
            evidence_rays: rays[2],
            roughness_levels: 3 + rays[2] as usize,
            specular_rays: rays[3],
            matte: switch(0),
            emission: switch(1),
            environment: switch(2),
            rooms: switch(3),
            seed,
            ..SolveOptions::default()
        };
        let result = reconstruct(&scene, &options, &Progress::silent());
        if rays[0] == 0 && rays[1] == 0 {
            // Nothing would be lit: said, not computed.
            prop_assert!(matches!(result, Err(unbake::Error::Usage(_))));
            return Ok(());
        }
        let s = result.expect("reconstructs").solution;
        for plane in [&s.albedo, &s.irradiance, &s.radiance, &s.emission, &s.environment] {
            prop_assert!(plane.data.iter().all(|v| v.is_finite() && v.min_element() >= 0.0));
        }
        prop_assert!(s.albedo.data.iter().all(|v| v.max_element() <= 1.0));
        prop_assert!(s.roughness.data.iter().all(|r| (0.0..=1.0).contains(r)));
        prop_assert!(s.confidence.data.iter().all(|c| c.is_finite() && c.min_element() >= 0.0));
        prop_assert!(options.emission != Switch::Off || s.emission.data.iter().all(|e| *e == Vec3::ZERO));
        prop_assert_eq!((s.albedo.width, s.roughness.width, s.irradiance.width), (sizes[0], sizes[1], sizes[2]));
    }
}

/// A room whose two photographs repeat 64 values.
fn room_of_noise(pixels: &[f32], labelled: bool) -> common::SceneDir {
    let dir = common::SceneDir::box_room();
    let value = |i: usize| pixels[i % pixels.len()];
    for (k, stem) in ["a", "b"].into_iter().enumerate() {
        let image = Plane {
            width: common::WIDTH,
            height: common::HEIGHT,
            data: (0..common::WIDTH * common::HEIGHT)
                .map(|i| Vec3::new(value(i * 7 + k), value(i * 3 + k), value(i + k)))
                .collect(),
        };
        formats::write_rgb_float(dir.path(&format!("{stem}.exr")), &image).expect("image");
    }
    if !labelled {
        dir.edit(|json| {
            let frames = json["frames"].as_array_mut().expect("frames");
            for frame in frames {
                frame.as_object_mut().expect("frame").remove("label_path");
            }
        });
    }
    dir
}

/// Surfaces at the photographs' ceiling are lights, and none where nothing may emit.
#[test]
fn no_light_is_emission_where_emission_is_off() {
    let mut pixels = [0.0f32; 64];
    let bright = [
        0.203_873_87,
        988_456.7,
        267_421.78,
        0.0,
        988_096.25,
        381_831.34,
        0.310_734_6,
        833_284.8,
    ];
    pixels[54..62].copy_from_slice(&bright);
    let dir = room_of_noise(&pixels, false);
    let scene = Scene::load(dir.folder(), &LoadOptions::default()).expect("usable");
    let emitting = |emission| {
        let options = SolveOptions {
            albedo_size: 68,
            roughness_size: 59,
            irradiance_size: 20,
            photo_reduction: 2,
            irradiance_rays: 3,
            emitter_samples: 3,
            irradiance_rounds: 2,
            evidence_points: 20,
            evidence_rays: 4,
            roughness_levels: 7,
            specular_rays: 8,
            emission,
            rooms: Switch::Off,
            seed: 17_668_992_816_828_570_824,
            ..SolveOptions::default()
        };
        let solved = reconstruct(&scene, &options, &Progress::silent()).expect("reconstructs");
        let emission = solved.solution.emission;
        emission.data.iter().filter(|e| **e != Vec3::ZERO).count()
    };
    assert!(emitting(Switch::Auto) > 0, "found where it may be");
    assert_eq!(emitting(Switch::Off), 0);
}

/// What was tested above is also what a mesh of quads holds: two triangles each, facing as stated.
#[test]
fn the_scene_builder_builds_what_it_says() {
    let quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 1.0);
    let mesh = mesh_of(&quads);
    for (i, q) in quads.iter().enumerate() {
        assert!((mesh.face_normal(2 * i) - q.normal()).length() < 1e-6);
        assert!(
            (Vec3::new(2.0, 1.5, 2.5) - q.at(0.5, 0.5)).dot(q.normal()) > 0.0,
            "walls face inwards"
        );
    }
}
