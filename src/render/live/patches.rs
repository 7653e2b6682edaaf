//! Surface patches: what reflects as one. Texels of one class, room and direction within a cell of a
//! grid are a patch; a patch whose texels do not see each other (a floor below a wall) is parted.

use crate::core::math::facing;
use crate::core::parallel::map_chunks;
use crate::core::trace::{Ray, Tracer};
use crate::render::{EditableScene, LightmapTexels, SurfaceModel};
use crate::solution::Solution;
use crate::specular::DirectionalAlbedo;
use glam::{IVec3, Vec2, Vec3};
use std::collections::HashMap;

/// Patches wanted of a scene; those that are parted come on top.
/// Derived: some ten bounces between them take a third of the 50 ms that an answer may.
pub(super) const WANTED: usize = 2048;
/// The number that stands for no patch in links: the sky, backs of surfaces, lamps' insides. Derived:
/// the largest of its type.
pub(super) const NONE: u16 = u16::MAX;
/// Steps in which the size of the cells is found. Derived: the number of patches falls with the
/// square of the size, a step brings it within some tenths.
const STEPS: usize = 8;
/// Height above their surface, relative to the cell's size, at which texels of a patch must see its
/// first: over the steps between floor and carpet, below furniture.
/// Derived: any small share does.
const LIFT: f32 = 0.1;
/// Diffuse and specular reflectance together stay below: energy is lost at every bounce. Derived.
const BRIGHTEST: f32 = 0.98;

/// A patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Patch {
    /// Class of its texels.
    pub class: u16,
    /// Surface, m².
    pub area: f32,
    /// Diffuse reflectance, linear RGB.
    pub diffuse: Vec3,
    /// What is reflected specularly of even light, taken to be scattered evenly.
    pub specular: Vec3,
}

impl Patch {
    /// Reflectance with a factor on the diffuse colour.
    pub(super) fn reflectance(&self, factor: Vec3) -> Vec3 {
        let diffuse = (self.diffuse * factor).clamp(Vec3::ZERO, Vec3::ONE);
        (diffuse + self.specular).min(Vec3::splat(BRIGHTEST))
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    class: u16,
    room: u16,
    /// Axis that the normal is nearest to, and its sign.
    direction: u8,
    cell: IVec3,
}

/// Area of every texel, m²; border texels, whose centres lie beside their chart, and those without any
/// area count a little, so that a patch of them is one.
pub(super) fn areas(texels: &LightmapTexels<'_>) -> Vec<f32> {
    const LEAST: f32 = 1e-12;
    let sound = |(a, inside): (f32, &bool)| {
        if *inside && a.is_finite() {
            a.max(LEAST)
        } else {
            LEAST
        }
    };
    let interior = &texels.texels().interior;
    texels
        .areas()
        .into_iter()
        .zip(interior)
        .map(sound)
        .collect()
}

/// Number of the patch of every texel, below [`NONE`], counted from 0 without gaps.
pub(super) fn divide(
    solution: &Solution,
    texels: &LightmapTexels<'_>,
    tracer: &dyn Tracer,
    wanted: usize,
) -> Vec<u16> {
    let points = texels.points();
    let whole: f32 = areas(texels).iter().sum();
    let mut size = (whole / wanted.max(1) as f32).sqrt();
    if !(size > 0.0 && size.is_finite()) {
        return vec![0; points.len()];
    }
    let (low, _) = solution.mesh.bounds();
    let number = |size: f32| {
        let mut numbers: HashMap<Key, u32> = HashMap::new();
        let of_texel = |i: usize| {
            let at = texels.texels().point[i];
            let uv = solution.mesh.uv(at.triangle as usize, at.u, at.v);
            let rooms = Vec2::new(solution.rooms.width as f32, solution.rooms.height as f32);
            let key = Key {
                class: solution.class_at(uv),
                room: *solution.rooms.nearest(uv * rooms),
                direction: facing(points[i].face_normal),
                cell: ((points[i].position - low) / size).floor().as_ivec3(),
            };
            let next = numbers.len() as u32;
            *numbers.entry(key).or_insert(next)
        };
        let of_texels: Vec<u32> = (0..points.len()).map(of_texel).collect();
        (of_texels, numbers.len())
    };
    let (mut of_texels, mut count) = number(size);
    for _ in 0..STEPS {
        let ratio = count as f32 / wanted.max(1) as f32;
        if (0.8..1.25).contains(&ratio) {
            break;
        }
        size *= ratio.sqrt();
        (of_texels, count) = number(size);
    }
    let parted = parted(&of_texels, count, texels, tracer, LIFT * size);
    compact(&parted)
}

/// Parts the texels of a patch that its first texel does not see.
fn parted(
    of_texels: &[u32],
    count: usize,
    texels: &LightmapTexels<'_>,
    tracer: &dyn Tracer,
    lift: f32,
) -> Vec<u32> {
    let points = texels.points();
    let mut first = vec![usize::MAX; count];
    for (i, &p) in of_texels.iter().enumerate() {
        if first[p as usize] == usize::MAX {
            first[p as usize] = i;
        }
    }
    let above = |i: usize| points[i].position + points[i].face_normal * lift;
    let pieces = map_chunks(points.len(), 4096, |range| {
        let ray = |i: usize| {
            let (from, to) = (above(first[of_texels[i] as usize]), above(i));
            let distance = from.distance(to);
            Ray::new(from, (to - from).normalize_or(Vec3::Y), distance)
        };
        let rays: Vec<Ray> = range.map(ray).collect();
        let mut hidden = vec![0u8; rays.len()];
        tracer.occluded(&rays, &mut hidden);
        hidden
    });
    let hidden = pieces.concat();
    of_texels
        .iter()
        .zip(hidden)
        .map(|(&p, h)| 2 * p + u32::from(h != 0))
        .collect()
}

/// Numbers without gaps, in the order of their first texel. Beyond the numbers there are, patches
/// share one: a scene of so many classes and rooms is coarse, and not wrong.
fn compact(of_texels: &[u32]) -> Vec<u16> {
    let mut numbers: HashMap<u32, u32> = HashMap::new();
    let of_texel = |&p: &u32| {
        let next = numbers.len() as u32;
        (*numbers.entry(p).or_insert(next) % u32::from(NONE)) as u16
    };
    of_texels.iter().map(of_texel).collect()
}

/// The patches by number: area and mean reflectance of their texels.
pub(super) fn describe(
    solution: &Solution,
    texels: &LightmapTexels<'_>,
    of_texels: &[u16],
    areas: &[f32],
) -> Vec<Patch> {
    let count = of_texels.iter().max().map_or(0, |m| usize::from(*m) + 1);
    let world = EditableScene::new(solution);
    let lobes = DirectionalAlbedo::new(solution.reflectance);
    let mut out = vec![Patch::default(); count];
    let places = &texels.texels().point;
    for ((&p, at), &area) in of_texels.iter().zip(places).zip(areas) {
        let t = at.triangle as usize;
        let surface = world.surface(t, at.u, at.v);
        let (patch, metal) = (&mut out[usize::from(p)], surface.base.metallic);
        let paint = Vec3::splat(lobes.mean_response(surface.roughness));
        patch.class = solution.class_at(solution.mesh.uv(t, at.u, at.v));
        patch.area += area;
        patch.diffuse += surface.material().albedo * area;
        patch.specular += paint.lerp(surface.base.colour, metal) * area;
    }
    for patch in &mut out {
        patch.diffuse /= patch.area;
        patch.specular /= patch.area;
    }
    out
}
