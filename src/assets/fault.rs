//! Constructors of [`AssetError`], so that every reader words the same fault the same way.

use std::io::{Error, ErrorKind};

use super::AssetError;
use crate::memory::Interrupt;

/// Travels inside an [`Error`] when a stream decompresses to more than it may.
#[derive(Debug, thiserror::Error)]
#[error("more than {limit} bytes after decompression")]
pub(crate) struct OverLimit {
    pub limit: u64,
}

/// The interrupt that travels inside an [`Error`] of a stream that was told to end.
pub(crate) fn interrupt_of(error: &Error) -> Option<Interrupt> {
    error.get_ref()?.downcast_ref::<Interrupt>().cloned()
}

impl AssetError {
    pub(crate) fn malformed(
        file: &str,
        place: impl Into<String>,
        reason: impl Into<String>,
    ) -> AssetError {
        AssetError::Malformed { file: file.to_owned(), place: place.into(), reason: reason.into() }
    }

    pub(crate) fn unsupported(file: &str, reason: impl Into<String>) -> AssetError {
        AssetError::Unsupported { file: file.to_owned(), reason: reason.into() }
    }

    /// An error of the stream itself. A decompression limit and damaged compressed data come back as
    /// what they are rather than as trouble with the disk.
    pub(crate) fn io(file: &str, source: Error) -> AssetError {
        if let Some(interrupt) = interrupt_of(&source) {
            return interrupt.into();
        }
        if let Some(over) = source.get_ref().and_then(|inner| inner.downcast_ref::<OverLimit>()) {
            return AssetError::TooLarge {
                file: file.to_owned(),
                what: "decompressed bytes",
                found: over.limit.saturating_add(1),
                limit: over.limit,
            };
        }
        match source.kind() {
            ErrorKind::InvalidData | ErrorKind::InvalidInput => {
                AssetError::malformed(file, "compressed data", source.to_string())
            }
            ErrorKind::UnexpectedEof => {
                AssetError::malformed(file, "end of file", "the file is truncated")
            }
            _ => AssetError::Io { file: file.to_owned(), source },
        }
    }

    /// Refuses `found` above `limit`.
    pub(crate) fn check_limit(
        file: &str,
        what: &'static str,
        found: u64,
        limit: u64,
    ) -> Result<(), AssetError> {
        if found <= limit {
            return Ok(());
        }
        Err(AssetError::TooLarge { file: file.to_owned(), what, found, limit })
    }
}
