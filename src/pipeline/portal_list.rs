//! The portals of a solution, for `lights.json`: openings through which the environment is seen, as
//! rectangles on the scene's bounding box ([`find_portals`]) with the light that enters.
//!
//! A portal of area A sends out π L A, L the environment's radiance averaged over the directions
//! behind it by their cosine. Called by the last step of `solve`.

use crate::core::geometry::Mesh;
use crate::core::math::{Frame, luminance};
use crate::core::sampling::{SobolSequence, square_to_cosine_hemisphere};
use crate::core::trace::Tracer;
use crate::lights::portals::find_portals;
use crate::radiance::Environment;
use crate::solution::{Lamp, LampKind};
use glam::{DVec3, Vec3};
use std::f32::consts::PI;

/// Directions that average the environment behind a portal. Derived: 1/√1024 is 3 % of even a sky
/// as uneven as its mean.
const DIRECTIONS: u32 = 1024;

/// The portals of a mesh whose faces look where the cameras are, most powerful first; numbered on
/// from `lamps`. None without light outside.
pub(super) fn portals(
    mesh: &Mesh,
    tracer: &dyn Tracer,
    environment: &Environment,
    origin: DVec3,
    lamps: usize,
) -> Vec<Lamp> {
    if environment.is_black() {
        return Vec::new();
    }
    let (low, high) = mesh.bounds();
    let middle = 0.5 * (low + high);
    // two triangles make a rectangle
    let mut out: Vec<Lamp> = find_portals(mesh, tracer)
        .chunks(2)
        .filter_map(|pair| describe(pair, environment, middle, origin))
        .collect();
    out.sort_by(|a, b| b.strength().total_cmp(&a.strength()));
    for (i, portal) in out.iter_mut().enumerate() {
        portal.id = lamps + i + 1;
    }
    out
}

fn describe(
    pair: &[[Vec3; 3]],
    environment: &Environment,
    middle: Vec3,
    origin: DVec3,
) -> Option<Lamp> {
    let corners: Vec<Vec3> = pair.iter().flatten().copied().collect();
    let double = |t: &[Vec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]);
    let area = 0.5 * pair.iter().map(|t| double(t).length()).sum::<f32>();
    let normal = double(pair.first()?).try_normalize()?;
    let low = corners.iter().fold(Vec3::INFINITY, |a, p| a.min(*p));
    let high = corners.iter().fold(Vec3::NEG_INFINITY, |a, p| a.max(*p));
    let centre = 0.5 * (low + high);
    let outwards = if normal.dot(centre - middle) < 0.0 {
        -normal
    } else {
        normal
    };
    let radiance = behind(environment, outwards);
    (luminance(radiance) > 0.0 && area > 0.0).then(|| Lamp {
        kind: LampKind::Portal,
        centre: (centre.as_dvec3() + origin).to_array(),
        size: (high - low).to_array(),
        area,
        power: (PI * area * radiance).to_array(),
        radiance: radiance.to_array(),
        ..Lamp::default()
    })
}

/// Mean radiance of the environment over a hemisphere, by the cosine to its middle.
fn behind(environment: &Environment, outwards: Vec3) -> Vec3 {
    let frame = Frame::from_normal(outwards);
    let sequence = SobolSequence::new(0x90a1, 0);
    let sum: Vec3 = (0..DIRECTIONS)
        .map(|j| frame.world_from_local(square_to_cosine_hemisphere(sequence.point2(j))))
        .map(|d| environment.radiance(d))
        .sum();
    sum / DIRECTIONS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::core::trace::EmbreeTracer;
    use glam::Vec2;

    /// A box of 4 × 3 × 5 m, seen from within, without its side x = 4.
    fn open_box() -> Mesh {
        let size = Vec3::new(4.0, 3.0, 5.0);
        let corner = |i: usize| size * Vec3::from_array([0, 1, 2].map(|k| ((i >> k) & 1) as f32));
        let sides = [
            [0, 2, 6, 4],
            [0, 1, 3, 2],
            [4, 6, 7, 5],
            [0, 4, 5, 1],
            [2, 3, 7, 6],
        ];
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        for side in sides {
            let p = side.map(corner);
            let inwards = (0.5 * size - 0.5 * (p[0] + p[2])).normalize();
            let turned = (p[1] - p[0]).cross(p[2] - p[0]).dot(inwards) < 0.0;
            // many triangles: portals are looked for from their middles
            for (u, v) in (0..16).flat_map(|u| (0..16).map(move |v| (u, v))) {
                let at = |a: i32, b: i32| {
                    let (s, t) = ((u + a) as f32 / 16.0, (v + b) as f32 / 16.0);
                    p[0] + (p[1] - p[0]) * s + (p[3] - p[0]) * t
                };
                let first = positions.len() as u32;
                positions.extend([at(0, 0), at(1, 0), at(1, 1), at(0, 1)]);
                normals.extend([inwards; 4]);
                let mut quad = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|k: u32| first + k));
                if turned {
                    quad.iter_mut().for_each(|t| t.swap(1, 2));
                }
                triangles.extend(quad);
            }
        }
        Mesh {
            uvs: vec![Vec2::ZERO; positions.len()],
            positions,
            normals,
            triangles,
        }
    }

    #[test]
    fn an_open_side_is_listed_with_the_light_that_enters() {
        let mesh = open_box();
        let tracer = EmbreeTracer::new(&mesh).expect("tracer");
        let sky = Environment::from_map(Plane::filled(16, 8, Vec3::new(1.0, 2.0, 3.0)));
        let origin = DVec3::new(100.0, 0.0, 0.0);
        let found = portals(&mesh, &tracer, &sky, origin, 3);
        let area: f32 = found.iter().map(|p| p.area).sum();
        assert!((area / 15.0 - 1.0).abs() < 0.1, "{area}: {found:?}");
        for (i, p) in found.iter().enumerate() {
            assert_eq!((p.id, p.kind), (4 + i, LampKind::Portal));
            assert!((p.centre[0] - 104.0).abs() < 0.05, "{:?}", p.centre);
            assert!((p.power[1] / (PI * 2.0 * p.area) - 1.0).abs() < 1e-3);
            assert!(p.triangles.is_empty());
        }
        assert!(portals(&mesh, &tracer, &Environment::black(), origin, 3).is_empty());
    }
}
