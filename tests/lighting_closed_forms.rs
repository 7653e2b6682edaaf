//! Irradiance against closed forms and quadrature: furnaces, lamps, windows, doorways, walls
//! without thickness.

mod common;

use common::lit::{
    Lit, Quad, box_quads, framed, lambert, mesh_of, quad, quadrature, radiance_of, receivers_on,
};
use glam::{DVec3, Mat3, Vec2, Vec3};
use std::f64::consts::PI;
use unbake::core::geometry::{Camera, Projection};
use unbake::core::image::Plane;
use unbake::core::math::luminance;
use unbake::core::progress::Progress;
use unbake::core::texture::Texels;
use unbake::core::trace::{EmbreeTracer, Hit};
use unbake::gbuffer::{Orientation, ViewBuffer};
use unbake::irradiance::{
    Estimator, Irradiance, IrradianceOptions, Receiver, SampleBudget, Surfel, bake_irradiance,
    bake_surface,
};
use unbake::radiance::{Environment, LightField, SurfaceRadiance};

const ALL: [Estimator; 3] = [Estimator::Uniform, Estimator::Cosine, Estimator::Mis];

fn options(estimator: Estimator, rays: u32) -> IrradianceOptions {
    IrradianceOptions {
        estimator,
        rays,
        emitter_samples: rays / 4,
        ..IrradianceOptions::default()
    }
}

fn bake(lit: &Lit, receivers: &[Receiver], options: &IrradianceOptions) -> Irradiance {
    let out = bake_irradiance(
        &lit.bake(),
        receivers.len(),
        |i| receivers[i],
        options,
        &Progress::silent(),
    );
    assert!(
        out.value
            .iter()
            .all(|e| e.is_finite() && e.min_element() >= 0.0),
        "irradiance is finite and not negative"
    );
    assert!(out.error.iter().all(|e| e.is_finite() && *e >= 0.0));
    out
}

/// As [`bake`], its samples doubled `times` by bakes that continue it.
fn continued(
    lit: &Lit,
    receivers: &[Receiver],
    options: &IrradianceOptions,
    times: u32,
) -> Irradiance {
    let all: Vec<u32> = (0..receivers.len() as u32).collect();
    let mut out = bake(lit, receivers, options);
    for k in 0..times {
        let [rays, lights] = [options.rays << k, options.emitter_samples << k];
        let more = IrradianceOptions {
            drawn: [rays, lights],
            rays,
            emitter_samples: lights,
            ..options.clone()
        };
        out.double(&all, &bake(lit, receivers, &more));
    }
    out
}

/// Root mean square and largest relative error against expected luminances.
fn errors(got: &Irradiance, expected: &[f64]) -> (f64, f64) {
    let relative: Vec<f64> = got
        .value
        .iter()
        .zip(expected)
        .map(|(e, x)| f64::from(luminance(*e)) / x - 1.0)
        .collect();
    let rms = (relative.iter().map(|r| r * r).sum::<f64>() / relative.len() as f64).sqrt();
    (rms, relative.iter().fold(0.0, |m, r| m.max(r.abs())))
}

/// Every texel of a mesh as the pipeline sees it, borders and corners included.
fn texel_receivers(quads: &[Quad], side: usize) -> Vec<Receiver> {
    let mesh = mesh_of(quads);
    let texels = Texels::rasterize(&mesh, side, side);
    (0..texels.len())
        .map(|i| {
            let (t, (u, v)) = (texels.point[i].triangle as usize, texels.ray_point(i));
            let n = mesh.face_normal(t);
            Receiver {
                position: mesh.position(t, u, v),
                normal: n,
                face_normal: n,
                key: u64::from(texels.cell[i]),
            }
        })
        .collect()
}

#[test]
fn a_white_furnace_gives_pi_everywhere_corners_included() {
    for (lo, hi) in [
        (Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0)),
        (Vec3::splat(-0.002), Vec3::splat(0.002)),
        (Vec3::ZERO, Vec3::splat(3e4)),
    ] {
        let quads = box_quads(lo, hi, 1.0);
        let receivers = texel_receivers(&quads, 96);
        assert!(receivers.len() > 4_000);
        let lit = Lit::new(&quads, Environment::black());
        for estimator in [Estimator::Cosine, Estimator::Mis] {
            let (_, worst) = errors(
                &bake(&lit, &receivers, &options(estimator, 64)),
                &vec![PI; receivers.len()],
            );
            assert!(
                worst < 2e-5,
                "{estimator:?}, box of {}: {worst:.1e}",
                hi - lo
            );
        }
        let some: Vec<Receiver> = receivers.iter().copied().step_by(29).collect();
        let (rms, worst) = errors(
            &bake(&lit, &some, &options(Estimator::Uniform, 2048)),
            &vec![PI; some.len()],
        );
        assert!(
            rms < 2e-3 && worst < 1e-2,
            "uniform: {rms:.1e}, at worst {worst:.1e}"
        );
    }
}

/// All walls emit: lamps everywhere, the hardest furnace for light sampling, where distances to the
/// next wall go to zero.
#[test]
fn a_furnace_of_emitting_walls_gives_pi_too() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 1.0);
    quads.iter_mut().for_each(|q| q.emits = true);
    let receivers = texel_receivers(&quads, 48);
    let lit = Lit::new(&quads, Environment::black());
    let (rms, worst) = errors(
        &bake(&lit, &receivers, &options(Estimator::Mis, 256)),
        &vec![PI; receivers.len()],
    );
    assert!(
        rms < 0.02 && worst < 0.12,
        "{rms:.1e}, at worst {worst:.1e}"
    );
}

#[test]
fn a_box_of_constant_radiance_scales_with_it_bit_for_bit_over_a_hundred_powers_of_two() {
    let mut one = None;
    for exponent in [-60i32, -20, 0, 20, 40] {
        let scale = 2f32.powi(exponent);
        let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.7 * scale);
        quads.push(quad(
            [1.0, 2.9, 1.0],
            [0.5, 0.0, 0.0],
            [0.0, 0.0, 0.5],
            9.0 * scale,
            true,
        ));
        let receivers = receivers_on(&quads[0], 8);
        let lit = Lit::new(&quads, Environment::black());
        let e = bake(&lit, &receivers, &options(Estimator::Mis, 64));
        let scaled: Vec<Vec3> = e.value.iter().map(|v| *v / scale).collect();
        let reference = one.get_or_insert_with(|| (scaled.clone(), e.error.clone()));
        assert_eq!(
            (&reference.0, &reference.1),
            (&scaled, &e.error),
            "exposure 2^{exponent} changes bits"
        );
    }
}

/// A room of black walls with one rectangular lamp under the ceiling.
fn lamp_room(lamp: Quad) -> Vec<Quad> {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    quads.push(lamp);
    quads
}

#[test]
fn a_rectangular_lamp_meets_lamberts_formula_with_every_estimator() {
    let lamp = quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true);
    let quads = lamp_room(lamp);
    let receivers: Vec<Receiver> = [0, 2, 5]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 9))
        .collect();
    let lit = Lit::new(&quads, Environment::black());
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| 7.0 * lambert(&lamp.corners(), r.position, r.normal))
        .collect();
    for (estimator, rays, bound) in [
        (Estimator::Uniform, 4096, 0.05),
        (Estimator::Cosine, 4096, 0.03),
        (Estimator::Mis, 256, 0.03),
    ] {
        let got = bake(&lit, &receivers, &options(estimator, rays));
        let (rms, worst) = errors(&got, &expected);
        assert!(rms < bound, "{estimator:?}: {rms:.4}, at worst {worst:.3}");
        // the stated error is of the true error's size: neither boasting nor wildly modest
        let stated = (got.error.iter().map(|e| f64::from(e * e)).sum::<f64>()
            / got.error.len() as f64)
            .sqrt();
        println!("{estimator:?}: rms {rms:.5}, stated {stated:.5}, worst {worst:.4}");
        assert!(
            stated > 0.5 * rms,
            "{estimator:?}: states {stated:.4}, is {rms:.4}"
        );
    }
}

/// A lamp's glass below a plate as bright, and two lamps in one place: the light arrives once.
#[test]
fn what_a_lamp_covers_does_not_shine_through_it() {
    let lamp = quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true);
    let frame = quad([0.8, 2.9, 1.1], [2.2, 0.0, 0.0], [0.0, 0.0, 2.6], 7.0, true);
    let raised = |quad: Quad, gap: f32| Quad {
        corner: quad.corner + Vec3::Y * gap,
        ..quad
    };
    let cases = [
        ("frame", raised(frame, 8e-4)),
        (
            "plate",
            Quad {
                emits: false,
                ..raised(lamp, 8e-4)
            },
        ),
        ("thin plate", raised(lamp, 2e-5)),
        ("twin", lamp),
    ];
    for (name, behind) in cases {
        let mut quads = lamp_room(lamp);
        quads.push(behind);
        // (from a wall one sees through the gap)
        let receivers = receivers_on(&quads[0], 16);
        let light = |r: &Receiver| 7.0 * lambert(&behind.corners(), r.position, r.normal);
        let expected: Vec<f64> = receivers.iter().map(light).collect();
        let got = bake(
            &Lit::new(&quads, Environment::black()),
            &receivers,
            &options(Estimator::Mis, 256),
        );
        let (rms, worst) = errors(&got, &expected);
        assert!(rms < 0.05, "{name}: {rms:.4}, at worst {worst:.3}");
    }
}

/// Where a wall shares a texel with a lamp, the wall is as bright for an emitter sample as for a
/// ray that hits it.
#[test]
fn a_texel_shared_with_a_lamp_counts_once() {
    let lamp = quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true);
    let mut quads = lamp_room(lamp);
    // a wall that is sampled too, for it is brighter than most, and whose texels belong to the lamp
    quads[3].radiance = Vec3::splat(4.0);
    let mesh = mesh_of(&quads);
    let orientation = Orientation::of_winding(mesh.triangles.len());
    let radiance = radiance_of(&quads, |q| {
        if q.radiance.x > 0.0 {
            q.radiance
        } else {
            Vec3::ZERO
        }
    });
    let emitting = radiance.map(|r| r.x > 0.0);
    let emissive: Vec<bool> = quads.iter().flat_map(|q| [q.emits; 2]).collect();
    let environment = Environment::black();
    let field = LightField::new(
        &mesh,
        &orientation,
        SurfaceRadiance {
            radiance,
            emissive: emitting,
            emissive_triangles: &emissive,
            back: Vec::new(),
        },
        environment,
    );
    for t in 0..mesh.triangles.len() {
        let hit = Hit {
            t: 1.0,
            u: 0.3,
            v: 0.4,
            triangle: t as u32,
        };
        assert_eq!(
            field.emitted(t, 0.3, 0.4),
            field.arriving(&hit, -field.outward_normal(t), 0.0),
            "triangle {t}"
        );
    }
}

/// 5 cm across, radiance 1e5, three metres away: 3e-5 of the hemisphere, which hemisphere rays
/// hardly ever find.
#[test]
fn a_spotlight_of_five_centimetres_and_radiance_1e5() {
    let lamp = quad(
        [2.0, 2.95, 2.0],
        [0.05, 0.0, 0.0],
        [0.0, 0.0, 0.05],
        1e5,
        true,
    );
    let quads = lamp_room(lamp);
    let receivers: Vec<Receiver> = [0, 2, 5]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 16))
        .collect();
    let lit = Lit::new(&quads, Environment::black());
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| 1e5 * lambert(&lamp.corners(), r.position, r.normal))
        .collect();
    let (rms, worst) = errors(
        &bake(&lit, &receivers, &IrradianceOptions::default()),
        &expected,
    );
    assert!(rms < 5e-3 && worst < 0.1, "{rms:.1e}, at worst {worst:.1e}");
}

#[test]
fn four_hundred_lamps() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(20.0, 4.0, 20.0), 0.0);
    for i in 0..400u32 {
        let (x, z) = ((i % 20) as f32 + 0.5, (i / 20) as f32 + 0.5);
        let bright = 10.0 + 90.0 * (i * 7 % 13) as f32 / 12.0;
        quads.push(quad(
            [x - 0.05, 3.9, z - 0.05],
            [0.1, 0.0, 0.0],
            [0.0, 0.0, 0.1],
            bright,
            true,
        ));
    }
    let receivers = receivers_on(&quads[0], 12);
    let lit = Lit::new(&quads, Environment::black());
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| {
            quads[6..]
                .iter()
                .map(|q| f64::from(q.radiance.x) * lambert(&q.corners(), r.position, r.normal))
                .sum()
        })
        .collect();
    let (rms, worst) = errors(
        &bake(&lit, &receivers, &options(Estimator::Mis, 256)),
        &expected,
    );
    assert!(rms < 0.08 && worst < 0.3, "{rms:.3}, at worst {worst:.3}");
    // unbiased: the mean over receivers is far more precise than any of them
    let got = bake(&lit, &receivers, &options(Estimator::Mis, 1024));
    let (sum, truth): (f64, f64) = (
        got.value.iter().map(|e| f64::from(e.x)).sum(),
        expected.iter().sum(),
    );
    assert!(
        (sum / truth - 1.0).abs() < 0.01,
        "mean off by {:.4}",
        sum / truth - 1.0
    );
}

/// A sky that is brighter to one side, smooth on the scale of the map.
fn sky() -> (Environment, impl Fn(Vec3) -> Vec3 + Copy) {
    let radiance = |d: Vec3| Vec3::new(3.0 + 2.0 * d.z, 4.0 + 2.0 * d.y, 5.0);
    let mut map = Plane::filled(256, 128, Vec3::ZERO);
    let camera = Camera {
        projection: Projection::Equirectangular,
        width: 256,
        height: 128,
        world_from_camera: Mat3::IDENTITY,
        position: Vec3::ZERO,
    };
    for y in 0..128 {
        for x in 0..256 {
            map[(x, y)] = radiance(camera.direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)));
        }
    }
    (Environment::from_map(map), radiance)
}

/// The box with a window in its x+ wall, and the opening as a quad that faces inwards.
fn window_room() -> (Vec<Quad>, Quad) {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let wall = quads.remove(3);
    let (lo, hi) = (Vec2::new(0.3, 0.35), Vec2::new(0.7, 0.85));
    let opening = Quad {
        corner: wall.at(lo.x, lo.y),
        edge_u: wall.edge_u * 0.4,
        edge_v: wall.edge_v * 0.5,
        ..wall
    };
    quads.extend(framed(wall, lo, hi));
    (quads, opening)
}

#[test]
fn a_window_is_the_sky_behind_it() {
    let (quads, opening) = window_room();
    let receivers: Vec<Receiver> = [0, 2, 4]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 7))
        .collect();
    let (environment, radiance) = sky();
    let lit = Lit::new(&quads, environment);
    assert!(lit.emitters.lamp_count() > 0, "the opening is sampled");
    let expected: Vec<DVec3> = receivers
        .iter()
        .map(|r| quadrature(&opening, r.position, r.normal, 200, None, radiance))
        .collect();
    for (estimator, rays, bound) in [
        (Estimator::Uniform, 4096, 0.06),
        (Estimator::Cosine, 4096, 0.05),
        (Estimator::Mis, 1024, 0.05),
    ] {
        let got = bake(&lit, &receivers, &options(estimator, rays));
        for channel in [0usize, 1, 2] {
            let relative = |i: usize| f64::from(got.value[i][channel]) / expected[i][channel] - 1.0;
            let rms = ((0..receivers.len())
                .map(|i| relative(i).powi(2))
                .sum::<f64>()
                / receivers.len() as f64)
                .sqrt();
            assert!(rms < bound, "{estimator:?}, channel {channel}: {rms:.4}");
            let mean = (0..receivers.len()).map(relative).sum::<f64>() / receivers.len() as f64;
            assert!(
                mean.abs() < 0.3 * bound,
                "{estimator:?}, channel {channel}: mean {mean:.4}"
            );
        }
    }
}

/// A window of 12 × 9 cm before a sky of radiance 1e4: as hard as a spotlight, and only the
/// environment knows of it.
#[test]
fn a_small_window_onto_a_bright_sky() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let wall = quads.remove(3);
    let (lo, hi) = (Vec2::new(0.4, 0.5), Vec2::new(0.424, 0.53));
    let opening = Quad {
        corner: wall.at(lo.x, lo.y),
        edge_u: wall.edge_u * 0.024,
        edge_v: wall.edge_v * 0.03,
        ..wall
    };
    quads.extend(framed(wall, lo, hi));
    let receivers: Vec<Receiver> = [0, 1, 2]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 12))
        .collect();
    let lit = Lit::new(
        &quads,
        Environment::from_map(Plane::filled(64, 32, Vec3::splat(1e4))),
    );
    assert!(lit.emitters.lamp_count() > 0, "the opening is sampled");
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| 1e4 * lambert(&opening.corners(), r.position, r.normal))
        .collect();
    let got = bake(
        &lit,
        &receivers,
        &IrradianceOptions {
            rays: 256,
            emitter_samples: 256,
            ..IrradianceOptions::default()
        },
    );
    let (rms, worst) = errors(&got, &expected);
    println!("small window: rms {rms:.4}, worst {worst:.3}");
    assert!(rms < 0.06 && worst < 0.3, "{rms:.4}, at worst {worst:.3}");
    let (sum, truth): (f64, f64) = (
        got.value.iter().map(|e| f64::from(e.x)).sum(),
        expected.iter().sum(),
    );
    assert!(
        (sum / truth - 1.0).abs() < 0.01,
        "mean off by {:.4}",
        sum / truth - 1.0
    );
}

/// Sunlight on a piece of floor: a reflecting surface, not an emitter, but 400 times brighter than
/// the grey walls around.
#[test]
fn a_sun_patch_on_the_floor_lights_the_room() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.5);
    let patch = quad(
        [1.5, 0.0, 2.0],
        [0.0, 0.0, 0.4],
        [0.3, 0.0, 0.0],
        200.0,
        false,
    );
    let floor = quads[0];
    let fraction = |p: f32, edge: Vec3| p / edge.length();
    let (lo, hi) = (
        Vec2::new(fraction(2.0, floor.edge_u), fraction(1.5, floor.edge_v)),
        Vec2::new(fraction(2.4, floor.edge_u), fraction(1.8, floor.edge_v)),
    );
    quads.splice(0..1, framed(floor, lo, hi));
    quads.push(patch);
    let n = quads.len();
    let receivers: Vec<Receiver> = (4..n - 1)
        .flat_map(|q| receivers_on(&quads[q], 8))
        .collect();
    let lit = Lit::new(&quads, Environment::black());
    assert!(lit.emitters.lamp_count() > 0, "the patch is sampled");
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| 0.5 * PI + (200.0 - 0.5) * lambert(&patch.corners(), r.position, r.normal))
        .collect();
    for (estimator, rays, bound) in [
        (Estimator::Uniform, 4096, 0.15),
        (Estimator::Cosine, 4096, 0.15),
        (Estimator::Mis, 128, 0.01),
    ] {
        let got = bake(&lit, &receivers, &options(estimator, rays));
        let (rms, worst) = errors(&got, &expected);
        println!("sun patch, {estimator:?}: rms {rms:.5}, worst {worst:.4}");
        assert!(
            rms < bound && worst < 12.0 * bound,
            "{estimator:?}: {rms:.4}, at worst {worst:.3}"
        );
        let (sum, truth): (f64, f64) = (
            got.value.iter().map(|e| f64::from(e.x)).sum(),
            expected.iter().sum(),
        );
        assert!(
            (sum / truth - 1.0).abs() < 0.2 * bound,
            "{estimator:?}: mean off by {:.5}",
            sum / truth - 1.0
        );
    }
}

/// Two rooms side by side along x, the lamp in the first, a doorway of 1 × 2 m in the wall between.
fn two_rooms(doorway: bool, sheets: &[f32]) -> (Vec<Quad>, Quad) {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(8.0, 3.0, 4.0), 0.0);
    // each room has its own floor: their common edge lies below the wall
    let (floor, half) = (quads[0], quads[0].edge_v * 0.5);
    quads[0].edge_v = half;
    quads.push(Quad {
        corner: floor.corner + half,
        edge_v: half,
        ..floor
    });
    for (i, &x) in sheets.iter().enumerate() {
        let sheet = quad([x, 0.0, 0.0], [0.0, 0.0, 4.0], [0.0, 3.0, 0.0], 0.0, false);
        let sheet = if i % 2 == 1 { sheet.flipped() } else { sheet };
        let (lo, hi) = (Vec2::new(0.4, 0.0), Vec2::new(0.65, 0.7));
        let (lo, hi) = if i % 2 == 1 {
            (Vec2::new(lo.y, lo.x), Vec2::new(hi.y, hi.x))
        } else {
            (lo, hi)
        };
        if doorway {
            quads.extend(framed(sheet, lo, hi))
        } else {
            quads.push(sheet)
        }
    }
    let lamp = quad(
        [1.0, 2.9, 1.5],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        20.0,
        true,
    );
    quads.push(lamp);
    (quads, lamp)
}

#[test]
fn a_room_lit_only_through_a_doorway() {
    let (quads, lamp) = two_rooms(true, &[4.0]);
    let far_wall = quads[3];
    let floor = Quad {
        corner: Vec3::new(4.2, 0.0, 0.3),
        edge_u: Vec3::Z * 3.4,
        edge_v: Vec3::X * 3.6,
        ..quads[0]
    };
    let receivers: Vec<Receiver> = [floor, far_wall]
        .iter()
        .flat_map(|q| receivers_on(q, 12))
        .collect();
    let lit = Lit::new(&quads, Environment::black());
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| {
            quadrature(&lamp, r.position, r.normal, 64, Some(&lit.tracer), |_| {
                lamp.radiance
            })
            .x
        })
        .collect();
    assert!(
        expected.iter().filter(|e| **e > 0.0).count() > 40,
        "some receivers see the lamp"
    );
    let got = bake(&lit, &receivers, &options(Estimator::Mis, 2048));
    let brightest = expected.iter().fold(0.0f64, |a, b| a.max(*b));
    for (i, (e, x)) in got.value.iter().zip(&expected).enumerate() {
        let error = (f64::from(e.x) - x).abs();
        assert!(
            error < 0.03 * x + 0.01 * brightest,
            "{}: {} against {x}",
            receivers[i].position,
            e.x
        );
        assert!(
            *x > 0.0 || e.x < 2e-3 * brightest as f32,
            "light where none arrives: {} at {}",
            e.x,
            receivers[i].position
        );
    }
}

/// No texel of the dark room may see the lamp: neither through a wall without thickness, nor
/// through two sheets 2 mm apart, nor at the floor's own border texels below the wall.
#[test]
fn walls_without_thickness_do_not_leak() {
    for sheets in [&[4.0f32][..], &[4.0, 4.002]] {
        let (quads, _) = two_rooms(false, sheets);
        let receivers = texel_receivers(&quads, 160);
        let lit = Lit::new(&quads, Environment::black());
        let got = bake(&lit, &receivers, &IrradianceOptions::default());
        let end = sheets[sheets.len() - 1];
        let (mut dark, mut lit_ones) = (0, 0);
        for (r, e) in receivers.iter().zip(&got.value) {
            if r.position.x > end || (r.position.x > end - 1e-4 && r.normal.x > 0.5) {
                assert_eq!(
                    *e,
                    Vec3::ZERO,
                    "leak at {} facing {} behind the sheets {sheets:?}",
                    r.position,
                    r.normal
                );
                dark += 1;
            } else if r.position.x < 3.9 && r.normal.y > 0.5 {
                assert!(e.x > 0.05, "{} at {}", e.x, r.position);
                lit_ones += 1;
            }
        }
        assert!(dark > 1_000 && lit_ones > 500, "{dark} {lit_ones}");
    }
}

/// The floor below a cupboard, and a sheet in the middle of a solid: no light, no NaN.
#[test]
fn texels_inside_solids_are_dark_and_finite() {
    let mut quads = lamp_room(quad(
        [1.2, 2.9, 1.5],
        [1.4, 0.0, 0.0],
        [0.0, 0.0, 1.8],
        7.0,
        true,
    ));
    // a solid standing on the floor, seen from outside: the inside of its walls is a back side
    quads.extend(
        box_quads(Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 1.0, 2.0), 0.5)
            .into_iter()
            .map(Quad::flipped),
    );
    let receivers = texel_receivers(&quads, 128);
    let lit = Lit::new(&quads, Environment::black());
    let got = bake(&lit, &receivers, &IrradianceOptions::default());
    let mut hidden = 0;
    for (r, e) in receivers.iter().zip(&got.value) {
        let p = r.position;
        let inside = p.x > 1.01 && p.x < 1.99 && p.z > 1.01 && p.z < 1.99;
        if inside && p.y < 1e-5 && r.normal.y > 0.0 {
            assert_eq!(*e, Vec3::ZERO, "{p}");
            hidden += 1;
        }
    }
    assert!(hidden > 10);
}

fn panorama(position: Vec3) -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width: 128,
        height: 64,
        world_from_camera: Mat3::IDENTITY,
        position,
    }
}

/// A mesh wound the wrong way round shows its inner side to the cameras; the vote finds out and
/// nothing else changes.
#[test]
fn inverted_windings_change_nothing_once_the_cameras_have_voted() {
    let lamp = quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true);
    let good = lamp_room(lamp);
    let mut inverted: Vec<Quad> = good.clone();
    for q in inverted.iter_mut().skip(1).step_by(2) {
        *q = q.flipped();
    }
    inverted[6] = lamp.flipped();
    let receivers = receivers_on(&good[0], 8);
    let reference = Lit::new(&good, Environment::black());
    let expected: Vec<f64> = receivers
        .iter()
        .map(|r| 7.0 * lambert(&lamp.corners(), r.position, r.normal))
        .collect();
    let mesh = mesh_of(&inverted);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let buffers = [ViewBuffer::trace(
        &panorama(Vec3::new(2.0, 1.2, 2.5)),
        &tracer,
    )];
    let orientation = Orientation::vote(&mesh, &buffers.iter().collect::<Vec<_>>());
    assert_eq!(orientation.flipped(), 8, "ceiling, x+, z+ and the lamp");
    let turned = Lit::with(
        mesh,
        &inverted,
        &orientation,
        Vec::new(),
        Environment::black(),
    );
    for lit in [&reference, &turned] {
        let (rms, worst) = errors(
            &bake(lit, &receivers, &IrradianceOptions::default()),
            &expected,
        );
        assert!(rms < 0.08 && worst < 0.25, "{rms:.3} {worst:.3}");
    }
}

/// A sheet that hangs free in the room: rays that meet its far side see what was observed there.
#[test]
fn both_sides_of_a_sheet_have_their_own_radiance() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::splat(2.0), 0.0);
    quads.push(quad(
        [0.0, 1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 0.0, 2.0],
        3.0,
        false,
    )); // front faces down
    let (floor, ceiling) = (quads[0], quads[1]);
    let receivers: Vec<Receiver> = [receivers_on(&floor, 4), receivers_on(&ceiling, 4)].concat();
    let mesh = mesh_of(&quads);
    let orientation = Orientation::of_winding(mesh.triangles.len());
    let mut back = vec![Vec3::ZERO; mesh.triangles.len()];
    back[12] = Vec3::splat(5.0);
    back[13] = Vec3::splat(5.0);
    let lit = Lit::with(mesh, &quads, &orientation, back, Environment::black());
    let got = bake(&lit, &receivers, &options(Estimator::Cosine, 1024));
    for (i, (r, e)) in receivers.iter().zip(&got.value).enumerate() {
        let radiance = if i < 16 { 3.0 } else { 5.0 };
        let expected = radiance * lambert(&quads[6].corners(), r.position, r.normal);
        assert!(
            (f64::from(e.x) / expected - 1.0).abs() < 0.03,
            "{i}: {} against {expected}",
            e.x
        );
    }
}

/// Lamps, a window, grey walls: the three estimators have the same expectation at every receiver.
/// Per receiver the mean over independent seeds is compared by its standard error; over all
/// receivers the squares of the scores must average about one.
#[test]
fn estimators_agree_statistically() {
    const SEEDS: u64 = 24;
    let (mut quads, _) = window_room();
    quads
        .iter_mut()
        .enumerate()
        .for_each(|(i, q)| q.radiance = Vec3::splat(0.2 + 0.05 * i as f32));
    quads.push(quad(
        [0.5, 2.7, 0.5],
        [0.6, 0.0, 0.0],
        [0.0, 0.0, 0.6],
        15.0,
        true,
    ));
    quads.push(
        quad(
            [2.5, 1.0, 4.0],
            [0.3, 0.0, 0.0],
            [0.0, 0.3, 0.0],
            30.0,
            true,
        )
        .flipped(),
    );
    let receivers: Vec<Receiver> = [0, 1, 2, 3]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 6))
        .collect();
    let lit = Lit::new(&quads, sky().0);
    let moments = |estimator: Estimator| -> Vec<(f64, f64)> {
        let rays = if estimator == Estimator::Mis {
            128
        } else {
            512
        };
        let runs: Vec<Irradiance> = (0..SEEDS)
            .map(|seed| {
                bake(
                    &lit,
                    &receivers,
                    &IrradianceOptions {
                        seed: seed * 77 + 5,
                        ..options(estimator, rays)
                    },
                )
            })
            .collect();
        (0..receivers.len())
            .map(|i| {
                let x: Vec<f64> = runs
                    .iter()
                    .map(|r| f64::from(luminance(r.value[i])))
                    .collect();
                let mean = x.iter().sum::<f64>() / SEEDS as f64;
                let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
                    / (SEEDS - 1) as f64
                    / SEEDS as f64;
                (mean, variance)
            })
            .collect()
    };
    let all: Vec<_> = ALL.iter().map(|&e| moments(e)).collect();
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let scores: Vec<f64> = all[a]
            .iter()
            .zip(&all[b])
            .map(|((ma, va), (mb, vb))| (ma - mb) / (va + vb + (2e-4 * ma).powi(2)).sqrt())
            .collect();
        let n = scores.len() as f64;
        let (mean, square) = (
            scores.iter().sum::<f64>() / n,
            scores.iter().map(|z| z * z).sum::<f64>() / n,
        );
        let worst = scores.iter().fold(0.0f64, |m, z| m.max(z.abs()));
        println!(
            "{:?} and {:?}: mean z {mean:.3}, mean z² {square:.3}, worst {worst:.2}",
            ALL[a], ALL[b]
        );
        // Student with 23 degrees of freedom: z² averages 1.1; neighbouring receivers are
        // independent by their keys
        assert!(
            square < 1.6 && worst < 5.0 && mean.abs() < 4.0 / n.sqrt(),
            "{:?} and {:?} disagree",
            ALL[a],
            ALL[b]
        );
    }
}

/// Later rounds add samples to the ones already taken: every estimator stays unbiased.
#[test]
fn refinement_keeps_the_expectation() {
    let quads = lamp_room(quad(
        [1.2, 2.9, 1.5],
        [1.4, 0.0, 0.0],
        [0.0, 0.0, 1.8],
        7.0,
        true,
    ));
    let receivers = receivers_on(&quads[0], 10);
    let lit = Lit::new(&quads, Environment::black());
    let lamp = quads[6].corners();
    let expected: f64 = receivers
        .iter()
        .map(|r| 7.0 * lambert(&lamp, r.position, r.normal))
        .sum();
    // a Hammersley set has one size; the others grow
    for (estimator, rays, times) in [
        (Estimator::Uniform, 4096, 0),
        (Estimator::Cosine, 512, 3),
        (Estimator::Mis, 256, 3),
    ] {
        let got = continued(&lit, &receivers, &options(estimator, rays), times);
        let sum: f64 = got.value.iter().map(|e| f64::from(e.x)).sum();
        assert!(
            (sum / expected - 1.0).abs() < 0.01,
            "{estimator:?}: mean off by {:.4}",
            sum / expected - 1.0
        );
        let least = if times == 0 { rays / 2 } else { 6 * rays };
        assert!(
            got.rays > u64::from(least) * receivers.len() as u64,
            "{estimator:?}: {} rays",
            got.rays
        );
    }
}

/// Samples drawn in four bakes are the samples of one: the same net, the same weights.
#[test]
fn continued_bakes_equal_one_of_all_their_samples() {
    let (mut quads, _) = window_room();
    quads
        .iter_mut()
        .enumerate()
        .for_each(|(i, q)| q.radiance = Vec3::splat(0.2 + 0.05 * i as f32));
    let receivers: Vec<Receiver> = [0, 1, 2]
        .iter()
        .flat_map(|&q| receivers_on(&quads[q], 5))
        .collect();
    let mut lit = Lit::new(&quads, sky().0);
    lit.field.prefilter = false;
    let cosine = continued(&lit, &receivers, &options(Estimator::Cosine, 32), 3);
    let whole = bake(&lit, &receivers, &options(Estimator::Cosine, 256));
    assert_eq!(cosine.rays, whole.rays);
    for (a, b) in cosine.value.iter().zip(&whole.value) {
        assert!(
            (*a - *b).abs().max_element() < 1e-5 * b.max_element(),
            "{a} against {b}"
        );
    }
}

/// The receivers as a surface of texels of 5 cm, baked by a budget of `rounds` rounds.
fn surface(lit: &Lit, receivers: &[Receiver], rounds: u32) -> Irradiance {
    surface_where(lit, receivers, &vec![1.0; receivers.len()], rounds)
}

/// The same with further samples only where they matter.
fn surface_where(lit: &Lit, receivers: &[Receiver], importance: &[f32], rounds: u32) -> Irradiance {
    let patches: Vec<Surfel> = receivers
        .iter()
        .map(|r| Surfel {
            position: r.position,
            normal: r.normal,
            size: 0.05,
        })
        .collect();
    let budget = SampleBudget {
        estimator: Estimator::Mis,
        samples: [96, 48],
        rounds,
        filter: true,
        target: 0.001,
        seed: 3,
    };
    bake_surface(
        &lit.bake(),
        &patches,
        |i| receivers[i],
        importance,
        &budget,
        &Progress::silent(),
    )
}

/// What does not matter gets the first round and no more; what does gets its share.
#[test]
fn samples_go_where_they_matter() {
    let (mut quads, _) = window_room();
    quads.push(quad(
        [0.5, 2.7, 0.5],
        [0.6, 0.0, 0.0],
        [0.0, 0.0, 0.6],
        15.0,
        true,
    ));
    let receivers = texel_receivers(&quads, 64);
    let lit = Lit::new(&quads, sky().0);
    let exact = bake(&lit, &receivers, &options(Estimator::Mis, 8192)).value;
    let half = receivers.len() / 2;
    let error = |o: &Irradiance| -> f32 {
        (0..half)
            .map(|i| (o.value[i] - exact[i]).length_squared())
            .sum()
    };
    let of = |matters: &dyn Fn(usize) -> bool| {
        let importance: Vec<f32> = (0..receivers.len())
            .map(|i| f32::from(u8::from(matters(i))))
            .collect();
        surface_where(&lit, &receivers, &importance, 2)
    };
    let (none, some, all) = (of(&|_| false), of(&|i| i < half), of(&|_| true));
    // 16 + 8 samples where nothing matters, fewer where rays start below the horizon
    assert!(
        none.rays <= 24 * receivers.len() as u64,
        "{} rays",
        none.rays
    );
    assert!(
        some.rays > none.rays && some.rays <= 144 * receivers.len() as u64,
        "{} rays, {} before, of {} texels",
        some.rays,
        none.rays,
        receivers.len()
    );
    assert!(
        error(&some) < error(&all) && error(&all) < error(&none),
        "{} {} {}",
        error(&some),
        error(&all),
        error(&none)
    );
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let (mut quads, _) = window_room();
    quads.push(quad(
        [0.5, 2.7, 0.5],
        [0.6, 0.0, 0.0],
        [0.0, 0.0, 0.6],
        15.0,
        true,
    ));
    let receivers = texel_receivers(&quads, 64);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            let lit = Lit::new(&quads, sky().0);
            let plain = bake(&lit, &receivers, &IrradianceOptions::default());
            let continued = continued(&lit, &receivers, &IrradianceOptions::default(), 2);
            let out = surface(&lit, &receivers, 3);
            assert!(out.rays > plain.rays, "some are refined");
            let of = |o: Irradiance| (o.value, o.error, o.rays);
            (of(plain), of(continued), of(out), lit.emitters.lamps())
        })
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert_eq!(one, run(7));
}

#[test]
fn a_black_scene_is_zero_and_an_empty_list_empty() {
    let quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let receivers = texel_receivers(&quads, 32);
    for environment in [
        Environment::black(),
        Environment::from_map(Plane::filled(8, 4, Vec3::ZERO)),
    ] {
        // one wall less: rays escape into the dark
        let lit = Lit::new(&quads[..5], environment);
        assert!(lit.emitters.is_empty());
        for estimator in ALL {
            let got = continued(
                &lit,
                &receivers,
                &options(estimator, 64),
                u32::from(estimator != Estimator::Uniform),
            );
            assert!(
                got.value.iter().all(|e| *e == Vec3::ZERO) && got.error.iter().all(|e| *e == 0.0)
            );
            assert!(bake(&lit, &[], &options(estimator, 64)).value.is_empty());
        }
        let got = surface(&lit, &receivers, 2);
        assert!(got.value.iter().all(|e| *e == Vec3::ZERO) && got.error.iter().all(|e| *e == 0.0));
        assert!(surface(&lit, &[], 2).value.is_empty());
    }
}

/// A lamp marked as such that happens to be switched off.
#[test]
fn a_dark_lamp_is_harmless() {
    let quads = lamp_room(quad(
        [1.2, 2.9, 1.5],
        [1.4, 0.0, 0.0],
        [0.0, 0.0, 1.8],
        0.0,
        true,
    ));
    let receivers = receivers_on(&quads[0], 8);
    let lit = Lit::new(&quads, Environment::black());
    assert!(
        bake(&lit, &receivers, &IrradianceOptions::default())
            .value
            .iter()
            .all(|e| *e == Vec3::ZERO)
    );
}

/// Millimetres or kilometres: powers of two scale every length exactly, so the same samples find
/// the same light.
#[test]
fn scale_of_the_scene_changes_no_sample() {
    let build = |scale: f32| {
        let (mut quads, _) = window_room();
        quads.push(quad(
            [0.5, 2.7, 0.5],
            [0.6, 0.0, 0.0],
            [0.0, 0.0, 0.6],
            15.0,
            true,
        ));
        quads.push(
            quad(
                [2.5, 1.0, 4.0],
                [0.3, 0.0, 0.0],
                [0.0, 0.3, 0.0],
                30.0,
                true,
            )
            .flipped(),
        );
        for q in &mut quads {
            (q.corner, q.edge_u, q.edge_v) = (q.corner * scale, q.edge_u * scale, q.edge_v * scale);
        }
        let receivers: Vec<Receiver> = [0, 1, 2, 3]
            .iter()
            .flat_map(|&q| receivers_on(&quads[q], 12))
            .collect();
        let lit = Lit::new(&quads, sky().0);
        bake(&lit, &receivers, &IrradianceOptions::default()).value
    };
    let one = build(1.0);
    for exponent in [-10, 13] {
        let scaled = build(2f32.powi(exponent));
        let off = one
            .iter()
            .zip(&scaled)
            .filter(|(a, b)| (**a - **b).abs().max_element() > 1e-5 * a.max_element())
            .count();
        assert!(
            off <= one.len() / 100,
            "2^{exponent}: {off} of {} receivers differ",
            one.len()
        );
    }
}
