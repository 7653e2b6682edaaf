//! Irradiance of whole surfaces as `solve` bakes it, in rounds and filtered: no light where none
//! arrives (thin walls, doorways, solids in solids, back sides), no samples where none are wanted,
//! no error that is not stated.

mod common;

use common::lit::{Lit, Quad, box_quads, framed, lambert, mesh_of, quad, quadrature, receivers_on};
use glam::{Vec2, Vec3};
use unbake::core::progress::Progress;
use unbake::core::texture::Texels;
use unbake::gbuffer::Orientation;
use unbake::irradiance::{
    Estimator, Irradiance, IrradianceOptions, Receiver, SampleBudget, Surfel, bake_irradiance,
    bake_surface,
};
use unbake::radiance::Environment;

/// Hemisphere rays and emitter samples of the presets.
const STANDARD: [u32; 2] = [136, 68];
const DRAFT: [u32; 2] = [42, 22];

/// The texels of a mesh of quads as the pipeline makes them.
struct Atlas {
    receivers: Vec<Receiver>,
    patches: Vec<Surfel>,
    importance: Vec<f32>,
    /// The quad of each texel.
    quad: Vec<usize>,
}

impl Atlas {
    fn new(quads: &[Quad], side: usize) -> Self {
        let mesh = mesh_of(quads);
        let texels = Texels::rasterize(&mesh, side, side);
        let of = |i: usize| texels.point[i].triangle as usize;
        let receiver = |i: usize| {
            let (u, v) = texels.ray_point(i);
            let n = mesh.face_normal(of(i));
            Receiver {
                position: mesh.position(of(i), u, v),
                normal: n,
                face_normal: n,
                key: u64::from(texels.cell[i]),
            }
        };
        let patch = |i: usize| {
            let Receiver {
                position, normal, ..
            } = receiver(i);
            Surfel {
                position,
                normal,
                size: texels.texel_area(&mesh, of(i)).sqrt(),
            }
        };
        Self {
            receivers: (0..texels.len()).map(receiver).collect(),
            patches: (0..texels.len()).map(patch).collect(),
            importance: texels
                .interior
                .iter()
                .map(|inside| if *inside { 1.0 } else { 0.25 })
                .collect(),
            quad: (0..texels.len()).map(|i| of(i) / 2).collect(),
        }
    }

    /// One plain bake, and what `solve` does with the samples of two presets: three rounds, the
    /// filter.
    fn bakes(&self, lit: &Lit) -> [(&'static str, Irradiance); 3] {
        let receiver = |i: usize| self.receivers[i];
        let (bake, silent) = (lit.bake(), Progress::silent());
        let surface = |samples: [u32; 2]| {
            let budget = SampleBudget {
                estimator: Estimator::Mis,
                samples,
                rounds: 3,
                filter: true,
                target: 0.01,
                seed: 5,
            };
            bake_surface(
                &bake,
                &self.patches,
                receiver,
                &self.importance,
                &budget,
                &silent,
            )
        };
        let plain = bake_irradiance(
            &bake,
            self.receivers.len(),
            receiver,
            &IrradianceOptions::default(),
            &silent,
        );
        let all = [
            ("plain", plain),
            ("draft", surface(DRAFT)),
            ("standard", surface(STANDARD)),
        ];
        for (name, out) in &all {
            assert!(
                out.value
                    .iter()
                    .all(|e| e.is_finite() && e.min_element() >= 0.0),
                "{name}: finite and not negative"
            );
            assert!(
                out.error.iter().all(|e| e.is_finite() && *e >= 0.0),
                "{name}: stated errors"
            );
        }
        all
    }

    /// Texels whose rays start where `keep` says, given quad and position.
    fn among(&self, keep: impl Fn(usize, Vec3) -> bool) -> Vec<usize> {
        (0..self.receivers.len())
            .filter(|&i| keep(self.quad[i], self.receivers[i].position))
            .collect()
    }
}

/// Root mean square of the relative error of some texels, and the largest.
fn errors(out: &Irradiance, ids: &[usize], expected: &[f64]) -> (f64, f64) {
    let off: Vec<f64> = ids
        .iter()
        .zip(expected)
        .map(|(&i, x)| f64::from(out.value[i].x) / x - 1.0)
        .collect();
    (
        (off.iter().map(|e| e * e).sum::<f64>() / off.len() as f64).sqrt(),
        off.iter().fold(0.0, |m, e| m.max(e.abs())),
    )
}

/// Two rooms on one undivided floor, below one ceiling, between walls that run on; sheets stand
/// between the rooms, at x = 4.
fn rooms(sheets: &[f32], lamps: &[Quad]) -> Vec<Quad> {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(8.0, 3.0, 4.0), 0.0);
    for (i, &x) in sheets.iter().enumerate() {
        let sheet = quad([x, 0.0, 0.0], [0.0, 0.0, 4.0], [0.0, 3.0, 0.0], 0.0, false);
        quads.push(if i % 2 == 1 { sheet.flipped() } else { sheet });
    }
    quads.extend(lamps);
    quads
}

const WALLS: [&[f32]; 2] = [&[4.0], &[4.0, 4.002]];
const FLOOR: usize = 0;

/// The dark room stays black to the last bit, the filter included, although its texels are the
/// bright room's neighbours on one plane; and the bright room is as bright as it ought to be right
/// up to the wall.
#[test]
fn a_thin_wall_on_an_undivided_floor_does_not_leak() {
    let lamps = [
        (
            "lamp",
            quad(
                [1.0, 2.9, 1.5],
                [1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0],
                20.0,
                true,
            ),
        ),
        (
            "lamp at the wall",
            quad(
                [3.0, 2.0, 1.5],
                [0.3, 0.0, 0.0],
                [0.0, 0.0, 0.3],
                20.0,
                true,
            ),
        ),
        (
            "spotlight",
            quad(
                [1.0, 2.9, 1.5],
                [0.05, 0.0, 0.0],
                [0.0, 0.0, 0.05],
                1e4,
                true,
            ),
        ),
    ];
    for (sheets, (name, lamp)) in WALLS.iter().flat_map(|s| lamps.map(|l| (*s, l))) {
        let quads = rooms(sheets, &[lamp]);
        let (lit, atlas) = (
            Lit::new(&quads, Environment::black()),
            Atlas::new(&quads, 160),
        );
        let end = sheets[sheets.len() - 1];
        let dark =
            atlas.among(|q, p| (q < 6 && p.x > end) || (q == 6 && sheets.len() > 1 && p.x > end));
        let near = atlas.among(|q, p| q == FLOOR && p.x < 4.0 && p.x > 3.4);
        assert!(
            dark.len() > 4_000 && near.len() > 100,
            "{} {}",
            dark.len(),
            near.len()
        );
        let expected: Vec<f64> = near
            .iter()
            .map(|&i| {
                f64::from(lamp.radiance.x)
                    * lambert(&lamp.corners(), atlas.receivers[i].position, Vec3::Y)
            })
            .collect();
        for (how, out) in atlas.bakes(&lit) {
            let leak = dark.iter().find(|&&i| out.value[i] != Vec3::ZERO);
            assert!(
                leak.is_none(),
                "{name}, {how}: leak at {:?}",
                leak.map(|&i| atlas.receivers[i])
            );
            let (rms, worst) = errors(&out, &near, &expected);
            println!(
                "{name}, sheets {sheets:?}, {how}: beside the wall rms {rms:.4}, worst {worst:.3}"
            );
            assert!(
                how == "plain" || (rms < 0.03 && worst < 0.15),
                "{name}, {how}: rms {rms:.4}, worst {worst:.3}"
            );
        }
    }
}

/// A night light in the one room, a twentieth or a thousandth of the lamp in the other: neither
/// room takes from the other. (Beside the wall many samples are spent on the lamp next door, just
/// in case: the night light is noisy, but a leak of a thousandth of the other room's light would
/// double it.)
#[test]
fn a_dim_room_next_door_keeps_its_own_light() {
    let bright = quad(
        [1.0, 2.9, 1.5],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        20.0,
        true,
    );
    for radiance in [1.0, 0.02] {
        let dim = quad(
            [6.0, 2.9, 1.5],
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            radiance,
            true,
        );
        let quads = rooms(WALLS[0], &[bright, dim]);
        let (lit, atlas) = (
            Lit::new(&quads, Environment::black()),
            Atlas::new(&quads, 256),
        );
        let bakes = atlas.bakes(&lit);
        for (lamp, from, to) in [(bright, 3.4, 4.0), (dim, 4.0, 4.6)] {
            let near = atlas.among(|q, p| q == FLOOR && p.x > from && p.x < to);
            let light = |p: Vec3| f64::from(lamp.radiance.x) * lambert(&lamp.corners(), p, Vec3::Y);
            let expected: Vec<f64> = near
                .iter()
                .map(|&i| light(atlas.receivers[i].position))
                .collect();
            for (how, out) in &bakes[1..] {
                let (rms, worst) = errors(out, &near, &expected);
                let mean = near.iter().map(|&i| f64::from(out.value[i].x)).sum::<f64>()
                    / expected.iter().sum::<f64>()
                    - 1.0;
                println!(
                    "night light {radiance}, {how}, x from {from}: rms {rms:.4}, worst {worst:.3}, mean {mean:+.4}"
                );
                let (most, bias) = match (from == 4.0, *how) {
                    (false, _) => (0.02, 0.01),
                    (true, "draft") => (if radiance < 1.0 { 0.65 } else { 0.25 }, 0.1),
                    (true, _) => (if radiance < 1.0 { 0.25 } else { 0.13 }, 0.03),
                };
                assert!(
                    rms < most && mean.abs() < bias,
                    "night light {radiance}, {how}, x from {from}: {rms:.4}, {mean:+.4}"
                );
            }
        }
    }
}

/// The worst case: a sheet that shines from its far side, of which nobody draws samples, so that a
/// part of a first round may well have found nothing: noise parts nothing, but the two sides of the
/// wall do not see each other.
#[test]
fn light_that_rays_find_by_chance_does_not_leak() {
    for side in [2.0f32, 1.0, 0.4] {
        let mut quads = rooms(WALLS[0], &[]);
        quads.push(quad(
            [1.0, 2.9, 1.0],
            [0.0, 0.0, side],
            [side, 0.0, 0.0],
            0.0,
            false,
        )); // front faces up
        let mesh = mesh_of(&quads);
        let n = mesh.triangles.len();
        let back = (0..n)
            .map(|t| {
                if t + 2 < n {
                    Vec3::ZERO
                } else {
                    Vec3::splat(20.0)
                }
            })
            .collect();
        let lit = Lit::with(
            mesh,
            &quads,
            &Orientation::of_winding(n),
            back,
            Environment::black(),
        );
        let atlas = Atlas::new(&quads, 256);
        let [dark, near] = [(4.0, 4.4), (3.6, 4.0)]
            .map(|(from, to)| atlas.among(|q, p| q < 6 && p.x > from && p.x < to));
        let elsewhere = atlas.among(|q, p| q < 6 && p.x > 4.6);
        for (how, out) in &atlas.bakes(&lit) {
            let mean = |ids: &[usize]| {
                ids.iter().map(|&i| f64::from(out.value[i].x)).sum::<f64>() / ids.len() as f64
            };
            let share = mean(&dark) / mean(&near);
            println!("sheet of {side} m, {how}: {share:.5} of the light beside the wall leaks");
            assert!(
                mean(&near) > 0.1 * f64::from(side * side) && share == 0.0,
                "sheet of {side} m, {how}: {share:.5}"
            );
            assert_eq!(mean(&elsewhere), 0.0, "beyond the filter's reach");
        }
    }
}

/// The far room has what light the doorway lets through; where none arrives the filter blurs next
/// to none from the half shadow.
#[test]
fn a_room_behind_a_doorway_after_rounds_and_filter() {
    let lamp = quad(
        [1.0, 2.9, 1.5],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        20.0,
        true,
    );
    let mut quads = rooms(&[], &[]);
    let sheet = quad(
        [4.0, 0.0, 0.0],
        [0.0, 0.0, 4.0],
        [0.0, 3.0, 0.0],
        0.0,
        false,
    );
    quads.extend(framed(sheet, Vec2::new(0.4, 0.0), Vec2::new(0.65, 0.7)));
    quads.push(lamp);
    let (lit, atlas) = (
        Lit::new(&quads, Environment::black()),
        Atlas::new(&quads, 256),
    );
    let far = atlas.among(|q, p| q == FLOOR && p.x > 4.0);
    let expected: Vec<f64> = far
        .iter()
        .map(|&i| {
            quadrature(
                &lamp,
                atlas.receivers[i].position,
                Vec3::Y,
                24,
                Some(&lit.tracer),
                |_| lamp.radiance,
            )
            .x
        })
        .collect();
    let brightest = expected.iter().fold(0.0f64, |a, b| a.max(*b));
    let (lighted, black) = (
        expected.iter().filter(|e| **e > 0.0).count(),
        expected.iter().filter(|e| **e == 0.0).count(),
    );
    assert!(lighted > 800 && black > 300, "{lighted} {black}");
    for (how, out) in atlas.bakes(&lit) {
        let (mut square, mut worst, mut leak, mut sum) = (0.0, 0.0f64, 0.0f64, 0.0);
        for (&i, x) in far.iter().zip(&expected) {
            let e = f64::from(out.value[i].x);
            square += (e - x).powi(2);
            worst = worst.max((e - x).abs() / brightest);
            leak = leak.max(if *x == 0.0 { e / brightest } else { 0.0 });
            sum += e;
        }
        let rms = (square / expected.iter().map(|x| x * x).sum::<f64>()).sqrt();
        let mean = sum / expected.iter().sum::<f64>() - 1.0;
        println!(
            "doorway, {how}: rms {rms:.4}, mean {mean:+.4}, of the brightest: worst {worst:.4}, where none arrives {leak:.5}"
        );
        let bounds = match how {
            "plain" => [0.08, 0.005, 0.2, 0.0],
            "draft" => [0.045, 0.015, 0.2, 0.03],
            _ => [0.025, 0.008, 0.08, 0.01],
        };
        assert!(
            [rms, mean.abs(), worst, leak]
                .iter()
                .zip(bounds)
                .all(|(e, most)| *e <= most),
            "{how}: beyond {bounds:?}"
        );
    }
}

/// A cupboard sunk into wall and floor, a block driven through it, a sheet inside: what lies in
/// solids or behind walls is black, what the room sees is lit as it ought to be.
#[test]
fn solids_in_solids_are_black_inside_and_right_outside() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let lamp = quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true);
    let solids = [
        (Vec3::new(-0.2, -0.3, 1.0), Vec3::new(0.7, 1.6, 2.4)),
        (Vec3::new(0.3, 0.5, 2.0), Vec3::new(1.1, 0.9, 3.0)),
    ];
    for (lo, hi) in solids {
        quads.extend(box_quads(lo, hi, 0.0).into_iter().map(Quad::flipped));
    }
    quads.push(quad(
        [0.35, 0.2, 1.2],
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        0.0,
        false,
    ));
    quads.push(lamp);
    let sheet = quads.len() - 2;
    let (lit, atlas) = (
        Lit::new(&quads, Environment::black()),
        Atlas::new(&quads, 256),
    );
    // the margin is what a float may round
    let within =
        |p: Vec3, (lo, hi): (Vec3, Vec3)| p.cmpgt(lo + 1e-4).all() && p.cmplt(hi - 1e-4).all();
    let outside = |p: Vec3| p.x < -1e-4 || p.y < -1e-4;
    // (the offset of rays looks to either side of a surface that lies on another: none does here)
    let hidden = atlas
        .among(|q, p| q == sheet || solids.iter().any(|s| within(p, *s)) || (q > 5 && outside(p)));
    let open = atlas.among(|q, p| {
        (6..18).contains(&q)
            && !outside(p)
            && !solids.iter().any(|s| within(p, *s))
            && p.x > 0.02
            && p.y > 0.02
    });
    assert!(
        hidden.len() > 1_500 && open.len() > 1_000,
        "{} {}",
        hidden.len(),
        open.len()
    );
    let expected: Vec<f64> = open
        .iter()
        .map(|&i| {
            let r = &atlas.receivers[i];
            quadrature(&lamp, r.position, r.normal, 16, Some(&lit.tracer), |_| {
                lamp.radiance
            })
            .x
        })
        .collect();
    let brightest = expected.iter().fold(0.0f64, |a, b| a.max(*b));
    for (how, out) in atlas.bakes(&lit) {
        let leak = hidden
            .iter()
            .map(|&i| f64::from(out.value[i].x))
            .fold(0.0, f64::max)
            / brightest;
        assert_eq!(leak, 0.0, "{how}: inside");
        let off = |k: usize| (f64::from(out.value[open[k]].x) - expected[k]).abs() / brightest;
        let rms = ((0..open.len()).map(|k| off(k).powi(2)).sum::<f64>() / open.len() as f64).sqrt();
        let worst = (0..open.len()).map(off).fold(0.0, f64::max);
        println!("solids, {how}: of the brightest rms {rms:.4}, worst {worst:.4}");
        assert!(
            how == "plain" || (rms < 0.015 && worst < 0.15),
            "{how}: rms {rms:.4}, worst {worst:.4}"
        );
    }
}

fn mis(lit: &Lit, receivers: &[Receiver]) -> Vec<f64> {
    let options = IrradianceOptions {
        estimator: Estimator::Mis,
        rays: 1024,
        emitter_samples: 256,
        ..IrradianceOptions::default()
    };
    let out = bake_irradiance(
        &lit.bake(),
        receivers.len(),
        |i| receivers[i],
        &options,
        &Progress::silent(),
    );
    out.value.iter().map(|e| f64::from(e.x)).collect()
}

fn worst(got: &[f64], expected: &[f64]) -> f64 {
    got.iter()
        .zip(expected)
        .map(|(e, x)| (e / x - 1.0).abs())
        .fold(0.0, f64::max)
}

/// A lamp shines to its front. From behind it is black, unless cameras saw that side shine.
#[test]
fn the_back_of_a_lamp_is_what_was_seen_of_it() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let lamp = quad([1.2, 1.5, 1.5], [0.0, 0.0, 1.8], [1.4, 0.0, 0.0], 7.0, true); // faces up
    quads.push(lamp);
    let upright = quad([3.0, 0.5, 2.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], 5.0, true); // faces x+
    let [floor, ceiling] = [0, 1].map(|q| receivers_on(&quads[q], 12));
    let light = |r: &Receiver| lambert(&lamp.corners(), r.position, r.normal);
    for behind in [0.0f32, 3.0] {
        let mesh = mesh_of(&quads);
        let back = (0..14)
            .map(|t| Vec3::splat(if t < 12 { 0.0 } else { behind }))
            .collect();
        let lit = Lit::with(
            mesh,
            &quads,
            &Orientation::of_winding(14),
            back,
            Environment::black(),
        );
        let above = worst(
            &mis(&lit, &ceiling),
            &ceiling.iter().map(|r| 7.0 * light(r)).collect::<Vec<_>>(),
        );
        assert!(above < 0.03, "the front is off by {above:.3}");
        let below = mis(&lit, &floor);
        if behind == 0.0 {
            assert!(
                below.iter().all(|e| *e == 0.0),
                "a lamp shines through its back"
            );
        } else {
            // nobody draws samples on a back: noisier, not biased
            let expected: Vec<f64> = floor.iter().map(|r| f64::from(behind) * light(r)).collect();
            let mean = below.iter().sum::<f64>() / expected.iter().sum::<f64>() - 1.0;
            let below = worst(&below, &expected);
            println!("front {above:.4}, back {below:.4}, mean {mean:+.4}");
            assert!(
                below < 0.25 && mean.abs() < 0.01,
                "the back is off by {below:.3}, {mean:+.4} on average"
            );
        }
    }
    // an upright lamp: half the floor is behind it
    quads[6] = upright;
    let lit = Lit::new(&quads, Environment::black());
    let got = mis(&lit, &floor);
    for (e, r) in got.iter().zip(&floor) {
        let expected = quadrature(&upright, r.position, r.normal, 128, None, |_| {
            upright.radiance
        })
        .x;
        assert!(
            (e - expected).abs() < 0.02 * expected + 1e-3 && (expected > 0.0 || *e == 0.0),
            "{}: {e}, {expected}",
            r.position
        );
    }
}

/// One sheet between two lamps: each side has the light of its own lamp and none of the other's.
#[test]
fn either_side_of_a_sheet_has_its_own_light() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::splat(3.0), 0.0);
    let sheet = quad(
        [0.5, 1.5, 0.5],
        [0.0, 0.0, 2.0],
        [2.0, 0.0, 0.0],
        0.0,
        false,
    ); // faces up
    let above = quad([1.0, 2.9, 1.2], [0.8, 0.0, 0.0], [0.0, 0.0, 0.6], 4.0, true); // faces down
    let below = quad([1.4, 0.1, 0.8], [0.0, 0.0, 0.5], [0.4, 0.0, 0.0], 0.3, true); // faces up
    quads.extend([sheet, above, below]);
    let lit = Lit::new(&quads, Environment::black());
    for (side, lamp) in [(sheet, above), (sheet.flipped(), below)] {
        let receivers = receivers_on(&side, 16);
        let light = |r: &Receiver| {
            f64::from(lamp.radiance.x) * lambert(&lamp.corners(), r.position, r.normal)
        };
        let off = worst(
            &mis(&lit, &receivers),
            &receivers.iter().map(light).collect::<Vec<_>>(),
        );
        println!("facing {}: worst {off:.4}", side.normal());
        assert!(off < 0.03, "facing {}: off by {off:.3}", side.normal());
    }
}

/// A texel within the target draws no more: a target that all meet costs the first round to the
/// ray, and so does light without noise, however strict the target; stricter targets cost more.
#[test]
fn texels_within_the_target_stop() {
    let even = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 1.0);
    let mut lamps = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.1);
    lamps.push(quad(
        [0.5, 2.7, 0.5],
        [0.6, 0.0, 0.0],
        [0.0, 0.0, 0.6],
        15.0,
        true,
    ));
    lamps.push(quad(
        [2.5, 1.0, 4.0],
        [0.0, 0.3, 0.0],
        [0.3, 0.0, 0.0],
        30.0,
        true,
    ));
    let rays = |quads: &[Quad], target: f32, rounds: u32| {
        let (lit, atlas) = (
            Lit::new(quads, Environment::black()),
            Atlas::new(quads, 128),
        );
        let (n, receiver) = (atlas.receivers.len(), |i: usize| atlas.receivers[i]);
        let rays = |samples: [u32; 2], rounds: u32| {
            let budget = SampleBudget {
                estimator: Estimator::Mis,
                samples,
                rounds,
                filter: true,
                target,
                seed: 3,
            };
            bake_surface(
                &lit.bake(),
                &atlas.patches,
                receiver,
                &vec![1.0; n],
                &budget,
                &Progress::silent(),
            )
            .rays
        };
        // the first round: the powers of two within half of the budget
        (rays([96, 48], rounds), rays([32, 16], 1), n as u64)
    };
    for rounds in [2, 4] {
        let (spent, first, _) = rays(&lamps, 10.0, rounds);
        assert_eq!(spent, first, "{rounds} rounds");
        let (spent, first, _) = rays(&even, 1e-3, rounds);
        assert_eq!(spent, first, "{rounds} rounds of light without noise");
        let [loose, middle, strict] = [0.05, 0.02, 1e-4].map(|target| rays(&lamps, target, rounds));
        println!(
            "{rounds} rounds: {} {} {} rays of {} texels, {} at first",
            loose.0, middle.0, strict.0, loose.2, loose.1
        );
        assert!(
            loose.1 < loose.0 && loose.0 < middle.0 && middle.0 < strict.0,
            "{rounds} rounds: {loose:?} {middle:?} {strict:?}"
        );
        assert!(
            strict.0 <= 144 * strict.2,
            "{rounds} rounds: no more than the budget"
        );
    }
}

/// The stated error is the true one within a factor, over all texels and over those that matter
/// less alike.
#[test]
fn the_stated_error_is_true() {
    let mut room = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    let lamps = [
        quad(
            [0.5, 2.7, 0.5],
            [0.6, 0.0, 0.0],
            [0.0, 0.0, 0.6],
            15.0,
            true,
        ),
        quad([1.0, 2.0, 3.0], [1.2, 0.0, 0.0], [0.0, 0.0, 0.8], 1.0, true),
    ];
    room.extend(lamps);
    let (lit, atlas) = (
        Lit::new(&room, Environment::black()),
        Atlas::new(&room, 256),
    );
    // the floor: it sees the fronts of both lamps whole; for the walls the lower one hides the
    // upper
    let floor = atlas.among(|q, _| q == FLOOR);
    let exact: Vec<f64> = floor
        .iter()
        .map(|&i| {
            let p = atlas.receivers[i].position;
            quadrature(&lamps[0], p, Vec3::Y, 24, Some(&lit.tracer), |_| {
                lamps[0].radiance
            })
            .x + lambert(&lamps[1].corners(), p, Vec3::Y)
        })
        .collect();
    for (how, out) in atlas.bakes(&lit) {
        let stated = (floor
            .iter()
            .map(|&i| f64::from(out.error[i]).powi(2))
            .sum::<f64>()
            / floor.len() as f64)
            .sqrt();
        let (rms, worst) = errors(&out, &floor, &exact);
        println!("{how}: states {stated:.4}, is {rms:.4}, worst {worst:.3}");
        assert!(
            (0.5..2.0).contains(&(stated / rms)),
            "{how}: states {stated:.4}, is {rms:.4}"
        );
    }
}

/// Whatever the estimator, the budget is what it spends and a large lamp's light what it finds;
/// only `Mis` asks for the lamp.
#[test]
fn every_estimator_spends_the_budget_and_finds_the_light() {
    let lamp = quad(
        [1.0, 2.9, 0.5],
        [2.0, 0.0, 0.0],
        [0.0, 0.0, 2.0],
        10.0,
        true,
    );
    let quads = rooms(&[], &[lamp]);
    let (lit, atlas) = (
        Lit::new(&quads, Environment::black()),
        Atlas::new(&quads, 128),
    );
    let floor = atlas.among(|q, p| q == FLOOR && p.x < 4.0);
    let expected: Vec<f64> = floor
        .iter()
        .map(|&i| 10.0 * lambert(&lamp.corners(), atlas.receivers[i].position, Vec3::Y))
        .collect();
    let texels = atlas.receivers.len() as u64;
    let rms = [Estimator::Uniform, Estimator::Cosine, Estimator::Mis].map(|estimator| {
        let budget = SampleBudget {
            estimator,
            samples: [96, 48],
            rounds: 3,
            filter: true,
            target: 0.0,
            seed: 5,
        };
        let out = bake_surface(
            &lit.bake(),
            &atlas.patches,
            |i| atlas.receivers[i],
            &atlas.importance,
            &budget,
            &Progress::silent(),
        );
        // (how many of the samples towards the lamp need no ray is estimated)
        assert!(
            out.rays <= 147 * texels,
            "{estimator:?}: {} rays for {texels} texels",
            out.rays
        );
        if estimator != Estimator::Mis {
            assert!(
                out.rays > 138 * texels,
                "{estimator:?}: {} rays for {texels} texels",
                out.rays
            );
        }
        errors(&out, &floor, &expected).0
    });
    let [uniform, cosine, mis] = rms;
    assert!(
        uniform < 0.2 && cosine < 0.1 && mis < 0.02 && mis < cosine && cosine < uniform,
        "{rms:?}"
    );
}
