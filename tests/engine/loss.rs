//! A lost device is replaced, with all scenes.

use std::sync::atomic::{AtomicBool, Ordering};

use pointillist::engine::{EngineError, Readiness};

use super::studio::{Studio, eventually, front, orbit, same};

#[test]
fn an_idle_engine_recovers() {
    let studio = Studio::with_two();
    let requests: Vec<_> =
        (0..6).map(|number| orbit(["solid", "cloud"][number as usize % 2], number, 100)).collect();
    let before: Vec<_> = requests.iter().map(|request| studio.bytes(request)).collect();
    assert_eq!(studio.engine.readiness(), Readiness::Ready);
    let seen = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while studio.engine.stats().device_losses == 0
                || studio.engine.readiness() != Readiness::Ready
            {
                if studio.engine.readiness() == Readiness::DeviceLost {
                    seen.store(true, Ordering::Relaxed);
                }
                std::thread::yield_now();
            }
        });
        studio.engine.lose_device();
    });
    assert!(seen.load(Ordering::Relaxed), "readiness told of the loss");
    assert_eq!(studio.engine.stats().device_losses, 1);
    for (request, bytes) in requests.iter().zip(&before) {
        same(&studio.bytes(request), bytes, "after the loss");
    }
}

#[test]
fn frames_in_flight_are_drawn_again() {
    let studio = Studio::with_two();
    let requests: Vec<_> = (0..10)
        .map(|number| orbit(["solid", "cloud"][number as usize % 2], number, 400 + 30 * number))
        .collect();
    let before: Vec<_> = requests.iter().map(|request| studio.bytes(request)).collect();
    for round in 0..6u64 {
        let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
        // Lose the device at different stages of the frames.
        std::thread::sleep(std::time::Duration::from_millis(3 * round));
        studio.engine.lose_device();
        for (ticket, bytes) in tickets.into_iter().zip(&before) {
            match ticket.wait() {
                Ok(frame) => same(&frame.bytes, bytes, "drawn again"),
                Err(error) => panic!("round {round}: {error}"),
            }
        }
        eventually("the loss", || studio.engine.stats().device_losses > round);
        eventually("readiness", || studio.engine.readiness() == Readiness::Ready);
        for (request, bytes) in requests.iter().zip(&before) {
            same(&studio.bytes(request), bytes, &format!("round {round}"));
        }
    }
    // If a frame were forgotten, this would wait for ever.
    studio.engine.drain();
}

/// Frames that the device refuses, even because of its first buffers, are drawn by the next device.
#[test]
fn a_device_lost_before_its_first_frame() {
    let studio = Studio::with_two();
    let request = front("solid", 90, 70);
    let before = Studio::new();
    before.load_two();
    let bytes = before.bytes(&request);
    for round in 0..4u64 {
        studio.engine.lose_device();
        same(&studio.bytes(&request), &bytes, "from the device that came after");
        assert_eq!(studio.engine.stats().device_losses, round + 1);
    }
}

/// A submission that the driver refuses fails only its own frames, and no frame shows another's pixels.
#[test]
fn a_refused_submission_costs_its_own_frames_alone() {
    let studio = Studio::with_two();
    // The frames are so large that each is a batch by itself. Two are in flight at a time.
    let requests: Vec<_> = (0..6).map(|number| orbit("solid", number, 1100)).collect();
    let before: Vec<_> = requests.iter().map(|request| studio.bytes(request)).collect();
    for round in 0..4u64 {
        let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
        std::thread::sleep(std::time::Duration::from_millis(15 * round));
        studio.engine.spoil_next_submission();
        let mut refused = 0;
        for (ticket, bytes) in tickets.into_iter().zip(&before) {
            match ticket.wait() {
                Ok(frame) => same(&frame.bytes, bytes, "beside a refused one"),
                Err(EngineError::Internal(text)) => {
                    assert!(text.contains("larger than any"), "{text}");
                    refused += 1;
                }
                Err(error) => panic!("round {round}: {error}"),
            }
        }
        // The failure may come after all of these frames. It then hits the next one.
        assert!(refused <= 1, "{refused} frames for one submission");
        if refused == 0 {
            studio.submit(&front("cloud", 30, 30)).wait().unwrap_err();
        }
        for (request, bytes) in requests.iter().zip(&before).take(2) {
            same(&studio.bytes(request), bytes, "after a refused one");
        }
    }
}

#[test]
fn a_render_thread_that_ends_is_told() {
    let studio = Studio::with_two();
    studio.frame(&front("solid", 20, 20));
    studio.engine.break_render_thread();
    eventually("the failure", || studio.engine.readiness() == Readiness::Failed);
    let refused = studio.engine.submit(front("solid", 20, 20)).map(|_| ());
    assert!(matches!(refused, Err(EngineError::Internal(_))), "{refused:?}");
    assert_eq!(studio.engine.scenes().len(), 2);
    studio.engine.drain();
    assert_eq!(studio.engine.readiness(), Readiness::Failed);
}
