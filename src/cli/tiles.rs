//! `pointillist tiles`: draws an image that is larger than a frame can be, in parts that fit together, and writes it as one PNG file or as tiles
//! for a Deep Zoom viewer.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::Args;
use png::{BitDepth, ColorType, Encoder, SrgbRenderingIntent};

use super::frame::{DrawArgs, PoseArgs};
use super::local::{SceneArgs, progress_bar};
use super::out::say;
use crate::encode::{FrameImage, ImageFormat, encode};
use crate::engine::{Engine, FrameRequest};
use crate::plan::{ImagePart, MOST_WHOLE_PX};

/// Options of `pointillist tiles`.
#[derive(Args, Clone, Debug)]
pub struct TilesArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Image to write: NAME.png for one file, NAME.dzi for a pyramid of tiles in NAME_files/ (Deep Zoom)
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    draw: DrawArgs,
    /// Side of a tile of NAME.dzi in pixels, without its border
    #[arg(long, value_name = "PX", default_value_t = 510, value_parser = clap::value_parser!(u32).range(64..=4096))]
    tile: u32,
}

/// Sides of the frames that are drawn, where limits allow them.
const FRAME_PX: [u32; 2] = [2048, 1024];
/// What is drawn around each and cut off again: effects look at neighbouring pixels, and pull-push at squares of powers of two, which begin at multiples
/// of this.
const MARGIN_PX: u32 = 64;
/// Pixels that neighbouring tiles share on each side, as viewers expect it.
const OVERLAP_PX: u32 = 1;

/// Draws the image and writes it.
///
/// # Errors
/// The scene, pose or size is refused, there is no GPU, or a file cannot be written.
pub fn run(args: TilesArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let request = args.draw.request(args.pose.pose(args.scene.up()))?;
    let (width, height) = (request.width, request.height);
    ensure!(
        width.max(height) <= MOST_WHOLE_PX,
        "--size: {width}x{height} is too large; accepted: up to {MOST_WHOLE_PX} pixels a side"
    );
    ensure!(!request.settings.is_part(), "--part-of: this command chooses the parts itself");
    ensure!(
        request.settings.goal().is_none(),
        "--budget-ms, --min-psnr-db: settings would be chosen anew for each part of the image; \
         name settings instead, such as --lod, --reconstruct and --antialias"
    );
    let is_pyramid = match args.file.extension().and_then(|extension| extension.to_str()) {
        Some("png") => false,
        Some("dzi") => true,
        _ => bail!("{}: the name ends neither with .png nor with .dzi", args.file.display()),
    };
    super::out::check_place(&args.file)?;
    let (engine, _) = args.scene.load_and_warn()?;
    let limits = engine.limits();
    let parts = request.settings.parts();
    let exposures = request.clone().with_blur_decided().settings.exposures();
    let pixels = most_pixels([limits.max_pixels, limits.max_exposed_pixels], parts, exposures);
    let step = step_within(pixels, limits.max_side / parts).context(
        "the limits of frames leave no room for parts; raise --max-pixels or --max-side, or lower --blur-samples",
    )?;
    ensure!(
        !is_pyramid || args.tile + 2 * OVERLAP_PX <= step[0].min(step[1]),
        "--tile: {} is too large within the limits of frames; accepted: up to {}",
        args.tile,
        step[0].min(step[1]) - 2 * OVERLAP_PX
    );
    let size = [request.width, request.height];
    let whole = Whole { engine: &engine, request: &request, size };
    super::path::bake(&engine, &whole.part([0, 0], [1, 1]))?;
    match is_pyramid {
        true => write_pyramid(&whole, &args.file, args.tile, step),
        false => write_png(&whole, &args.file, step),
    }
}

/// Most pixels of a frame whose pixels have `parts` parts a side, and which is the mean of so many exposures. The limits are those of an exposure and of
/// all exposures.
fn most_pixels([one, all]: [u64; 2], parts: u32, exposures: u32) -> u64 {
    one.min(all / u64::from(exposures.max(1))) / u64::from(parts * parts)
}

/// Largest sides of parts whose frames, with what is around them, have at most `pixels` pixels and `side` a side.
fn step_within(pixels: u64, side: u32) -> Option<[u32; 2]> {
    // What is around begins at a multiple of the margin.
    let around = 3 * MARGIN_PX;
    let (wide, high) = (FRAME_PX[0].min(side), FRAME_PX[1].min(side));
    // Nearly square where there are few.
    let width = u64::from(wide).min(pixels.isqrt().max(pixels / u64::from(high).max(1)));
    let height = u64::from(high).min(pixels / width.max(1));
    let step = [width, height].map(|side| (side as u32).saturating_sub(around));
    (step[0] >= MARGIN_PX && step[1] >= MARGIN_PX).then_some(step)
}

/// An image, drawn part by part.
#[derive(Clone, Copy)]
struct Whole<'a> {
    engine: &'a Engine,
    request: &'a FrameRequest,
    size: [u32; 2],
}

/// Pixels of a part, RGBA with straight alpha, row by row.
struct Sheet {
    at: [u32; 2],
    size: [u32; 2],
    rgba: Vec<[u8; 4]>,
}

impl Whole<'_> {
    fn part(&self, [x, y]: [u32; 2], [width, height]: [u32; 2]) -> FrameRequest {
        let part = ImagePart { width: self.size[0], height: self.size[1], x, y };
        let mut request =
            FrameRequest { width, height, format: ImageFormat::Raw, ..self.request.clone() };
        request.settings = request.settings.as_part(part);
        request
    }

    /// Draws a part with what is around it, and cuts that off.
    fn sheet(&self, at: [u32; 2], size: [u32; 2]) -> anyhow::Result<Sheet> {
        let [begin, end]: [[u32; 2]; 2] = [
            std::array::from_fn(|axis| at[axis].saturating_sub(MARGIN_PX) / MARGIN_PX * MARGIN_PX),
            std::array::from_fn(|axis| (at[axis] + size[axis] + MARGIN_PX).min(self.size[axis])),
        ];
        let drawn = [end[0] - begin[0], end[1] - begin[1]];
        let frame = self.engine.submit(self.part(begin, drawn))?.wait()?;
        let (pixels, _) = frame.bytes.as_chunks::<4>();
        ensure!(
            pixels.len() == (drawn[0] * drawn[1]) as usize,
            "a frame of another size was drawn"
        );
        let rows = pixels.chunks_exact(drawn[0] as usize).skip((at[1] - begin[1]) as usize);
        let from = (at[0] - begin[0]) as usize;
        let rgba = rows.take(size[1] as usize).flat_map(|row| &row[from..from + size[0] as usize]);
        Ok(Sheet { at, size, rgba: rgba.copied().collect() })
    }

    /// The places and sizes of parts that cover the image, row by row; each is drawn as one frame.
    fn sheets(&self, step: [u32; 2]) -> impl Iterator<Item = ([u32; 2], [u32; 2])> {
        let [width, height] = self.size;
        let rows = (0..height).step_by(step[1] as usize);
        rows.flat_map(move |y| {
            (0..width)
                .step_by(step[0] as usize)
                .map(move |x| ([x, y], [step[0].min(width - x), step[1].min(height - y)]))
        })
    }
}

/// Writes one file, which takes its name when it is complete.
fn write_png(whole: &Whole, path: &Path, step: [u32; 2]) -> anyhow::Result<()> {
    let [width, height] = whole.size;
    let unwritable = || format!("{} cannot be written", path.display());
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let file = tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new(".")))
        .with_context(unwritable)?;
    let mut encoder = Encoder::new(BufWriter::new(file.as_file()), width, height);
    encoder.set_color(ColorType::Rgba);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_source_srgb(SrgbRenderingIntent::RelativeColorimetric);
    let mut header = encoder.write_header()?;
    let mut stream = header.stream_writer()?;
    let sheets: Vec<_> = whole.sheets(step).collect();
    let bar = progress_bar();
    bar.set_message("drawing");
    let mut drawn = 0;
    for row in sheets.chunk_by(|a, b| a.0[1] == b.0[1]) {
        let rows = row[0].1[1] as usize;
        let mut band = vec![[0u8; 4]; width as usize * rows];
        for &(at, size) in row {
            let sheet = whole.sheet(at, size)?;
            for (y, line) in sheet.rgba.chunks_exact(size[0] as usize).enumerate() {
                let first = y * width as usize + at[0] as usize;
                band[first..first + line.len()].copy_from_slice(line);
            }
            drawn += 1;
            bar.set_position(1000 * drawn / sheets.len() as u64);
        }
        stream.write_all(band.as_flattened())?;
    }
    stream.finish()?;
    header.finish()?;
    file.persist(path).with_context(unwritable)?;
    bar.finish_and_clear();
    let parts = if drawn == 1 { "part" } else { "parts" };
    say!("{}: {width} × {height} pixels in {drawn} {parts}", path.display());
    Ok(())
}

/// The sizes of a Deep Zoom pyramid, from one pixel to the whole image; each is half the next, rounded up.
fn levels(size: [u32; 2]) -> Vec<[u32; 2]> {
    let mut levels = vec![size];
    while let Some(last) = levels.last().filter(|size| size[0].max(size[1]) > 1) {
        levels.push(last.map(|side| side.div_ceil(2)));
    }
    levels.reverse();
    levels
}

fn write_pyramid(whole: &Whole, path: &Path, tile: u32, step: [u32; 2]) -> anyhow::Result<()> {
    let size = whole.size;
    let stem = path.file_stem().context("the image has no name")?.to_string_lossy();
    let folder = path.with_file_name(format!("{stem}_files"));
    let unwritable = |path: &Path| format!("{} cannot be written", path.display());
    remove_levels(&folder)?;
    // Whole tiles for each frame.
    let step = step.map(|side| (side - 2 * OVERLAP_PX) / tile * tile);
    let levels = levels(size);
    let of = |size| Whole { size, ..*whole };
    let all: usize = levels.iter().map(|&size| of(size).sheets(step).count()).sum();
    let bar = progress_bar();
    bar.set_message("drawing");
    let (mut drawn, mut files) = (0, 0);
    for (level, &size) in levels.iter().enumerate() {
        let whole = of(size);
        let place = folder.join(level.to_string());
        std::fs::create_dir_all(&place).with_context(|| unwritable(&place))?;
        for (at, net) in whole.sheets(step) {
            // With the border that the outer tiles share with their neighbours.
            let begin = at.map(|side| side.saturating_sub(OVERLAP_PX));
            let end: [u32; 2] =
                std::array::from_fn(|axis| (at[axis] + net[axis] + OVERLAP_PX).min(size[axis]));
            let sheet = whole.sheet(begin, [end[0] - begin[0], end[1] - begin[1]])?;
            for y in (at[1]..at[1] + net[1]).step_by(tile as usize) {
                for x in (at[0]..at[0] + net[0]).step_by(tile as usize) {
                    let file = place.join(format!("{}_{}.png", x / tile, y / tile));
                    let image = sheet.tile([x, y], tile, size);
                    let encoded = encode(&image, ImageFormat::Png, 100)?;
                    std::fs::write(&file, &encoded.bytes).with_context(|| unwritable(&file))?;
                    files += 1;
                }
            }
            drawn += 1;
            bar.set_position(1000 * drawn as u64 / all as u64);
        }
    }
    std::fs::write(path, description(size, tile)).with_context(|| unwritable(path))?;
    bar.finish_and_clear();
    say!(
        "{}: {} × {} pixels, {} levels, {files} tiles in {}",
        path.display(),
        size[0],
        size[1],
        levels.len(),
        folder.display()
    );
    Ok(())
}

/// Removes the tiles of an earlier run. A folder with anything else stays, and is an error.
fn remove_levels(folder: &Path) -> anyhow::Result<()> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name();
        let is_level = name.to_string_lossy().bytes().all(|c| c.is_ascii_digit());
        ensure!(
            is_level && entry.path().is_dir(),
            "{}: {} is no level of an image; remove it, or give the image another name",
            folder.display(),
            name.to_string_lossy()
        );
    }
    std::fs::remove_dir_all(folder)
        .with_context(|| format!("{} cannot be emptied", folder.display()))
}

impl Sheet {
    /// A tile with its border, as far as the image reaches.
    fn tile(&self, [x, y]: [u32; 2], tile: u32, image: [u32; 2]) -> FrameImage {
        let span = |first: u32, axis: usize| {
            let begin = first.saturating_sub(OVERLAP_PX);
            let end = (first + tile + OVERLAP_PX).min(image[axis]);
            (
                (begin - self.at[axis]) as usize,
                (end - begin).min(self.at[axis] + self.size[axis] - begin),
            )
        };
        let ((left, width), (top, height)) = (span(x, 0), span(y, 1));
        let rows = self.rgba.chunks_exact(self.size[0] as usize).skip(top).take(height as usize);
        let rgba = rows.flat_map(|row| row[left..left + width as usize].iter().copied()).collect();
        FrameImage::Color { width, height, rgba }
    }
}

/// The file that describes a pyramid (Microsoft, Deep Zoom File Format, 2008).
fn description([width, height]: [u32; 2], tile: u32) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Image xmlns=\"http://schemas.microsoft.com/deepzoom/2008\" TileSize=\"{tile}\" Overlap=\"{OVERLAP_PX}\" Format=\"png\">\n  <Size Width=\"{width}\" Height=\"{height}\"/>\n</Image>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_keep_within_limits() {
        assert_eq!(step_within(1 << 24, 8192), Some([2048 - 192, 1024 - 192]));
        for (pixels, side) in [(200_000, 8192), (150_000, 500), (1 << 20, 2048), (1 << 24, 300)] {
            let [width, height] = step_within(pixels, side).unwrap().map(|side| side + 192);
            assert!(
                u64::from(width * height) <= pixels && width.max(height) <= side,
                "{pixels} {side}"
            );
        }
        assert_eq!(step_within(60_000, 8192), None);
        assert_eq!(step_within(1 << 24, 200), None);
    }

    #[test]
    fn parts_with_exposures_keep_within_the_limit_of_all_exposures() {
        let limits = [1 << 24, 1 << 28];
        for (parts, exposures) in [(1, 1), (2, 1), (4, 1), (1, 32), (2, 64), (1, 256), (4, 256)] {
            let pixels = most_pixels(limits, parts, exposures);
            let drawn = pixels * u64::from(parts * parts);
            assert!(drawn <= limits[0] && drawn * u64::from(exposures) <= limits[1], "{parts}");
            let [width, height] = step_within(pixels, 8192).unwrap().map(|side| side + 192);
            assert!(u64::from(width * height) <= pixels, "{parts} {exposures}");
        }
        assert_eq!(most_pixels(limits, 2, 64), 1 << 20);
    }

    #[test]
    fn levels_halve_down_to_one_pixel() {
        assert_eq!(levels([5, 3]), [[1, 1], [2, 1], [3, 2], [5, 3]]);
        assert_eq!(levels([1, 1]), [[1, 1]]);
        assert_eq!(levels([65536, 1]).len(), 17);
    }

    #[test]
    fn tiles_overlap_by_a_pixel_and_end_with_the_image() {
        let image = [7, 5];
        let rgba = (0..35u8).map(|i| [i; 4]).collect();
        let sheet = Sheet { at: [0, 0], size: image, rgba };
        let of = |at: [u32; 2]| match sheet.tile(at, 4, image) {
            FrameImage::Color { width, height, rgba } => {
                (width, height, rgba[0][0], rgba[rgba.len() - 1][0])
            }
            _ => panic!("no colours"),
        };
        assert_eq!(of([0, 0]), (5, 5, 0, 32));
        assert_eq!(of([4, 0]), (4, 5, 3, 34));
        assert_eq!(of([4, 4]), (4, 2, 24, 34));
    }
}
