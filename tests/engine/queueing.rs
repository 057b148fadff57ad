//! Who waits, who is turned away, and who is not drawn at all.

use std::time::{Duration, Instant};

use pointillist::engine::{EngineError, FrameRequest, Readiness};

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
    let studio = Studio::new();
    studio.load_two();
    let late = FrameRequest { deadline: Some(Instant::now()), ..front("solid", 60, 60) };
    let before = studio.engine.stats();
    for _ in 0..3 {
        let reply = studio.submit(&late).wait();
        assert!(matches!(reply, Err(EngineError::DeadlineExceeded)), "{reply:?}");
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
    let studio = Studio::new();
    studio.load_two();
    let hurried = FrameRequest { deadline: Some(Instant::now()), ..front("solid", 61, 60) };
    let busy = studio.keep_busy("cloud");
    let tickets = [studio.submit(&hurried), studio.submit(&front("solid", 61, 60))];
    let [_, patient] = tickets.map(|ticket| ticket.wait());
    assert!(patient.is_ok());
    drop(busy);
}

#[test]
fn abandoned_frames_are_not_drawn() {
    const ASKED: u32 = 30;
    let studio = Studio::new();
    studio.load_two();
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
        // Every job was either drawn or cancelled, soon.
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
    let studio = Studio::new();
    studio.load_two();
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
    let studio = Studio::new();
    studio.load_two();
    let tickets: Vec<_> =
        (0..6).map(|number| studio.submit(&orbit("solid", number, 200))).collect();
    drop(studio);
    assert!(tickets.into_iter().all(|ticket| ticket.wait().is_ok()));
}

#[test]
fn a_seat_draws_the_newest_and_answers_those_before() {
    let studio = Studio::new();
    studio.load_two();
    let mut overtaken = 0;
    // The render thread may take the seat's request before it is replaced, but not ten times.
    for round in 0..10 {
        let mut seat = studio.engine.seat();
        let busy = studio.keep_busy("cloud");
        let before = studio.engine.stats();
        let mut last = seat.ask(orbit("solid", 0, 64)).unwrap();
        for number in 1..20 {
            let Some(newer) = seat.replace(orbit("solid", number, 64)).unwrap() else { break };
            let older = std::mem::replace(&mut last, newer).wait();
            assert!(matches!(older, Err(EngineError::Overtaken)), "{older:?}");
            overtaken += 1;
        }
        assert!(last.wait().is_ok());
        assert!(seat.replace(orbit("solid", 30, 64)).unwrap().is_none(), "nothing waits");
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
    let studio = Studio::new();
    studio.load_two();
    for _ in 0..10 {
        let (mut seat, mut other) = (studio.engine.seat(), studio.engine.seat());
        let busy = studio.keep_busy("cloud");
        let mine = seat.ask(orbit("solid", 0, 64)).unwrap();
        let shared =
            [studio.submit(&orbit("solid", 0, 64)), other.ask(orbit("solid", 0, 64)).unwrap()];
        let replaced = seat.replace(orbit("solid", 1, 64)).unwrap();
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
