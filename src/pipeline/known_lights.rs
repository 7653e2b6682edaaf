//! Which triangles are lamps by what people say: their labels. Called by `light` and `clipped_light`;
//! what emits by its brightness is found by `crate::lights::detect_emissive`.

use super::{SolveOptions, Switch};
use crate::core::geometry::{Mesh, Shells};
use crate::core::parallel::prelude::*;
use crate::core::texture::Texels;
use crate::gbuffer::Probe;
use crate::observed::Surface;
use crate::solution::lamp_gap;
use glam::Vec2;
use std::collections::BTreeSet;

/// Triangles whose class is known to emit.
pub(super) fn known_lights(surface: &Surface, options: &SolveOptions) -> Vec<bool> {
    if options.emission == Switch::Off {
        return vec![false; surface.scene.mesh.triangles.len()];
    }
    let is_light: BTreeSet<u16> = surface
        .scene
        .classes
        .iter()
        .filter(|c| c.is_light)
        .map(|c| c.id)
        .collect();
    let mut votes = vec![Votes::default(); surface.scene.mesh.triangles.len()];
    for (i, (p, label)) in surface.texels.point.iter().zip(&surface.labels).enumerate() {
        let v = &mut votes[p.triangle as usize];
        let own = u16::try_from(surface.fusion.label[i]).is_ok_and(|l| is_light.contains(&l));
        v.all += 1;
        v.light += u32::from(is_light.contains(label));
        v.own += u32::from(own);
        v.seen += u32::from(surface.fusion.views[i] > 0);
    }
    let mesh = &surface.scene.mesh;
    let probe = Probe {
        mesh,
        tracer: &surface.tracer,
        offset: surface.offset,
        beyond: lamp_gap(mesh),
    };
    let orientation = &surface.orientation;
    witnessed(mesh, &votes, &|t| {
        let side = orientation.sign(t);
        orientation.open_share(&probe, t as u32, side, LEAVING_RAYS) >= LEAVING
    })
}

/// What the texels of a triangle say of its being a lamp.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    /// Texels.
    all: u32,
    /// Those of a class of kind light, be it by their neighbours'.
    light: u32,
    /// Those that views themselves label so.
    own: u32,
    /// Those that views see.
    seen: u32,
}

/// Rays that tell whether light leaves a face, and the share of them from which it does. Derived: a
/// face that sends less than a sixteenth of its light into the room is dark there to 6 % of itself.
const LEAVING_RAYS: usize = 64;
const LEAVING: f32 = 1.0 / 16.0;

/// Triangles that are lamps by their label. One that no view itself calls a lamp, having its label
/// from neighbours, must belong to the shell of one that is called so; and one that nobody sees at
/// all must have a way for its light to leave (`leaves`): the back of a panel has none. Of a shell
/// that is a lamp where it is seen, all that nobody sees is one, whatever label lies nearest.
fn witnessed(mesh: &Mesh, votes: &[Votes], leaves: &dyn Fn(usize) -> bool) -> Vec<bool> {
    let claimed = |t: usize| votes[t].light > 0 && 2 * votes[t].light >= votes[t].all;
    let doubtful = |t: usize| claimed(t) && votes[t].own == 0;
    let mut known: Vec<bool> = (0..votes.len())
        .map(|t| claimed(t) && !doubtful(t))
        .collect();
    if !known.contains(&true) {
        return known;
    }
    let unseen = |t: usize| votes[t].seen == 0;
    for shell in Shells::of(mesh).iter() {
        let of_shell = || shell.iter().map(|&t| t as usize);
        if !of_shell().any(|t| known[t]) {
            continue;
        }
        let (mut seen, mut lamp) = (0, 0);
        for t in of_shell() {
            seen += votes[t].seen;
            lamp += if known[t] { votes[t].seen } else { 0 };
        }
        for t in of_shell() {
            if doubtful(t) || 2 * lamp > seen && unseen(t) {
                known[t] = !unseen(t) || leaves(t);
            }
        }
    }
    known
}

/// Per triangle the one that has its place in the atlas: itself, but of those too small for a texel of
/// their own that whose texel it is (itself where there is none).
pub(super) fn owners(mesh: &Mesh, texels: &Texels) -> Vec<u32> {
    let owner: Vec<u32> = texels.point.iter().map(|p| p.triangle).collect();
    let mut has_texel = vec![false; mesh.triangles.len()];
    owner.iter().for_each(|&t| has_texel[t as usize] = true);
    let owner = texels.scatter(&owner, u32::MAX);
    let size = Vec2::new(owner.width as f32, owner.height as f32);
    let of = |t: usize| {
        if has_texel[t] {
            return t as u32;
        }
        let corners = mesh.corner_uvs(t);
        let centre = corners.iter().sum::<Vec2>() / 3.0;
        let near = std::iter::once(centre)
            .chain(corners)
            .map(|uv| *owner.nearest(uv * size))
            .find(|&o| o != u32::MAX);
        near.unwrap_or(t as u32)
    };
    (0..mesh.triangles.len()).into_par_iter().map(of).collect()
}

/// Adds to emitting triangles those too small for a texel of their own whose place in the atlas
/// belongs to an emitting one: a lamp of many facets must not lose what falls between the texels.
pub(super) fn adopt_subtexel_triangles(
    mesh: &Mesh,
    texels: &Texels,
    emissive: Vec<bool>,
) -> Vec<bool> {
    let owners = owners(mesh, texels).into_iter().map(|o| o as usize);
    let shines = |(t, owner): (usize, usize)| emissive[t] || emissive[owner];
    owners.enumerate().map(shines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observed::surface_tests::box_scene;
    use glam::Vec3;

    /// Two faces of a closed shell are seen: as lamps, what nobody sees of it is one wherever light
    /// can leave, whatever its label; as a wall with a lamp on it, only what has the label.
    #[test]
    fn what_nobody_sees_of_a_lamp_is_a_lamp() {
        let scene = box_scene();
        let votes = |lamp: u32| {
            let of = |t: usize| {
                let seen = if t < 4 { 10 } else { 0 };
                let own = if t == 0 { seen } else { seen.min(lamp) };
                Votes {
                    all: 10,
                    light: own,
                    own,
                    seen,
                }
            };
            (0..12).map(of).collect::<Vec<_>>()
        };
        let open = |t: usize| t != 7;
        let all = witnessed(&scene.mesh, &votes(10), &open);
        assert_eq!(all, (0..12).map(open).collect::<Vec<_>>());
        let one = witnessed(&scene.mesh, &votes(0), &open);
        assert_eq!(one, (0..12).map(|t| t == 0).collect::<Vec<_>>());
    }

    #[test]
    fn facets_between_the_texels_of_a_lamp_emit_too() {
        // two squares of 32 × 32 facets, a lamp and a wall, in an atlas of 8 × 8 texels: most
        // facets have no texel of their own
        const N: u32 = 32;
        let mut mesh = Mesh {
            positions: vec![],
            normals: vec![],
            uvs: vec![],
            triangles: vec![],
        };
        for left in [0.02f32, 0.52] {
            let first = mesh.positions.len() as u32;
            for (y, x) in (0..=N).flat_map(|y| (0..=N).map(move |x| (y, x))) {
                let p = Vec2::new(x as f32, y as f32) / N as f32;
                mesh.positions.push(p.extend(0.0));
                mesh.normals.push(Vec3::Z);
                mesh.uvs
                    .push(Vec2::new(left, 0.02) + p * Vec2::new(0.46, 0.96));
            }
            for (y, x) in (0..N).flat_map(|y| (0..N).map(move |x| (y, x))) {
                let a = first + y * (N + 1) + x;
                mesh.triangles
                    .extend([[a, a + 1, a + N + 2], [a, a + N + 2, a + N + 1]]);
            }
        }
        let texels = Texels::rasterize(&mesh, 8, 8);
        let lamp = mesh.triangles.len() / 2;
        let mut known = vec![false; mesh.triangles.len()];
        texels
            .point
            .iter()
            .map(|p| p.triangle as usize)
            .filter(|&t| t < lamp)
            .for_each(|t| known[t] = true);
        assert!(known.iter().filter(|k| **k).count() < lamp / 10);
        let emissive = adopt_subtexel_triangles(&mesh, &texels, known);
        let marked = |range: std::ops::Range<usize>| emissive[range].iter().filter(|e| **e).count();
        assert_eq!(marked(0..lamp), lamp, "every facet of the lamp");
        assert_eq!(marked(lamp..2 * lamp), 0, "none of the wall");

        // each belongs to one with a texel, of the same square
        let owners = owners(&mesh, &texels);
        let with_texel = |o: u32| texels.point.iter().any(|p| p.triangle == o);
        for (t, &o) in owners.iter().enumerate() {
            assert!(
                with_texel(o) && (t < lamp) == ((o as usize) < lamp),
                "{t}: {o}"
            );
            assert!(!with_texel(t as u32) || o as usize == t);
        }
    }
}
