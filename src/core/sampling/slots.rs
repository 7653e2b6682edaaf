//! Sampling of a discrete distribution by inversion in constant time, without a search: one lookup,
//! no branch.

/// A discrete distribution over non-negative weights, rounded to multiples of 1/N. What is sampled
/// is exactly what [`Self::pmf`] says, so estimates stay unbiased; like any inversion it keeps the
/// order of the numbers it is fed, hence their stratification.
#[derive(Clone, Debug)]
pub struct SlotTable {
    /// The entry that owns each of the N equal parts of [0, 1).
    owner: Vec<u32>,
    /// First slot and number of slots of each entry.
    share: Vec<[f32; 2]>,
    /// 1/N.
    width: f32,
}

/// Slots per entry of positive weight.
const SLOTS: usize = 4;

impl SlotTable {
    /// Builds the table; `None` if no weight is positive or the sum is not finite. Every positive
    /// weight gets at least one slot.
    #[must_use]
    pub fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        if !(total > 0.0 && total.is_finite()) || weights.iter().any(|w| w.is_nan() || *w < 0.0) {
            return None;
        }
        let n = (SLOTS * weights.iter().filter(|w| **w > 0.0).count()).next_power_of_two();
        let ideal: Vec<f64> = weights.iter().map(|w| w / total * n as f64).collect();
        let mut count: Vec<usize> = ideal
            .iter()
            .zip(weights)
            .map(|(x, w)| (*x as usize).max(usize::from(*w > 0.0)))
            .collect();
        let mut given: usize = count.iter().sum();
        let mut order: Vec<usize> = (0..weights.len()).filter(|&i| weights[i] > 0.0).collect();
        // those that rounding robbed most come first
        let lack = |i: usize, count: &[usize]| ideal[i] - count[i] as f64;
        order.sort_by(|&a, &b| lack(b, &count).total_cmp(&lack(a, &count)).then(a.cmp(&b)));
        while given < n {
            for &i in order.iter().take(n - given) {
                count[i] += 1;
            }
            given = count.iter().sum();
        }
        while given > n {
            let mut excess = given - n;
            for &i in order.iter().rev() {
                let take = usize::from(excess > 0 && count[i] > 1);
                count[i] -= take;
                excess -= take;
            }
            given = count.iter().sum();
        }
        let mut owner = Vec::with_capacity(n);
        let share = count
            .iter()
            .enumerate()
            .map(|(i, &c)| {
                let first = owner.len();
                owner.resize(first + c, i as u32);
                [first as f32, c as f32]
            })
            .collect();
        Some(Self {
            owner,
            share,
            width: 1.0 / n as f32,
        })
    }

    /// Draws an index from `u` in [0, 1); also returns the rest of `u`, again uniform in [0, 1) and
    /// in the same order.
    #[must_use]
    #[inline(always)]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let n = self.owner.len();
        // n is a power of two: the product is exact
        let x = u * n as f32;
        let i = self.owner[(x as usize).min(n - 1)] as usize;
        let [first, count] = self.share[i];
        (i, ((x - first) / count).clamp(0.0, 1.0 - f32::EPSILON))
    }

    /// The entry that owns each slot, in order.
    #[must_use]
    pub fn owners(&self) -> &[u32] {
        &self.owner
    }

    /// First slot and number of slots of entry `i`.
    #[must_use]
    pub fn share(&self, i: usize) -> [f32; 2] {
        self.share[i]
    }

    /// Probability of index `i`.
    #[must_use]
    #[inline(always)]
    pub fn pmf(&self, i: usize) -> f32 {
        self.share[i][1] * self.width
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_are_the_stated_ones_in_order() {
        let many: Vec<f64> = (0..999)
            .map(|i| f64::from(i % 7) * 1e-3 + f64::from(i / 990) * 50.0)
            .collect();
        for w in [
            vec![1.0],
            vec![0.0, 1.0, 3.0, 6.0, 0.5, 0.0],
            vec![1e-300, 1.0, 0.0],
            vec![1e300, 1.0, 1e-300],
            many,
        ] {
            let d = SlotTable::new(&w).expect("positive weights");
            let n = 1 << 18;
            let mut count = vec![0u32; w.len()];
            let (mut rest_sum, mut last) = (0.0f64, 0);
            for i in 0..n {
                let (k, r) = d.sample((i as f32 + 0.5) / n as f32);
                assert!(k >= last && (0.0..1.0).contains(&r), "order is kept");
                last = k;
                count[k] += 1;
                rest_sum += f64::from(r);
            }
            let total: f64 = w.iter().sum();
            let mut sum = 0.0;
            for k in 0..w.len() {
                assert_eq!(
                    f64::from(count[k]) / f64::from(n),
                    f64::from(d.pmf(k)),
                    "index {k}"
                );
                assert_eq!(w[k] > 0.0, d.pmf(k) > 0.0);
                // within the rounding of one slot, or a little less to pay for those that get their
                // least
                assert!(
                    (f64::from(d.pmf(k)) - w[k] / total).abs() < 0.3,
                    "index {k}"
                );
                sum += f64::from(d.pmf(k));
            }
            assert_eq!(sum, 1.0);
            assert!((rest_sum / f64::from(n) - 0.5).abs() < 5e-3);
        }
        // large weights are met closely
        let d = SlotTable::new(&[1.0, 3.0, 6.0, 0.5]).expect("positive weights");
        for (k, w) in [1.0, 3.0, 6.0, 0.5].iter().enumerate() {
            assert!((f64::from(d.pmf(k)) - w / 10.5).abs() <= 1.0 / 16.0);
        }
    }

    #[test]
    fn hopeless_weights_are_refused() {
        for weights in [
            &[][..],
            &[0.0, 0.0],
            &[1.0, f64::NAN],
            &[1.0, -1.0],
            &[f64::INFINITY],
        ] {
            assert!(SlotTable::new(weights).is_none());
        }
    }
}
