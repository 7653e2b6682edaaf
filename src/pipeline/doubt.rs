//! What makes a whole result less sure, as stages find it before the albedo is known that it concerns.
//! Handed to `settle`.

use crate::verdict::Reason;

/// Something that makes every albedo less sure.
pub(super) struct Doubt {
    /// What, in a sentence.
    pub(super) what: String,
    /// Standard error of the albedo, relative.
    pub(super) relative: f64,
}

impl Doubt {
    /// As a reason against a result of this mean albedo.
    pub(super) fn reason(self, mean_albedo: f64) -> Reason {
        Reason {
            what: self.what,
            weight: self.relative * mean_albedo,
            place: String::new(),
        }
    }
}
