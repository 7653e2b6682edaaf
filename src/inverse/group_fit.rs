//! The roughness of one group of surface points, as the views' evidence has it.

/// What the evidence says about one group.
#[derive(Clone, Debug)]
pub struct GroupFit {
    /// Class id.
    pub class: u16,
    /// Best roughness.
    pub roughness: f32,
    /// Standard error of the roughness.
    pub error: f32,
    /// The same by the points alone, as they were fitted, for differences within a class: without
    /// what all its points have in common.
    pub own_error: f32,
    /// Objective per level (mean relative disagreement).
    pub objective: Vec<f64>,
    /// Points used.
    pub points: usize,
}

impl GroupFit {
    /// The least mean relative disagreement of the views.
    #[must_use]
    pub fn disagreement(&self) -> f64 {
        self.objective.iter().copied().fold(f64::INFINITY, f64::min)
    }
}
