//! The three stages: albedo without reflections, roughness on virtual highlights, both together
//! (method §7). Photometric comparisons are L1 in ln(1 + radiance); one step is one view.

use super::descent::{Descent, descend};
use super::hybrid::Hybrid;
use super::learned_texture::{LearnedTexture, MipTexture, Taps};
use super::options::{Correction, PublishedOptions, PublishedStage as Stage, Weights};
use super::pixels::{Pixel, PixelGrid};
use super::strategy::{Lighting, MaterialSlope};
use crate::core::brdf::Material;
use crate::core::math;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::sampling::hash_u64;
use glam::Vec3;
use std::collections::BTreeMap;

/// Steps of Adam, their decay and its period in epochs (cited: supplement, Sec. C.1).
const RATE: f32 = 0.03;
const DECAY: f32 = 0.8;
const PERIOD: u32 = 20;
/// Values that the textures start from (cited: method §7).
const FIRST_ALBEDO: f32 = 0.5;
const FIRST_ROUGHNESS: f32 = 0.1;
/// Range of roughness (cited: method §4.1).
const ROUGHNESS: (f32, f32) = (0.01, 0.8);
/// Classes that the losses are means over, whatever a scene has (cited: method §7).
const CLASSES: f64 = 49.0;
/// Share of a class's highlights below its target roughness, and the ceiling's target (cited:
/// method §7, the values of synthetic scenes).
const QUANTILE: f32 = 0.4;
const CEILING: f32 = 0.8;

/// What the stages see of the scene.
pub struct Training<'a> {
    /// Pixels of every view, radiance in the units of the losses.
    pub views: &'a [PixelGrid],
    /// Per view, which of its pixels are virtual highlights.
    pub highlights: &'a [Vec<bool>],
    /// The light.
    pub hybrid: Hybrid<'a>,
    /// Classes of ceilings.
    pub ceilings: &'a [u16],
    /// Numbers.
    pub options: &'a PublishedOptions,
    /// Key of all randomness.
    pub seed: u64,
}

/// The textures that are learned.
pub struct Learned {
    /// Albedo, linear RGB.
    pub albedo: LearnedTexture<3>,
    /// Roughness R.
    pub roughness: LearnedTexture<1>,
    /// Rays traced.
    pub rays: u64,
}

/// Runs all three stages from the published first values.
#[must_use]
pub fn optimise(training: &Training, sides: Sides, progress: &Progress) -> Learned {
    let mut learned = Learned {
        albedo: LearnedTexture::filled(sides.albedo, [FIRST_ALBEDO; 3]),
        roughness: LearnedTexture::filled(sides.roughness, [FIRST_ROUGHNESS]),
        rays: 0,
    };
    let steps = u64::from(training.options.epochs) * training.views.len() as u64;
    for stage in Stage::ALL {
        if training.options.stages.contains(&stage) {
            progress.stage(stage.name(), steps, |p| {
                training.run(stage, &mut learned, p)
            });
        }
    }
    learned
}

/// Sides of the learned textures, texels.
#[derive(Clone, Copy, Debug)]
pub struct Sides {
    /// Albedo.
    pub albedo: usize,
    /// Roughness.
    pub roughness: usize,
}

/// A pixel's texels and what they hold.
struct Shaded {
    albedo_taps: Taps,
    albedo: Vec3,
}

/// Means and counts of a value by group.
#[derive(Default)]
struct GroupMeans(BTreeMap<u32, (Vec3, f64)>);

impl GroupMeans {
    fn add(&mut self, group: u32, value: Vec3) {
        let of = self.0.entry(group).or_default();
        of.0 += value;
        of.1 += 1.0;
    }

    fn mean(&self, group: u32) -> Vec3 {
        self.0
            .get(&group)
            .map_or(Vec3::ZERO, |(sum, n)| *sum / *n as f32)
    }
}

/// Gradient of the mean of |value − mean of its group| by each value, the mean's own dependence
/// included: sgn_i − mean(sgn).
fn pull_to_means(values: &[Vec3], groups: &[Option<u32>], given: Option<&GroupMeans>) -> Vec<Vec3> {
    let mut own = GroupMeans::default();
    if given.is_none() {
        for (value, group) in values.iter().zip(groups) {
            group.iter().for_each(|g| own.add(*g, *value));
        }
    }
    let means = given.unwrap_or(&own);
    let mut signs = GroupMeans::default();
    let sign_of = |value: &Vec3, group: &Option<u32>| {
        group.map_or(Vec3::ZERO, |g| math::signs(*value - means.mean(g)))
    };
    if given.is_none() {
        for (value, group) in values.iter().zip(groups) {
            group
                .iter()
                .for_each(|g| signs.add(*g, sign_of(value, group)));
        }
    }
    values
        .iter()
        .zip(groups)
        .map(|(value, group)| sign_of(value, group) - group.map_or(Vec3::ZERO, |g| signs.mean(g)))
        .collect()
}

impl Training<'_> {
    fn weights(&self) -> Weights {
        self.options.weights()
    }

    fn run(&self, stage: Stage, learned: &mut Learned, progress: &Progress) {
        learned.albedo.restart();
        learned.roughness.restart();
        let epochs = self.options.epochs;
        let key = |epoch| hash_u64(self.seed, hash_u64(stage as u64, u64::from(epoch)));
        let mut descent = StageDescent {
            training: self,
            stage,
            learned,
            rate: RATE,
            pooled: None,
        };
        descend(&mut descent, epochs, self.views.len(), key, progress);
        if stage == Stage::Albedo {
            learned.albedo.step(0.0, 0.0, f32::INFINITY);
        }
    }

    /// Albedo of each of `pixels`.
    fn shade(&self, pixels: &[Pixel], learned: &Learned) -> Vec<Shaded> {
        let albedo = learned.albedo.texture();
        let shaded = |p: &Pixel| {
            let albedo_taps = albedo.taps(p.uv, p.footprint);
            Shaded {
                albedo: albedo.fetch(&albedo_taps).into(),
                albedo_taps,
            }
        };
        pixels.par_iter().map(shaded).collect()
    }

    /// Stage I: I = E A/π, and every class near its mean.
    fn albedo_step(
        &self,
        view: usize,
        key: u64,
        pooled: Option<&GroupMeans>,
        learned: &mut Learned,
    ) {
        let grid = &self.views[view];
        let shaded = self.shade(&grid.pixels, learned);
        let diffuse = self.hybrid.diffuse(&grid.pixels, key);
        learned.rays += u64::from(self.hybrid.light_samples) * grid.pixels.len() as u64;
        let all = grid.size() as f64;
        let photometric = (1.0 / (3.0 * all)) as f32;
        let prior = (self.weights().albedo_smoothness / (CLASSES * 3.0 * all)) as f32;
        let albedos: Vec<Vec3> = shaded.iter().map(|s| s.albedo).collect();
        let groups: Vec<Option<u32>> = grid.pixels.iter().map(class_group).collect();
        let pull = pull_to_means(&albedos, &groups, pooled);
        let without_highlights = self.options.corrects(Correction::W3);
        for (i, (pixel, s)) in grid.pixels.iter().zip(&shaded).enumerate() {
            let fits = !(without_highlights && self.highlights[view][i]);
            let slope = if fits {
                self.hybrid
                    .loss
                    .slope(diffuse[i] * s.albedo, pixel.radiance)
                    * diffuse[i]
                    * photometric
            } else {
                Vec3::ZERO
            };
            let gradient = slope + pull[i] * prior;
            learned
                .albedo
                .add_gradient(&s.albedo_taps, gradient.to_array());
        }
    }

    /// Where roughness is read for a fit to highlights.
    fn roughness_taps(&self, pixel: &Pixel, roughness: &MipTexture<1>) -> Taps {
        let width = if self.options.corrects(Correction::W7) {
            pixel.footprint
        } else {
            0.0
        };
        roughness.taps(pixel.uv, width)
    }

    /// Stage II: highlights fit their pixels, and the rest of a class in the view follows them.
    fn roughness_step(
        &self,
        view: usize,
        key: u64,
        pooled: Option<&GroupMeans>,
        learned: &mut Learned,
    ) {
        let grid = &self.views[view];
        let lit = |i: &usize| self.highlights[view][*i] && grid.pixels[*i].class != 0;
        let chosen: Vec<usize> = (0..grid.pixels.len()).filter(lit).collect();
        let pixels: Vec<Pixel> = chosen.iter().map(|&i| grid.pixels[i]).collect();
        let texture = learned.roughness.texture();
        let taps: Vec<Taps> = pixels
            .par_iter()
            .map(|p| self.roughness_taps(p, texture))
            .collect();
        let roughness: Vec<f32> = taps.iter().map(|t| texture.fetch(t)[0]).collect();
        let shaded = self.shade(&pixels, learned);
        let slopes = self.photometric_slopes(&pixels, &shaded, &roughness, key, learned);
        let all = CLASSES * grid.size() as f64;
        let fit = (self.weights().highlights / (3.0 * all)) as f32;
        for (taps, slope) in taps.iter().zip(&slopes) {
            learned
                .roughness
                .add_gradient(taps, [slope.by_roughness * fit]);
        }
        let targets = match pooled {
            Some(pooled) => pooled.0.keys().map(|c| (*c, pooled.mean(*c).x)).collect(),
            None => self.targets(&pixels, &roughness),
        };
        let follow = (self.weights().propagation / all) as f32;
        let texture = learned.roughness.texture();
        let followers: Vec<(Taps, f32)> = (0..grid.pixels.len())
            .into_par_iter()
            .filter(|i| !self.highlights[view][*i])
            .filter_map(|i| {
                let pixel = &grid.pixels[i];
                let target = targets.get(&u32::from(pixel.class))?;
                let taps = texture.taps(pixel.uv, pixel.footprint);
                let off = texture.fetch(&taps)[0] - target;
                (off != 0.0).then(|| (taps, off.signum()))
            })
            .collect();
        for (taps, sign) in &followers {
            learned.roughness.add_gradient(taps, [sign * follow]);
        }
    }

    /// Roughness that the rest of each class follows: a quantile of its highlights', a constant
    /// for ceilings.
    fn targets(&self, pixels: &[Pixel], roughness: &[f32]) -> BTreeMap<u32, f32> {
        let mut by_class: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
        for (pixel, r) in pixels.iter().zip(roughness) {
            by_class.entry(u32::from(pixel.class)).or_default().push(*r);
        }
        let target = |(class, mut values): (u32, Vec<f32>)| {
            if self.ceilings.iter().any(|c| u32::from(*c) == class) {
                return (class, CEILING);
            }
            let at = (QUANTILE * (values.len() - 1) as f32).round() as usize;
            (class, *values.select_nth_unstable_by(at, f32::total_cmp).1)
        };
        by_class.into_iter().map(target).collect()
    }

    /// Stage III: both textures fit all pixels, and roughness is near its class's mean in a room.
    fn joint_step(
        &self,
        view: usize,
        key: u64,
        pooled: Option<&GroupMeans>,
        learned: &mut Learned,
    ) {
        let grid = &self.views[view];
        let pixels: Vec<Pixel> = grid
            .pixels
            .iter()
            .filter(|p| p.class != 0)
            .copied()
            .collect();
        let shaded = self.shade(&pixels, learned);
        let texture = learned.roughness.texture();
        let taps: Vec<Taps> = pixels
            .par_iter()
            .map(|p| texture.taps(p.uv, p.footprint))
            .collect();
        let roughness: Vec<f32> = taps.iter().map(|t| texture.fetch(t)[0]).collect();
        let slopes = self.photometric_slopes(&pixels, &shaded, &roughness, key, learned);
        let groups: Vec<Option<u32>> = pixels.iter().map(room_group).collect();
        let values: Vec<Vec3> = roughness.iter().map(|r| Vec3::splat(*r)).collect();
        let pull = pull_to_means(&values, &groups, pooled);
        let rooms: std::collections::BTreeSet<u16> = pixels.iter().map(|p| p.room).collect();
        let all = CLASSES * grid.size() as f64;
        let fit = (1.0 / (3.0 * all)) as f32;
        let smooth =
            (self.weights().roughness_smoothness / (all * rooms.len().max(1) as f64)) as f32;
        for i in 0..pixels.len() {
            let albedo = slopes[i].by_albedo * fit;
            learned
                .albedo
                .add_gradient(&shaded[i].albedo_taps, albedo.to_array());
            let slope = slopes[i].by_roughness * fit + pull[i].x * smooth;
            learned.roughness.add_gradient(&taps[i], [slope]);
        }
    }

    /// Slopes of the sum of |ln(1+I) − ln(1+shown)| over the channels, I = E A/π + L_s.
    fn photometric_slopes(
        &self,
        pixels: &[Pixel],
        shaded: &[Shaded],
        roughness: &[f32],
        key: u64,
        learned: &mut Learned,
    ) -> Vec<MaterialSlope> {
        let materials: Vec<Material> = shaded
            .iter()
            .zip(roughness)
            .map(|(s, roughness)| Material {
                albedo: s.albedo,
                roughness: *roughness,
            })
            .collect();
        let mut hybrid = self.hybrid;
        learned.rays += hybrid.rays(pixels.len());
        hybrid.compare(pixels, &materials, key)
    }

    /// Means over all views: of albedo by class in stage I, of highlights' roughness by class in
    /// stage II, of roughness by room and class in stage III ([`Correction::W8`]).
    fn pooled(&self, stage: Stage, learned: &Learned) -> GroupMeans {
        let mut means = GroupMeans::default();
        for (grid, highlights) in self.views.iter().zip(self.highlights) {
            for (pixel, lit) in grid.pixels.iter().zip(highlights) {
                let roughness = || {
                    let texture = learned.roughness.texture();
                    let taps = texture.taps(pixel.uv, pixel.footprint);
                    Vec3::splat(texture.fetch(&taps)[0])
                };
                match stage {
                    Stage::Albedo => {
                        let texture = learned.albedo.texture();
                        let taps = texture.taps(pixel.uv, pixel.footprint);
                        class_group(pixel)
                            .iter()
                            .for_each(|g| means.add(*g, texture.fetch(&taps).into()));
                    }
                    Stage::Roughness if *lit => {
                        class_group(pixel)
                            .iter()
                            .for_each(|g| means.add(*g, roughness()));
                    }
                    Stage::Roughness => {}
                    Stage::Joint => room_group(pixel)
                        .iter()
                        .for_each(|g| means.add(*g, roughness())),
                }
            }
        }
        if stage == Stage::Roughness {
            for ceiling in self.ceilings {
                let target = (Vec3::splat(CEILING), 1.0);
                means.0.insert(u32::from(*ceiling), target);
            }
        }
        means
    }
}

/// A stage under way.
struct StageDescent<'a, 'b> {
    training: &'a Training<'b>,
    stage: Stage,
    learned: &'a mut Learned,
    rate: f32,
    pooled: Option<GroupMeans>,
}

impl Descent for StageDescent<'_, '_> {
    fn begin_epoch(&mut self, epoch: u32) {
        self.rate = RATE * DECAY.powi((epoch / PERIOD) as i32);
        let pools = self.training.options.corrects(Correction::W8);
        self.pooled = pools.then(|| self.training.pooled(self.stage, self.learned));
    }

    fn visit(&mut self, view: usize, key: u64) {
        let (training, pooled) = (self.training, self.pooled.as_ref());
        match self.stage {
            Stage::Albedo => training.albedo_step(view, key, pooled, self.learned),
            Stage::Roughness => training.roughness_step(view, key, pooled, self.learned),
            Stage::Joint => training.joint_step(view, key, pooled, self.learned),
        }
        if self.stage != Stage::Roughness {
            // stage I is clamped once it is over: Adam may pass through zero
            let low = match self.stage {
                Stage::Albedo => f32::NEG_INFINITY,
                _ => 0.0,
            };
            self.learned.albedo.step(self.rate, low, f32::INFINITY);
        }
        if self.stage != Stage::Albedo {
            self.learned
                .roughness
                .step(self.rate, ROUGHNESS.0, ROUGHNESS.1);
        }
    }
}

/// The class of a labelled pixel.
fn class_group(pixel: &Pixel) -> Option<u32> {
    (pixel.class != 0).then(|| u32::from(pixel.class))
}

/// Room and class of a labelled pixel.
fn room_group(pixel: &Pixel) -> Option<u32> {
    (pixel.class != 0).then(|| u32::from(pixel.room) << 16 | u32::from(pixel.class))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loss(values: &[Vec3], groups: &[Option<u32>]) -> f32 {
        let mut means = GroupMeans::default();
        for (v, g) in values.iter().zip(groups) {
            g.iter().for_each(|g| means.add(*g, *v));
        }
        let off = |(v, g): (&Vec3, &Option<u32>)| {
            g.map_or(0.0, |g| (*v - means.mean(g)).abs().element_sum())
        };
        values.iter().zip(groups).map(off).sum()
    }

    #[test]
    fn the_pull_to_class_means_is_the_gradient_of_its_loss() {
        let mut values: Vec<Vec3> = (0..7)
            .map(|i| Vec3::new(0.1 * i as f32, 0.9 - 0.07 * i as f32, 0.3))
            .collect();
        values[3].z = 0.8;
        let groups = [Some(1), Some(1), Some(2), Some(1), None, Some(2), Some(2)];
        let pull = pull_to_means(&values, &groups, None);
        for i in 0..7 {
            let h = 1e-3;
            let moved = |d: f32| {
                let mut v = values.clone();
                v[i].x += d;
                loss(&v, &groups)
            };
            let central = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((pull[i].x - central).abs() < 1e-3, "{i}: {}", pull[i].x);
        }
    }
}
