//! What the compared systems differ in: a [`Strategy`] has parameters from which materials follow
//! at surface points, and their adjoint; a [`Lighting`] turns materials into pixels and tells how
//! the comparison with the photographs changes with them. One loop trains every pair
//! ([`Compared`]).

use super::descent::Descent;
use super::pixels::{Pixel, PixelGrid};
use crate::core::brdf::Material;
use crate::core::math::signs;
use crate::core::sampling::{KeyedRng, hash_u64};
use glam::Vec3;

/// Slopes of an objective by the material of a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialSlope {
    /// By albedo.
    pub by_albedo: Vec3,
    /// By roughness.
    pub by_roughness: f32,
}

/// When a step is taken.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// Epochs before.
    pub epoch: u32,
    /// Epochs of the whole run.
    pub epochs: u32,
    /// Steps before.
    pub step: u32,
}

impl Moment {
    /// The share of the run that is over when its epoch begins.
    #[must_use]
    pub fn share(&self) -> f32 {
        self.epoch as f32 / self.epochs.max(1) as f32
    }
}

/// A representation of materials with its own regularisers and steps.
pub trait Strategy {
    /// Materials at points of the surface.
    fn materials(&mut self, points: &[Pixel]) -> Vec<Material>;

    /// Adds to the gradient what follows from `slopes` by the materials of `points`, those last
    /// given to [`Self::materials`], and the gradient of the strategy's own regularisers there.
    /// `key` decides what these draw.
    fn adjoint(&mut self, points: &[Pixel], slopes: &[MaterialSlope], now: Moment, key: u64);

    /// Steps against the gradient, which is zero afterwards.
    fn step(&mut self, now: Moment);
}

/// How materials become what photographs show.
pub trait Lighting {
    /// Per pixel, the slopes of the loss (summed over channels) by its material. A lighting that
    /// learns gathers its own gradient, of the mean over pixels and channels.
    fn compare(&mut self, pixels: &[Pixel], materials: &[Material], key: u64)
    -> Vec<MaterialSlope>;

    /// Steps against the gradient, where there is one.
    fn step(&mut self, _now: Moment) {}

    /// Rays that comparing so many pixels traces.
    fn rays(&self, pixels: usize) -> u64;
}

/// How a pixel is compared: in ln(1 + radiance), channel by channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Absolute difference.
    Absolute,
    /// Squared difference.
    Squared,
}

impl Loss {
    /// Derivative by the prediction, per channel.
    #[must_use]
    pub fn slope(self, predicted: Vec3, shown: Vec3) -> Vec3 {
        let inner = 1.0 / (1.0 + predicted.max(Vec3::ZERO));
        match self {
            Self::Absolute => signs(predicted - shown) * inner,
            Self::Squared => {
                let ln = |v: Vec3| Vec3::from_array(v.max(Vec3::ZERO).to_array().map(f32::ln_1p));
                2.0 * (ln(predicted) - ln(shown)) * inner
            }
        }
    }
}

/// The material that a network's numbers in [0, 1] stand for: albedo by the first three, roughness
/// by that of `channel`, within `range[0]` to `range[0] + range[1]`.
#[must_use]
pub fn material(s: &[f32], channel: usize, range: [f32; 2]) -> Material {
    Material {
        albedo: Vec3::new(s[0], s[1], s[2]),
        roughness: range[0] + range[1] * s[channel],
    }
}

/// How much of a view a visit looks at.
#[derive(Clone, Copy, Debug)]
pub struct Visit {
    /// Pixels, drawn anew each time; all if the view has fewer.
    pub pixels: usize,
    /// Pixels of a step.
    pub batch: usize,
}

/// A compared system: its materials, the light they are seen in.
pub struct Compared<'a> {
    /// Pixels of every view, radiance in the units of the losses.
    pub views: &'a [PixelGrid],
    /// Materials.
    pub strategy: &'a mut dyn Strategy,
    /// Light.
    pub light: &'a mut dyn Lighting,
    /// What a visit looks at.
    pub visit: Visit,
    /// When.
    pub now: Moment,
    /// Rays traced.
    pub rays: u64,
}

impl Descent for Compared<'_> {
    fn begin_epoch(&mut self, epoch: u32) {
        self.now.epoch = epoch;
    }

    fn visit(&mut self, view: usize, key: u64) {
        let drawn = draw(&self.views[view].pixels, self.visit.pixels, key);
        for batch in drawn.chunks(self.visit.batch) {
            let key = hash_u64(key, u64::from(self.now.step));
            let materials = self.strategy.materials(batch);
            let mut slopes = self.light.compare(batch, &materials, key);
            let share = 1.0 / (3.0 * batch.len() as f32);
            for slope in &mut slopes {
                slope.by_albedo *= share;
                slope.by_roughness *= share;
            }
            self.strategy
                .adjoint(batch, &slopes, self.now, hash_u64(key, 1));
            self.strategy.step(self.now);
            self.light.step(self.now);
            self.rays += self.light.rays(batch.len());
            self.now.step += 1;
        }
    }
}

/// So many of `pixels` in random order, none twice.
fn draw(pixels: &[Pixel], count: usize, key: u64) -> Vec<Pixel> {
    let mut rng = KeyedRng::new(key, 0xd2a);
    let mut left: Vec<u32> = (0..pixels.len() as u32).collect();
    let count = count.min(left.len());
    for i in 0..count {
        let other = i + rng.below(left.len() - i);
        left.swap(i, other);
    }
    left[..count].iter().map(|&i| pixels[i as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_the_losses() {
        let shown = Vec3::new(0.2, 1.0, 5.0);
        for loss in [Loss::Absolute, Loss::Squared] {
            for p in [Vec3::new(0.4, 0.2, 7.0), Vec3::new(0.1, 3.0, 0.0)] {
                let value = |p: Vec3| {
                    let off = (0..3).map(|k| (p[k].ln_1p() - shown[k].ln_1p()).abs());
                    match loss {
                        Loss::Absolute => off.sum::<f32>(),
                        Loss::Squared => off.map(|d| d * d).sum(),
                    }
                };
                let slope = loss.slope(p, shown);
                for k in 0..3 {
                    let mut d = Vec3::ZERO;
                    d[k] = 1e-3;
                    let central = (value(p + d) - value(p)) / 1e-3;
                    assert!((slope[k] - central).abs() < 1e-2, "{slope} {central}");
                }
            }
        }
    }
}
