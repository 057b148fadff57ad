//! Output of commands: results on standard output, messages on standard error.

use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, ensure};

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

/// Refuses a file whose place has no room for one. Commands ask before they load a scene, which may take minutes.
///
/// # Errors
/// The file is a folder, or lies in a folder that does not exist.
pub fn check_place(file: &Path) -> anyhow::Result<()> {
    ensure!(!file.is_dir(), "{}: this is a folder; name a file in it", file.display());
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        ensure!(
            folder.is_dir(),
            "{}: there is no folder {}; make it, or name a file in another folder",
            file.display(),
            folder.display()
        );
    }
    Ok(())
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
    fn files_need_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |name: &str| check_place(&folder.path().join(name)).unwrap_err().to_string();
        assert!(check_place(Path::new("a.png")).is_ok());
        assert!(check_place(&folder.path().join("a.png")).is_ok());
        assert!(refused("").contains("this is a folder"));
        std::fs::write(folder.path().join("file"), "").unwrap();
        for name in ["none/a.png", "file/a.png"] {
            let told = refused(name);
            assert!(told.contains("there is no folder") && told.contains(name), "{told}");
        }
    }

    #[test]
    fn who_has_had_enough_is_no_failure() {
        assert!(written(Ok(())).is_ok());
        assert!(written(Err(io::ErrorKind::BrokenPipe.into())).is_ok());
        assert!(written(Err(io::ErrorKind::StorageFull.into())).is_err());
    }
}
