//! Which light to sample from where.
//!
//! Lights are emissive triangles and portals: triangles in openings through which the environment
//! is seen, so that a window is sampled like a lamp. A uniform grid over the scene holds one alias
//! table per cell, weighted by power, distance and a few visibility rays, so that a room does not
//! waste its samples on the lamps of the next. Every light keeps a share of every table: selection
//! changes the variance, never the expectation.

use super::scene::{Environment, SurfaceModel};
use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::core::parallel::map_chunks;
use crate::core::sampling::{AliasTable, KeyedRng, square_to_triangle};
use crate::core::trace::{Ray, Tracer};
use glam::Vec3;

/// A triangle to sample.
#[derive(Clone, Copy, Debug)]
struct Light {
    corner: Vec3,
    edges: [Vec3; 2],
    normal: Vec3,
    area: f32,
    power: f32,
    /// Mesh triangle; `None` for a portal.
    triangle: Option<u32>,
    /// Lamp the triangle belongs to: visibility is probed for lamps, not for their triangles.
    group: u32,
}

/// A point on a light as seen from a shading point.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// Distance of the light's point; infinite for the environment behind a portal.
    pub distance: f32,
    /// Density per steradian, selection included.
    pub pdf: f32,
    /// Triangle and barycentrics of the point; `None` for the environment.
    pub hit: Option<(u32, f32, f32)>,
}

/// All lights of a scene with their selection tables.
pub struct Lights {
    lights: Vec<Light>,
    light_of_triangle: Vec<u32>,
    portals: Vec<u32>,
    /// Ranges of `lights` that make up one lamp or window.
    groups: Vec<std::ops::Range<usize>>,
    origin: Vec3,
    cells_per_metre: f32,
    counts: [usize; 3],
    tables: Vec<AliasTable>,
}

const NO_LIGHT: u32 = u32::MAX;
/// Bound on cells · lights: 12 bytes each.
const TABLE_BUDGET: usize = 4 << 20;
/// Visibility rays per cell and lamp at build time.
const PROBES: usize = 24;
/// Weight of a lamp of which no probe saw anything, of a triangle that faces away: how much rarer
/// than its power says the unlikely may be sampled, and so how much brighter a lucky sample can be.
const UNSEEN: f64 = 0.1;
const AVERTED: f32 = 0.1;

impl Lights {
    /// Collects the lights of a scene and builds the selection tables.
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        surfaces: &dyn SurfaceModel,
        environment: &dyn Environment,
        tracer: &dyn Tracer,
        seed: u64,
    ) -> Self {
        let mut lights = Vec::new();
        let mut light_of_triangle = vec![NO_LIGHT; mesh.triangles.len()];
        for (t, slot) in light_of_triangle.iter_mut().enumerate() {
            let brightness = luminance(surfaces.mean_emission(t));
            if brightness > 0.0 && mesh.area(t) > 0.0 {
                *slot = lights.len() as u32;
                lights.push(Light::new(mesh.corners(t), brightness, Some(t as u32)));
            }
        }
        let first_portal = lights.len();
        for &corners in environment.portals() {
            let n = (corners[1] - corners[0])
                .cross(corners[2] - corners[0])
                .normalize_or_zero();
            let brightness =
                0.5 * (luminance(environment.radiance(n)) + luminance(environment.radiance(-n)));
            if n != Vec3::ZERO && brightness > 0.0 {
                lights.push(Light::new(corners, brightness, None));
            }
        }
        let portals = (first_portal as u32..lights.len() as u32).collect();
        let (low, high) = mesh.bounds();
        let mut out = Self {
            lights,
            light_of_triangle,
            portals,
            origin: low,
            cells_per_metre: 0.0,
            counts: [1; 3],
            groups: Vec::new(),
            tables: Vec::new(),
        };
        out.build_tables(low, high, tracer, seed);
        out
    }

    fn build_tables(&mut self, low: Vec3, high: Vec3, tracer: &dyn Tracer, seed: u64) {
        if self.lights.is_empty() {
            return;
        }
        let size = (high - low).max(Vec3::splat(1e-6));
        self.group_lights();
        // cubic cells, about as many as the budget allows but never more than 4096
        let cells = (TABLE_BUDGET / self.lights.len()).clamp(1, 4096) as f32;
        let edge = (size.x * size.y * size.z / cells)
            .cbrt()
            .max(size.max_element() / 64.0);
        self.cells_per_metre = 1.0 / edge;
        self.counts = (size / edge).to_array().map(|c| (c.ceil() as usize).max(1));
        let total = self.counts.iter().product::<usize>();
        if total * self.lights.len() > 2 * TABLE_BUDGET {
            self.counts = [1; 3];
            self.cells_per_metre = 0.0;
        }
        let total = self.counts.iter().product::<usize>();
        let tables = map_chunks(total, 1, |range| {
            self.cell_table(range.start, edge, total > 1, tracer, seed)
        });
        self.tables = tables.into_iter().flatten().collect();
        if self.tables.len() != total {
            self.tables.clear();
            self.lights.clear();
            self.light_of_triangle.fill(NO_LIGHT);
            self.portals.clear();
        }
    }

    /// Joins runs of triangles of equal brightness that lie close together.
    fn group_lights(&mut self) {
        for i in 0..self.lights.len() {
            let light = &self.lights[i];
            let joins = self.groups.last().is_some_and(|g| {
                let first = &self.lights[g.start];
                let ratio = (light.power / light.area) / (first.power / first.area);
                let reach = 0.5 + first.area.sqrt();
                // portals are pairs of triangles, and each may be seen from where its neighbour is
                // not
                (ratio - 1.0).abs() < 0.01
                    && light.triangle.is_some() == first.triangle.is_some()
                    && if light.triangle.is_some() {
                        (light.corner - first.corner).length() < reach
                    } else {
                        g.len() < 2
                    }
            });
            match self.groups.last_mut().filter(|_| joins) {
                Some(g) => g.end = i + 1,
                None => self.groups.push(i..i + 1),
            }
            self.lights[i].group = self.groups.len() as u32 - 1;
        }
    }

    fn cell_table(
        &self,
        cell: usize,
        edge: f32,
        local: bool,
        tracer: &dyn Tracer,
        seed: u64,
    ) -> Option<AliasTable> {
        let [nx, ny, _] = self.counts;
        let low = self.origin
            + Vec3::new(
                (cell % nx) as f32,
                (cell / nx % ny) as f32,
                (cell / (nx * ny)) as f32,
            ) * edge;
        let total: f64 = self.lights.iter().map(|l| f64::from(l.power)).sum();
        if !local {
            return AliasTable::new(
                &self
                    .lights
                    .iter()
                    .map(|l| f64::from(l.power))
                    .collect::<Vec<_>>(),
            );
        }
        let mut rng = KeyedRng::new(seed ^ 0x11_6475, cell as u64);
        let mut rays = Vec::with_capacity(self.groups.len() * PROBES);
        for group in &self.groups {
            for _ in 0..PROBES {
                let light = &self.lights[group.start + rng.below(group.len())];
                let p = low + Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * edge;
                let [u, v] = square_to_triangle([rng.next_f32(), rng.next_f32()]);
                let d = light.point(u, v) - p;
                rays.push(Ray::new(p, d.normalize_or(Vec3::Y), d.length() * 0.999));
            }
        }
        let mut occluded = vec![0u8; rays.len()];
        tracer.occluded(&rays, &mut occluded);
        let seen: Vec<f64> = occluded
            .chunks(PROBES)
            .map(|o| o.iter().filter(|&&x| x == 0).count() as f64 / PROBES as f64)
            .collect();
        let centre = low + Vec3::splat(0.5 * edge);
        let weights: Vec<f64> = self
            .lights
            .iter()
            .map(|light| {
                let d = centre - light.point(1.0 / 3.0, 1.0 / 3.0);
                // half the cell's diagonal widens every angle and every distance
                let (distance, spread) = (d.length(), 0.87 * edge);
                let facing =
                    light.normal.dot(d / distance.max(1e-9)) + (spread / distance.max(spread));
                let facing = if light.triangle.is_none() {
                    1.0
                } else {
                    facing.clamp(AVERTED, 1.0)
                };
                let seen = seen[light.group as usize] + UNSEEN;
                f64::from(light.power * facing) * seen
                    / f64::from(distance.max(0.5 * spread).powi(2))
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        let mixed: Vec<f64> = weights
            .iter()
            .zip(&self.lights)
            .map(|(w, l)| w / sum + 0.02 * f64::from(l.power) / total)
            .collect();
        AliasTable::new(&mixed)
    }

    /// Whether there is anything to sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tables.is_empty()
    }

    fn table(&self, p: Vec3) -> &AliasTable {
        let c = (p - self.origin) * self.cells_per_metre;
        let [x, y, z] = std::array::from_fn(|k| (c[k].max(0.0) as usize).min(self.counts[k] - 1));
        &self.tables[(z * self.counts[1] + y) * self.counts[0] + x]
    }

    /// Draws a point on a light from `p`; `None` without lights or where the light is seen exactly
    /// edge-on.
    #[must_use]
    pub fn sample(&self, p: Vec3, u: [f32; 2]) -> Option<LightSample> {
        if self.is_empty() {
            return None;
        }
        let table = self.table(p);
        let (i, rest) = table.sample(u[0]);
        let light = &self.lights[i];
        let [b1, b2] = square_to_triangle([rest, u[1]]);
        let d = light.point(b1, b2) - p;
        let distance = d.length();
        let direction = d / distance;
        let cosine = light.normal.dot(direction).abs();
        if !(distance > 0.0 && cosine > 1e-6) {
            return None;
        }
        let pdf = match light.triangle {
            Some(_) => table.pmf(i) * distance * distance / (light.area * cosine),
            // several portals may lie behind one another: the density of the direction is the sum
            None => self.portal_pdf(p, direction, table),
        };
        let hit = light.triangle.map(|t| (t, b1, b2));
        let distance = if hit.is_some() {
            distance
        } else {
            f32::INFINITY
        };
        (pdf > 0.0 && pdf.is_finite()).then_some(LightSample {
            direction,
            distance,
            pdf,
            hit,
        })
    }

    /// Density per steradian with which [`Self::sample`] draws, from `p`, the direction in which
    /// `triangle` was hit.
    #[must_use]
    pub fn triangle_pdf(&self, p: Vec3, direction: Vec3, distance: f32, triangle: u32) -> f32 {
        let i = self.light_of_triangle[triangle as usize];
        if i == NO_LIGHT || self.is_empty() {
            return 0.0;
        }
        let light = &self.lights[i as usize];
        let cosine = light.normal.dot(direction).abs();
        if cosine > 1e-6 {
            self.table(p).pmf(i as usize) * distance * distance / (light.area * cosine)
        } else {
            0.0
        }
    }

    /// Density per steradian with which [`Self::sample`] draws a direction that meets no geometry.
    #[must_use]
    pub fn environment_pdf(&self, p: Vec3, direction: Vec3) -> f32 {
        if self.is_empty() || self.portals.is_empty() {
            0.0
        } else {
            self.portal_pdf(p, direction, self.table(p))
        }
    }

    fn portal_pdf(&self, p: Vec3, direction: Vec3, table: &AliasTable) -> f32 {
        let mut pdf = 0.0;
        for &i in &self.portals {
            let light = &self.lights[i as usize];
            if let Some(t) = light.intersect(p, direction) {
                pdf += table.pmf(i as usize) * t * t
                    / (light.area * light.normal.dot(direction).abs());
            }
        }
        pdf
    }
}

impl Light {
    fn new(c: [Vec3; 3], brightness: f32, triangle: Option<u32>) -> Self {
        let edges = [c[1] - c[0], c[2] - c[0]];
        let n = edges[0].cross(edges[1]);
        let area = 0.5 * n.length();
        Self {
            corner: c[0],
            edges,
            normal: n.normalize_or_zero(),
            area,
            power: brightness * area,
            triangle,
            group: 0,
        }
    }

    fn point(&self, u: f32, v: f32) -> Vec3 {
        self.corner + self.edges[0] * u + self.edges[1] * v
    }

    /// Distance to the triangle along a ray, half-open so that two triangles of a quad share their
    /// diagonal once (up to rounding).
    fn intersect(&self, p: Vec3, d: Vec3) -> Option<f32> {
        let cosine = self.normal.dot(d);
        if cosine.abs() <= 1e-6 {
            return None;
        }
        let t = self.normal.dot(self.corner - p) / cosine;
        if t <= 0.0 {
            return None;
        }
        let q = p + d * t - self.corner;
        let [a, b] = self.edges;
        let (aa, ab, bb, qa, qb) = (a.dot(a), a.dot(b), b.dot(b), q.dot(a), q.dot(b));
        let det = aa * bb - ab * ab;
        let (u, v) = ((bb * qa - ab * qb) / det, (aa * qb - ab * qa) / det);
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then_some(t)
    }
}
