//! What a reconstruction gives.

use crate::inverse::GroupFit;
use crate::solution::Solution;
use crate::verdict::Findings;

/// A reconstruction and what is known about it.
pub struct Solved {
    /// The textures.
    pub solution: Solution,
    /// Roughness fits per class.
    pub fits: Vec<GroupFit>,
    /// Rays traced in all.
    pub rays: u64,
    /// What is known of its faults.
    pub findings: Findings,
}
