//! The order of the queue, refusals, and cancelled frames.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, RwLock, mpsc};
use std::time::{Duration, Instant};

use pointillist::engine::{
    Class, Client, EngineError, FrameRequest, FrameTicket, LatestSlot, Readiness, RequestId,
    ResolvedFrame,
};

use super::studio::{Studio, eventually, front, orbit};

#[test]
fn a_full_queue_refuses_and_says_when_to_come_back() {
    let studio = Studio::with(|config| {
        config.queue_capacity = 6;
        config.max_batch = 2;
    });
    studio.load_two();
    let (mut accepted, mut refused) = (Vec::new(), 0);
    for number in 0..200 {
        match studio.engine.submit(orbit("solid", number, 500)) {
            Ok(ticket) => accepted.push(ticket),
            Err(EngineError::Busy { retry_after }) => {
                assert!(retry_after >= Duration::from_millis(1), "{retry_after:?}");
                assert!(retry_after < Duration::from_secs(600), "{retry_after:?}");
                refused += 1;
            }
            Err(error) => panic!("{error}"),
        }
    }
    assert!(refused > 0 && accepted.len() >= 6);
    assert!(accepted.into_iter().all(|ticket| ticket.wait().is_ok()), "a promise is kept");
    assert_eq!(studio.engine.stats().refused, refused);
    assert_eq!(studio.engine.stats().queued, 0);
    assert!(studio.engine.submit(orbit("solid", 1, 50)).is_ok(), "there is room again");
}

#[test]
fn late_frames_are_not_drawn() {
    let studio = Studio::with_two();
    let late = FrameRequest { deadline: Some(Instant::now()), ..front("solid", 60, 60) };
    let before = studio.engine.stats();
    for _ in 0..3 {
        let reply = studio.submit(&late).wait();
        assert!(matches!(reply, Err(EngineError::DeadlineExceeded { .. })), "{reply:?}");
    }
    let after = studio.engine.stats();
    assert_eq!(after.expired - before.expired, 3);
    assert_eq!(after.frames, before.frames);
    let patient = FrameRequest {
        deadline: Some(Instant::now() + Duration::from_secs(600)),
        ..front("solid", 60, 60)
    };
    assert!(studio.submit(&patient).wait().is_ok());
}

#[test]
fn the_most_patient_of_those_who_share_a_frame_decides() {
    let studio = Studio::with_two();
    let busy = studio.keep_busy("cloud");
    // Nothing was measured yet, so the engine does not know how long these frames take.
    let soon = Instant::now() + Duration::from_millis(150);
    let hurried = FrameRequest { deadline: Some(soon), ..front("solid", 61, 60) };
    let tickets = [studio.submit(&hurried), studio.submit(&front("solid", 61, 60))];
    let [_, patient] = tickets.map(|ticket| ticket.wait());
    assert!(patient.is_ok());
    drop(busy);
}

#[test]
fn abandoned_frames_are_not_drawn() {
    const ASKED: u32 = 30;
    let studio = Studio::with_two();
    let mut cancelled = 0;
    for _ in 0..10 {
        let before = studio.engine.stats();
        let busy = studio.keep_busy("cloud");
        let blockers = busy.len() as u64;
        let kept: Vec<_> = (0..ASKED)
            .map(|number| (number, studio.submit(&orbit("solid", number, 64))))
            .filter_map(|(number, ticket)| (number % 3 == 0).then_some(ticket))
            .collect();
        assert!(kept.into_iter().all(|ticket| ticket.wait().is_ok()));
        assert!(busy.into_iter().all(|ticket| ticket.wait().is_ok()));
        // Each job is soon drawn or cancelled.
        eventually("an end of every job", || {
            let now = studio.engine.stats();
            cancelled = now.cancelled - before.cancelled;
            now.frames - before.frames + cancelled == blockers + u64::from(ASKED)
        });
        if cancelled == 20 {
            break;
        }
    }
    assert_eq!(cancelled, 20);
}

#[test]
fn draining_keeps_promises_and_makes_no_new_ones() {
    let studio = Studio::with_two();
    let tickets: Vec<_> =
        (0..12).map(|number| studio.submit(&orbit("solid", number, 300))).collect();
    let engine = studio.engine.clone();
    let draining = std::thread::spawn(move || engine.drain());
    eventually("draining", || studio.engine.readiness() == Readiness::Draining);
    let refused = studio.engine.submit(front("solid", 20, 20));
    assert!(matches!(refused, Err(EngineError::ShuttingDown)));
    for ticket in tickets {
        assert!(ticket.wait().is_ok());
    }
    draining.join().unwrap();
}

#[test]
fn dropping_the_engine_keeps_promises_too() {
    let studio = Studio::with_two();
    let tickets: Vec<_> =
        (0..6).map(|number| studio.submit(&orbit("solid", number, 200))).collect();
    drop(studio);
    assert!(tickets.into_iter().all(|ticket| ticket.wait().is_ok()));
}

fn resolved(studio: &Studio, number: u32) -> Arc<ResolvedFrame> {
    studio.engine.resolve_blocking(orbit("solid", number, 64)).unwrap()
}

fn ask(slot: &mut LatestSlot, studio: &Studio, number: u32) -> FrameTicket {
    slot.ask(RequestId::fresh(), resolved(studio, number)).unwrap()
}

fn replace(slot: &mut LatestSlot, studio: &Studio, number: u32) -> Option<FrameTicket> {
    slot.replace(RequestId::fresh(), &resolved(studio, number)).unwrap()
}

#[test]
fn a_latest_slot_draws_the_newest_and_answers_those_before() {
    let studio = Studio::with_two();
    let mut overtaken = 0;
    // The render thread may take the slot's request before it is replaced, but not ten times.
    for round in 0..10 {
        let mut slot = studio.engine.latest_slot(Client::Unnamed);
        let busy = studio.keep_busy("cloud");
        let before = studio.engine.stats();
        let mut last = ask(&mut slot, &studio, 0);
        for number in 1..20 {
            let Some(newer) = replace(&mut slot, &studio, number) else { break };
            let older = std::mem::replace(&mut last, newer).wait();
            assert!(matches!(older, Err(EngineError::Overtaken)), "{older:?}");
            overtaken += 1;
        }
        assert!(last.wait().is_ok());
        assert!(replace(&mut slot, &studio, 30).is_none(), "nothing waits");
        assert!(busy.into_iter().all(|ticket| ticket.wait().is_ok()));
        let after = studio.engine.stats();
        assert_eq!(after.overtaken, overtaken, "round {round}: from {}", before.overtaken);
        assert_eq!(after.cancelled, before.cancelled);
        if overtaken >= 19 {
            return;
        }
    }
    panic!("only {overtaken} were replaced");
}

#[test]
fn whoever_shares_an_overtaken_frame_still_gets_it() {
    let studio = Studio::with_two();
    for _ in 0..10 {
        let (mut slot, mut other) = (
            studio.engine.latest_slot(Client::Unnamed),
            studio.engine.latest_slot(Client::Unnamed),
        );
        let busy = studio.keep_busy("cloud");
        let mine = ask(&mut slot, &studio, 0);
        let shared = [studio.submit(&orbit("solid", 0, 64)), ask(&mut other, &studio, 0)];
        let replaced = replace(&mut slot, &studio, 1);
        let was_replaced = replaced.is_some();
        drop(mine);
        assert!(replaced.is_none_or(|ticket| ticket.wait().is_ok()));
        assert!(shared.into_iter().all(|ticket| ticket.wait().is_ok()));
        assert!(busy.into_iter().all(|ticket| ticket.wait().is_ok()));
        assert_eq!(studio.engine.stats().overtaken, 0, "somebody wanted it");
        if was_replaced {
            return;
        }
    }
    panic!("nothing was ever replaced");
}

#[test]
fn what_cannot_be_had_in_time_is_refused_at_once() {
    let studio = Studio::with(|config| config.max_batch = 1);
    studio.load_two();
    let waiting: Vec<_> =
        (0..30).map(|number| studio.submit(&orbit("solid", number, 1200))).collect();
    let deadline = Some(Instant::now() + Duration::from_millis(1));
    let hurried = FrameRequest { deadline, ..orbit("solid", 99, 60) };
    // Another client, because the most urgent frame of the same client would be the next one, and trying it costs nobody
    // anything.
    match studio.engine.submit_for(Client::Caller(1), hurried).err() {
        Some(EngineError::DeadlineExceeded { retry_after }) => {
            assert!(
                retry_after > Duration::from_millis(1) && retry_after < Duration::from_secs(60)
            );
        }
        other => panic!("{other:?}"),
    }
    let stats = studio.engine.stats();
    assert_eq!((stats.hopeless, stats.expired), (1, 0));
    let patient = Some(Instant::now() + Duration::from_secs(600));
    let patient = studio.submit(&FrameRequest { deadline: patient, ..orbit("solid", 98, 60) });
    assert!(patient.wait().is_ok());
    assert!(waiting.into_iter().all(|ticket| ticket.wait().is_ok()));
}

#[test]
fn requests_come_before_jobs() {
    const FRAMES: u32 = 60;
    let studio = Studio::with(|config| config.max_batch = 1);
    studio.load_two();
    let job: Vec<_> = (0..FRAMES)
        .map(|number| {
            studio.engine.submit_for(Client::Job(1), orbit("solid", number, 200)).unwrap()
        })
        .collect();
    let asked: Vec<_> =
        (100..104).map(|number| studio.submit(&orbit("solid", number, 200))).collect();
    let before = studio.engine.stats().frames;
    assert!(asked.into_iter().all(|ticket| ticket.wait().is_ok()));
    let drawn = studio.engine.stats().frames - before;
    // The four requests, the frames in flight, and a tenth of the device's time.
    assert!(drawn <= 4 + 4 + 2, "{drawn} frames were drawn before");
    assert!(job.into_iter().all(|ticket| ticket.wait().is_ok()), "and jobs after");
}

#[test]
fn a_jobs_frame_comes_forward_for_who_asks_for_the_same() {
    const FRAMES: u32 = 60;
    let studio = Studio::with(|config| config.max_batch = 1);
    studio.load_two();
    let job: Vec<_> = (0..FRAMES)
        .map(|number| {
            studio.engine.submit_for(Client::Job(1), orbit("solid", number, 200)).unwrap()
        })
        .collect();
    let same = studio.submit(&orbit("solid", FRAMES - 1, 200)).wait().unwrap();
    assert!(same.receipt.coalesced);
    let drawn = studio.engine.stats().frames;
    assert!(drawn < u64::from(FRAMES), "{drawn} frames were drawn before");
    let frames: Vec<_> = job.into_iter().map(|ticket| ticket.wait().unwrap()).collect();
    let last = &frames[frames.len() - 1].receipt;
    assert!(!last.coalesced && last.request_id != same.receipt.request_id);
    assert_eq!(studio.engine.stats().frames, u64::from(FRAMES), "none was drawn twice");
}

/// While the encoders are busy with a job's images, frames of streams and requests are drawn, encoded and answered.
#[test]
fn a_jobs_images_delay_no_other_frames() {
    const FRAMES: u32 = 40;
    let (gate, begun) = (Arc::new(RwLock::new(())), Arc::new(AtomicUsize::new(0)));
    let studio = Studio::with(|config| {
        let (gate, begun) = (gate.clone(), begun.clone());
        config.max_batch = 1;
        config.encode_hook = Some(Arc::new(move |class| {
            if class == Class::Job {
                begun.fetch_add(1, Ordering::SeqCst);
                drop(gate.read());
            }
        }));
    });
    let shut = gate.write().unwrap();
    studio.load_two();
    let job: Vec<_> = (0..FRAMES)
        .map(|number| studio.engine.submit_for(Client::Job(1), orbit("solid", number, 64)).unwrap())
        .collect();
    eventually("encoders full of images", || begun.load(Ordering::SeqCst) == 2);
    for client in [Client::Stream { of: 1, number: 1 }, Client::Caller(2)] {
        for number in 0..5 {
            let request = orbit("solid", number, 65 + client.class() as u32);
            let ticket = studio.engine.submit_for(client, request).unwrap();
            let (sender, answer) = mpsc::sync_channel(1);
            std::thread::spawn(move || sender.send(ticket.wait()));
            let answer = answer.recv_timeout(Duration::from_secs(60));
            assert!(answer.expect("the encoders wait for the job").is_ok());
        }
    }
    let stats = studio.engine.stats();
    assert_eq!((begun.load(Ordering::SeqCst), stats.frames), (2, 10));
    // Two are in encoders, four wait for them, and two may have been in flight.
    assert!(stats.queued >= u64::from(FRAMES) - 8, "{} wait to be drawn", stats.queued);
    drop(shut);
    assert!(job.into_iter().all(|ticket| ticket.wait().is_ok()));
}
