//! The command line program; everything is in the library.

use std::io::Write;
use std::process::ExitCode;

fn main() -> ExitCode {
    match pointillist::cli::run() {
        Ok(code) => code,
        Err(error) => {
            // The process that started it may listen no more.
            let _ = writeln!(std::io::stderr(), "pointillist: {error:#}");
            ExitCode::FAILURE
        }
    }
}
