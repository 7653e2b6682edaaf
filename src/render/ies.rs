//! Luminaires measured with a goniophotometer: IESNA LM-63 files (1986 to 2019), photometric type
//! C.
//!
//! Angles: vertical from 0 (along the lamp's axis, straight down as mounted) to 180 degrees;
//! horizontal around the axis. A file may state a quarter (0 to 90) or a half (0 to 180) of a
//! symmetric distribution, or one plane of a rotationally symmetric one.

use crate::core::formats::{MOST_TEXT, read_input};
use crate::error::{Error, Result};
use std::path::Path;

/// Luminous intensity over directions, as a share of its maximum.
#[derive(Clone, Debug, PartialEq)]
pub struct IesProfile {
    /// Degrees, ascending.
    vertical: Vec<f32>,
    /// Degrees, ascending; one value where the distribution is rotationally symmetric.
    horizontal: Vec<f32>,
    /// `[horizontal][vertical]`, 0 to 1.
    share: Vec<f32>,
}

/// Angles a file may state.
const MOST_ANGLES: usize = 4096;

/// A part of a file, or what is wrong with it.
type Parsed<T> = std::result::Result<T, String>;

/// The numbers of a file in their order; each is named for the message if it is missing or wrong.
struct Numbers<'a> {
    words: Box<dyn Iterator<Item = &'a str> + 'a>,
}

impl<'a> Numbers<'a> {
    /// The numbers that follow the line TILT=NONE.
    fn after_tilt(text: &'a str) -> Parsed<Self> {
        let body = text
            .find("TILT=")
            .map(|at| &text[at + 5..])
            .ok_or("no line TILT=: expected an IES file (LM-63)")?;
        let (tilt, rest) = body.split_once('\n').ok_or("ends after TILT=")?;
        if !tilt.trim().eq_ignore_ascii_case("NONE") {
            return Err(format!(
                "TILT={}: only TILT=NONE is read; export the luminaire without tilt",
                tilt.trim()
            ));
        }
        let words = rest
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|w| !w.is_empty());
        Ok(Self {
            words: Box::new(words),
        })
    }

    fn next(&mut self, what: &str) -> Parsed<f32> {
        let word = self.words.next().ok_or(format!("ends before {what}"))?;
        let value: f32 = word
            .parse()
            .map_err(|_| format!("{what}: {word:?} is no number"))?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(format!("{what}: {word} is not finite"))
        }
    }

    fn skip(&mut self, names: &[&str]) -> Parsed<()> {
        names.iter().try_for_each(|what| self.next(what).map(drop))
    }

    fn count(&mut self, what: &str) -> Parsed<usize> {
        match self.next(what)? {
            n if n >= 1.0 && n <= MOST_ANGLES as f32 && n.fract() == 0.0 => Ok(n as usize),
            n => Err(format!(
                "{what}: {n}; expected a whole number from 1 to {MOST_ANGLES}"
            )),
        }
    }

    fn list(&mut self, count: usize, what: &str) -> Parsed<Vec<f32>> {
        (0..count).map(|_| self.next(what)).collect()
    }
}

fn check_angles(name: &str, angles: &[f32], end: f32) -> Parsed<()> {
    if angles.windows(2).any(|w| w[0] >= w[1]) || angles[0] < 0.0 || angles[angles.len() - 1] > end
    {
        return Err(format!(
            "the {name} angles must ascend within 0 to {end} degrees"
        ));
    }
    Ok(())
}

impl IesProfile {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is no LM-63 file of type C; the message names what was expected.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = read_input(path, MOST_TEXT)
            .map_err(|e| e.advise("expected a luminaire's IES file (LM-63)"))?;
        Self::parse(&String::from_utf8_lossy(&bytes)).map_err(|m| Error::input(path, m))
    }

    /// Parses the text of a file.
    fn parse(text: &str) -> Parsed<Self> {
        let mut numbers = Numbers::after_tilt(text)?;
        numbers.skip(&[
            "the number of lamps",
            "the lumens per lamp",
            "the candela multiplier",
        ])?;
        let rows = numbers.count("the number of vertical angles")?;
        let columns = numbers.count("the number of horizontal angles")?;
        match numbers.count("the photometric type")? {
            1 => {}
            t => return Err(format!("photometric type {t}: only type C (1) is read")),
        }
        numbers.skip(&[
            "units",
            "width",
            "length",
            "height",
            "the ballast factor",
            "the ballast-lamp factor",
            "the input watts",
        ])?;
        let vertical = numbers.list(rows, "a vertical angle")?;
        let horizontal = numbers.list(columns, "a horizontal angle")?;
        let candela = numbers.list(rows * columns, "a candela value")?;
        check_angles("vertical", &vertical, 180.0)?;
        check_angles("horizontal", &horizontal, 360.0)?;
        let most = candela.iter().copied().fold(0.0, f32::max);
        if most <= 0.0 || candela.iter().any(|c| *c < 0.0) {
            return Err("candela values must not be negative, and one must be positive".into());
        }
        Ok(Self {
            vertical,
            horizontal,
            share: candela.into_iter().map(|c| c / most).collect(),
        })
    }

    /// Share of the largest intensity in a direction: `cosine` to the lamp's axis, `around` the
    /// axis in radians; 0 where the file states nothing.
    #[must_use]
    pub fn share(&self, cosine: f32, around: f32) -> f32 {
        let theta = cosine.clamp(-1.0, 1.0).acos().to_degrees();
        let Some((row, t)) = place(&self.vertical, theta) else {
            return 0.0;
        };
        let last = self.horizontal[self.horizontal.len() - 1];
        let phi = around.to_degrees().rem_euclid(360.0);
        let phi = match last {
            l if l <= 90.0 => (phi - 180.0 * (phi / 180.0).round()).abs(),
            l if l <= 180.0 => phi.min(360.0 - phi),
            _ => phi,
        };
        let (column, s) =
            place(&self.horizontal, phi.clamp(self.horizontal[0], last)).unwrap_or((0, 0.0));
        let at = |i: usize, j: usize| {
            let (i, j) = (
                i.min(self.horizontal.len() - 1),
                j.min(self.vertical.len() - 1),
            );
            self.share[i * self.vertical.len() + j]
        };
        let along = |i: usize| at(i, row) + t * (at(i, row + 1) - at(i, row));
        along(column) + s * (along(column + 1) - along(column))
    }
}

/// Interval of an ascending list and the place in it; `None` beyond its ends.
fn place(angles: &[f32], x: f32) -> Option<(usize, f32)> {
    if x < angles[0] - 1e-3 || x > angles[angles.len() - 1] + 1e-3 {
        return None;
    }
    let i = angles.partition_point(|a| *a <= x).saturating_sub(1);
    let width = angles.get(i + 1).map_or(1.0, |b| b - angles[i]);
    Some((i, ((x - angles[i]) / width).clamp(0.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(angles: &str, candela: &str, counts: &str) -> String {
        format!(
            "IESNA:LM-63-2002\n[TEST] x\nTILT=NONE\n1 1000 1 {counts} 1 2 0 0 0\n1 1 20\n{angles}\n{candela}\n"
        )
    }

    #[test]
    fn one_plane_is_rotationally_symmetric_and_ends_at_its_last_angle() {
        let p = IesProfile::parse(&file("0 45 90\n0", "200 100,0", "3 1")).expect("parses");
        let at = |degrees: f32, around: f32| p.share(degrees.to_radians().cos(), around);
        assert!(
            (at(0.0, 0.3) - 1.0).abs() < 1e-3
                && (at(22.5, 2.0) - 0.75).abs() < 1e-3
                && (at(45.0, 5.0) - 0.5).abs() < 1e-3
        );
        assert_eq!(at(120.0, 0.0), 0.0);
    }

    #[test]
    fn a_quarter_and_a_half_are_mirrored() {
        let degrees = |p: &IesProfile, phi: f32| p.share(0.0, phi.to_radians());
        let quarter = IesProfile::parse(&file("0 90\n0 90", "10 10 10 5", "2 2")).expect("parses");
        for (phi, expected) in [
            (0.0, 1.0),
            (90.0, 0.5),
            (45.0, 0.75),
            (135.0, 0.75),
            (180.0, 1.0),
            (270.0, 0.5),
            (315.0, 0.75),
        ] {
            assert!((degrees(&quarter, phi) - expected).abs() < 1e-3, "{phi}");
        }
        let half = IesProfile::parse(&file("0 90\n0 180", "10 10 10 5", "2 2")).expect("parses");
        for (phi, expected) in [(0.0, 1.0), (180.0, 0.5), (90.0, 0.75), (270.0, 0.75)] {
            assert!((degrees(&half, phi) - expected).abs() < 1e-3, "{phi}");
        }
    }

    #[test]
    fn damaged_files_are_refused_in_words() {
        let good = file("0 45 90\n0", "200 100 0", "3 1");
        for (text, words) in [
            ("hello".to_owned(), "TILT="),
            (good.replace("NONE", "INCLUDE"), "without tilt"),
            (
                good.replace("200 100 0", "200 100"),
                "ends before a candela value",
            ),
            (good.replace("200 100 0", "200 x 0"), "is no number"),
            (good.replace("0 45 90", "0 95 90"), "must ascend"),
            (good.replace("3 1 1 2", "3 1 2 2"), "only type C"),
            (good.replace("3 1 1 2", "99999 1 1 2"), "whole number"),
            (good.replace("200 100 0", "0 0 0"), "one must be positive"),
        ] {
            let e = IesProfile::parse(&text).expect_err("damaged");
            assert!(e.contains(words), "{e}");
        }
    }
}
