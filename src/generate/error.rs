//! Errors of generators and writers.

use std::path::Path;

/// Why an asset could not be generated or written.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    #[error("{parameter}: {reason}")]
    Parameter { parameter: &'static str, reason: String },
    /// The file's extension does not fit the asset.
    #[error("{file}: cannot hold {what}; accepted are {accepted}")]
    Format { file: String, what: &'static str, accepted: &'static str },
    #[error("{file}: cannot be written")]
    Io { file: String, source: std::io::Error },
    /// A library's writer failed.
    #[error("{file}: {reason}")]
    Write { file: String, reason: String },
}

impl GenerateError {
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> GenerateError {
        let file = path.display().to_string();
        move |source| GenerateError::Io { file, source }
    }

    pub(super) fn write(path: &Path, reason: impl std::fmt::Display) -> GenerateError {
        GenerateError::Write { file: path.display().to_string(), reason: reason.to_string() }
    }
}
