//! The exposure of a photograph by its EXIF, and the groups of a folder.

use crate::core::formats::exif_exposure;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Exposures nearer than this are the same (derived: a third of a stop is 26 %).
const SAME: f64 = 0.05;

/// A photograph and how much light it took in.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// The file.
    pub path: PathBuf,
    /// Seconds · ISO / 100 / f-number².
    pub exposure: f64,
}

/// Reads a photograph's exposure.
///
/// # Errors
/// [`Error::Input`] where the file states no time.
pub fn read_exposure(path: &Path) -> Result<f64> {
    exif_exposure(path).map_err(|what| {
        Error::input(
            path,
            format!(
                "{what}; give the times in the order of the file names with --exposure-times 1/4,1/15,1/60"
            ),
        )
    })
}

/// Parses `--exposure-times`: seconds, `1/60` or `0.5`.
///
/// # Errors
/// [`Error::Usage`] naming the word.
pub fn parse_times(list: &str) -> Result<Vec<f64>> {
    let one = |word: &str| -> Option<f64> {
        let (over, under) = word.trim().split_once('/').unwrap_or((word.trim(), "1"));
        let t = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
        (t.is_finite() && t > 0.0).then_some(t)
    };
    list.split(',')
        .map(|word| {
            one(word).ok_or_else(|| {
                Error::Usage(format!(
                    "--exposure-times: \"{word}\" is no time in seconds such as 1/60 or 0.5"
                ))
            })
        })
        .collect()
}

/// Parts a folder's photographs, in the order of their names, into brackets: a new one begins when
/// an exposure comes again.
#[must_use]
pub fn groups(photographs: Vec<Photograph>) -> Vec<Vec<Photograph>> {
    let mut groups: Vec<Vec<Photograph>> = Vec::new();
    for p in photographs {
        let again = |g: &Vec<Photograph>| {
            g.iter()
                .any(|q| (q.exposure / p.exposure).ln().abs() < SAME)
        };
        match groups.last_mut() {
            Some(g) if !again(g) => g.push(p),
            _ => groups.push(vec![p]),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_parsed_and_refused_by_word() {
        assert_eq!(parse_times("1/4, 0.5,2").expect("times"), [0.25, 0.5, 2.0]);
        for bad in ["", "1/0", "fast", "-1", "1/4,,2"] {
            assert!(parse_times(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_bracket_ends_when_an_exposure_comes_again() {
        let p = |e: f64| Photograph {
            path: PathBuf::new(),
            exposure: e,
        };
        let made = groups([1.0, 4.0, 0.25, 1.01, 4.0, 0.25].map(p).to_vec());
        assert_eq!(made.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3]);
    }
}
