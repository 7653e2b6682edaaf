//! Sampling of a discrete distribution by inversion.
//!
//! Inversion keeps the order of the numbers it is fed, so that low-discrepancy points stay
//! stratified; an alias table would not.

/// A discrete distribution over non-negative weights.
#[derive(Clone, Debug)]
pub struct Discrete {
    /// Cumulative probability up to and including each entry; the last is 1.
    cumulative: Vec<f32>,
    pmf: Vec<f32>,
    /// Per k: about the first entry whose cumulative probability exceeds k/n, where the search of a
    /// u near k/n starts (Chen & Asau
    /// 1974); on average it ends after less than two steps.
    guide: Vec<u32>,
}

impl Discrete {
    /// Builds the distribution; `None` if no weight is positive or the sum is not finite.
    #[must_use]
    pub fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        if !(total > 0.0 && total.is_finite()) || weights.iter().any(|w| w.is_nan() || *w < 0.0) {
            return None;
        }
        let mut sum = 0.0;
        let mut cumulative: Vec<f32> = weights
            .iter()
            .map(|w| {
                sum += w;
                (sum / total) as f32
            })
            .collect();
        let last = weights.iter().rposition(|w| *w > 0.0)?;
        for c in &mut cumulative[last..] {
            *c = 1.0;
        }
        let n = cumulative.len();
        let mut at = 0;
        let guide = (0..n)
            .map(|k| {
                let u = k as f32 / n as f32;
                while at + 1 < n && cumulative[at] <= u {
                    at += 1;
                }
                at as u32
            })
            .collect();
        Some(Self {
            cumulative,
            pmf: weights.iter().map(|w| (w / total) as f32).collect(),
            guide,
        })
    }

    /// Draws an index from `u` in [0, 1); also returns the rest of `u`, again uniform in [0, 1) and
    /// in the same order.
    #[must_use]
    #[inline]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let n = self.cumulative.len();
        let mut i = self.guide[((u * n as f32) as usize).min(n - 1)] as usize;
        while i + 1 < n && self.cumulative[i] <= u {
            i += 1;
        }
        // u · n may have been rounded up to the next k
        while i > 0 && self.cumulative[i - 1] > u {
            i -= 1;
        }
        let below = if i > 0 { self.cumulative[i - 1] } else { 0.0 };
        let width = (self.cumulative[i] - below).max(f32::MIN_POSITIVE);
        (i, ((u - below) / width).clamp(0.0, 1.0 - f32::EPSILON))
    }

    /// Probability of index `i`.
    #[must_use]
    #[inline]
    pub fn pmf(&self, i: usize) -> f32 {
        self.pmf[i]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_follow_the_weights_in_order() {
        let w = [0.0, 1.0, 3.0, 6.0, 0.5, 0.0];
        let d = Discrete::new(&w).expect("positive weights");
        let n = 200_000;
        let mut count = [0usize; 6];
        let (mut rest_sum, mut last) = (0.0f64, 0);
        for i in 0..n {
            let (k, r) = d.sample((i as f32 + 0.5) / n as f32);
            assert!(k >= last, "order is kept");
            last = k;
            count[k] += 1;
            rest_sum += f64::from(r);
        }
        for k in 0..6 {
            let p = w[k] / 10.5;
            assert!(
                (count[k] as f64 / f64::from(n) - p).abs() < 1e-3,
                "index {k}"
            );
            assert!((f64::from(d.pmf(k)) - p).abs() < 1e-6);
        }
        assert!((rest_sum / f64::from(n) - 0.5).abs() < 5e-3);
    }

    #[test]
    fn the_guide_finds_what_a_search_finds() {
        for weights in [
            vec![1.0],
            vec![0.0, 0.0, 1e-9, 5.0, 0.0],
            (0..999)
                .map(|i| f64::from(i % 7) * 1e-3 + f64::from(i / 990) * 50.0)
                .collect(),
        ] {
            let d = Discrete::new(&weights).expect("positive weights");
            let edges = d
                .cumulative
                .iter()
                .flat_map(|c| [c.next_down(), *c, c.next_up()]);
            for u in (0..4096)
                .map(|i| i as f32 / 4096.0)
                .chain(edges)
                .filter(|u| (0.0..1.0).contains(u))
            {
                let expected = d.cumulative.partition_point(|c| *c <= u);
                assert_eq!(d.sample(u).0, expected, "u = {u}");
                assert!(d.pmf(expected) > 0.0);
            }
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
            assert!(Discrete::new(weights).is_none());
        }
    }
}
