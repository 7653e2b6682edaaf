//! The written account of an import: what was read, what was changed on the way, what was left out.

use serde::Serialize;

/// Sentences for people, in the order in which things happened.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Account {
    /// Files and what they held.
    pub read: Vec<String>,
    /// Conventions turned, images resampled, scales applied.
    pub converted: Vec<String>,
    /// What the capture holds and the scene does not, and why.
    pub ignored: Vec<String>,
}

impl Account {
    /// Something was read.
    pub fn read(&mut self, line: impl Into<String>) {
        self.read.push(line.into());
    }

    /// Something was changed.
    pub fn converted(&mut self, line: impl Into<String>) {
        self.converted.push(line.into());
    }

    /// Something was left out.
    pub fn ignored(&mut self, line: impl Into<String>) {
        self.ignored.push(line.into());
    }

    /// All lines, each with its heading before it.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        [
            ("read", &self.read),
            ("converted", &self.converted),
            ("ignored", &self.ignored),
        ]
        .into_iter()
        .flat_map(|(heading, lines)| lines.iter().map(move |l| format!("{heading}: {l}")))
        .collect()
    }
}
