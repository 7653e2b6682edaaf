//! `--atlas per-object`: textures of its own for each object.
//!
//! The rectangles around an object's charts are cut out of the shared atlas and packed anew, in shelves
//! (Coffman et al. 1980). They move by whole cells of a grid that every texture's texels fill evenly,
//! and take a cell around them along: texels are copied, not resampled, and a look-up near a chart's
//! edge meets the neighbours it had.

use crate::core::geometry::{Mesh, charts};
use crate::core::image::{Plane, RgbPlane};
use crate::core::texture::{Shelves, Texel, fill_uncovered, shelves};
use crate::error::{Error, Result};
use crate::solution::{MeshPart, Solution};
use glam::{DVec2, Vec2};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which textures objects have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum AtlasKind {
    /// One set of textures for all.
    #[default]
    Shared,
    /// A set of its own for each.
    PerObject,
}

/// Whether the textures' sizes allow objects to have textures of their own.
///
/// # Errors
/// They have no common divisor, or a small one: every object would take most of the atlas along.
pub(super) fn check_sizes(solution: &Solution) -> Result<()> {
    let Grid { width, height } = Grid::of(solution);
    let largest = sizes(solution).into_iter().flatten().fold(1, usize::max);
    if largest > COARSEST * width.min(height) {
        return Err(Error::Usage(format!(
            "--atlas per-object cuts whole texels out of textures whose sizes are multiples of each other; these have {width} x {height} \
             cells in common only, the largest {largest} texels: solve with sizes that are powers of two, or use --atlas shared"
        )));
    }
    Ok(())
}

/// An object with its textures: a solution of its triangles alone, in the order of the part's.
///
/// Its mesh is relative to the origin of the whole; what a glTF file does not have (radiance, labels,
/// confidence) it has not.
#[must_use]
pub fn cut_out(solution: &Solution, part: &MeshPart) -> Solution {
    let grid = Grid::of(solution);
    let mesh = solution.mesh.part(&part.triangles);
    let cutouts = cutouts(&mesh, grid);
    let boxes: Vec<CellBox> = cutouts.iter().map(|c| c.cells).collect();
    let cut = Cut {
        grid,
        cutouts: &cutouts,
        packed: &packed(&boxes),
    };
    let transparent = |p: &Plane<f32>| p.data.iter().any(|x| *x > 0.0);
    let nothing = || Plane::filled(1, 1, glam::Vec3::ZERO);
    Solution {
        mesh: cut.mesh(&mesh),
        origin: solution.origin,
        albedo: cut.plane(&solution.albedo),
        // without metal too: it decides the size of the texture that it shares with the roughness
        metallic: solution.metallic.as_ref().map(|p| cut.plane(p)),
        transmission: solution
            .transmission
            .as_ref()
            .map(|p| cut.plane(p))
            .filter(transparent),
        roughness: cut.plane(&solution.roughness),
        irradiance: cut.plane(&solution.irradiance),
        radiance: nothing(),
        emission: cut.plane(&solution.emission),
        confidence: Plane::filled(1, 1, Vec2::ZERO),
        irradiance_error: None,
        labels: Plane::filled(1, 1, 0),
        rooms: Plane::filled(1, 1, 0),
        environment: nothing(),
        reflectance: solution.reflectance,
        lamps: Vec::new(),
        portals: Vec::new(),
        camera_masks: Vec::new(),
    }
}

/// Texels that a cell may be wide (derived: objects of a 64th of an atlas of 4096 texels are then cut
/// out with no more than themselves around them).
const COARSEST: usize = 64;

/// Rectangles that others are joined to, the largest (derived: of a hundred thousand charts all pairs
/// would take minutes).
const MOST_JOINED: usize = 1024;

/// The finest grid whose cells hold whole texels of every texture.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Grid {
    width: usize,
    height: usize,
}

/// A rectangle of cells; it may reach a cell beyond the atlas, whose texels are those of the border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct CellBox {
    x: isize,
    y: isize,
    width: usize,
    height: usize,
}

impl CellBox {
    fn area(&self) -> usize {
        self.width * self.height
    }

    fn right(&self) -> isize {
        self.x + self.width as isize
    }

    fn bottom(&self) -> isize {
        self.y + self.height as isize
    }

    /// The rectangle around both.
    fn union(&self, other: &Self) -> Self {
        let (x, y) = (self.x.min(other.x), self.y.min(other.y));
        Self {
            x,
            y,
            width: self.right().max(other.right()).abs_diff(x),
            height: self.bottom().max(other.bottom()).abs_diff(y),
        }
    }
}

/// A rectangle of the shared atlas that an object takes along.
struct Cutout {
    cells: CellBox,
    /// The triangles in it, as places in the object.
    triangles: Vec<usize>,
}

/// The rectangles around the charts of a mesh; those that are smaller together than apart are one.
fn cutouts(mesh: &Mesh, grid: Grid) -> Vec<Cutout> {
    let mut single: Vec<Cutout> = triangles_of_charts(mesh)
        .into_iter()
        .map(|triangles| Cutout {
            cells: grid.cells(mesh, &triangles),
            triangles,
        })
        .collect();
    single.sort_by_key(|c| (std::cmp::Reverse(c.cells.area()), c.triangles[0]));
    let mut out: Vec<Cutout> = Vec::new();
    for chart in single {
        let together = |c: &&mut Cutout| {
            c.cells.union(&chart.cells).area() <= c.cells.area() + chart.cells.area()
        };
        match out.iter_mut().take(MOST_JOINED).find(together) {
            Some(c) => {
                c.cells = c.cells.union(&chart.cells);
                c.triangles.extend(chart.triangles);
            }
            None => out.push(chart),
        }
    }
    out
}

impl Grid {
    fn of(solution: &Solution) -> Self {
        let shares = [&solution.metallic, &solution.transmission];
        let [width, height] = sizes(solution)
            .into_iter()
            .chain(shares.into_iter().flatten().map(|p| [p.width, p.height]))
            .fold([0, 0], |[w, h], [x, y]| [divisor(w, x), divisor(h, y)]);
        Self { width, height }
    }

    /// The cells around some triangles' texture coordinates, and one more on each side.
    fn cells(&self, mesh: &Mesh, triangles: &[usize]) -> CellBox {
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for uv in triangles.iter().flat_map(|&t| mesh.corner_uvs(t)) {
            (low, high) = (low.min(uv), high.max(uv));
        }
        let range = |low: f32, high: f32, cells: usize| {
            let first = (low * cells as f32).floor() - 1.0;
            let end = (high * cells as f32).ceil() + 1.0;
            // what lies outside of the atlas takes its border
            let cells = cells as isize;
            let first = (first as isize).clamp(-1, cells - 1);
            (
                first,
                (end as isize).clamp(first + 1, cells + 1).abs_diff(first),
            )
        };
        let (x, width) = range(low.x, high.x, self.width);
        let (y, height) = range(low.y, high.y, self.height);
        CellBox {
            x,
            y,
            width,
            height,
        }
    }
}

/// Width and height of the textures that every solution has.
fn sizes(solution: &Solution) -> [[usize; 2]; 4] {
    let size = |p: &RgbPlane| [p.width, p.height];
    let roughness = &solution.roughness;
    [
        size(&solution.albedo),
        size(&solution.irradiance),
        size(&solution.emission),
        [roughness.width, roughness.height],
    ]
}

/// The greatest common divisor.
fn divisor(mut a: usize, mut b: usize) -> usize {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// The triangles of each chart.
fn triangles_of_charts(mesh: &Mesh) -> Vec<Vec<usize>> {
    let mut out: Vec<Vec<usize>> = Vec::new();
    for (t, chart) in charts(mesh).into_iter().enumerate() {
        let chart = chart as usize;
        if chart == out.len() {
            out.push(Vec::new());
        }
        out[chart].push(t);
    }
    out
}

/// Where rectangles lie in an atlas of their own.
#[derive(Clone, Debug, PartialEq)]
struct Packed {
    /// Sides in cells: powers of two, as engines stream textures.
    width: usize,
    height: usize,
    /// First cell of each rectangle.
    places: Vec<[usize; 2]>,
}

/// Packs rectangles, the highest first, into the smaller of the atlases of several widths.
fn packed(boxes: &[CellBox]) -> Packed {
    let widest = boxes.iter().map(|b| b.width).max().unwrap_or(1);
    let area: usize = boxes.iter().map(CellBox::area).sum();
    let narrow = widest.max(area.isqrt() / 2).next_power_of_two();
    let sizes: Vec<[usize; 2]> = boxes.iter().map(|b| [b.width, b.height]).collect();
    let of_width = |width: usize| {
        let Shelves { corners, height } = shelves(&sizes, width, 0);
        Packed {
            width,
            height: height.max(1).next_power_of_two(),
            places: corners,
        }
    };
    [2 * narrow, 4 * narrow]
        .map(of_width)
        .into_iter()
        .fold(of_width(narrow), |best, p| {
            let size = |p: &Packed| (p.width * p.height, p.width.abs_diff(p.height));
            if size(&p) < size(&best) { p } else { best }
        })
}

/// Rectangles of the shared atlas on their way into an object's.
struct Cut<'a> {
    grid: Grid,
    cutouts: &'a [Cutout],
    packed: &'a Packed,
}

impl Cut<'_> {
    /// The mesh on its own atlas; vertices that several charts share are there once for each.
    fn mesh(&self, mesh: &Mesh) -> Mesh {
        let size = DVec2::new(self.grid.width as f64, self.grid.height as f64);
        let own = DVec2::new(self.packed.width as f64, self.packed.height as f64);
        let mut out = Mesh {
            triangles: vec![[0; 3]; mesh.triangles.len()],
            ..Mesh::default()
        };
        for (
            Cutout {
                cells: from,
                triangles,
            },
            to,
        ) in self.cutouts.iter().zip(&self.packed.places)
        {
            let moved = DVec2::new(to[0] as f64 - from.x as f64, to[1] as f64 - from.y as f64);
            let mut number: BTreeMap<u32, u32> = BTreeMap::new();
            for &t in triangles {
                out.triangles[t] = mesh.triangles[t].map(|i| {
                    *number.entry(i).or_insert_with(|| {
                        let i = i as usize;
                        let uv = (mesh.uvs[i].as_dvec2() * size + moved) / own;
                        out.positions.push(mesh.positions[i]);
                        out.normals.push(mesh.normals[i]);
                        out.uvs.push(uv.as_vec2());
                        out.positions.len() as u32 - 1
                    })
                });
            }
        }
        out
    }

    /// A texture of the object: the rectangles' texels; what lies between is filled from around.
    fn plane<T: Texel>(&self, plane: &Plane<T>) -> Plane<T> {
        let texels = [
            plane.width / self.grid.width,
            plane.height / self.grid.height,
        ];
        let size = [
            self.packed.width * texels[0],
            self.packed.height * texels[1],
        ];
        let mut out = Plane::filled(size[0], size[1], T::default());
        let mut covered = Plane::filled(size[0], size[1], false);
        for (Cutout { cells: from, .. }, to) in self.cutouts.iter().zip(&self.packed.places) {
            let columns = border_repeated(from.x, from.width, texels[0], plane.width);
            let rows = border_repeated(from.y, from.height, texels[1], plane.height);
            for (row, from_row) in rows.enumerate() {
                let at = (to[1] * texels[1] + row) * size[0] + to[0] * texels[0];
                for (at, column) in (at..).zip(columns.clone()) {
                    out.data[at] = plane[(column, from_row)];
                    covered.data[at] = true;
                }
            }
        }
        fill_uncovered(&out, &covered)
    }
}

/// The texels of `cells` cells from `first` on, along a side of `side` texels: its last where cells lie
/// beyond it, as a look-up that does not repeat the texture sees it.
fn border_repeated(
    first: isize,
    cells: usize,
    texels: usize,
    side: usize,
) -> impl Iterator<Item = usize> + Clone {
    let first = first * texels as isize;
    (first..first + (cells * texels) as isize)
        .map(move |i| usize::try_from(i).unwrap_or(0).min(side - 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Wrap;
    use crate::solution::tests::small_solution;
    use glam::Vec3;

    /// Three squares in a large atlas, two at its borders: the first two are one object, the last is another.
    fn squares() -> (Solution, [MeshPart; 2]) {
        let mut solution = small_solution();
        solution.mesh = Mesh::default();
        let m = &mut solution.mesh;
        for (k, (x, y)) in [(0.0, 0.1), (0.8, 0.62), (0.1, 0.7)]
            .into_iter()
            .enumerate()
        {
            let first = m.positions.len() as u32;
            for (i, j) in [(0., 0.), (0., 1.), (1., 1.), (1., 0.)] {
                m.positions.push(Vec3::new(2.0 * k as f32 + i, 0.0, j));
                m.normals.push(Vec3::Y);
                m.uvs.push(Vec2::new(x + 0.2 * i, y + 0.17 * j));
            }
            m.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        let values = |side: usize| Plane {
            width: side,
            height: side,
            data: (0..side * side)
                .map(|i| Vec3::new(i as f32, (i % side) as f32, 1.0))
                .collect(),
        };
        solution.albedo = values(128);
        solution.irradiance = values(32);
        solution.emission = values(64);
        solution.roughness = values(256).map(|v| v.x);
        solution.metallic = Some(values(128).map(|v| v.y));
        let part = |name: &str, triangles: Vec<u32>| {
            MeshPart::standing(name.into(), &solution.mesh, triangles)
        };
        let parts = [part("a", vec![0, 1, 2, 3]), part("b", vec![4, 5])];
        (solution, parts)
    }

    /// Wherever a surface is looked at, its textures say what they said.
    #[test]
    fn surfaces_have_the_values_they_had() {
        let (solution, parts) = squares();
        for part in &parts {
            let own = cut_out(&solution, part);
            assert_eq!(own.mesh.triangles.len(), part.triangles.len());
            let at = |p: &Plane<f32>, uv: Vec2| {
                p.bilinear(uv * Vec2::new(p.width as f32, p.height as f32), Wrap::Clamp)
            };
            for (t, &number) in part.triangles.iter().enumerate() {
                assert_eq!(own.mesh.corners(t), solution.mesh.corners(number as usize));
                for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.3), (0.01, 0.9)] {
                    let (new, old) = (
                        own.mesh.uv(t, u, v),
                        solution.mesh.uv(number as usize, u, v),
                    );
                    assert!(new.min_element() >= 0.0 && new.max_element() <= 1.0);
                    for (a, b) in [
                        (&own.albedo.map(|v| v.x), &solution.albedo.map(|v| v.x)),
                        (
                            &own.irradiance.map(|v| v.x),
                            &solution.irradiance.map(|v| v.x),
                        ),
                        (&own.emission.map(|v| v.y), &solution.emission.map(|v| v.y)),
                        (&own.roughness, &solution.roughness),
                    ] {
                        let (a, b) = (at(a, new), at(b, old));
                        assert!((a - b).abs() < 0.05 * 256.0 * 1e-2 + 1e-4 * b, "{a} {b}");
                    }
                }
            }
        }
    }

    #[test]
    fn texels_are_copied_and_objects_are_small() {
        let (mut solution, parts) = squares();
        solution.metallic = Some(Plane::filled(128, 128, 0.0));
        solution.transmission = solution.metallic.clone();
        let own = cut_out(&solution, &parts[1]);
        assert!(own.metallic.is_some_and(|m| m.width == own.albedo.width));
        assert!(own.transmission.is_none(), "nothing is transparent");
        // 0.2 of 32 cells are seven or eight, and one more on each side
        assert!(own.irradiance.width <= 16 && own.irradiance.height <= 16);
        assert_eq!(own.albedo.width, 4 * own.irradiance.width);
        assert_eq!(own.roughness.height, 8 * own.irradiance.height);
        let known: std::collections::BTreeSet<u32> =
            solution.albedo.data.iter().map(|v| v.x.to_bits()).collect();
        let copied = own
            .albedo
            .data
            .iter()
            .filter(|v| known.contains(&v.x.to_bits()))
            .count();
        let square = (0.2 * 128.0 * 0.17 * 128.0) as usize;
        assert!(copied >= square, "{copied} {square}");
    }

    #[test]
    fn rectangles_do_not_overlap_and_fill_most_of_the_atlas() {
        let boxes: Vec<CellBox> = (1..60)
            .map(|k| CellBox {
                x: 0,
                y: 0,
                width: 1 + k * 7 % 13,
                height: 1 + k * 5 % 11,
            })
            .collect();
        let packed = packed(&boxes);
        let mut taken = vec![false; packed.width * packed.height];
        for (b, [x, y]) in boxes.iter().zip(&packed.places) {
            for (i, j) in (0..b.width).flat_map(|i| (0..b.height).map(move |j| (i, j))) {
                let cell = &mut taken[(y + j) * packed.width + x + i];
                assert!(!*cell);
                *cell = true;
            }
        }
        let full = taken.iter().filter(|t| **t).count();
        assert!(3 * full > taken.len(), "{full} of {}", taken.len());
    }

    #[test]
    fn odd_sizes_and_coordinates_beyond_the_atlas_are_no_trouble() {
        let (mut solution, parts) = squares();
        solution.roughness = Plane::filled(37, 101, 0.5);
        solution.mesh.uvs[0] = Vec2::new(-3.0, 7.0);
        solution.mesh.uvs[1] = Vec2::splat(f32::NAN);
        for part in &parts {
            let own = cut_out(&solution, part);
            assert!(own.roughness.data.iter().all(|r| *r == 0.5));
        }
        assert!(check_sizes(&solution).is_err() && check_sizes(&small_solution()).is_ok());
        let none = MeshPart {
            triangles: Vec::new(),
            ..parts[0].clone()
        };
        assert!(cut_out(&solution, &none).mesh.triangles.is_empty());
    }
}
