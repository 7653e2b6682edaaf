//! From samples to pixels: sums with their variance and first-hit features, and which pixels need
//! more samples.

use super::options::{Adaptive, Noise};
use super::scene::Surface;
use super::wave::{Feature, Sums};
use crate::core::brdf::BaseColour;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use glam::Vec3;

/// An image with what its first hits saw.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Light emitted by the first hit, or the environment's.
    pub emission: RgbPlane,
    /// Light reflected by the diffuse lobe of the first hit.
    pub diffuse: RgbPlane,
    /// Light reflected by the specular lobe of the first hit.
    pub specular: RgbPlane,
    /// Variance of the luminance of the pixel's diffuse and specular mean.
    pub variance: Plane<[f32; 2]>,
    /// Mean albedo of the diffuse part over the pixel's samples that met geometry.
    pub albedo: RgbPlane,
    /// Mean normal over the pixel's samples (zero without geometry).
    pub normal: RgbPlane,
    /// Mean distance over the pixel's samples that met geometry; 0 without.
    pub depth: Plane<f32>,
    /// Class at the pixel's centre; 0 without geometry.
    pub label: Plane<u16>,
    /// Base colour, box-filtered over the part of the pixel that has the centre's class: of metal
    /// what it reflects at normal incidence, of the rest its albedo.
    pub class_albedo: RgbPlane,
    /// Share of metal, likewise.
    pub class_metallic: Plane<f32>,
    /// Share of transmitted light, likewise.
    pub class_transmission: Plane<f32>,
    /// Roughness, likewise.
    pub class_roughness: Plane<f32>,
}

impl Frame {
    /// The image: emission + diffuse + specular.
    #[must_use]
    pub fn radiance(&self) -> RgbPlane {
        let mut out = self.emission.clone();
        for (i, p) in out.data.iter_mut().enumerate() {
            *p += self.diffuse.data[i] + self.specular.data[i];
        }
        out
    }
}

/// Side of the blocks that adaptive sampling decides about.
const BLOCK: usize = 8;

/// What a finished pixel holds: one element of every plane of [`Frame`].
pub(super) struct PixelResult {
    emission: Vec3,
    diffuse: Vec3,
    specular: Vec3,
    variance: [f32; 2],
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    label: u16,
    class_base: BaseColour,
    class_transmission: f32,
    class_roughness: f32,
}

/// The planes of an image from its pixels.
pub(super) fn assemble(w: usize, h: usize, pixels: &[PixelResult]) -> Frame {
    fn of<T: Send>(
        w: usize,
        h: usize,
        pixels: &[PixelResult],
        f: fn(&PixelResult) -> T,
    ) -> Plane<T> {
        Plane {
            width: w,
            height: h,
            data: pixels.par_iter().map(f).collect(),
        }
    }
    let plane = |f| of(w, h, pixels, f);
    Frame {
        emission: plane(|p| p.emission),
        diffuse: plane(|p| p.diffuse),
        specular: plane(|p| p.specular),
        variance: of(w, h, pixels, |p| p.variance),
        albedo: plane(|p| p.albedo),
        normal: plane(|p| p.normal),
        depth: of(w, h, pixels, |p| p.depth),
        label: of(w, h, pixels, |p| p.label),
        class_albedo: plane(|p| p.class_base.colour),
        class_metallic: of(w, h, pixels, |p| p.class_base.metallic),
        class_transmission: of(w, h, pixels, |p| p.class_transmission),
        class_roughness: of(w, h, pixels, |p| p.class_roughness),
    }
}

/// The pixels of `among` whose block has a relative standard error above the goal.
pub(super) fn noisy_pixels(
    [w, h]: [usize; 2],
    pixels: &[PixelResult],
    among: &[usize],
    goal: &Adaptive,
) -> Vec<usize> {
    let columns = w.div_ceil(BLOCK);
    let mut blocks = vec![(0.0f64, 0.0f64, 0u32); columns * h.div_ceil(BLOCK)];
    let block_of = |p: usize| (p / w / BLOCK) * columns + p % w / BLOCK;
    let mut mean = 0.0;
    for (p, pixel) in pixels.iter().enumerate() {
        let reflected = luminance(pixel.diffuse + pixel.specular);
        let [diffuse, specular] = pixel.variance;
        let variance = match goal.noise {
            Noise::Reflected => diffuse + specular,
            Noise::Specular => specular,
        };
        let b = &mut blocks[block_of(p)];
        *b = (
            b.0 + f64::from(reflected),
            b.1 + f64::from(variance),
            b.2 + 1,
        );
        mean += f64::from(reflected) / (w * h) as f64;
    }
    // what is much darker than the picture as a whole need not be as exact as itself asks
    let noisy = |b: &(f64, f64, u32)| {
        let n = f64::from(b.2.max(1));
        (b.1 / n).sqrt() > f64::from(goal.error) * (b.0 / n + 0.1 * mean)
    };
    let noisy: Vec<bool> = blocks.iter().map(noisy).collect();
    among
        .iter()
        .copied()
        .filter(|&p| noisy[block_of(p)])
        .collect()
}

/// What a sample of both lobes counts for the specular part beside one of the specular lobe alone:
/// about the probability with which it follows that lobe, where it is seen from the front.
const MIXED_WORTH: f32 = 0.15;

/// Variance of the mean of `n` numbers, given their sum and their squares' sum.
fn variance_of_mean([sum, square]: [f64; 2], n: u32) -> f32 {
    let n = f64::from(n.max(1));
    let mean = sum / n;
    ((square / n - mean * mean).max(0.0) / (n - 1.0).max(1.0)) as f32
}

/// Sums over a pixel's samples, in f64 where differences of squares are taken.
#[derive(Clone)]
pub(super) struct PixelAccumulator {
    samples: u32,
    /// Those of them that followed both lobes.
    mixed_samples: u32,
    /// Samples of the specular lobe alone, their sum and the luminance's moments.
    lobe_samples: u32,
    lobe_sum: Vec3,
    lobe_moments: [f64; 2],
    centre: Option<(u16, Surface)>,
    sums: Sums,
    moments: [[f64; 2]; 2],
    geometry: f32,
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    class: f32,
    class_base: BaseColour,
    class_transmission: f32,
    class_roughness: f32,
}

impl PixelAccumulator {
    pub(super) fn new(centre: Option<(u16, Surface)>) -> Self {
        Self {
            samples: 0,
            mixed_samples: 0,
            lobe_samples: 0,
            lobe_sum: Vec3::ZERO,
            lobe_moments: [0.0; 2],
            centre,
            sums: Sums::default(),
            moments: [[0.0; 2]; 2],
            geometry: 0.0,
            albedo: Vec3::ZERO,
            normal: Vec3::ZERO,
            depth: 0.0,
            class: 0.0,
            class_base: BaseColour::default(),
            class_transmission: 0.0,
            class_roughness: 0.0,
        }
    }

    /// Adds a sample that followed both lobes.
    pub(super) fn add(&mut self, s: &Sums, feature: Option<&Feature>) {
        self.mixed_samples += 1;
        self.sums.specular += s.specular;
        for (m, x) in self.moments.iter_mut().zip([s.diffuse, s.specular]) {
            let y = f64::from(luminance(x));
            *m = [m[0] + y, m[1] + y * y];
        }
        self.add_known(s, feature);
    }

    /// Adds what a sample met, with diffuse light that is known and therefore without variance.
    pub(super) fn add_known(&mut self, s: &Sums, feature: Option<&Feature>) {
        self.samples += 1;
        self.sums.emission += s.emission;
        self.sums.diffuse += s.diffuse;
        if let Some(f) = feature {
            self.geometry += 1.0;
            self.albedo += f.albedo;
            self.normal += f.normal;
            self.depth += f.depth;
            if self.centre.is_some_and(|(label, _)| label == f.label) {
                self.class += 1.0;
                self.class_base.colour += f.base.colour;
                self.class_base.metallic += f.base.metallic;
                self.class_transmission += f.transmission;
                self.class_roughness += f.roughness;
            }
        }
    }

    /// Adds a sample that followed the specular lobe alone.
    pub(super) fn add_specular(&mut self, s: &Sums) {
        let y = f64::from(luminance(s.specular));
        self.lobe_samples += 1;
        self.lobe_sum += s.specular;
        self.lobe_moments = [self.lobe_moments[0] + y, self.lobe_moments[1] + y * y];
    }

    pub(super) fn finish(&self) -> PixelResult {
        let samples = self.samples.max(1);
        let scale = 1.0 / samples as f32;
        let mixed = self.mixed_samples.max(1);
        let [diffuse_variance, mut specular_variance] =
            self.moments.map(|m| variance_of_mean(m, mixed));
        let mut specular = self.sums.specular / mixed as f32;
        if self.lobe_samples > 0 {
            let alone = self.lobe_samples as f32;
            let weight = alone / (alone + MIXED_WORTH * self.mixed_samples as f32);
            specular = specular.lerp(self.lobe_sum / alone, weight);
            let lobe_variance = variance_of_mean(self.lobe_moments, self.lobe_samples);
            specular_variance =
                (1.0 - weight).powi(2) * specular_variance + weight * weight * lobe_variance;
        }
        let seen = 1.0 / self.geometry.max(1.0);
        let class = self.class_mean();
        PixelResult {
            emission: self.sums.emission * scale,
            diffuse: self.sums.diffuse * scale,
            specular,
            variance: [diffuse_variance, specular_variance],
            albedo: self.albedo * seen,
            normal: self.normal * scale,
            depth: self.depth * seen,
            label: self.centre.map_or(0, |(l, _)| l),
            class_base: class.base,
            class_transmission: class.transmission,
            class_roughness: class.roughness,
        }
    }

    /// The surface of the centre's class: its mean over the samples that met it, else that at the
    /// centre. Emission is not averaged.
    fn class_mean(&self) -> Surface {
        if self.class > 0.0 {
            Surface {
                base: BaseColour {
                    colour: self.class_base.colour / self.class,
                    metallic: self.class_base.metallic / self.class,
                },
                transmission: self.class_transmission / self.class,
                roughness: self.class_roughness / self.class,
                emission: Vec3::ZERO,
            }
        } else {
            let nothing = Surface {
                base: BaseColour::default(),
                transmission: 0.0,
                roughness: 0.0,
                emission: Vec3::ZERO,
            };
            self.centre.map_or(nothing, |(_, s)| s)
        }
    }
}
