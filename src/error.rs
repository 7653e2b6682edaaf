//! What can go wrong, in words a user can act on.

use std::path::{Path, PathBuf};

/// Result of everything that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// An error that names the file, the place in it, what was expected and how to mend it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Input that cannot be used: exit code 2. The message says what is wrong and the way out.
    #[error("{}: {message}", path.display())]
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
    #[error("{}: {source}", path.display())]
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
}

impl Error {
    /// Unusable input at `path`.
    pub fn input(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        Self::Input {
            path: path.as_ref().to_path_buf(),
            message: message.into(),
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
            Self::Io { .. } | Self::Native(_) | Self::Failed(_) => 1,
        }
    }
}
