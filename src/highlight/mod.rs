//! Where the photographs say something about roughness: virtual highlights (VHL) and the specular response of points seen
//! from several views.

mod evidence;
mod select;

pub use evidence::{Evidence, EvidencePoint, MODELS, Sight, gather_evidence};
pub use select::{Candidate, SelectOptions, select_points};

/// Roughness levels at which specular responses are tabulated; closer where lobes change fastest.
pub const LEVELS: [f32; 18] =
    [0.03, 0.06, 0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.31, 0.36, 0.42, 0.48, 0.55, 0.62, 0.70, 0.80, 0.90, 1.0];

/// Roughness of the lobes that directions are drawn from; every level is close to one of them.
pub const LOBES: [f32; 7] = [0.05, 0.10, 0.17, 0.28, 0.45, 0.68, 1.0];
