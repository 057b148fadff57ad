//! Output of commands: results on standard output, messages on standard error.

use std::io::{self, Write};

use anyhow::Context;

/// Writes text to standard output. If the reader has closed the pipe, as `head` does, the rest is dropped without an error.
///
/// # Errors
/// The output cannot be written for another reason, such as a full disk.
pub fn print(text: &str) -> anyhow::Result<()> {
    print_bytes(text.as_bytes())
}

/// Writes bytes, as [`print()`] does text.
///
/// # Errors
/// As [`print()`].
pub fn print_bytes(bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    written(out.write_all(bytes).and_then(|()| out.flush()))
        .context("cannot write to standard output")
}

/// Writes a line to standard error, and ignores errors. `eprintln!` panics if the reader is gone, as in `2>&1 | head`.
pub fn say_line(line: std::fmt::Arguments<'_>) {
    // A failure could be reported nowhere.
    let _ = writeln!(io::stderr(), "{line}");
}

/// [`say_line`] with the arguments of `format!`.
macro_rules! say {
    ($($line:tt)*) => { $crate::cli::out::say_line(format_args!($($line)*)) };
}
pub(crate) use say;

fn written(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_has_had_enough_is_no_failure() {
        assert!(written(Ok(())).is_ok());
        assert!(written(Err(io::ErrorKind::BrokenPipe.into())).is_ok());
        assert!(written(Err(io::ErrorKind::StorageFull.into())).is_err());
    }
}
