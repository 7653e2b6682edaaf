//! What goes in and out of a network's engine, whichever it is.

/// Columns and rows of a network's input; `None` = any.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub width: Option<usize>,
    pub height: Option<usize>,
}

/// Maps that a network gives.
pub(super) struct Output {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Maps.
    pub channels: usize,
    /// Map by map, row by row.
    pub values: Vec<f32>,
    /// Whole numbers: ids of classes already, not their logits.
    pub integers: bool,
}
