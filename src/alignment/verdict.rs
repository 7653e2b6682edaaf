//! The verdict: aligned, doubtful or misaligned, by paired differences of scores.
//!
//! The poses as given are compared with the same poses moved a little (six degrees of what the
//! cameras see, in eight directions and both senses): where the cameras are right, every move makes
//! the score worse; where they are not, about half of them make it better. Differences are paired
//! by view, so that their standard error is that of the views' differences and no threshold knows
//! how high a score a room can reach.

use super::correction::Correction;
use super::evidence::{EvidenceSize, ViewEvidence, gather};
use super::hypotheses::Hypothesis;
use super::refine::RefinedPose;
use super::score::{Ground, ViewScore};
use super::search::{COARSE, Candidate, Judge, ROUGH};
use crate::Result;
use crate::core::trace::Tracer;
use crate::scene::Scene;
use crate::verdict::AlignmentVerdict;
use serde::{Deserialize, Serialize};

/// Views that take part, evenly spread over the training views.
pub(super) const MOST_VIEWS: usize = 48;
/// Differences beyond this many standard errors are none of chance: some sixty hypotheses are
/// compared, and 60 · P(z > 3.5) is 1.4 %.
const SIGNIFICANT: f64 = 3.5;
/// By how many standard errors every one of the sixteen moves must be worse for the search to be
/// left out. Derived: the weakest of sixteen is beyond two by chance once in 2.3 %¹⁶; poses far from
/// the right ones lie on slopes, where some move is better (a house shifted by 2 m: −0.7; five
/// undamaged scenes: 3.2 to 9.3, `bench alignment`).
const EVERY_MOVE: f64 = 2.0;
/// Moves that the verdict compares with, see [`Judge::moved`].
const MOVES: usize = 8;
/// A score below this, with all of its error, is no score of poses that fit: a quarter of what is
/// perfect.
const NOTHING_FITS: f64 = 0.25;
/// A correction that reaches this score is offered even where few views leave its peak in doubt: half
/// of what is perfect. Measured: right corrections 0.59 to 0.72, the best of wrong ones 0.31 (tests of
/// this room, `bench alignment`, fc40 of the shared cases; 2026-11-25).
const FITS: f64 = 0.5;
/// Photographs whose contrast ([`ViewEvidence::contrast`]) exceeds this show edges that right poses
/// cannot all miss: bare walls and noise do not reach it. Derived: a tenth of all pairs of
/// neighbours differ by a fifth, ten times the step of an 8-bit image's mid grey.
const SHOWS_EDGES: f64 = 0.2;
/// Hypotheses that are listed.
const LISTED: usize = 12;
/// Changes that move what the cameras see by up to this are small: doubtful, a case for refinement,
/// not refused. Radians. Derived: a pixel of the evidence's panoramas ([`EvidenceSize::COARSE`]);
/// less is not its business.
const SMALL: f64 = std::f64::consts::TAU / 192.0;

/// A hypothesis and its score.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Scored {
    /// What would be wrong with the poses.
    pub name: String,
    /// Score if that were mended: 0 by chance, 1 when perfect.
    pub score: f64,
}

/// The parts of the score, 0 by chance, 1 when perfect; `None` without such evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Parts {
    /// Photo-consistency of luminance and chromaticity.
    pub photo: Option<f64>,
    /// Photo-consistency of detail.
    pub detail: Option<f64>,
    /// Contrast at edges of the mesh.
    pub edges: Option<f64>,
    /// Labels over views.
    pub labels: Option<f64>,
    /// Edges of labels at edges of the mesh.
    pub label_edges: Option<f64>,
}

/// What was found about alignment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Alignment {
    /// The verdict.
    pub verdict: AlignmentVerdict,
    /// Score of the poses as given: 0 by chance, 1 when perfect.
    pub score: f64,
    /// Standard error of the score over the views.
    pub standard_error: f64,
    /// Its parts.
    pub parts: Parts,
    /// By how many standard errors the poses beat the same poses moved a little.
    pub peak: f64,
    /// The same for the move that did best: negative if it is better than the poses as given.
    pub weakest: f64,
    /// Share of the views' samples that meet the mesh.
    pub met: f64,
    /// Share of the views whose photographs could be compared with another's.
    pub compared: f64,
    /// Difference of log radiance that a tenth of neighbouring points exceed, mean over the views.
    pub contrast: f64,
    /// Median distance from the cameras to what they see, metres.
    pub distance: f64,
    /// Scores of hypotheses, best first.
    pub hypotheses: Vec<Scored>,
    /// The hypothesis that fits, if the poses as given do not.
    pub winner: Option<String>,
    /// By how many standard errors it beats the poses as given.
    pub winner_significance: f64,
    /// What it does to the poses relative to the mesh.
    pub correction: Option<Correction>,
    /// Median distance from the corrected cameras to what they see, in the mesh's units.
    pub corrected_distance: f64,
    /// The correction has been applied (`--fix-alignment`).
    pub fixed: bool,
    /// Views that took part.
    pub views: usize,
    /// Poses that were refined one by one (`--refine-poses`).
    pub refined: Vec<RefinedPose>,
}

/// Tests the alignment of a scene's training views with its mesh.
///
/// # Errors
/// Images, labels or masks that cannot be read.
pub fn assess(scene: &Scene, tracer: &dyn Tracer) -> Result<Alignment> {
    let views = gather(scene, MOST_VIEWS, EvidenceSize::COARSE)?;
    Ok(assess_views(scene, tracer, &views))
}

/// [`assess`] with evidence that is at hand.
#[must_use]
pub fn assess_views(scene: &Scene, tracer: &dyn Tracer, views: &[ViewEvidence]) -> Alignment {
    let labelled = views.iter().any(|v| v.labels.is_some());
    let several = views.len() > 1;
    let judge = Judge {
        ground: Ground {
            mesh: &scene.mesh,
            tracer,
        },
        views,
        origin: scene.origin,
        z_up: scene.z_up,
        counted: [several, several, true, labelled && several, labelled],
    };
    if views.is_empty() {
        return Alignment::default();
    }
    let Given {
        mut out,
        scores: given,
    } = as_given(&judge);
    let settled = out.peak > SIGNIFICANT && out.weakest > EVERY_MOVE;
    let mut candidates = judge.usual(scene, if settled { ROUGH } else { COARSE });
    // a ninth of the samples has three times the error
    let margin = 3.0 * SIGNIFICANT * out.standard_error;
    let rival = candidates
        .iter()
        .any(|c| c.hypothesis.steps > 0 && c.score > out.score - margin);
    let winner = if settled && !rival {
        None
    } else {
        if settled {
            candidates = judge.usual(scene, COARSE);
        } else {
            candidates.extend(judge.unusual());
        }
        find_winner(&judge, &candidates, &given)
    };
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    decide(&mut out, &judge, winner);
    list(&mut out, &candidates);
    out
}

/// A hypothesis that beats the poses as given.
struct Winner {
    hypothesis: Hypothesis,
    score: f64,
    significance: f64,
    scores: Vec<f64>,
}

/// The poses as given: what is known of them, and their score by view.
struct Given {
    out: Alignment,
    scores: Vec<f64>,
}

fn as_given(judge: &Judge<'_>) -> Given {
    let given = Correction::default();
    let full = judge.view_scores(&given, 1);
    let scores: Vec<f64> = full.iter().map(|s| s.mean(judge.counted)).collect();
    let distance = judge.distance();
    let moves = Moves::of(judge, &given, &scores, distance);
    let zero = vec![0.0; scores.len()];
    let score = Paired::of(&scores, &zero, judge);
    let part = |k: usize| -> Option<f64> {
        let known: Vec<f64> = full
            .iter()
            .filter_map(|s| s.parts[k].map(f64::from))
            .collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
    };
    let out = Alignment {
        score: score.mean,
        standard_error: score.error,
        parts: Parts {
            photo: part(0),
            detail: part(1),
            edges: part(2),
            labels: part(3),
            label_edges: part(4),
        },
        peak: moves.peak,
        weakest: moves.weakest,
        met: mean_of(&full, |s| s.met),
        compared: mean_of(&full, |s| if s.parts[0].is_some() { 1.0 } else { 0.0 }),
        contrast: judge
            .views
            .iter()
            .map(|v| f64::from(v.contrast))
            .sum::<f64>()
            / full.len().max(1) as f64,
        distance: judge.distance_under(&given),
        views: full.len(),
        ..Alignment::default()
    };
    Given { out, scores }
}

/// How a correction compares with the same moved a little, in standard errors.
struct Moves {
    /// Over the mean of all moves.
    peak: f64,
    /// Over the move that does best.
    weakest: f64,
}

impl Moves {
    /// `scores` are those of the correction, `distance` that to what its cameras see.
    fn of(judge: &Judge<'_>, c: &Correction, scores: &[f64], distance: f64) -> Self {
        let mut worse = vec![0.0; scores.len()];
        let mut weakest = f64::INFINITY;
        for k in 0..MOVES {
            for sign in [1.0, -1.0] {
                let moved = judge.scores(&judge.moved(c, k, sign, distance), 1);
                let gain = Paired::of(scores, &moved, judge);
                weakest = weakest.min(gain.significance());
                for (w, (a, b)) in worse.iter_mut().zip(scores.iter().zip(&moved)) {
                    *w += (a - b) / (2 * MOVES) as f64;
                }
            }
        }
        let zero = vec![0.0; scores.len()];
        Self {
            peak: Paired::of(&worse, &zero, judge).significance(),
            weakest,
        }
    }

    /// Poses that fit are better than all that lie around them.
    fn is_peak(&self) -> bool {
        self.peak > SIGNIFICANT && self.weakest > -1.0
    }
}

fn mean_of(all: &[ViewScore], of: fn(&ViewScore) -> f32) -> f64 {
    all.iter().map(|s| f64::from(of(s))).sum::<f64>() / all.len().max(1) as f64
}

/// Mean and standard error of paired differences.
struct Paired {
    mean: f64,
    error: f64,
}

impl Paired {
    /// `a − b` by view. The error is that of the views' differences and, beside it, of the samples
    /// within a view, so that two or three views do not agree by accident.
    fn of(a: &[f64], b: &[f64], judge: &Judge<'_>) -> Self {
        let n = a.len().max(1) as f64;
        let mean = a.iter().zip(b).map(|(x, y)| x - y).sum::<f64>() / n;
        let spread = a
            .iter()
            .zip(b)
            .map(|(x, y)| (x - y - mean).powi(2))
            .sum::<f64>()
            / (n - 1.0).max(1.0);
        // a rank correlation of m independent samples has a standard error of 1/√m
        let parts = judge.counted.iter().filter(|c| **c).count().max(1) as f64;
        let samples = judge
            .views
            .iter()
            .map(|v| v.samples.len() as f64)
            .sum::<f64>()
            .max(1.0);
        Self {
            mean,
            error: (spread / n + 1.0 / (samples * parts)).sqrt(),
        }
    }

    fn significance(&self) -> f64 {
        self.mean / self.error.max(1e-9)
    }
}

fn find_winner(judge: &Judge<'_>, candidates: &[Candidate], given: &[f64]) -> Option<Winner> {
    let mut tried: Vec<Candidate> = judge.adjusted(candidates.to_vec());
    let mut plain = candidates.to_vec();
    plain.sort_by(|a, b| b.score.total_cmp(&a.score));
    plain.truncate(2);
    tried.extend(plain);
    let scored = |c: &Candidate| {
        let scores = judge.scores(&c.hypothesis.correction, 1);
        let gain = Paired::of(&scores, given, judge);
        (scores, gain)
    };
    let mut best: Option<Winner> = None;
    for c in tried
        .iter()
        .filter(|c| c.hypothesis.correction != Correction::default())
    {
        let (scores, gain) = scored(c);
        let better = best.as_ref().is_none_or(|w| {
            let over = Paired::of(&scores, &w.scores, judge);
            // of two that cannot be told apart the simpler one
            if c.hypothesis.steps < w.hypothesis.steps {
                over.significance() > -1.0
            } else {
                over.mean > 0.0
            }
        });
        if better {
            best = Some(Winner {
                hypothesis: c.hypothesis.clone(),
                score: scores.iter().sum::<f64>() / scores.len() as f64,
                significance: gain.significance(),
                scores,
            });
        }
    }
    best
}

fn decide(out: &mut Alignment, judge: &Judge<'_>, winner: Option<Winner>) {
    let beaten = winner.filter(|w| w.significance > SIGNIFICANT);
    let Some(w) = beaten else {
        let above_chance = out.score > SIGNIFICANT * out.standard_error;
        // (photographs of bare walls fit nothing either: without a better hypothesis only rays
        // that miss the mesh are a proof, or edges that agree with it no better than chance)
        let missed = out.met < 0.5 && out.score + SIGNIFICANT * out.standard_error < NOTHING_FITS;
        let unrelated = !above_chance && out.compared > 0.5 && out.contrast > SHOWS_EDGES;
        out.verdict = if (Moves {
            peak: out.peak,
            weakest: out.weakest,
        })
        .is_peak()
            && above_chance
        {
            AlignmentVerdict::Aligned
        } else if missed || unrelated {
            AlignmentVerdict::Misaligned
        } else {
            AlignmentVerdict::Doubtful
        };
        return;
    };
    let small = is_small(judge, &w.hypothesis.correction);
    out.verdict = if small {
        AlignmentVerdict::Doubtful
    } else {
        AlignmentVerdict::Misaligned
    };
    out.corrected_distance = judge.distance_under(&w.hypothesis.correction);
    let around = Moves::of(
        judge,
        &w.hypothesis.correction,
        &w.scores,
        out.corrected_distance,
    );
    if !small && !around.is_peak() && w.score < FITS {
        // better than what was given, and yet no poses that fit: nothing to offer as a cure
        return;
    }
    out.hypotheses.push(Scored {
        name: w.hypothesis.name.clone(),
        score: w.score,
    });
    out.winner = Some(w.hypothesis.name);
    out.winner_significance = w.significance;
    out.correction = Some(w.hypothesis.correction);
}

/// Whether a correction moves all cameras so little that refinement is its place.
fn is_small(judge: &Judge<'_>, c: &Correction) -> bool {
    let distance = judge.distance();
    let before = judge.cameras(&Correction::default());
    let after = judge.cameras(c);
    let lens = (c.focal_scale - 1.0).abs() < 0.04 && !c.centred;
    lens && before.iter().zip(&after).all(|(a, b)| {
        let turn = a.world_from_camera.transpose() * b.world_from_camera;
        let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
        let proper = turn.determinant() > 0.0;
        proper
            && f64::from(cosine.clamp(-1.0, 1.0).acos()) < SMALL
            && f64::from(a.position.distance(b.position)) < SMALL * distance
    }) && c.scale.ln().abs() < SMALL
}

/// Lists the winner, the poses as given and the best of the rest.
fn list(out: &mut Alignment, candidates: &[Candidate]) {
    let winner = out.winner.clone();
    out.hypotheses.push(Scored {
        name: "as given".into(),
        score: out.score,
    });
    for c in candidates.iter().filter(|c| c.hypothesis.steps > 0) {
        if out.hypotheses.len() < LISTED && Some(&c.hypothesis.name) != winner.as_ref() {
            out.hypotheses.push(Scored {
                name: c.hypothesis.name.clone(),
                score: c.score,
            });
        }
    }
    out.hypotheses.sort_by(|a, b| b.score.total_cmp(&a.score));
}
