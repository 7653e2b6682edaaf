//! The neural irradiance field (NIrF), the paper's alternative to the irradiance texture (method
//! §3.2), for comparison.
//!
//! A perceptron maps a position (metres; NeRF's encoding with 10 octaves and the identity, 63
//! numbers) through four hidden layers of 512 with leaky rectifiers to log(1 + E). Every epoch
//! draws 1024 points uniformly by area, 1 cm above the surface, estimates their irradiance with
//! 2048 uniform rays each, and takes 64 steps of Adam over batches of 16 with an L1 loss in log(1 +
//! E).
//!
//! Activations are stored feature by feature with the batch as the vector lane, weights as `outputs
//! × inputs`. Every sum has a fixed order, so that the number of threads does not change a bit.

use super::{Bake, Estimator, IrradianceOptions, Receiver, bake_irradiance};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::sampling::{Discrete, KeyedRng, square_to_triangle};
use crate::ffi::simd::with_widest;
use crate::lights::LitScene;
use glam::Vec3;
use std::time::Instant;

/// Samples per batch: the paper's, and the vector lanes of every kernel.
pub const BATCH: usize = 16;
/// Octaves of the encoding.
const OCTAVES: usize = 10;
/// Numbers of an encoded position.
pub const ENCODED: usize = 3 + 6 * OCTAVES;
/// Slope of the rectifier below zero.
const LEAK: f32 = 0.01;
/// Distance of training points from the surface, metres.
const HEIGHT: f32 = 0.01;
/// Output rows per parallel task.
const ROWS: usize = 32;

/// One value per sample of a batch.
type Lanes = [f32; BATCH];

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

#[derive(Clone, Debug)]
struct Layer {
    inputs: usize,
    /// `outputs × inputs`.
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// Derivatives of the loss by one layer's parameters.
#[derive(Clone, Debug)]
struct Slope {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// A neural irradiance field.
#[derive(Clone, Debug)]
pub struct Nirf {
    layers: Vec<Layer>,
}

/// NeRF's encoding (Mildenhall et al. 2020, eq. 4, without π): x, then sin 2ᵏx and cos 2ᵏx.
fn encode(p: Vec3) -> [f32; ENCODED] {
    let mut out = [0.0; ENCODED];
    out[..3].copy_from_slice(&p.to_array());
    for k in 0..OCTAVES {
        for axis in 0..3 {
            let (sin, cos) = (p[axis] * (1u32 << k) as f32).sin_cos();
            out[3 + 6 * k + axis] = sin;
            out[6 + 6 * k + axis] = cos;
        }
    }
    out
}

/// Features × lanes of up to [`BATCH`] positions; missing ones are zero.
fn encoded(positions: &[Vec3]) -> Vec<Lanes> {
    let mut x = vec![[0.0; BATCH]; ENCODED];
    for (b, p) in positions.iter().enumerate() {
        for (row, v) in x.iter_mut().zip(encode(*p)) {
            row[b] = v;
        }
    }
    x
}

impl Nirf {
    /// A field with random weights (He et al. 2015, uniform, for the leaky rectifier) and no bias.
    #[must_use]
    pub fn new(hidden: &[usize], seed: u64) -> Self {
        let sizes: Vec<usize> = std::iter::once(ENCODED)
            .chain(hidden.iter().copied())
            .chain([3])
            .collect();
        let layers = sizes
            .windows(2)
            .enumerate()
            .map(|(k, s)| {
                let bound = (2.0 / (1.0 + LEAK * LEAK) * 3.0 / s[0] as f32).sqrt();
                let mut rng = KeyedRng::new(seed, k as u64);
                let weight = (0..s[0] * s[1])
                    .map(|_| bound * (2.0 * rng.next_f32() - 1.0))
                    .collect();
                Layer {
                    inputs: s[0],
                    weight,
                    bias: vec![0.0; s[1]],
                }
            })
            .collect();
        Self { layers }
    }

    /// Number of weights and biases.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.layers
            .iter()
            .map(|l| l.weight.len() + l.bias.len())
            .sum()
    }

    /// Irradiance at surface points with unit normals on the lit side.
    #[must_use]
    pub fn irradiance(&self, points: &[(Vec3, Vec3)]) -> Vec<Vec3> {
        let parts: Vec<Vec<Vec3>> = points
            .par_chunks(BATCH)
            .map(|chunk| {
                let positions: Vec<Vec3> = chunk.iter().map(|(p, n)| *p + *n * HEIGHT).collect();
                let y = self.forward(&positions, false).pop().unwrap_or_default();
                (0..chunk.len())
                    .map(|b| Vec3::new(y[0][b], y[1][b], y[2][b]).exp() - Vec3::ONE)
                    .collect()
            })
            .collect();
        parts.concat()
    }

    /// Inputs of every layer, after the rectifier, and the output.
    fn forward(&self, positions: &[Vec3], parallel: bool) -> Vec<Vec<Lanes>> {
        let mut all = vec![encoded(positions)];
        for (k, layer) in self.layers.iter().enumerate() {
            let x = &all[k];
            let rectified = k + 1 < self.layers.len();
            let mut y = vec![[0.0; BATCH]; layer.bias.len()];
            let task = |(c, rows): (usize, &mut [Lanes])| {
                with_widest(
                    #[inline(always)]
                    || layer.rows(c * ROWS, x, rows, rectified),
                )
            };
            if parallel {
                y.par_chunks_mut(ROWS).enumerate().for_each(task);
            } else {
                y.chunks_mut(ROWS).enumerate().for_each(task);
            }
            all.push(y);
        }
        all
    }

    /// Loss of a batch (mean |log(1+E) − y| over samples and channels) and its slopes.
    fn slopes(&self, positions: &[Vec3], targets: &[Vec3]) -> (f64, Vec<Slope>) {
        let all = self.forward(positions, true);
        let n = positions.len() as f32;
        let mut delta = vec![[0.0; BATCH]; 3];
        let mut loss = 0.0f64;
        if let Some(y) = all.last() {
            for (b, target) in targets.iter().enumerate() {
                for c in 0..3 {
                    let d = y[c][b] - target[c].ln_1p();
                    loss += f64::from(d.abs());
                    delta[c][b] = if d == 0.0 {
                        0.0
                    } else {
                        d.signum() / (3.0 * n)
                    };
                }
            }
        }
        let mut slopes = Vec::with_capacity(self.layers.len());
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let x = &all[k];
            slopes.push(layer.slope(x, &delta));
            if k > 0 {
                delta = layer.back(x, &delta);
            }
        }
        slopes.reverse();
        (loss / f64::from(3.0 * n), slopes)
    }
}

impl Layer {
    /// Output rows from `first` on.
    #[inline(always)]
    fn rows(&self, first: usize, x: &[Lanes], out: &mut [Lanes], rectified: bool) {
        for (c, four) in out.chunks_mut(4).enumerate() {
            let o = first + 4 * c;
            // rows beyond the last repeat it: their sums are dropped
            let row = |k: usize| {
                let r = (o + k).min(self.bias.len() - 1);
                &self.weight[r * self.inputs..(r + 1) * self.inputs]
            };
            let w = [row(0), row(1), row(2), row(3)];
            let mut sum = [[0.0f32; BATCH]; 4];
            // zipped, so that no index is checked inside the loop
            for ((((xi, w0), w1), w2), w3) in x.iter().zip(w[0]).zip(w[1]).zip(w[2]).zip(w[3]) {
                for (s, wk) in sum.iter_mut().zip([w0, w1, w2, w3]) {
                    for b in 0..BATCH {
                        s[b] += wk * xi[b];
                    }
                }
            }
            for (k, y) in four.iter_mut().enumerate() {
                for b in 0..BATCH {
                    let v = sum[k][b] + self.bias[o + k];
                    y[b] = if rectified && v < 0.0 { LEAK * v } else { v };
                }
            }
        }
    }

    /// Slopes by this layer's parameters, given its inputs and the slopes by its (unrectified)
    /// outputs.
    fn slope(&self, x: &[Lanes], delta: &[Lanes]) -> Slope {
        let transposed: Vec<Vec<f32>> = (0..BATCH)
            .map(|b| x.iter().map(|row| row[b]).collect())
            .collect();
        let mut weight = vec![0.0f32; self.weight.len()];
        weight
            .par_chunks_mut(self.inputs * 4)
            .zip(delta.par_chunks(4))
            .for_each(|(rows, deltas)| {
                with_widest(
                    #[inline(always)]
                    || {
                        for (row, d) in rows.chunks_mut(self.inputs).zip(deltas) {
                            for (b, xb) in transposed.iter().enumerate() {
                                for (w, v) in row.iter_mut().zip(xb) {
                                    *w += d[b] * v;
                                }
                            }
                        }
                    },
                );
            });
        Slope {
            weight,
            bias: delta.iter().map(|d| d.iter().sum()).collect(),
        }
    }

    /// Slopes by the unrectified outputs of the layer before, whose rectified outputs are `x`.
    fn back(&self, x: &[Lanes], delta: &[Lanes]) -> Vec<Lanes> {
        let mut out = vec![[0.0f32; BATCH]; self.inputs];
        out.par_chunks_mut(ROWS).enumerate().for_each(|(c, rows)| {
            with_widest(
                #[inline(always)]
                || {
                    for (d, w) in delta.iter().zip(self.weight.chunks(self.inputs)) {
                        let w = &w[c * ROWS..c * ROWS + rows.len()];
                        for (row, wi) in rows.iter_mut().zip(w) {
                            for b in 0..BATCH {
                                row[b] += wi * d[b];
                            }
                        }
                    }
                    for (row, xi) in rows.iter_mut().zip(&x[c * ROWS..]) {
                        for b in 0..BATCH {
                            // the rectifier keeps the sign, so its output tells which side it was
                            // on
                            if xi[b] < 0.0 {
                                row[b] *= LEAK;
                            }
                        }
                    }
                },
            );
        });
        out
    }
}

/// Adam (Kingma & Ba 2015) over one array.
struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
}

impl Adam {
    const BETA: [f32; 2] = [0.9, 0.999];

    fn new(n: usize) -> Self {
        Self {
            mean: vec![0.0; n],
            square: vec![0.0; n],
        }
    }

    fn step(&mut self, values: &mut [f32], slopes: &[f32], rate: f32, t: i32) {
        let [b1, b2] = Self::BETA;
        let (c1, c2) = (1.0 / (1.0 - b1.powi(t)), 1.0 / (1.0 - b2.powi(t)));
        let chunk = 1 << 14;
        let moments = self
            .mean
            .par_chunks_mut(chunk)
            .zip(self.square.par_chunks_mut(chunk));
        values
            .par_chunks_mut(chunk)
            .zip(slopes.par_chunks(chunk))
            .zip(moments)
            .for_each(|((v, g), (m, s))| {
                with_widest(
                    #[inline(always)]
                    || {
                        for i in 0..v.len() {
                            m[i] = b1 * m[i] + (1.0 - b1) * g[i];
                            s[i] = b2 * s[i] + (1.0 - b2) * g[i] * g[i];
                            v[i] -= rate * (m[i] * c1) / ((s[i] * c2).sqrt() + 1e-8);
                        }
                    },
                );
            });
    }
}

/// A field and what Adam remembers of its steps.
struct Training {
    field: Nirf,
    /// Per layer, of weights and biases.
    adam: Vec<[Adam; 2]>,
    /// Steps taken.
    steps: i32,
}

impl Training {
    fn begin(options: &NirfOptions) -> Self {
        let field = Nirf::new(&options.hidden, options.seed);
        let adam = field
            .layers
            .iter()
            .map(|l| [Adam::new(l.weight.len()), Adam::new(l.bias.len())])
            .collect();
        Self {
            field,
            adam,
            steps: 0,
        }
    }

    /// One epoch at a learning rate, batch by batch; returns the mean loss.
    fn epoch(&mut self, positions: &[Vec3], targets: &[Vec3], rate: f32) -> f64 {
        let batches = positions.chunks(BATCH).zip(targets.chunks(BATCH));
        let count = batches.len();
        let mut loss = 0.0;
        for (p, e) in batches {
            self.steps += 1;
            let (l, slopes) = self.field.slopes(p, e);
            loss += l;
            let layers = self.field.layers.iter_mut().zip(&slopes);
            for ((layer, slope), [weight, bias]) in layers.zip(&mut self.adam) {
                weight.step(&mut layer.weight, &slope.weight, rate, self.steps);
                bias.step(&mut layer.bias, &slope.bias, rate, self.steps);
            }
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

    fn positions(n: usize) -> Vec<Vec3> {
        let mut rng = KeyedRng::new(3, 1);
        (0..n)
            .map(|_| Vec3::from_array(std::array::from_fn(|_| 2.0 * rng.next_f32() - 1.0)))
            .collect()
    }

    /// The loss in double precision, loop by loop.
    fn plain_loss(
        field: &Nirf,
        positions: &[Vec3],
        targets: &[Vec3],
        change: (usize, bool, usize, f64),
    ) -> f64 {
        let mut loss = 0.0;
        for (p, e) in positions.iter().zip(targets) {
            let mut x: Vec<f64> = encode(*p).iter().map(|v| f64::from(*v)).collect();
            for (k, layer) in field.layers.iter().enumerate() {
                let nudge = |is_weight: bool, i: usize| {
                    if change.0 == k && change.1 == is_weight && change.2 == i {
                        change.3
                    } else {
                        0.0
                    }
                };
                x = (0..layer.bias.len())
                    .map(|o| {
                        let sum: f64 = (0..layer.inputs)
                            .map(|i| {
                                let at = o * layer.inputs + i;
                                (f64::from(layer.weight[at]) + nudge(true, at)) * x[i]
                            })
                            .sum();
                        let v = sum + f64::from(layer.bias[o]) + nudge(false, o);
                        if k + 1 < field.layers.len() && v < 0.0 {
                            f64::from(LEAK) * v
                        } else {
                            v
                        }
                    })
                    .collect();
            }
            loss += (0..3)
                .map(|c| (x[c] - f64::from(e[c]).ln_1p()).abs())
                .sum::<f64>();
        }
        loss / (3.0 * positions.len() as f64)
    }

    #[test]
    fn slopes_equal_central_differences() {
        let mut field = Nirf::new(&[37, 9], 5);
        // a bias that is not zero, so that its place matters
        for layer in &mut field.layers {
            let mut rng = KeyedRng::new(8, layer.inputs as u64);
            layer
                .bias
                .iter_mut()
                .for_each(|b| *b = 0.2 * rng.next_f32() - 0.1);
        }
        for n in [BATCH, 5] {
            let p = positions(n);
            // far from the outputs, where the L1 loss has a kink
            let targets: Vec<Vec3> = (0..n)
                .map(|i| {
                    if i % 2 == 0 {
                        Vec3::splat(500.0)
                    } else {
                        Vec3::splat(-0.999)
                    }
                })
                .collect();
            let (loss, slopes) = field.slopes(&p, &targets);
            assert!(
                (loss - plain_loss(&field, &p, &targets, (9, true, 0, 0.0))).abs() < 1e-5 * loss
            );
            for (k, slope) in slopes.iter().enumerate() {
                for (is_weight, values) in [(true, &slope.weight), (false, &slope.bias)] {
                    let largest = values.iter().fold(0.0f32, |a, v| a.max(v.abs()));
                    for i in (0..values.len()).step_by(1 + values.len() / 40) {
                        let at = |h| plain_loss(&field, &p, &targets, (k, is_weight, i, h));
                        let central = (at(1e-6) - at(-1e-6)) / 2e-6;
                        let error = (f64::from(values[i]) - central).abs();
                        assert!(
                            error < 1e-4 * f64::from(largest) + 1e-8,
                            "layer {k} weight {is_weight} {i}: {} {central}",
                            values[i]
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn encoding_has_63_numbers_and_they_are_named() {
        let e = encode(Vec3::new(0.5, -1.0, 2.0));
        assert_eq!(e[..3], [0.5, -1.0, 2.0]);
        assert!((e[3] - 0.5f32.sin()).abs() < 1e-7 && (e[7] - (-1.0f32).cos()).abs() < 1e-7);
        assert!((e[3 + 6 * 9 + 2] - (2.0f32 * 512.0).sin()).abs() < 1e-6);
        assert_eq!(e.len(), 63);
        assert_eq!(
            Nirf::new(&[512; 4], 0).parameters(),
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
                let mut field = Nirf::new(&[32, 32], 1);
                let mut adam: Vec<_> = field
                    .layers
                    .iter()
                    .map(|l| [Adam::new(l.weight.len()), Adam::new(l.bias.len())])
                    .collect();
                let mut losses = Vec::new();
                for t in 1..=320 {
                    let batch = (t as usize % 16) * BATCH..(t as usize % 16 + 1) * BATCH;
                    let (loss, slopes) = field.slopes(&p[batch.clone()], &truth[batch]);
                    losses.push(loss);
                    for ((layer, slope), [weight, bias]) in
                        field.layers.iter_mut().zip(&slopes).zip(&mut adam)
                    {
                        weight.step(&mut layer.weight, &slope.weight, 3e-3, t);
                        bias.step(&mut layer.bias, &slope.bias, 3e-3, t);
                    }
                }
                (
                    losses[0],
                    losses[300..].iter().sum::<f64>() / 20.0,
                    field.layers[0].weight[7].to_bits(),
                )
            })
        };
        let (first, last, bits) = fit(1);
        assert!(last < 0.12 * first, "loss {first} to {last}");
        assert_eq!(fit(3).2, bits);
    }
}
