//! A perceptron: y = a(W x + b), layer by layer, and its adjoint (Rumelhart et al. 1986). Products
//! of matrices are nalgebra's. All parameters lie in one array, layer by layer: weights (`outputs ×
//! inputs`, column by column), then biases.

use crate::core::math::fast_sin_cos;
use crate::core::sampling::KeyedRng;
use crate::ffi::simd::with_widest;
use nalgebra::{DMatrix, DMatrixView, DMatrixViewMut};
use std::ops::Range;

/// What a layer does to its sums.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    /// Nothing.
    Linear,
    /// max(x, slope · x); a slope of 0 is the plain rectifier.
    Rectifier(f32),
    /// sin x (Sitzmann et al. 2020, SIREN, whose ω belongs to the input here: an encoding brings its own).
    Sine,
    /// 1/(1 + e⁻ˣ).
    Sigmoid,
    /// (1 + tanh x)/2, steeper by two.
    HalfTanh,
    /// eˣ, x at most 15 so that no light is infinite.
    Exponential,
}

/// Rows of the input that enter a later layer beside the outputs of the one before.
#[derive(Clone, Debug)]
pub struct Join {
    /// Layer, the first being 0.
    pub layer: usize,
    /// Rows of the input.
    pub rows: Range<usize>,
}

/// Sizes of a perceptron.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Rows of the input that enter the first layer: 0 up to this.
    pub inputs: usize,
    /// Widths of the hidden layers.
    pub hidden: Vec<usize>,
    /// Numbers it answers with.
    pub outputs: usize,
    /// Of the hidden layers.
    pub activation: Activation,
    /// Of the last layer.
    pub last: Activation,
    /// What enters later.
    pub join: Option<Join>,
    /// Whether layers have biases.
    pub biased: bool,
    /// Sum that the last layer starts with everywhere, its weights being zero; random if `None`.
    pub start: Option<f32>,
}

#[derive(Clone, Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    activation: Activation,
    weight: Range<usize>,
    bias: Range<usize>,
}

/// A perceptron.
#[derive(Clone, Debug)]
pub struct Mlp {
    layers: Vec<Layer>,
    first: usize,
    join: Option<Join>,
    parameters: Vec<f32>,
}

/// What a pass through a network leaves for the way back.
pub struct Trace {
    /// What entered each layer.
    inputs: Vec<DMatrix<f32>>,
    /// Derivatives of each layer's activations.
    slopes: Vec<DMatrix<f32>>,
    /// Rows of the whole input.
    rows: usize,
    /// What the last layer gave, `outputs × samples`.
    pub output: DMatrix<f32>,
}

/// A sum's activation and derivative.
#[inline(always)]
fn activate(activation: Activation, x: f32) -> (f32, f32) {
    match activation {
        Activation::Linear => (x, 1.0),
        Activation::Rectifier(slope) if x < 0.0 => (slope * x, slope),
        Activation::Rectifier(_) => (x, 1.0),
        Activation::Sine => fast_sin_cos(x),
        Activation::Sigmoid => {
            let s = 1.0 / (1.0 + (-x).exp());
            (s, s * (1.0 - s))
        }
        Activation::HalfTanh => {
            let s = 1.0 / (1.0 + (-2.0 * x).exp());
            (s, 2.0 * s * (1.0 - s))
        }
        Activation::Exponential => {
            const MOST: f32 = 15.0;
            let e = x.min(MOST).exp();
            (e, if x < MOST { e } else { 0.0 })
        }
    }
}

impl Mlp {
    /// Random weights and no biases. Rectifiers: He et al. 2015, uniform. Others: Glorot & Bengio
    /// 2010 for as many outputs as inputs, which is also what NeILF's release gives its sines: an
    /// Adam step of 2·10⁻³ is small beside such weights, and 17 times as large beside SIREN's own,
    /// which are smaller by its ω of 30.
    #[must_use]
    pub fn new(shape: &Shape, seed: u64) -> Self {
        let mut layers = Vec::new();
        let mut parameters = Vec::new();
        let mut inputs = shape.inputs;
        for k in 0..=shape.hidden.len() {
            let outputs = *shape.hidden.get(k).unwrap_or(&shape.outputs);
            let activation = if k < shape.hidden.len() {
                shape.activation
            } else {
                shape.last
            };
            if let Some(join) = shape.join.as_ref().filter(|j| j.layer == k) {
                inputs += join.rows.len();
            }
            let n = inputs as f32;
            // what the layer before does decides how large this one's inputs are
            let bound = match shape.activation {
                Activation::Rectifier(slope) => (6.0 / (n * (1.0 + slope * slope))).sqrt(),
                _ => (3.0 / n).sqrt(),
            };
            let mut rng = KeyedRng::new(seed, k as u64);
            let started = shape.start.filter(|_| k == shape.hidden.len());
            let bound = if started.is_some() { 0.0 } else { bound };
            let start = parameters.len();
            let weights = (0..inputs * outputs).map(|_| bound * (2.0 * rng.next_f32() - 1.0));
            parameters.extend(weights);
            let weight = start..parameters.len();
            if shape.biased {
                parameters.extend(std::iter::repeat_n(started.unwrap_or(0.0), outputs));
            }
            let bias = weight.end..parameters.len();
            layers.push(Layer {
                inputs,
                outputs,
                activation,
                weight,
                bias,
            });
            inputs = outputs;
        }
        Self {
            layers,
            first: shape.inputs,
            join: shape.join.clone(),
            parameters,
        }
    }

    /// All weights and biases.
    #[must_use]
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// The same, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// The network's answer to a batch, and what its gradient needs.
    #[must_use]
    pub fn forward(&self, x: &DMatrix<f32>) -> Trace {
        let mut inputs = Vec::with_capacity(self.layers.len());
        let mut slopes = Vec::with_capacity(self.layers.len());
        let mut h = x.rows(0, self.first).into_owned();
        for (k, layer) in self.layers.iter().enumerate() {
            if let Some(join) = self.join.as_ref().filter(|j| j.layer == k) {
                let before = h.nrows();
                h = h.resize_vertically(before + join.rows.len(), 0.0);
                h.rows_mut(before, join.rows.len())
                    .copy_from(&x.rows(join.rows.start, join.rows.len()));
            }
            let weight = DMatrixView::from_slice(
                &self.parameters[layer.weight.clone()],
                layer.outputs,
                layer.inputs,
            );
            let mut y = weight * &h;
            let mut slope = DMatrix::zeros(layer.outputs, x.ncols());
            layer.finish(
                &self.parameters[layer.bias.clone()],
                y.as_mut_slice(),
                slope.as_mut_slice(),
            );
            inputs.push(std::mem::replace(&mut h, y));
            slopes.push(slope);
        }
        Trace {
            inputs,
            slopes,
            rows: x.nrows(),
            output: h,
        }
    }

    /// Adds the slopes of all parameters to `gradient`, given the slopes by the output; returns the
    /// slopes by the input.
    pub fn backward(
        &self,
        trace: &Trace,
        output: DMatrix<f32>,
        gradient: &mut [f32],
    ) -> DMatrix<f32> {
        let mut by_input = DMatrix::zeros(trace.rows, output.ncols());
        let mut delta = output;
        for (k, layer) in self.layers.iter().enumerate().rev() {
            delta.component_mul_assign(&trace.slopes[k]);
            let samples = trace.inputs[k].transpose();
            DMatrixViewMut::from_slice(
                &mut gradient[layer.weight.clone()],
                layer.outputs,
                layer.inputs,
            )
            .gemm(1.0, &delta, &samples, 1.0);
            for column in delta.column_iter() {
                let biases = gradient[layer.bias.clone()].iter_mut();
                biases.zip(column.iter()).for_each(|(b, d)| *b += d);
            }
            let weight = DMatrixView::from_slice(
                &self.parameters[layer.weight.clone()],
                layer.outputs,
                layer.inputs,
            );
            delta = weight.transpose() * delta;
            if let Some(join) = self.join.as_ref().filter(|j| j.layer == k) {
                let before = delta.nrows() - join.rows.len();
                let mut to = by_input.rows_mut(join.rows.start, join.rows.len());
                to += delta.rows(before, join.rows.len());
                delta = delta.resize_vertically(before, 0.0);
            }
        }
        let mut to = by_input.rows_mut(0, self.first);
        to += delta;
        by_input
    }
}

impl Layer {
    /// Adds biases to the sums of a batch, then activations and their derivatives.
    fn finish(&self, bias: &[f32], sums: &mut [f32], slopes: &mut [f32]) {
        let activation = self.activation;
        let samples = sums
            .chunks_exact_mut(self.outputs)
            .zip(slopes.chunks_exact_mut(self.outputs));
        for (y, slope) in samples {
            y.iter_mut().zip(bias).for_each(|(y, b)| *y += b);
            with_widest(
                #[inline(always)]
                || {
                    for (y, s) in y.iter_mut().zip(slope) {
                        (*y, *s) = activate(activation, *y);
                    }
                },
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(rows: usize, columns: usize, key: u64) -> DMatrix<f32> {
        let mut rng = KeyedRng::new(key, 4);
        DMatrix::from_fn(rows, columns, |_, _| 2.0 * rng.next_f32() - 1.0)
    }

    /// The network in double precision, sum by sum.
    fn plain(mlp: &Mlp, parameters: &[f64], x: &[f64]) -> Vec<f64> {
        let mut h = x[..mlp.first].to_vec();
        for (k, layer) in mlp.layers.iter().enumerate() {
            if let Some(join) = mlp.join.as_ref().filter(|j| j.layer == k) {
                h.extend(&x[join.rows.clone()]);
            }
            let sum = |o: usize| {
                let weights = (0..layer.inputs)
                    .map(|i| parameters[layer.weight.start + i * layer.outputs + o] * h[i]);
                let bias = parameters[layer.bias.clone()].get(o);
                weights.sum::<f64>() + bias.unwrap_or(&0.0)
            };
            let of = |y: f64| match layer.activation {
                Activation::Linear => y,
                Activation::Rectifier(slope) => y.max(f64::from(slope) * y),
                Activation::Sine => y.sin(),
                Activation::Sigmoid => 1.0 / (1.0 + (-y).exp()),
                Activation::HalfTanh => 0.5 + 0.5 * y.tanh(),
                Activation::Exponential => y.exp(),
            };
            h = (0..layer.outputs).map(|o| of(sum(o))).collect();
        }
        h
    }

    #[test]
    fn slopes_equal_central_differences_for_every_activation() {
        let hidden = [Activation::Rectifier(0.2), Activation::Sine];
        let last = [
            Activation::Linear,
            Activation::Sigmoid,
            Activation::Exponential,
        ];
        for (activation, last) in hidden
            .into_iter()
            .zip(last)
            .chain([(hidden[1], last[2]), (hidden[1], Activation::HalfTanh)])
        {
            let shape = Shape {
                inputs: 5,
                hidden: vec![11, 7, 6],
                outputs: 3,
                activation,
                last,
                join: Some(Join {
                    layer: 2,
                    rows: 3..8,
                }),
                biased: true,
                start: None,
            };
            let mut mlp = Mlp::new(&shape, 5);
            let mut rng = KeyedRng::new(8, 1);
            // biases that are not zero, so that their place matters
            for p in mlp.parameters_mut() {
                *p += 0.02 * rng.next_f32() - 0.01;
            }
            let (x, weight) = (random(8, 9, 1), random(3, 9, 2));
            let objective = |parameters: &[f64], x: &DMatrix<f64>| -> f64 {
                let answers = (0..9).map(|s| {
                    let y = plain(&mlp, parameters, x.column(s).as_slice());
                    (0..3)
                        .map(|o| y[o] * f64::from(weight[(o, s)]))
                        .sum::<f64>()
                });
                answers.sum()
            };
            let trace = mlp.forward(&x);
            let mut gradient = vec![0.0; mlp.parameters().len()];
            let by_input = mlp.backward(&trace, weight.clone(), &mut gradient);
            let base: Vec<f64> = mlp.parameters().iter().map(|p| f64::from(*p)).collect();
            let x = x.map(f64::from);
            let h = 1e-6;
            let largest = gradient.iter().fold(0.0f32, |a, g| a.max(g.abs()));
            for i in 0..base.len() {
                let at = |d: f64| {
                    let mut p = base.clone();
                    p[i] += d;
                    objective(&p, &x)
                };
                let central = (at(h) - at(-h)) / (2.0 * h);
                let error = (f64::from(gradient[i]) - central).abs();
                assert!(
                    error < 2e-4 * f64::from(largest),
                    "{activation:?} {i}: {error}"
                );
            }
            let largest = by_input.amax();
            for i in 0..x.len() {
                let at = |d: f64| {
                    let mut moved = x.clone();
                    moved[i] += d;
                    objective(&base, &moved)
                };
                let central = (at(h) - at(-h)) / (2.0 * h);
                let error = (f64::from(by_input[i]) - central).abs();
                assert!(error < 2e-4 * f64::from(largest), "input {i}: {error}");
            }
        }
    }
}
