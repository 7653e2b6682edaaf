//! [`Alignment`] for people: the verdict first, then the numbers, then the way out.

use super::verdict::Alignment;
use crate::verdict::AlignmentVerdict;
use std::fmt::{Display, Formatter, Result};

impl Alignment {
    /// What is wrong and the way out; `None` unless misaligned.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        if self.verdict != AlignmentVerdict::Misaligned || self.fixed {
            return None;
        }
        let nothing = || {
            format!(
                ": {:.0} % of the rays meet the mesh, and none of the usual mistakes explains it; are these the photographs of this mesh?",
                100.0 * self.met
            )
        };
        let found = self.winner.as_ref().map_or_else(nothing, |w| {
            format!(
                ": {w} ({:.0} standard errors better); pass --fix-alignment to apply this, or correct the files",
                self.winner_significance
            )
        });
        Some(format!(
            "photographs and mesh do not fit{found} (--force solves all the same)"
        ))
    }

    /// What a user should know although the scene can be used.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        (self.verdict == AlignmentVerdict::Doubtful).then(|| {
            let found = self.winner.as_ref().map_or(String::new(), |w| {
                format!("; they would fit better if this were mended: {w}")
            });
            format!("it is doubtful whether photographs and mesh fit{found}")
        })
    }
}

impl Display for Alignment {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let verdict = match self.verdict {
            AlignmentVerdict::Aligned => "aligned",
            AlignmentVerdict::Doubtful => "doubtful",
            AlignmentVerdict::Misaligned => "MISALIGNED",
        };
        write!(
            f,
            "alignment: {verdict} (score {:.2} ± {:.2}; 0 by chance, 1 perfect; {:.0} standard errors above poses moved by 6°)",
            self.score, self.standard_error, self.peak
        )?;
        if let (Some(w), false) = (&self.winner, self.fixed) {
            let best = self.hypotheses.first().map_or(0.0, |h| h.score);
            write!(f, "\n  fits better: {w} (score {best:.2})")?;
        }
        if self.fixed {
            write!(
                f,
                "\n  corrected by --fix-alignment: {}",
                self.winner.as_deref().unwrap_or("nothing")
            )?;
        }
        if let Some(largest) = self
            .refined
            .iter()
            .max_by(|a, b| a.degrees.total_cmp(&b.degrees))
        {
            write!(
                f,
                "\n  poses of {} views refined by --refine-poses; largest: {} by {:.2}° ± {:.2}° and {:.3} ± {:.3} m",
                self.refined.len(),
                largest.stem,
                largest.degrees,
                largest.degrees_error,
                largest.metres,
                largest.metres_error
            )?;
        }
        Ok(())
    }
}
