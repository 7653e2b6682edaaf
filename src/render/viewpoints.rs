//! Cameras where none are given: places inside the scene from which much of it is seen.

use super::NamedCamera;
use crate::geometry::{Camera, Lens, Mesh, Projection};
use crate::sampling::{SobolSequence, hammersley};
use crate::trace::{Hit, Ray, Tracer};
use glam::{Mat3, Vec3};
use std::f32::consts::TAU;

/// Places tried.
const CANDIDATES: u32 = 512;
/// Rays per place.
const RAYS: u32 = 128;

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
    let mut scored: Vec<(f32, Vec3, f32)> = (0..CANDIDATES)
        .filter_map(|i| {
            let u = sequence.point3(i);
            let p = lo + (hi - lo) * Vec3::new(u[0], 0.35 + 0.35 * u[1], u[2]);
            let rays: Vec<Ray> = directions
                .iter()
                .map(|&d| Ray::new(p, d, f32::INFINITY))
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
            // inside means: fronts all around; the view should be deep and nothing should stand
            // before the lens
            (fronts > 0.3).then(|| {
                (
                    3.0 * fronts + depth + close.min(1.0),
                    p,
                    TAU * ((sector as f32 + 0.5) / 8.0 - 0.5),
                )
            })
        })
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    // the better half is good enough: among it, far from what is chosen already
    scored.truncate((scored.len() / 2).max(1));
    let mut chosen: Vec<(f32, Vec3, f32)> = scored.first().copied().into_iter().collect();
    while chosen.len() < count.min(scored.len()) {
        let far = |c: &(f32, Vec3, f32)| {
            chosen
                .iter()
                .map(|o| (o.1 - c.1).length())
                .fold(f32::INFINITY, f32::min)
        };
        match scored.iter().max_by(|a, b| far(a).total_cmp(&far(b))) {
            Some(best) => chosen.push(*best),
            None => break,
        }
    }
    let lens = Lens::centred(width, height, 70.0);
    let camera = |(i, &(_, position, azimuth)): (usize, &(f32, Vec3, f32))| NamedCamera {
        name: format!("view{}", i + 1),
        camera: Camera {
            projection: Projection::Pinhole(lens),
            width,
            height,
            // azimuth 0 looks along -z, growing towards +x
            world_from_camera: Mat3::from_rotation_y(-azimuth) * Mat3::from_rotation_x(-0.08),
            position,
        },
    };
    chosen.iter().enumerate().take(count).map(camera).collect()
}
