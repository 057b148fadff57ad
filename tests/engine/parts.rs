//! Frames that are parts of a larger image fit together, whatever a scene calls for.

use std::path::Path;
use std::sync::Arc;

use pointillist::encode::ImageFormat;
use pointillist::engine::{EncodedFrame, EngineError, FrameRequest, Pose};
use pointillist::math::{Camera, Projection};
use pointillist::plan::{Edl, Effect, Given, ImagePart, Lod, Output, Reconstruct, Settings};

use super::studio::{Studio, etag, front};

const WHOLE: (u32, u32) = (320, 224);

fn scenes() -> Studio {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let studio = Studio::below(&root, |_| {});
    for name in ["town", "plaza", "textured", "glasshouse", "part", "neurons"] {
        studio.engine.load(name, &root.join(format!("{name}.json"))).unwrap();
    }
    studio
}

fn request(scene: &str, camera: &str, settings: Settings, output: Output) -> FrameRequest {
    FrameRequest {
        pose: Pose::Named(camera.to_owned()),
        settings,
        output,
        ..front(scene, WHOLE.0, WHOLE.1)
    }
}

fn part(whole: &FrameRequest, [x, y]: [u32; 2], [width, height]: [u32; 2]) -> FrameRequest {
    let of = ImagePart { width: whole.width, height: whole.height, x, y };
    let settings = Settings { part_of: Some(of), ..whole.settings };
    FrameRequest { width, height, settings, ..whole.clone() }
}

/// Pixels of an image that is drawn in parts of unequal sizes.
fn assembled(studio: &Studio, whole: &FrameRequest) -> Vec<[u8; 4]> {
    let (width, height) = (whole.width, whole.height);
    let mut pixels = vec![[0; 4]; (width * height) as usize];
    for (x, w) in [(0, 100), (100, 37), (137, width - 137)] {
        for (y, h) in [(0, 81), (81, height - 81)] {
            let bytes = drawn(studio, &part(whole, [x, y], [w, h]));
            let (own, _) = bytes.as_chunks::<4>();
            for (row, line) in own.chunks_exact(w as usize).enumerate() {
                let first = (y as usize + row) * width as usize + x as usize;
                pixels[first..first + w as usize].copy_from_slice(line);
            }
        }
    }
    pixels
}

/// A frame, after the bake that it needs.
fn frame(studio: &Studio, request: &FrameRequest) -> Arc<EncodedFrame> {
    studio.engine.resolve_blocking(request.clone()).unwrap();
    studio.frame(request)
}

fn drawn(studio: &Studio, request: &FrameRequest) -> Vec<u8> {
    frame(studio, request).bytes.to_vec()
}

/// Pixels that differ by more than this many steps in some channel.
fn differing(a: &[[u8; 4]], b: &[[u8; 4]], steps: u8) -> usize {
    let pairs = a.iter().zip(b);
    pairs.filter(|(a, b)| (0..4).any(|channel| a[channel].abs_diff(b[channel]) > steps)).count()
}

/// Corners are rounded to 1/256 pixel in each part; but for edges, parts show what the whole image shows.
#[test]
fn parts_make_up_the_whole() {
    let studio = scenes();
    // Effects that look at neighbouring pixels have none beyond a part's border.
    let plain = Settings { ao: Effect::Off, edl: Edl::Off, ..Settings::default() };
    let spt = Settings { lod: Lod::Spt, ..plain };
    let lens = Settings { aperture: 0.5.into(), ..plain };
    for (scene, camera, settings) in [
        ("town", "overview", plain),
        ("town", "street", Settings { reconstruct: Reconstruct::Splats, ..plain }),
        ("plaza", "assembly", plain),
        ("plaza", "walk", spt),
        ("textured", "front", plain),
        ("glasshouse", "corner", plain),
        ("part", "front", plain),
        ("part", "front", lens),
        ("neurons", "front", plain),
    ] {
        for output in [Output::Color, Output::Id] {
            let request = request(scene, camera, settings, output);
            let bytes = drawn(&studio, &request);
            let (whole, _) = bytes.as_chunks::<4>();
            let parts = assembled(&studio, &request);
            let steps = if output == Output::Id { 0 } else { 3 };
            let far = differing(whole, &parts, steps);
            println!("{scene}, {camera}, {output:?}: {far} of {} pixels differ", whole.len());
            assert!(far * 400 < whole.len(), "{scene} {camera} {output:?}: {far}");
        }
    }
}

/// What the engine decides for the whole image holds for each part, also where the part shows other things.
#[test]
fn parts_are_drawn_alike() {
    let studio = scenes();
    for (scene, camera) in [("town", "street"), ("plaza", "walk"), ("part", "front")] {
        let request = request(scene, camera, Settings::default(), Output::Color);
        let receipt = |request: &FrameRequest| {
            let mut receipt = serde_json::to_value(&frame(&studio, request).receipt).unwrap();
            receipt["settings"].as_object_mut().unwrap().remove("part_of");
            [receipt["settings"].take(), receipt["camera"].take()]
        };
        let whole = receipt(&request);
        for at in [[0, 0], [300, 0], [0, 204], [300, 204]] {
            assert_eq!(receipt(&part(&request, at, [20, 20])), whole, "{scene} {at:?}");
        }
    }
}

/// An image of more pixels than a frame may have, and a part of it at the far corner.
#[test]
fn images_may_be_larger_than_frames() {
    let studio = Studio::with_two();
    let camera = Camera::perspective([0.0, 0.0, 4.0].into(), [0.0; 3].into(), 45.0);
    let whole = FrameRequest { pose: Pose::Camera(camera), ..front("solid", 65536, 65536) };
    assert!(matches!(studio.engine.submit(whole.clone()), Err(EngineError::OverLimit { .. })));
    // The middle of the wall, where neighbouring parts meet: no background shines through.
    let whole = FrameRequest { output: Output::Id, ..whole };
    for at in [[32700, 32700], [32764, 32700], [32700, 32764]] {
        let bytes = studio.bytes(&part(&whole, at, [64, 64]));
        let shown = bytes.as_chunks::<4>().0.iter().filter(|word| **word != [0; 4]).count();
        assert_eq!(shown, 64 * 64, "{at:?}");
    }
    // A coarse image tells what lies in the far corner.
    let coarse = FrameRequest { width: 64, height: 64, ..whole.clone() };
    let coarse = studio.bytes(&coarse);
    let corner = coarse.as_chunks::<4>().0[64 * 64 - 1];
    let bytes = studio.bytes(&part(&whole, [65000, 65000], [64, 64]));
    assert!(bytes.as_chunks::<4>().0.iter().all(|word| *word == corner), "{corner:?}");
}

/// Effects that look at neighbouring pixels, away from a part's border; in parallel rays, eye-dome lighting counts in heights of the whole image.
#[test]
fn effects_are_those_of_the_whole_image() {
    let studio = scenes();
    let on = Settings { edl: Edl::On, ..Settings::default() };
    let parallel = Settings { projection: Some(Projection::Orthographic), ..on };
    for (scene, camera, settings) in
        [("town", "overview", on), ("town", "overview", parallel), ("textured", "front", on)]
    {
        let request = request(scene, camera, settings, Output::Color);
        let bytes = drawn(&studio, &request);
        let (whole, _) = bytes.as_chunks::<4>();
        let ([x, y], [w, h], border) = ([64, 48], [192, 128], 40);
        let bytes = drawn(&studio, &part(&request, [x, y], [w, h]));
        let (own, _) = bytes.as_chunks::<4>();
        let inner = |width: u32, at: [u32; 2]| {
            (border..h - border).flat_map(move |row| {
                (border..w - border)
                    .map(move |column| ((at[1] + row) * width + at[0] + column) as usize)
            })
        };
        let pick = |pixels: &[[u8; 4]], width, at| -> Vec<[u8; 4]> {
            inner(width, at).map(|index| pixels[index]).collect()
        };
        let [whole, own] = [pick(whole, WHOLE.0, [x, y]), pick(own, w, [0, 0])];
        let far = differing(&whole, &own, 3);
        println!("{scene}, {camera}: {far} of {} pixels differ", own.len());
        assert!(far * 200 < own.len(), "{scene}: {far}");
    }
}

/// Settings that are chosen for a goal would be chosen for each part.
#[test]
fn goals_are_refused_for_parts() {
    let studio = Studio::with_two();
    let mut request = part(&front("solid", 100, 80), [0, 0], [10, 10]);
    request.settings = Settings { part_of: request.settings.part_of, ..goal() };
    let refused = studio.engine.submit(request).err().map(|error| error.to_string());
    assert!(refused.as_ref().is_some_and(|why| why.contains("each part")), "{refused:?}");
}

fn goal() -> Settings {
    let mut given = Given::default();
    given.set_text("budget_ms", "20").unwrap();
    given.resolve().unwrap()
}

#[test]
fn parts_beyond_the_image_are_refused() {
    let studio = Studio::with_two();
    let whole = front("solid", 100, 80);
    let refused = |request: FrameRequest| match studio.engine.submit(request) {
        Err(EngineError::BadParameter { parameter, reason, .. }) => {
            assert_eq!(parameter, "part_of");
            reason
        }
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("accepted"),
    };
    assert!(refused(part(&whole, [60, 0], [41, 10])).contains("100 columns"));
    assert!(refused(part(&whole, [0, 79], [10, 2])).contains("80 rows"));
    let view = whole.clone();
    let Pose::Named(_) = &view.pose else { panic!("no camera") };
    let camera = Camera::perspective([0.0, 0.0, 4.0].into(), [0.0; 3].into(), 45.0);
    let by_view = FrameRequest { pose: Pose::View(camera.view(10, 10).unwrap()), ..whole.clone() };
    assert!(refused(part(&by_view, [0, 0], [10, 10])).contains("`proj`"));
    // Parts have entity tags of their own; the format stays what it was.
    let tags: Vec<String> = [[0, 0], [10, 0]]
        .map(|at| etag(&studio.engine, &part(&whole, at, [20, 20])).unwrap())
        .into();
    assert_ne!(tags[0], tags[1]);
    assert_eq!(whole.format, ImageFormat::Raw);
}
