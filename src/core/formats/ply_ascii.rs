//! The elements of an ASCII PLY file: a line each, its numbers apart by blanks.
//!
//! They are read here because the library's grammar refuses what programs write: numbers that are
//! none (`nan`, `-nan(ind)`, `inf`), whole ones with a point (`3.0` for an int) and blank lines.
//! Called by `ply`.

use ply_rs_bw::ply::{ElementDef, Property, PropertyAccess, PropertyType, ScalarType};

/// What of an ASCII file has not been read yet.
pub(super) struct AsciiLines<'a> {
    rest: &'a [u8],
    /// Lines that were read, those of the header included.
    read: usize,
}

impl<'a> AsciiLines<'a> {
    /// What follows a header of so many lines.
    pub(super) fn new(rest: &'a [u8], header_lines: usize) -> Self {
        Self {
            rest,
            read: header_lines,
        }
    }

    /// The elements that the header announces. Numbers become `Float` or `Double`, lists
    /// `ListDouble`, whatever the header calls them: who takes them judges whether they are whole.
    ///
    /// # Errors
    /// A line is missing, too short or holds what is no number: the message names the line.
    pub(super) fn elements<E: PropertyAccess>(
        &mut self,
        kind: &ElementDef,
    ) -> Result<Vec<E>, String> {
        let mut found = Vec::new();
        while found.len() < kind.count && !kind.properties.is_empty() {
            let Some(line) = self.next_line() else {
                return Err(format!(
                    "the file ends after {} of {}",
                    found.len(),
                    kind.count
                ));
            };
            let element = element(&String::from_utf8_lossy(line), kind);
            found.push(element.map_err(|e| format!("line {}: {e}", self.read))?);
        }
        Ok(found)
    }

    /// The next line that is not blank.
    fn next_line(&mut self) -> Option<&'a [u8]> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|b| *b == b'\n');
            let (line, rest) = self.rest.split_at(end.map_or(self.rest.len(), |e| e + 1));
            self.rest = rest;
            self.read += 1;
            if !line.trim_ascii().is_empty() {
                return Some(line);
            }
        }
        None
    }
}

/// The element in a line; numbers beyond those announced do not matter.
fn element<E: PropertyAccess>(line: &str, kind: &ElementDef) -> Result<E, String> {
    let mut words = line.split_ascii_whitespace();
    let mut next = |name: &str| {
        let word = words.next();
        let word = word.ok_or_else(|| format!("it ends before the property \"{name}\""))?;
        number(word).ok_or_else(|| {
            let comma = word.contains(',');
            let why = if comma { " (decimal comma?)" } else { "" };
            format!("'{word}' is no number{why}")
        })
    };
    let mut out = E::new();
    for (name, property) in &kind.properties {
        let value = match property.data_type {
            PropertyType::Scalar(ScalarType::Float) => Property::Float(next(name)? as f32),
            PropertyType::Scalar(_) => Property::Double(next(name)?),
            PropertyType::List(..) => {
                let length = next(name)?;
                // (two bytes for every number that may follow)
                if length.fract() != 0.0 || !(0.0..=line.len() as f64).contains(&length) {
                    return Err(format!("{length} is no length of the list \"{name}\""));
                }
                let list = (0..length as usize).map(|_| next(name));
                Property::ListDouble(list.collect::<Result<_, _>>()?)
            }
        };
        // (properties that nobody knows are left out)
        let _ = out.set_property(name, value);
    }
    Ok(out)
}

/// A number as any C library prints it: those that are none as `nan`, `-nan(ind)` or `1.#QNAN`.
fn number(word: &str) -> Option<f64> {
    if let Ok(number) = word.parse() {
        return Some(number);
    }
    let bare = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
    match bare.strip_prefix("1.#") {
        Some(inf) if inf.starts_with("inf") => Some(f64::INFINITY),
        Some(_) => Some(f64::NAN),
        None => bare.starts_with("nan(").then_some(f64::NAN),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_none_are_told_from_words() {
        for nan in [
            "nan",
            "-nan",
            "NaN",
            "-nan(ind)",
            "nan(snan)",
            "1.#QNAN",
            "-1.#IND",
        ] {
            assert!(number(nan).is_some_and(f64::is_nan), "{nan}");
        }
        for infinite in ["inf", "-inf", "Infinity", "1.#INF"] {
            assert!(number(infinite).is_some_and(f64::is_infinite), "{infinite}");
        }
        assert_eq!(number("3.0"), Some(3.0));
        for word in ["banana", "nanometre", "1,5", "", "#"] {
            assert!(number(word).is_none(), "{word}");
        }
    }
}
