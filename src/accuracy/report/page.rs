//! The report as one HTML page that needs no other file and no network.
//!
//! Scripts, style, data and images stand in the page itself. Images are the frames as they are, where these are small enough; else they are
//! JPEG, in sizes and qualities that fit.

use std::collections::BTreeMap;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::RgbaImage;
use image::imageops::{FilterType, resize};
use rayon::prelude::*;
use serde::Serialize;

use super::ReportError;
use crate::accuracy::results::Results;
use crate::accuracy::survey::{REFERENCE, frame_file};
use crate::encode::{FrameImage, ImageFormat, encode};
use crate::markup::escaped;

/// Most bytes of all images of a page before base64 makes them a third longer; the page then stays below 20 MB.
pub const MOST_IMAGE_BYTES: u64 = 14_000_000;

/// Sizes and qualities of images, from the best: the share of the width, and JPEG's quality. FLIP maps have half the width.
const STEPS: [(f64, u8); 6] = [(1.0, 92), (1.0, 82), (0.75, 80), (0.5, 80), (0.35, 70), (0.2, 60)];

/// Images of a page as data URIs, by the folder of the pose and the slug of the row.
#[derive(Debug, Default, Serialize)]
pub struct Images {
    /// The images' form, in words.
    form: String,
    frames: BTreeMap<String, BTreeMap<String, String>>,
    flips: BTreeMap<String, BTreeMap<String, String>>,
}

/// Folder, slug, and suffix of the file.
type Key = (String, String, &'static str);

impl Images {
    /// Reads the frames of all rows that were drawn, and makes them small enough that all take at most `most` bytes if that is possible.
    ///
    /// # Errors
    /// A frame is missing or cannot be read.
    pub fn load(folder: &Path, results: &Results, most: u64) -> Result<Images, ReportError> {
        let mut keys: Vec<Key> = Vec::new();
        for scope in &results.scopes {
            let Some(pose) = &scope.folder else { continue };
            keys.push((pose.clone(), REFERENCE.to_owned(), ""));
            for entry in scope.entries.iter().filter(|entry| entry.same_as.is_none()) {
                keys.push((pose.clone(), entry.slug.clone(), ""));
                keys.push((pose.clone(), entry.slug.clone(), "-flip"));
            }
        }
        let file = |(pose, slug, suffix): &Key| folder.join(frame_file(pose, slug, suffix));
        let sizes: u64 =
            keys.iter().map(|key| file(key).metadata().map_or(0, |found| found.len())).sum();
        if sizes <= most {
            let read = |key: &Key| {
                let file = file(key);
                std::fs::read(&file).map_err(|error| ReportError::Io { file, error })
            };
            let all: Vec<Vec<u8>> = keys.par_iter().map(read).collect::<Result<_, _>>()?;
            return Ok(Images::new("the frames themselves, as PNG".to_owned(), "png", keys, &all));
        }
        let mut best = None;
        for (share, quality) in STEPS {
            let small = |key: &Key| {
                let share = if key.2.is_empty() { share } else { 0.5 * share };
                shrunk(&file(key), share, quality)
            };
            let all: Vec<Vec<u8>> = keys.par_iter().map(small).collect::<Result<_, _>>()?;
            let bytes: u64 = all.iter().map(|image| image.len() as u64).sum();
            let form = format!(
                "JPEG of quality {quality} at {:.0} % of the width; the folder frames/ has the frames themselves",
                100.0 * share
            );
            best = Some((form, all));
            if bytes <= most {
                break;
            }
        }
        let (form, all) = best.unwrap_or_default();
        Ok(Images::new(form, "jpeg", keys, &all))
    }

    fn new(form: String, kind: &str, keys: Vec<Key>, all: &[Vec<u8>]) -> Images {
        let mut images = Images { form, ..Images::default() };
        for ((pose, slug, suffix), bytes) in keys.into_iter().zip(all) {
            let uri = format!("data:image/{kind};base64,{}", STANDARD.encode(bytes));
            let of = if suffix.is_empty() { &mut images.frames } else { &mut images.flips };
            of.entry(pose).or_default().insert(slug, uri);
        }
        images
    }
}

/// The image of a PNG file as a JPEG with a share of its width.
fn shrunk(file: &Path, share: f64, quality: u8) -> Result<Vec<u8>, ReportError> {
    let bytes =
        std::fs::read(file).map_err(|error| ReportError::Io { file: file.to_owned(), error })?;
    let image = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png);
    let image = image
        .map_err(|error| ReportError::Image { file: file.to_owned(), reason: error.to_string() })?;
    let side = |side: u32| ((f64::from(side) * share).round() as u32).max(1);
    let image: RgbaImage = image.to_rgba8();
    let (width, height) = (side(image.width()), side(image.height()));
    let image =
        if share < 1.0 { resize(&image, width, height, FilterType::Triangle) } else { image };
    let rgba = image.pixels().map(|pixel| pixel.0).collect();
    let image = FrameImage::Color { width, height, rgba };
    Ok(encode(&image, ImageFormat::Jpeg, quality)?.bytes)
}

#[derive(Serialize)]
struct Data<'a> {
    results: &'a Results,
    images: &'a Images,
}

/// The page.
///
/// # Errors
/// The data cannot be written as JSON.
pub fn page(results: &Results, images: &Images) -> Result<String, ReportError> {
    // `</script>` in a name must not end the data.
    let data = serde_json::to_string(&Data { results, images })?.replace('<', "\\u003c");
    let identity = &results.identity;
    let poses = match identity.poses.len() {
        1 => "1 pose".to_owned(),
        count => format!("{count} poses"),
    };
    let measured = format!(
        "{}x{}, {poses}, each frame timed {} times in random order (seed {}), {} UTC",
        identity.width, identity.height, identity.repeats, identity.seed, results.date
    );
    Ok(filled(
        include_str!("page.html"),
        &[
            ("style", include_str!("page.css")),
            ("script", include_str!("page.js")),
            ("curve_style", include_str!("../../viewer/curve.css")),
            ("curve", include_str!("../../viewer/curve.js")),
            ("scene", &escaped(&identity.scene)),
            ("summary", &escaped(&results.summary)),
            ("adapter", &escaped(&identity.adapter)),
            ("reference", &escaped(&identity.reference)),
            ("measured", &escaped(&measured)),
            ("version", &escaped(&identity.version)),
            ("form", &escaped(&images.form)),
            ("data", &data),
        ],
    ))
}

/// The template with a text in each place `{{name}}`. Texts may hold such places themselves, which stay as they are.
fn filled(template: &str, texts: &[(&str, &str)]) -> String {
    let mut out = String::with_capacity(template.len());
    let mut rest = template;
    while let Some((before, (name, after))) =
        rest.split_once("{{").and_then(|(before, rest)| Some((before, rest.split_once("}}")?)))
    {
        out += before;
        out += texts.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| text);
        rest = after;
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;

    fn frames(folder: &Path, results: &Results) {
        let rgba: Vec<[u8; 4]> =
            (0..64 * 48u32).map(|i| [(i % 251) as u8, (i * i % 241) as u8, 9, 255]).collect();
        let image = FrameImage::Color { width: 64, height: 48, rgba };
        let png = encode(&image, ImageFormat::Png, 100).unwrap().bytes;
        for scope in results.scopes.iter().filter(|scope| scope.folder.is_some()) {
            let pose = scope.folder.as_ref().unwrap();
            let slugs = scope
                .entries
                .iter()
                .filter(|entry| entry.same_as.is_none())
                .map(|entry| entry.slug.as_str());
            for slug in slugs.chain([REFERENCE]) {
                for suffix in ["", "-flip"] {
                    let file = folder.join(frame_file(pose, slug, suffix));
                    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
                    std::fs::write(file, &png).unwrap();
                }
            }
        }
    }

    #[test]
    fn the_page_holds_everything_and_names_no_other_place() {
        let folder = tempfile::tempdir().unwrap();
        let results = results();
        frames(folder.path(), &results);
        let images = Images::load(folder.path(), &results, MOST_IMAGE_BYTES).unwrap();
        let text = page(&results, &images).unwrap();
        for expected in [
            "From 29.97 dB to 40.00 dB",
            "the reference",
            "data:image/png;base64,",
            "good-way",
            "type=\"range\"",
            "id=\"along-summary\"",
            "beaten way in frame 4",
            "<title>",
        ] {
            assert!(text.contains(expected), "{expected}");
        }
        assert!(!text.contains("{{") && !text.contains("gone <way>"));
        // The only address is the namespace of SVG.
        let rest = text.replace("http://www.w3.org/2000/svg", "");
        for outside in
            ["http:", "https:", "src=\"/", "@import", "url(", "fetch(", "XMLHttpRequest", "<link"]
        {
            assert!(!rest.contains(outside), "{outside}");
        }
        let start = text.find("id=\"data\">").unwrap() + "id=\"data\">".len();
        let data = &text[start..start + text[start..].find("</script>").unwrap()];
        let data: serde_json::Value = serde_json::from_str(data).unwrap();
        assert_eq!(data["images"]["frames"]["1-pose"].as_object().unwrap().len(), 4);
        assert_eq!(data["images"]["flips"]["2-pose"].as_object().unwrap().len(), 3);
        assert_eq!(data["results"]["scopes"][1]["refused"][0][0], "gone <way>");
    }

    #[test]
    fn images_that_are_too_large_become_smaller() {
        let folder = tempfile::tempdir().unwrap();
        let results = results();
        frames(folder.path(), &results);
        let images = Images::load(folder.path(), &results, 9_000).unwrap();
        assert!(images.form.starts_with("JPEG"), "{}", images.form);
        let all = images.frames.values().chain(images.flips.values()).flat_map(BTreeMap::values);
        let bytes: usize = all.map(|uri| uri.len() * 3 / 4).sum();
        assert!(bytes < 10_000, "{bytes}");
        std::fs::remove_file(folder.path().join(frame_file("1-pose", "good-way", ""))).unwrap();
        let error = Images::load(folder.path(), &results, 9_000).unwrap_err();
        assert!(error.to_string().contains("good-way.png"), "{error}");
    }
}
