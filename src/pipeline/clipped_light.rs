//! Light beyond the sensor's ceiling, restored before anything is reconstructed from it.
//!
//! Texels that every view shows at its ceiling are lower bounds. Those of classes that emit, the
//! clipped sky, and clipped surfaces brighter than their class can be under the light there are
//! gathered into groups; the irradiance of each on all surfaces is baked once, and the shape of the
//! shading tells their radiance ([`fit_clipped`]). Other clipped surfaces send out what their class
//! reflects of the light then known. Afterwards the fused radiance, the sky in the photographs and
//! the masks are such as an unclipped camera would have left them, and all later stages are the
//! same. Nothing happens where no pixel is clipped.

use super::clipped_looks::{ClippedLooks, Restored, SECTORS, sector};
use super::clipped_texels::ClippedTexels;
use super::known_lights::known_lights;
use super::light::light_field;
use super::light_basis::{Sources, bake, light_of};
use super::texel_radiance::{KnownFaces, first_radiance, texture_of, trusted_radiance};
use super::{SolveOptions, Switch};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::median;
use crate::core::texture::Texels;
use crate::inverse::{ClippedFit, LightGroup, ShadingRow, fit_clipped};
use crate::irradiance::IrradianceOptions;
use crate::lights::Emitters;
use crate::observed::Surface;
use crate::radiance::{Environment, LightField};
use crate::scene::Class;
use crate::verdict::MissingLight;
use glam::Vec3;
use std::collections::BTreeMap;
use std::f32::consts::FRAC_1_PI;

/// Side of the texture on which the light of a group is baked.
const SIDE: usize = 256;
/// Rays and light samples per texel of it: the fit averages over thousands of texels.
const RAYS: u32 = 48;
const LIGHT_SAMPLES: u32 = 32;
/// Pieces of surface that enter the fit.
const ROWS: usize = 50_000;
/// Groups on surfaces at most; the weakest are joined.
const MOST_GROUPS: usize = 24;
/// A clipped surface this much brighter than its class would be there is a light.
const BRIGHTER: f32 = 1.6;
/// A light sends at least this share of what all clipped surfaces send at their ceilings; one that
/// faces down less: the sun's patches, which make up most of that, fall on nothing that does.
const LEAST_POWER: f32 = 0.01;
const LEAST_POWER_DOWN: f32 = 0.0005;
/// Fits, with what follows from each for clipped surfaces that reflect.
const ROUNDS: usize = 3;

/// What is known of a clipped light.
struct Group {
    /// Texels, ascending; empty for sky.
    texels: Vec<u32>,
    /// Sector of the sky.
    sector: Option<usize>,
    fit: LightGroup,
    /// Irradiance per unit radiance, per coarse texel.
    basis: Vec<f32>,
}

/// The kinds of groups.
const LAMP: usize = 0;
const SKY: usize = 1;
const FOUND: usize = 2;
const WINDOW: usize = 3;

/// Lights beyond the ceiling.
pub(super) struct ClippedLights {
    /// The light that the photographs lack.
    pub(super) missing: MissingLight,
    /// Every group on surfaces.
    pub(super) lights: Vec<FoundLight>,
}

/// A group of texels that send out more than the photographs show.
pub(super) struct FoundLight {
    /// Its texels, ascending.
    pub(super) texels: Vec<u32>,
    /// Standard error of ln radiance.
    pub(super) log_error: f32,
    /// It emits: a lamp or a window; else it may be a surface that the sun shines on.
    pub(super) emits: bool,
}

/// Restores the clipped light of `surface`; `None` if nothing is clipped.
pub(super) fn restore_clipped_light(
    surface: &mut Surface,
    options: &SolveOptions,
    progress: &Progress,
) -> Option<ClippedLights> {
    if options.clipped_light == Switch::Off || surface.ceilings.iter().all(Option::is_none) {
        return None;
    }
    progress.stage("clipped light", ROUNDS as u64, |p| {
        let clipped = ClippedTexels::find(surface, options);
        let mut restorer = Restorer::new(surface, &clipped, options);
        let mut fit = ClippedFit::default();
        for round in 0..ROUNDS {
            fit = restorer.round(round);
            p.advance(1);
        }
        let found = restorer.summary(&fit);
        restorer.report(&fit, p);
        p.note(format!(
            "{} groups of clipped lights; the photographs lack {:.0} ± {:.0} % of the light",
            restorer.groups.len(),
            100.0 * found.share,
            100.0 * found.standard_error
        ));
        let lights = restorer.lights(&fit);
        let looks = ClippedLooks {
            texels: restorer.restored(&fit),
            sky: restorer.sky_radiance(&fit),
            reflected: restorer.reflected_radiance(&fit),
        };
        looks.apply(surface);
        Some(ClippedLights {
            missing: found,
            lights,
        })
    })
}

/// Unit direction of pixel `i` of an environment map.
fn map_direction(map: &RgbPlane, i: usize) -> Vec3 {
    let (x, y) = ((i % map.width) as f32 + 0.5, (i / map.width) as f32 + 0.5);
    let longitude = std::f32::consts::TAU * (x / map.width as f32 - 0.5);
    let colatitude = std::f32::consts::PI * y / map.height as f32;
    Vec3::new(
        longitude.sin() * colatitude.sin(),
        colatitude.cos(),
        -longitude.cos() * colatitude.sin(),
    )
}

struct Restorer<'s, 'a> {
    surface: &'s Surface<'a>,
    clipped: &'s ClippedTexels,
    options: &'s SolveOptions,
    known: KnownFaces,
    environment: Environment,
    coarse: Texels,
    groups: Vec<Group>,
    /// Clusters of clipped texels that may be lights: their texels.
    doubtful: Vec<Vec<u32>>,
    /// Class of each texel as an index, and the number of classes.
    class: Vec<u16>,
    classes: usize,
    /// Radiance sent by every texel, clipped ones at their ceiling or what their class reflects.
    sent: Vec<Vec3>,
    /// Irradiance of the last round, before and after the groups' excess, per coarse texel.
    base: Vec<Vec3>,
    total: Vec<Vec3>,
}

impl<'s, 'a> Restorer<'s, 'a> {
    fn new(
        surface: &'s Surface<'a>,
        clipped: &'s ClippedTexels,
        options: &'s SolveOptions,
    ) -> Self {
        let known = known_lights(surface, options);
        let mut ids: Vec<u16> = surface.labels.clone();
        ids.sort_unstable();
        ids.dedup();
        let class = surface
            .labels
            .iter()
            .map(|l| ids.binary_search(l).unwrap_or(0) as u16)
            .collect();
        let environment = if options.environment == Switch::Off {
            Environment::black()
        } else {
            Environment::observe(&surface.views)
        };
        let mut out = Self {
            surface,
            clipped,
            options,
            sent: trusted_radiance(surface, &known),
            known: KnownFaces {
                lamps: known,
                dark: Vec::new(),
            },
            environment,
            coarse: Texels::rasterize(&surface.scene.mesh, SIDE, SIDE),
            groups: Vec::new(),
            doubtful: Vec::new(),
            class,
            classes: ids.len(),
            base: Vec::new(),
            total: Vec::new(),
        };
        for (i, sent) in out.sent.iter_mut().enumerate() {
            if clipped.bits[i] != 0 {
                *sent = surface.fusion.peak[i];
            }
        }
        out.gather_lights();
        out
    }

    fn is_light_class(&self, i: usize) -> bool {
        self.known.lamps[self.surface.texels.point[i].triangle as usize]
    }

    fn area(&self, i: usize) -> f32 {
        self.surface.texels.area(&self.surface.scene.mesh, i)
    }

    /// Power of texels at their ceiling, up to a constant.
    fn power(&self, texels: &[u32]) -> f32 {
        texels
            .iter()
            .map(|&i| self.area(i as usize) * luminance(self.surface.fusion.peak[i as usize]))
            .sum()
    }

    /// The lights that classes and the sky tell of, and clusters that may be lights.
    fn gather_lights(&mut self) {
        let is_window = self.windows();
        let at: Vec<u32> = (0..self.clipped.bits.len() as u32)
            .filter(|&i| self.clipped.bits[i as usize] != 0 && !is_window[i as usize])
            .collect();
        let (lamps, others): (Vec<u32>, Vec<u32>) = at
            .into_iter()
            .partition(|&i| self.is_light_class(i as usize));
        let all = self.power(&lamps) + self.power(&others);
        let mut lamps = self.surface.clusters(&lamps);
        lamps.sort_by(|a, b| self.power(b).total_cmp(&self.power(a)));
        while lamps.len() > MOST_GROUPS {
            let weakest = lamps.pop().unwrap_or_default();
            if let Some(last) = lamps.last_mut() {
                last.extend(weakest);
                last.sort_unstable();
            }
        }
        for texels in lamps {
            let group = self.surface_group(texels, LAMP);
            self.groups.push(group);
        }
        let windows: Vec<u32> = (0..is_window.len() as u32)
            .filter(|&i| is_window[i as usize])
            .collect();
        for texels in self.surface.clusters(&windows) {
            let group = self.window_group(texels);
            self.groups.push(group);
        }
        let mut doubtful = self.surface.clusters(&others);
        let least = |c: &[u32]| {
            if self.surface.faces_down(c) {
                LEAST_POWER_DOWN
            } else {
                LEAST_POWER
            }
        };
        doubtful.retain(|c| self.power(c) > least(c) * all);
        doubtful.sort_by(|a, b| self.power(b).total_cmp(&self.power(a)));
        self.doubtful = doubtful;
        if self.clipped.has_sky {
            for s in 0..SECTORS {
                self.add_sky(s);
            }
        }
    }

    /// Seen texels of windows that no class of light holds: photographs of an ordinary camera show
    /// what is behind them darker than it is, clipped or not.
    fn windows(&self) -> Vec<bool> {
        let mut windows = self.surface.texels_of(Class::is_window);
        for (i, window) in windows.iter_mut().enumerate() {
            *window &= self.surface.fusion.views[i] > 0 && !self.is_light_class(i);
        }
        windows
    }

    /// A window: what it sends in every channel is a lower bound.
    fn window_group(&self, texels: Vec<u32>) -> Group {
        let mut group = self.surface_group(texels, WINDOW);
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for &i in &group.texels {
            sum += self.sent[i as usize] * self.area(i as usize);
            total += self.area(i as usize);
        }
        group.fit.ceiling = sum / total.max(f32::MIN_POSITIVE);
        group.fit.free = [true; 3];
        group
    }

    fn surface_group(&self, texels: Vec<u32>, kind: usize) -> Group {
        let (mut sum, mut total, mut at) = (Vec3::ZERO, 0.0, [0.0f32; 3]);
        for &i in &texels {
            let area = self.area(i as usize);
            sum += self.surface.fusion.peak[i as usize] * area;
            total += area;
            for (c, at) in at.iter_mut().enumerate() {
                *at += area * f32::from((self.clipped.bits[i as usize] >> c) & 1);
            }
        }
        Group {
            texels,
            sector: None,
            fit: LightGroup {
                kind,
                ceiling: sum / total.max(f32::MIN_POSITIVE),
                free: at.map(|a| a > 0.5 * total),
            },
            basis: Vec::new(),
        }
    }

    fn add_sky(&mut self, s: usize) {
        let map = self.environment.map();
        let marks = &self.clipped.sky;
        let (mut sum, mut count, mut at) = (Vec3::ZERO, 0.0f32, Vec3::ZERO);
        for (i, m) in marks.data.iter().enumerate() {
            if m.max_element() > 0.5 && sector(map_direction(marks, i)) == s {
                sum += map.data[i];
                at += *m;
                count += 1.0;
            }
        }
        if count > 0.0 {
            self.groups.push(Group {
                texels: Vec::new(),
                sector: Some(s),
                fit: LightGroup {
                    kind: SKY,
                    ceiling: sum / count,
                    free: (at / count).to_array().map(|a| a > 0.5),
                },
                basis: Vec::new(),
            });
        }
    }

    fn irt_options(&self) -> IrradianceOptions {
        IrradianceOptions {
            rays: RAYS,
            emitter_samples: LIGHT_SAMPLES,
            seed: self.options.seed ^ 0xc11b,
            ..IrradianceOptions::default()
        }
    }

    fn irradiance(&self, field: &LightField, emitters: &Emitters) -> Vec<Vec3> {
        let lit = self.surface.lit(field, emitters);
        let (coarse, options) = (&self.coarse, self.irt_options());
        bake(self.surface, lit, coarse, &options, &Progress::silent()).value
    }

    /// Bakes the groups that have no basis yet, three at a time: one per channel.
    fn bake_groups(&mut self) {
        let new: Vec<usize> = (0..self.groups.len())
            .filter(|&k| self.groups[k].basis.is_empty())
            .collect();
        for three in new.chunks(3) {
            let light = self.basis_of(three);
            for (c, &k) in three.iter().enumerate() {
                self.groups[k].basis = light.iter().map(|e| e[c]).collect();
            }
        }
    }

    /// Irradiance of up to three groups of unit radiance, in a channel each.
    fn basis_of(&self, groups: &[usize]) -> Vec<Vec3> {
        let mut sent = vec![Vec3::ZERO; self.surface.texels.len()];
        let mut sky = self.clipped.sky.map(|_| Vec3::ZERO);
        for (c, &k) in groups.iter().enumerate() {
            for &i in &self.groups[k].texels {
                sent[i as usize][c] = 1.0;
            }
            if let Some(s) = self.groups[k].sector {
                for (i, m) in self.clipped.sky.data.iter().enumerate() {
                    if sector(map_direction(&sky, i)) == s {
                        sky.data[i][c] = m.max_element();
                    }
                }
            }
        }
        let environment = if sky.data.iter().all(|v| *v == Vec3::ZERO) {
            Environment::black()
        } else {
            Environment::from_map(sky)
        };
        let sources = Sources { sent, environment };
        light_of(self.surface, sources, &self.coarse, &self.irt_options())
    }

    /// One fit with what follows from it.
    fn round(&mut self, round: usize) -> ClippedFit {
        self.bake_groups();
        let radiance = if round == 0 {
            first_radiance(self.surface, &self.sent, &self.known)
        } else {
            texture_of(&self.surface.texels, &self.sent)
        };
        let (field, emitters) = light_field(
            self.surface,
            &radiance,
            &self.emitting(),
            self.environment.clone(),
            &self.coarse,
            self.options,
        );
        self.base = self.irradiance(&field, &emitters);
        let rows = self.rows();
        let groups: Vec<LightGroup> = self.groups.iter().map(|g| g.fit).collect();
        let fit = fit_clipped(&rows, &groups, self.classes);
        self.total = (0..self.coarse.len())
            .map(|i| {
                (self.groups.iter().zip(&fit.excess))
                    .fold(self.base[i], |sum, (g, e)| sum + *e * g.basis[i])
            })
            .collect();
        self.predict(&fit);
        if round + 1 < ROUNDS {
            self.decide(&fit);
        }
        fit
    }

    fn emitting(&self) -> Vec<bool> {
        let mut emitting = self.known.lamps.clone();
        for g in self.groups.iter().filter(|g| g.fit.kind >= FOUND) {
            for &i in &g.texels {
                emitting[self.surface.texels.point[i as usize].triangle as usize] = true;
            }
        }
        emitting
    }

    /// Which group each texel belongs to.
    fn group_of(&self) -> Vec<Option<u32>> {
        let mut of = vec![None; self.surface.texels.len()];
        for (k, g) in self.groups.iter().enumerate() {
            g.texels
                .iter()
                .for_each(|&i| of[i as usize] = Some(k as u32));
        }
        of
    }

    /// Pieces of surface with their light, evenly drawn.
    fn rows(&self) -> Vec<ShadingRow> {
        let (surface, mesh) = (self.surface, &self.surface.scene.mesh);
        let base = texture_of(&self.coarse, &self.base);
        let bases: Vec<RgbPlane> = self.groups.chunks(3).map(|g| self.packed(g)).collect();
        let light = self.group_of();
        let useful: Vec<usize> = (0..surface.texels.len())
            .filter(|&i| {
                surface.fusion.views[i] > 0
                    && surface.texels.interior[i]
                    && !self.is_light_class(i)
                    && light[i].is_none()
                    && (surface.fusion.clean[i] || self.clipped.bits[i] != 0)
                    && (surface.labels[i] != 0 || self.classes == 1)
            })
            .collect();
        let stride = useful.len().div_ceil(ROWS).max(1);
        useful
            .par_iter()
            .step_by(stride)
            .map(|&i| ShadingRow {
                class: usize::from(self.class[i]),
                weight: self.area(i),
                position: surface.texels.position(mesh, i),
                radiance: if self.clipped.bits[i] != 0 {
                    surface.fusion.peak[i]
                } else {
                    surface.fusion.radiance[i]
                },
                is_bound: self.clipped.bits[i] != 0,
                base: surface.texels.lookup(mesh, &base, i),
                basis: (0..self.groups.len())
                    .map(|k| surface.texels.lookup(mesh, &bases[k / 3], i)[k % 3])
                    .collect(),
            })
            .filter(|r| r.radiance.min_element() > 0.0 && r.base.min_element() > 0.0)
            .collect()
    }

    /// Bases of up to three groups as a texture.
    fn packed(&self, groups: &[Group]) -> RgbPlane {
        let at = |i: usize| {
            Vec3::from_array(std::array::from_fn(|c| {
                groups.get(c).map_or(0.0, |g| g.basis[i])
            }))
        };
        let values: Vec<Vec3> = (0..self.coarse.len()).map(at).collect();
        texture_of(&self.coarse, &values)
    }

    /// What a texel's class reflects of the light there, if that is known.
    fn reflected(&self, fit: &ClippedFit, total: &RgbPlane, i: usize) -> Option<Vec3> {
        let albedo = fit.albedo[usize::from(self.class[i])];
        let e = self
            .surface
            .texels
            .lookup(&self.surface.scene.mesh, total, i);
        (albedo != Vec3::ZERO).then(|| e * albedo.min(Vec3::ONE) * FRAC_1_PI)
    }

    /// Sets what unseen and clipped reflecting texels send out.
    fn predict(&mut self, fit: &ClippedFit) {
        let total = texture_of(&self.coarse, &self.total);
        let light = self.group_of();
        let f = &self.surface.fusion;
        let predicted: Vec<Option<Vec3>> = (0..self.sent.len())
            .into_par_iter()
            .map(|i| {
                if light[i].is_some() || self.is_light_class(i) {
                    return None;
                }
                let reflected = || self.reflected(fit, &total, i);
                if self.clipped.bits[i] != 0 {
                    return reflected().map(|r| r.max(f.peak[i]));
                }
                (!f.clean[i]).then(reflected).flatten()
            })
            .collect();
        for (sent, predicted) in self.sent.iter_mut().zip(predicted) {
            *sent = predicted.unwrap_or(*sent);
        }
    }

    /// Which doubtful clusters are lights, given what is known now.
    fn decide(&mut self, fit: &ClippedFit) {
        let total = texture_of(&self.coarse, &self.total);
        let excess_of = |texel: u32| {
            self.groups
                .iter()
                .zip(&fit.excess)
                .find(|(g, _)| g.texels.binary_search(&texel).is_ok())
                .map_or(Vec3::ZERO, |(_, e)| *e)
        };
        let is_light = |cluster: &Vec<u32>| {
            let excess = cluster.first().map_or(Vec3::ZERO, |&i| excess_of(i));
            let stride = cluster.len().div_ceil(512).max(1);
            let ratios: Vec<f32> = cluster
                .iter()
                .step_by(stride)
                .filter_map(|&i| {
                    let i = i as usize;
                    let reflected = luminance(self.reflected(fit, &total, i)?);
                    Some(luminance(self.surface.fusion.peak[i] + excess) / reflected)
                })
                .collect();
            median(ratios).is_none_or(|r| r > BRIGHTER)
        };
        let lights: Vec<Vec<u32>> = (self.doubtful.iter().filter(|c| is_light(c)))
            .cloned()
            .collect();
        let mut kept: Vec<Group> = std::mem::take(&mut self.groups);
        let (found, mut kept): (Vec<Group>, Vec<Group>) =
            kept.drain(..).partition(|g| g.fit.kind == FOUND);
        let mut found: BTreeMap<u32, Group> = found.into_iter().map(|g| (g.texels[0], g)).collect();
        for texels in lights.into_iter().take(MOST_GROUPS) {
            let group = found
                .remove(&texels[0])
                .unwrap_or_else(|| self.surface_group(texels, FOUND));
            group
                .texels
                .iter()
                .for_each(|&i| self.sent[i as usize] = self.surface.fusion.peak[i as usize]);
            kept.push(group);
        }
        self.groups = kept;
    }

    /// Share of the light that the photographs lack.
    fn summary(&self, fit: &ClippedFit) -> MissingLight {
        let seen = self.surface.seen(&self.coarse);
        let mut area_light = (0.0f64, 0.0f64);
        let mut of_group = vec![0.0f64; self.groups.len()];
        for i in (0..self.coarse.len()).filter(|&i| seen[i]) {
            let t = self.coarse.point[i].triangle as usize;
            let area = f64::from(self.coarse.texel_area(&self.surface.scene.mesh, t));
            area_light.0 += area * f64::from(luminance(self.base[i]));
            area_light.1 += area * f64::from(luminance(self.total[i]));
            for (k, g) in self.groups.iter().enumerate() {
                let sent = luminance(g.fit.ceiling + fit.excess[k]);
                of_group[k] += area * f64::from(sent * g.basis[i]);
            }
        }
        let total = area_light.1.max(f64::MIN_POSITIVE);
        let variance: f64 = of_group
            .iter()
            .zip(&fit.log_error)
            .map(|(e, s)| (e / total * f64::from(*s)).powi(2))
            .sum();
        MissingLight {
            share: 1.0 - area_light.0 / total,
            standard_error: variance.sqrt(),
        }
    }

    fn report(&self, fit: &ClippedFit, progress: &Progress) {
        for (k, g) in self.groups.iter().enumerate() {
            let name = match (g.fit.kind, g.sector) {
                (SKY, Some(s)) => format!("sky, sector {s}"),
                (_, _) => {
                    let i = g.texels[g.texels.len() / 2] as usize;
                    let p = self.surface.texels.position(&self.surface.scene.mesh, i);
                    let class = self.surface.scene.class(self.surface.labels[i]);
                    let name = class.map_or("unlabelled", |c| c.name.as_str());
                    let p = p.as_dvec3() + self.surface.scene.origin;
                    format!("{name} at ({:.2}, {:.2}, {:.2})", p.x, p.y, p.z)
                }
            };
            progress.note(format!(
                "clipped light: {name}: at least {:.3}, estimated {:.3} (factor {:.2} ± {:.0} %)",
                luminance(g.fit.ceiling),
                luminance(g.fit.ceiling + fit.excess[k]),
                luminance(g.fit.ceiling + fit.excess[k])
                    / luminance(g.fit.ceiling).max(f32::MIN_POSITIVE),
                100.0 * fit.log_error[k]
            ));
        }
    }

    /// Radiance of the clipped texels: lights with their excess (`true`), others as they reflect.
    fn restored(&self, fit: &ClippedFit) -> Vec<Restored> {
        let light = self.group_of();
        (0..self.sent.len())
            .filter(|&i| self.clipped.bits[i] != 0 || light[i].is_some())
            .map(|i| Restored {
                texel: i as u32,
                radiance: light[i].map_or(self.sent[i], |k| {
                    self.groups[k as usize].fit.ceiling + fit.excess[k as usize]
                }),
                is_light: light[i].is_some(),
                least: self.surface.fusion.peak[i],
                footprint: self.clipped.footprint[i],
            })
            .collect()
    }

    /// What the class of every texel reflects of the light there; zero where that is unknown, and
    /// on lights.
    fn reflected_radiance(&self, fit: &ClippedFit) -> RgbPlane {
        let total = texture_of(&self.coarse, &self.total);
        let light = self.group_of();
        let values: Vec<Vec3> = (0..self.sent.len())
            .into_par_iter()
            .map(|i| {
                let reflects = light[i].is_none() && !self.is_light_class(i);
                let reflected = reflects.then(|| self.reflected(fit, &total, i));
                reflected.flatten().unwrap_or(Vec3::ZERO)
            })
            .collect();
        self.surface.texels.scatter(&values, Vec3::ZERO)
    }

    /// The groups on surfaces.
    fn lights(&self, fit: &ClippedFit) -> Vec<FoundLight> {
        let on_surface = |(g, _): &(&Group, &f32)| g.sector.is_none();
        (self.groups.iter().zip(&fit.log_error))
            .filter(on_surface)
            .map(|(g, e)| FoundLight {
                texels: g.texels.clone(),
                log_error: *e,
                emits: g.fit.kind != FOUND || self.surface.faces_down(&g.texels),
            })
            .collect()
    }

    /// Radiance of the clipped sky in every sector; zero where none of it is clipped.
    fn sky_radiance(&self, fit: &ClippedFit) -> [Vec3; SECTORS] {
        let mut out = [Vec3::ZERO; SECTORS];
        for (g, e) in self.groups.iter().zip(&fit.excess) {
            if let Some(s) = g.sector {
                out[s] = g.fit.ceiling + *e;
            }
        }
        out
    }
}
