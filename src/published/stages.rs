//! The three stages: albedo without reflections, roughness on virtual highlights, both together
//! (method §7). Photometric comparisons are L1 in ln(1 + radiance); one step is one view.

use super::learned_texture::{LearnedTexture, MipTexture, Taps};
use super::options::{Correction, PublishedOptions, PublishedStage as Stage, Weights};
use super::pixels::{Pixel, PixelGrid};
use super::reflection::Reflector;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::sampling::{KeyedRng, hash_u64};
use glam::Vec3;
use std::collections::BTreeMap;
use std::f32::consts::FRAC_1_PI;

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
    /// The irradiance texture in the units of the losses.
    pub irradiance: &'a MipTexture<3>,
    /// What reflects, in the units of the photographs.
    pub reflector: Reflector<'a>,
    /// Factor from the photographs' units to those of the losses.
    pub exposure: f32,
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
    /// E/π.
    diffuse: Vec3,
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

/// Sign with sgn 0 = 0.
fn sign(v: Vec3) -> Vec3 {
    Vec3::from_array(
        v.to_array()
            .map(|x| if x == 0.0 { 0.0 } else { x.signum() }),
    )
}

/// Derivative of |ln(1+p) − ln(1+g)| by p, per channel.
fn photometric_slope(predicted: Vec3, shown: Vec3) -> Vec3 {
    sign(predicted - shown) / (1.0 + predicted.max(Vec3::ZERO))
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
        group.map_or(Vec3::ZERO, |g| sign(*value - means.mean(g)))
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
        let mut order: Vec<usize> = (0..self.views.len()).collect();
        for epoch in 0..self.options.epochs {
            let key = hash_u64(self.seed, hash_u64(stage as u64, u64::from(epoch)));
            let mut rng = KeyedRng::new(key, 0);
            for i in (1..order.len()).rev() {
                order.swap(i, rng.below(i + 1));
            }
            let rate = RATE * DECAY.powi((epoch / PERIOD) as i32);
            let pooled = self
                .options
                .corrects(Correction::W8)
                .then(|| self.pooled(stage, learned));
            for &v in &order {
                let key = hash_u64(key, v as u64 + 1);
                let pooled = pooled.as_ref();
                match stage {
                    Stage::Albedo => self.albedo_step(v, pooled, learned),
                    Stage::Roughness => self.roughness_step(v, key, pooled, learned),
                    Stage::Joint => self.joint_step(v, key, pooled, learned),
                }
                if stage != Stage::Roughness {
                    // stage I is clamped once it is over: Adam may pass through zero
                    let low = match stage {
                        Stage::Albedo => f32::NEG_INFINITY,
                        _ => 0.0,
                    };
                    learned.albedo.step(rate, low, f32::INFINITY);
                }
                if stage != Stage::Albedo {
                    learned.roughness.step(rate, ROUGHNESS.0, ROUGHNESS.1);
                }
                progress.advance(1);
            }
        }
        if stage == Stage::Albedo {
            learned.albedo.step(0.0, 0.0, f32::INFINITY);
        }
    }

    /// Albedo and irradiance of each of `pixels`.
    fn shade(&self, pixels: &[Pixel], learned: &Learned) -> Vec<Shaded> {
        let albedo = learned.albedo.texture();
        let shaded = |p: &Pixel| {
            let albedo_taps = albedo.taps(p.uv, p.footprint);
            let e = self.irradiance.taps(p.uv, p.footprint);
            Shaded {
                albedo: albedo.fetch(&albedo_taps).into(),
                albedo_taps,
                diffuse: Vec3::from(self.irradiance.fetch(&e)) * FRAC_1_PI,
            }
        };
        pixels.par_iter().map(shaded).collect()
    }

    /// Stage I: I = E A/π, and every class near its mean.
    fn albedo_step(&self, view: usize, pooled: Option<&GroupMeans>, learned: &mut Learned) {
        let grid = &self.views[view];
        let shaded = self.shade(&grid.pixels, learned);
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
                photometric_slope(s.diffuse * s.albedo, pixel.radiance) * s.diffuse * photometric
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

    /// Derivatives of the sum of |ln(1+I) − ln(1+shown)| over the channels, I = E A/π + L_s.
    fn photometric_slopes(
        &self,
        pixels: &[Pixel],
        shaded: &[Shaded],
        roughness: &[f32],
        key: u64,
        learned: &mut Learned,
    ) -> Vec<Slopes> {
        let mirrored = self.reflector.reflect(pixels, roughness, key);
        let rays = pixels.len() as u64 * u64::from(super::reflection::SAMPLES);
        learned.rays += rays;
        // residuals from samples of their own do not conspire with their slopes
        let independent = self.options.corrects(Correction::W2).then(|| {
            learned.rays += rays;
            self.reflector
                .reflect(pixels, roughness, hash_u64(key, 0x1d))
        });
        let shown = independent.as_ref().unwrap_or(&mirrored);
        (0..pixels.len())
            .into_par_iter()
            .map(|i| {
                let s = &shaded[i];
                let predicted = s.diffuse * s.albedo + shown[i].radiance * self.exposure;
                let slope = photometric_slope(predicted, pixels[i].radiance);
                Slopes {
                    by_albedo: slope * s.diffuse,
                    by_roughness: slope.dot(mirrored[i].slope * self.exposure),
                }
            })
            .collect()
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

/// Derivatives of a pixel's photometric loss.
struct Slopes {
    by_albedo: Vec3,
    by_roughness: f32,
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

    #[test]
    fn the_photometric_slope_is_that_of_its_loss() {
        let shown = Vec3::new(0.2, 1.0, 5.0);
        for p in [Vec3::new(0.4, 0.2, 7.0), Vec3::new(0.1, 3.0, 0.0)] {
            let loss = |p: Vec3| {
                (0..3)
                    .map(|k| (p[k].ln_1p() - shown[k].ln_1p()).abs())
                    .sum::<f32>()
            };
            let slope = photometric_slope(p, shown);
            for k in 0..3 {
                let mut d = Vec3::ZERO;
                d[k] = 1e-3;
                let central = (loss(p + d) - loss(p)) / 1e-3;
                assert!((slope[k] - central).abs() < 1e-2, "{slope} {central}");
            }
        }
    }
}
