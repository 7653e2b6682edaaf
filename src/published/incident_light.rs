//! NeILF's own light (Yao et al., ECCV 2022, Sec. 3.1): a perceptron L(x, ω) of position and
//! direction, learned with the materials. A pixel is (2π/N) Σ f(x, ω_i, v) L(x, ω_i) (n·ω_i) over
//! Fibonacci directions of the hemisphere, turned at random; no ray is traced.

use super::neilf::{JOIN, rate, widths};
use super::pixels::Pixel;
use super::place::Place;
use super::strategy::{Lighting, Loss, MaterialSlope, Moment};
use crate::core::brdf::{Material, specular_d_roughness};
use crate::core::math::Frame;
use crate::core::network::{Activation, Join, Learner, Shape, encode, encoded_size, sum_gradient};
use crate::core::sampling::{KeyedRng, hash_u64};
use glam::Vec3;
use nalgebra::DMatrix;
use std::f32::consts::{FRAC_1_PI, TAU};
use std::ops::Range;

/// Octaves of the direction's encoding (cited: method §7.2).
const OCTAVES: usize = 6;
/// Radiance before the first step, of every direction (cited: the release).
const START: f32 = 1.5;
/// Directions of a pixel: the authors', and the comparison's (cited: method §7.2).
const DIRECTIONS: [usize; 2] = [128, 32];
/// Directions that run through the network together.
const COLUMNS: usize = 1024;

/// A light field that is learned.
pub struct IncidentLight {
    place: Place,
    learner: Learner,
    directions: usize,
    loss: Loss,
    handicapped: bool,
}

/// What a direction adds to a pixel, per unit of radiance.
#[derive(Clone, Copy)]
struct Response {
    /// 2 cosθ / N: times albedo, the diffuse part.
    diffuse: f32,
    /// The specular part and its slope by roughness.
    specular: f32,
    slope: f32,
}

impl IncidentLight {
    /// A random field.
    #[must_use]
    pub fn new(place: Place, loss: Loss, handicapped: bool, seed: u64) -> Self {
        let inputs = encoded_size(OCTAVES);
        let shape = Shape {
            inputs,
            hidden: widths(128, inputs + 3),
            outputs: 3,
            activation: Activation::Sine,
            last: Activation::Exponential,
            join: Some(Join {
                layer: JOIN,
                rows: 0..inputs + 3,
            }),
            biased: true,
            start: Some(START.ln()),
        };
        Self {
            place,
            learner: Learner::new(&shape, seed),
            directions: DIRECTIONS[usize::from(handicapped)],
            loss,
            handicapped,
        }
    }

    /// Directions to the light in the frame of the normal.
    fn directions(&self, key: u64, i: usize) -> impl Iterator<Item = Vec3> + use<> {
        /// 2π over the golden ratio squared: the turn from one Fibonacci point to the next.
        const TURN: f32 = 2.399_963_2;
        let turn = TAU * KeyedRng::new(key, i as u64).next_f32();
        let n = self.directions;
        (0..n).map(move |j| {
            let z = 1.0 - (j as f32 + 0.5) / n as f32;
            let r = (1.0 - z * z).sqrt();
            let (sin, cos) = (turn + TURN * j as f32).sin_cos();
            Vec3::new(r * cos, r * sin, z)
        })
    }

    /// Inputs of the network and responses for some pixels, all directions of one after another.
    fn gathered(
        &self,
        pixels: &[Pixel],
        range: Range<usize>,
        key: u64,
    ) -> (DMatrix<f32>, Vec<Vec3>) {
        let rows = encoded_size(OCTAVES) + 3;
        let mut x = DMatrix::zeros(rows, range.len() * self.directions);
        let mut local = Vec::with_capacity(x.ncols());
        for i in range {
            let frame = Frame::from_normal(pixels[i].normal);
            let place = self.place.normalised(pixels[i].position).to_array();
            for direction in self.directions(key, i) {
                let from = rows * local.len();
                let column = &mut x.as_mut_slice()[from..from + rows];
                encode(frame.world_from_local(direction), &mut column[..rows - 3]);
                column[rows - 3..].copy_from_slice(&place);
                local.push(direction);
            }
        }
        (x, local)
    }

    /// The response to light from `direction` of a surface of some roughness seen from `view`, both
    /// in the frame of the normal.
    fn response(&self, direction: Vec3, view: Vec3, roughness: f32) -> Response {
        let share = TAU * direction.z / self.directions as f32;
        let half = (direction + view).normalize_or(Vec3::Z);
        let sin2 = half.x * half.x + half.y * half.y;
        let v_h = half.dot(view).max(0.0);
        let (specular, slope) =
            specular_d_roughness(direction.z, view.z.max(1e-3), sin2, v_h, roughness);
        Response {
            diffuse: share * FRAC_1_PI,
            specular: share * specular,
            slope: share * slope,
        }
    }

    /// Compares some pixels; adds the gradient of the light.
    fn block(
        &self,
        seen: Seen,
        range: Range<usize>,
        key: u64,
        gradient: &mut [f32],
    ) -> Vec<MaterialSlope> {
        let (x, local) = self.gathered(seen.pixels, range.clone(), key);
        let trace = self.learner.network.forward(&x);
        let mut by_light = DMatrix::zeros(3, x.ncols());
        let scale = 1.0 / (3.0 * seen.pixels.len() as f32);
        let mut out = Vec::with_capacity(range.len());
        for (k, i) in range.enumerate() {
            let columns = k * self.directions..(k + 1) * self.directions;
            let (pixel, material) = (&seen.pixels[i], &seen.materials[i]);
            let frame = Frame::from_normal(pixel.normal);
            let view = frame.local_from_world(pixel.to_camera);
            let responses: Vec<Response> = local[columns.clone()]
                .iter()
                .map(|d| self.response(*d, view, material.roughness))
                .collect();
            let (mut diffuse, mut specular, mut slope) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
            for (r, c) in responses.iter().zip(columns.clone()) {
                let light = Vec3::from_slice(trace.output.column(c).as_slice());
                diffuse += r.diffuse * light;
                specular += r.specular * light;
                slope += r.slope * light;
            }
            let by_pixel = self
                .loss
                .slope(diffuse * material.albedo + specular, pixel.radiance);
            for (r, c) in responses.iter().zip(columns) {
                let by = scale * by_pixel * (r.diffuse * material.albedo + r.specular);
                by_light.column_mut(c).copy_from_slice(&by.to_array());
            }
            out.push(MaterialSlope {
                by_albedo: by_pixel * diffuse,
                by_roughness: by_pixel.dot(slope),
            });
        }
        self.learner.network.backward(&trace, by_light, gradient);
        out
    }
}

/// Pixels and what they are made of.
#[derive(Clone, Copy)]
struct Seen<'a> {
    pixels: &'a [Pixel],
    materials: &'a [Material],
}

impl Lighting for IncidentLight {
    fn compare(
        &mut self,
        pixels: &[Pixel],
        materials: &[Material],
        key: u64,
    ) -> Vec<MaterialSlope> {
        let seen = Seen { pixels, materials };
        let together = (COLUMNS / self.directions).max(1);
        let key = hash_u64(key, 0x11f);
        let sum = sum_gradient(
            self.learner.gradient.len(),
            pixels.len(),
            |range, gradient| {
                let mut out = Vec::with_capacity(range.len());
                for start in range.clone().step_by(together) {
                    let few = start..(start + together).min(range.end);
                    out.extend(self.block(seen, few, key, gradient));
                }
                out
            },
        );
        self.learner.gradient = sum.gradient;
        sum.values
    }

    fn step(&mut self, now: Moment) {
        self.learner.step(rate(now, self.handicapped));
    }

    fn rays(&self, _: usize) -> u64 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::network::slope_along;
    use crate::published::place::test_points;

    fn materials(n: usize) -> Vec<Material> {
        let mut rng = KeyedRng::new(2, 7);
        let mut material = || Material {
            albedo: Vec3::splat(0.2 + 0.6 * rng.next_f32()),
            roughness: 0.2 + 0.6 * rng.next_f32(),
        };
        (0..n).map(|_| material()).collect()
    }

    #[test]
    fn slopes_by_light_and_materials_are_those_of_the_loss() {
        let (points, _) = test_points(12, 1.0);
        let mut made = materials(12);
        let mut light = IncidentLight::new(Place::of_points(&points), Loss::Squared, true, 5);
        let key = hash_u64(3, 0x11f);
        // the mean squared difference, pixel by pixel and direction by direction
        let objective = |light: &IncidentLight, made: &[Material]| -> f64 {
            let mut sum = 0.0;
            for i in 0..points.len() {
                let (x, local) = light.gathered(&points, i..i + 1, key);
                let radiance = light.learner.network.forward(&x).output;
                let view =
                    Frame::from_normal(points[i].normal).local_from_world(points[i].to_camera);
                let mut shown = Vec3::ZERO;
                for (c, direction) in local.iter().enumerate() {
                    let r = light.response(*direction, view, made[i].roughness);
                    let l = Vec3::from_slice(radiance.column(c).as_slice());
                    shown += l * (r.diffuse * made[i].albedo + r.specular);
                }
                for k in 0..3 {
                    let off = shown[k].ln_1p() - points[i].radiance[k].ln_1p();
                    sum += f64::from(off * off) / (3.0 * points.len() as f64);
                }
            }
            sum
        };
        let slopes = light.compare(&points, &made, 3);
        let gradient = light.learner.gradient.clone();
        let ratio = slope_along(&gradient, 1e-3, |step| {
            light.learner.move_along(&gradient, step);
            objective(&light, &made)
        });
        assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
        let share = 1.0 / 36.0;
        for i in 0..points.len() {
            let d = 1e-2;
            let mut at = |by_albedo: f32, by_roughness: f32| {
                let before = made[i];
                made[i].albedo.x += by_albedo;
                made[i].roughness += by_roughness;
                let value = objective(&light, &made);
                made[i] = before;
                value
            };
            let by_albedo = (at(d, 0.0) - at(-d, 0.0)) / f64::from(2.0 * d);
            let by_roughness = (at(0.0, d) - at(0.0, -d)) / f64::from(2.0 * d);
            let close =
                |a: f64, b: f32| (a - f64::from(share * b)).abs() < 2e-3 * a.abs().max(0.05);
            assert!(close(by_albedo, slopes[i].by_albedo.x), "{i}: {by_albedo}");
            assert!(
                close(by_roughness, slopes[i].by_roughness),
                "{i}: {by_roughness}"
            );
        }
    }
}
