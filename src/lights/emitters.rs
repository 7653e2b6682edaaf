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

use super::grouping::{MAX_LAMPS, bright_sets, split_into_lamps, uncovered};
use super::light_model::LightModel;
use super::light_sampler::{LightSampler, LightShapes, Piece};
use super::portal_grid::PortalGrid;
use super::portals::{self, find_exits};
use super::primitives::{Columns, GRAZING, PORTAL, SHORT, Sources};
use super::reach::{Found, ReachTable};
use crate::core::geometry::{Mesh, SMOOTH};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::sampling::{SlotTable, SobolSequence, hash_u64, square_to_triangle};
use crate::core::stats::ENOUGH;
use crate::core::trace::{Hit, Ray, Tracer};
use crate::ffi::simd::{floor_to_index, prefetch};
use crate::radiance::LightField;
use glam::Vec3;
use std::collections::BTreeMap;

/// Cells along the longest side of the scene: about one metre in a flat.
/// Measured: ×½ roughness +0.8 dB, ×2 albedo +0.2 dB (docs/constants.md).
const CELLS_LONGEST: f32 = 20.0;
/// Distance in cells within which two points of one smooth surface ask the same lamps.
/// Measured: ×½ albedo within two errors +9 %, ×2 roughness within two errors +14 % (docs/constants.md).
const ALIKE: f32 = 0.1;

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

/// A piece of a lamp, as [`Sources`] numbers it.
#[derive(Clone, Copy)]
struct LampPiece {
    /// Mesh triangle or cell of the hull.
    id: u32,
    /// Its first slot within its lamp, and how many it has.
    first: f32,
    slots: f32,
}

/// A point on a lamp or in an opening, as seen from another point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightPoint {
    /// Unit direction towards it.
    pub direction: Vec3,
    /// Metres; infinite for an opening, behind which the environment lies.
    pub distance: f32,
    /// Density per steradian.
    pub pdf: f32,
    /// Triangle and barycentrics; `None` for an opening.
    pub place: Option<(u32, f32, f32)>,
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
    pieces: Vec<LampPiece>,
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
    /// Gathers the emissive triangles of a scene and the openings to its environment into lamps,
    /// and learns which of them reach the `receivers` (position, unit normal).
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        model: &dyn LightModel,
        tracer: &dyn Tracer,
        receivers: &[(Vec3, Vec3)],
    ) -> Self {
        let (lo, hi) = mesh.bounds();
        let cell_size = ((hi - lo).max_element() / CELLS_LONGEST).max(f32::MIN_POSITIVE);
        let mut out = Self {
            lamps: Vec::new(),
            shapes: LightShapes::default(),
            sources: Sources::default(),
            pieces: Vec::new(),
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
            .map(|t| model.power(mesh, t))
            .collect();
        for set in bright_sets(mesh, model, &power) {
            let set = uncovered(mesh, model, tracer, set);
            for group in split_into_lamps(&centre, small, MAX_LAMPS, set) {
                let out_of = |t: u32| model.outward_normal(t as usize);
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
                out.add_lamp(mesh, model, LampKind::Triangles(group), &items);
            }
        }
        if !model.is_dark_outside() {
            out.add_portals(mesh, model, tracer, receivers);
        }
        out.reach = ReachTable::unknown(out.lamps.len());
        if out.lamps.len() > 1 {
            out.learn_reach(mesh, model, tracer, receivers);
        }
        out
    }

    /// Adds a lamp of pieces with their areas and the weights by which they are drawn.
    fn add_lamp(
        &mut self,
        mesh: &Mesh,
        model: &dyn LightModel,
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
            self.portal_slot.resize(PortalGrid::numbers(), (0, 0.0));
        }
        for (i, item) in items.iter().enumerate() {
            let density = table.pmf(i) / item.1;
            let id = match &kind {
                LampKind::Triangles(ids) => {
                    self.triangle_slot[ids[i] as usize] = (lamp, density);
                    self.sources.push_triangle(mesh, model, ids[i], density);
                    ids[i]
                }
                LampKind::Portal(ids) => {
                    self.portal_slot[ids[i] as usize] = (lamp, density);
                    self.sources.push_portal(&self.hull, ids[i], density);
                    ids[i]
                }
            };
            let [first, slots] = table.share(i);
            self.pieces.push(LampPiece { id, first, slots });
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
        model: &dyn LightModel,
        tracer: &dyn Tracer,
        receivers: &[(Vec3, Vec3)],
    ) {
        let stride = (receivers.len() / portals::PROBES).max(1);
        let probes: Vec<(Vec3, Vec3)> = receivers.iter().copied().step_by(stride).collect();
        let mut light: BTreeMap<u32, f64> = BTreeMap::new();
        let (mut sum, mut crossings) = (0.0, 0.0);
        for exit in find_exits(&self.hull, tracer, &probes) {
            let l = f64::from(luminance(model.environment(exit.direction)));
            *light.entry(exit.cell).or_default() += l;
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
        for group in split_into_lamps(&centre, small, MAX_LAMPS, cells) {
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
            self.add_lamp(mesh, model, LampKind::Portal(group), &items);
        }
    }

    /// Learns how much of the expected irradiance of each lamp arrives in each cell.
    fn learn_reach(
        &mut self,
        mesh: &Mesh,
        model: &dyn LightModel,
        tracer: &dyn Tracer,
        receivers: &[(Vec3, Vec3)],
    ) {
        let mut members: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
        for (i, (p, _)) in receivers.iter().enumerate() {
            members.entry(self.cell(*p)).or_default().push(i);
        }
        let cells: Vec<(&[i32; 3], &Vec<usize>)> = members.iter().collect();
        let probed = cells
            .into_par_iter()
            .map(|(cell, ids)| {
                let stride = (ids.len() / ENOUGH).max(1);
                let probes = ids.iter().step_by(stride).take(ENOUGH);
                let probes: Vec<_> = probes.map(|&i| receivers[i]).collect();
                let key = hash_u64(cell[1] as u64, cell[2] as u64);
                let sequence = SobolSequence::new(0x1a3b, hash_u64(cell[0] as u64, key));
                (*cell, self.probe(mesh, model, tracer, &probes, &sequence))
            })
            .collect();
        self.reach.learn(&probed);
    }

    /// What receivers close to each other find of each lamp.
    fn probe(
        &self,
        mesh: &Mesh,
        model: &dyn LightModel,
        tracer: &dyn Tracer,
        probes: &[(Vec3, Vec3)],
        sequence: &SobolSequence,
    ) -> Vec<Found> {
        let lamps = self.lamps.len();
        let everywhere = vec![1.0; lamps];
        let mut found = vec![Found::default(); lamps];
        let (mut rays, mut owners, mut expected) = (Vec::new(), Vec::new(), Vec::new());
        for (probe, &(p, n)) in probes.iter().enumerate() {
            let origin = p + n * (1e-4 * self.cell_size);
            self.shapes.expected(p, n, &everywhere, &mut expected);
            for (f, e) in found.iter_mut().zip(&expected) {
                f.expected += e;
            }
            for (k, lamp) in self.lamps.iter().enumerate() {
                let u = sequence.point3((probe * lamps + k) as u32);
                let source = self.slots[lamp.slot(u[0]) as usize];
                let Some(point) = self.point(mesh, model, source, origin, [u[1], u[2]]) else {
                    continue;
                };
                let cosine = n.dot(point.direction);
                if cosine > 0.0 {
                    let radiance = match point.place {
                        Some((t, u, v)) => model.radiance(t as usize, u, v),
                        None => model.environment(point.direction),
                    };
                    // at most what was expected: one sample of a lamp nearby says little of the
                    // others
                    let light = (luminance(radiance) * cosine / point.pdf).max(0.0);
                    let t_far = point.distance * (1.0 - SHORT);
                    rays.push(Ray::new(origin, point.direction, t_far));
                    owners.push((k, light.min(expected[k])));
                }
            }
        }
        let mut hidden = vec![0u8; rays.len()];
        tracer.occluded(&rays, &mut hidden);
        for ((k, light), h) in owners.into_iter().zip(hidden) {
            found[k].arrives += if h == 0 { light } else { 0.0 };
        }
        found
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
        a.0.distance_squared(b.0) < (ALIKE * self.cell_size).powi(2) && a.1.dot(b.1) > SMOOTH
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

    /// The point of a source that `u` in [0, 1)² stands for, as seen from `from`, with the density
    /// within its lamp; `None` if it faces away or is seen edge-on.
    fn point(
        &self,
        mesh: &Mesh,
        model: &dyn LightModel,
        source: u32,
        from: Vec3,
        u: [f32; 2],
    ) -> Option<LightPoint> {
        let id = self.pieces[source as usize].id;
        let (place, position, normal, density) = if self.sources.is_portal(source) {
            let position = self.hull.cell_point(id, u);
            let normal = self.hull.cell_frame(id)[3];
            (None, position, normal, self.portal_slot[id as usize].1)
        } else {
            let (mut at, t) = (square_to_triangle(u), id as usize);
            let normal = model.outward_normal(t);
            // the same point however the triangle is wound
            if mesh.face_normal(t).dot(normal) < 0.0 {
                at.reverse();
            }
            let density = self.triangle_slot[t].1;
            let position = mesh.position(t, at[0], at[1]);
            (Some((id, at[0], at[1])), position, normal, density)
        };
        let to = position - from;
        let distance = to.length();
        let direction = to / distance;
        let cosine = match place {
            Some((t, _, _)) if normal == Vec3::ZERO => {
                mesh.face_normal(t as usize).dot(direction).abs()
            }
            _ => -normal.dot(direction),
        };
        let pdf = density * distance * distance / cosine;
        (cosine > GRAZING && pdf > 0.0 && pdf.is_finite()).then_some(LightPoint {
            direction,
            distance: place.map_or(f32::INFINITY, |_| distance),
            pdf,
            place,
        })
    }

    /// Draws a point on a lamp or in an opening from two numbers, which keep their stratification;
    /// `None` where the drawn point faces away from `from`.
    pub(crate) fn sample_point(
        &self,
        mesh: &Mesh,
        model: &dyn LightModel,
        choice: &LightSampler,
        from: Vec3,
        u: [f32; 2],
    ) -> Option<LightPoint> {
        let (lamp, rest) = choice.sample(u[0]);
        let source = self.slots[self.lamps[lamp].slot(rest) as usize];
        let piece = &self.pieces[source as usize];
        let within = (rest * self.lamps[lamp].slots - piece.first) / piece.slots;
        let within = within.clamp(0.0, 1.0 - f32::EPSILON);
        let point = self.point(mesh, model, source, from, [within, u[1]])?;
        Some(LightPoint {
            pdf: choice.pmf(lamp) * point.pdf,
            ..point
        })
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

impl Emitters {
    /// Centres and powers of the lamps, for reports.
    #[must_use]
    pub fn lamps(&self) -> Vec<(Vec3, f64)> {
        self.shapes.centres_and_powers().collect()
    }
}
