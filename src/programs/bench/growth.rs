//! How cost grows: with texels, with triangles, with threads.
//!
//! Triangles are multiplied by splitting every one into four coplanar ones (the rays then hit the
//! same places), and reduced by merging vertices on a grid (the rays then meet a coarser room).
//! Rays are the bake's own, traced without lookups: a changed mesh has no atlas of its own.

use super::irt_rates::{bare_closest, rays_of};
use super::{BenchScene, interleaved, median, timed};
use crate::Result;
use crate::core::geometry::Mesh;
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::irradiance::{Estimator, IrradianceOptions};
use crate::pipeline::bake_irradiance_texels;
use glam::Vec3;
use serde::Serialize;
use std::collections::HashMap;
use std::hint::black_box;

/// A bake of a whole texture.
#[derive(Clone, Debug, Serialize)]
pub struct TextureGrowth {
    /// Side of the texture.
    pub side: usize,
    /// Covered texels.
    pub texels: usize,
    /// Rays.
    pub rays: u64,
    /// Seconds.
    pub seconds: f64,
    /// Texels per second.
    pub texels_per_second: f64,
}

/// Tracing the same rays in a mesh of another size.
#[derive(Clone, Debug, Serialize)]
pub struct TriangleGrowth {
    /// Triangles.
    pub triangles: usize,
    /// Seconds to build the acceleration structure.
    pub build_seconds: f64,
    /// Closest hits per second through the batch interface.
    pub closest_per_second: f64,
    /// Closest hits per second of the bare loop.
    pub bare_closest_per_second: f64,
    /// Occlusion queries of the same rays per second.
    pub occluded_per_second: f64,
}

/// The cosine bake of the same texels on a number of threads.
#[derive(Clone, Debug, Serialize)]
pub struct ThreadGrowth {
    /// Threads.
    pub threads: usize,
    /// Rays per second end to end.
    pub rays_per_second: f64,
    /// Rays per second relative to one thread's.
    pub speedup: f64,
}

/// All three.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Growth {
    /// With texels.
    pub texels: Vec<TextureGrowth>,
    /// With triangles.
    pub triangles: Vec<TriangleGrowth>,
    /// With threads.
    pub threads: Vec<ThreadGrowth>,
}

/// Bakes whole textures of the given sides as the pipeline would.
#[must_use]
pub(super) fn with_texels(
    ground: &BenchScene,
    sides: &[usize],
    progress: &Progress,
) -> Vec<TextureGrowth> {
    sides
        .iter()
        .map(|&side| {
            let texels = Texels::rasterize(&ground.surface.scene.mesh, side, side);
            let (field, emitters) = (&ground.light.field, &ground.light.emitters);
            let (baked, seconds) = timed(|| {
                bake_irradiance_texels(
                    &ground.surface,
                    field,
                    emitters,
                    &texels,
                    &ground.options,
                    progress,
                )
            });
            TextureGrowth {
                side,
                texels: texels.len(),
                rays: baked.rays,
                seconds,
                texels_per_second: texels.len() as f64 / seconds,
            }
        })
        .collect()
}

/// Traces the same rays in meshes from about 10,000 triangles to `most`.
///
/// # Errors
/// Embree running out of memory.
pub(super) fn with_triangles(
    ground: &BenchScene,
    texels: &Texels,
    most: usize,
    progress: &Progress,
) -> Result<Vec<TriangleGrowth>> {
    let ids = ground.runs(texels, 2048);
    let (rays, _) = rays_of(ground, texels, &ids, &cosine(ground, 128));
    let mesh = &ground.surface.scene.mesh;
    let mut out = Vec::new();
    for target in [10_000, 40_000] {
        if target * 3 < mesh.triangles.len() * 2 {
            out.push(traced(&merged_to(mesh, target), &rays)?);
            progress.advance(1);
        }
    }
    let mut mesh = bare(mesh);
    out.push(traced(&mesh, &rays)?);
    while mesh.triangles.len() * 4 <= most {
        mesh = subdivided(&mesh);
        out.push(traced(&mesh, &rays)?);
        progress.advance(1);
    }
    Ok(out)
}

fn cosine(ground: &BenchScene, rays: u32) -> IrradianceOptions {
    IrradianceOptions {
        estimator: Estimator::Cosine,
        rays,
        emitter_samples: 0,
        seed: ground.options.seed,
        ..IrradianceOptions::default()
    }
}

fn traced(mesh: &Mesh, rays: &[Ray]) -> Result<TriangleGrowth> {
    let (tracer, build_seconds) = timed(|| EmbreeTracer::new(mesh));
    let tracer = tracer?;
    let mut hits = vec![Hit::miss(); rays.len()];
    let mut flags = vec![0u8; rays.len()];
    let mut tasks: Vec<Box<dyn FnMut()>> = vec![
        Box::new(|| tracer.closest(rays, &mut hits)),
        Box::new(|| {
            black_box(bare_closest(&tracer, rays));
        }),
        Box::new(|| tracer.occluded(rays, &mut flags)),
    ];
    let seconds = interleaved(3, &mut tasks);
    let rate = |s: f64| rays.len() as f64 / s;
    Ok(TriangleGrowth {
        triangles: mesh.triangles.len(),
        build_seconds,
        closest_per_second: rate(seconds[0]),
        bare_closest_per_second: rate(seconds[1]),
        occluded_per_second: rate(seconds[2]),
    })
}

/// The cosine bake of the same texels on 1, 2, 4, … threads and on all of this pool.
///
/// # Errors
/// Threads that cannot be started.
pub(super) fn with_threads(
    ground: &BenchScene,
    texels: &Texels,
    repetitions: usize,
) -> Result<Vec<ThreadGrowth>> {
    let most = rayon::current_num_threads();
    let mut counts: Vec<usize> = (0..)
        .map(|k| 1usize << k)
        .take_while(|n| *n < most)
        .collect();
    counts.push(most);
    let ids = ground.runs(texels, 4096);
    let options = cosine(ground, 64);
    let mut out: Vec<ThreadGrowth> = Vec::new();
    for threads in counts {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|e| crate::Error::Failed(format!("cannot start {threads} threads: {e}")))?;
        let mut seconds = Vec::new();
        let mut rays = 0;
        for _ in 0..repetitions.max(1) {
            let (baked, s) = timed(|| {
                pool.install(|| ground.bake_some(texels, &ids, &options, &Progress::silent()))
            });
            rays = baked.rays;
            seconds.push(s);
        }
        let rays_per_second = rays as f64 / median(&mut seconds);
        let speedup = out
            .first()
            .map_or(1.0, |one| rays_per_second / one.rays_per_second);
        out.push(ThreadGrowth {
            threads,
            rays_per_second,
            speedup,
        });
    }
    Ok(out)
}

/// Positions and triangles alone: all that tracing needs.
fn bare(mesh: &Mesh) -> Mesh {
    Mesh {
        positions: mesh.positions.clone(),
        triangles: mesh.triangles.clone(),
        ..Mesh::default()
    }
}

/// Every triangle split into four by the midpoints of its edges; shared edges keep sharing.
fn subdivided(mesh: &Mesh) -> Mesh {
    let mut positions = mesh.positions.clone();
    let mut middle: HashMap<(u32, u32), u32> = HashMap::with_capacity(mesh.triangles.len() * 3 / 2);
    let mut triangles = Vec::with_capacity(mesh.triangles.len() * 4);
    for &[a, b, c] in &mesh.triangles {
        let mut mid = |i: u32, j: u32| {
            *middle.entry((i.min(j), i.max(j))).or_insert_with(|| {
                positions.push((positions[i as usize] + positions[j as usize]) * 0.5);
                (positions.len() - 1) as u32
            })
        };
        let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
        triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    Mesh {
        positions,
        triangles,
        ..Mesh::default()
    }
}

/// Vertices merged on the finest grid that leaves at most `target` triangles.
fn merged_to(mesh: &Mesh, target: usize) -> Mesh {
    let (lo, hi) = mesh.bounds();
    let (mut fine, mut coarse) = (1e-4f32, (hi - lo).max_element().max(1e-3));
    let mut best = merged(mesh, lo, coarse);
    for _ in 0..16 {
        let cell = (fine * coarse).sqrt();
        let m = merged(mesh, lo, cell);
        if m.triangles.len() <= target {
            (coarse, best) = (cell, m);
        } else {
            fine = cell;
        }
    }
    best
}

fn merged(mesh: &Mesh, lo: Vec3, cell: f32) -> Mesh {
    let mut index: HashMap<[i32; 3], u32> = HashMap::new();
    let mut positions = Vec::new();
    let of: Vec<u32> = mesh
        .positions
        .iter()
        .map(|&p| {
            *index
                .entry(((p - lo) / cell).floor().to_array().map(|x| x as i32))
                .or_insert_with(|| {
                    positions.push(p);
                    (positions.len() - 1) as u32
                })
        })
        .collect();
    let triangles: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|i| of[i as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    Mesh {
        positions,
        triangles,
        ..Mesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn subdivision_keeps_area_and_shares_edges() {
        let fine = subdivided(&subdivided(&square()));
        assert_eq!(fine.triangles.len(), 32);
        assert_eq!(fine.positions.len(), 25, "a 5×5 grid");
        let area: f32 = (0..fine.triangles.len()).map(|t| fine.area(t)).sum();
        assert!((area - 1.0).abs() < 1e-6);
    }

    #[test]
    fn merging_stays_below_the_target() {
        let fine = subdivided(&subdivided(&subdivided(&subdivided(&square()))));
        let coarse = merged_to(&fine, 100);
        assert!(
            (20..=100).contains(&coarse.triangles.len()),
            "{} triangles",
            coarse.triangles.len()
        );
    }
}
