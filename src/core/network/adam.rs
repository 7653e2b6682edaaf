//! Adam (Kingma & Ba 2015, algorithm 1).

use crate::core::parallel::prelude::*;
use crate::ffi::simd::with_widest;

/// Decay of the gradient's mean and of its square (cited: Kingma & Ba's defaults).
const BETA: [f32; 2] = [0.9, 0.999];
/// Floor of the denominator (cited: the same).
const EPSILON: f32 = 1e-8;
/// Numbers per task.
const CHUNK: usize = 1 << 14;

/// What one step does to a number.
#[derive(Clone, Copy, Debug)]
pub struct AdamRule {
    rate: f32,
    correction: [f32; 2],
}

impl AdamRule {
    /// The rule of the `step`-th step, the first being 1.
    #[must_use]
    pub fn new(rate: f32, step: i32) -> Self {
        Self {
            rate,
            correction: BETA.map(|b| 1.0 / (1.0 - b.powi(step))),
        }
    }

    /// How far a number goes against its gradient; updates what is remembered of gradients.
    #[inline(always)]
    pub fn advance(&self, gradient: f32, mean: &mut f32, square: &mut f32) -> f32 {
        *mean = BETA[0] * *mean + (1.0 - BETA[0]) * gradient;
        *square = BETA[1] * *square + (1.0 - BETA[1]) * gradient * gradient;
        self.rate * (*mean * self.correction[0] / ((*square * self.correction[1]).sqrt() + EPSILON))
    }
}

/// What Adam remembers of an array's steps.
#[derive(Clone, Debug)]
pub struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: i32,
}

impl Adam {
    /// For an array of `n` numbers.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self {
            mean: vec![0.0; n],
            square: vec![0.0; n],
            steps: 0,
        }
    }

    /// One step of `values` against `gradient`.
    pub fn step(&mut self, values: &mut [f32], gradient: &[f32], rate: f32) {
        self.steps += 1;
        let rule = AdamRule::new(rate, self.steps);
        self.each(values, gradient, |v, g, m, s| *v -= rule.advance(g, m, s));
    }

    /// As [`Self::step`], but numbers without gradient stay and forget nothing: for tables of which
    /// a step touches few entries (Müller et al. 2022, Sec. 4).
    pub fn sparse_step(&mut self, values: &mut [f32], gradient: &[f32], rate: f32) {
        self.steps += 1;
        let rule = AdamRule::new(rate, self.steps);
        self.each(values, gradient, |v, g, m, s| {
            if g != 0.0 {
                *v -= rule.advance(g, m, s);
            }
        });
    }

    fn each(
        &mut self,
        values: &mut [f32],
        gradient: &[f32],
        update: impl Fn(&mut f32, f32, &mut f32, &mut f32) + Sync + Send,
    ) {
        let moments = self
            .mean
            .par_chunks_mut(CHUNK)
            .zip(self.square.par_chunks_mut(CHUNK));
        values
            .par_chunks_mut(CHUNK)
            .zip(gradient.par_chunks(CHUNK))
            .zip(moments)
            .for_each(|((v, g), (m, s))| {
                with_widest(
                    #[inline(always)]
                    || {
                        for i in 0..v.len() {
                            update(&mut v[i], g[i], &mut m[i], &mut s[i]);
                        }
                    },
                );
            });
    }
}
