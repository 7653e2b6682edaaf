//! Cameras where none are given: places inside the scene from which much of it is seen.

use super::NamedCamera;
use crate::core::geometry::{Camera, Lens, Mesh, Projection};
use crate::core::sampling::{SobolSequence, hammersley};
use crate::core::trace::{Hit, Ray, Tracer};
use glam::{Mat3, Vec3};
use std::f32::consts::TAU;

/// Places tried.
const CANDIDATES: u32 = 512;
/// Rays per place.
const RAYS: u32 = 128;

/// A place tried.
#[derive(Clone, Copy)]
struct Candidate {
    /// How good a view it has: fronts all around, depth, nothing close before the lens.
    score: f32,
    position: Vec3,
    /// Radians of the widest view at eye level: 0 along -z, growing towards +x.
    azimuth: f32,
}

/// Up to `count` pinhole cameras of `width` × `height`, far apart from one another, each looking
/// along the widest view at eye level. Empty only if no place of the bounding box sees the front of
/// a surface.
#[must_use]
pub fn viewpoints(
    mesh: &Mesh,
    tracer: &dyn Tracer,
    count: usize,
    width: usize,
    height: usize,
) -> Vec<NamedCamera> {
    let lens = Lens::centred(width, height, 70.0);
    let camera = |(i, c): (usize, &Candidate)| NamedCamera {
        name: format!("view{}", i + 1),
        camera: Camera {
            projection: Projection::Pinhole(lens),
            width,
            height,
            world_from_camera: Mat3::from_rotation_y(-c.azimuth) * Mat3::from_rotation_x(-0.08),
            position: c.position,
        },
    };
    apart(candidates(mesh, tracer), count)
        .iter()
        .enumerate()
        .take(count)
        .map(camera)
        .collect()
}

/// The places tried that lie inside, best first.
fn candidates(mesh: &Mesh, tracer: &dyn Tracer) -> Vec<Candidate> {
    let (lo, hi) = mesh.bounds();
    let sequence = SobolSequence::new(0x1e3, 7);
    let directions: Vec<Vec3> = (0..RAYS)
        .map(|k| {
            let u = hammersley(k, RAYS);
            let (z, phi) = (1.0 - 2.0 * (u[1] + 0.5 / RAYS as f32), TAU * u[0]);
            let r = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(r * phi.cos(), z, r * phi.sin())
        })
        .collect();
    let mut scored: Vec<Candidate> = (0..CANDIDATES)
        .filter_map(|i| {
            let u = sequence.point3(i);
            let p = lo + (hi - lo) * Vec3::new(u[0], 0.35 + 0.35 * u[1], u[2]);
            judge(mesh, tracer, &directions, p)
        })
        .collect();
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    scored
}

/// What is seen from `position` along `directions`; `None` where that is not inside.
fn judge(
    mesh: &Mesh,
    tracer: &dyn Tracer,
    directions: &[Vec3],
    position: Vec3,
) -> Option<Candidate> {
    let (lo, hi) = mesh.bounds();
    let rays: Vec<Ray> = directions
        .iter()
        .map(|&d| Ray::new(position, d, f32::INFINITY))
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let (mut fronts, mut depth, mut nearest) = (0.0f32, 0.0f32, f32::INFINITY);
    let mut widest = [0.0f32; 8];
    for (d, h) in directions.iter().zip(&hits).filter(|(_, h)| h.is_hit()) {
        nearest = nearest.min(h.t);
        if mesh.face_normal(h.triangle as usize).dot(*d) < 0.0 {
            fronts += 1.0 / RAYS as f32;
            depth += h.t.max(1e-6).ln() / RAYS as f32;
            if d.y.abs() < 0.5 {
                widest[((d.x.atan2(-d.z) / TAU + 0.5) * 8.0) as usize % 8] += h.t;
            }
        }
    }
    let sector = (0..8)
        .max_by(|&a, &b| widest[a].total_cmp(&widest[b]))
        .unwrap_or(0);
    let close = nearest / (0.03 * (hi - lo).length());
    // inside means: fronts all around; the view should be deep and nothing should stand before the
    // lens
    (fronts > 0.3).then(|| Candidate {
        score: 3.0 * fronts + depth + close.min(1.0),
        position,
        azimuth: TAU * ((sector as f32 + 0.5) / 8.0 - 0.5),
    })
}

/// `count` of the candidates, the best of all first: of the better half, which is good enough, each
/// time the one farthest from what is chosen already.
fn apart(mut scored: Vec<Candidate>, count: usize) -> Vec<Candidate> {
    scored.truncate((scored.len() / 2).max(1));
    let mut chosen: Vec<Candidate> = scored.first().copied().into_iter().collect();
    while chosen.len() < count.min(scored.len()) {
        let far = |c: &Candidate| {
            chosen
                .iter()
                .map(|o| (o.position - c.position).length())
                .fold(f32::INFINITY, f32::min)
        };
        match scored.iter().max_by(|a, b| far(a).total_cmp(&far(b))) {
            Some(best) => chosen.push(*best),
            None => break,
        }
    }
    chosen
}
