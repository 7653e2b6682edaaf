//! Constant-time sampling of a discrete distribution (Walker 1977, Vose 1991).

/// Alias table over non-negative weights.
#[derive(Clone, Debug)]
pub struct AliasTable {
    threshold: Vec<f32>,
    alias: Vec<u32>,
    pmf: Vec<f32>,
}

impl AliasTable {
    /// Builds the table; `None` if no weight is positive and finite in sum.
    #[must_use]
    pub fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        if !(total > 0.0 && total.is_finite()) || weights.iter().any(|w| w.is_nan() || *w < 0.0) {
            return None;
        }
        let n = weights.len();
        let mut scaled: Vec<f64> = weights.iter().map(|w| w / total * n as f64).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) =
            (0..n).partition(|&i| scaled[i] < 1.0);
        let mut threshold = vec![1.0f32; n];
        let mut alias: Vec<u32> = (0..n as u32).collect();
        while let (Some(&s), Some(&l)) = (small.last(), large.last()) {
            small.pop();
            threshold[s] = scaled[s] as f32;
            alias[s] = l as u32;
            scaled[l] -= 1.0 - scaled[s];
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        let pmf = weights.iter().map(|w| (w / total) as f32).collect();
        Some(Self {
            threshold,
            alias,
            pmf,
        })
    }

    /// Draws an index; also returns the rest of `u`, again uniform in [0, 1).
    #[must_use]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let n = self.threshold.len();
        let x = f64::from(u) * n as f64;
        let i = (x as usize).min(n - 1);
        let rest = (x - i as f64) as f32;
        let t = self.threshold[i];
        if rest < t {
            (i, (rest / t).min(1.0 - f32::EPSILON))
        } else {
            (
                self.alias[i] as usize,
                ((rest - t) / (1.0 - t)).clamp(0.0, 1.0 - f32::EPSILON),
            )
        }
    }

    /// Probability of index `i`.
    #[must_use]
    pub fn pmf(&self, i: usize) -> f32 {
        self.pmf[i]
    }

    /// Number of entries.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pmf.len()
    }

    /// Never true: a table has at least one positive weight.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pmf.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_follow_the_weights() {
        let w = [0.0, 1.0, 3.0, 6.0, 0.5];
        let t = AliasTable::new(&w).expect("positive weights");
        let n = 200_000;
        let mut count = [0usize; 5];
        let mut rest_sum = 0.0f64;
        for i in 0..n {
            let (k, r) = t.sample((i as f32 + 0.5) / n as f32);
            count[k] += 1;
            rest_sum += f64::from(r);
        }
        for k in 0..5 {
            let p = w[k] / 10.5;
            assert!(
                (count[k] as f64 / f64::from(n) - p).abs() < 1e-3,
                "index {k}"
            );
            assert!((f64::from(t.pmf(k)) - p).abs() < 1e-6);
        }
        assert!((rest_sum / f64::from(n) - 0.5).abs() < 5e-3);
    }

    #[test]
    fn hopeless_weights_are_refused() {
        assert!(AliasTable::new(&[]).is_none());
        assert!(AliasTable::new(&[0.0, 0.0]).is_none());
        assert!(AliasTable::new(&[1.0, f64::NAN]).is_none());
        assert!(AliasTable::new(&[1.0, -1.0]).is_none());
    }
}
