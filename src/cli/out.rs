//! What commands write on standard output, and say on standard error.

use std::io::{self, Write};

use anyhow::Context;

/// Writes text. Whoever reads it may have had enough, as `head` has: that is no failure, and what is left to say is said to nobody.
///
/// # Errors
/// An output that cannot be written for another reason, a full disk say.
pub fn print(text: &str) -> anyhow::Result<()> {
    print_bytes(text.as_bytes())
}

/// Writes bytes, as [`print`] does text.
///
/// # Errors
/// As [`print`].
pub fn print_bytes(bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    written(out.write_all(bytes).and_then(|()| out.flush()))
        .context("standard output cannot be written")
}

/// Says a line on standard error, to whoever listens; `eprintln!` panics where nobody does, as in `2>&1 | head`.
pub fn say_line(line: std::fmt::Arguments<'_>) {
    // There is nowhere else to say that it failed.
    let _ = writeln!(io::stderr(), "{line}");
}

/// [`say_line`], with what `format!` takes.
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
