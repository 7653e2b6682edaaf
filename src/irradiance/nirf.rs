//! The neural irradiance field (NIrF), the paper's alternative to the irradiance texture (method
//! §3.2), for comparison.
//!
//! A perceptron maps a position (metres; NeRF's encoding with 10 octaves and the identity, 63
//! numbers) through four hidden layers of 512 with leaky rectifiers to log(1 + E). Every epoch
//! draws 1024 points uniformly by area, 1 cm above the surface, estimates their irradiance with
//! 2048 uniform rays each, and takes 64 steps of Adam over batches of 16 with an L1 loss in log(1 +
//! E).

use super::{Bake, Estimator, IrradianceOptions, Receiver, bake_irradiance};
use crate::core::math::sign;
use crate::core::network::{Activation, Adam, BLOCK, Mlp, Shape, encoded, encoded_size};
use crate::core::parallel::map_chunks;
use crate::core::progress::Progress;
use crate::core::sampling::{Discrete, KeyedRng, square_to_triangle};
use crate::lights::LitScene;
use glam::Vec3;
use nalgebra::DMatrix;
use std::time::Instant;

/// Samples per batch (cited: method §3.2).
const BATCH: usize = 16;
/// Octaves of the encoding (cited: the same).
const OCTAVES: usize = 10;
/// Slope of the rectifier below zero (cited: the same).
const LEAK: f32 = 0.01;
/// Distance of training points from the surface, metres (cited: the same).
const HEIGHT: f32 = 0.01;

/// Options of the training; the defaults are the paper's.
#[derive(Clone, Debug, PartialEq)]
pub struct NirfOptions {
    /// Epochs.
    pub epochs: u32,
    /// Points per epoch, a multiple of `BATCH`.
    pub points: usize,
    /// Rays per point.
    pub rays: u32,
    /// Step size of Adam.
    pub learning_rate: f32,
    /// Hidden layers' widths.
    pub hidden: Vec<usize>,
    /// Seed of weights and points.
    pub seed: u64,
}

impl Default for NirfOptions {
    fn default() -> Self {
        Self {
            epochs: 2000,
            points: 1024,
            rays: 2048,
            learning_rate: 1e-4,
            hidden: vec![512; 4],
            seed: 666,
        }
    }
}

impl NirfOptions {
    /// The paper's, for so many epochs; `seed` is the run's.
    #[must_use]
    pub fn of_run(epochs: u32, seed: u64) -> Self {
        let paper = Self::default();
        Self {
            epochs,
            seed: paper.seed ^ seed,
            ..paper
        }
    }
}

/// What a training cost.
#[derive(Clone, Copy, Debug, Default)]
pub struct NirfCost {
    /// Epochs done.
    pub epochs: u32,
    /// Rays traced.
    pub rays: u64,
    /// Seconds spent on targets.
    pub ray_seconds: f64,
    /// Seconds spent on steps.
    pub step_seconds: f64,
    /// Mean loss of the last epoch.
    pub loss: f64,
}

/// A neural irradiance field.
#[derive(Clone, Debug)]
pub struct Nirf {
    network: Mlp,
}

impl Nirf {
    /// A field with random weights and no bias.
    #[must_use]
    pub fn new(hidden: &[usize], seed: u64) -> Self {
        let shape = Shape {
            inputs: encoded_size(OCTAVES),
            hidden: hidden.to_vec(),
            outputs: 3,
            activation: Activation::Rectifier(LEAK),
            last: Activation::Linear,
            join: None,
            biased: true,
            start: None,
        };
        Self {
            network: Mlp::new(&shape, seed),
        }
    }

    /// Irradiance at surface points with unit normals on the lit side.
    #[must_use]
    pub fn irradiance(&self, points: &[(Vec3, Vec3)]) -> Vec<Vec3> {
        let parts = map_chunks(points.len(), BLOCK, |range| {
            let positions: Vec<Vec3> = points[range]
                .iter()
                .map(|(p, n)| *p + *n * HEIGHT)
                .collect();
            let y = self
                .network
                .forward(&encoded(positions.into_iter(), OCTAVES))
                .output;
            y.column_iter()
                .map(|y| Vec3::new(y[0], y[1], y[2]).exp() - Vec3::ONE)
                .collect::<Vec<Vec3>>()
        });
        parts.concat()
    }

    /// Loss of a batch (mean |log(1+E) − y| over samples and channels) and its slopes.
    fn slopes(&self, positions: &[Vec3], targets: &[Vec3]) -> (f64, Vec<f32>) {
        let count = 3.0 * positions.len() as f32;
        let x = encoded(positions.iter().copied(), OCTAVES);
        let trace = self.network.forward(&x);
        let off = DMatrix::from_fn(3, targets.len(), |c, b| {
            trace.output[(c, b)] - targets[b][c].ln_1p()
        });
        let loss = off.iter().map(|d| f64::from(d.abs())).sum::<f64>() / f64::from(count);
        let mut slopes = vec![0.0; self.network.parameters().len()];
        self.network
            .backward(&trace, off.map(|d| sign(d) / count), &mut slopes);
        (loss, slopes)
    }
}

/// A field and what Adam remembers of its steps.
struct Training {
    field: Nirf,
    adam: Adam,
}

impl Training {
    fn begin(options: &NirfOptions) -> Self {
        let field = Nirf::new(&options.hidden, options.seed);
        Self {
            adam: Adam::new(field.network.parameters().len()),
            field,
        }
    }

    /// One epoch at a learning rate, batch by batch; returns the mean loss.
    fn epoch(&mut self, positions: &[Vec3], targets: &[Vec3], rate: f32) -> f64 {
        let batches = positions.chunks(BATCH).zip(targets.chunks(BATCH));
        let count = batches.len();
        let mut loss = 0.0;
        for (p, e) in batches {
            let (l, slopes) = self.field.slopes(p, e);
            loss += l;
            let parameters = self.field.network.parameters_mut();
            self.adam.step(parameters, &slopes, rate);
        }
        loss / count.max(1) as f64
    }
}

/// Shading and geometric normal on the lit side at (triangle, u, v).
pub type Normals<'a> = &'a (dyn Fn(usize, f32, f32) -> (Vec3, Vec3) + Sync);

/// The points of an epoch, uniform over the surface by `areas`, raised off it by [`HEIGHT`].
fn draw_receivers(
    bake: &Bake,
    areas: &Discrete,
    normals: Normals<'_>,
    options: &NirfOptions,
    epoch: u32,
) -> Vec<Receiver> {
    (0..options.points)
        .map(|i| {
            let key = u64::from(epoch) * options.points as u64 + i as u64;
            let mut rng = KeyedRng::new(options.seed ^ 0x9e1f, key);
            let (triangle, _) = areas.sample(rng.next_f32());
            let [u, v] = square_to_triangle([rng.next_f32(), rng.next_f32()]);
            let (normal, face_normal) = normals(triangle, u, v);
            Receiver {
                position: bake.lit.mesh.position(triangle, u, v) + normal * HEIGHT,
                normal,
                face_normal,
                key,
            }
        })
        .collect()
}

/// Trains a field on a scene. `normals(t, u, v)` gives shading and geometric normal on the lit
/// side; `each` sees the field and its cost after every epoch.
#[must_use]
pub fn train_nirf(
    bake: &Bake,
    normals: Normals<'_>,
    options: &NirfOptions,
    progress: &Progress,
    each: &mut dyn FnMut(&Nirf, &NirfCost),
) -> (Nirf, NirfCost) {
    let mut training = Training::begin(options);
    let mut cost = NirfCost::default();
    let areas: Vec<f64> = (0..bake.lit.mesh.triangles.len())
        .map(|t| f64::from(bake.lit.mesh.area(t)))
        .collect();
    let Some(areas) = Discrete::new(&areas) else {
        return (training.field, cost);
    };
    let lit = LitScene {
        offset: 0.0,
        ..bake.lit
    };
    let raised = Bake { lit, ..*bake };
    let estimate = IrradianceOptions {
        estimator: Estimator::Uniform,
        rays: options.rays,
        emitter_samples: 0,
        seed: options.seed,
        drawn: [0, 0],
    };
    for epoch in 0..options.epochs {
        let start = Instant::now();
        let receivers = draw_receivers(bake, &areas, normals, options, epoch);
        let targets = bake_irradiance(
            &raised,
            receivers.len(),
            |i| receivers[i],
            &estimate,
            &Progress::silent(),
        );
        cost.rays += targets.rays;
        cost.ray_seconds += start.elapsed().as_secs_f64();
        let start = Instant::now();
        let positions: Vec<Vec3> = receivers.iter().map(|r| r.position).collect();
        // the authors' code lowers the rate by a fifth every 800 epochs
        let rate = options.learning_rate * 0.8f32.powi((epoch / 800) as i32);
        cost.loss = training.epoch(&positions, &targets.value, rate);
        cost.step_seconds += start.elapsed().as_secs_f64();
        cost.epochs = epoch + 1;
        progress.advance(1);
        each(&training.field, &cost);
    }
    (training.field, cost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::network::slope_along;

    fn positions(n: usize) -> Vec<Vec3> {
        let mut rng = KeyedRng::new(3, 1);
        (0..n)
            .map(|_| Vec3::from_array(std::array::from_fn(|_| 2.0 * rng.next_f32() - 1.0)))
            .collect()
    }

    #[test]
    fn slopes_are_those_of_the_loss() {
        let mut field = Nirf::new(&[37, 9], 5);
        let p = positions(BATCH);
        // far from the outputs, where the L1 loss has a kink
        let far = [Vec3::splat(500.0), Vec3::splat(-0.999)];
        let targets: Vec<Vec3> = (0..BATCH).map(|i| far[i % 2]).collect();
        let (_, slopes) = field.slopes(&p, &targets);
        let ratio = slope_along(&slopes, 1e-3, |step| {
            let values = field.network.parameters_mut().iter_mut();
            values.zip(&slopes).for_each(|(v, s)| *v += step * s);
            field.slopes(&p, &targets).0
        });
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    }

    #[test]
    fn the_network_has_the_papers_size() {
        assert_eq!(
            Nirf::new(&[512; 4], 0).network.parameters().len(),
            63 * 512 + 3 * 512 * 512 + 512 * 3 + 4 * 512 + 3
        );
    }

    #[test]
    fn adam_fits_a_smooth_field_and_the_thread_count_changes_nothing() {
        let p = positions(16 * BATCH);
        let truth: Vec<Vec3> = p
            .iter()
            .map(|p| Vec3::new(2.0 + p.x, 1.0 + p.y * p.y, 0.5))
            .collect();
        let fit = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("pool");
            pool.install(|| {
                let mut training = Training::begin(&NirfOptions {
                    hidden: vec![32, 32],
                    seed: 1,
                    ..NirfOptions::default()
                });
                let losses: Vec<f64> = (0..20).map(|_| training.epoch(&p, &truth, 3e-3)).collect();
                (losses, training.field.network.parameters()[7].to_bits())
            })
        };
        let (losses, bits) = fit(1);
        assert!(losses[19] < 0.12 * losses[0], "{losses:?}");
        assert_eq!(fit(3).1, bits);
    }
}
