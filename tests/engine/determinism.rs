//! Equal requests give equal bytes.

use pointillist::encode::ImageFormat;
use pointillist::engine::FrameRequest;
use pointillist::plan::{Lod, Output, Reconstruct, Settings};
use serde_json::json;

use super::studio::{OUTPUTS, Studio, disk_sphere, disks, front, orbit, same};

/// Requests with different sizes, scenes, poses, outputs and formats.
fn mixed() -> Vec<pointillist::engine::FrameRequest> {
    let mut requests = Vec::new();
    for (number, output) in OUTPUTS.into_iter().cycle().take(12).enumerate() {
        let scene = if number % 3 == 1 { "cloud" } else { "solid" };
        let mut request = orbit(scene, number as u32, 40 + 17 * number as u32);
        request.output = output;
        request.height += 3 * number as u32;
        if number % 5 == 4 {
            request.format = ImageFormat::Png;
        }
        requests.push(request);
    }
    requests
}

#[test]
fn the_same_request_twice_and_in_a_fresh_engine() {
    let studio = Studio::with_two();
    let requests = mixed();
    let first: Vec<Vec<u8>> = requests.iter().map(|request| studio.bytes(request)).collect();
    for (request, bytes) in requests.iter().zip(&first) {
        same(&studio.bytes(request), bytes, &format!("{request:?}"));
    }
    let fresh = Studio::new();
    fresh.load_two();
    for (request, bytes) in requests.iter().zip(&first) {
        same(&fresh.bytes(request), bytes, &format!("{request:?}"));
        assert_eq!(
            super::studio::etag(&fresh.engine, request).unwrap(),
            super::studio::etag(&studio.engine, request).unwrap()
        );
    }
}

/// Draws requests together until a batch has had `wanted` frames, twenty times at most, and compares each frame with the one that is drawn alone. Returns the largest
/// batch. Its size depends on timing. The frames do not.
fn largest_batch(studio: &Studio, busy: &str, requests: &[FrameRequest], wanted: u32) -> u32 {
    let alone: Vec<Vec<u8>> = requests.iter().map(|request| studio.bytes(request)).collect();
    let mut largest = 0;
    for _ in 0..20 {
        let busy = studio.keep_busy(busy);
        let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
        for (ticket, (request, bytes)) in tickets.into_iter().zip(requests.iter().zip(&alone)) {
            let frame = ticket.wait().unwrap();
            largest = largest.max(frame.receipt.batch_size);
            same(&frame.bytes, bytes, &format!("{request:?}"));
        }
        drop(busy);
        if largest >= wanted {
            break;
        }
    }
    largest
}

#[test]
fn a_batch_changes_no_frame() {
    for force_32_bit in [false, true] {
        let studio = Studio::with(|config| config.force_32_bit = force_32_bit);
        studio.load_two();
        let largest = largest_batch(&studio, "solid", &mixed(), 6);
        assert!(largest >= 6, "batches of {largest} at most");
    }
}

/// Frames of one kind share passes, each as a view of its own. What is rounded at random must not know which of them it is.
#[test]
fn views_that_share_passes_change_no_frame() {
    let studio = Studio::new();
    studio.write("ball.ply", disks(&disk_sphere(4000, 0.03, |_| [200, 120, 60])));
    let scene = json!({
        "assets": { "a": { "file": "ball.ply" } },
        "nodes": [{ "asset": "a" }],
        "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0] } },
    });
    studio.load_json("ball", &scene);
    for reconstruct in [
        Reconstruct::Points,
        Reconstruct::Splats,
        Reconstruct::Fuzzy,
        Reconstruct::Painted,
        Reconstruct::PullPush,
    ] {
        // Near enough for splats of many pixels, and so far that they are small parts of one.
        for side in [96, 24] {
            let requests: Vec<FrameRequest> = (0..8)
                .map(|number| {
                    let request = orbit("ball", number, side);
                    let settings = Settings { reconstruct, lod: Lod::Full, ..request.settings };
                    FrameRequest { settings, ..request }
                })
                .collect();
            let largest = largest_batch(&studio, "ball", &requests, 4);
            // Painted frames are drawn one by one.
            assert!(largest >= 4 || reconstruct == Reconstruct::Painted, "{reconstruct:?}");
        }
    }
}

#[test]
fn identical_requests_are_drawn_once() {
    const ASKED: u64 = 24;
    let studio = Studio::with_two();
    let mut request = front("solid", 300, 200);
    request.format = ImageFormat::Png;
    let expected = studio.bytes(&request);
    let mut joined = 0;
    for _ in 0..10 {
        let before = studio.engine.stats();
        let busy = studio.keep_busy("cloud");
        let blockers = busy.len() as u64;
        let tickets: Vec<_> = (0..ASKED).map(|_| studio.submit(&request)).collect();
        let frames: Vec<_> = tickets.into_iter().map(|ticket| ticket.wait().unwrap()).collect();
        for ticket in busy {
            ticket.wait().unwrap();
        }
        assert!(frames.iter().all(|frame| frame.bytes == expected));
        let after = studio.engine.stats();
        joined = after.coalesced - before.coalesced;
        assert_eq!(after.frames - before.frames, blockers + ASKED - joined);
        let told = frames.iter().filter(|frame| frame.receipt.coalesced).count() as u64;
        assert_eq!(told, joined, "receipts say who shared a frame");
        if joined == ASKED - 1 {
            break;
        }
    }
    assert_eq!(joined, ASKED - 1);
}

#[test]
fn frames_show_what_they_should() {
    // The other tests only compare frames with each other. This one looks at a frame's content.
    let studio = Studio::with_two();
    let mut request = front("solid", 64, 64);
    request.output = Output::Id;
    let ids: Vec<u32> = studio
        .bytes(&request)
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes(word.try_into().unwrap()))
        .collect();
    for id in 1..=7 {
        assert!(ids.contains(&id), "instance {id} is in view");
    }
    assert!(ids.iter().all(|id| *id <= 7));
}
