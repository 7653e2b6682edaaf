//! One class per texel, from votes that are sure within a surface and mixed at its edges.

use super::{Fusion, UNSEEN};
use crate::core::geometry::{Mesh, pieces};
use crate::core::texture::Texels;
use std::collections::HashMap;

/// Share of the clean texels of a triangle or piece that must agree: large ones may carry several
/// classes.
const AGREEMENT: f32 = 0.9;
/// The same for all texels of a piece seen at edges alone, where pixels carry the label of what
/// lies next to it as well.
const MIXED_AGREEMENT: f32 = 0.75;
/// Texels from which a piece of the mesh is known.
const ENOUGH: u32 = 3;

/// Texels seen clean keep their vote. A pixel at an edge may carry the label of the surface next to
/// it, so texels seen there take what the clean texels of their triangle agree on; if it has none,
/// those of its piece of the mesh, or all texels of a piece that has hardly any; and else all
/// texels of the triangle. Those that nobody sees take the label of the nearest triangle. At an
/// edge no label says nothing: it is the sky's beside a window bar.
pub(crate) fn complete_labels(mesh: &Mesh, texels: &Texels, fusion: &Fusion) -> Vec<u16> {
    let triangles = mesh.triangles.len();
    let (mut clean, mut all) = (
        vec![Ballot::default(); triangles],
        vec![Ballot::default(); triangles],
    );
    let voted = |i: usize| fusion.label[i] != UNSEEN && (fusion.label[i] != 0 || fusion.clean[i]);
    for i in (0..texels.len()).filter(|&i| voted(i)) {
        let t = texels.point[i].triangle as usize;
        all[t].cast(fusion.label[i], 1);
        if fusion.clean[i] {
            clean[t].cast(fusion.label[i], 1);
        }
    }
    let pieces = pieces(mesh);
    let number = pieces.iter().max().map_or(0, |m| *m as usize + 1);
    let by_piece = |ballots: &[Ballot]| {
        let mut sums = vec![Ballot::default(); number];
        for (ballot, piece) in ballots.iter().zip(&pieces) {
            ballot
                .0
                .iter()
                .for_each(|v| sums[*piece as usize].cast(v.0, v.1));
        }
        sums
    };
    let of_piece: Vec<Option<u32>> = by_piece(&clean)
        .iter()
        .zip(&by_piece(&all))
        .map(|(clean, all)| agreed_by_piece(clean, all))
        .collect();
    let mut of_triangle: Vec<u32> = (0..triangles)
        .map(|t| {
            let sure = clean[t]
                .winner()
                .map(|w| w.0)
                .or(of_piece[pieces[t] as usize]);
            sure.or(all[t].winner().map(|w| w.0)).unwrap_or(UNSEEN)
        })
        .collect();
    let agreed = |t: usize| clean[t].winner().is_none_or(|w| w.1 >= AGREEMENT);
    spread_over_neighbours(mesh, &mut of_triangle);
    // every other vote came from a 16-bit label
    let known = |l: u32| u16::try_from(l).unwrap_or(0);
    (0..texels.len())
        .map(|i| {
            let (t, own) = (texels.point[i].triangle as usize, fusion.label[i]);
            let keep = voted(i) && (fusion.clean[i] || !agreed(t));
            known(if keep { own } else { of_triangle[t] })
        })
        .collect()
}

/// What the clean texels of a piece of the mesh agree on, or all of them where hardly any is clean:
/// the rim of a lamp, a table's edge.
fn agreed_by_piece(clean: &Ballot, all: &Ballot) -> Option<u32> {
    let (ballot, share) = if clean.votes() >= ENOUGH {
        (clean, AGREEMENT)
    } else {
        (all, MIXED_AGREEMENT)
    };
    ballot
        .winner()
        .filter(|w| w.1 >= share && ballot.votes() >= ENOUGH)
        .map(|w| w.0)
}

/// Labels with their numbers of votes.
#[derive(Clone, Default)]
struct Ballot(Vec<(u32, u32)>);

impl Ballot {
    fn cast(&mut self, label: u32, votes: u32) {
        match self.0.iter_mut().find(|v| v.0 == label) {
            Some(v) => v.1 += votes,
            None => self.0.push((label, votes)),
        }
    }

    fn votes(&self) -> u32 {
        self.0.iter().map(|v| v.1).sum()
    }

    /// The label with the most votes, the earliest of equals, and its share.
    fn winner(&self) -> Option<(u32, f32)> {
        let best = self
            .0
            .iter()
            .copied()
            .reduce(|best, v| if v.1 > best.1 { v } else { best })?;
        Some((best.0, best.1 as f32 / self.votes() as f32))
    }
}

/// Gives triangles that nobody sees the label of a neighbour, farther and farther.
fn spread_over_neighbours(mesh: &Mesh, labels: &mut [u32]) {
    let mut vertex_of = HashMap::new();
    let welded: Vec<u32> = mesh
        .positions
        .iter()
        .map(|p| {
            let next = vertex_of.len() as u32;
            *vertex_of
                .entry(p.to_array().map(f32::to_bits))
                .or_insert(next)
        })
        .collect();
    let mut at_vertex = vec![UNSEEN; vertex_of.len()];
    for _ in 0..64 {
        let mut changed = false;
        for (t, corners) in mesh.triangles.iter().enumerate() {
            if labels[t] != UNSEEN {
                for &c in corners {
                    let v = &mut at_vertex[welded[c as usize] as usize];
                    if *v == UNSEEN {
                        *v = labels[t];
                        changed = true;
                    }
                }
            }
        }
        for (t, corners) in mesh.triangles.iter().enumerate() {
            if labels[t] == UNSEEN
                && let Some(l) = corners
                    .iter()
                    .map(|&c| at_vertex[welded[c as usize] as usize])
                    .find(|l| *l != UNSEEN)
            {
                labels[t] = l;
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ballot(votes: &[(u32, u32)]) -> Ballot {
        Ballot(votes.to_vec())
    }

    #[test]
    fn a_piece_is_what_its_clean_texels_say_and_a_rim_what_most_of_it_says() {
        const LAMP: u32 = 30;
        const RIM: u32 = 27;
        let mixed = ballot(&[(RIM, 157), (LAMP, 23)]);
        assert_eq!(
            agreed_by_piece(&ballot(&[]), &mixed),
            Some(RIM),
            "seen at edges alone"
        );
        assert_eq!(
            agreed_by_piece(&ballot(&[(LAMP, 5)]), &mixed),
            Some(LAMP),
            "clean looks know better"
        );
        assert_eq!(
            agreed_by_piece(&ballot(&[(LAMP, 5), (RIM, 4)]), &mixed),
            None,
            "a piece of two classes"
        );
        assert_eq!(
            agreed_by_piece(&ballot(&[(LAMP, 2)]), &mixed),
            Some(RIM),
            "two clean texels are too few"
        );
        assert_eq!(
            agreed_by_piece(&ballot(&[]), &ballot(&[(RIM, 60), (LAMP, 40)])),
            None,
            "edges that disagree"
        );
        assert_eq!(agreed_by_piece(&ballot(&[]), &ballot(&[(RIM, 2)])), None);
    }

    #[test]
    fn unseen_triangles_take_their_neighbours_label() {
        // a strip of four triangles and one that touches none of them; corners are doubled as at
        // chart borders
        let corner = |i: usize| glam::Vec3::new((i / 2) as f32, (i % 2) as f32, 0.0);
        let strip = (0..4).flat_map(|t| [corner(t), corner(t + 1), corner(t + 2)]);
        let positions: Vec<glam::Vec3> = strip
            .chain((0..3).map(|i| corner(i) + 9.0 * glam::Vec3::Z))
            .collect();
        let n = positions.len();
        let triangles = (0..n as u32 / 3)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect();
        let mesh = Mesh {
            normals: vec![glam::Vec3::Z; n],
            uvs: vec![glam::Vec2::ZERO; n],
            positions,
            triangles,
        };
        let mut labels = [UNSEEN, UNSEEN, UNSEEN, 7, UNSEEN];
        spread_over_neighbours(&mesh, &mut labels);
        assert_eq!(labels, [7, 7, 7, 7, UNSEEN]);
    }
}
