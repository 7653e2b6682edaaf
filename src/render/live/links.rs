//! What every texel sees: the patches that cosine-distributed rays from it meet. A texel receives the
//! mean of their exitances: E = D + (1/n) Σ ρ_j E_j, a final gather whose rays are traced once.

use super::patches::NONE;
use crate::core::image::Plane;
use crate::core::math::Frame;
use crate::core::parallel::map_chunks;
use crate::core::progress::Progress;
use crate::core::sampling::{KeyedRng, hammersley, square_to_cosine_hemisphere};
use crate::core::trace::{CutOut, Hit, Ray, Tracer};
use crate::render::LightmapTexels;
use crate::render::panes::SolutionPanes;
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use std::sync::atomic::{AtomicU32, Ordering};

/// Rays per texel.
/// Derived: gathering so many for each texel of a map of 512² takes a third of the 50 ms that an answer
/// may.
pub(super) const LINKS: usize = 64;
/// Texels per parallel piece. Derived: as many rays as one call into the tracer takes.
const PIECE: usize = 64;
/// Height at which rays leave their surface, relative to the scene's diagonal. Derived: far above
/// the rounding of positions, 1e-7, and far below any detail.
const LIFT: f32 = 1e-5;

/// From hits to patches.
struct Lookup<'a> {
    solution: &'a Solution,
    texels: &'a LightmapTexels<'a>,
    /// Texel of each cell of the atlas; `u32::MAX` where none is.
    texel_of_cell: Plane<u32>,
}

impl Lookup<'_> {
    /// The texel whose front a ray meets; nothing for the sky and for backs.
    fn texel(&self, ray: &Ray, hit: &Hit) -> Option<usize> {
        if !hit.is_hit() {
            return None;
        }
        let (mesh, t) = (&self.solution.mesh, hit.triangle as usize);
        let normal = mesh.face_normal(t);
        if normal.dot(Vec3::from_array(ray.direction)) > 0.0 {
            return None;
        }
        let grid = self.texels.texels();
        let size = Vec2::new(grid.width as f32, grid.height as f32);
        let at = (mesh.uv(t, hit.u, hit.v) * size).floor().as_ivec2();
        let texel = |dx: i32, dy: i32| {
            let x = (at.x + dx).clamp(0, grid.width as i32 - 1) as usize;
            let y = (at.y + dy).clamp(0, grid.height as i32 - 1) as usize;
            self.texel_of_cell[(x, y)]
        };
        let own = texel(0, 0);
        let same = |i: u32| {
            grid.point
                .get(i as usize)
                .is_some_and(|p| p.triangle == hit.triangle)
        };
        if same(own) {
            return Some(own as usize);
        }
        // charts lie close: of the texels around, the nearest that faces the same way
        let p = mesh.position(t, hit.u, hit.v);
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        let nearest = around
            .map(|(dx, dy)| texel(dx, dy))
            .filter(|&i| i != u32::MAX)
            .min_by(|&a, &b| {
                let far = |i: u32| {
                    let q = &self.texels.points()[i as usize];
                    (2.0 - q.face_normal.dot(normal)) * q.position.distance(p)
                };
                far(a).total_cmp(&far(b))
            });
        nearest.map(|i| i as usize)
    }
}

/// What texels see.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Seeing {
    /// The patches that every texel sees: [`LINKS`] for each, ascending.
    pub links: Vec<u16>,
    /// How many rays of all texels meet each, up to [`LINKS`], about which number meets a texel in the
    /// open: fewer meet one behind a cabinet, none one inside a wall. What reflects light to where it
    /// is seen is weighed by it.
    pub seen: Vec<u8>,
}

/// Traces what texels see.
pub(super) fn links(
    solution: &Solution,
    texels: &LightmapTexels<'_>,
    of_texels: &[u16],
    tracer: &dyn Tracer,
    progress: &Progress,
) -> Seeing {
    let grid = texels.texels();
    let lookup = Lookup {
        solution,
        texels,
        texel_of_cell: grid.numbers(),
    };
    let met: Vec<AtomicU32> = (0..grid.len()).map(|_| AtomicU32::new(0)).collect();
    let panes = SolutionPanes(solution);
    let through = CutOut::new(tracer, &panes);
    let seeing: &dyn Tracer = if solution.transmission.is_some() {
        &through
    } else {
        tracer
    };
    let (low, high) = solution.mesh.bounds();
    let lift = LIFT * (high - low).length();
    let points = texels.points();
    let links = progress.stage("tracing what surfaces see", points.len() as u64, |p| {
        let pieces = map_chunks(points.len(), PIECE, |range| {
            let rays: Vec<Ray> = range
                .clone()
                .flat_map(|i| rays_of(&points[i], u64::from(grid.cell[i]), lift))
                .collect();
            let mut hits = vec![Hit::miss(); rays.len()];
            seeing.closest(&rays, &mut hits);
            let mut found: Vec<u16> = rays
                .iter()
                .zip(&hits)
                .map(|(ray, hit)| {
                    lookup.texel(ray, hit).map_or(NONE, |i| {
                        met[i].fetch_add(1, Ordering::Relaxed);
                        of_texels[i]
                    })
                })
                .collect();
            // neighbours in memory are read one after the other
            found.chunks_mut(LINKS).for_each(<[u16]>::sort_unstable);
            p.advance(range.len() as u64);
            found
        });
        pieces.concat()
    });
    let seen = met
        .into_iter()
        .map(|n| n.into_inner().min(LINKS as u32) as u8);
    Seeing {
        links,
        seen: seen.collect(),
    }
}

/// Cosine-distributed rays of a point about its shading normal; those that would enter the surface
/// start nowhere, and miss.
fn rays_of(
    point: &crate::render::IrradiancePoint,
    key: u64,
    lift: f32,
) -> impl Iterator<Item = Ray> + use<> {
    let mut random = KeyedRng::new(0x6c69_6e6b, key);
    let shift = [random.next_f32(), random.next_f32()];
    let frame = Frame::from_normal(point.normal);
    let face = point.face_normal;
    let from = point.position + face * lift;
    (0..LINKS as u32).map(move |k| {
        let u = hammersley(k, LINKS as u32);
        let turned = [(u[0] + shift[0]).fract(), (u[1] + shift[1]).fract()];
        let to = frame.world_from_local(square_to_cosine_hemisphere(turned));
        let end = if to.dot(face) > 0.0 {
            f32::INFINITY
        } else {
            0.0
        };
        Ray::new(from, to, end)
    })
}
