//! Triangles and portal cells that send out light, packed for sampling: what one sample needs lies
//! side by side in memory.

use super::PortalGrid;
use super::light_model::LightModel;
use crate::core::geometry::Mesh;
use crate::core::sampling::square_to_triangle;
use crate::ffi::simd::{prefetch, transpose4};
use crate::radiance::LightField;
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

/// Shadow rays end this share of their length before the surface they aim at. Derived: ten times the
/// rounding of positions and no more, for what lies between would be overlooked.
pub(crate) const SHORT: f32 = 1e-4;

/// Below this cosine at the source it counts as seen from behind: it is nothing but rounding.
pub(crate) const GRAZING: f32 = f32::EPSILON;

/// A flat piece of a lamp, one cache line: a triangle or a parallelogram, turned so that edge 1 ×
/// edge 2 points to where its light goes.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(64))]
struct Source {
    corner: Vec3,
    edge1: Vec3,
    edge2: Vec3,
    /// Density per m² within its lamp, times the length of edge 1 × edge 2.
    density: f32,
    /// The corner in the texture and the edges there; zero for a portal.
    uv: Vec2,
    uv_edge1: Vec2,
    uv_edge2: Vec2,
}

/// Numbers of a [`Source`].
const NUMBERS: usize = size_of::<Source>() / size_of::<f32>();

impl Source {
    /// `density` is per m² within its lamp; light goes where `normal` points.
    fn new(
        corner: Vec3,
        mut edges: [Vec3; 2],
        normal: Vec3,
        density: f32,
        uv: Vec2,
        mut uv_edges: [Vec2; 2],
    ) -> Self {
        let doubled_area = edges[0].cross(edges[1]);
        if doubled_area.dot(normal) < 0.0 {
            edges.reverse();
            uv_edges.reverse();
        }
        let density = density * doubled_area.length();
        Self {
            corner,
            edge1: edges[0],
            edge2: edges[1],
            density,
            uv,
            uv_edge1: uv_edges[0],
            uv_edge2: uv_edges[1],
        }
    }
}

/// All sources: triangles that emit, triangles that reflect much light, parallelograms through
/// which the environment is seen.
#[derive(Default)]
pub(crate) struct Sources {
    list: Vec<Source>,
    emitting_end: u32,
    triangles_end: u32,
}

/// Room for N sources, number by number.
pub(crate) struct Columns<const N: usize>([[f32; N]; NUMBERS]);

impl<const N: usize> Default for Columns<N> {
    fn default() -> Self {
        Self([[0.0; N]; NUMBERS])
    }
}

/// Directions to one point each of N sources, column by column; the sources may face away. Nothing
/// is traced yet.
pub(crate) struct Aims<const N: usize> {
    /// Unit directions.
    pub direction: [[f32; N]; 3],
    /// Where shadow rays end.
    pub t_far: [f32; N],
    /// Cosine at the source, times a number that is `density`'s too; 0 where the receiver is behind
    /// it or sees it under less than [`GRAZING`].
    pub facing: [f32; N],
    /// `density / facing` is the density per steradian at the receiver, that of the source within
    /// its lamp.
    pub density: [f32; N],
    /// Address of the point's radiance in the light field; [`PORTAL`] where the environment is what
    /// shines.
    pub address: [u32; N],
}

/// No address: the radiance is that of the environment.
pub(crate) const PORTAL: u32 = u32::MAX;

impl Sources {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// Adds a triangle, which comes after those that emit if it does not; `density` is per m²
    /// within its lamp.
    pub(crate) fn push_triangle(
        &mut self,
        mesh: &Mesh,
        model: &dyn LightModel,
        t: u32,
        density: f32,
    ) {
        let t = t as usize;
        let ([a, b, c], [uv_a, uv_b, uv_c]) = (mesh.corners(t), mesh.corner_uvs(t));
        let uv_edges = [uv_b - uv_a, uv_c - uv_a];
        self.list.push(Source::new(
            a,
            [b - a, c - a],
            model.outward_normal(t),
            density,
            uv_a,
            uv_edges,
        ));
        self.triangles_end = self.list.len() as u32;
        if model.is_emissive(t) {
            self.emitting_end = self.triangles_end;
        }
    }

    /// Adds a cell of the hull, which comes last.
    pub(crate) fn push_portal(&mut self, hull: &PortalGrid, cell: u32, density: f32) {
        let [corner, edge1, edge2, normal] = hull.cell_frame(cell);
        self.list.push(Source::new(
            corner,
            [edge1, edge2],
            normal,
            density,
            Vec2::ZERO,
            [Vec2::ZERO; 2],
        ));
    }

    #[inline(always)]
    fn is_emitting(&self, index: u32) -> bool {
        index < self.emitting_end
    }

    /// Whether a source is an opening.
    #[inline(always)]
    pub(crate) fn is_portal(&self, index: u32) -> bool {
        index >= self.triangles_end
    }

    /// Tells the cache that [`Self::aim`] will be asked for a source soon.
    #[inline(always)]
    pub(crate) fn expect(&self, index: u32) {
        prefetch(&self.list, index as usize);
    }

    /// Puts the numbers of the sources of `index` side by side, four sources at a time.
    #[inline(always)]
    fn transpose<const N: usize>(&self, index: &[u32; N], Columns(columns): &mut Columns<N>) {
        let numbers = |i: u32| -> [[f32; 4]; NUMBERS / 4] { bytemuck::cast(self.list[i as usize]) };
        let (fours, rest) = index.as_chunks::<4>();
        for (k, four) in fours.iter().enumerate() {
            let sources = four.map(numbers);
            for q in 0..NUMBERS / 4 {
                for (c, column) in transpose4(sources.map(|s| s[q])).into_iter().enumerate() {
                    columns[4 * q + c][4 * k..4 * k + 4].copy_from_slice(&column);
                }
            }
        }
        for (k, i) in rest.iter().enumerate() {
            for (c, number) in numbers(*i).into_iter().flatten().enumerate() {
                columns[c][N - rest.len() + k] = number;
            }
        }
    }

    /// The directions from `origin` to the points that `place` in [0, 1)² stands for, each on the
    /// source with the number `index`.
    #[inline(always)]
    pub(crate) fn aim<const N: usize>(
        &self,
        field: &LightField,
        origin: Vec3,
        index: &[u32; N],
        place: [&[f32; N]; 2],
        columns: &mut Columns<N>,
    ) -> Aims<N> {
        self.transpose(index, columns);
        let [
            ax,
            ay,
            az,
            bx,
            by,
            bz,
            cx,
            cy,
            cz,
            density,
            uv_x,
            uv_y,
            uv1_x,
            uv1_y,
            uv2_x,
            uv2_y,
        ] = &columns.0;
        let mut out = Aims {
            direction: [[0.0; N]; 3],
            t_far: [0.0; N],
            facing: [0.0; N],
            density: [0.0; N],
            address: [0; N],
        };
        let [x, y, z] = &mut out.direction;
        let (mut u, mut v) = (*place[0], *place[1]);
        for k in 0..N {
            let folded = square_to_triangle([u[k], v[k]]);
            [u[k], v[k]] = if self.is_portal(index[k]) {
                [u[k], v[k]]
            } else {
                folded
            };
        }
        for k in 0..N {
            let (edge1, edge2) = (
                Vec3::new(bx[k], by[k], bz[k]),
                Vec3::new(cx[k], cy[k], cz[k]),
            );
            let d = Vec3::new(ax[k], ay[k], az[k]) + edge1 * u[k] + edge2 * v[k] - origin;
            let d2 = d.length_squared();
            let length = d2.sqrt();
            let unit = d * (1.0 / length);
            let doubled_area = edge1.cross(edge2);
            let facing = -doubled_area.dot(unit);
            let least = GRAZING * doubled_area.length_squared().sqrt();
            (x[k], y[k], z[k]) = (unit.x, unit.y, unit.z);
            out.t_far[k] = length * (1.0 - SHORT);
            out.facing[k] = if facing > least { facing } else { 0.0 };
            out.density[k] = density[k] * d2;
        }
        for k in 0..N {
            let uv = Vec2::new(
                uv_x[k] + uv1_x[k] * u[k] + uv2_x[k] * v[k],
                uv_y[k] + uv1_y[k] * u[k] + uv2_y[k] * v[k],
            );
            out.address[k] = field.sent_address(uv, self.is_emitting(index[k]));
        }
        for ((i, t_far), address) in index.iter().zip(&mut out.t_far).zip(&mut out.address) {
            let portal = self.is_portal(*i);
            *t_far = if portal { f32::INFINITY } else { *t_far };
            *address = if portal { PORTAL } else { *address };
        }
        out
    }
}
