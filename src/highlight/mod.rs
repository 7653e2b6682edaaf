//! Where the photographs say something about roughness: virtual highlights (VHL) and the specular
//! response of points seen from several views.

mod evidence;
mod select;

#[cfg(test)]
pub(crate) use evidence::TestSight;

pub use evidence::{DIELECTRICS, Evidence, EvidencePoint, Tabulation, ViewSample, gather_evidence};
pub use select::{Candidate, SelectOptions, select_points};

/// Roughness levels at which specular responses are tabulated; closer where lobes change fastest.
pub const LEVELS: [f32; 18] = [
    0.03, 0.06, 0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.31, 0.36, 0.42, 0.48, 0.55, 0.62, 0.70, 0.80,
    0.90, 1.0,
];

/// `n` levels from the first to the last of [`LEVELS`], as unevenly spaced as those; `LEVELS`
/// themselves for 18. At least two.
#[must_use]
pub fn roughness_levels(n: usize) -> Vec<f32> {
    let steps = (LEVELS.len() - 1) as f32;
    (0..n.max(2))
        .map(|i| {
            let x = i as f32 * steps / (n.max(2) - 1) as f32;
            let k = (x as usize).min(LEVELS.len() - 2);
            let t = x - k as f32;
            LEVELS[k] * (1.0 - t) + LEVELS[k + 1] * t
        })
        .collect()
}

/// Roughness of the lobes that directions are drawn from; every level is close to one of them.
pub const LOBES: [f32; 7] = [0.05, 0.10, 0.17, 0.28, 0.45, 0.68, 1.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_levels_rises_between_the_same_ends() {
        assert_eq!(roughness_levels(LEVELS.len()), LEVELS);
        for n in [2, 3, 9, 35, 72] {
            let levels = roughness_levels(n);
            assert_eq!(levels.len(), n);
            assert_eq!(
                [levels[0], levels[n - 1]],
                [LEVELS[0], LEVELS[LEVELS.len() - 1]]
            );
            assert!(levels.windows(2).all(|w| w[0] < w[1]), "{n}: {levels:?}");
        }
    }
}
