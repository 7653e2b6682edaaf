//! The materials of InvRender (Zhang et al., CVPR 2022, "Modeling Indirect Illumination for Inverse
//! Rendering", Sec. 3.3): a perceptron encodes a place as a sparse code, another one decodes the
//! code, so that all places share few materials.
//!
//! Regularisers: codes are sparse, Σ_k KL(ρ ‖ mean z_k) with ρ = 0.05 over the batch, and materials
//! are smooth in the code, |D(z) − D(z + ξ)| with ξ normal.

use super::pixels::Pixel;
use super::place::{Place, normal};
use super::strategy::{MaterialSlope, Moment, Strategy, material};
use crate::core::brdf::Material;
use crate::core::math::sign;
use crate::core::network::{Activation, BLOCK, Learner, Shape, encoded_size, sum_gradient};
use crate::core::parallel::map_chunks;
use crate::core::sampling::{KeyedRng, hash_u64};
use nalgebra::DMatrix;

/// Octaves of the encoding, numbers of a code (cited: method §7.2, as are all constants here).
const OCTAVES: usize = 10;
const CODE: usize = 32;
/// ρ, the mean that the parts of a code are drawn to.
const SPARSE: f32 = 0.05;
/// Weights of sparseness and smoothness, and the standard deviation of ξ.
const SPARSENESS: f32 = 0.01;
const SMOOTHNESS: f32 = 0.1;
const NOISE: f32 = 0.01;
/// R = 0.09 + 0.9 s.
const ROUGHNESS: [f32; 2] = [0.09, 0.9];
/// Step of Adam; the comparison's decay and its period in epochs.
const RATE: f32 = 5e-4;
const DECAY: f32 = 0.8;
const PERIOD: u32 = 20;
/// A mean of codes is kept this far from 0 and 1, where KL is infinite.
const MARGIN: f32 = 1e-4;

/// Sparse codes and their decoder.
pub struct InvRender {
    place: Place,
    encoder: Learner,
    decoder: Learner,
    /// Mean code of the points that materials were last asked for.
    mean: Vec<f32>,
    handicapped: bool,
}

impl InvRender {
    /// Random networks. `handicapped`: sparseness is a mean over the parts of a code instead of
    /// their sum, and steps decay, as in the comparison of TexIR's authors.
    #[must_use]
    pub fn new(place: Place, handicapped: bool, seed: u64) -> Self {
        let shape = |inputs, hidden: &[usize], outputs| Shape {
            inputs,
            hidden: hidden.to_vec(),
            outputs,
            activation: Activation::Rectifier(0.2),
            last: Activation::Sigmoid,
            join: None,
            biased: true,
            start: None,
        };
        let inputs = encoded_size(OCTAVES);
        Self {
            place,
            encoder: Learner::new(&shape(inputs, &[512; 4], CODE), seed),
            decoder: Learner::new(&shape(CODE, &[128; 2], 4), hash_u64(seed, 1)),
            mean: vec![SPARSE; CODE],
            handicapped,
        }
    }

    /// Derivative of the weighted Σ KL(ρ ‖ mean) by each mean.
    fn sparseness_slopes(&self) -> Vec<f32> {
        let parts = if self.handicapped { CODE as f32 } else { 1.0 };
        let slope = |m: &f32| {
            let m = m.clamp(MARGIN, 1.0 - MARGIN);
            SPARSENESS / parts * ((1.0 - SPARSE) / (1.0 - m) - SPARSE / m)
        };
        self.mean.iter().map(slope).collect()
    }
}

impl Strategy for InvRender {
    fn materials(&mut self, points: &[Pixel]) -> Vec<Material> {
        let parts = map_chunks(points.len(), BLOCK, |range| {
            let x = self.place.encoded(&points[range], OCTAVES);
            let z = self.encoder.network.forward(&x).output;
            let s = self.decoder.network.forward(&z).output;
            let materials: Vec<Material> = s
                .column_iter()
                .map(|s| material(s.as_slice(), 3, ROUGHNESS))
                .collect();
            (materials, z.column_sum())
        });
        let mut mean = vec![0.0; CODE];
        let mut materials = Vec::with_capacity(points.len());
        for (of_part, sum) in parts {
            mean.iter_mut()
                .zip(sum.iter())
                .for_each(|(m, s)| *m += s / points.len() as f32);
            materials.extend(of_part);
        }
        self.mean = mean;
        materials
    }

    fn adjoint(&mut self, points: &[Pixel], slopes: &[MaterialSlope], _: Moment, key: u64) {
        let sparseness = self.sparseness_slopes();
        let n = points.len() as f32;
        let [encoder, decoder] = [&self.encoder.network, &self.decoder.network];
        let sizes = [encoder, decoder].map(|n| n.parameters().len());
        let sum = sum_gradient(sizes[0] + sizes[1], points.len(), |range, gradient| {
            let (of_encoder, of_decoder) = gradient.split_at_mut(sizes[0]);
            let x = self.place.encoded(&points[range.clone()], OCTAVES);
            let encoded = encoder.forward(&x);
            let mut moved = encoded.output.clone();
            for (column, i) in moved.as_mut_slice().chunks_mut(CODE).zip(range.clone()) {
                let mut rng = KeyedRng::new(key, i as u64);
                column
                    .iter_mut()
                    .for_each(|z| *z += NOISE * normal(&mut rng));
            }
            let decoded = decoder.forward(&encoded.output);
            let neighbour = decoder.forward(&moved);
            let smooth = (&decoded.output - &neighbour.output).map(|d| {
                let share = SMOOTHNESS / (4.0 * n);
                share * sign(d)
            });
            let mut by_output = smooth.clone();
            for (column, i) in by_output.as_mut_slice().chunks_mut(4).zip(range) {
                let by_albedo = slopes[i].by_albedo.to_array();
                column.iter_mut().zip(by_albedo).for_each(|(c, s)| *c += s);
                column[3] += ROUGHNESS[1] * slopes[i].by_roughness;
            }
            let mut by_code: DMatrix<f32> = decoder.backward(&decoded, by_output, of_decoder);
            by_code += decoder.backward(&neighbour, -smooth, of_decoder);
            for column in by_code.as_mut_slice().chunks_mut(CODE) {
                let pairs = column.iter_mut().zip(&sparseness);
                pairs.for_each(|(z, s)| *z += s / n);
            }
            encoder.backward(&encoded, by_code, of_encoder);
            Vec::<()>::new()
        });
        let (of_encoder, of_decoder) = sum.gradient.split_at(sizes[0]);
        self.encoder.gradient = of_encoder.to_vec();
        self.decoder.gradient = of_decoder.to_vec();
    }

    fn step(&mut self, now: Moment) {
        let rate = if self.handicapped {
            RATE * DECAY.powi((now.epoch / PERIOD) as i32)
        } else {
            RATE
        };
        self.encoder.step(rate);
        self.decoder.step(rate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::network::slope_along;
    use crate::published::place::test_points;

    #[test]
    fn slopes_are_those_of_materials_and_regularisers() {
        // with the fit to photographs, and the regularisers alone
        for (handicapped, fit) in [(false, 1.0), (true, 1.0), (false, 0.0), (true, 0.0)] {
            let (points, slopes) = test_points(40, fit);
            let mut peer = InvRender::new(Place::of_points(&points), handicapped, 3);
            let key = 9;
            let objective = |peer: &mut InvRender| -> f64 {
                let materials = peer.materials(&points);
                let mut value: f64 = materials.iter().zip(&slopes).map(fitted).sum();
                let x = peer.place.encoded(&points, OCTAVES);
                let z = peer.encoder.network.forward(&x).output;
                let mut moved = z.clone();
                for i in 0..points.len() {
                    let mut rng = KeyedRng::new(key, i as u64);
                    (0..CODE).for_each(|k| moved[(k, i)] += NOISE * normal(&mut rng));
                }
                let a = peer.decoder.network.forward(&z).output;
                let b = peer.decoder.network.forward(&moved).output;
                let rough: f32 = a.iter().zip(b.iter()).map(|(a, b)| (a - b).abs()).sum();
                value += f64::from(SMOOTHNESS * rough) / (4 * points.len()) as f64;
                let kl: f64 = (0..CODE)
                    .map(|k| {
                        let m = f64::from(z.row(k).mean());
                        let p = f64::from(SPARSE);
                        p * (p / m).ln() + (1.0 - p) * ((1.0 - p) / (1.0 - m)).ln()
                    })
                    .sum();
                let parts = if handicapped { CODE as f64 } else { 1.0 };
                value + f64::from(SPARSENESS) * kl / parts
            };
            objective(&mut peer);
            peer.adjoint(&points, &slopes, Moment::default(), key);
            let [of_encoder, of_decoder] =
                [&peer.encoder, &peer.decoder].map(|l| l.gradient.clone());
            let gradient = [&of_encoder[..], &of_decoder].concat();
            let ratio = slope_along(&gradient, 1e-2, |step| {
                peer.encoder.move_along(&of_encoder, step);
                peer.decoder.move_along(&of_decoder, step);
                objective(&mut peer)
            });
            assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        }
    }

    fn fitted((m, s): (&Material, &MaterialSlope)) -> f64 {
        f64::from(m.albedo.dot(s.by_albedo) + m.roughness * s.by_roughness)
    }
}
