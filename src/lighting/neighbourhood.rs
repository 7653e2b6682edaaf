//! Which texels lie around a texel on the same smooth surface, in space and across charts.
//!
//! Texels are sorted into cubes; those of one cube share a list of candidates, copied side by side. Charts of different density live in
//! different grids (octaves of texel size), so that the number of neighbours does not grow with the density of a chart next door.

use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Cubes per reach: more waste less on candidates out of reach, fewer need fewer look-ups.
const CELLS_PER_REACH: i32 = 2;
/// Normals closer than this cosine belong to one smooth surface.
const SMOOTH: f32 = 0.95;
/// Height over the tangent plane, as a share of the distance, within which a texel belongs to the same surface.
const FLAT: f32 = 0.15;

/// A texel as a piece of surface.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Position of its centre, metres.
    pub position: Vec3,
    /// Unit shading normal on the lit side.
    pub normal: Vec3,
    /// Side of the texel on the surface, metres.
    pub size: f32,
}

/// The surroundings of every texel.
pub(super) struct Neighbourhood {
    octaves: Vec<Octave>,
    /// Octave of every texel's size.
    octave_of: Vec<i32>,
    /// In texels.
    reach: f32,
}

/// Texels of similar size sorted by cube.
struct Octave {
    /// Logarithm of the members' texel size; a grid also holds the octaves next to it.
    octave: i32,
    /// Texels in the order of their cubes.
    sorted: Vec<u32>,
    /// Cubes in order with their ranges of `sorted`.
    cubes: Vec<([i32; 3], Range<usize>)>,
}

/// What a texel's neighbours are drawn from.
pub(super) struct Candidates<T> {
    list: Vec<(Patch, T)>,
    reach: f32,
}

impl Neighbourhood {
    /// Sorts the texels; `reach` in texels.
    pub(super) fn new(patches: &[Patch], reach: f32) -> Self {
        let octave_of: Vec<i32> = patches.par_iter().map(|p| octave(p.size)).collect();
        let mut present = octave_of.clone();
        present.par_sort_unstable();
        present.dedup();
        let octaves = present.iter().map(|&o| Octave::new(patches, &octave_of, o, reach)).collect();
        Self { octaves, octave_of, reach }
    }

    /// Calls `f(i, candidates)` for every texel and returns the results in order. `data[i]` travels with texel i.
    pub(super) fn map<T: Copy + Send + Sync, R: Send + Clone + Default>(
        &self,
        patches: &[Patch],
        data: &[T],
        f: impl Fn(usize, &Candidates<T>) -> R + Sync,
    ) -> Vec<R> {
        let mut out = vec![R::default(); patches.len()];
        for o in &self.octaves {
            let is_member = |i: &u32| self.octave_of[*i as usize] == o.octave;
            let parts: Vec<Vec<(u32, R)>> = o
                .cubes
                .par_iter()
                .map(|(c, range)| {
                    let members = &o.sorted[range.clone()];
                    if !members.iter().any(is_member) {
                        return Vec::new();
                    }
                    let list =
                        o.around(*c).flat_map(|r| &o.sorted[r]).map(|&j| (patches[j as usize], data[j as usize])).collect();
                    let candidates = Candidates { list, reach: self.reach };
                    members.iter().filter(|i| is_member(i)).map(|&i| (i, f(i as usize, &candidates))).collect()
                })
                .collect();
            for (i, value) in parts.into_iter().flatten() {
                out[i as usize] = value;
            }
        }
        out
    }
}

impl Octave {
    fn new(patches: &[Patch], octave_of: &[i32], o: i32, reach: f32) -> Self {
        // the reach of the octave's largest texels
        let cell = (2.0f32.powf(o as f32 + 0.5) * reach / CELLS_PER_REACH as f32).max(f32::MIN_POSITIVE);
        let cube = |p: Vec3| (p / cell).floor().to_array().map(|x| x as i32);
        let mut keyed: Vec<([i32; 3], u32)> = (0..patches.len())
            .filter(|&i| (octave_of[i] - o).abs() <= 1)
            .map(|i| (cube(patches[i].position), i as u32))
            .collect();
        keyed.par_sort_unstable();
        let mut cubes: Vec<([i32; 3], Range<usize>)> = Vec::new();
        for (k, (c, _)) in keyed.iter().enumerate() {
            match cubes.last_mut() {
                Some((last, range)) if last == c => range.end = k + 1,
                _ => cubes.push((*c, k..k + 1)),
            }
        }
        Self { octave: o, sorted: keyed.into_iter().map(|k| k.1).collect(), cubes }
    }

    /// The ranges of `sorted` within reach of cube `c`; the cubes of one row lie side by side.
    fn around(&self, c: [i32; 3]) -> impl Iterator<Item = Range<usize>> + '_ {
        let r = CELLS_PER_REACH;
        let rows = (-r..=r).flat_map(move |x| (-r..=r).map(move |y| [c[0].saturating_add(x), c[1].saturating_add(y)]));
        rows.filter_map(move |[x, y]| {
            let (first, last) = ([x, y, c[2].saturating_sub(r)], [x, y, c[2].saturating_add(r)]);
            let from = self.cubes.partition_point(|k| k.0 < first);
            let to = from + self.cubes[from..].iter().take_while(|k| k.0 <= last).count();
            (to > from).then(|| self.cubes[from].1.start..self.cubes[to - 1].1.end)
        })
    }
}

impl<T> Candidates<T> {
    /// Calls `f(patch, data, squared distance as a share of the reach's square)` for every texel on the same smooth surface as `p`
    /// and within its reach, `p` itself among them.
    #[inline(always)]
    pub(super) fn each(&self, p: &Patch, mut f: impl FnMut(&Patch, &T, f32)) {
        let limit = (self.reach * p.size).powi(2);
        for (q, data) in &self.list {
            let step = q.position - p.position;
            let d2 = step.length_squared();
            if d2 < limit && q.normal.dot(p.normal) > SMOOTH && p.normal.dot(step).powi(2) <= FLAT * FLAT * d2 {
                f(q, data, d2 / limit);
            }
        }
    }
}

/// Octave of a texel's size.
fn octave(size: f32) -> i32 {
    size.max(1e-20).log2().round().clamp(-60.0, 60.0) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor of 60 × 60 texels of 1 cm, a wall on it, and a second floor of texels of 0.1 cm above.
    fn patches() -> Vec<Patch> {
        let mut out = Vec::new();
        let grid = |n: usize| (0..n * n).map(move |k| ((k % n) as f32 + 0.5, (k / n) as f32 + 0.5));
        out.extend(grid(60).map(|(x, y)| Patch { position: Vec3::new(x, 0.0, y) * 0.01, normal: Vec3::Y, size: 0.01 }));
        out.extend(grid(40).map(|(x, y)| Patch { position: Vec3::new(0.0, y, x) * 0.01, normal: Vec3::X, size: 0.01 }));
        out.extend(grid(50).map(|(x, y)| Patch { position: Vec3::new(x, 300.0, y) * 1e-3, normal: Vec3::Y, size: 1e-3 }));
        out
    }

    #[test]
    fn neighbours_are_those_of_a_plain_search() {
        let patches = patches();
        let reach = 4.0;
        let index: Vec<u32> = (0..patches.len() as u32).collect();
        let found = Neighbourhood::new(&patches, reach).map(&patches, &index, |i, candidates| {
            let mut list = Vec::new();
            candidates.each(&patches[i], |_, &j, _| list.push(j));
            list.sort_unstable();
            list
        });
        for (i, list) in found.iter().enumerate().step_by(7) {
            let p = &patches[i];
            let plain: Vec<u32> = index
                .iter()
                .copied()
                .filter(|&j| {
                    let q = &patches[j as usize];
                    let step = q.position - p.position;
                    step.length_squared() < (reach * p.size).powi(2)
                        && q.normal.dot(p.normal) > SMOOTH
                        && p.normal.dot(step).abs() <= FLAT * step.length()
                })
                .collect();
            assert!(plain.len() > 10, "texel {i} has company");
            assert_eq!(*list, plain, "texel {i}");
        }
    }
}
