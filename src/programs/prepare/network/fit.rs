//! Scale and shift of depth that networks guess, solved from where tiles see the same surface.
//!
//! A tile's depth is d = y or d = 1/y with y = scale·value + shift, along the ray or the axis. A place that
//! tile i puts at X = c_i + d_i ω, tile j sees at the distance |X − c_j|, which should be d_j there:
//!
//! > r = ln |X − c_j| − ln d_j(π_j(X)).
//!
//! Positions of cameras are known, so the distance between them gives the scale: no other one brings views of
//! one room to agreement. Where the capture has sparse points, r = ln d_i(π_i(P)) − ln |P − c_i| holds them too. Σ ρ(r/σ) is least by
//! Levenberg's and Marquardt's steps on (ln scale, shift), with the redescending ρ of Geman and McClure (1987), which lets
//! go of what one view sees and another does not, and σ falling from coarse to the residuals' own spread (graduated
//! non-convexity: Blake and Zisserman 1987). The beginning is the best of a list of common scales and shifts.
//! The standard error is that of the normal equations. Called by `depth`; tests by closed forms of a box.

use super::options::{DepthFit, DepthValues};
use super::tiles::Tile;
use crate::core::image::{Plane, Wrap, bilinear_taps};
use crate::core::parallel::prelude::*;
use crate::core::stats::{MAD_SCALE, median};
use glam::{Vec2, Vec3};
use nalgebra::{DMatrix, DVector};

/// Places of a tile that are compared with others. Derived: two unknowns from so many residuals that half of them may
/// be hidden and their mean still be a tenth of one's spread.
const SAMPLES: usize = 400;
/// The beginning asks one in so many of these places. Derived: it tells steps of √2 apart, where
/// fifty residuals a tile do.
const COARSE: usize = 8;
/// Other cameras that a tile is compared with, the nearest. Derived: those of a room; farther ones see other rooms.
const NEIGHBOURS: usize = 8;
/// Spread of residuals that is believed in, coarse to fine: logarithms, thus shares of the depth. Derived: 0.5 is a
/// wrong wall, and 0.02 finer than networks see (a few percent on rooms: Jiang et al. 2021).
const SPREADS: [f64; 5] = [0.5, 0.25, 0.1, 0.05, 0.02];
/// Steps at each spread. Derived: a step of a well-posed square fit is nearly exact; three more for visibility.
const STEPS: usize = 5;
/// Spread of ln scale about the common one and of the shift, in medians of the tile's values, before anything is seen.
/// Derived: a factor of two, and the values themselves: both give way to a single good residual.
const PRIOR: [f64; 2] = [0.7, 1.0];
/// From this standard error of its scale on, a tile counts as unfounded. Derived: a quarter of the depth is a wrong room.
const UNFOUNDED: f64 = 0.25;
/// Share of the depth by which a residual's derivative is probed. Derived: far above rounding of f32, below a pixel.
const PROBE: f32 = 1e-3;

/// A known point of a photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Anchor {
    /// Place in the tile.
    pub pixel: Vec2,
    /// Distance along the ray, metres.
    pub distance: f32,
}

/// What a network gave for a tile.
pub(super) struct Guess {
    pub tile: Tile,
    /// At any size of the tile's aspect; not finite = none.
    pub values: Plane<f32>,
    pub kind: DepthValues,
    pub anchors: Vec<Anchor>,
}

/// y = scale·value + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub scale: f64,
    pub shift: f64,
}

/// Lines of all tiles.
#[derive(Debug)]
pub(super) struct Fit {
    /// In the order of the guesses.
    pub lines: Vec<Line>,
    /// Robust standard deviation of the residuals that agree: share of the depth.
    pub spread: f64,
    /// Median standard error of ln scale.
    pub error: f64,
    /// Tiles that nothing founds.
    pub unfounded: usize,
}

impl Guess {
    /// Distance along the ray at a place of the tile, metres; `None` where it is none or not positive.
    pub fn distance(&self, pixel: Vec2, line: Line) -> Option<f32> {
        let direction = self.tile.direction(pixel)?;
        let y = line.scale * self.value(pixel)? + line.shift;
        let d = if self.kind.is_inverse() { 1.0 / y } else { y } as f32;
        let length = match self.kind.is_along_axis() {
            true => self.tile.along_axis(direction),
            false => 1.0,
        };
        (d > 0.0 && d.is_finite()).then_some(d * length)
    }

    fn value(&self, pixel: Vec2) -> Option<f64> {
        let (w, h) = (self.values.width, self.values.height);
        let scale = Vec2::new(
            w as f32 / self.tile.size[0] as f32,
            h as f32 / self.tile.size[1] as f32,
        );
        let taps = bilinear_taps(w, h, pixel * scale, Wrap::Clamp);
        let sum: f32 = taps.iter().map(|(i, t)| self.values.data[*i] * t).sum();
        sum.is_finite().then_some(f64::from(sum))
    }

    /// The middle of what the network gave.
    fn middle(&self) -> Option<f64> {
        let finite = self.values.data.iter().copied().filter(|v| v.is_finite());
        let middle = median(finite.map(f32::abs).collect())?;
        (middle > 0.0).then_some(f64::from(middle))
    }

    /// Places spread evenly over the tile.
    fn samples(&self) -> Vec<Vec2> {
        let [w, h] = self.tile.size.map(|s| s as f32);
        let columns = (SAMPLES as f32 * w / h).sqrt().ceil().max(1.0) as usize;
        let rows = SAMPLES.div_ceil(columns);
        let place = |i: usize| {
            let (x, y) = ((i % columns) as f32 + 0.5, (i / columns) as f32 + 0.5);
            Vec2::new(x * w / columns as f32, y * h / rows as f32)
        };
        (0..columns * rows).map(place).collect()
    }
}

/// Unknowns of a tile: y = e^log (value/middle + shift).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Unknown {
    log: f64,
    shift: f64,
}

/// A residual with its derivatives by the unknowns of its tiles.
struct Residual {
    value: f64,
    /// Distance in units of that between the cameras; 1 for what has no parallax.
    parallax: f64,
    by: [(usize, [f64; 2]); 2],
}

/// The tiles with what is asked of them.
struct Problem<'a> {
    guesses: &'a [Guess],
    middles: Vec<f64>,
    samples: Vec<Vec<Vec2>>,
    neighbours: Vec<Vec<usize>>,
    freedom: DepthFit,
}

/// The lines by which the tiles' depths agree; `None` where nothing tells a scale: no two positions whose views
/// overlap, and no points.
pub(super) fn fit(guesses: &[Guess], freedom: DepthFit) -> Option<Fit> {
    let problem = Problem::new(guesses, freedom)?;
    let (mut unknowns, common) = problem.beginning()?;
    let mut spread = SPREADS[0];
    for least in SPREADS {
        for _ in 0..STEPS {
            let residuals = problem.residuals(&unknowns, 1);
            spread = least.max(robust_spread(&residuals, 3.0 * least)?);
            unknowns = problem.step(&unknowns, &residuals, spread, common).unknowns;
        }
    }
    let residuals = problem.residuals(&unknowns, 1);
    let last = problem.step(&unknowns, &residuals, spread, common);
    let lines = (unknowns.iter().zip(&problem.middles)).map(|(u, middle)| Line {
        scale: u.log.exp() / middle,
        shift: u.log.exp() * u.shift,
    });
    let errors: Vec<f32> = last.errors.iter().map(|e| *e as f32).collect();
    Some(Fit {
        lines: lines.collect(),
        spread: robust_spread(&residuals, 3.0 * spread)?,
        error: f64::from(median(errors.clone())?),
        unfounded: errors.iter().filter(|e| f64::from(**e) > UNFOUNDED).count(),
    })
}

/// Standard deviation of the residuals within `most`, by their median size.
fn robust_spread(residuals: &[Residual], most: f64) -> Option<f64> {
    let sizes = residuals.iter().map(|r| r.value.abs());
    let agreeing = sizes.filter(|r| *r < most).map(|r| r as f32).collect();
    median(agreeing).map(|m| f64::from(MAD_SCALE * m))
}

/// A step and what it knows of its errors.
struct Step {
    unknowns: Vec<Unknown>,
    /// Standard error of ln scale, tile by tile.
    errors: Vec<f64>,
}

impl<'a> Problem<'a> {
    fn new(guesses: &'a [Guess], freedom: DepthFit) -> Option<Self> {
        let middles = guesses.iter().map(Guess::middle).collect::<Option<_>>()?;
        let near = |i: usize| {
            let here = guesses[i].tile.photo.position;
            let mut others: Vec<Vec3> = guesses.iter().map(|g| g.tile.photo.position).collect();
            others.sort_by(|a, b| a.distance(here).total_cmp(&b.distance(here)));
            others.dedup();
            others.truncate(NEIGHBOURS + 1);
            let of = |j: &usize| *j != i && others.contains(&guesses[*j].tile.photo.position);
            (0..guesses.len()).filter(of).collect()
        };
        Some(Self {
            guesses,
            middles,
            samples: guesses.iter().map(Guess::samples).collect(),
            neighbours: (0..guesses.len()).map(near).collect(),
            freedom,
        })
    }

    fn distance(&self, i: usize, pixel: Vec2, u: Unknown) -> Option<f32> {
        let line = Line {
            scale: u.log.exp() / self.middles[i],
            shift: u.log.exp() * u.shift,
        };
        self.guesses[i].distance(pixel, line)
    }

    /// Derivatives of ln d by the unknowns: ±1, ±1/(value/middle + shift).
    fn slopes(&self, i: usize, pixel: Vec2, u: Unknown) -> Option<[f64; 2]> {
        let sign = if self.guesses[i].kind.is_inverse() {
            -1.0
        } else {
            1.0
        };
        let y = self.guesses[i].value(pixel)? / self.middles[i] + u.shift;
        let by_shift = match self.freedom {
            DepthFit::Affine => sign / y,
            DepthFit::Scale | DepthFit::None => 0.0,
        };
        Some([sign, by_shift])
    }

    /// How tile j disagrees with a place, as the logarithm of a ratio of distances; where it sees it.
    fn disagreement(&self, place: Vec3, j: usize, u: Unknown) -> Option<(f64, Vec2)> {
        let tile = &self.guesses[j].tile;
        let pixel = tile.project(place)?;
        let along = (place - tile.photo.position).length();
        let seen = self.distance(j, pixel, u)?;
        (along > 0.0).then(|| (f64::from((along / seen).ln()), pixel))
    }

    /// Of all tiles, of one place in `every`.
    fn residuals(&self, unknowns: &[Unknown], every: usize) -> Vec<Residual> {
        let of = |i: usize| self.residuals_of(i, unknowns, every);
        let all: Vec<Vec<Residual>> = (0..unknowns.len()).into_par_iter().map(of).collect();
        all.into_iter().flatten().collect()
    }

    fn residuals_of(&self, i: usize, unknowns: &[Unknown], every: usize) -> Vec<Residual> {
        let mut out = Vec::new();
        let tile = &self.guesses[i].tile;
        for pixel in self.samples[i].iter().step_by(every) {
            let Some(d) = self.distance(i, *pixel, unknowns[i]) else {
                continue;
            };
            let (Some(direction), Some(mine)) =
                (tile.direction(*pixel), self.slopes(i, *pixel, unknowns[i]))
            else {
                continue;
            };
            let place = |d: f32| tile.photo.position + direction * d;
            for j in &self.neighbours[i] {
                let seen = self.disagreement(place(d), *j, unknowns[*j]);
                let probed = self.disagreement(place(d * (1.0 + PROBE)), *j, unknowns[*j]);
                let (Some((value, at)), Some((moved, _))) = (seen, probed) else {
                    continue;
                };
                let Some(theirs) = self.slopes(*j, at, unknowns[*j]) else {
                    continue;
                };
                let slope = (moved - value) / f64::from(PROBE.ln_1p());
                let apart = tile
                    .photo
                    .position
                    .distance(self.guesses[*j].tile.photo.position);
                out.push(Residual {
                    value,
                    parallax: if apart > 0.0 {
                        f64::from(d / apart)
                    } else {
                        1.0
                    },
                    by: [(i, mine.map(|s| s * slope)), (*j, theirs.map(|s| -s))],
                });
            }
        }
        for anchor in &self.guesses[i].anchors {
            let d = self.distance(i, anchor.pixel, unknowns[i]);
            let slopes = self.slopes(i, anchor.pixel, unknowns[i]);
            if let (Some(d), Some(mine)) = (d, slopes) {
                out.push(Residual {
                    value: f64::from((d / anchor.distance).ln()),
                    parallax: 1.0,
                    by: [(i, mine), (i, [0.0; 2])],
                });
            }
        }
        out
    }

    /// The best of common scales and shifts, and ln of that scale.
    fn beginning(&self) -> Option<(Vec<Unknown>, f64)> {
        let inverse = self.guesses.first()?.kind.is_inverse();
        let mut found: Option<(f64, Vec<Unknown>, f64)> = None;
        for depth in self.scales()? {
            let log = if inverse { -depth.ln() } else { depth.ln() };
            for shift in self.shifts() {
                for own in [true, false] {
                    let all = self.common(log, *shift, own);
                    let cost = self.cost(&all)?;
                    if found.as_ref().is_none_or(|f| cost < f.0) {
                        found = Some((cost, all, log));
                    }
                }
            }
        }
        found.map(|(_, all, log)| (all, log))
    }

    /// One scale for all: with values as they are, or of tiles whose medians are equal.
    fn common(&self, log: f64, shift: f64, own: bool) -> Vec<Unknown> {
        let middles: Vec<f32> = self.middles.iter().map(|m| *m as f32).collect();
        let whole = median(middles).map_or(1.0, f64::from);
        let of = |m: &f64| Unknown {
            log: if own { log } else { log + (m / whole).ln() },
            shift,
        };
        self.middles.iter().map(of).collect()
    }

    /// Median depths to begin with: of the points, else multiples of the distance between neighbours.
    fn scales(&self) -> Option<Vec<f64>> {
        let anchors = self.guesses.iter().flat_map(|g| &g.anchors);
        let mut base = median(anchors.map(|a| a.distance).collect());
        if base.is_none() {
            let place = |i: usize| self.guesses[i].tile.photo.position;
            let nearest = |i: usize| {
                let to = self.neighbours[i]
                    .iter()
                    .map(|j| place(*j).distance(place(i)));
                to.filter(|d| *d > 0.0).min_by(f32::total_cmp)
            };
            base = median((0..self.guesses.len()).filter_map(nearest).collect());
        }
        // from a quarter to 32 times as far, by factors of √2 (derived: rooms and steps between photographs)
        let base = f64::from(base?);
        Some(
            (-4..=10)
                .map(|k| base * 2f64.powf(0.5 * f64::from(k)))
                .collect(),
        )
    }

    fn shifts(&self) -> &'static [f64] {
        match self.freedom {
            DepthFit::Affine => &[0.0, 1.0, 0.3, -0.3],
            DepthFit::Scale | DepthFit::None => &[0.0],
        }
    }

    /// Mean of ρ over what is compared; everything that could be and is not counts in full.
    fn cost(&self, unknowns: &[Unknown]) -> Option<f64> {
        let residuals = self.residuals(unknowns, COARSE);
        let rho = |r: &Residual| {
            // far away all distances are alike to a small share: by the cameras' distance they are not
            let x = (r.value * r.parallax / SPREADS[1]).powi(2);
            x / (1.0 + x)
        };
        let sum: f64 = residuals.iter().map(rho).sum();
        let most = self.samples.iter().map(Vec::len).sum::<usize>() / COARSE;
        let missing = most.saturating_sub(residuals.len());
        Some((sum + missing as f64) / (residuals.len() + missing).max(1) as f64)
    }

    /// A step of reweighted least squares.
    fn step(&self, unknowns: &[Unknown], all: &[Residual], spread: f64, common: f64) -> Step {
        let n = unknowns.len();
        let mut normal = DMatrix::<f64>::zeros(2 * n, 2 * n);
        let mut right = DVector::<f64>::zeros(2 * n);
        for r in all {
            let x = r.value / spread;
            let weight = (1.0 + x * x).powi(-2) / (spread * spread);
            for (i, a) in &r.by {
                for k in 0..2 {
                    right[2 * i + k] -= weight * a[k] * r.value;
                    for (j, b) in &r.by {
                        for l in 0..2 {
                            normal[(2 * i + k, 2 * j + l)] += weight * a[k] * b[l];
                        }
                    }
                }
            }
        }
        for (i, u) in unknowns.iter().enumerate() {
            let prior = PRIOR.map(|p| 1.0 / (p * p));
            normal[(2 * i, 2 * i)] += prior[0];
            normal[(2 * i + 1, 2 * i + 1)] += prior[1];
            right[2 * i] -= prior[0] * (u.log - common);
            right[2 * i + 1] -= prior[1] * u.shift;
        }
        // (positive definite by the prior)
        let Some(factor) = normal.cholesky() else {
            return Step {
                unknowns: unknowns.to_vec(),
                errors: vec![f64::INFINITY; n],
            };
        };
        let by = factor.solve(&right);
        let inverse = factor.inverse();
        // no farther at once than the prior thinks likely
        let bounded = |d: f64, k: usize| d.clamp(-PRIOR[k], PRIOR[k]);
        let moved = |(i, u): (usize, &Unknown)| Unknown {
            log: u.log + bounded(by[2 * i], 0),
            shift: u.shift + bounded(by[2 * i + 1], 1),
        };
        Step {
            unknowns: unknowns.iter().enumerate().map(moved).collect(),
            errors: (0..n).map(|i| inverse[(2 * i, 2 * i)].sqrt()).collect(),
        }
    }
}
