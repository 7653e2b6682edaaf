//! Sliders of the page for the solution's lamps, and the share of the light on every texel that
//! comes directly from each.
//!
//! With the shares, the page can dim and brighten lamps at once: a texel's irradiance is multiplied
//! by 1 + Σ (s − 1)(f + (1 − Σf) g), where s is the lamp's slider, f the directly received share
//! (traced here, with shadows) and g the lamp's share of all direct light, which stands for its
//! part of the bounces. All sliders at s give exactly s times the light.

use super::encode::gzip;
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, Wrap};
use crate::core::math::{Frame, luminance};
use crate::core::parallel::prelude::*;
use crate::core::sampling::{Discrete, KeyedRng, square_to_cosine_hemisphere, square_to_triangle};
use crate::core::texture::{Texels, fill_uncovered};
use crate::core::trace::{Ray, Tracer};
use crate::solution::{Lamp, Solution, triangle_emission};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Sliders of lamps: the strongest have one of their own, the last is for all others.
const SLIDERS: usize = 11;
/// Longest side of the share textures.
const SIDE: usize = 256;
/// Shadow rays per texel, divided among the lamps.
const SHADOW_RAYS: usize = 96;
/// Rays per texel that look for the sky.
const SKY_RAYS: usize = 64;
/// Texels per parallel piece.
const CHUNK: usize = 32;

/// One or several lamps of the solution, or the light from outside.
#[derive(Clone, Debug)]
pub struct Slider {
    /// What the page calls it.
    pub name: String,
    /// Numbers of its lamps in `lights.json`; empty for the light from outside.
    pub ids: Vec<usize>,
    /// Emitting triangles; empty for the light from outside.
    pub triangles: Vec<u32>,
    /// Middle of its bounding box.
    pub centre: Vec3,
    /// Emitted power in the images' unit times square metres.
    pub power: f32,
    /// Class of its largest triangle.
    pub class: u16,
}

/// The sliders of a solution in the order of its lamps' numbers; light from outside, if there is
/// any, comes last.
#[must_use]
pub fn sliders(solution: &Solution) -> Vec<Slider> {
    let lamps = &solution.lamps;
    let own = if lamps.len() <= SLIDERS {
        lamps.len()
    } else {
        SLIDERS - 1
    };
    let mut out: Vec<Slider> = lamps[..own]
        .iter()
        .map(|l| slider(solution, format!("Lamp {}", l.id), std::slice::from_ref(l)))
        .collect();
    if let [first, .., last] = &lamps[own..] {
        let name = format!("Lamps {} to {}", first.id, last.id);
        out.push(slider(solution, name, &lamps[own..]));
    }
    if solution.environment.data.iter().any(|v| *v != Vec3::ZERO) {
        out.push(Slider {
            name: "Light from outside".to_owned(),
            ids: Vec::new(),
            triangles: Vec::new(),
            centre: Vec3::ZERO,
            power: 0.0,
            class: 0,
        });
    }
    out
}

/// Number of the lamp of every vertex, counted from 1; 0 where nothing emits.
#[must_use]
pub fn lamp_of_vertices(mesh: &Mesh, lamps: &[Slider]) -> Vec<u8> {
    let mut out = vec![0; mesh.positions.len()];
    for (i, lamp) in lamps.iter().enumerate() {
        for &t in &lamp.triangles {
            for v in mesh.triangles[t as usize] {
                out[v as usize] = i as u8 + 1;
            }
        }
    }
    out
}

fn slider(solution: &Solution, name: String, lamps: &[Lamp]) -> Slider {
    let mesh = &solution.mesh;
    let mut triangles: Vec<u32> = lamps
        .iter()
        .flat_map(|l| l.triangles.iter().copied())
        .collect();
    triangles.sort_unstable();
    let corners = || triangles.iter().flat_map(|&t| mesh.corners(t as usize));
    let (low, high) = corners().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| {
        (l.min(p), h.max(p))
    });
    let largest = triangles
        .iter()
        .max_by(|a, b| mesh.area(**a as usize).total_cmp(&mesh.area(**b as usize)));
    let class = largest.map_or(0, |&t| {
        let size = Vec2::new(solution.labels.width as f32, solution.labels.height as f32);
        *solution
            .labels
            .nearest(mesh.uv(t as usize, 0.33, 0.33) * size)
    });
    Slider {
        name,
        ids: lamps.iter().map(|l| l.id).collect(),
        triangles,
        centre: 0.5 * (low + high),
        power: lamps.iter().map(Lamp::strength).sum(),
        class,
    }
}

/// The shares of all lamps on a small atlas.
pub struct Shares {
    /// Width of the textures.
    pub width: usize,
    /// Height of the textures.
    pub height: usize,
    /// Per lamp its share of all direct light in the scene.
    pub bounce: Vec<f32>,
    /// Gzip-compressed bytes: one plane per lamp, a byte per texel, the square root of the share
    /// times 255.
    pub planes: Vec<u8>,
}

/// Traces the direct light of every lamp to every texel.
#[must_use]
pub fn shares(solution: &Solution, lamps: &[Slider], tracer: &dyn Tracer) -> Shares {
    let mesh = &solution.mesh;
    let (width, height) = (
        solution.irradiance.width.clamp(1, SIDE),
        solution.irradiance.height.clamp(1, SIDE),
    );
    let texels = Texels::rasterize(mesh, width, height);
    let emission = triangle_emission(mesh, &solution.emission);
    let tables: Vec<Option<Discrete>> = lamps
        .iter()
        .map(|l| {
            let weight =
                |&t: &u32| f64::from(luminance(emission[t as usize]) * mesh.area(t as usize));
            Discrete::new(&l.triangles.iter().map(weight).collect::<Vec<f64>>())
        })
        .collect();
    let (low, high) = mesh.bounds();
    let gather = Gather {
        solution,
        lamps,
        tables: &tables,
        tracer,
        offset: (high - low).length() * 1e-5,
        texels: &texels,
    };
    let pieces: Vec<Vec<f32>> = (0..texels.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|c| gather.piece(c * CHUNK..((c + 1) * CHUNK).min(texels.len())))
        .collect();
    let direct: Vec<f32> = pieces.concat();
    let n = lamps.len();
    let mut total = vec![0.0f64; n];
    let mut share = vec![vec![0.0f32; texels.len()]; n];
    for i in 0..texels.len() {
        let area = f64::from(texels.area(mesh, i));
        let c = texels.cell[i] as usize;
        let uv = Vec2::new((c % width) as f32 + 0.5, (c / width) as f32 + 0.5)
            / Vec2::new(width as f32, height as f32);
        let size = Vec2::new(
            solution.irradiance.width as f32,
            solution.irradiance.height as f32,
        );
        let all = luminance(solution.irradiance.bilinear(uv * size, Wrap::Clamp));
        let here = &direct[i * n..(i + 1) * n];
        // the estimate is noisy: together the lamps cannot give more than there is
        let whole = all.max(here.iter().sum());
        for l in 0..n {
            total[l] += area * f64::from(here[l]);
            share[l][i] = if whole > 0.0 { here[l] / whole } else { 0.0 };
        }
    }
    let sum: f64 = total.iter().sum();
    let bounce = total
        .iter()
        .map(|t| if sum > 0.0 { (t / sum) as f32 } else { 0.0 })
        .collect();
    let covered = texels.scatter(&vec![true; texels.len()], false);
    let planes: Vec<Vec<u8>> = share
        .par_iter()
        .map(|s| {
            let filled: Plane<f32> = fill_uncovered(&texels.scatter(s, 0.0), &covered);
            filled
                .data
                .iter()
                .map(|x| (x.clamp(0.0, 1.0).sqrt() * 255.0 + 0.5) as u8)
                .collect()
        })
        .collect();
    Shares {
        width,
        height,
        bounce,
        planes: gzip(&planes.concat()),
    }
}

/// Everything needed to gather direct light at texels.
struct Gather<'a> {
    solution: &'a Solution,
    lamps: &'a [Slider],
    tables: &'a [Option<Discrete>],
    tracer: &'a dyn Tracer,
    offset: f32,
    texels: &'a Texels,
}

impl Gather<'_> {
    /// Luminance of the direct irradiance, lamp by lamp, at a run of texels.
    fn piece(&self, range: std::ops::Range<usize>) -> Vec<f32> {
        let n = self.lamps.len();
        let mut out = vec![0.0; range.len() * n];
        let (mut rays, mut gains) = (Vec::new(), Vec::new());
        for (i, texel) in range.enumerate() {
            self.shoot(texel, i * n, &mut rays, &mut gains);
        }
        let mut hidden = vec![0u8; rays.len()];
        self.tracer.occluded(&rays, &mut hidden);
        for ((slot, gain), hidden) in gains.into_iter().zip(hidden) {
            if hidden == 0 {
                out[slot] += gain;
            }
        }
        out
    }

    fn shoot(&self, texel: usize, slot: usize, rays: &mut Vec<Ray>, gains: &mut Vec<(usize, f32)>) {
        let mesh = &self.solution.mesh;
        let point = self.texels.point[texel];
        let normal = mesh.face_normal(point.triangle as usize);
        let position = self.texels.position(mesh, texel) + normal * self.offset;
        let mut random = KeyedRng::new(0x6c61_6d70, u64::from(self.texels.cell[texel]));
        let per_lamp = (SHADOW_RAYS / self.lamps.len().max(1)).max(6);
        for (l, lamp) in self.lamps.iter().enumerate() {
            if lamp.triangles.is_empty() {
                self.sky(position, normal, slot + l, &mut random, rays, gains);
                continue;
            }
            let Some(table) = &self.tables[l] else {
                continue;
            };
            for s in 0..per_lamp {
                let (k, _) = table.sample((s as f32 + random.next_f32()) / per_lamp as f32);
                let t = lamp.triangles[k] as usize;
                let [u, v] = square_to_triangle([random.next_f32(), random.next_f32()]);
                let to = mesh.position(t, u, v) - position;
                let distance = to.length();
                let direction = to / distance;
                let (cos_here, cos_lamp) = (
                    normal.dot(direction),
                    mesh.face_normal(t).dot(direction).abs(),
                );
                if !(cos_here > 0.0 && distance > 4.0 * self.offset) {
                    continue;
                }
                // the table chose the triangle by its mean radiance times its area, so that
                // radiance/density is a constant
                let intensity = lamp.power / PI / per_lamp as f32;
                rays.push(Ray::new(position, direction, distance - 4.0 * self.offset));
                gains.push((
                    slot + l,
                    intensity * cos_here * cos_lamp / (distance * distance),
                ));
            }
        }
    }

    /// Cosine-distributed rays; what escapes brings the sky's light.
    fn sky(
        &self,
        position: Vec3,
        normal: Vec3,
        slot: usize,
        random: &mut KeyedRng,
        rays: &mut Vec<Ray>,
        gains: &mut Vec<(usize, f32)>,
    ) {
        let frame = Frame::from_normal(normal);
        let side = SKY_RAYS.isqrt();
        for i in 0..side * side {
            let u = [
                ((i % side) as f32 + random.next_f32()) / side as f32,
                ((i / side) as f32 + random.next_f32()) / side as f32,
            ];
            let direction = frame.world_from_local(square_to_cosine_hemisphere(u));
            let sky = luminance(super::probes::sky(&self.solution.environment, direction));
            if sky > 0.0 {
                rays.push(Ray::new(position, direction, f32::INFINITY));
                gains.push((slot, PI * sky / (side * side) as f32));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::BruteForce;
    use crate::solution::find_lamps;
    use glam::DVec3;

    /// A floor of 2 m, and above it, 2 m high, two lamps facing down whose radiances differ by the
    /// given factor.
    fn room(factor: f32) -> Solution {
        let mut mesh = Mesh::default();
        let mut quad = |centre: Vec3, half: f32, up: bool, u0: f32, u1: f32| {
            let base = mesh.positions.len() as u32;
            for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                mesh.positions.push(centre + Vec3::new(x, 0.0, z) * half);
                mesh.normals.push(if up { Vec3::Y } else { Vec3::NEG_Y });
                mesh.uvs.push(Vec2::new(
                    if x < 0.0 { u0 } else { u1 },
                    if z < 0.0 { 0.02 } else { 0.98 },
                ));
            }
            let faces = if up {
                [[0, 2, 1], [0, 3, 2]]
            } else {
                [[0, 1, 2], [0, 2, 3]]
            };
            mesh.triangles
                .extend(faces.map(|f: [u32; 3]| f.map(|i| i + base)));
        };
        quad(Vec3::ZERO, 1.0, true, 0.02, 0.48);
        quad(Vec3::new(-0.9, 2.0, 0.0), 0.05, false, 0.55, 0.7);
        quad(Vec3::new(0.9, 2.0, 0.0), 0.05, false, 0.8, 0.95);
        let mut emission = Plane::filled(64, 64, Vec3::ZERO);
        for y in 0..64 {
            for x in 33..64 {
                emission.data[y * 64 + x] = if x < 48 {
                    Vec3::ONE
                } else {
                    Vec3::splat(factor)
                };
            }
        }
        Solution {
            lamps: find_lamps(&mesh, &emission, DVec3::ZERO),
            portals: Vec::new(),
            mesh,
            origin: DVec3::ZERO,
            albedo: Plane::filled(8, 8, Vec3::splat(0.5)),
            roughness: Plane::filled(8, 8, 0.5),
            irradiance: Plane::filled(64, 64, Vec3::splat(1e-6)),
            radiance: Plane::filled(8, 8, Vec3::ZERO),
            emission,
            confidence: Plane::filled(8, 8, Vec2::ZERO),
            metallic: None,
            transmission: None,
            irradiance_error: None,
            camera_masks: Vec::new(),
            labels: Plane::filled(8, 8, 3),
            rooms: Plane::filled(8, 8, 1),
            reflectance: crate::core::brdf::Reflectance::Paper,
            environment: Plane::filled(8, 4, Vec3::ZERO),
        }
    }

    #[test]
    fn lamps_are_counted_as_a_person_would() {
        let found = sliders(&room(4.0));
        assert_eq!(found.len(), 2, "two quads of two triangles each, no sky");
        assert_eq!((found[0].triangles.len(), found[0].class), (2, 3));
        assert!(found[0].centre.x > 0.0, "the stronger first");
        assert!(
            (found[0].power - 4.0 * PI * 0.01).abs() < 1e-4,
            "{}",
            found[0].power
        );
        let of_vertex = lamp_of_vertices(&room(4.0).mesh, &found);
        assert_eq!(of_vertex, [0, 0, 0, 0, 2, 2, 2, 2, 1, 1, 1, 1]);
    }

    #[test]
    fn sliders_bear_the_numbers_of_the_stored_list() {
        let mut solution = room(4.0);
        let few = sliders(&solution);
        assert_eq!(few[0].ids, [1]);
        assert_eq!(few[1].name, "Lamp 2");
        let lamp = solution.lamps[1].clone();
        solution
            .lamps
            .extend((3..=20).map(|id| Lamp { id, ..lamp.clone() }));
        let many = sliders(&solution);
        assert_eq!(many.len(), SLIDERS);
        assert_eq!(many[SLIDERS - 1].name, "Lamps 11 to 20");
        let ids: Vec<usize> = many.iter().flat_map(|s| s.ids.iter().copied()).collect();
        assert_eq!(ids, (1..=20).collect::<Vec<_>>());
    }

    #[test]
    fn shares_follow_the_inverse_square_law() {
        let solution = room(4.0);
        let found = sliders(&solution);
        let shares = shares(&solution, &found, &BruteForce::new(&solution.mesh));
        let mut planes = Vec::new();
        std::io::Read::read_to_end(
            &mut flate2::read::GzDecoder::new(&shares.planes[..]),
            &mut planes,
        )
        .expect("unpacks");
        assert_eq!(planes.len(), 2 * shares.width * shares.height);
        // the floor's middle: same distance and angles, so the shares are 4/5 and 1/5
        let middle = shares.width * (shares.height / 2) + shares.width / 4;
        let share = |lamp: usize| {
            (f32::from(planes[lamp * shares.width * shares.height + middle]) / 255.0).powi(2)
        };
        assert!(
            (share(0) - 0.8).abs() < 0.02 && (share(1) - 0.2).abs() < 0.02,
            "{} {}",
            share(0),
            share(1)
        );
        assert!((shares.bounce[0] - 0.8).abs() < 0.01, "{:?}", shares.bounce);
    }

    #[test]
    fn a_dark_scene_has_no_lamps() {
        let mut solution = room(1.0);
        solution.emission.data.fill(Vec3::ZERO);
        solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        assert!(sliders(&solution).is_empty());
        solution.environment.data[3] = Vec3::ONE;
        assert_eq!(sliders(&solution).len(), 1);
        let outside = shares(
            &solution,
            &sliders(&solution),
            &BruteForce::new(&solution.mesh),
        );
        assert!((outside.bounce[0] - 1.0).abs() < 1e-6);
    }
}
