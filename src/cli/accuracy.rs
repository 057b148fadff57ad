//! `pointillist accuracy`: reports what accuracy costs, and whether bounds on errors hold.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;

use super::out;
use crate::accuracy::stability::stability;

/// Options of `pointillist accuracy`.
#[derive(Args, Clone, Debug)]
pub struct AccuracyArgs {
    /// Compare the splat shaders on this adapter with exact results for hard cases; fails if an error bound is exceeded
    #[arg(long)]
    stability: bool,
    /// Folder for stability.json and stability.md; created if missing
    #[arg(short, long, alias = "output", value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Seed of the random splats
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of splats in each class
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

/// Makes the report, prints it, and writes it to a file.
///
/// # Errors
/// The report does not exist yet, a file cannot be written, or a bound does not hold.
pub fn run(args: &AccuracyArgs) -> Result<()> {
    if !args.stability {
        bail!("no report was selected: give --stability, the only report");
    }
    let report = stability(args.seed, args.count)?;
    let json = serde_json::to_string_pretty(&report)? + "\n";
    if args.json {
        out::print(&json)?;
    } else {
        out::print(&report.to_string())?;
    }
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("making the folder {}", folder.display()))?;
        for (name, text) in [("stability.json", json), ("stability.md", report.markdown())] {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        }
    }
    let broken: Vec<&str> =
        report.rows.iter().filter(|row| !row.holds).map(|row| row.class.as_str()).collect();
    if !broken.is_empty() {
        bail!("outlines exceed their error bounds: {}", broken.join("; "));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writes_both_files_and_says_what_does_not_exist() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("new");
        let mut args = AccuracyArgs {
            stability: true,
            out: Some(output.clone()),
            seed: 5,
            count: 3,
            json: true,
        };
        run(&args).unwrap();
        let json = std::fs::read_to_string(output.join("stability.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!((&report["holds"], &report["seed"]), (&true.into(), &5.into()));
        let page = std::fs::read_to_string(output.join("stability.md")).unwrap();
        assert!(page.contains("3 splats a row, seed 5"), "{page}");
        args.stability = false;
        assert!(run(&args).unwrap_err().to_string().contains("--stability"));
    }
}
