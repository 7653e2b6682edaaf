//! Emitters: which texels emit, and how to sample them from any point of the scene.
//!
//! Light from outside enters through openings. Where rays leave the scene, the patches of its
//! bounding box they cross become portals: area lights through which the environment is seen
//! (Bitterli et al. 2015, "Portal-Masked Environment Map Sampling", in spirit).
//!
//! Emissive triangles are gathered into lamps; space into cells. Every point chooses lamps with
//! probability proportional to the irradiance they are expected to send there ([`LightSampler`]),
//! times what rays found of their visibility from the point's cell, so that lamps in other rooms
//! and behind the surface cost no samples.

use super::light_sampler::{LightSampler, LightShapes, Piece};
use super::portal_grid::PortalGrid;
use super::primitives::{Columns, GRAZING, PORTAL, SHORT, Sources};
use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::core::sampling::{SlotTable, SobolSequence};
use crate::core::trace::{Hit, Ray, Tracer};
use crate::ffi::simd::{floor_to_index, prefetch};
use crate::radiance::LightField;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// At most this many lamps; more are merged with their neighbours in space.
const MAX_LAMPS: usize = 128;
/// Reflecting triangles this many times brighter than the mean are sampled like lamps.
const BRIGHT: f64 = 2.5;
/// At most this many portals.
const MAX_PORTALS: usize = 64;
/// Receivers and rays per receiver that look for openings.
const PORTAL_PROBES: usize = 16_384;
const PORTAL_RAYS: u32 = 32;
/// Cells along the longest side of the scene: about one metre in a flat.
const CELLS_LONGEST: f32 = 20.0;
/// Receivers per cell used to find which lamps reach it.
const PROBES: usize = 32;
/// Share of the expected irradiance that a lamp is believed to send where no ray from it arrived.
const DEFENSIVE: f32 = 0.03;
/// What a neighbouring cell's findings count beside a cell's own.
const NEIGHBOURS: f32 = 0.2;

/// Distance in cells and cosine between normals within which two points ask the same lamps.
const ALIKE: f32 = 0.1;
const ALIKE_NORMALS: f32 = 0.95;

/// A direction towards an emitter.
#[derive(Clone, Copy, Debug)]
pub struct EmitterSample {
    /// Shadow ray: hits nothing if the emitter is visible.
    pub ray: Ray,
    /// Radiance arriving if visible.
    pub radiance: Vec3,
    /// Density per steradian at the receiver.
    pub pdf: f32,
}

/// A group of emissive triangles or of portal cells, sampled by power.
struct Lamp {
    /// Its first entry in [`Emitters::slots`], and how many it has.
    first: u32,
    slots: f32,
}

impl Lamp {
    /// The slot that `u` in [0, 1) stands for.
    #[inline(always)]
    fn slot(&self, u: f32) -> u32 {
        self.first + floor_to_index(u * self.slots, self.slots - 1.0)
    }
}

/// What a lamp is made of.
enum LampKind {
    /// Mesh triangles.
    Triangles(Vec<u32>),
    /// Cells of the bounding box.
    Portal(Vec<u32>),
}

/// Samples emissive triangles and portals.
pub struct Emitters {
    lamps: Vec<Lamp>,
    shapes: LightShapes,
    /// The pieces of all lamps, lamp by lamp.
    sources: Sources,
    /// The pieces again, lamp by lamp, each as often as it is likely.
    slots: Vec<u32>,
    /// Per triangle, and once more for no triangle: lamp and density per m² within the lamp;
    /// density 0 where it is not sampled.
    triangle_slot: Vec<(u32, f32)>,
    /// The same per cell of the hull; empty without portals.
    portal_slot: Vec<(u32, f32)>,
    hull: PortalGrid,
    reach: ReachTable,
    cell_size: f32,
}

impl Emitters {
    /// Gathers the emissive triangles of `field` and the openings to its environment into lamps,
    /// and learns which of them reach the `receivers` (position, normal).
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        field: &LightField,
        tracer: &dyn Tracer,
        receivers: &[(Vec3, Vec3)],
    ) -> Self {
        let (lo, hi) = mesh.bounds();
        let cell_size = ((hi - lo).max_element() / CELLS_LONGEST).max(f32::MIN_POSITIVE);
        let mut out = Self {
            lamps: Vec::new(),
            shapes: LightShapes::default(),
            sources: Sources::default(),
            slots: Vec::new(),
            triangle_slot: vec![(0, 0.0); mesh.triangles.len() + 1],
            portal_slot: Vec::new(),
            hull: PortalGrid::around(lo, hi),
            reach: ReachTable::default(),
            cell_size,
        };
        let small = 0.02 * (hi - lo).length();
        let centre = |t: u32| mesh.position(t as usize, 1.0 / 3.0, 1.0 / 3.0);
        let power: Vec<f64> = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| triangle_power(mesh, field, t))
            .collect();
        for set in bright_sets(mesh, field, &power) {
            let set = uncovered(mesh, field, tracer, set);
            for group in split_into_lamps(&centre, small, MAX_LAMPS, set) {
                let out_of = |t: u32| field.outward_normal(t as usize);
                let item = |t: u32| {
                    let (area, power) = (mesh.area(t as usize), power[t as usize]);
                    (
                        Piece {
                            centre: centre(t),
                            normal: out_of(t),
                            area,
                            power,
                        },
                        area,
                        power,
                    )
                };
                let items = group.iter().map(|&t| item(t)).collect::<Vec<_>>();
                out.add_lamp(mesh, field, LampKind::Triangles(group), &items);
            }
        }
        if !field.environment.is_black() {
            out.add_portals(mesh, field, tracer, receivers);
        }
        out.reach.everywhere = vec![1.0; out.lamps.len()];
        if out.lamps.len() > 1 {
            out.learn_reach(field, tracer, receivers);
        }
        out
    }

    /// Adds a lamp of pieces with their areas and the weights by which they are drawn.
    fn add_lamp(
        &mut self,
        mesh: &Mesh,
        field: &LightField,
        kind: LampKind,
        items: &[(Piece, f32, f64)],
    ) {
        let Some(table) = SlotTable::new(&items.iter().map(|i| i.2).collect::<Vec<_>>()) else {
            return;
        };
        self.shapes
            .push(&items.iter().map(|i| i.0).collect::<Vec<_>>());
        let (lamp, base) = (self.lamps.len() as u32, self.sources.len() as u32);
        if matches!(kind, LampKind::Portal(_)) {
            self.portal_slot.resize(PortalGrid::NUMBERS, (0, 0.0));
        }
        for (i, item) in items.iter().enumerate() {
            let density = table.pmf(i) / item.1;
            match &kind {
                LampKind::Triangles(ids) => {
                    self.triangle_slot[ids[i] as usize] = (lamp, density);
                    self.sources.push_triangle(mesh, field, ids[i], density);
                }
                LampKind::Portal(ids) => {
                    self.portal_slot[ids[i] as usize] = (lamp, density);
                    self.sources.push_portal(&self.hull, ids[i], density);
                }
            }
        }
        let first = self.slots.len() as u32;
        self.slots.extend(table.owners().iter().map(|i| base + i));
        self.lamps.push(Lamp {
            first,
            slots: table.owners().len() as f32,
        });
    }

    /// Finds where rays from the receivers leave the scene and groups those cells of the bounding
    /// box into portals.
    fn add_portals(
        &mut self,
        mesh: &Mesh,
        field: &LightField,
        tracer: &dyn Tracer,
        receivers: &[(Vec3, Vec3)],
    ) {
        let stride = (receivers.len() / PORTAL_PROBES).max(1);
        let probes: Vec<usize> = (0..receivers.len()).step_by(stride).collect();
        let found = crate::core::parallel::map_chunks(probes.len(), 64, |range| {
            let mut rays = Vec::new();
            for k in range {
                let (p, n) = receivers[probes[k]];
                let frame = crate::core::math::Frame::from_normal(n);
                let sequence = SobolSequence::new(0x907_7a1, k as u64);
                for j in 0..PORTAL_RAYS {
                    let d = frame.world_from_local(
                        crate::core::sampling::square_to_cosine_hemisphere(sequence.point2(j)),
                    );
                    rays.push(Ray::new(p + n * (1e-4 * self.cell_size), d, f32::INFINITY));
                }
            }
            let mut hits = vec![crate::core::trace::Hit::miss(); rays.len()];
            tracer.closest(&rays, &mut hits);
            let mut out = Vec::new();
            for (r, h) in rays.iter().zip(&hits) {
                if !h.is_hit() {
                    let d = Vec3::from_array(r.direction);
                    if let Some((cell, _, _)) = self.hull.exit(Vec3::from_array(r.origin), d) {
                        out.push((cell, f64::from(luminance(field.environment.radiance(d)))));
                    }
                }
            }
            out
        });
        let mut light: BTreeMap<u32, f64> = BTreeMap::new();
        let (mut sum, mut crossings) = (0.0, 0.0);
        for (cell, l) in found.into_iter().flatten() {
            *light.entry(cell).or_default() += l;
            (sum, crossings) = (sum + l, crossings + 1.0);
        }
        if light.is_empty() {
            return;
        }
        let radiance = sum / crossings;
        let mean = light.values().sum::<f64>() / light.len() as f64;
        // an opening goes on a little where no probe happened to cross it
        for cell in light.keys().copied().collect::<Vec<_>>() {
            self.hull.around_cell(cell).for_each(|c| {
                light.entry(c).or_default();
            });
        }
        let cells: Vec<u32> = light.keys().copied().collect();
        let small = 0.08 * self.hull.diagonal();
        let hull = self.hull.clone();
        let centre = |c: u32| hull.cell_centre(c);
        for group in split_into_lamps(&centre, small, MAX_PORTALS, cells) {
            // a floor keeps cells that few probes crossed possible; unseen cells stay with the
            // hemisphere rays
            let item = |c: u32| {
                let area = hull.cell_area(c);
                let piece = Piece {
                    centre: centre(c),
                    normal: hull.cell_frame(c)[3],
                    area,
                    power: radiance * f64::from(area),
                };
                (piece, area, light[&c].max(0.2 * mean))
            };
            let items: Vec<_> = group.iter().map(|&c| item(c)).collect();
            self.add_lamp(mesh, field, LampKind::Portal(group), &items);
        }
    }

    /// Learns how much of the expected irradiance of each lamp arrives in each cell.
    fn learn_reach(&mut self, field: &LightField, tracer: &dyn Tracer, receivers: &[(Vec3, Vec3)]) {
        let mut members: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
        for (i, (p, _)) in receivers.iter().enumerate() {
            members.entry(self.cell(*p)).or_default().push(i);
        }
        let lamps = self.lamps.len();
        let nothing = || vec![[0.0f32; 2]; lamps];
        // per lamp: what arrives, what was expected
        let probed: BTreeMap<[i32; 3], Vec<[f32; 2]>> = members
            .par_iter()
            .map(|(cell, ids)| {
                let mut found = nothing();
                let stride = (ids.len() / PROBES).max(1);
                let sequence = SobolSequence::new(
                    0x1a3b,
                    crate::core::sampling::hash_u64(
                        cell[0] as u64,
                        crate::core::sampling::hash_u64(cell[1] as u64, cell[2] as u64),
                    ),
                );
                let (mut rays, mut owners, mut expected) = (Vec::new(), Vec::new(), Vec::new());
                for (probe, &i) in ids.iter().step_by(stride).take(PROBES).enumerate() {
                    let (p, n) = receivers[i];
                    let origin = p + n * (1e-4 * self.cell_size);
                    self.shapes
                        .expected(p, n, &self.reach.everywhere, &mut expected);
                    found.iter_mut().zip(&expected).for_each(|(f, e)| f[1] += e);
                    for (k, lamp) in self.lamps.iter().enumerate() {
                        let u = sequence.point3((probe * lamps + k) as u32);
                        let Some(sample) = self.aim(field, lamp.slot(u[0]), origin, [u[1], u[2]])
                        else {
                            continue;
                        };
                        let cosine = n.dot(Vec3::from_array(sample.ray.direction));
                        if cosine > 0.0 {
                            // at most what was expected: one sample of a lamp nearby says little of
                            // the others
                            let light = (luminance(sample.radiance) * cosine / sample.pdf).max(0.0);
                            rays.push(sample.ray);
                            owners.push((k, light.min(expected[k])));
                        }
                    }
                }
                let mut hidden = vec![0u8; rays.len()];
                tracer.occluded(&rays, &mut hidden);
                for ((k, light), h) in owners.into_iter().zip(hidden) {
                    found[k][0] += if h == 0 { light } else { 0.0 };
                }
                (*cell, found)
            })
            .collect();
        // a few probes may miss a lamp that the cell does see: its neighbours' findings count too
        let learned = probed
            .iter()
            .map(|(cell, own)| {
                let mut sum = own.clone();
                for near in neighbours(*cell).filter_map(|c| probed.get(&c)) {
                    sum.iter_mut()
                        .zip(near)
                        .for_each(|(s, n)| (0..2).for_each(|j| s[j] += NEIGHBOURS * n[j]));
                }
                // of equal light, what arrives in a few places only varies more: the least variance
                // has the root of the share that arrives
                (
                    *cell,
                    sum.iter()
                        .map(|[a, e]| {
                            if *e > 0.0 {
                                DEFENSIVE + (a / e).sqrt()
                            } else {
                                1.0
                            }
                        })
                        .collect(),
                )
            })
            .collect();
        self.reach.set(learned);
    }

    fn cell(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell_size).floor().to_array().map(|x| x as i32)
    }

    /// Whether there is nothing to sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lamps.is_empty()
    }

    /// Number of lamps (groups of emissive triangles).
    #[must_use]
    pub fn lamp_count(&self) -> usize {
        self.lamps.len()
    }

    /// Writes into `choice` which lamps suit a point with a unit normal; pass it to
    /// [`Self::sample`] and [`Self::pdf`]. They are combined with `rays` cosine-distributed rays
    /// per sample, which meet large lamps anyway.
    pub fn choose(&self, p: Vec3, normal: Vec3, rays: f32, choice: &mut LightSampler) {
        choice.set(|weights| {
            self.shapes
                .expected(p, normal, self.reach.at(self.cell(p)), weights);
            if rays > 0.0 {
                self.shapes.rebalance(rays, weights);
            }
        });
    }

    /// Whether two points (position, unit normal) lie so close together that one's choice of lamps
    /// serves the other as well.
    pub(crate) fn alike(&self, [a, b]: [(Vec3, Vec3); 2]) -> bool {
        a.0.distance_squared(b.0) < (ALIKE * self.cell_size).powi(2) && a.1.dot(b.1) > ALIKE_NORMALS
    }

    /// Draws a direction from `origin` towards an emitter; `None` where the drawn point faces away.
    #[must_use]
    #[inline]
    pub fn sample(
        &self,
        field: &LightField,
        choice: &LightSampler,
        origin: Vec3,
        u: [f32; 3],
    ) -> Option<EmitterSample> {
        let (lamp, rest) = choice.sample(u[0]);
        let sample = self.aim(field, self.lamps[lamp].slot(rest), origin, [u[1], u[2]])?;
        Some(EmitterSample {
            pdf: choice.pmf(lamp) * sample.pdf,
            ..sample
        })
    }

    /// A direction to the point of a slot's source that `place` in [0, 1)² stands for, with the
    /// density within its lamp; `None` if the source faces away.
    #[inline]
    fn aim(
        &self,
        field: &LightField,
        slot: u32,
        origin: Vec3,
        place: [f32; 2],
    ) -> Option<EmitterSample> {
        let index = [self.slots[slot as usize]];
        let aims = self.sources.aim(
            field,
            origin,
            &index,
            [&[place[0]], &[place[1]]],
            &mut Columns::default(),
        );
        let (direction, facing) = (
            Vec3::from_array(aims.direction.map(|d| d[0])),
            aims.facing[0],
        );
        (facing > 0.0).then(|| EmitterSample {
            ray: Ray::new(origin, direction, aims.t_far[0]),
            radiance: match aims.address[0] {
                PORTAL => field.environment.radiance(direction),
                address => field.texel(address),
            },
            pdf: aims.density[0] / facing,
        })
    }

    /// Density per steradian with which [`Self::sample`] draws the direction of a ray from `origin`
    /// that ended in `hit`.
    #[must_use]
    #[inline]
    pub fn pdf(
        &self,
        field: &LightField,
        choice: &LightSampler,
        origin: Vec3,
        direction: Vec3,
        hit: &Hit,
    ) -> f32 {
        if choice.is_empty() {
            0.0
        } else if hit.is_hit() {
            let cosine = -field.outward_normal(hit.triangle as usize).dot(direction);
            self.hit_pdf(choice, hit, cosine)
        } else {
            self.miss_pdf(choice, origin, direction)
        }
    }

    /// The pieces of all lamps.
    pub(crate) fn sources(&self) -> &Sources {
        &self.sources
    }

    /// The slot of a source that `u` in [0, 1) stands for, and the probability of its lamp; `first`
    /// is from [`LightSampler::guide`], if at hand. The slot is on its way into the cache.
    #[inline(always)]
    pub(crate) fn pick(&self, choice: &LightSampler, first: Option<u32>, u: f32) -> (u32, f32) {
        let (lamp, rest) = match first {
            Some(first) => choice.sample_in(first, u),
            None => choice.sample(u),
        };
        let slot = self.lamps[lamp].slot(rest);
        prefetch(&self.slots, slot as usize);
        (slot, choice.pmf(lamp))
    }

    /// The number of the source of a slot.
    #[inline(always)]
    pub(crate) fn source_in(&self, slot: u32) -> u32 {
        self.slots[slot as usize]
    }

    /// Tells the cache that [`Self::hit_pdf`] will be asked for a hit on `triangle` soon.
    #[inline(always)]
    pub(crate) fn prefetch_hit(&self, triangle: u32) {
        prefetch(&self.triangle_slot, triangle as usize);
    }

    /// [`Self::pdf`] of a ray that meets a triangle under `cosine`; 0 for a miss.
    #[inline(always)]
    pub(crate) fn hit_pdf(&self, choice: &LightSampler, hit: &Hit, cosine: f32) -> f32 {
        // the last slot is that of no triangle
        let (lamp, density) =
            self.triangle_slot[(hit.triangle as usize).min(self.triangle_slot.len() - 1)];
        let pdf = choice.pmf(lamp as usize) * density * hit.t * hit.t / cosine;
        if density > 0.0 && cosine > GRAZING {
            pdf
        } else {
            0.0
        }
    }

    /// [`Self::pdf`] of a ray that leaves the scene.
    #[inline]
    pub(crate) fn miss_pdf(&self, choice: &LightSampler, origin: Vec3, direction: Vec3) -> f32 {
        if self.portal_slot.is_empty() {
            return 0.0;
        }
        let Some((cell, t, cosine)) = self.hull.exit(origin, direction) else {
            return 0.0;
        };
        let (lamp, density) = self.portal_slot[cell as usize];
        if density > 0.0 {
            choice.pmf(lamp as usize) * density * t * t / cosine
        } else {
            0.0
        }
    }
}

/// Per cell of space and lamp: how much of the expected irradiance arrives; in a dense grid around
/// the cells that hold receivers.
#[derive(Default)]
struct ReachTable {
    base: [i32; 3],
    size: [usize; 3],
    /// One more than the place in `tables`; 0 where nothing was learned.
    index: Vec<u32>,
    tables: Vec<Vec<f32>>,
    /// What holds where nothing was learned.
    everywhere: Vec<f32>,
}

impl ReachTable {
    fn set(&mut self, learned: Vec<([i32; 3], Vec<f32>)>) {
        let bound = |pick: fn(i32, i32) -> i32, a: usize| {
            learned.iter().map(|(c, _)| c[a]).reduce(pick).unwrap_or(0)
        };
        self.base = std::array::from_fn(|a| bound(i32::min, a));
        // receivers lie in the scene's box, which has about CELLS_LONGEST cells a side
        self.size = std::array::from_fn(|a| {
            (bound(i32::max, a).saturating_sub(self.base[a]) as usize + 1).min(256)
        });
        self.index = vec![0; self.size.iter().product()];
        for (cell, table) in learned {
            if let Some(i) = self.slot(cell) {
                self.tables.push(table);
                self.index[i] = self.tables.len() as u32;
            }
        }
    }

    fn slot(&self, cell: [i32; 3]) -> Option<usize> {
        let at: [usize; 3] = std::array::from_fn(|a| {
            i64::from(cell[a]).wrapping_sub(i64::from(self.base[a])) as usize
        });
        (0..3)
            .all(|a| at[a] < self.size[a])
            .then(|| (at[2] * self.size[1] + at[1]) * self.size[0] + at[0])
    }

    fn at(&self, cell: [i32; 3]) -> &[f32] {
        let place = self
            .slot(cell)
            .and_then(|s| self.index.get(s))
            .map_or(0, |i| *i as usize);
        self.tables
            .get(place.wrapping_sub(1))
            .unwrap_or(&self.everywhere)
    }
}

/// The 26 cells around one.
fn neighbours(cell: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (0..27).filter(|i| *i != 13).map(move |i| {
        [
            cell[0] + i % 3 - 1,
            cell[1] + i / 3 % 3 - 1,
            cell[2] + i / 9 - 1,
        ]
    })
}

/// Triangles worth sampling: the emissive ones, and those that reflect much more light than the
/// average surface (a window sill in the sun). Sampling the latter changes no estimate, only its
/// noise.
fn bright_sets(mesh: &Mesh, field: &LightField, power: &[f64]) -> [Vec<u32>; 2] {
    let area: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| f64::from(mesh.area(t)))
        .collect();
    let reflecting = |t: usize| !field.is_emissive(t) && area[t] > 0.0;
    let (sum, total) = (0..area.len())
        .filter(|&t| reflecting(t))
        .fold((0.0, 0.0), |s, t| (s.0 + power[t], s.1 + area[t]));
    let threshold = BRIGHT * sum / f64::max(total, f64::MIN_POSITIVE);
    let emissive = (0..area.len())
        .filter(|&t| field.is_emissive(t) && area[t] > 0.0)
        .map(|t| t as u32)
        .collect();
    let bright = (0..area.len())
        .filter(|&t| reflecting(t) && power[t] > threshold * area[t])
        .map(|t| t as u32)
        .collect();
    [emissive, bright]
}

/// The triangles that can be seen from right above somewhere. A shadow ray ends so close to its
/// source that it may overlook what covers that: a hidden twin of a lamp would shine through it.
/// Hemisphere rays meet whatever is dropped here and visible after all.
fn uncovered(
    mesh: &Mesh,
    field: &LightField,
    tracer: &dyn Tracer,
    triangles: Vec<u32>,
) -> Vec<u32> {
    const PLACES: [(f32, f32); 4] = [
        (1.0 / 3.0, 1.0 / 3.0),
        (0.7, 0.15),
        (0.15, 0.7),
        (0.15, 0.15),
    ];
    let (lo, hi) = mesh.bounds();
    let above = 0.5 * SHORT * (hi - lo).length();
    let rays: Vec<Ray> = triangles
        .iter()
        .flat_map(|&t| {
            let normal = field.outward_normal(t as usize);
            PLACES.map(|(u, v)| {
                Ray::new(
                    mesh.position(t as usize, u, v) + normal * above,
                    -normal,
                    2.0 * above,
                )
            })
        })
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let seen = |i: usize| {
        hits[PLACES.len() * i..][..PLACES.len()]
            .iter()
            .any(|h| h.triangle == triangles[i])
    };
    (0..triangles.len())
        .filter(|&i| seen(i))
        .map(|i| triangles[i])
        .collect()
}

/// Luminance × area, from a few points; a floor keeps dim corners possible.
fn triangle_power(mesh: &Mesh, field: &LightField, t: usize) -> f64 {
    const POINTS: [(f32, f32); 4] = [(1.0 / 3.0, 1.0 / 3.0), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)];
    let lum: Vec<f32> = POINTS
        .iter()
        .map(|&(u, v)| luminance(field.emitted(t, u, v)).max(0.0))
        .collect();
    let peak = lum.iter().copied().fold(0.0, f32::max);
    f64::from((lum.iter().sum::<f32>() / 4.0).max(0.1 * peak)) * f64::from(mesh.area(t))
}

/// Splits items into at most `most` compact groups by cutting the largest group at its widest gap
/// until groups are smaller than `small`.
fn split_into_lamps(
    centre: &dyn Fn(u32) -> Vec3,
    small: f32,
    most: usize,
    items: Vec<u32>,
) -> Vec<Vec<u32>> {
    let mut groups = if items.is_empty() {
        vec![]
    } else {
        vec![items]
    };
    loop {
        let extent = |g: &Vec<u32>| {
            let b = g
                .iter()
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, &t| {
                    (b.0.min(centre(t)), b.1.max(centre(t)))
                });
            b.1 - b.0
        };
        let largest = groups
            .iter()
            .enumerate()
            .filter(|(_, g)| g.len() > 1)
            .map(|(i, g)| (i, extent(g)))
            .max_by(|a, b| a.1.max_element().total_cmp(&b.1.max_element()));
        let Some((i, e)) = largest else { break };
        if e.max_element() < small || groups.len() >= most {
            break;
        }
        let axis = if e.x >= e.y && e.x >= e.z {
            0
        } else if e.y >= e.z {
            1
        } else {
            2
        };
        let mut g = std::mem::take(&mut groups[i]);
        g.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
        // cut at the widest gap, so that separate lamps stay whole
        let cut = (1..g.len())
            .max_by(|&a, &b| {
                let gap = |k: usize| centre(g[k])[axis] - centre(g[k - 1])[axis];
                gap(a)
                    .total_cmp(&gap(b))
                    .then(b.abs_diff(g.len() / 2).cmp(&a.abs_diff(g.len() / 2)))
            })
            .unwrap_or(1);
        let tail = g.split_off(cut);
        groups[i] = g;
        groups.push(tail);
    }
    groups
}

impl Emitters {
    /// Centres and powers of the lamps, for reports.
    #[must_use]
    pub fn lamps(&self) -> Vec<(Vec3, f64)> {
        self.shapes.centres_and_powers().collect()
    }
}
