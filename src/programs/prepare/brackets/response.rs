//! The response of a camera from its brackets (Debevec & Malik, SIGGRAPH 1997): g(z), the logarithm
//! of the exposure that gives code z, minimises
//! Σᵢⱼ w(zᵢⱼ) (g(zᵢⱼ) − ln Eᵢ − ln tⱼ)² + λ ∫ (d²g / d(ln z)²)² d(ln z)
//! per channel; ln Eᵢ is eliminated, so that the system has 256 unknowns whatever the number of
//! points. Points that contradict the first fit (something moved) leave before the second. Then g is
//! made monotone (pool adjacent violators).

use crate::core::stats::MAD_SCALE;
use nalgebra::{DMatrix, DVector};

/// Codes of an 8-bit photograph.
pub const CODES: usize = 256;
/// The code whose exposure is 1: Debevec & Malik's choice of gauge.
const MIDDLE: usize = 128;
/// λ as a multiple of the data's whole weight. Brackets in equal steps leave every function of the
/// step's period undetermined; this decides for the smooth one (derived: it takes a ripple of half a
/// stop's period below 1 % and bends a curve whose slope halves over the range by less).
const SMOOTHNESS: f64 = 1e-4;
/// Residuals beyond this many robust deviations are something that moved.
const OUTLIER: f64 = 4.0;

/// One place as the photographs of a bracket saw it, one channel.
pub type Sighting = Vec<Seen>;

/// A code under an exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// ln of the exposure.
    pub ln_exposure: f64,
    /// The code.
    pub code: u8,
}

/// ln of the relative exposure that gives each code, ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// g(z); g(128) = 0.
    pub ln: Vec<f64>,
}

/// Debevec & Malik's hat: trust the middle of the curve.
fn hat(code: usize) -> f64 {
    code.min(CODES - 1 - code) as f64 / MIDDLE as f64
}

impl Response {
    /// Fits a channel; `None` where the points do not determine a curve (no place seen twice).
    #[must_use]
    pub fn fit(points: &[Sighting]) -> Option<Self> {
        let first = solve(points)?;
        let spread = first.spread(points);
        let kept: Vec<Sighting> = points
            .iter()
            .filter(|s| first.consistent(s, spread))
            .cloned()
            .collect();
        solve(&kept).or(Some(first))
    }

    /// The sRGB curve, for brackets that do not determine one.
    #[must_use]
    pub fn srgb() -> Self {
        let ln = |z: usize| {
            let x = (z as f64).max(0.5) / 255.0;
            let linear = if x <= 0.040_45 {
                x / 12.92
            } else {
                ((x + 0.055) / 1.055).powf(2.4)
            };
            linear.ln()
        };
        let middle = ln(MIDDLE);
        Self {
            ln: (0..CODES).map(|z| ln(z) - middle).collect(),
        }
    }

    /// Relative exposure of a code.
    #[must_use]
    pub fn linear(&self, code: u8) -> f64 {
        self.ln[usize::from(code)].exp()
    }

    /// Whether a sighting's deviations are noise: of the fit, and of one code's width.
    fn consistent(&self, s: &Sighting, spread: f64) -> bool {
        self.residuals(s).zip(s).all(|(r, o)| {
            let z = usize::from(o.code);
            let width = self.ln[(z + 1).min(CODES - 1)] - self.ln[z.saturating_sub(1)];
            r.abs() <= OUTLIER * spread + width
        })
    }

    /// Deviations of a sighting from its own weighted mean, in ln exposure.
    fn residuals<'a>(&'a self, s: &'a Sighting) -> impl Iterator<Item = f64> + 'a {
        let (mut sum, mut weight) = (0.0, 0.0);
        for o in s {
            let w = hat(usize::from(o.code));
            sum += w * (self.ln[usize::from(o.code)] - o.ln_exposure);
            weight += w;
        }
        let mean = sum / weight.max(1e-9);
        s.iter()
            .map(move |o| self.ln[usize::from(o.code)] - o.ln_exposure - mean)
    }

    /// Robust standard deviation of the residuals.
    #[must_use]
    pub fn spread(&self, points: &[Sighting]) -> f64 {
        let mut all: Vec<f64> = points
            .iter()
            .flat_map(|s| self.residuals(s).map(f64::abs).collect::<Vec<_>>())
            .collect();
        if all.is_empty() {
            return 0.0;
        }
        all.sort_by(f64::total_cmp);
        f64::from(MAD_SCALE) * all[all.len() / 2]
    }
}

fn solve(points: &[Sighting]) -> Option<Response> {
    let mut a = DMatrix::<f64>::zeros(CODES, CODES);
    let mut b = DVector::<f64>::zeros(CODES);
    let mut total = 0.0;
    for s in points.iter().filter(|s| s.len() > 1) {
        let weight: f64 = s.iter().map(|o| hat(usize::from(o.code))).sum();
        if weight <= 0.0 {
            continue;
        }
        let mean: f64 = s
            .iter()
            .map(|o| hat(usize::from(o.code)) * o.ln_exposure)
            .sum::<f64>()
            / weight;
        for o in s {
            let (i, w) = (usize::from(o.code), hat(usize::from(o.code)));
            a[(i, i)] += w;
            b[i] += w * (o.ln_exposure - mean);
            for p in s {
                let j = usize::from(p.code);
                a[(i, j)] -= w * hat(j) / weight;
            }
        }
        total += weight;
    }
    if total <= 0.0 {
        return None;
    }
    let place = |z: usize| (z as f64 + 0.5).ln();
    for z in 1..CODES - 1 {
        // ∫ (d²g / d(ln z)²)² d(ln z): gamma curves are straight lines on that axis
        let (before, after) = (place(z) - place(z - 1), place(z + 1) - place(z));
        let row = [
            (z - 1, 1.0 / before),
            (z, -1.0 / before - 1.0 / after),
            (z + 1, 1.0 / after),
        ];
        let w = 2.0 * SMOOTHNESS * total / (before + after);
        for (i, ci) in row {
            for (j, cj) in row {
                a[(i, j)] += w * ci * cj;
            }
        }
    }
    a[(MIDDLE, MIDDLE)] += total;
    let g = a.cholesky()?.solve(&b);
    let ascending = ascending(g.as_slice());
    let middle = ascending[MIDDLE];
    Some(Response {
        ln: ascending.iter().map(|v| v - middle).collect(),
    })
}

/// The nearest ascending sequence (pool adjacent violators).
fn ascending(values: &[f64]) -> Vec<f64> {
    let mut blocks: Vec<(f64, usize)> = Vec::new();
    for &v in values {
        blocks.push((v, 1));
        while let [.., (a, n), (b, m)] = blocks[..] {
            if a <= b {
                break;
            }
            blocks.truncate(blocks.len() - 2);
            blocks.push(((a * n as f64 + b * m as f64) / (n + m) as f64, n + m));
        }
    }
    blocks
        .into_iter()
        .flat_map(|(v, n)| std::iter::repeat_n(v, n))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Codes of a camera with the given curve, for radiances over four decades.
    fn sightings(encode: fn(f64) -> f64) -> Vec<Sighting> {
        let exposures = [0.01, 0.04, 0.16, 0.64, 2.56, 10.24];
        (0..1500)
            .map(|i| {
                let e = 10f64.powf(-2.5 + 4.0 * f64::from(i) / 1500.0);
                exposures
                    .iter()
                    .map(|t| Seen {
                        ln_exposure: f64::ln(*t),
                        code: (encode((e * t).min(1.0)) * 255.0).round() as u8,
                    })
                    .filter(|s| (5..=250).contains(&s.code))
                    .collect()
            })
            .filter(|s: &Sighting| s.len() > 1)
            .collect()
    }

    #[test]
    fn known_curves_are_found_again() {
        type Curve = fn(f64) -> f64;
        let curves: [(&str, Curve); 3] = [
            ("gamma 2.2", |x| x.powf(1.0 / 2.2)),
            ("linear", |x| x),
            ("s-shaped", |x| {
                let y = x.powf(1.0 / 2.2);
                y * y * (3.0 - 2.0 * y)
            }),
        ];
        for (name, encode) in curves {
            let r = Response::fit(&sightings(encode)).expect("determined");
            // invert the curve by bisection: the truth for each code
            let truth = |z: usize| {
                let (mut lo, mut hi) = (0.0, 1.0);
                for _ in 0..60 {
                    let mid = 0.5 * (lo + hi);
                    if encode(mid) * 255.0 < z as f64 {
                        lo = mid;
                    } else {
                        hi = mid;
                    }
                }
                f64::ln(0.5 * (lo + hi))
            };
            for z in [20, 60, 100, 160, 200, 235] {
                let error = r.ln[z] - (truth(z) - truth(MIDDLE));
                assert!(error.abs() < 0.05, "{name}, code {z}: {error}");
            }
            assert!(r.ln.windows(2).all(|w| w[0] <= w[1]), "{name}: monotone");
        }
    }

    #[test]
    fn what_moved_does_not_bend_the_curve() {
        let mut points = sightings(|x| x.powf(1.0 / 2.2));
        for s in points.iter_mut().step_by(9) {
            s[0].code = s[0].code.saturating_add(60).min(250);
        }
        let r = Response::fit(&points).expect("determined");
        for z in [40usize, 200] {
            let truth = 2.2 * (z as f64 / MIDDLE as f64).ln();
            assert!(
                (r.ln[z] - truth).abs() < 0.08,
                "{z}: {} against {truth}",
                r.ln[z]
            );
        }
    }

    #[test]
    fn nothing_seen_twice_determines_nothing() {
        assert!(Response::fit(&[]).is_none());
        let once = vec![Seen {
            ln_exposure: 0.0,
            code: 99,
        }];
        assert!(Response::fit(&[once]).is_none());
    }
}
