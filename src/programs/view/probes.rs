//! Reflections for the page while it moves: panoramas of the reconstructed radiance from the middle of each
//! room, blurred for rising roughness. At rest the page traces them ([`super::ray_tree`]).
//!
//! The page looks reflections up in the nearest probe of the surface's room and corrects for the
//! distance between the surface and the probe with the distances stored beside the radiance. That
//! is an approximation (what the probe does not see is missing, and no probe knows the surface's
//! own surroundings).

use super::encode::{gzip, rgb9e5};
use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::Frame;
use crate::core::parallel::prelude::*;
use crate::core::sampling::{KeyedRng, hammersley};
use crate::core::texture::MipChain;
use crate::core::trace::{Hit, Ray, Tracer};
use crate::solution::Solution;
use glam::{Mat3, Vec2, Vec3};
use half::f16;
use std::collections::BTreeMap;
use std::f32::consts::TAU;

/// Width of a probe's sharpest panorama; the height is half of it.
const WIDTH: usize = 256;
/// Levels: the k-th has half the width of the one before and shows roughness k / (LEVELS − 1).
pub const LEVELS: usize = 6;
/// Probes in all, and per room.
const MAX_PROBES: usize = 8;
const PER_ROOM: usize = 2;
/// Places tried per room, and directions looked in from each.
const CANDIDATES: u64 = 96;
const LOOKS: u32 = 48;
/// Samples of the blur.
const BLUR: u32 = 128;

/// A place from which reflections are looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// Where it is.
    pub position: Vec3,
    /// The room it serves.
    pub room: u16,
}

/// An equirectangular camera at `position` in world axes.
fn camera(width: usize, position: Vec3) -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width,
        height: width / 2,
        world_from_camera: Mat3::IDENTITY,
        position,
    }
}

/// Radiance of the environment from a direction.
#[must_use]
pub fn sky(environment: &RgbPlane, direction: Vec3) -> Vec3 {
    let view = Camera {
        height: environment.height,
        ..camera(environment.width, Vec3::ZERO)
    };
    view.project(direction)
        .map_or(Vec3::ZERO, |p| environment.bilinear(p, Wrap::Repeat))
}

/// Places with a clear view, at most two per room, in rooms of falling size.
#[must_use]
pub fn place(solution: &Solution, tracer: &dyn Tracer) -> Vec<Probe> {
    let mesh = &solution.mesh;
    let size = Vec2::new(solution.rooms.width as f32, solution.rooms.height as f32);
    let mut boxes: BTreeMap<u16, (Vec3, Vec3, f32)> = BTreeMap::new();
    for t in 0..mesh.triangles.len() {
        let room = *solution.rooms.nearest(mesh.uv(t, 0.33, 0.33) * size);
        let b = boxes
            .entry(room)
            .or_insert((Vec3::INFINITY, Vec3::NEG_INFINITY, 0.0));
        let p = mesh.position(t, 0.33, 0.33);
        *b = (b.0.min(p), b.1.max(p), b.2 + mesh.area(t));
    }
    if boxes.len() > 1 {
        boxes.remove(&0);
    }
    let mut rooms: Vec<_> = boxes.into_iter().collect();
    rooms.sort_by(|a, b| b.1.2.total_cmp(&a.1.2).then(a.0.cmp(&b.0)));
    rooms.truncate(MAX_PROBES);
    let per_room = (MAX_PROBES / rooms.len().max(1)).clamp(1, PER_ROOM);
    rooms
        .par_iter()
        .flat_map_iter(|&(room, (low, high, _))| {
            let candidates: Vec<(Vec3, f32)> = (0..CANDIDATES)
                .map(|i| {
                    let mut random = KeyedRng::new(u64::from(room), i);
                    let f = Vec3::new(
                        0.1 + 0.8 * random.next_f32(),
                        0.35 + 0.3 * random.next_f32(),
                        0.1 + 0.8 * random.next_f32(),
                    );
                    let p = low + (high - low) * f;
                    (p, clearance(p, mesh, tracer))
                })
                .collect();
            let mut chosen: Vec<Vec3> = Vec::new();
            for _ in 0..per_room {
                // far from surfaces and from the probes there are already
                let score = |c: &(Vec3, f32)| {
                    chosen
                        .iter()
                        .map(|p| 0.3 * p.distance(c.0))
                        .fold(c.1, f32::min)
                };
                if let Some(best) = candidates
                    .iter()
                    .max_by(|a, b| score(a).total_cmp(&score(b)))
                    .filter(|b| score(b) > 0.0)
                {
                    chosen.push(best.0);
                }
            }
            if chosen.is_empty() {
                chosen.push(0.5 * (low + high));
            }
            chosen
                .into_iter()
                .map(move |position| Probe { position, room })
        })
        .collect()
}

/// Distance to the nearest surface seen; negative where many surfaces show their back (inside a
/// wall or a piece of furniture).
fn clearance(p: Vec3, mesh: &crate::core::geometry::Mesh, tracer: &dyn Tracer) -> f32 {
    let rays: Vec<Ray> = (0..LOOKS)
        .map(|i| Ray::new(p, sphere(hammersley(i, LOOKS)), f32::INFINITY))
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let back = |ray: &Ray, hit: &Hit| {
        hit.is_hit()
            && mesh
                .face_normal(hit.triangle as usize)
                .dot(Vec3::from(ray.direction))
                > 0.0
    };
    let backs = rays.iter().zip(&hits).filter(|(r, h)| back(r, h)).count();
    let misses = hits.iter().filter(|h| !h.is_hit()).count();
    if 4 * backs > rays.len() || 2 * misses > rays.len() {
        return -1.0;
    }
    hits.iter()
        .filter(|h| h.is_hit())
        .map(|h| h.t)
        .fold(f32::MAX, f32::min)
}

fn sphere(u: [f32; 2]) -> Vec3 {
    let y = 1.0 - 2.0 * u[0];
    let r = (1.0 - y * y).max(0.0).sqrt();
    let (sin, cos) = (TAU * u[1]).sin_cos();
    Vec3::new(r * cos, y, r * sin)
}

/// How the light of what probes see has changed.
pub struct Relit<'a> {
    /// Factor on the light that surfaces send out and do not emit, on the atlas.
    pub reflected: RgbPlane,
    /// Factor on what each triangle emits; `None` where it is no light.
    pub emitted: &'a [Option<Vec3>],
    /// Factor on the light from outside.
    pub outside: Vec3,
}

/// The panoramas of all probes, gzip-compressed: for each level and each probe the radiance times
/// `scale` (RGB9E5), then for each probe the distances (half floats, 0 where nothing is hit).
#[must_use]
pub fn panoramas(
    solution: &Solution,
    probes: &[Probe],
    tracer: &dyn Tracer,
    scale: f32,
    relit: Option<&Relit<'_>>,
) -> Vec<u8> {
    let seen: Vec<(Vec<RgbPlane>, Vec<f16>)> = probes
        .par_iter()
        .map(|p| look(solution, p, tracer, relit))
        .collect();
    let mut bytes = Vec::new();
    for level in 0..LEVELS {
        for (levels, _) in &seen {
            bytes.extend(
                levels[level]
                    .data
                    .iter()
                    .flat_map(|v| rgb9e5(*v * scale).to_le_bytes()),
            );
        }
    }
    for (_, distance) in &seen {
        bytes.extend(distance.iter().flat_map(|d| d.to_le_bytes()));
    }
    gzip(&bytes)
}

/// Radiance levels and distances around one probe.
fn look(
    solution: &Solution,
    probe: &Probe,
    tracer: &dyn Tracer,
    relit: Option<&Relit<'_>>,
) -> (Vec<RgbPlane>, Vec<f16>) {
    let view = camera(WIDTH, probe.position);
    let pixel = |i: usize| {
        view.direction(Vec2::new(
            (i % WIDTH) as f32 + 0.5,
            (i / WIDTH) as f32 + 0.5,
        ))
    };
    let rays: Vec<Ray> = (0..WIDTH * WIDTH / 2)
        .map(|i| Ray::new(probe.position, pixel(i), f32::INFINITY))
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let (radiance, emission) = (&solution.radiance, &solution.emission);
    let shade = |(ray, hit): (&Ray, &Hit)| {
        if !hit.is_hit() {
            let outside = relit.map_or(Vec3::ONE, |r| r.outside);
            return sky(&solution.environment, Vec3::from(ray.direction)) * outside;
        }
        let uv = solution.mesh.uv(hit.triangle as usize, hit.u, hit.v);
        let at = |p: &RgbPlane| uv * Vec2::new(p.width as f32, p.height as f32);
        let reflected = radiance.bilinear(at(radiance), Wrap::Clamp);
        let emitted = *emission.nearest(at(emission));
        let Some(relit) = relit else {
            return reflected.max(emitted);
        };
        if let Some(factor) = relit.emitted[hit.triangle as usize] {
            return emitted * factor;
        }
        reflected * relit.reflected.bilinear(at(&relit.reflected), Wrap::Clamp)
    };
    let sharp = Plane {
        width: WIDTH,
        height: WIDTH / 2,
        data: rays.iter().zip(&hits).map(shade).collect(),
    };
    let distance = hits
        .iter()
        .map(|h| f16::from_f32(if h.is_hit() { h.t.min(60_000.0) } else { 0.0 }))
        .collect();
    let mips = MipChain::new(sharp.clone(), 5);
    let mut levels = vec![sharp];
    for k in 1..LEVELS {
        levels.push(blurred(&mips, WIDTH >> k, k as f32 / (LEVELS - 1) as f32));
    }
    (levels, distance)
}

/// The panorama as a surface of roughness R facing each direction would reflect it, seen head-on
/// (GGX, α = R²).
fn blurred(mips: &MipChain<Vec3>, width: usize, roughness: f32) -> RgbPlane {
    let (view, height) = (camera(width, Vec3::ZERO), width / 2);
    let alpha2 = roughness.powi(4);
    // fewer samples than pixels in the lobe: each stands for a patch
    let footprint = (4.0 * roughness * roughness * WIDTH as f32 / 16.0).clamp(1.0, 16.0);
    let pixel = |i: usize| {
        let n = view.direction(Vec2::new(
            (i % width) as f32 + 0.5,
            (i / width) as f32 + 0.5,
        ));
        let frame = Frame::from_normal(n);
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
        for s in 0..BLUR {
            let [a, b] = hammersley(s, BLUR);
            let tan2 = alpha2 * a / (1.0 - a).max(1e-6);
            let cos = (1.0 / (1.0 + tan2)).sqrt();
            let (sin_phi, cos_phi) = (TAU * b).sin_cos();
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            let h = Vec3::new(sin * cos_phi, sin * sin_phi, cos);
            let l = 2.0 * cos * h - Vec3::Z;
            if l.z <= 0.0 {
                continue;
            }
            let p = camera(WIDTH, Vec3::ZERO)
                .project(frame.world_from_local(l))
                .unwrap_or_default();
            let uv = p / Vec2::new(WIDTH as f32, WIDTH as f32 / 2.0);
            sum += mips.lookup(uv, footprint) * l.z;
            weight += l.z;
        }
        sum / f32::max(weight, 1e-6)
    };
    Plane {
        width,
        height,
        data: (0..width * height).into_par_iter().map(pixel).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::BruteForce;
    use crate::solution::tests::small_solution;

    #[test]
    fn blur_keeps_a_constant_and_spreads_a_light() {
        let constant = MipChain::new(Plane::filled(WIDTH, WIDTH / 2, Vec3::new(0.5, 1.0, 2.0)), 5);
        for v in blurred(&constant, 16, 0.6).data {
            assert!((v - Vec3::new(0.5, 1.0, 2.0)).abs().max_element() < 1e-4);
        }
        let mut spot = Plane::filled(WIDTH, WIDTH / 2, Vec3::ZERO);
        for y in 60..68 {
            for x in 124..132 {
                spot[(x, y)] = Vec3::splat(100.0);
            }
        }
        let chain = MipChain::new(spot, 5);
        let peak = |r: f32| {
            blurred(&chain, 64, r)
                .data
                .iter()
                .map(|v| v.x)
                .fold(0.0, f32::max)
        };
        assert!(
            peak(0.2) > 2.0 * peak(0.5) && peak(0.5) > 2.0 * peak(1.0),
            "{} {} {}",
            peak(0.2),
            peak(0.5),
            peak(1.0)
        );
    }

    #[test]
    fn the_sky_follows_the_contracts_axes() {
        let mut map = Plane::filled(8, 4, Vec3::ZERO);
        map.data[..8].fill(Vec3::ONE);
        assert_eq!(sky(&map, Vec3::Y), Vec3::ONE);
        assert_eq!(sky(&map, Vec3::NEG_Y), Vec3::ZERO);
    }

    #[test]
    fn changed_light_is_seen_in_reflections() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::ZERO);
        let tracer = BruteForce::new(&solution.mesh);
        let probe = Probe {
            position: Vec3::new(0.0, 1.0, 0.5),
            room: 1,
        };
        let emitted = [None, None];
        let relit = Relit {
            reflected: Plane::filled(4, 4, Vec3::new(2.0, 1.0, 0.0)),
            emitted: &emitted,
            outside: Vec3::splat(3.0),
        };
        let before = look(&solution, &probe, &tracer, None).0;
        let after = look(&solution, &probe, &tracer, Some(&relit)).0;
        let (up, down) = (WIDTH / 2, (WIDTH / 2 - 1) * WIDTH + WIDTH / 2);
        assert_eq!(after[0].data[up], 3.0 * before[0].data[up]);
        assert_eq!(
            after[0].data[down],
            before[0].data[down] * Vec3::new(2.0, 1.0, 0.0)
        );
    }

    #[test]
    fn panoramas_have_the_promised_length() {
        let solution = small_solution();
        let tracer = BruteForce::new(&solution.mesh);
        let probes = place(&solution, &tracer);
        assert!(!probes.is_empty() && probes.len() <= MAX_PROBES);
        let packed = panoramas(&solution, &probes, &tracer, 1.0, None);
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut bytes)
            .expect("unpacks");
        let texels: usize = (0..LEVELS).map(|k| (WIDTH >> k) * (WIDTH >> k) / 2).sum();
        assert_eq!(bytes.len(), probes.len() * (4 * texels + WIDTH * WIDTH));
    }
}
