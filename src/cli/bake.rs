//! `pointillist bake`: builds point trees in advance, so that the first frame of a process finds them in the cache.

use std::io::IsTerminal;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use clap::Args;
use comfy_table::{CellAlignment, Table, presets};
use serde::Serialize;

use super::local::{SceneFile, progress_bar, show_baking};
use super::out::{self, say};
use crate::bake::cache::BakeCache;
use crate::bake::external::Memory;
use crate::engine::{BakeEvent, BakeSource, BakedAsset, bake_file};

/// Options of `pointillist bake`.
#[derive(Args, Clone, Debug)]
pub struct BakeArgs {
    #[command(flatten)]
    file: SceneFile,
    /// Memory limit for building: a number of bytes, or a number with K, M or G; overrides --bake-memory-mib
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    memory: Option<u64>,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

/// Parses a size such as "512M" into bytes. K, M and G are powers of 1024, with or without "iB" or "B".
fn parse_bytes(text: &str) -> Result<u64, String> {
    let wrong = || {
        format!(
            "`{text}` is not a size; accepted: a number of bytes, or a number with K, M or G, as in 512M"
        )
    };
    let upper = text.trim().to_ascii_uppercase();
    let digits = upper.bytes().take_while(u8::is_ascii_digit).count();
    let (number, unit) = upper.split_at(digits);
    let shift = match unit.strip_suffix("IB").or(unit.strip_suffix('B')).unwrap_or(unit) {
        "" => 0,
        "K" => 10,
        "M" => 20,
        "G" => 30,
        _ => return Err(wrong()),
    };
    number.parse::<u64>().ok().and_then(|n| n.checked_mul(1 << shift)).ok_or_else(wrong)
}

/// The report in JSON.
#[derive(Serialize)]
struct Baking<'a> {
    assets: &'a [BakedAsset],
    /// Absent with --no-cache.
    cache: Option<&'a Path>,
    /// Time for reading, building and writing.
    elapsed_ns: u64,
}

/// Bakes, with a progress bar on a terminal and one line per asset elsewhere. Needs no GPU.
///
/// # Errors
/// The scene is refused, or the cache has no folder, cannot be written or is too small.
pub fn run(args: &BakeArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let began = Instant::now();
    let bar = progress_bar();
    let (path, mut config) = args.file.config(&bar)?;
    if let Some(bytes) = args.memory {
        ensure!(bytes >= Memory::LEAST, "--memory: must be at least {}M", Memory::LEAST >> 20);
        let cache = config.bake_cache.take();
        ensure!(
            cache.is_some(),
            "--memory needs a cache folder for temporary files: give --cache FOLDER"
        );
        config.bake_cache = cache.map(|cache| cache.with_bake_bytes(Some(bytes)));
    }
    let cache = config.bake_cache.as_ref();
    match cache {
        // Fail now rather than after minutes of building.
        Some(cache) => std::fs::create_dir_all(cache.folder()).with_context(|| {
            format!("--cache {}: cannot create the folder", cache.folder().display())
        })?,
        None if args.file.cache.no_cache == Some(true) => {}
        None => bail!("there is no cache folder: give --cache FOLDER"),
    }
    let lines = !std::io::stderr().is_terminal();
    let baked = bake_file(&path, &config, |event| {
        show_baking(&bar, &event);
        if let BakeEvent::Finished(asset) = event
            && lines
        {
            say!("{}", line(asset));
        }
    });
    bar.finish_and_clear();
    let assets = baked?;
    let elapsed = began.elapsed();
    let kept = cache.map_or(Ok(()), |cache| check_kept(&assets, cache));
    if args.json {
        let told = Baking {
            assets: &assets,
            cache: cache.map(BakeCache::folder),
            elapsed_ns: elapsed.as_nanos() as u64,
        };
        out::print(&(serde_json::to_string_pretty(&told)? + "\n"))?;
    } else {
        let folder = match (cache, &kept) {
            (None, _) => "kept nowhere".to_owned(),
            (Some(cache), Ok(())) => format!("kept in {}", cache.folder().display()),
            (Some(cache), Err(_)) => format!("not all kept in {}", cache.folder().display()),
        };
        out::print(&format!(
            "{}\n{:.1} MB of point trees, {folder}; {:.2} s in all\n",
            table(&assets),
            bytes(&assets) as f64 / 1e6,
            elapsed.as_secs_f64()
        ))?;
    }
    kept
}

/// # Errors
/// The trees of some asset are not in the cache.
fn check_kept(assets: &[BakedAsset], cache: &BakeCache) -> anyhow::Result<()> {
    let folder = cache.folder().display();
    for asset in assets {
        match &asset.source {
            BakeSource::NotStored { reason } => {
                bail!(
                    "--cache {folder}: cannot store the point trees of `{}`: {reason}",
                    asset.name
                )
            }
            BakeSource::TooLarge => bail!(
                "--cache-max-mib {}: the point trees of `{}` alone exceed this limit",
                cache.max_bytes() >> 20,
                asset.name
            ),
            _ => {}
        }
    }
    if bytes(assets) > cache.max_bytes() {
        bail!(
            "--cache-max-mib {}: all point trees together take {} MiB, so the first ones were deleted again; raise the limit",
            cache.max_bytes() >> 20,
            bytes(assets).div_ceil(1 << 20)
        );
    }
    Ok(())
}

fn bytes(assets: &[BakedAsset]) -> u64 {
    assets.iter().map(|asset| asset.tree.bytes + asset.triangle_bytes).sum()
}

fn nodes(asset: &BakedAsset) -> u64 {
    asset.tree.leaves + asset.tree.inner
}

fn seconds(asset: &BakedAsset) -> f64 {
    asset.elapsed_ns as f64 / 1e9
}

/// Millions of leaves built per second: samples of a cloud, or of a mesh. `None` if the tree was not built in this run.
fn built_rate(asset: &BakedAsset) -> Option<f64> {
    let is_built = !matches!(asset.source, BakeSource::Cached | BakeSource::Kept);
    is_built.then(|| asset.tree.leaves as f64 / 1e6 / seconds(asset).max(1e-9))
}

fn origin(source: &BakeSource) -> &'static str {
    match source {
        BakeSource::Cached => "cache",
        BakeSource::Kept => "memory",
        BakeSource::Stored => "built, now in the cache",
        BakeSource::Built => "built",
        BakeSource::TooLarge => "built, too large for the cache",
        BakeSource::NotStored { .. } => "built, not written",
    }
}

fn line(asset: &BakedAsset) -> String {
    let rate = built_rate(asset).map_or_else(String::new, |rate| format!(", {rate:.2} M leaves/s"));
    format!(
        "{}: {}, {} nodes, {:.2} s{rate}, {}",
        asset.name,
        super::render::contents([asset.samples, asset.triangles, 0], 0),
        nodes(asset),
        seconds(asset),
        origin(&asset.source)
    )
}

fn table(assets: &[BakedAsset]) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(["asset", "samples", "triangles", "nodes", "s", "M leaves/s", "from"]);
    for asset in assets {
        table.add_row([
            asset.name.clone(),
            asset.samples.to_string(),
            asset.triangles.to_string(),
            nodes(asset).to_string(),
            format!("{:.2}", seconds(asset)),
            built_rate(asset).map_or_else(|| "-".to_owned(), |rate| format!("{rate:.2}")),
            origin(&asset.source).to_owned(),
        ]);
    }
    for column in table.column_iter_mut().skip(1).take(5) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    format!("{table}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_understood() {
        for (text, bytes) in [
            ("77", 77),
            ("512M", 512 << 20),
            ("2g", 2 << 30),
            ("64 MiB", 0),
            ("3KiB", 3072),
            ("9B", 9),
        ] {
            assert_eq!(parse_bytes(text).unwrap_or(0), bytes, "{text}");
        }
        for text in ["", "M", "1.5G", "-3", "99999999999G", "5T5"] {
            assert!(parse_bytes(text).unwrap_err().contains("512M"), "{text}");
        }
    }
}
