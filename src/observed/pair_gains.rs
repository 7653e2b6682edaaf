//! Exposure and white balance of views where geometry is only roughly right: pairs of views vote.
//!
//! Where furniture and door leaves are missing from the mesh, most points that two views share may
//! show two different things, and a joint fit of all points follows whatever happens to agree. The
//! ratio of two photographs is the same at all points that both do see, so the densest ratio of a
//! pair is its estimate, and the share of points near it says what it is worth. Exposures then are
//! the weighted least absolute deviations from the pairs' ratios (Koenker & Bassett 1978, solved by
//! reweighted least squares), which a minority of wrong pairs cannot bend, along chains of rooms
//! and with a prior for views that share little. White balance likewise. Called by
//! [`super::estimate_gains`].

use glam::Vec3;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// One look at a point: view, ln radiance, weight.
pub(super) type Look = (u32, Vec3, f32);

/// Standard deviation of ln exposure between views: cameras that expose for themselves indoors
/// range over some ±1.5 stops (measured on the house: 0.55 to 3.8 times the mean). Twice that, so
/// that the pull of a long chain of rooms does not break its weakest link.
const EXPOSURE_SD: f64 = 2.0;
/// Standard deviation of ln of a channel's white balance: daylight against warm lamps is a factor
/// of 2 between blue and red, of which a camera takes out a part.
const BALANCE_SD: f64 = 0.15;
/// Points a pair must share.
const FEWEST: usize = 20;
/// Mean over channels of |ln ratio − the pair's| up to which a point counts as seen by both.
const INLIER: f32 = 0.2;
/// Share of such points from which a pair says anything.
const LEAST_SHARE: f32 = 0.15;
/// Error of a pair however many points it has: gloss, response, mixed pixels.
const MODEL_ERROR: f32 = 0.05;
/// Ratios from which the densest is looked for, and steps towards it.
const STARTS: usize = 48;
const SHIFTS: usize = 8;
/// Residuals below this share of a pair's error weigh alike, which makes the fit smooth there.
const SMOOTH: f64 = 0.1;
const ITERATIONS: usize = 100;

/// What two views say about each other.
#[derive(Clone, Copy, Debug)]
struct Pair {
    views: [usize; 2],
    /// ln of the first's photographed radiance over the second's, per channel.
    ratio: Vec3,
    /// Standard error of its mean over channels.
    error: f32,
}

/// ln gains of the views (mean 0) and their standard errors; views that share nothing with others
/// keep a gain of 1 and the prior's error.
pub(super) fn pairwise_gains(points: &[&[Look]], views: usize) -> (Vec<Vec3>, Vec<f32>) {
    let pairs = pairs(points);
    let grey = |p: &Pair| p.ratio.element_sum() / 3.0;
    let exposure = least_absolute(&pairs, views, EXPOSURE_SD, &grey);
    let balance: [Fit; 3] = std::array::from_fn(|c| {
        least_absolute(&pairs, views, BALANCE_SD, &|p| p.ratio[c] - grey(p))
    });
    let gains = (0..views)
        .map(|v| Vec3::from_array(std::array::from_fn(|c| balance[c].value[v] as f32)))
        .zip(&exposure.value)
        .map(|(b, e)| b - b.element_sum() / 3.0 + *e as f32);
    (gains.collect(), exposure.error)
}

/// The pairs of views with what their shared points say.
fn pairs(points: &[&[Look]]) -> Vec<Pair> {
    let mut ratios: BTreeMap<[u32; 2], Vec<Vec3>> = BTreeMap::new();
    for point in points {
        for (i, a) in point.iter().enumerate() {
            for b in &point[i + 1..] {
                let (first, second) = if a.0 < b.0 { (a, b) } else { (b, a) };
                let ratio = first.1 - second.1;
                ratios.entry([first.0, second.0]).or_default().push(ratio);
            }
        }
    }
    ratios
        .into_iter()
        .filter_map(|(views, ratios)| pair(views.map(|v| v as usize), &ratios))
        .collect()
}

fn pair(views: [usize; 2], ratios: &[Vec3]) -> Option<Pair> {
    if ratios.len() < FEWEST {
        return None;
    }
    let centre = densest(ratios);
    let near = ratios.iter().filter(|r| distance(**r, centre) < INLIER);
    let near = near.count() as f32;
    let share = near / ratios.len() as f32;
    if share < LEAST_SHARE {
        return None;
    }
    // a door's wood before a wall's paint looks like a strong change of white balance
    let colour = centre - Vec3::splat(centre.element_sum() / 3.0);
    let variance = MODEL_ERROR.powi(2)
        + colour.length_squared() / 3.0
        + (MODEL_ERROR / share.powi(2)).powi(2)
        + 1.0 / near;
    Some(Pair {
        views,
        ratio: centre,
        error: variance.sqrt(),
    })
}

/// The ratio around which most of some ratios lie: the densest of some of them, refined by mean
/// shift (Fukunaga & Hostetler 1975).
fn densest(ratios: &[Vec3]) -> Vec3 {
    let near = |centre: Vec3| {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for r in ratios {
            let w = (1.0 + (distance(*r, centre) / INLIER).powi(2)).powi(-2);
            sum += *r * w;
            total += w;
        }
        (sum / total, total)
    };
    let starts = ratios.iter().step_by(ratios.len().div_ceil(STARTS).max(1));
    let tried = starts.map(|r| near(*r));
    let best = tried.reduce(|a, b| if b.1 > a.1 { b } else { a });
    let mut centre = best.map_or(Vec3::ZERO, |b| b.0);
    for _ in 0..SHIFTS {
        centre = near(centre).0;
    }
    centre
}

/// Mean over channels of the absolute difference.
fn distance(a: Vec3, b: Vec3) -> f32 {
    (a - b).abs().element_sum() / 3.0
}

/// A gain per view with its standard error; the mean gain is 0.
struct Fit {
    value: Vec<f64>,
    error: Vec<f32>,
}

/// Minimises Σ |g_a − g_b − value|/error over the pairs plus Σ (g/prior)²/2.
fn least_absolute(pairs: &[Pair], views: usize, prior: f64, value: &dyn Fn(&Pair) -> f32) -> Fit {
    let mut gains = vec![0.0; views];
    let mut error = vec![prior as f32; views];
    for _ in 0..ITERATIONS {
        let mut a = DMatrix::<f64>::identity(views, views) / prior.powi(2);
        let mut b = DMatrix::<f64>::zeros(views, 1);
        for p in pairs {
            let ([i, j], said, e) = (p.views, f64::from(value(p)), f64::from(p.error));
            let off = (said - (gains[i] - gains[j])).abs() / e;
            let w = 1.0 / (e * e * off.max(SMOOTH));
            a[(i, i)] += w;
            a[(j, j)] += w;
            a[(i, j)] -= w;
            a[(j, i)] -= w;
            b[(i, 0)] += w * said;
            b[(j, 0)] -= w * said;
        }
        let Some(factors) = a.cholesky() else { break };
        let next = factors.solve(&b);
        let covariance = factors.inverse();
        error = relative_errors(&covariance);
        let step = (0..views).map(|i| (next[(i, 0)] - gains[i]).abs());
        let step = step.fold(0.0, f64::max);
        gains = next.column(0).iter().copied().collect();
        if step < 1e-4 {
            break;
        }
    }
    let mean = gains.iter().sum::<f64>() / views.max(1) as f64;
    Fit {
        value: gains.iter().map(|g| g - mean).collect(),
        error,
    }
}

/// Standard errors of the gains against their mean, from their covariance.
fn relative_errors(covariance: &DMatrix<f64>) -> Vec<f32> {
    let n = covariance.nrows();
    let all = covariance.mean();
    (0..n)
        .map(|i| {
            let own = covariance.row(i).mean();
            (covariance[(i, i)] - 2.0 * own + all).max(0.0).sqrt() as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    /// Twelve views in a chain of six rooms, two in each; neighbours share a few points through
    /// their door. At `wrong` of the points one of the views shows something else, at doors often
    /// the same brown leaf.
    fn chain(gain: impl Fn(usize) -> Vec3, wrong: f32) -> Vec<Vec<Look>> {
        let mut rng = KeyedRng::new(5, 0);
        let mut points = Vec::new();
        for k in 0..6000 {
            let room = rng.below(6);
            let paint = Vec3::new(-0.4, -0.5, -0.7) + rng.next_f32();
            let door = k % 10 == 0 && room < 5;
            let views = [2 * room, if door { 2 * room + 2 } else { 2 * room + 1 }];
            let mut looks: Vec<Look> = Vec::new();
            for v in views {
                let noise = 0.1 * (rng.next_f32() + rng.next_f32() - 1.0);
                looks.push((v as u32, paint + gain(v) + noise, 0.8));
            }
            if rng.next_f32() < wrong {
                let leaf = Vec3::new(-1.2, -1.9, -2.8);
                let other = Vec3::splat(-3.0) + 3.0 * rng.next_f32();
                let shown = if door && rng.next_f32() < 0.5 {
                    leaf
                } else {
                    other
                };
                looks[1].1 = shown + gain(views[1]);
            }
            points.push(looks);
        }
        points
    }

    #[test]
    fn a_chain_of_rooms_is_exposed_alike_although_half_of_the_points_lie() {
        let truth = |v: usize| {
            let exposure = 0.5 * (1.3 * v as f32).sin() + 0.1 * (v as f32 - 5.5);
            let warm = 0.06 * (0.9 * v as f32).cos();
            Vec3::new(exposure + warm, exposure, exposure - warm)
        };
        let mean = (0..12).map(truth).sum::<Vec3>() / 12.0;
        let points = chain(truth, 0.5);
        let points: Vec<&[Look]> = points.iter().map(Vec::as_slice).collect();
        let (gains, errors) = pairwise_gains(&points, 12);
        for (v, (gain, error)) in gains.iter().zip(&errors).enumerate() {
            let off = *gain - (truth(v) - mean);
            let grey = off.element_sum() / 3.0;
            assert!(
                grey.abs() < 0.08 && (off - grey).abs().max_element() < 0.06,
                "view {v}: off by {off}"
            );
            assert!(grey.abs() < 3.0 * error && *error < 0.5, "{errors:?}");
        }
    }

    #[test]
    fn a_view_apart_keeps_its_exposure_and_says_so() {
        let points = chain(|_| Vec3::ZERO, 0.2);
        let points: Vec<&[Look]> = points.iter().map(Vec::as_slice).collect();
        let (gains, errors) = pairwise_gains(&points, 13);
        assert!(gains[12].abs().max_element() < 0.05, "{}", gains[12]);
        assert!(
            errors[12] > 1.0 && errors[..12].iter().all(|e| *e < 0.5),
            "{errors:?}"
        );
        let (none, errors) = pairwise_gains(&[], 2);
        assert!(none == [Vec3::ZERO; 2] && errors.iter().all(|e| *e > 0.5));
    }
}
