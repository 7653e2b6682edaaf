//! The materials of NVDIFFREC (Munkberg et al., CVPR 2022, Sec. 3 and supplement): a multiresolution
//! hash grid and a small perceptron. Regulariser: λ |A(x + ξ) − A(x)| with ξ normal in space,
//! faded in over the first steps.

use super::pixels::Pixel;
use super::place::{Place, normal};
use super::strategy::{MaterialSlope, Moment, Strategy, material};
use crate::core::brdf::Material;
use crate::core::math::sign;
use crate::core::network::{
    Activation, Adam, BLOCK, HashGrid, Learner, Shape, Trace, sum_gradient,
};
use crate::core::parallel::map_chunks;
use crate::core::sampling::{KeyedRng, hash_u64};
use glam::Vec3;
use nalgebra::DMatrix;
use std::ops::Range;

/// The grid: levels, cells along the axes of the coarsest and finest, entries (cited: method §7.2).
const LEVELS: usize = 16;
const CELLS: [u32; 2] = [16, 4096];
const ENTRIES: usize = 1 << 19;
/// R = 0.01 + 0.99 s (cited: method §7.2).
const ROUGHNESS: [f32; 2] = [0.01, 0.99];
/// Weight of smoothness, deviation of ξ in metres (cited: method §7.2).
const SMOOTHNESS: f32 = 0.03;
const JITTER: f32 = 0.01;
/// Steps until smoothness counts in full: the authors' trainer, and the comparison (method §7.2).
const FADE: [f32; 2] = [500.0, 100.0];
/// Step of Adam; it grows over so many steps and then decays by a factor each (cited: method §7.2).
const RATE: f32 = 1e-2;
const WARM_UP: f32 = 100.0;
const DECAY_EXPONENT: f32 = -2e-4;

/// A hash grid and its decoder.
pub struct NvDiffRec {
    place: Place,
    grid: HashGrid,
    adam: Adam,
    /// Of the grid.
    gradient: Vec<f32>,
    decoder: Learner,
    handicapped: bool,
}

/// Points as the grid knows them, and what was decoded there.
struct Decoded {
    places: Vec<Vec3>,
    trace: Trace,
}

/// Slopes by the grid's features.
struct Features {
    places: Vec<Vec3>,
    slopes: Vec<f32>,
}

impl NvDiffRec {
    /// A random grid. `handicapped`: steps are counted in epochs, so that a run is warm-up, as in
    /// the comparison of TexIR's authors.
    #[must_use]
    pub fn new(place: Place, handicapped: bool, seed: u64) -> Self {
        let grid = HashGrid::new(LEVELS, CELLS[0], CELLS[1], ENTRIES, seed);
        let shape = Shape {
            inputs: grid.outputs(),
            hidden: vec![32; 2],
            outputs: 4,
            activation: Activation::Rectifier(0.0),
            last: Activation::Sigmoid,
            join: None,
            biased: false,
            start: None,
        };
        let size = grid.parameters().len();
        Self {
            place,
            adam: Adam::new(size),
            gradient: vec![0.0; size],
            grid,
            decoder: Learner::new(&shape, hash_u64(seed, 1)),
            handicapped,
        }
    }

    /// Decodes positions in metres.
    fn decode(&self, positions: impl Iterator<Item = Vec3>) -> Decoded {
        let places: Vec<Vec3> = positions
            .map(|p| 0.5 * (self.place.normalised(p) + 1.0))
            .collect();
        let width = self.grid.outputs();
        let mut x = DMatrix::zeros(width, places.len());
        for (column, p) in x.as_mut_slice().chunks_mut(width).zip(&places) {
            self.grid.encode(*p, column);
        }
        Decoded {
            places,
            trace: self.decoder.network.forward(&x),
        }
    }

    /// The weight of smoothness at a step.
    fn smoothness(&self, now: Moment) -> f32 {
        SMOOTHNESS * (now.step as f32 / FADE[usize::from(self.handicapped)]).min(1.0)
    }

    /// The step of Adam.
    fn rate(&self, now: Moment) -> f32 {
        let t = if self.handicapped {
            now.epoch
        } else {
            now.step
        } as f32;
        if t < WARM_UP {
            RATE * t / WARM_UP
        } else {
            RATE * 10f32.powf(DECAY_EXPONENT * (t - WARM_UP))
        }
    }

    /// Adds the decoder's gradient for a block of points; returns the slopes by features.
    fn block(
        &self,
        points: &[Pixel],
        slopes: &[MaterialSlope],
        range: Range<usize>,
        jitter: Jitter,
        gradient: &mut [f32],
    ) -> Vec<Features> {
        let own = self.decode(points[range.clone()].iter().map(|p| p.position));
        let moved = self.decode(range.clone().map(|i| points[i].position + jitter.of(i)));
        let share = jitter.weight / (3.0 * points.len() as f32);
        let (mut by_own, mut by_moved) = (
            DMatrix::zeros(4, range.len()),
            DMatrix::zeros(4, range.len()),
        );
        for (c, i) in range.enumerate() {
            for k in 0..3 {
                let off = own.trace.output[(k, c)] - moved.trace.output[(k, c)];
                let rough = share * sign(off);
                by_own[(k, c)] = slopes[i].by_albedo[k] + rough;
                by_moved[(k, c)] = -rough;
            }
            by_own[(3, c)] = ROUGHNESS[1] * slopes[i].by_roughness;
        }
        [(own, by_own), (moved, by_moved)]
            .into_iter()
            .map(|(at, by)| Features {
                slopes: self
                    .decoder
                    .network
                    .backward(&at.trace, by, gradient)
                    .as_slice()
                    .to_vec(),
                places: at.places,
            })
            .collect()
    }
}

/// Where neighbours of points lie, and how much their likeness counts.
#[derive(Clone, Copy)]
struct Jitter {
    key: u64,
    weight: f32,
}

impl Jitter {
    fn of(self, i: usize) -> Vec3 {
        let mut rng = KeyedRng::new(self.key, i as u64);
        JITTER * Vec3::from_array(std::array::from_fn(|_| normal(&mut rng)))
    }
}

impl Strategy for NvDiffRec {
    fn materials(&mut self, points: &[Pixel]) -> Vec<Material> {
        let parts = map_chunks(points.len(), BLOCK, |range| {
            let at = self.decode(points[range].iter().map(|p| p.position));
            let of = |s: &[f32]| material(s, 3, ROUGHNESS);
            let columns = at.trace.output.column_iter();
            columns.map(|s| of(s.as_slice())).collect::<Vec<Material>>()
        });
        parts.concat()
    }

    fn adjoint(&mut self, points: &[Pixel], slopes: &[MaterialSlope], now: Moment, key: u64) {
        let jitter = Jitter {
            key,
            weight: self.smoothness(now),
        };
        let sum = sum_gradient(
            self.decoder.gradient.len(),
            points.len(),
            |range, gradient| self.block(points, slopes, range, jitter, gradient),
        );
        self.decoder.gradient = sum.gradient;
        let places: Vec<Vec3> = sum.values.iter().flat_map(|f| f.places.clone()).collect();
        let by: Vec<f32> = sum.values.iter().flat_map(|f| f.slopes.clone()).collect();
        self.grid.backward(&places, &by, &mut self.gradient);
    }

    fn step(&mut self, now: Moment) {
        let rate = self.rate(now);
        self.adam
            .sparse_step(self.grid.parameters_mut(), &self.gradient, rate);
        self.gradient.fill(0.0);
        self.decoder.step(rate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::network::slope_along;
    use crate::published::place::test_points;

    #[test]
    fn slopes_are_those_of_materials_and_smoothness() {
        // with the fit to photographs, and smoothness alone
        for fit in [1.0, 0.0] {
            check_slopes(fit);
        }
    }

    fn check_slopes(fit: f32) {
        let (points, slopes) = test_points(40, fit);
        let mut peer = NvDiffRec::new(Place::of_points(&points), false, 3);
        // features as large as training makes them
        for f in peer.grid.parameters_mut() {
            *f *= 1e3;
        }
        let now = Moment {
            step: 250,
            ..Moment::default()
        };
        let jitter = Jitter {
            key: 4,
            weight: peer.smoothness(now),
        };
        assert!((jitter.weight / SMOOTHNESS - 0.5).abs() < 1e-6);
        let objective = |peer: &mut NvDiffRec| -> f64 {
            let materials = peer.materials(&points);
            let neighbours: Vec<Pixel> = (0..points.len())
                .map(|i| Pixel {
                    position: points[i].position + jitter.of(i),
                    ..points[i]
                })
                .collect();
            let moved = peer.materials(&neighbours);
            let value = |i: usize| {
                let (m, s) = (materials[i], slopes[i]);
                let rough = (m.albedo - moved[i].albedo).abs().element_sum();
                f64::from(m.albedo.dot(s.by_albedo) + m.roughness * s.by_roughness)
                    + f64::from(jitter.weight * rough) / (3 * points.len()) as f64
            };
            (0..points.len()).map(value).sum()
        };
        peer.adjoint(&points, &slopes, now, jitter.key);
        // of the grid and of the decoder, each alone
        for part in 0..2 {
            let gradient = match part {
                0 => peer.gradient.clone(),
                _ => peer.decoder.gradient.clone(),
            };
            let ratio = slope_along(&gradient, 1e-2, |step| {
                let values = match part {
                    0 => peer.grid.parameters_mut(),
                    _ => peer.decoder.network.parameters_mut(),
                };
                let pairs = values.iter_mut().zip(&gradient);
                pairs.for_each(|(v, s)| *v += step * s);
                objective(&mut peer)
            });
            assert!((ratio - 1.0).abs() < 0.03, "part {part}: {ratio}");
        }
    }

    #[test]
    fn steps_warm_up_and_decay_and_the_handicap_never_leaves_the_warm_up() {
        let place = Place::of_box(Vec3::ZERO, Vec3::ONE);
        let (own, slow) = (
            NvDiffRec::new(place, false, 1),
            NvDiffRec::new(place, true, 1),
        );
        let at = |step| Moment {
            epoch: step / 24,
            step,
            ..Moment::default()
        };
        assert_eq!(own.rate(at(0)), 0.0);
        assert_eq!(own.rate(at(100)), RATE);
        assert!((own.rate(at(5100)) / RATE - 0.1).abs() < 1e-3);
        assert!(slow.rate(at(2399)) < RATE);
    }
}
