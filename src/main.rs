//! The command line program; everything is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    match pointillist::cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("pointillist: {error:#}");
            ExitCode::FAILURE
        }
    }
}
