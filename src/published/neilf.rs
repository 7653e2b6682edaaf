//! The materials of NeILF (Yao et al., ECCV 2022, "Neural Incident Light Field for Physically-based
//! Material Estimation", Secs. 3.2 and 3.4): one perceptron of sines over encoded positions.
//!
//! Regularisers: surface is taken to be Lambertian where nothing speaks against it, |R − 1|, and
//! roughness to be smooth where the photograph is, |∇R| e^(−|∇I|). The gradient of R is a
//! difference over a step in a random direction along the surface; its mean over directions is
//! 2/π |∇R|. Every fourth point tells of it for the others: a neighbour costs as much as a point.

use super::pixels::Pixel;
use super::place::Place;
use super::strategy::{MaterialSlope, Moment, Strategy, material};
use crate::core::brdf::Material;
use crate::core::math::{Frame, sign};
use crate::core::network::{Activation, BLOCK, Join, Learner, Shape, encoded_size, sum_gradient};
use crate::core::parallel::map_chunks;
use crate::core::sampling::KeyedRng;
use glam::Vec3;
use nalgebra::DMatrix;
use std::f32::consts::{FRAC_PI_2, TAU};

/// Octaves of the encoding, and the layer before which it enters again (cited: method §7.2).
const OCTAVES: usize = 6;
pub(super) const JOIN: usize = 4;
/// R = 0.01 + 0.99 s: [0, 1] as published, and no mirror that rays could not sample.
const ROUGHNESS: [f32; 2] = [0.01, 0.99];
/// Weights of the Lambertian prior, own (its release's, there for metals) and in the comparison;
/// and of smoothness (cited: method §7.2).
const LAMBERTIAN: [f32; 2] = [5e-3, 5e-4];
const SMOOTHNESS: f32 = 5e-4;
/// One point in so many has a neighbour (derived: the mean stays what it is).
const THINNING: usize = 4;
/// Step of ∇R, of the scene's half size: 1 cm in a room of 10 m (derived).
const STEP: f32 = 2e-3;
/// Step of Adam, its factor, and the two shares of a run after which that is applied: thirds of the
/// authors' 30,000 steps, twice epoch 20 of 51 in the comparison (cited: method §7.2).
const RATE: f32 = 2e-3;
const DROP: f32 = 0.2;
const DROPS: [[f32; 2]; 2] = [[1.0 / 3.0, 2.0 / 3.0], [20.0 / 51.0; 2]];

/// The step of Adam of all NeILF's networks.
#[must_use]
pub(super) fn rate(now: Moment, handicapped: bool) -> f32 {
    let drops = DROPS[usize::from(handicapped)].iter();
    let over = drops.filter(|d| now.share() >= **d).count();
    RATE * DROP.powi(over as i32)
}

/// Widths of the hidden layers: what enters at the join takes the place of as many outputs.
#[must_use]
pub(super) fn widths(width: usize, joined: usize) -> Vec<usize> {
    let mut widths = vec![width; 8];
    widths[JOIN - 1] -= joined;
    widths
}

/// A perceptron of materials.
pub struct Neilf {
    place: Place,
    learner: Learner,
    handicapped: bool,
}

impl Neilf {
    /// A random network. `handicapped`: roughness is the red of albedo, its prior is weak and steps
    /// drop early, as in the comparison of TexIR's authors.
    #[must_use]
    pub fn new(place: Place, handicapped: bool, seed: u64) -> Self {
        let inputs = encoded_size(OCTAVES);
        let shape = Shape {
            inputs,
            hidden: widths(512, inputs),
            outputs: 4,
            activation: Activation::Sine,
            last: Activation::HalfTanh,
            join: Some(Join {
                layer: JOIN,
                rows: 0..inputs,
            }),
            biased: true,
            start: Some(0.0),
        };
        Self {
            place,
            learner: Learner::new(&shape, seed),
            handicapped,
        }
    }

    /// The output that roughness is read from.
    fn channel(&self) -> usize {
        if self.handicapped { 0 } else { 3 }
    }

    /// A neighbour of a point on the surface.
    fn neighbour(&self, point: &Pixel, key: u64, i: usize) -> Pixel {
        let angle = TAU * KeyedRng::new(key, i as u64).next_f32();
        let (sin, cos) = angle.sin_cos();
        let along = Frame::from_normal(point.normal).world_from_local(Vec3::new(cos, sin, 0.0));
        Pixel {
            position: point.position + along * self.place.metres(STEP),
            ..*point
        }
    }
}

/// Weight of |R(x) − R(neighbour)|: of |∇R| in units of the scene's half size.
fn smoothness(point: &Pixel) -> f32 {
    THINNING as f32 * SMOOTHNESS * FRAC_PI_2 / STEP * (-point.contrast).exp()
}

impl Strategy for Neilf {
    fn materials(&mut self, points: &[Pixel]) -> Vec<Material> {
        let parts = map_chunks(points.len(), BLOCK, |range| {
            let x = self.place.encoded(&points[range], OCTAVES);
            let output = self.learner.network.forward(&x).output;
            let of = |s: &[f32]| material(s, self.channel(), ROUGHNESS);
            let columns = output.column_iter();
            columns.map(|s| of(s.as_slice())).collect::<Vec<Material>>()
        });
        parts.concat()
    }

    fn adjoint(&mut self, points: &[Pixel], slopes: &[MaterialSlope], _: Moment, key: u64) {
        let (n, network) = (points.len() as f32, &self.learner.network);
        let channel = self.channel();
        let prior = LAMBERTIAN[usize::from(self.handicapped)] * ROUGHNESS[1] / n;
        let sum = sum_gradient(
            self.learner.gradient.len(),
            points.len(),
            |range, gradient| {
                // blocks begin at multiples of the thinning
                let neighbours: Vec<Pixel> = range
                    .clone()
                    .step_by(THINNING)
                    .map(|i| self.neighbour(&points[i], key, i))
                    .collect();
                let own = network.forward(&self.place.encoded(&points[range.clone()], OCTAVES));
                let moved = network.forward(&self.place.encoded(&neighbours, OCTAVES));
                let mut by_own = DMatrix::zeros(4, range.len());
                let mut by_moved = DMatrix::zeros(4, neighbours.len());
                for (c, i) in range.enumerate() {
                    for k in 0..3 {
                        by_own[(k, c)] = slopes[i].by_albedo[k];
                    }
                    // R never exceeds 1, so that |R − 1| falls as R grows
                    by_own[(channel, c)] += ROUGHNESS[1] * slopes[i].by_roughness - prior;
                    if c.is_multiple_of(THINNING) {
                        let next = c / THINNING;
                        let off = own.output[(channel, c)] - moved.output[(channel, next)];
                        let rough = smoothness(&points[i]) * ROUGHNESS[1] / n * sign(off);
                        by_own[(channel, c)] += rough;
                        by_moved[(channel, next)] = -rough;
                    }
                }
                network.backward(&own, by_own, gradient);
                network.backward(&moved, by_moved, gradient);
                Vec::<()>::new()
            },
        );
        self.learner.gradient = sum.gradient;
    }

    fn step(&mut self, now: Moment) {
        self.learner.step(rate(now, self.handicapped));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::math::signs;
    use crate::core::network::slope_along;
    use crate::published::place::test_points;

    #[test]
    fn slopes_are_those_of_materials_and_regularisers() {
        // with the fit to photographs, and the regularisers alone
        for (handicapped, fit) in [(false, 1.0), (true, 1.0), (false, 0.0), (true, 0.0)] {
            let (points, slopes) = test_points(30, fit);
            let mut peer = Neilf::new(Place::of_points(&points), handicapped, 3);
            let key = 4;
            let objective = |peer: &mut Neilf| -> f64 {
                let materials = peer.materials(&points);
                let neighbours: Vec<Pixel> = (0..points.len())
                    .map(|i| peer.neighbour(&points[i], key, i))
                    .collect();
                let moved = peer.materials(&neighbours);
                let value = |i: usize| {
                    let (m, s) = (materials[i], slopes[i]);
                    let rough = if i.is_multiple_of(THINNING) {
                        (m.roughness - moved[i].roughness).abs()
                    } else {
                        0.0
                    };
                    let lambertian = LAMBERTIAN[usize::from(handicapped)];
                    f64::from(m.albedo.dot(s.by_albedo) + m.roughness * s.by_roughness)
                        + f64::from(
                            smoothness(&points[i]) * rough + lambertian * (m.roughness - 1.0).abs(),
                        ) / points.len() as f64
                };
                (0..points.len()).map(value).sum()
            };
            peer.adjoint(&points, &slopes, Moment::default(), key);
            let gradient = peer.learner.gradient.clone();
            // (short: |R − R'| of neighbours has its kink within a thousandth)
            let ratio = slope_along(&gradient, 1e-4, |step| {
                peer.learner.move_along(&gradient, step);
                objective(&mut peer)
            });
            assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
        }
    }

    /// The plain check that a network learns: told the albedo and roughness of every point, it comes
    /// near them within few steps.
    #[test]
    fn a_known_texture_is_learned() {
        let (points, _) = test_points(256, 1.0);
        let place = Place::of_points(&points);
        let known = |p: &Pixel| {
            let x = place.normalised(p.position);
            Material {
                albedo: 0.5 + 0.3 * Vec3::from_array((3.0 * x).to_array().map(f32::sin)),
                roughness: if x.x + x.y > 0.0 { 0.8 } else { 0.3 },
            }
        };
        let mut peer = Neilf::new(place, false, 3);
        let mut errors = Vec::new();
        let steps = 60;
        for step in 0..=steps {
            let now = Moment {
                epoch: step,
                epochs: steps,
                step,
            };
            let share = 1.0 / (3.0 * points.len() as f32);
            let mut error = 0.0;
            let slopes: Vec<MaterialSlope> = peer
                .materials(&points)
                .iter()
                .zip(&points)
                .map(|(m, p)| {
                    let off = m.albedo - known(p).albedo;
                    let rough = m.roughness - known(p).roughness;
                    error += share * (off.abs().element_sum() + rough.abs());
                    MaterialSlope {
                        by_albedo: share * signs(off),
                        by_roughness: share * sign(rough),
                    }
                })
                .collect();
            errors.push(error);
            peer.adjoint(&points, &slopes, now, u64::from(step));
            peer.step(now);
        }
        let (first, last) = (errors[0], errors[steps as usize]);
        assert!(last < 0.2 * first, "{first} {last}");
    }

    #[test]
    fn steps_shrink_at_thirds_of_a_run_or_twice_at_once() {
        let at = |epoch, handicapped| {
            let now = Moment {
                epoch,
                epochs: 51,
                step: 0,
            };
            (rate(now, handicapped) / RATE * 1e4).round() / 1e4
        };
        assert_eq!(
            [0, 16, 17, 33, 34].map(|e| at(e, false)),
            [1.0, 1.0, 0.2, 0.2, 0.04]
        );
        assert_eq!([19, 20, 50].map(|e| at(e, true)), [1.0, 0.04, 0.04]);
    }
}
