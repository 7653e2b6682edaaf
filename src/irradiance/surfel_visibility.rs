//! What stands between texels of one surface.
//!
//! The floor on both sides of a thin wall is one plane, but nothing in common as light goes:
//! statistics cannot tell where light is found by chance. Texels share samples only where they see
//! each other from a little above the surface. A fan of rays around each finds the places near
//! which anything stands at all; there, rays to the neighbours that may lie behind it decide. Who
//! hides from whom is mutual, whichever of the two found out.

use super::occluded_pairs::OccludedPairs;
use super::surfel_grid::{Surfel, SurfelGrid};
use crate::core::math::Frame;
use crate::core::parallel::map_chunks;
use crate::core::trace::{BATCH, Hit, Ray, Tracer};
use glam::Vec3;
use std::f32::consts::{FRAC_1_SQRT_2, PI, SQRT_2};
use std::ops::Range;

/// Height over the surface, in texels, at which texels look at each other. Derived: between neighbours a
/// convex surface rises less than a quarter above their line: d θ / 8 for normals θ = acos 0.95
/// apart at a distance of d = 6.
const HEIGHT: f32 = 0.5;
/// Rays of a fan. Derived: both ways along both axes of the tangent plane, and between them.
const SPOKES: usize = 8;
/// Their directions along those axes, anticlockwise.
const SPOKE: [[f32; 2]; SPOKES] = {
    const D: f32 = FRAC_1_SQRT_2;
    [
        [1.0, 0.0],
        [D, D],
        [0.0, 1.0],
        [-D, D],
        [-1.0, 0.0],
        [-D, -D],
        [0.0, -1.0],
        [D, -D],
    ]
};
/// Share of the way to what a fan met within which nothing hides.
/// Measured: ×½ albedo within two errors +3 %, ×2 little (docs/constants.md).
const BEFORE: f32 = 0.75;

/// Texels that look around.
struct Looks<'a> {
    patches: &'a [Surfel],
    /// The places from which they do.
    eyes: Vec<Vec3>,
    reach: f32,
    /// Length of a fan's rays in reaches: one of them meets any straight wall within reach.
    spoke: f32,
}

impl Looks<'_> {
    /// The place of texel `j` on the plane of texel `i`, in reaches.
    fn toward(&self, i: usize, j: usize) -> [f32; 2] {
        let Surfel {
            position,
            normal,
            size,
        } = self.patches[i];
        let (Frame { t, b, .. }, step) = (
            Frame::from_normal(normal),
            self.patches[j].position - position,
        );
        [t, b].map(|axis| step.dot(axis) / (self.reach * size))
    }

    /// Whether a neighbour at (x, y) on the plane, in reaches, may lie behind what the rays to its left
    /// and right met: behind the line from the one to the other, or nearly.
    fn may_hide(&self, [x, y]: [f32; 2], fan: &[f32; SPOKES]) -> bool {
        let axis = match x.abs() > y.abs() {
            true => 4 * usize::from(x < 0.0),
            false => 2 + 4 * usize::from(y < 0.0),
        };
        let diagonal = match (x < 0.0, y < 0.0) {
            (false, false) => 1,
            (true, false) => 3,
            (true, true) => 5,
            (false, true) => 7,
        };
        // the place is a sum of steps along the two rays
        let (long, short) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
        let (along_axis, along_diagonal) = (long - short, SQRT_2 * short);
        let (to_axis, to_diagonal) = (fan[axis], fan[diagonal]);
        let met = to_axis.min(to_diagonal) <= self.spoke;
        met && along_axis / to_axis.min(self.spoke) + along_diagonal / to_diagonal.min(self.spoke)
            > BEFORE
    }
}

/// Memory for the rays of one texel.
#[derive(Default)]
struct Sight {
    ids: Vec<u32>,
    rays: Vec<Ray>,
    blocked: Vec<u8>,
}

/// Asks which of the texels within `reach` texels of each are hidden from it.
pub(crate) fn find_occluded(around: &SurfelGrid, reach: f32, tracer: &dyn Tracer) -> OccludedPairs {
    let patches = around.patches();
    let looks = Looks {
        patches,
        eyes: eyes(patches, tracer),
        reach,
        spoke: (PI / SPOKES as f32).cos().recip(),
    };
    let fans = fans(&looks, tracer);
    let obstructed = |i: usize| fans[i].iter().any(|d| d.is_finite());
    // of two that may be hidden from each other the one with the lower number asks
    let asks_itself = |j: usize, i: usize| {
        let asks = || {
            let [x, y] = looks.toward(j, i);
            looks.may_hide([x, y], &fans[j]) && patches[j].reaches(&patches[i], reach)
        };
        j < i && asks()
    };
    let found = around.map(
        reach,
        obstructed,
        |_| true,
        |i, near, sight: &mut Sight| {
            let unsure = near
                .iter()
                .filter(|n| looks.may_hide([n.along[0], n.along[1]], &fans[i]));
            sight.ids.clear();
            sight.ids.extend(
                unsure
                    .map(|n| n.id)
                    .filter(|&j| !asks_itself(j as usize, i)),
            );
            sight.rays.clear();
            sight.rays.extend(
                sight
                    .ids
                    .iter()
                    .map(|&j| between(looks.eyes[i], looks.eyes[j as usize])),
            );
            sight.blocked.resize(sight.ids.len(), 0);
            tracer.occluded(&sight.rays, &mut sight.blocked);
            let blocked = sight
                .ids
                .iter()
                .zip(&sight.blocked)
                .filter(|(_, blocked)| **blocked != 0);
            blocked.map(|(j, _)| *j).collect::<Vec<u32>>()
        },
    );
    OccludedPairs::mutual(&found)
}

/// The places from which texels look at each other: lower where something hangs over them.
fn eyes(patches: &[Surfel], tracer: &dyn Tracer) -> Vec<Vec3> {
    let chunk = |range: Range<usize>| {
        let patches = &patches[range];
        // (not so near that rounding finds the surface itself)
        let up = |p: &Surfel| Ray {
            t_near: 0.02 * p.size,
            ..Ray::new(p.position, p.normal, HEIGHT * p.size)
        };
        let rays: Vec<Ray> = patches.iter().map(up).collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        tracer.closest(&rays, &mut hits);
        let eye =
            |(p, hit): (&Surfel, &Hit)| p.position + p.normal * (0.5 * hit.t).min(HEIGHT * p.size);
        patches.iter().zip(&hits).map(eye).collect::<Vec<_>>()
    };
    map_chunks(patches.len(), BATCH, chunk).concat()
}

/// How far each texel sees along its tangent plane, in reaches; infinite where nothing is met.
fn fans(looks: &Looks, tracer: &dyn Tracer) -> Vec<[f32; SPOKES]> {
    let reach = |i: usize| looks.reach * looks.patches[i].size;
    let chunk = |range: Range<usize>| {
        let spokes = |i: usize| {
            let Frame { t, b, .. } = Frame::from_normal(looks.patches[i].normal);
            SPOKE.map(|[x, y]| Ray::new(looks.eyes[i], x * t + y * b, looks.spoke * reach(i)))
        };
        let rays: Vec<Ray> = range.clone().flat_map(spokes).collect();
        let mut hits = vec![Hit::miss(); rays.len()];
        tracer.closest(&rays, &mut hits);
        let distances = |(i, hits): (usize, &[Hit])| std::array::from_fn(|s| hits[s].t / reach(i));
        range
            .zip(hits.chunks_exact(SPOKES))
            .map(distances)
            .collect::<Vec<_>>()
    };
    map_chunks(looks.patches.len(), BATCH / SPOKES, chunk).concat()
}

fn between(a: Vec3, b: Vec3) -> Ray {
    let length = a.distance(b);
    Ray::new(a, (b - a) / length, length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::trace::{BruteForce, EmbreeTracer};
    use crate::irradiance::surfel_grid::Near;
    use std::f32::consts::{PI, TAU};

    const REACH: f32 = 6.0;
    const SIDE: usize = 40;

    /// A floor of 40 × 40 texels of 1 m in y = 0.
    fn floor() -> SurfelGrid {
        let at = |k: usize| Vec3::new((k % SIDE) as f32 + 0.5, 0.0, (k / SIDE) as f32 + 0.5);
        SurfelGrid::new(
            &(0..SIDE * SIDE)
                .map(|k| Surfel {
                    position: at(k),
                    normal: Vec3::Y,
                    size: 1.0,
                })
                .collect::<Vec<_>>(),
        )
    }

    /// Parallelograms: corner, two edges.
    fn mesh(quads: &[[Vec3; 3]]) -> Mesh {
        let positions = quads
            .iter()
            .flat_map(|&[c, u, v]| [c, c + u, c + u + v, c + v])
            .collect();
        let triangles = (0..quads.len() as u32)
            .flat_map(|q| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|k| 4 * q + k)))
            .collect();
        Mesh {
            positions,
            triangles,
            ..Mesh::default()
        }
    }

    /// A wall over the floor from one place to another.
    fn wall(from: [f32; 2], to: [f32; 2], height: f32) -> [Vec3; 3] {
        let at = |[x, z]: [f32; 2]| Vec3::new(x, 0.0, z);
        [at(from), at(to) - at(from), height * Vec3::Y]
    }

    fn hidden(around: &SurfelGrid, mesh: &Mesh) -> OccludedPairs {
        find_occluded(around, REACH, &EmbreeTracer::new(mesh).expect("embree"))
    }

    /// Neighbours i, j of each other, whether hidden or not.
    fn pairs(around: &SurfelGrid) -> Vec<(usize, usize)> {
        let ids = |i: usize, near: &[Near], (): &mut ()| {
            near.iter().map(|n| (i, n.id as usize)).collect::<Vec<_>>()
        };
        around.map(REACH, |_| true, |_| true, ids).concat()
    }

    fn hides(hidden: &OccludedPairs, i: usize, j: usize) -> bool {
        hidden.of(i).binary_search(&(j as u32)).is_ok()
    }

    /// Whatever way a wall runs, texels see their own side of it and nothing of the other's,
    /// however near to it they lie.
    #[test]
    fn a_wall_hides_its_two_sides_from_each_other() {
        let floor = floor();
        let (patches, pairs) = (floor.patches(), pairs(&floor));
        // (one passes a texel's centre by 0.0013 of it)
        for (from, to) in [
            ([20.0, -9.0], [20.0, 50.0]),
            ([19.63, -9.0], [19.41, 50.0]),
            ([-9.0, 7.0], [50.0, 31.0]),
        ] {
            let hidden = hidden(&floor, &mesh(&[wall(from, to, 9.0)]));
            let side = |i: usize| {
                let p = patches[i].position;
                (to[0] - from[0]) * (p.z - from[1]) > (to[1] - from[1]) * (p.x - from[0])
            };
            let across = pairs.iter().filter(|(i, j)| side(*i) != side(*j)).count();
            assert!(across > 3000, "{across}");
            for &(i, j) in &pairs {
                assert_eq!(
                    hides(&hidden, i, j),
                    side(i) != side(j),
                    "{from:?}: {:?} {:?}",
                    patches[i],
                    patches[j]
                );
            }
        }
    }

    /// Beside the free end of a wall, in a box, by a folded sheet: what is hidden is what a ray for
    /// every pair finds, nearly without exception, and always mutual.
    #[test]
    fn what_is_hidden_is_what_every_pair_would_find() {
        let floor = floor();
        let patches = floor.patches();
        let walls = [
            ([10.3, -1.0], [11.2, 15.7]),
            ([24.6, 10.2], [29.3, 12.4]),
            ([29.3, 12.4], [26.4, 16.8]),
            ([8.2, 28.1], [14.8, 28.1]),
            ([14.8, 28.1], [14.8, 33.3]),
            ([14.8, 33.3], [8.2, 33.3]),
            ([8.2, 33.3], [8.2, 28.1]),
        ];
        let mesh = mesh(&walls.map(|(from, to)| wall(from, to, 3.0)));
        let (hidden, brute) = (hidden(&floor, &mesh), BruteForce::new(&mesh));
        let pairs = pairs(&floor);
        let eye = |i: usize| patches[i].position + HEIGHT * Vec3::Y;
        let rays: Vec<Ray> = pairs
            .iter()
            .map(|&(i, j)| between(eye(i), eye(j)))
            .collect();
        let mut blocked = vec![0; rays.len()];
        brute.occluded(&rays, &mut blocked);
        let (mut all, mut missed) = (0, 0);
        for (&(i, j), blocked) in pairs.iter().zip(blocked) {
            assert_eq!(hides(&hidden, i, j), hides(&hidden, j, i), "mutual");
            assert!(
                blocked == 1 || !hides(&hidden, i, j),
                "{:?} sees {:?}",
                patches[i],
                patches[j]
            );
            (all, missed) = (
                all + usize::from(blocked),
                missed + usize::from(blocked == 1 && !hides(&hidden, i, j)),
            );
        }
        println!("{missed} of {all} hidden pairs missed");
        assert!(all > 5000 && missed * 1000 <= all, "{missed} of {all}");
    }

    #[test]
    fn a_step_lower_than_half_a_texel_hides_nothing() {
        let floor = floor();
        let step = |height: f32| hidden(&floor, &mesh(&[wall([20.2, -9.0], [20.2, 50.0], height)]));
        assert!(step(0.45).is_empty());
        assert!(!step(0.55).is_empty());
    }

    /// Seen from outside a ball is convex, from inside concave: neither way do neighbours hide from
    /// each other, few texels to the radius or many.
    #[test]
    fn a_ball_keeps_its_neighbours() {
        let (rings, sectors) = (48u32, 96u32);
        let unit = |ring: u32, sector: u32| {
            let (theta, phi) = (
                PI * ring as f32 / rings as f32,
                TAU * sector as f32 / sectors as f32,
            );
            Vec3::new(
                theta.sin() * phi.cos(),
                theta.cos(),
                theta.sin() * phi.sin(),
            )
        };
        let quad = |r: u32, s: u32| {
            [[r, s], [r, s + 1], [r + 1, s + 1], [r + 1, s]].map(|[r, s]| r * sectors + s % sectors)
        };
        // (without the slivers at its poles)
        let quads = || (1..rings - 1).flat_map(|r| (0..sectors).map(move |s| quad(r, s)));
        let mesh = Mesh {
            positions: (0..=rings)
                .flat_map(|r| (0..sectors).map(move |s| unit(r, s)))
                .collect(),
            triangles: quads()
                .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
                .collect(),
            ..Mesh::default()
        };
        for (radius, inside) in [(20.0, 1.0), (60.0, 1.0), (20.0, -1.0), (60.0, -1.0)] {
            let centre = |t: usize| {
                (mesh.triangles[t]
                    .iter()
                    .map(|&k| mesh.positions[k as usize])
                    .sum::<Vec3>())
                    / 3.0
            };
            let patch = |p: Vec3| Surfel {
                position: p,
                normal: inside * p.normalize(),
                size: 1.0 / radius,
            };
            let patches: Vec<Surfel> = (0..mesh.triangles.len())
                .map(|t| patch(centre(t)))
                .collect();
            let around = SurfelGrid::new(&patches);
            let hidden = hidden(&around, &mesh);
            assert!(
                pairs(&around).len() > 10 * patches.len(),
                "texels have company"
            );
            assert!(hidden.is_empty(), "radius {radius}, {inside}");
        }
    }

    /// Beneath a sheet lower than half a texel texels see each other, and nobody beside it.
    #[test]
    fn texels_beneath_something_low_look_below_it() {
        let floor = floor();
        let patches = floor.patches();
        const HIGH: f32 = 0.17;
        let [x0, z0, x1, z1] = [10.03, 10.09, 19.96, 19.88];
        let corners = [[x0, z0], [x1, z0], [x1, z1], [x0, z1]];
        let rug = [
            Vec3::new(x0, HIGH, z0),
            (x1 - x0) * Vec3::X,
            (z1 - z0) * Vec3::Z,
        ];
        let sides = (0..4).map(|k| wall(corners[k], corners[(k + 1) % 4], HIGH));
        let hidden = hidden(&floor, &mesh(&sides.chain([rug]).collect::<Vec<_>>()));
        let beneath = |i: usize| {
            (x0..x1).contains(&patches[i].position.x) && (z0..z1).contains(&patches[i].position.z)
        };
        for (i, j) in pairs(&floor) {
            assert_eq!(
                hides(&hidden, i, j),
                beneath(i) != beneath(j),
                "{:?} {:?}",
                patches[i],
                patches[j]
            );
        }
    }
}
