//! Exposure and white balance of every view from what the views share.
//!
//! A surface point sends nearly the same radiance to all views that see it, so ln L = ln D(point) +
//! g(view) for each channel. The points' D are eliminated in closed form and the views' g solved by
//! iteratively reweighted least squares with Geman-McClure weights, which highlights and
//! misregistrations cannot bend; the gauge is a geometric mean of 1 over the views. Where the views
//! still contradict each other, geometry is only roughly right, and pairs of views vote instead
//! ([`super::pair_gains`]).

use super::pair_gains::{Look, pairwise_gains};
use crate::core::math::luminance;
use crate::core::parallel;
use crate::gbuffer::{Observation, Observer, Orientation};
use glam::Vec3;
use nalgebra::DMatrix;

/// Points in all, and the bounds per view.
const POINTS: usize = 24_000;
const PER_VIEW: (usize, usize) = (60, 1500);
/// Points that a thread works on at a time.
const POINTS_PER_PIECE: usize = 256;
/// Looks more slanting than this are left out: they see mostly reflection.
const MIN_COSINE: f32 = 0.25;
const ITERATIONS: usize = 25;
/// Iterations over which the weights narrow.
const ANNEALING: usize = 10;
/// Gains are believed if they remove this share of the disagreement between views, and differ by
/// this much at least (RMS).
const REMOVED: f32 = 0.1;
const NOTICEABLE: f32 = 0.01;

/// Median disagreement beyond which points are not believed to be the same surface in all views.
/// Measured: gloss and misregistration leave 0.8 to 7.6 % on the known scenes (most on aws-house),
/// the house without its furniture and doors 18.4 % (`docs/lab/real-house.md`); the bar is the
/// geometric mean of the two.
const ROUGH: f32 = 0.12;

/// The gains of all views.
#[derive(Clone, Debug, Default)]
pub struct ViewGains {
    /// ln of photographed over consistent radiance, per view and channel; the mean over views is 0.
    pub log_gain: Vec<Vec3>,
    /// Median relative disagreement of a look with the others at its point, without the gains.
    pub before: f32,
    /// The same with the gains.
    pub after: f32,
    /// Points seen in two views at least.
    pub points: usize,
    /// Standard error of ln gain per view, where pairs of views voted because the geometry is only
    /// roughly right; empty otherwise.
    pub error: Vec<f32>,
}

impl ViewGains {
    /// Whether most points are not the same surface in all views: geometry is missing or only
    /// roughly right.
    #[must_use]
    pub fn geometry_is_rough(&self) -> bool {
        !self.error.is_empty()
    }

    /// Root mean square of ln gain over views and channels.
    #[must_use]
    pub fn rms(&self) -> f32 {
        let square: f32 = self.log_gain.iter().map(|g| g.length_squared()).sum();
        (square / (3 * self.log_gain.len()).max(1) as f32).sqrt()
    }

    /// Whether the views ask for it: the gains must explain a good part of their disagreement, not
    /// merely fit noise; or differ by more than their errors.
    #[must_use]
    pub fn is_needed(&self) -> bool {
        let significant = || {
            let error: f32 = self.error.iter().map(|e| e * e).sum();
            self.rms() > 2.0 * (error / self.error.len() as f32).sqrt()
        };
        let explained = self.after < (1.0 - REMOVED) * self.before;
        self.rms() > NOTICEABLE && (explained || (self.geometry_is_rough() && significant()))
    }

    /// What an image of view `v` is multiplied by.
    #[must_use]
    pub fn correction(&self, v: usize) -> Vec3 {
        (-self.log_gain[v]).exp()
    }
}

/// Solves for the gains; zeros where views share nothing.
#[must_use]
pub fn estimate_gains(observer: &Observer, orientation: &Orientation) -> ViewGains {
    let views = observer.views.len();
    let (looks, ends) = shared_looks(observer, orientation);
    let mut gains = ViewGains {
        log_gain: vec![Vec3::ZERO; views],
        points: ends.len(),
        ..ViewGains::default()
    };
    if views < 2 || ends.is_empty() {
        return gains;
    }
    let points: Vec<&[Look]> = (0..ends.len())
        .map(|i| &looks[if i == 0 { 0 } else { ends[i - 1] }..ends[i]])
        .collect();
    gains.before = disagreement(&points, &gains.log_gain);
    for i in 0..ITERATIONS {
        let scale = scale(&points, &gains.log_gain, i);
        let next = solve(&points, &gains.log_gain, scale);
        let step = next
            .iter()
            .zip(&gains.log_gain)
            .map(|(a, b)| (*a - *b).abs().max_element())
            .fold(0.0, f32::max);
        gains.log_gain = next;
        if step < 1e-5 && i >= ANNEALING {
            break;
        }
    }
    gains.after = disagreement(&points, &gains.log_gain);
    if gains.after > ROUGH {
        (gains.log_gain, gains.error) = pairwise_gains(&points, views);
        gains.after = disagreement(&points, &gains.log_gain);
    }
    gains
}

/// Deviation at which a look's weight is a quarter: wide at first, so that drift of any size is
/// caught, then narrowing to the quarter of the looks that agree best, which are those of matte
/// surfaces. Glossy ones would tilt the gains by what they mirror.
fn scale(points: &[&[Look]], gains: &[Vec3], iteration: usize) -> f32 {
    let [wide, narrow] = quantiles(points, gains, [0.5, 0.25]);
    let t = (iteration as f32 / ANNEALING as f32).min(1.0);
    (1.5 * wide * (1.0 - t) + narrow * t).max(1e-4)
}

/// Clean, frontal looks at points spread over the pixels of all views; `ends[i]` ends the looks of
/// point i.
fn shared_looks(observer: &Observer, orientation: &Orientation) -> (Vec<Look>, Vec<usize>) {
    let per_view = (POINTS / observer.views.len().max(1)).clamp(PER_VIEW.0, PER_VIEW.1);
    let parts = parallel::map_chunks(observer.views.len(), 1, |range| {
        let mut out: Vec<Vec<Look>> = Vec::new();
        let mut seen: Vec<Observation> = Vec::new();
        for view in range.map(|v| &observer.views[v]) {
            let (w, h) = (view.clean.width, view.clean.height);
            let stride = (w * h / per_view).max(1);
            // an odd phase per row keeps the samples from lining up in columns
            for i in (stride / 2..w * h).step_by(stride) {
                let (x, y) = ((i + 7 * (i / w)) % w, i / w);
                if !view.clean[(x, y)] {
                    continue;
                }
                let t = view.buffer.triangle[(x, y)] as usize;
                let normal = observer.mesh.face_normal(t) * orientation.sign(t);
                observer.observe(view.buffer.position(x, y), normal, &mut seen);
                seen.retain(|o| o.clean && o.n_v > MIN_COSINE && o.radiance.min_element() > 0.0);
                if seen.len() >= 2 {
                    out.push(
                        seen.iter()
                            .map(|o| (o.view, o.radiance.map(f32::ln), o.n_v))
                            .collect(),
                    );
                }
            }
        }
        out
    });
    let (mut looks, mut ends) = (Vec::new(), Vec::new());
    for point in parts.into_iter().flatten() {
        looks.extend(point);
        ends.push(looks.len());
    }
    (looks, ends)
}

/// A point's level given the gains: the median look by luminance, the darker of two (reflections
/// only add).
fn level(point: &[Look], gains: &[Vec3], order: &mut Vec<(f32, Vec3)>) -> Vec3 {
    order.clear();
    order.extend(point.iter().map(|l| {
        let v = l.1 - gains[l.0 as usize];
        (luminance(v), v)
    }));
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order[(order.len() - 1) / 2].1
}

/// Median over all looks of the mean absolute deviation of its channels from its point's level.
fn disagreement(points: &[&[Look]], gains: &[Vec3]) -> f32 {
    let [median] = quantiles(points, gains, [0.5]);
    median
}

/// Quantiles of the deviations of all looks from their points' levels.
fn quantiles<const N: usize>(points: &[&[Look]], gains: &[Vec3], shares: [f64; N]) -> [f32; N] {
    let parts = parallel::map_chunks(points.len(), POINTS_PER_PIECE, |range| {
        let mut order = Vec::new();
        let mut found: Vec<f32> = Vec::new();
        for p in &points[range] {
            let centre = level(p, gains, &mut order);
            // the look that is the level itself says nothing
            found.extend(
                p.iter()
                    .map(|l| distance(l.1 - gains[l.0 as usize] - centre))
                    .filter(|d| *d > 0.0),
            );
        }
        found
    });
    let mut all = parts.concat();
    shares.map(|share| {
        let at = (all.len() as f64 * share) as usize;
        if at < all.len() {
            *all.select_nth_unstable_by(at, f32::total_cmp).1
        } else {
            0.0
        }
    })
}

fn distance(e: Vec3) -> f32 {
    e.abs().element_sum() / 3.0
}

/// The looks at a point, weighed by how well they agree with its level.
struct Weighted {
    weights: Vec<f64>,
    total: f64,
    /// Weighted mean of the looks.
    mean: [f64; 3],
}

impl Weighted {
    fn of(p: &[Look], gains: &[Vec3], scale: f32, order: &mut Vec<(f32, Vec3)>) -> Self {
        let centre = level(p, gains, order);
        let weight = |l: &Look| {
            let r = distance(l.1 - gains[l.0 as usize] - centre) / scale;
            f64::from(l.2 / (1.0 + r * r).powi(2))
        };
        let weights: Vec<f64> = p.iter().map(weight).collect();
        let total: f64 = weights.iter().sum();
        let mean = std::array::from_fn(|c| {
            p.iter()
                .zip(&weights)
                .map(|(l, w)| w * f64::from(l.1[c]))
                .sum::<f64>()
                / total
        });
        Self {
            weights,
            total,
            mean,
        }
    }
}

/// One step of reweighted least squares: the points' levels eliminated, a dense system over the
/// views.
fn solve(points: &[&[Look]], gains: &[Vec3], scale: f32) -> Vec<Vec3> {
    let n = gains.len();
    let weighted = parallel::map_chunks(points.len(), POINTS_PER_PIECE, |range| {
        let mut order = Vec::new();
        let weigh = |p: &&[Look]| Weighted::of(p, gains, scale, &mut order);
        points[range].iter().map(weigh).collect::<Vec<_>>()
    });
    // every view's looks, as point and place in it
    let mut of_view: Vec<Vec<(u32, u32)>> = vec![Vec::new(); n];
    for (i, p) in points.iter().enumerate() {
        for (k, l) in p.iter().enumerate() {
            of_view[l.0 as usize].push((i as u32, k as u32));
        }
    }
    let rows = parallel::map_chunks(n, 1, |range| {
        let row = |i: usize| {
            let (mut a, mut b) = (vec![0.0f64; n], [0.0f64; 3]);
            for &(point, k) in &of_view[i] {
                let (p, k) = (points[point as usize], k as usize);
                let point = point as usize;
                let known = &weighted[point / POINTS_PER_PIECE][point % POINTS_PER_PIECE];
                let w = known.weights[k];
                a[i] += w;
                for (m, v) in p.iter().zip(&known.weights) {
                    a[m.0 as usize] -= w * v / known.total;
                }
                for (c, b) in b.iter_mut().enumerate() {
                    *b += w * (f64::from(p[k].1[c]) - known.mean[c]);
                }
            }
            (a, b)
        };
        range.map(row).collect::<Vec<_>>()
    });
    let rows: Vec<(Vec<f64>, [f64; 3])> = rows.into_iter().flatten().collect();
    let mut a = DMatrix::<f64>::from_fn(n, n, |i, j| rows[i].0[j]);
    let b = DMatrix::<f64>::from_fn(n, 3, |i, c| rows[i].1[c]);
    // the gauge, and a touch of ridge that holds views which share nothing with the rest at their
    // own mean
    let trace = a.trace().max(f64::MIN_POSITIVE);
    a.add_scalar_mut(1e-3 * trace / (n * n) as f64);
    for i in 0..n {
        a[(i, i)] += 1e-6 * trace / n as f64;
    }
    let Some(factors) = a.cholesky() else {
        return gains.to_vec();
    };
    let x = factors.solve(&b);
    let mean = x.row_mean();
    x.row_iter()
        .map(|g| Vec3::from_array(std::array::from_fn(|c| (g[c] - mean[c]) as f32)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    /// Points of known level seen by some of eight views with known gains; a fifth of the looks
    /// shows a highlight.
    fn looks(gain: impl Fn(usize) -> Vec3) -> Vec<Vec<Look>> {
        let mut rng = KeyedRng::new(11, 0);
        (0..4000)
            .map(|_| {
                let d = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 3.0 - 2.0;
                let first = rng.below(8);
                (0..2 + rng.below(3))
                    .map(|k| {
                        let v = (first + k) % 8;
                        let noise = 0.02 * (rng.next_f32() + rng.next_f32() - 1.0);
                        let highlight = if rng.next_f32() < 0.2 {
                            rng.next_f32()
                        } else {
                            0.0
                        };
                        (v as u32, d + gain(v) + noise + highlight, 0.5)
                    })
                    .collect()
            })
            .collect()
    }

    fn solved(points: &[Vec<Look>]) -> ViewGains {
        let points: Vec<&[Look]> = points.iter().map(Vec::as_slice).collect();
        let mut g = ViewGains {
            log_gain: vec![Vec3::ZERO; 8],
            points: points.len(),
            ..ViewGains::default()
        };
        g.before = disagreement(&points, &g.log_gain);
        for i in 0..ITERATIONS {
            g.log_gain = solve(&points, &g.log_gain, scale(&points, &g.log_gain, i));
        }
        g.after = disagreement(&points, &g.log_gain);
        g
    }

    #[test]
    fn drift_is_recovered_beside_highlights() {
        let truth = |v: usize| Vec3::new(0.1, 0.12, 0.08) * (v as f32 - 3.5);
        let g = solved(&looks(truth));
        assert!(g.is_needed(), "{g:?}");
        for v in 0..8 {
            assert!(
                (g.log_gain[v] - truth(v)).abs().max_element() < 0.01,
                "view {v}: {} for {}",
                g.log_gain[v],
                truth(v)
            );
            assert!((g.correction(v) * truth(v).exp() - 1.0).abs().max_element() < 0.02);
        }
    }

    #[test]
    fn without_drift_nothing_is_asked_for() {
        let g = solved(&looks(|_| Vec3::ZERO));
        assert!(g.rms() < 0.005 && !g.is_needed(), "{g:?}");
    }

    /// Gradient row: with constant weights the step is the minimum of Σ w ‖l − D − g‖² over gains
    /// and levels together, so central differences of that loss vanish in every gain (and only
    /// there).
    #[test]
    fn a_step_is_stationary_in_every_gain() {
        let truth = |v: usize| Vec3::new(0.1, -0.05, 0.02) * (v as f32 - 3.5);
        let points = looks(truth);
        let points: Vec<&[Look]> = points.iter().map(Vec::as_slice).collect();
        let gains = solve(&points, &[Vec3::ZERO; 8], 1e9);
        let loss = |gains: &[Vec3]| -> f64 {
            let at = |l: &Look, c: usize| f64::from(l.1[c]) - f64::from(gains[l.0 as usize][c]);
            let of = |p: &&[Look], c: usize| {
                let total: f64 = p.iter().map(|l| f64::from(l.2)).sum();
                let level = p.iter().map(|l| f64::from(l.2) * at(l, c)).sum::<f64>() / total;
                p.iter()
                    .map(|l| f64::from(l.2) * (at(l, c) - level).powi(2))
                    .sum::<f64>()
            };
            points
                .iter()
                .map(|p| (0..3).map(|c| of(p, c)).sum::<f64>())
                .sum()
        };
        let slope = |gains: &[Vec3], v: usize, c: usize| {
            let (mut a, mut b) = (gains.to_vec(), gains.to_vec());
            a[v][c] += 1e-2;
            b[v][c] -= 1e-2;
            (loss(&a) - loss(&b)) / 2e-2
        };
        for v in 0..8 {
            for c in 0..3 {
                let (there, elsewhere) = (slope(&gains, v, c), slope(&[Vec3::ZERO; 8], v, c));
                assert!(
                    there.abs() < 1e-3 * elsewhere.abs().max(10.0),
                    "view {v}, channel {c}: {there} beside {elsewhere}"
                );
            }
        }
    }

    #[test]
    fn one_view_or_none_needs_nothing() {
        assert!(!ViewGains::default().is_needed());
        assert_eq!(ViewGains::default().rms(), 0.0);
    }
}
