//! What can go wrong, in words a user can act on.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// Result of everything that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// Text for a terminal: control characters are shown as escapes, so that a name in a file cannot
/// move the cursor, forge a line or set the window's title.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    // C0, DEL and C1, and the marks that turn the direction of writing round
    let bad =
        |c: char| c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    if !text.contains(bad) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match bad(c) {
            true => out.extend(c.escape_default()),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}

/// An error that names the file, the place in it, what was expected and how to mend it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Input that cannot be used: exit code 2. The message says what is wrong and the way out.
    #[error("{}: {}", shown(path), printable_lines(message))]
    Input {
        /// The file or folder concerned.
        path: PathBuf,
        /// Place, expectation and cure.
        message: String,
    },
    /// Several unusable inputs, all reported at once: exit code 2.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Inputs(Vec<Error>),
    /// Options that contradict each other or are out of range: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// Reading or writing failed: exit code 1 when writing, 2 when reading input (use
    /// [`Error::Input`] there).
    #[error("{}: {source}", shown(path))]
    Io {
        /// The file concerned.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A native library failed or is missing: exit code 1.
    #[error("{0}")]
    Native(String),
    /// A computation could not be carried out: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// Whoever watches the work stopped it: exit code 1. Nothing was written; what long stages had
    /// finished is kept, and the same call goes on from there.
    #[error("stopped on request; the same call goes on where this one was")]
    Stopped,
}

/// [`printable`] for texts of several lines.
#[must_use]
pub fn printable_lines(text: &str) -> String {
    let lines: Vec<_> = text.split('\n').map(printable).collect();
    lines.join("\n")
}

fn shown(path: &Path) -> String {
    printable(&path.to_string_lossy()).into_owned()
}

impl Error {
    /// Unusable input at `path`.
    pub fn input(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        Self::Input {
            path: path.as_ref().to_path_buf(),
            message: message.into(),
        }
    }

    /// The same with one more piece of advice, if it is about input; other errors stay as they are.
    #[must_use]
    pub fn advise(self, more: &str) -> Self {
        match self {
            Self::Input { path, message } => Self::Input {
                path,
                message: format!("{message}; {more}"),
            },
            other => other,
        }
    }

    /// A failed system call on `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io {
            path: path.as_ref().to_path_buf(),
            source,
        }
    }

    /// The process exit code: 2 for wrong usage or unusable input, 1 otherwise.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Inputs(_) | Self::Usage(_) => 2,
            Self::Io { .. } | Self::Native(_) | Self::Failed(_) | Self::Stopped => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_drive_the_terminal() {
        assert_eq!(printable("wall, Stuck é"), "wall, Stuck é");
        let evil = "\u{1b}]0;pwn\u{7}\u{1b}[2J\nerror: all is well \u{202e}";
        let shown = printable(evil);
        assert!(!shown.contains(|c: char| c.is_control()), "{shown}");
        assert!(shown.contains("\\u{1b}]0;pwn\\u{7}") && shown.contains("\\nerror"));
        let e = Error::input("a\u{1b}\nb", "c\u{1b}d\ne").to_string();
        assert_eq!(
            e, "a\\u{1b}\\nb: c\\u{1b}d\ne",
            "messages may have lines, paths not"
        );
    }
}
