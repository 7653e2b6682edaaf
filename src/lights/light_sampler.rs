//! Which lamp a surface point asks for light: every lamp with a probability proportional to the
//! irradiance it is expected to send there, by its shape and by what was learned about its
//! visibility in that part of space.

use crate::core::stats::ROUNDS;
use crate::ffi::simd::{Kernel, LANES, run_widest};
use glam::Vec3;
use std::f32::consts::{FRAC_1_PI, PI};

/// Lamps as their light is judged from afar, a column per property.
#[derive(Default)]
pub(crate) struct LightShapes {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Mean distance of a lamp's pieces from its centre, metres.
    radius: Vec<f32>,
    /// Luminance × area.
    power: Vec<f32>,
    /// Mean of the pieces' outward normals: a unit vector for a flat lamp, zero for a closed one.
    axis: [Vec<f32>; 3],
    /// Share of the power that a lamp sends to all sides alike.
    round: Vec<f32>,
    /// 1/(π · luminance): of a lamp's irradiance times this, a share of the hemisphere rays meets
    /// it.
    dimness: Vec<f32>,
}

/// A flat piece of a lamp.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    pub centre: Vec3,
    /// Unit normal of the side that sends out light.
    pub normal: Vec3,
    /// m².
    pub area: f32,
    /// Luminance × area.
    pub power: f64,
}

/// Least factor on a lamp's probability, however well hemisphere rays meet it and however seldom light of it arrives:
/// what steers samples may err (defensive sampling, after Hesterberg).
/// Measured: ×½ albedo +0.2 dB, ×2 albedo within two errors +1 % (docs/constants.md).
pub(super) const DEFENSIVE: f32 = 0.03;

impl LightShapes {
    /// Adds a lamp.
    pub(crate) fn push(&mut self, pieces: &[Piece]) {
        let power = pieces.iter().map(|p| p.power).sum::<f64>();
        let share = |p: &Piece| (p.power / power) as f32;
        let centre = pieces.iter().map(|p| p.centre * share(p)).sum::<Vec3>();
        let axis = pieces.iter().map(|p| p.normal * share(p)).sum::<Vec3>();
        let radius = pieces
            .iter()
            .map(|p| p.centre.distance_squared(centre) * share(p))
            .sum::<f32>()
            .sqrt();
        self.x.push(centre.x);
        self.y.push(centre.y);
        self.z.push(centre.z);
        self.radius.push(radius);
        self.power.push(power as f32);
        self.axis
            .iter_mut()
            .zip(axis.to_array())
            .for_each(|(column, a)| column.push(a));
        let area = pieces.iter().map(|p| p.area).sum::<f32>();
        self.dimness.push(area * FRAC_1_PI / power as f32);
        // what a convex body shows to one side is a quarter of its surface
        self.round.push(0.25 * (1.0 - axis.length()).max(0.0));
    }

    pub(crate) fn len(&self) -> usize {
        self.x.len()
    }

    pub(crate) fn centres_and_powers(&self) -> impl Iterator<Item = (Vec3, f64)> + '_ {
        (0..self.len()).map(|k| {
            (
                Vec3::new(self.x[k], self.y[k], self.z[k]),
                f64::from(self.power[k]),
            )
        })
    }

    /// Turns expected irradiance into the probabilities, up to a factor, that suit samples combined
    /// with `rays` cosine-distributed rays each. Rays meet large lamps anyway: under the balance
    /// heuristic a lamp of irradiance E and luminance L adds to the variance as E²/(q + h E/(πL)),
    /// for samples of probability q and h rays per sample. The least sum has q ∝ E·(1 −
    /// h/(πL·level)) where that is positive, and 0 elsewhere, the level being such that Σ q = 1.
    pub(crate) fn rebalance(&self, rays: f32, weights: &mut [f32]) {
        run_widest(Rebalance {
            rays,
            dimness: &self.dimness[..weights.len()],
            weights,
        });
    }

    /// Writes the unoccluded irradiance that each lamp is expected to send to a point, times
    /// `reach`.
    pub(crate) fn expected(&self, p: Vec3, normal: Vec3, reach: &[f32], out: &mut Vec<f32>) {
        out.clear();
        out.resize(self.len(), 0.0);
        run_widest(Expected {
            lamps: self,
            p,
            normal,
            reach,
            out,
        });
    }
}

/// [`LightShapes::expected`].
struct Expected<'a> {
    lamps: &'a LightShapes,
    p: Vec3,
    normal: Vec3,
    reach: &'a [f32],
    out: &'a mut [f32],
}

impl Kernel for Expected<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            lamps: l,
            p,
            normal,
            reach,
            out,
        } = self;
        let n = out.len();
        let [x, y, z, radius, power, round] =
            [&l.x, &l.y, &l.z, &l.radius, &l.power, &l.round].map(|c| &c[..n]);
        // flat pieces that lie normally distributed about the centre, seen under a grazing angle, still shine as much
        // as this share of their angular size
        let slack = (6.0 * PI).sqrt().recip();
        let ([ax, ay, az], reach) = (l.axis.each_ref().map(|c| &c[..n]), &reach[..n]);
        for k in 0..n {
            let d = Vec3::new(x[k], y[k], z[k]) - p;
            let d2 = d.length_squared() + radius[k] * radius[k] + f32::MIN_POSITIVE;
            let inverse = 1.0 / d2.sqrt();
            let size = radius[k] * inverse;
            let cosine = ((normal.dot(d) * inverse + size) / (1.0 + size)).max(0.0);
            let facing = (-(ax[k] * d.x + ay[k] * d.y + az[k] * d.z) * inverse).max(0.0)
                + round[k]
                + slack * size;
            out[k] = power[k] * reach[k] * cosine * facing * (inverse * inverse);
        }
    }
}

/// [`LightShapes::rebalance`].
struct Rebalance<'a> {
    rays: f32,
    dimness: &'a [f32],
    weights: &'a mut [f32],
}

impl Kernel for Rebalance<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            rays,
            dimness,
            weights,
        } = self;
        let mut level = f32::INFINITY;
        // what lies above the level is left out, which lowers it
        for _ in 0..ROUNDS {
            let [sum, met] = sums_below(level / rays, weights, dimness);
            let next = (1.0 + rays * met) / sum;
            if next.is_nan() || next >= level {
                break;
            }
            level = next;
        }
        let slope = rays / level;
        for (w, d) in weights.iter_mut().zip(dimness) {
            *w *= (1.0 - slope * d).max(DEFENSIVE);
        }
    }
}

/// Σ w and Σ w·d over those whose d is below `limit`, in lanes whose order is the same on every
/// processor: a single sum would wait for every addition.
#[inline(always)]
fn sums_below(limit: f32, weights: &[f32], dimness: &[f32]) -> [f32; 2] {
    let (mut sum, mut met) = ([0.0f32; LANES], [0.0f32; LANES]);
    let (weights, weights_end) = weights.as_chunks::<LANES>();
    let (dimness, dimness_end) = dimness.as_chunks::<LANES>();
    for (w, d) in weights.iter().zip(dimness) {
        for l in 0..LANES {
            let w = if d[l] < limit { w[l] } else { 0.0 };
            sum[l] += w;
            met[l] += w * d[l];
        }
    }
    for (l, (w, d)) in weights_end.iter().zip(dimness_end).enumerate() {
        let w = if *d < limit { *w } else { 0.0 };
        sum[l] += w;
        met[l] += w * d;
    }
    [sum.iter().sum(), met.iter().sum()]
}

/// The sums of the weights up to and with each, found in as many stretches as there are lanes;
/// weights become what is left of them there after rounding.
struct Sums<'a> {
    weights: &'a mut [f32],
    ends: &'a mut [f32],
}

impl Kernel for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { weights, ends } = self;
        let length = weights.len() / LANES;
        let mut sums = [0.0f32; LANES];
        for k in 0..length {
            for (s, sum) in sums.iter_mut().enumerate() {
                *sum += weights[s * length + k];
                ends[s * length + k] = *sum;
            }
        }
        let (stretches, rest) = ends.split_at_mut(LANES * length);
        let mut before = 0.0;
        for (stretch, sum) in stretches.chunks_exact_mut(length.max(1)).zip(sums) {
            // (the same added to ascending numbers leaves them ascending)
            stretch.iter_mut().for_each(|end| *end += before);
            before += sum;
        }
        for (end, w) in rest.iter_mut().zip(&weights[LANES * length..]) {
            before += w;
            *end = before;
        }
        let mut before = 0.0;
        for (w, end) in weights.iter_mut().zip(&*ends) {
            (*w, before) = (end - before, *end);
        }
    }
}

/// The probability of each lamp at one point. What is sampled is exactly what [`Self::pmf`] says;
/// lamps keep the order of the numbers they are drawn by, hence their stratification.
#[derive(Clone, Debug, Default)]
pub struct LightSampler {
    /// Sums of the weights up to and with each lamp.
    ends: Vec<f32>,
    weights: Vec<f32>,
    inverse: f32,
}

impl LightSampler {
    /// Takes the weights that `fill` writes, one per lamp.
    pub(crate) fn set(&mut self, fill: impl FnOnce(&mut Vec<f32>)) {
        fill(&mut self.weights);
        self.ends.resize(self.weights.len(), 0.0);
        run_widest(Sums {
            weights: &mut self.weights,
            ends: &mut self.ends,
        });
        let sum = self.ends.last().copied().unwrap_or(0.0);
        self.inverse = if sum > 0.0 && sum.is_finite() {
            1.0 / sum
        } else {
            0.0
        };
    }

    /// Whether no lamp can send light to the point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inverse == 0.0
    }

    /// Draws a lamp from `u` in [0, 1); also the rest of `u`, again uniform in [0, 1) and in the
    /// same order.
    #[inline(always)]
    pub(crate) fn sample(&self, u: f32) -> (usize, f32) {
        let x = u * self.sum();
        // the first that ends behind x has a positive weight
        let k = self
            .ends
            .partition_point(|end| *end <= x)
            .min(self.ends.len() - 1);
        (k, rest(self.start(k), x))
    }

    /// Writes for each of `cells` equal parts of [0, 1) the first lamp that [`Self::sample_in`] can
    /// draw there: it pays where many are drawn.
    pub(crate) fn guide(&self, cells: usize, first: &mut Vec<u32>) {
        first.clear();
        first.resize(cells + 1, 0);
        // a lamp may end a rounding later than it does: it is only looked at in vain
        let scale = cells as f32 / self.sum() * (1.0 + 4.0 * f32::EPSILON);
        for (end, lamp) in self.ends.iter().zip(1..) {
            first[((end * scale) as usize).min(cells)] = lamp;
        }
        let mut ended = 0;
        for f in first.iter_mut() {
            (*f, ended) = (ended, ended.max(*f));
        }
    }

    /// What [`Self::sample`] draws from `u`; `first` is its part's entry of [`Self::guide`].
    #[inline(always)]
    pub(crate) fn sample_in(&self, first: u32, u: f32) -> (usize, f32) {
        let (x, last) = (u * self.sum(), self.ends.len() - 1);
        let first = (first as usize).min(last);
        // mostly one step or none: not a branch that would be guessed wrongly
        let mut lamp = (first + usize::from(self.ends[first] <= x)).min(last);
        while self.ends[lamp] <= x && lamp < last {
            lamp += 1;
        }
        (lamp, rest(self.start(lamp), x))
    }

    fn sum(&self) -> f32 {
        self.ends[self.ends.len() - 1]
    }

    /// Where lamp `k` starts among the numbers below the sum of the weights, and one over its
    /// weight.
    fn start(&self, k: usize) -> [f32; 2] {
        [self.ends[k] - self.weights[k], 1.0 / self.weights[k]]
    }

    /// Probability of lamp `k`.
    #[must_use]
    #[inline(always)]
    pub fn pmf(&self, k: usize) -> f32 {
        self.weights[k] * self.inverse
    }
}

/// How far into a lamp with the given [`LightSampler::start`] the number `x` lies, in [0, 1).
#[inline(always)]
fn rest([start, per_weight]: [f32; 2], x: f32) -> f32 {
    ((x - start) * per_weight).clamp(0.0, 1.0 - f32::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_are_drawn_as_often_as_stated_and_in_order() {
        let mut choice = LightSampler::default();
        let weights = [0.0, 3.0, 1e-9, 0.0, 5.0, 0.25, 0.0];
        choice.set(|w| *w = weights.to_vec());
        assert!(!choice.is_empty());
        let n = 1 << 16;
        let (mut count, mut rest_sum, mut last) = ([0u32; 7], 0.0f64, 0);
        let guides = [1, 8, 64].map(|cells| {
            let mut first = Vec::new();
            choice.guide(cells, &mut first);
            (cells, first)
        });
        for i in 0..n {
            let u = (i as f32 + 0.5) / n as f32;
            let (k, rest) = choice.sample(u);
            assert!(k >= last && (0.0..1.0).contains(&rest));
            for (cells, first) in &guides {
                assert_eq!(
                    choice.sample_in(first[(u * *cells as f32) as usize], u),
                    (k, rest)
                );
            }
            last = k;
            count[k] += 1;
            rest_sum += f64::from(rest);
        }
        for (k, w) in weights.iter().enumerate() {
            assert!((choice.pmf(k) - w / 8.25).abs() < 1e-6, "lamp {k}");
            assert!(
                (f64::from(count[k]) / f64::from(n) - f64::from(choice.pmf(k))).abs()
                    < 2.0 / f64::from(n),
                "lamp {k}"
            );
        }
        assert!((rest_sum / f64::from(n) - 0.5).abs() < 1e-3);
        choice.set(|w| w.fill(0.0));
        assert!(choice.is_empty());
    }

    /// The variance that a choice leaves, and that of choices near it.
    #[test]
    fn rebalanced_probabilities_leave_the_least_variance() {
        // (area, power): small and bright to large and dim
        let lamps = [(0.01, 3.0), (0.5, 2.0), (2.0, 1.5), (6.0, 1.0), (0.2, 0.4)];
        let expected = [0.5f64, 0.8, 0.3, 0.6, 0.1];
        let mut shapes = LightShapes::default();
        for (area, power) in lamps {
            shapes.push(&[Piece {
                centre: Vec3::Z,
                normal: Vec3::NEG_Z,
                area,
                power,
            }]);
        }
        let rays = 4.0;
        let mut weights = expected.map(|e| e as f32);
        shapes.rebalance(rays, &mut weights);
        let sum: f64 = weights.iter().map(|w| f64::from(*w)).sum();
        let q = weights.map(|w| f64::from(w) / sum);
        let variance = |q: &[f64; 5]| -> f64 {
            let met = |k: usize| {
                f64::from(rays) * f64::from(lamps[k].0) / (std::f64::consts::PI * lamps[k].1)
            };
            (0..5)
                .map(|k| expected[k].powi(2) / (q[k] + expected[k] * met(k)))
                .sum()
        };
        let by_expectation = expected.map(|e| e / expected.iter().sum::<f64>());
        assert!(
            variance(&q) < 0.98 * variance(&by_expectation),
            "{} {}",
            variance(&q),
            variance(&by_expectation)
        );
        // what the floor gives is not the optimum's
        let above_floor =
            |k: &usize| f64::from(weights[*k]) > 1.01 * f64::from(DEFENSIVE) * expected[*k];
        assert_eq!((0..5).filter(above_floor).collect::<Vec<_>>(), [0, 1, 4]);
        for from in (0..5).filter(above_floor) {
            for to in 0..5 {
                let mut other = q;
                let step = 0.02f64.min(q[from]);
                other[from] -= step;
                other[to] += step;
                assert!(
                    variance(&other) > 0.999 * variance(&q),
                    "{from} to {to}: {q:?}"
                );
            }
        }
        let mut none = [0.0f32; 5];
        shapes.rebalance(rays, &mut none);
        assert_eq!(none, [0.0; 5]);
    }

    #[test]
    fn what_is_expected_of_a_small_flat_lamp_is_its_irradiance() {
        let mut shapes = LightShapes::default();
        shapes.push(&[Piece {
            centre: Vec3::new(0.0, 0.0, 2.0),
            normal: Vec3::NEG_Z,
            area: 1.0,
            power: 3.0,
        }]);
        let mut expected = Vec::new();
        let mut of = |p: Vec3, n: Vec3| {
            shapes.expected(p, n, &[1.0], &mut expected);
            expected[0]
        };
        assert!((of(Vec3::ZERO, Vec3::Z) - 3.0 / 4.0).abs() < 1e-6);
        let p = Vec3::new(1.5, 0.0, 0.0);
        // both cosines are 2/2.5
        assert!((of(p, Vec3::Z) - 3.0 * 0.64 / 6.25).abs() < 1e-6);
        // from behind the lamp, and behind the surface
        assert_eq!(of(Vec3::new(0.0, 0.0, 4.0), Vec3::NEG_Z), 0.0);
        assert_eq!(of(Vec3::ZERO, Vec3::NEG_Z), 0.0);
    }

    #[test]
    fn a_round_lamp_shines_to_all_sides_and_a_large_one_around_the_horizon() {
        let mut shapes = LightShapes::default();
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let ball: Vec<Piece> = axes
            .iter()
            .flat_map(|a| [*a, -*a])
            .map(|a| Piece {
                centre: 0.5 * a,
                normal: a,
                area: 1.0,
                power: 1.0,
            })
            .collect();
        shapes.push(&ball);
        let mut expected = Vec::new();
        let mut of = |p: Vec3, n: Vec3| {
            shapes.expected(p, n, &[1.0], &mut expected);
            expected[0]
        };
        for a in axes {
            assert!((of(3.0 * a, -a) - of(-3.0 * Vec3::X, Vec3::X)).abs() < 1e-5);
        }
        // its upper half rises above the horizon of a surface that looks up
        assert!(of(Vec3::new(3.0, 0.0, 0.0), Vec3::Z) > 0.0);
    }
}
