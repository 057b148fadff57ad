//! The report of a survey: JSON, Markdown, an SVG and one self-contained HTML page, all made of the same [`Results`]. Several reports
//! together tell what accuracy costs in several scenes ([`Costs`]).

mod cost;
mod markdown;
mod page;
mod plot;
mod svg;

use std::path::{Path, PathBuf};

pub use cost::{cost_markdown, cost_svg};
pub use markdown::markdown;
pub use page::{Images, MOST_IMAGE_BYTES, page};
pub use svg::svg;

use super::cost::Costs;
use super::journal::write_whole;
use super::results::Results;
use crate::encode::EncodeError;
use crate::scene::recolor::ColorMap;

/// Why a report cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    #[error("{file}: {error}", file = file.display())]
    Io { file: PathBuf, error: std::io::Error },
    #[error("{file}: the image cannot be read: {reason}; delete the folder to draw it anew", file = file.display())]
    Image { file: PathBuf, reason: String },
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

/// Writes all files of the report into the folder, which has the frames already. Returns the path of the page.
///
/// # Errors
/// A frame cannot be read, or a file cannot be written.
pub fn write(folder: &Path, results: &Results) -> Result<PathBuf, ReportError> {
    let images = Images::load(folder, results, MOST_IMAGE_BYTES)?;
    let plot = svg(results);
    let json = serde_json::to_string_pretty(results)? + "\n";
    for (name, text) in [
        ("accuracy.json", json),
        ("accuracy.md", markdown(results)),
        ("accuracy.svg", plot),
        ("index.html", page(results, &images)?),
    ] {
        write_file(folder.join(name), &text)?;
    }
    Ok(folder.join("index.html"))
}

/// Writes `cost.json`, `cost.md` and `cost.svg` into the folder, which is created if missing. Returns the path of the plot.
///
/// # Errors
/// The folder cannot be created, or a file cannot be written.
pub fn write_costs(folder: &Path, costs: &Costs) -> Result<PathBuf, ReportError> {
    std::fs::create_dir_all(folder)
        .map_err(|error| ReportError::Io { file: folder.to_owned(), error })?;
    let json = serde_json::to_string_pretty(costs)? + "\n";
    for (name, text) in
        [("cost.json", json), ("cost.md", cost_markdown(costs)), ("cost.svg", cost_svg(costs))]
    {
        write_file(folder.join(name), &text)?;
    }
    Ok(folder.join("cost.svg"))
}

fn write_file(file: PathBuf, text: &str) -> Result<(), ReportError> {
    write_whole(&file, text.as_bytes()).map_err(|error| ReportError::Io { file, error })
}

/// Opaque colour of a FLIP value in 0..=1.
pub fn heat(value: f64) -> [u8; 4] {
    let colors = ColorMap::Plasma.colors();
    let place = value.clamp(0.0, 1.0) * (colors.len() - 1) as f64;
    let (low, high) = (colors[place as usize], colors[place.ceil() as usize]);
    let channel = |i: usize| {
        let (low, high) = (f64::from(low[i]), f64::from(high[i]));
        (low + (high - low) * place.fract()).round() as u8
    };
    [channel(0), channel(1), channel(2), 255]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_rises_from_the_first_colour_to_the_last() {
        let colors = ColorMap::Plasma.colors();
        assert_eq!(heat(0.0)[..3], colors[0]);
        assert_eq!(heat(1.0)[..3], colors[colors.len() - 1]);
        assert_eq!(heat(f64::INFINITY), heat(1.0));
        let sum = |value| heat(value).iter().map(|&byte| u32::from(byte)).sum::<u32>();
        assert!(sum(0.1) < sum(0.5) && sum(0.5) < sum(0.9));
    }
}
