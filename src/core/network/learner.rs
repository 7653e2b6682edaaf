//! A perceptron that learns: its gradient, and what Adam remembers.

use super::{Adam, Mlp, Shape};

/// A perceptron on its way down.
#[derive(Clone, Debug)]
pub struct Learner {
    /// The perceptron.
    pub network: Mlp,
    /// Slopes of the objective by its parameters.
    pub gradient: Vec<f32>,
    adam: Adam,
}

impl Learner {
    /// A random perceptron without gradient.
    #[must_use]
    pub fn new(shape: &Shape, seed: u64) -> Self {
        let network = Mlp::new(shape, seed);
        let size = network.parameters().len();
        Self {
            network,
            gradient: vec![0.0; size],
            adam: Adam::new(size),
        }
    }

    /// One step against the gradient, which is zero afterwards.
    pub fn step(&mut self, rate: f32) {
        let parameters = self.network.parameters_mut();
        self.adam.step(parameters, &self.gradient, rate);
        self.gradient.fill(0.0);
    }

    /// Moves the parameters by a multiple of `direction`.
    #[cfg(test)]
    pub fn move_along(&mut self, direction: &[f32], step: f32) {
        let values = self.network.parameters_mut().iter_mut();
        values.zip(direction).for_each(|(v, s)| *v += step * s);
    }
}
