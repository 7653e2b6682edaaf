//! Alignment of photographs and mesh, tested before anything is solved.
//!
//! `evidence` reads the photographs once at low resolution; `score` says how well a set of cameras
//! agrees with the mesh; `hypotheses` are the usual mistakes; `search` tries them; `verdict` decides
//! by the differences of paired scores; `refine` mends small errors of single poses, by `joint_fit`.
//! Called by
//! `check` and `solve`.

mod apply;
mod correction;
mod evidence;
mod hypotheses;
mod joint_fit;
mod options;
mod refine;
mod score;
mod search;
mod text;
mod verdict;

pub use apply::apply;
pub use correction::Correction;
pub use evidence::{EvidenceSize, ViewEvidence, gather};
pub use hypotheses::Hypothesis;
pub use options::{AlignmentOptions, align};
pub use refine::{RefinedPose, refine};
pub use score::{Ground, PARTS, ViewScore, score_views};
pub use verdict::{Alignment, Scored, assess};

#[cfg(test)]
mod tests;
