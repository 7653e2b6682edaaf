//! Which texels lie around a texel on the same smooth surface, in space and across charts, and are
//! not hidden from it.
//!
//! Texels are sorted into cubes and there by direction; those of one such group share a list of
//! candidates, copied side by side. Charts of different density live in different grids (octaves of
//! texel size), so that the number of neighbours does not grow with the density of a chart next
//! door. Numbers of texels are places in that order everywhere: what lies close in space lies close
//! in memory.

use super::occluded_pairs::OccludedPairs;
use crate::core::geometry::SMOOTH;
use crate::core::math::{Frame, facing};
use crate::core::parallel::prelude::*;
use crate::ffi::simd::with_widest;
use glam::Vec3;
use std::f32::consts::PI;
use std::ops::Range;

/// Side of a cube in texels: smaller ones waste less on candidates out of reach, larger ones need
/// fewer look-ups.
/// Measured: ×½ albedo within two errors +2 %, ×2 little (docs/constants.md).
const CELL: f32 = 4.5;

/// A texel as a piece of surface.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    /// Where its light is sampled, metres: its centre, but off the walls that it touches.
    pub position: Vec3,
    /// Unit shading normal on the lit side.
    pub normal: Vec3,
    /// Side of the texel on the surface, metres.
    pub size: f32,
}

impl Surfel {
    /// Whether `other` lies within `reach` texels on the same smooth surface.
    pub(crate) fn reaches(&self, other: &Self, reach: f32) -> bool {
        Reach::new(self.size, reach)
            .share(other.position - self.position, [self.normal, other.normal])
            < 1.0
    }
}

/// How far the surroundings of a texel go: the square, and one over it.
#[derive(Clone, Copy)]
struct Reach {
    limit: f32,
    per_limit: f32,
}

impl Reach {
    fn new(size: f32, reach: f32) -> Self {
        let limit = (reach * size) * (reach * size);
        Self {
            limit,
            per_limit: 1.0 / limit.max(f32::MIN_POSITIVE),
        }
    }

    /// Squared length of a step between two texels with these normals as a share of the square; 1
    /// if the second does not lie within it on the first's smooth surface: with normals θ apart, an even bend
    /// rises over the tangent plane by sin(θ/2) of the distance.
    #[inline(always)]
    fn share(self, step: Vec3, [normal, other]: [Vec3; 2]) -> f32 {
        let d2 = step.length_squared();
        let smooth = normal.dot(other) > SMOOTH;
        let height = normal.dot(step);
        let flat = height * height <= 0.5 * (1.0 - SMOOTH) * d2;
        if (d2 < self.limit) & smooth & flat {
            d2 * self.per_limit
        } else {
            1.0
        }
    }
}

/// The surroundings of every texel.
pub(crate) struct SurfelGrid {
    /// Finest first.
    octaves: Vec<Octave>,
    /// The texels' own numbers, octave by octave, in the order of their groups.
    order: Vec<u32>,
    /// In that order, as all that follows.
    patches: Vec<Surfel>,
    /// Positions and normals, a column per coordinate.
    columns: [Vec<f32>; 6],
    /// Who is hidden from whom.
    hidden: OccludedPairs,
}

/// Texels of similar size sorted by cube.
struct Octave {
    /// Logarithm of their size.
    octave: i32,
    /// Side of a cube, metres.
    cell: f32,
    /// In the order of their cubes.
    groups: Vec<Group>,
}

/// Texels of one cube that face about the same way.
struct Group {
    cube: [i32; 3],
    /// Its texels.
    range: Range<usize>,
    /// Mean normal, and the largest angle from it; its sine and cosine.
    axis: Vec3,
    spread: f32,
    spread_sin_cos: (f32, f32),
}

/// Texels of the cubes around a few texels, a column per property.
#[derive(Default)]
struct Candidates {
    ids: Vec<u32>,
    /// Positions, then normals.
    columns: [Vec<f32>; 6],
    distance2: Vec<f32>,
    /// Along the two axes of the texel in question: positions, then normals.
    along: [Vec<f32>; 4],
    /// Which are near.
    near: Vec<u32>,
    /// Memory for the search: runs of texels among which they may be, and for every texel of one
    /// run whether it is one (1 or 0).
    runs: Vec<Range<usize>>,
    inside: Vec<u32>,
}

/// A texel on the same smooth surface as the one whose surroundings are asked for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Near {
    /// Which.
    pub id: u32,
    /// Squared distance as a share of the reach's square.
    pub distance2: f32,
    /// Place relative to the texel along two axes of its plane, in reaches; then its normal along
    /// the same axes.
    pub along: [f32; 4],
}

impl SurfelGrid {
    /// Sorts the texels.
    pub(crate) fn new(patches: &[Surfel]) -> Self {
        let octave_of: Vec<i32> = patches.par_iter().map(|p| octave(p.size)).collect();
        let mut present = octave_of.clone();
        present.par_sort_unstable();
        present.dedup();
        let (mut octaves, mut order) = (Vec::new(), Vec::with_capacity(patches.len()));
        for o in present {
            let members = (0..patches.len())
                .into_par_iter()
                .filter(|&i| octave_of[i] == o);
            octaves.push(Octave::new(patches, members, o, &mut order));
        }
        let patches: Vec<Surfel> = order.par_iter().map(|&i| patches[i as usize]).collect();
        let column = |c: usize| {
            let of = |p: &Surfel| {
                if c < 3 {
                    p.position[c]
                } else {
                    p.normal[c - 3]
                }
            };
            patches.par_iter().map(of).collect()
        };
        Self {
            octaves,
            columns: std::array::from_fn(column),
            patches,
            order,
            hidden: OccludedPairs::default(),
        }
    }

    /// The same without texels that are hidden from each other.
    pub(crate) fn without(self, hidden: OccludedPairs) -> Self {
        Self { hidden, ..self }
    }

    /// The numbers that the texels had before they were sorted.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
    }

    /// The texels.
    pub(crate) fn patches(&self) -> &[Surfel] {
        &self.patches
    }

    /// Groups with their octaves, in the order of their texels.
    fn groups(&self) -> impl Iterator<Item = (&Octave, &Group)> {
        self.octaves
            .iter()
            .flat_map(|o| o.groups.iter().map(move |g| (o, g)))
    }

    /// `f(i, near, scratch)` for every texel that is `asked` for, with those that `count` within
    /// `reach` texels of it, maybe itself among them; the default for all others.
    pub(crate) fn map<S: Default, R: Send + Default>(
        &self,
        reach: f32,
        asked: impl Fn(usize) -> bool + Sync,
        count: impl Fn(usize) -> bool + Sync,
        f: impl Fn(usize, &[Near], &mut S) -> R + Sync,
    ) -> Vec<R> {
        let mut results: Vec<R> = (0..self.patches.len())
            .into_par_iter()
            .map(|_| R::default())
            .collect();
        let (mut rest, mut tasks) = (results.as_mut_slice(), Vec::new());
        for (o, group) in self.groups() {
            let (own, others) = rest.split_at_mut(group.range.len());
            tasks.push((o, group, own));
            rest = others;
        }
        tasks.into_par_iter().for_each_init(
            || (Candidates::default(), Vec::new(), S::default()),
            |(candidates, near, scratch), (o, group, own)| {
                let members = group.range.clone().filter(|&i| asked(i));
                let Some(bounds) = bounds(members.map(|i| &self.patches[i]), reach) else {
                    return;
                };
                candidates.fill(self, o, group, bounds, &count);
                for (i, out) in group.range.clone().zip(own).filter(|(i, _)| asked(*i)) {
                    candidates.find(&self.patches[i], reach, near);
                    self.hidden.part(i, near, |n| n.id);
                    *out = f(i, near, scratch);
                }
            },
        );
        results
    }
}

/// The texels within a small reach of each, found once for many uses.
pub(crate) struct Discs {
    /// Group by group: a texel, and the squared distance to it as a share of the reach's square.
    near: Vec<Vec<(u32, f32)>>,
    /// Per texel: its group, and its range there.
    place: Vec<(u32, Range<u32>)>,
}

impl Discs {
    /// The texels around texel `i`, itself among them.
    pub(crate) fn of(&self, i: usize) -> &[(u32, f32)] {
        let (group, range) = &self.place[i];
        &self.near[*group as usize][range.start as usize..range.end as usize]
    }
}

impl SurfelGrid {
    /// The texels within `reach` texels of each, on the same smooth surface.
    pub(crate) fn discs(&self, reach: f32) -> Discs {
        let groups: Vec<(&Octave, &Group)> = self.groups().collect();
        let each = |(candidates, found): &mut (Candidates, Vec<Near>),
                    (o, group): &(&Octave, &Group)| {
            let (mut near, mut ranges) = (Vec::new(), Vec::with_capacity(group.range.len()));
            let bounds = bounds(group.range.clone().map(|i| &self.patches[i]), reach);
            candidates.fill(self, o, group, bounds.unwrap_or_default(), |_| true);
            for i in group.range.clone() {
                candidates.find(&self.patches[i], reach, found);
                self.hidden.part(i, found, |n| n.id);
                let start = near.len() as u32;
                near.extend(found.iter().map(|n| (n.id, n.distance2)));
                ranges.push(start..near.len() as u32);
            }
            near.shrink_to_fit();
            (near, ranges)
        };
        let (near, ranges): (Vec<_>, Vec<_>) =
            groups.par_iter().map_init(Default::default, each).unzip();
        let of_group = |(group, ranges): (usize, Vec<Range<u32>>)| {
            ranges.into_iter().map(move |r| (group as u32, r))
        };
        let place = ranges
            .into_par_iter()
            .enumerate()
            .flat_map_iter(of_group)
            .collect();
        Discs { near, place }
    }
}

/// The box within `reach` texels of all of `patches`; `None` if there are none.
fn bounds<'a>(patches: impl Iterator<Item = &'a Surfel>, reach: f32) -> Option<[Vec3; 2]> {
    // a little more, for what rounding takes away; finite, so that only cubes nearby are visited
    let corner = |p: &Surfel, reach: f32| {
        let position = if p.position.is_finite() {
            p.position
        } else {
            Vec3::ZERO
        };
        (position + 1.001 * reach * p.size).clamp(Vec3::MIN, Vec3::MAX)
    };
    let of = |p: &Surfel| [corner(p, -reach), corner(p, reach)];
    patches
        .map(of)
        .reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

impl Octave {
    /// Sorts the `members` into groups and appends them to `order`.
    fn new(
        patches: &[Surfel],
        members: impl ParallelIterator<Item = usize>,
        o: i32,
        order: &mut Vec<u32>,
    ) -> Self {
        let cell = (2.0f32.powi(o) * CELL).max(f32::MIN_POSITIVE);
        // cube, facing and number in one: what compares fast sorts fast
        let key = |i: usize| {
            let cube = cube(patches[i].position, cell).map(|c| (c + CUBES) as u128);
            (cube[0] << 95)
                | (cube[1] << 65)
                | (cube[2] << 35)
                | (u128::from(facing(patches[i].normal)) << 32)
                | i as u128
        };
        let mut keyed: Vec<u128> = members.map(key).collect();
        keyed.par_sort_unstable();
        let first = order.len();
        order.par_extend(keyed.par_iter().map(|k| *k as u32));
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for k in 0..keyed.len() {
            match ranges.last_mut() {
                Some(last) if keyed[last.start] >> 32 == keyed[k] >> 32 => last.end = k + 1,
                _ => ranges.push(k..k + 1),
            }
        }
        let group = |range: Range<usize>| {
            let range = first + range.start..first + range.end;
            let members = || order[range.clone()].iter().map(|&i| &patches[i as usize]);
            let axis = members()
                .map(|p| p.normal)
                .sum::<Vec3>()
                .normalize_or(Vec3::Z);
            let spread = members()
                .map(|p| axis.dot(p.normal).clamp(-1.0, 1.0).acos())
                .fold(0.0, f32::max);
            let cube = cube(patches[order[range.start] as usize].position, cell);
            Group {
                cube,
                axis,
                spread,
                spread_sin_cos: spread.sin_cos(),
                range,
            }
        };
        Self {
            octave: o,
            cell,
            groups: ranges.into_par_iter().map(group).collect(),
        }
    }

    /// The groups whose cubes meet a box; those of one row of cubes lie side by side.
    fn within(&self, [lo, hi]: [Vec3; 2]) -> impl Iterator<Item = &Group> {
        let (lo, hi) = (cube(lo, self.cell), cube(hi, self.cell));
        (lo[0]..=hi[0]).flat_map(move |x| {
            let from = self.groups.partition_point(|g| g.cube < [x, lo[1], lo[2]]);
            let to = from + self.groups[from..].partition_point(|g| g.cube <= [x, hi[1], hi[2]]);
            let slab = &self.groups[from..to];
            // (most slabs of a grid with few texels have none, hence no rows)
            let rows = if slab.is_empty() {
                0..0
            } else {
                lo[1]..hi[1] + 1
            };
            rows.flat_map(move |y| {
                let from = slab.partition_point(|g| g.cube < [x, y, lo[2]]);
                slab[from..]
                    .iter()
                    .take_while(move |g| g.cube <= [x, y, hi[2]])
            })
        })
    }
}

/// Cubes lie within so many of the origin in every direction, those beyond in the outermost.
/// Derived: thirty bits a coordinate in the key that texels are sorted by.
const CUBES: i32 = 1 << 29;

fn cube(p: Vec3, cell: f32) -> [i32; 3] {
    (p / cell)
        .floor()
        .to_array()
        .map(|x| (x as i32).clamp(-CUBES, CUBES - 1))
}

impl Candidates {
    /// Takes the texels of the octaves around one within `bounds` that `count` and may lie on one
    /// smooth surface with texels of `group`.
    fn fill(
        &mut self,
        all: &SurfelGrid,
        octave: &Octave,
        group: &Group,
        bounds: [Vec3; 2],
        count: impl Fn(usize) -> bool,
    ) {
        let Self {
            ids,
            columns,
            runs,
            inside,
            ..
        } = self;
        // a little more, for what rounding takes away
        let turn = SMOOTH.acos() + group.spread + 1e-3;
        let (sin, cos) = turn.sin_cos();
        let may = |g: &&Group| {
            let (g_sin, g_cos) = g.spread_sin_cos;
            turn + g.spread >= PI || g.axis.dot(group.axis) >= cos * g_cos - sin * g_sin
        };
        runs.clear();
        let octaves = all
            .octaves
            .iter()
            .filter(|o| (o.octave - octave.octave).abs() <= 1);
        for near in octaves.flat_map(|o| o.within(bounds)).filter(may) {
            match runs.last_mut() {
                Some(last) if last.end == near.range.start => last.end = near.range.end,
                _ => runs.push(near.range.clone()),
            }
        }
        inside.resize(runs.iter().map(Range::len).max().unwrap_or(0), 0);
        ids.resize(runs.iter().map(Range::len).sum(), 0);
        let (cosine, mut kept) = (turn.min(PI).cos(), 0);
        with_widest(|| {
            // (copies: what is read through a reference could change with every value written)
            let ([lo, hi], axis) = (bounds, group.axis);
            for run in runs.iter() {
                let [x, y, z, nx, ny, nz] = all.columns.each_ref().map(|c| &c[run.clone()]);
                let inside = &mut inside[..run.len()];
                for (k, inside) in inside.iter_mut().enumerate() {
                    let within = (x[k] >= lo.x)
                        & (x[k] <= hi.x)
                        & (y[k] >= lo.y)
                        & (y[k] <= hi.y)
                        & (z[k] >= lo.z)
                        & (z[k] <= hi.z);
                    *inside = u32::from(
                        within & (nx[k] * axis.x + ny[k] * axis.y + nz[k] * axis.z >= cosine),
                    );
                }
                // (written whether inside or not: a branch would be mispredicted every other time)
                for (id, inside) in run.clone().zip(inside) {
                    ids[kept] = id as u32;
                    kept += *inside as usize;
                }
            }
        });
        ids.truncate(kept);
        ids.retain(|i| count(*i as usize));
        for (to, from) in columns.iter_mut().zip(&all.columns) {
            to.clear();
            to.extend(ids.iter().map(|i| from[*i as usize]));
        }
        let n = self.ids.len();
        self.distance2.resize(n, 0.0);
        self.along.iter_mut().for_each(|c| c.resize(n, 0.0));
        self.near.resize(n, 0);
    }

    /// Writes those that lie around `p`.
    fn find(&mut self, p: &Surfel, reach: f32, out: &mut Vec<Near>) {
        let n = self.ids.len();
        with_widest(|| {
            // (copies: what is read through a reference could change with every value written)
            let Surfel {
                position,
                normal,
                size,
            } = *p;
            let Frame { t, b, .. } = Frame::from_normal(normal);
            let (around, per_reach) = (
                Reach::new(size, reach),
                1.0 / (reach * size).max(f32::MIN_POSITIVE),
            );
            let [x, y, z, nx, ny, nz] = self.columns.each_ref().map(|c| &c[..n]);
            let distance2 = &mut self.distance2[..n];
            let [s0, s1, n0, n1] = self.along.each_mut().map(|c| &mut c[..n]);
            for k in 0..n {
                let (step, other) = (
                    Vec3::new(x[k], y[k], z[k]) - position,
                    Vec3::new(nx[k], ny[k], nz[k]),
                );
                distance2[k] = around.share(step, [normal, other]);
                (s0[k], s1[k]) = (step.dot(t) * per_reach, step.dot(b) * per_reach);
                (n0[k], n1[k]) = (other.dot(t), other.dot(b));
            }
        });
        let (ids, distance2, along) = (
            &self.ids[..n],
            &self.distance2[..n],
            self.along.each_ref().map(|c| &c[..n]),
        );
        let near = &mut self.near[..n];
        let mut kept = 0;
        for (k, d2) in distance2.iter().enumerate() {
            // (written whether near or not: a branch would be mispredicted every other time)
            near[kept] = k as u32;
            kept += usize::from(*d2 < 1.0);
        }
        out.clear();
        let near = near[..kept].iter().map(|k| *k as usize);
        out.extend(near.map(|k| Near {
            id: ids[k],
            distance2: distance2[k],
            along: along.map(|c| c[k]),
        }));
    }
}

/// Octave of a texel's size.
fn octave(size: f32) -> i32 {
    size.max(1e-20).log2().round().clamp(-66.0, 128.0) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor of 60 × 60 texels of 1 cm, a wall on it, a second floor of texels of 0.1 cm above,
    /// and a ball.
    fn patches() -> Vec<Surfel> {
        let mut out = Vec::new();
        let grid = |n: usize| (0..n * n).map(move |k| ((k % n) as f32 + 0.5, (k / n) as f32 + 0.5));
        out.extend(grid(60).map(|(x, y)| Surfel {
            position: Vec3::new(x, 0.0, y) * 0.01,
            normal: Vec3::Y,
            size: 0.01,
        }));
        out.extend(grid(40).map(|(x, y)| Surfel {
            position: Vec3::new(0.0, y, x) * 0.01,
            normal: Vec3::X,
            size: 0.01,
        }));
        out.extend(grid(50).map(|(x, y)| Surfel {
            position: Vec3::new(x, 300.0, y) * 1e-3,
            normal: Vec3::Y,
            size: 1e-3,
        }));
        let ball = (0..5000).map(|k| {
            let (z, turn) = (1.0 - (k as f32 + 0.5) / 2500.0, k as f32 * 2.399_963);
            let (sin, cos) = turn.sin_cos();
            Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        });
        out.extend(ball.map(|n| Surfel {
            position: Vec3::new(2.0, 0.0, 0.0) + 0.2 * n,
            normal: n,
            size: 0.01,
        }));
        out
    }

    /// Every texel of whatever size and place finds itself, in a time that does not grow with what
    /// it might reach.
    #[test]
    fn extreme_texels_find_themselves() {
        let at = |x: f32, size: f32| Surfel {
            position: Vec3::splat(x),
            normal: Vec3::Y,
            size,
        };
        let sizes = [0.0, 1e-38, 1e-10, 1.0, 1e20, 3e37, 3e38, f32::INFINITY];
        let places = [0.0, -1e-20, 1.0, -1e9, 1e30, -3e38];
        let patches: Vec<Surfel> = sizes
            .iter()
            .flat_map(|s| places.map(|x| at(x, *s)))
            .chain([at(f32::NAN, 1.0)])
            .collect();
        let itself = |i: usize, near: &[Near], (): &mut ()| {
            near.iter().any(|n| n.distance2 < 1.0 && n.id as usize == i)
        };
        let around = SurfelGrid::new(&patches);
        let found = around.map(9.0, |_| true, |_| true, itself);
        for (p, found) in around.patches().iter().zip(found) {
            // a texel whose reach has no finite, positive square has no surroundings
            let limit = (9.0 * p.size).powi(2);
            let has_reach = limit > 0.0 && limit.is_finite() && p.position.is_finite();
            assert!(found || !has_reach, "{p:?}");
        }
    }

    #[test]
    fn neighbours_are_those_of_a_plain_search() {
        let reach = 4.0;
        let around = SurfelGrid::new(&patches());
        let patches = around.patches();
        let index: Vec<u32> = (0..patches.len() as u32).collect();
        let (asked, counts) = (
            |i: usize| !i.is_multiple_of(3),
            |i: usize| !i.is_multiple_of(4),
        );
        let found = around.map(reach, asked, counts, |i, near: &[Near], (): &mut ()| {
            for n in near {
                // places on the plane: with the height over it they are as far as stated
                let (p, q) = (&patches[i], &patches[n.id as usize]);
                let (step, [x, y, ..]) = ((q.position - p.position) / (reach * p.size), n.along);
                assert!(
                    (step.dot(p.normal).powi(2) + x * x + y * y - n.distance2).abs() < 1e-4,
                    "{n:?}"
                );
            }
            let mut list: Vec<u32> = near.iter().map(|n| n.id).collect();
            list.sort_unstable();
            list
        });
        for (i, list) in found.iter().enumerate().step_by(7) {
            let p = &patches[i];
            if !asked(i) {
                assert!(list.is_empty(), "texel {i} was not asked for");
                continue;
            }
            let plain: Vec<u32> = index
                .iter()
                .copied()
                .filter(|&j| {
                    let q = &patches[j as usize];
                    let step = q.position - p.position;
                    counts(j as usize)
                        && step.length_squared() < (reach * p.size).powi(2)
                        && q.normal.dot(p.normal) > SMOOTH
                        && p.normal.dot(step).abs() <= (0.5 * SMOOTH.acos()).sin() * step.length()
                })
                .collect();
            assert!(plain.len() > 10, "texel {i} has company");
            assert_eq!(*list, plain, "texel {i}");
        }
    }
}
