//! Rays per second of the tracer on a synthetic room, and the directions that rays are drawn from.
//!
//! `cargo bench --bench rays`. `unbake bench irt SCENE` measures whole bakes.

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use unbake::core::geometry::Mesh;
use unbake::core::sampling::{KeyedRng, square_to_cosine_hemisphere, square_to_uniform_hemisphere};
use unbake::core::trace::{EmbreeTracer, Hit, Ray, Tracer};

/// Rays per call: one batch of the tracer.
const COUNT: usize = 4096;

fn main() {
    divan::main();
}

/// A sphere of 40 × 80 patches of radius 2 seen from inside: every ray hits.
fn sphere() -> Mesh {
    let (rows, columns) = (40u32, 80u32);
    let mut mesh = Mesh::default();
    for i in 0..=rows {
        for j in 0..columns {
            let theta = std::f32::consts::PI * i as f32 / rows as f32;
            let phi = std::f32::consts::TAU * j as f32 / columns as f32;
            let (y, x, z) = (
                theta.cos(),
                theta.sin() * phi.cos(),
                theta.sin() * phi.sin(),
            );
            mesh.positions.push(2.0 * Vec3::new(x, y, z));
        }
    }
    for i in 0..rows {
        for j in 0..columns {
            let at = |i: u32, j: u32| i * columns + j % columns;
            let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)];
            mesh.triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh
}

/// Rays from near the centre in directions uniform over a hemisphere.
fn rays(t_far: f32) -> Vec<Ray> {
    let mut rng = KeyedRng::new(7, 0);
    let mut next = || [rng.next_f32(), rng.next_f32()];
    (0..COUNT)
        .map(|_| {
            let [x, y] = next();
            let direction = square_to_uniform_hemisphere(next());
            Ray::new(0.2 * Vec3::new(x, y, 0.0), direction, t_far)
        })
        .collect()
}

#[divan::bench]
fn closest_hits(bencher: Bencher<'_, '_>) {
    let tracer = EmbreeTracer::new(&sphere()).expect("a scene");
    let (rays, mut hits) = (rays(f32::INFINITY), vec![Hit::miss(); COUNT]);
    bencher
        .counter(ItemsCount::new(COUNT))
        .bench_local(|| tracer.closest(&rays, &mut hits));
}

#[divan::bench]
fn occlusion(bencher: Bencher<'_, '_>) {
    let tracer = EmbreeTracer::new(&sphere()).expect("a scene");
    let (rays, mut occluded) = (rays(1.5), vec![0; COUNT]);
    bencher
        .counter(ItemsCount::new(COUNT))
        .bench_local(|| tracer.occluded(&rays, &mut occluded));
}

#[divan::bench]
fn cosine_directions(bencher: Bencher<'_, '_>) {
    let mut rng = KeyedRng::new(9, 0);
    let squares: Vec<[f32; 2]> = (0..COUNT)
        .map(|_| [rng.next_f32(), rng.next_f32()])
        .collect();
    bencher.counter(ItemsCount::new(COUNT)).bench_local(|| {
        squares
            .iter()
            .map(|&u| square_to_cosine_hemisphere(u))
            .sum::<Vec3>()
    });
}
