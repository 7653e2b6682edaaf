//! Embree against the brute-force twin, on random soups and on the cases that break ray tracers.

use super::*;
use crate::core::geometry::{Mesh, add_box};
use crate::core::sampling::KeyedRng;
use crate::ffi::embree::PacketWidth;
use crate::ffi::ray::FAR_AWAY;
use glam::Vec3;

fn unit(rng: &mut KeyedRng) -> Vec3 {
    loop {
        let p = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 2.0 - 1.0;
        if p.length() > 0.1 && p.length() < 1.0 {
            return p.normalize();
        }
    }
}

fn point(rng: &mut KeyedRng) -> Vec3 {
    Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 10.0
}

/// `count` triangles of about half a metre in a box of ten.
fn soup(count: usize, seed: u64) -> Mesh {
    let mut mesh = Mesh::default();
    for t in 0..count {
        let mut rng = KeyedRng::new(seed, t as u64);
        let centre = point(&mut rng);
        let base = mesh.positions.len() as u32;
        for _ in 0..3 {
            mesh.positions.push(centre + unit(&mut rng) * 0.5);
        }
        mesh.triangles.push([base, base + 1, base + 2]);
    }
    mesh
}

fn random_rays(count: usize, seed: u64) -> Vec<Ray> {
    (0..count)
        .map(|i| {
            let mut rng = KeyedRng::new(seed ^ 0x5eed, i as u64);
            let (origin, direction) = (point(&mut rng), unit(&mut rng));
            let t_far = if i % 3 == 0 {
                f32::INFINITY
            } else {
                12.0 * rng.next_f32()
            };
            Ray {
                t_near: if i % 5 == 0 { 0.5 } else { 0.0 },
                ..Ray::new(origin, direction, t_far)
            }
        })
        .collect()
}

fn closest(tracer: &dyn Tracer, rays: &[Ray]) -> Vec<Hit> {
    let mut hits = vec![
        Hit {
            t: 0.0,
            u: 9.0,
            v: 9.0,
            triangle: 7
        };
        rays.len()
    ];
    tracer.closest(rays, &mut hits);
    hits
}

fn occluded(tracer: &dyn Tracer, rays: &[Ray]) -> Vec<u8> {
    let mut flags = vec![9; rays.len()];
    tracer.occluded(rays, &mut flags);
    flags
}

/// Compares both tracers; returns how many rays disagree about hit or miss (rays that graze an edge
/// may).
fn disagreements(mesh: &Mesh, rays: &[Ray]) -> usize {
    let (embree, brute) = (
        EmbreeTracer::new(mesh).expect("builds"),
        BruteForce::new(mesh),
    );
    let (a, b) = (closest(&embree, rays), closest(&brute, rays));
    let (oa, ob) = (occluded(&embree, rays), occluded(&brute, rays));
    let mut differ = 0;
    for i in 0..rays.len() {
        assert!(oa[i] <= 1, "ray {i}: flag {}", oa[i]);
        differ += usize::from(oa[i] != ob[i]);
        let close = (a[i].t - b[i].t).abs() <= 1e-4 * (1.0 + b[i].t.abs()) || a[i].t == b[i].t;
        if !close {
            differ += 1;
            continue;
        }
        if a[i].is_hit() {
            // At the same distance either triangle will do, but the point must be the ray's.
            let at = mesh.position(a[i].triangle as usize, a[i].u, a[i].v);
            let expected = Vec3::from(rays[i].origin) + Vec3::from(rays[i].direction) * a[i].t;
            assert!(
                (at - expected).length() < 1e-3,
                "ray {i}: {at} is not {expected}"
            );
        } else {
            assert_eq!(a[i], Hit::miss(), "ray {i}");
        }
    }
    differ
}

#[test]
fn embree_agrees_with_brute_force_on_random_soups() {
    for (count, seed) in [(1, 1), (7, 2), (300, 3), (3000, 4)] {
        let rays = random_rays(3001, seed);
        let differ = disagreements(&soup(count, seed), &rays);
        assert!(
            differ <= 3,
            "{count} triangles: {differ} of {} rays disagree",
            rays.len()
        );
    }
}

#[test]
fn packets_of_every_width_agree_with_single_rays() {
    let (mesh, rays) = (soup(2000, 5), random_rays(5003, 5));
    let tracer = EmbreeTracer::new(&mesh).expect("builds");
    let run = |width| {
        let mut flags = vec![9; rays.len()];
        tracer.scene().occluded(&rays, &mut flags, width);
        flags
    };
    let one = run(PacketWidth::One);
    for width in [PacketWidth::Eight, PacketWidth::Sixteen] {
        let differ = one.iter().zip(run(width)).filter(|&(&a, b)| a != b).count();
        assert!(differ <= 2, "{width:?}: {differ} rays differ");
    }
    assert!(one.contains(&0) && one.contains(&1));
}

#[test]
fn rays_that_are_not_finite_miss() {
    // A box all round the origin: every proper ray hits.
    let mesh = cube(1.0);
    let good = Ray::new(Vec3::ZERO, Vec3::new(0.6, 0.0, 0.8), f32::INFINITY);
    let mut rays = vec![good; 40];
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let mut next = 1;
    for value in bad {
        for axis in 0..3 {
            rays[next].origin[axis] = value;
            rays[next + 1].direction[axis] = value;
            next += 2;
        }
    }
    rays[next].t_near = f32::NAN;
    rays[next + 1].t_far = f32::NAN;
    rays[next + 2].t_near = f32::INFINITY;
    rays[next + 3].direction = [0.0; 3];
    rays[next + 4].t_far = -1.0;
    (rays[next + 5].t_near, rays[next + 5].t_far) = (3.0, 2.0);
    rays[next + 6].origin[1] = 3e38;
    rays[next + 7].direction = [1e-30, 0.0, 0.0];
    let broken = next + 8;
    for tracer in [
        &EmbreeTracer::new(&mesh).expect("builds") as &dyn Tracer,
        &BruteForce::new(&mesh),
    ] {
        let (hits, flags) = (closest(tracer, &rays), occluded(tracer, &rays));
        for i in 0..rays.len() {
            let proper = i == 0 || i >= broken;
            assert_eq!(hits[i].is_hit(), proper, "ray {i} {:?}", rays[i]);
            assert_eq!(flags[i], u8::from(proper), "ray {i} {:?}", rays[i]);
        }
    }
}

/// An axis-aligned cube of half-size `h` about the origin, 12 triangles.
fn cube(h: f32) -> Mesh {
    let mut mesh = Mesh::default();
    add_box(&mut mesh, Vec3::splat(-h), Vec3::splat(h), false);
    mesh
}

#[test]
fn distances_in_a_cube_are_right_and_the_segment_is_half_open() {
    let tracer = EmbreeTracer::new(&cube(2.0)).expect("builds");
    let x = Ray::new(Vec3::new(0.25, 0.1, 0.3), Vec3::X, f32::INFINITY);
    let rays = [
        x,
        Ray { t_far: 1.75, ..x },
        Ray { t_far: 1.5, ..x },
        Ray { t_near: 1.75, ..x },
        Ray { t_near: -5.0, ..x },
    ];
    let hits = closest(&tracer, &rays);
    // Embree divides by an approximate reciprocal with one Newton step: the last bit may differ.
    let near = |t: f32| (t - 1.75).abs() <= 2.0 * f32::EPSILON;
    assert!(near(hits[0].t), "{}", hits[0].t);
    assert!(near(hits[1].t), "t_far itself counts: {}", hits[1].t);
    assert!(!hits[2].is_hit());
    assert!(!hits[3].is_hit(), "t_near itself does not");
    assert!(
        near(hits[4].t),
        "a negative t_near counts as 0: {}",
        hits[4].t
    );
    assert_eq!(occluded(&tracer, &rays), [1, 1, 0, 0, 1]);
}

#[test]
fn no_ray_leaves_a_closed_cube_through_an_edge_by_more_than_chance() {
    // Not robust mode: exact hits on shared edges may slip through, but hardly ever.
    let tracer = EmbreeTracer::new(&cube(1.0)).expect("builds");
    let mut rng = KeyedRng::new(9, 9);
    let rays: Vec<Ray> = (0..100_000)
        .map(|_| Ray::new(Vec3::splat(0.1), unit(&mut rng), f32::INFINITY))
        .collect();
    let escaped = closest(&tracer, &rays)
        .iter()
        .filter(|h| !h.is_hit())
        .count();
    assert!(escaped <= 3, "{escaped} rays escaped");
}

#[test]
fn an_empty_mesh_is_never_hit() {
    for mesh in [
        Mesh::default(),
        Mesh {
            positions: vec![Vec3::ONE; 3],
            ..Mesh::default()
        },
    ] {
        let tracer = EmbreeTracer::new(&mesh).expect("builds");
        let rays = random_rays(100, 6);
        assert!(closest(&tracer, &rays).iter().all(|h| *h == Hit::miss()));
        assert!(occluded(&tracer, &rays).iter().all(|&o| o == 0));
        tracer.closest(&[], &mut []);
        tracer.occluded(&[], &mut []);
    }
}

#[test]
fn an_index_out_of_range_is_refused_with_its_place() {
    let mut mesh = soup(3, 7);
    mesh.triangles[2] = [0, 1, 9];
    let message = EmbreeTracer::new(&mesh).err().expect("refused").to_string();
    assert!(
        message.contains("triangle 2") && message.contains('9'),
        "{message}"
    );
}

#[test]
fn broken_and_degenerate_triangles_change_nothing_else() {
    let mut mesh = soup(200, 8);
    let rays = random_rays(2000, 8);
    let before = closest(&EmbreeTracer::new(&mesh).expect("builds"), &rays);
    let base = mesh.positions.len() as u32;
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, f32::MAX];
    for value in bad {
        let at = mesh.positions.len() as u32;
        mesh.positions.push(Vec3::new(value, 0.0, 1.0));
        mesh.triangles.push([at, 0, 1]);
        mesh.triangles.push([2, at, at]);
    }
    // Zero area: a point, an edge used twice, three points in a line.
    let line = mesh.positions.len() as u32;
    mesh.positions
        .extend([Vec3::ZERO, Vec3::splat(5.0), Vec3::splat(10.0)]);
    mesh.triangles
        .extend([[0, 0, 0], [0, 1, 0], [line, line + 1, line + 2]]);
    let tracer = EmbreeTracer::new(&mesh).expect("builds");
    assert_eq!(tracer.skipped(), 2 * bad.len());
    assert_eq!(before, closest(&tracer, &rays));
    // Rays straight at the degenerate ones and along the line.
    let aimed = [
        Ray::new(
            Vec3::new(-1.0, -1.0, -1.0),
            Vec3::ONE.normalize(),
            f32::INFINITY,
        ),
        Ray::new(mesh.positions[0] + Vec3::X * 1e-3, -Vec3::X, 1e-2),
    ];
    for h in closest(&tracer, &aimed) {
        assert!(!h.is_hit() || h.triangle < 200, "{h:?}");
        assert!(!h.t.is_nan());
    }
    assert!(disagreements(&mesh, &rays) <= 3);
    assert_eq!(base as usize, 600);
}

#[test]
fn coincident_triangles_give_the_right_distance() {
    let mut mesh = cube(1.0);
    let copy = mesh.triangles.clone();
    for _ in 0..20 {
        mesh.triangles.extend(copy.iter().copied());
    }
    let mut rng = KeyedRng::new(10, 0);
    let rays: Vec<Ray> = (0..2000)
        .map(|_| Ray::new(Vec3::ZERO, unit(&mut rng), f32::INFINITY))
        .collect();
    assert!(disagreements(&mesh, &rays) <= 1);
}

#[test]
fn answers_have_the_same_bits_for_any_thread_count() {
    // With coincident triangles, so that ties would show.
    let mut mesh = soup(20_000, 11);
    let copy = mesh.triangles[..5000].to_vec();
    mesh.triangles.extend(copy);
    let rays = random_rays(3 * BATCH + 17, 11);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            let tracer = EmbreeTracer::new(&mesh).expect("builds");
            let hits: Vec<[u32; 4]> = closest(&tracer, &rays)
                .iter()
                .map(|h| bytemuck::cast(*h))
                .collect();
            (hits, occluded(&tracer, &rays))
        })
    };
    let one = run(1);
    assert!(
        one == run(2) && one == run(5),
        "thread count changed an answer"
    );
}

#[test]
fn the_bare_loop_counts_what_the_batches_find() {
    let (mesh, rays) = (soup(500, 12), random_rays(4000, 12));
    let tracer = EmbreeTracer::new(&mesh).expect("builds");
    assert_eq!(
        tracer.scene().bare_closest(&rays),
        closest(&tracer, &rays)
            .iter()
            .filter(|h| h.is_hit())
            .count()
    );
    let blocked = occluded(&tracer, &rays).iter().filter(|&&o| o == 1).count();
    assert!(tracer.scene().bare_occluded(&rays).abs_diff(blocked) <= 2);
}

#[test]
fn the_floating_point_mode_is_restored() {
    let tracer = EmbreeTracer::new(&cube(1.0)).expect("builds");
    let _ = closest(&tracer, &random_rays(10, 13));
    let _ = occluded(&tracer, &random_rays(10, 13));
    let tiny = std::hint::black_box(1e-40f32);
    assert!(
        tiny * std::hint::black_box(0.5) > 0.0,
        "denormals are still flushed"
    );
}

#[test]
fn the_version_is_stated() {
    let version = embree_version();
    assert!(version.starts_with(['3', '4']), "{version}");
}

#[test]
fn rays_and_meshes_of_random_bits_end_nothing() {
    // Debian builds Embree with assertions, which would end the process on a ray it calls invalid.
    let bits = |seed: u64, i: u64| f32::from_bits(crate::core::sampling::hash_u64(seed, i) as u32);
    let ray = |i: u64| {
        let b = |k: u64| bits(21, i * 8 + k);
        Ray {
            origin: [b(0), b(1), b(2)],
            t_near: b(3),
            direction: [b(4), b(5), b(6)],
            t_far: b(7),
        }
    };
    let mut rays: Vec<Ray> = (0..20_000).map(ray).collect();
    // Usable, but at the limits.
    let limit = FAR_AWAY * 0.99;
    for (i, r) in rays.iter_mut().enumerate().step_by(3) {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        *r = Ray {
            origin: [sign * limit, 0.5, -limit],
            t_near: 0.0,
            direction: [-sign, 1e-12, 1.0],
            t_far: f32::MAX,
        };
        r.t_far = if i % 4 == 0 { f32::INFINITY } else { r.t_far };
    }
    let mut wild = Mesh::default();
    for i in 0..3000u64 {
        wild.positions.push(Vec3::new(
            bits(22, 3 * i),
            bits(22, 3 * i + 1),
            bits(22, 3 * i + 2),
        ));
    }
    // Far corners among near ones, and slivers across everything.
    wild.positions.extend([
        Vec3::splat(limit),
        Vec3::splat(-limit),
        Vec3::new(limit, -limit, 0.0),
        Vec3::splat(1e-38),
    ]);
    let n = wild.positions.len() as u32;
    wild.triangles = (0..n - 2).map(|i| [i, i + 1, (i * 7 + 2) % n]).collect();
    for mesh in [&wild, &soup(500, 23)] {
        let tracer = EmbreeTracer::new(mesh).expect("builds");
        for hit in closest(&tracer, &rays) {
            assert!(
                if hit.is_hit() {
                    hit.t.is_finite()
                } else {
                    hit == Hit::miss()
                },
                "{hit:?}"
            );
        }
        assert!(occluded(&tracer, &rays).iter().all(|&o| o <= 1));
    }
}
