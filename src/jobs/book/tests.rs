use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::*;
use crate::jobs::spec::tests::spec;

const SLOTS: Slots = Slots { baking: 1, drawing: 2, coding: 1 };
const LIMITS: Limits = Limits { most_unfinished: 4, most: 6, ttl_ms: 1000, slots: SLOTS };

fn book() -> Book {
    Book::new(LIMITS, [], 0)
}

fn repeat(owner: &str, key: &str, spec: &Spec) -> Option<Repeat> {
    Some(Repeat { owner: owner.to_owned(), key: key.to_owned(), fingerprint: spec.fingerprint() })
}

fn admit(book: &mut Book, scene: &str, now_ms: u64) -> JobId {
    admit_of(book, None, scene, now_ms)
}

fn admit_of(book: &mut Book, owner: Option<&str>, scene: &str, now_ms: u64) -> JobId {
    let origin = Origin { owner: owner.map(str::to_owned), request_id: None };
    match book.admit(spec(scene), origin, None, now_ms).unwrap() {
        Admitted::New(id) => id,
        Admitted::Before(id) => panic!("{id} was there before"),
    }
}

/// A `need` of jobs that lack nothing.
fn all(_: &Spec) -> Need {
    Need::Nothing
}

/// Takes the next job, which must be due for drawing.
fn draw(book: &mut Book, now_ms: u64, need: impl Fn(&Spec) -> Need) -> Option<JobId> {
    let (id, phase) = book.next(now_ms, need)?;
    assert_eq!(phase, Phase::Drawing);
    Some(id)
}

fn failed() -> Outcome {
    Outcome::Failed(Failure { kind: FailureKind::Engine, detail: "no".to_owned() })
}

/// Ends a run of a job and releases the job. Returns whether the job is still known.
fn leave(book: &mut Book, id: JobId, outcome: Outcome) -> bool {
    let is_known = book.left(id, outcome, Made { done: 3, ..Made::default() }, 3, 50);
    assert_eq!(book.release(id), !is_known && !book.is_held(id));
    is_known
}

fn ids(records: &[Record]) -> Vec<JobId> {
    records.iter().map(|record| record.id).collect()
}

#[test]
fn a_job_from_queue_to_end() {
    let mut book = book();
    let (first, second) = (admit(&mut book, "a", 10), admit(&mut book, "b", 11));
    assert_eq!((first, second), (1, 2));
    assert_eq!(draw(&mut book, 20, all), Some(first));
    assert_eq!(draw(&mut book, 20, all), Some(second), "another runner");
    assert_eq!(draw(&mut book, 20, all), None);
    assert!(leave(&mut book, first, Outcome::Done) && leave(&mut book, second, failed()));
    assert_eq!(book.get(first).unwrap().state, State::Done);
    let job = book.get(second).unwrap();
    assert_eq!((job.state.name(), job.since_ms, job.drawn, job.made.done), ("failed", 50, 3, 3));
    assert_eq!(job.expires_ms(LIMITS.ttl_ms), Some(1050));
    book.resume(first, 60).unwrap();
    book.cancel(first, 61).unwrap();
    book.resume(second, 60).unwrap();
    assert_eq!(draw(&mut book, 70, all), Some(second));
    assert!(matches!(book.resume(second, 80), Err(Refusal::State { state: "running", .. })));
    leave(&mut book, second, Outcome::Paused);
    assert_eq!(book.get(second).unwrap().state, State::Queued { waits_for: None });
    assert_eq!(book.resume(9, 80), Err(Refusal::Unknown));
}

#[test]
fn who_cancels_has_the_last_word() {
    let mut book = book();
    let id = admit(&mut book, "a", 0);
    draw(&mut book, 1, all).unwrap();
    book.cancel(id, 2).unwrap();
    book.cancel(id, 3).unwrap();
    assert_eq!(book.get(id).unwrap().since_ms, 2);
    // A job that was resumed before its runner released it goes to no other runner until then.
    book.resume(id, 4).unwrap();
    assert_eq!(draw(&mut book, 5, all), None);
    assert!(leave(&mut book, id, failed()));
    assert_eq!(book.get(id).unwrap().state, State::Queued { waits_for: None });
    assert_eq!(draw(&mut book, 6, all), Some(id));
    // The runner of a removed job learns that nothing is kept.
    book.remove(id).unwrap();
    assert!(book.is_held(id) && book.get(id).is_err());
    assert!(!book.release(id), "its runner has it, and clears up");
    assert!(!leave(&mut book, id, Outcome::Done) && !book.is_held(id));
}

#[test]
fn what_cannot_be_written_is_taken_back() {
    let mut book = book();
    let id = admit(&mut book, "a", 0);
    book.cancel(id, 1).unwrap();
    let before = book.get(id).unwrap().clone();
    book.resume(id, 2).unwrap();
    book.hold(id);
    assert_eq!(draw(&mut book, 3, all), None, "not before it is durable");
    let turn = book.get(id).unwrap().turn;
    book.restore(before.clone(), turn);
    assert_eq!(book.get(id), Ok(&before));
    // A change made meanwhile stands.
    book.resume(id, 4).unwrap();
    book.restore(before.clone(), turn);
    assert_eq!(book.get(id).unwrap().state.name(), "queued");
    assert!(!book.release(id));
    let removed = book.remove(id).unwrap();
    assert!(book.is_held(id));
    book.restore(removed.clone(), removed.turn);
    assert!(!book.release(id) && book.get(id) == Ok(&removed));
}

#[test]
fn jobs_wait_for_their_scenes_and_not_for_each_other() {
    let mut book = book();
    let (away, here) = (admit(&mut book, "away", 0), admit(&mut book, "here", 0));
    let missing = |spec: &Spec| match spec.scene.as_str() {
        "away" => Need::Missing("no scene".to_owned()),
        _ => Need::Nothing,
    };
    assert_eq!(book.note_missing(10, missing), [away]);
    assert_eq!(book.note_missing(20, missing), [] as [JobId; 0]);
    assert_eq!(
        book.get(away).unwrap().state,
        State::Queued { waits_for: Some("no scene".to_owned()) }
    );
    assert_eq!(draw(&mut book, 30, missing), Some(here));
    assert_eq!(draw(&mut book, 30, missing), None);
    assert_eq!(book.expire(1009), Expired::default());
    let expired = book.expire(1010);
    assert_eq!(expired, Expired { forgotten: vec![], failed: vec![away] });
    let State::Failed(failure) = &book.get(away).unwrap().state else { panic!() };
    assert!(
        failure.kind == FailureKind::SceneGone
            && failure.detail.contains("no scene, for 1 seconds")
    );
    book.resume(away, 1020).unwrap();
    assert_eq!(book.note_missing(1030, all), [] as [JobId; 0]);
    assert_eq!(draw(&mut book, 1040, all), Some(away));
}

#[test]
fn ended_jobs_are_forgotten_in_time() {
    let mut book = book();
    let (done, cancelled, queued) =
        (admit(&mut book, "a", 0), admit(&mut book, "a", 0), admit(&mut book, "a", 0));
    draw(&mut book, 0, all).unwrap();
    leave(&mut book, done, Outcome::Done);
    book.cancel(cancelled, 100).unwrap();
    assert_eq!(book.expire(1049).forgotten, []);
    assert_eq!(ids(&book.expire(1050).forgotten), [done]);
    assert!(book.is_held(done) && book.release(done), "who forgot it clears up");
    assert_eq!(ids(&book.expire(1100).forgotten), [cancelled]);
    // A job that can run at any time does not expire.
    assert_eq!(book.expire(u64::MAX), Expired::default());
    assert_eq!(book.all().map(|job| job.id).collect::<Vec<_>>(), [queued]);
}

#[test]
fn limits_of_the_book() {
    let mut book = book();
    let ids: Vec<JobId> = (0..4).map(|_| admit(&mut book, "a", 0)).collect();
    assert_eq!(
        book.admit(spec("a"), Origin::default(), None, 0),
        Err(Refusal::TooManyUnfinished { limit: 4 })
    );
    for &id in &ids {
        book.cancel(id, 1).unwrap();
    }
    admit(&mut book, "a", 0);
    admit(&mut book, "a", 0);
    assert_eq!(
        book.admit(spec("a"), Origin::default(), None, 0),
        Err(Refusal::TooMany { limit: 6 })
    );
    // All jobs that could make room are held.
    ids.iter().for_each(|&id| book.hold(id));
    assert_eq!(book.make_room(None, None), None);
    ids.iter().for_each(|&id| assert!(!book.release(id)));
    book.resume(ids[0], 2).unwrap();
    book.resume(ids[1], 2).unwrap();
    assert_eq!(book.resume(ids[2], 2), Err(Refusal::TooManyUnfinished { limit: 4 }));
    assert_eq!(book.get(ids[2]).unwrap().state, State::Cancelled);
}

#[test]
fn no_owner_keeps_the_others_out_of_the_queue() {
    let mut book = book();
    let of = |owner: &str| Origin { owner: Some(owner.to_owned()), request_id: None };
    let anns = [(); 2].map(|()| admit_of(&mut book, Some("ann"), "away", 0));
    let full = Err(Refusal::TooManyOfOwner { limit: 2 });
    assert_eq!(book.admit(spec("a"), of("ann"), None, 0), full);
    let bobs = admit_of(&mut book, Some("bob"), "a", 0);
    admit_of(&mut book, Some("cid"), "a", 0);
    assert_eq!(
        book.admit(spec("a"), of("bob"), None, 0),
        Err(Refusal::TooManyUnfinished { limit: 4 })
    );
    // Jobs that wait for a scene take places of their owner only.
    let missing = |spec: &Spec| match spec.scene.as_str() {
        "away" => Need::Missing("no scene".to_owned()),
        _ => Need::Nothing,
    };
    assert_eq!(book.note_missing(1, missing), anns);
    admit_of(&mut book, Some("bob"), "a", 1);
    assert_eq!(book.admit(spec("a"), of("ann"), None, 1), full);
    book.cancel(anns[0], 2).unwrap();
    book.cancel(bobs, 2).unwrap();
    admit_of(&mut book, Some("ann"), "a", 3);
    assert_eq!(book.resume(anns[0], 4), Err(Refusal::TooManyOfOwner { limit: 2 }));
}

#[test]
fn the_owner_of_most_ended_jobs_makes_room() {
    let mut book = book();
    let end = |book: &mut Book, owner: &str, now_ms: u64| {
        let id = admit_of(book, Some(owner), "a", now_ms);
        book.cancel(id, now_ms).unwrap();
        id
    };
    assert_eq!(book.make_room(Some("bob"), None), None, "there is room");
    let bobs = end(&mut book, "bob", 0);
    let anns: Vec<JobId> = (1..6).map(|now_ms| end(&mut book, "ann", now_ms)).collect();
    assert_eq!(
        book.admit(spec("a"), Origin::default(), None, 9),
        Err(Refusal::TooMany { limit: 6 })
    );
    let removed = book.make_room(Some("bob"), None).unwrap();
    assert_eq!(removed.id, anns[0]);
    assert!(book.is_held(removed.id) && book.release(removed.id), "who removed it clears up");
    let last = admit_of(&mut book, Some("bob"), "a", 9);
    assert!(book.get(bobs).is_ok() && last > bobs);
    // A request that creates no job takes no room.
    let known = repeat("bob", "k", &spec("a"));
    book.cancel(last, 9).unwrap();
    let removed = book.make_room(Some("bob"), known.as_ref()).unwrap();
    book.release(removed.id);
    let of_bob = Origin { owner: Some("bob".to_owned()), request_id: None };
    book.admit(spec("a"), of_bob, known.clone(), 9).unwrap();
    assert_eq!(book.make_room(Some("bob"), known.as_ref()), None);
}

#[test]
fn keys_name_jobs() {
    let mut book = book();
    let (one, two) = (spec("a"), spec("b"));
    assert_eq!(
        book.admit(one.clone(), Origin::default(), repeat("me", "k", &one), 0),
        Ok(Admitted::New(1))
    );
    assert_eq!(
        book.admit(one.clone(), Origin::default(), repeat("me", "k", &one), 0),
        Ok(Admitted::Before(1))
    );
    assert_eq!(
        book.admit(two.clone(), Origin::default(), repeat("me", "k", &two), 0),
        Err(Refusal::KeyReused { id: 1 })
    );
    assert_eq!(
        book.admit(one.clone(), Origin::default(), repeat("you", "k", &one), 0),
        Ok(Admitted::New(2))
    );
    assert_eq!(book.admit(one.clone(), Origin::default(), None, 0), Ok(Admitted::New(3)));
    book.remove(1).unwrap();
    assert_eq!(
        book.admit(two.clone(), Origin::default(), repeat("me", "k", &two), 0),
        Ok(Admitted::New(4))
    );
}

#[test]
fn a_new_process_goes_on() {
    let mut old = book();
    let ids: Vec<JobId> = (0..4).map(|_| admit(&mut old, "a", 0)).collect();
    old.next(1, all).unwrap();
    old.note_missing(2, |_| Need::Missing("x".to_owned()));
    old.cancel(ids[3], 3).unwrap();
    let kept: Vec<Record> = old.all().cloned().collect();
    let mut new = Book::new(LIMITS, kept, 9);
    let states: Vec<&str> = new.all().map(|job| job.state.name()).collect();
    assert_eq!(states, ["queued", "queued", "queued", "cancelled"]);
    assert!(new.all().all(|job| job.state != State::Queued { waits_for: Some("x".to_owned()) }));
    // Kept jobs run in their old order, and new ones after them, with unused ids.
    assert_eq!(admit(&mut new, "a", 4), 10);
    let turn = |new: &mut Book| {
        let id = draw(new, 5, all)?;
        leave(new, id, Outcome::Done);
        Some(id)
    };
    let turns: Vec<JobId> = std::iter::from_fn(|| turn(&mut new)).collect();
    assert_eq!(turns, [ids[0], ids[1], ids[2], 10]);
}

#[test]
fn owners_have_their_turns() {
    let mut book = Book::new(Limits { most_unfinished: 9, most: 9, ..LIMITS }, [], 0);
    let anns: Vec<JobId> = (0..4).map(|_| admit_of(&mut book, Some("ann"), "a", 0)).collect();
    assert_eq!(draw(&mut book, 1, all), Some(anns[0]));
    assert_eq!(draw(&mut book, 1, all), Some(anns[1]), "nobody else is there");
    let bobs = [(); 2].map(|()| admit_of(&mut book, Some("bob"), "a", 2));
    assert_eq!(draw(&mut book, 3, all), None, "two are drawn at a time");
    leave(&mut book, anns[0], Outcome::Done);
    assert_eq!(draw(&mut book, 4, all), Some(bobs[0]), "he has nothing at work, she has");
    leave(&mut book, anns[1], Outcome::Done);
    assert_eq!(draw(&mut book, 5, all), Some(anns[2]));
    leave(&mut book, bobs[0], Outcome::Done);
    leave(&mut book, anns[2], Outcome::Done);
    assert_eq!(draw(&mut book, 6, all), Some(anns[3]), "of equals the one that came first");
    assert_eq!(draw(&mut book, 6, all), Some(bobs[1]));
}

#[test]
fn phases_have_places_of_their_own() {
    let mut book = book();
    let need = |spec: &Spec| if spec.scene == "large" { Need::Bake } else { Need::Nothing };
    let (large, other) = (admit(&mut book, "large", 0), admit(&mut book, "large", 0));
    let (small, film) = (admit(&mut book, "a", 0), admit(&mut book, "b", 0));
    assert_eq!(book.next(1, need), Some((large, Phase::Baking)));
    assert_eq!(book.next(1, need), Some((small, Phase::Drawing)), "one bakes at a time");
    assert_eq!(book.next(1, need), Some((film, Phase::Drawing)));
    assert_eq!(book.next(1, need), None);
    // Coding frees a place for drawing, and a baked job takes it.
    leave(&mut book, large, Outcome::Next(Phase::Drawing));
    assert_eq!(book.get(large).unwrap().state, State::Running);
    leave(&mut book, film, Outcome::Next(Phase::Coding));
    assert_eq!(book.next(2, all), Some((large, Phase::Drawing)));
    assert_eq!(book.next(2, need), Some((other, Phase::Baking)));
    assert_eq!(book.next(2, |_| Need::Missing("gone".to_owned())), Some((film, Phase::Coding)));
    // A job that is cancelled between two phases runs no further phase.
    leave(&mut book, other, Outcome::Next(Phase::Drawing));
    book.cancel(other, 3).unwrap();
    leave(&mut book, small, Outcome::Done);
    assert_eq!(book.next(4, all), None);
    book.resume(other, 5).unwrap();
    assert_eq!(book.next(6, all), Some((other, Phase::Drawing)));
    // The job's scene disappears before its turn comes.
    leave(&mut book, other, Outcome::Next(Phase::Drawing));
    assert_eq!(book.note_missing(7, |_| Need::Missing("gone".to_owned())), [other]);
    assert_eq!(book.get(other).unwrap().state, State::Queued { waits_for: Some("gone".into()) });
}

/// A random operation on a book.
#[derive(Clone, Debug)]
enum Step {
    Admit(u8),
    Next,
    Leave(usize, u8),
    Bake(bool),
    Cancel(u64),
    Resume(u64),
    Remove(u64),
    Expire,
    Restart,
    Wait(u16),
    Scene(bool),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => any::<u8>().prop_map(Step::Admit),
        4 => Just(Step::Next),
        1 => any::<bool>().prop_map(Step::Bake),
        3 => (0usize..4, 0u8..7).prop_map(|(which, how)| Step::Leave(which, how)),
        2 => (1u64..10).prop_map(Step::Cancel),
        2 => (1u64..10).prop_map(Step::Resume),
        1 => (1u64..10).prop_map(Step::Remove),
        1 => Just(Step::Expire),
        1 => Just(Step::Restart),
        2 => (0u16..700).prop_map(Step::Wait),
        1 => any::<bool>().prop_map(Step::Scene),
    ]
}

proptest! {
    /// For every sequence of operations: no job has two runners, none is lost or comes back, none begins again before it is
    /// released, limits hold, ids are new, and jobs begin in the order of their turns.
    #[test]
    fn books_stay_in_order(steps in prop::collection::vec(step(), 1..120)) {
        let mut book = book();
        let mut now_ms = 0u64;
        let (mut scene, mut bakes) = (true, false);
        let mut held: Vec<(JobId, Phase)> = Vec::new();
        let mut due: BTreeMap<JobId, Phase> = BTreeMap::new();
        let mut known: BTreeSet<JobId> = BTreeSet::new();
        let mut ever: BTreeSet<JobId> = BTreeSet::new();
        for step in steps {
            let before: Vec<Record> = book.all().cloned().collect();
            match step {
                Step::Admit(key) => {
                    let asked = spec("a");
                    // Some requests are repeated.
                    let twin = (key < 100).then(|| repeat("me", &format!("{}", key % 5), &asked)).flatten();
                    let owner = [None, Some("ann"), Some("bob")][usize::from(key % 3)];
                    let origin = Origin { owner: owner.map(str::to_owned), request_id: None };
                    match book.admit(asked, origin, twin, now_ms) {
                        Ok(Admitted::New(id)) => {
                            prop_assert!(ever.insert(id));
                            known.insert(id);
                        }
                        Ok(Admitted::Before(id)) => prop_assert!(known.contains(&id)),
                        Err(Refusal::TooMany { .. }) => prop_assert_eq!(before.len(), LIMITS.most),
                        Err(Refusal::TooManyUnfinished { limit }) => {
                            let waits = |job: &&Record| matches!(job.state, State::Queued { waits_for: Some(_) });
                            let unfinished = before.iter().filter(|job| !job.has_ended() && !waits(job));
                            prop_assert!(unfinished.count() >= limit);
                        }
                        Err(Refusal::TooManyOfOwner { limit }) => {
                            let own = |job: &&Record| !job.has_ended() && job.owner.as_deref() == owner;
                            prop_assert_eq!(before.iter().filter(own).count(), limit);
                        }
                        Err(other) => prop_assert!(false, "{:?}", other),
                    }
                }
                Step::Next => {
                    let need = || match (scene, bakes) {
                        (false, _) => Need::Missing("gone".to_owned()),
                        (true, true) => Need::Bake,
                        (true, false) => Need::Nothing,
                    };
                    let found = book.next(now_ms, |_| need());
                    let busy = |phase| held.iter().filter(|(_, at)| *at == phase).count();
                    let phase = |job: &Record| {
                        let wanted = match job.state {
                            State::Queued { .. } => Phase::Drawing,
                            State::Running => *due.get(&job.id)?,
                            _ => return None,
                        };
                        let phase = match (wanted, need()) {
                            (Phase::Coding, _) => Phase::Coding,
                            (_, Need::Missing(_)) => return None,
                            (_, Need::Bake) => Phase::Baking,
                            (_, Need::Nothing) => Phase::Drawing,
                        };
                        let most = match phase { Phase::Drawing => 2, _ => 1 };
                        let is_free = held.iter().all(|(id, _)| *id != job.id) && busy(phase) < most;
                        is_free.then_some(phase)
                    };
                    let waiting: Vec<(&Record, Phase)> = before.iter().filter_map(|job| Some((job, phase(job)?))).collect();
                    prop_assert_eq!(found.is_some(), !waiting.is_empty());
                    if let Some((id, at)) = found {
                        let (job, expected) = waiting.iter().find(|(job, _)| job.id == id).unwrap();
                        prop_assert_eq!(at, *expected);
                        // No earlier job of the same owner waits for the same phase.
                        for (other, phase) in &waiting {
                            prop_assert!(other.owner != job.owner || *phase != at || other.turn >= job.turn);
                        }
                        due.remove(&id);
                        held.push((id, at));
                    }
                }
                Step::Leave(which, how) => {
                    if held.is_empty() { continue }
                    let (id, _) = held.remove(which % held.len());
                    let is_running = book.get(id).is_ok_and(|job| job.state == State::Running);
                    let phases = [Phase::Baking, Phase::Drawing, Phase::Coding];
                    let outcome = match how {
                        4.. => Outcome::Next(phases[usize::from(how - 4)]),
                        0 => Outcome::Done,
                        1 => failed(),
                        2 => Outcome::Paused,
                        _ => Outcome::Waits("gone".to_owned()),
                    };
                    if let (Outcome::Next(phase), true) = (&outcome, is_running) {
                        due.insert(id, *phase);
                    }
                    prop_assert_eq!(leave(&mut book, id, outcome), known.contains(&id));
                }
                Step::Cancel(id) => {
                    let ok = book.cancel(id, now_ms).is_ok();
                    prop_assert!(!ok || book.get(id).unwrap().state == State::Cancelled);
                    if ok { due.remove(&id); }
                }
                Step::Resume(id) => {
                    let ok = book.resume(id, now_ms).is_ok();
                    let is_queued = |job: &Record| matches!(job.state, State::Queued { .. });
                    prop_assert!(!ok || is_queued(book.get(id).unwrap()));
                }
                Step::Remove(id) => {
                    let removed = book.remove(id).is_ok();
                    prop_assert_eq!(removed, known.remove(&id));
                    if removed {
                        due.remove(&id);
                        prop_assert_eq!(book.release(id), held.iter().all(|(other, _)| *other != id));
                    }
                }
                Step::Expire => {
                    let expired = book.expire(now_ms);
                    for job in &expired.forgotten {
                        prop_assert!(before.contains(job));
                        prop_assert!(job.has_ended() && now_ms - job.since_ms >= LIMITS.ttl_ms);
                        prop_assert!(known.remove(&job.id) && held.iter().all(|(id, _)| *id != job.id));
                        prop_assert!(book.release(job.id));
                    }
                }
                Step::Restart => {
                    let last = ever.iter().max().copied().unwrap_or(0);
                    book = Book::new(LIMITS, before.clone(), last);
                    held.clear();
                    due.clear();
                    prop_assert!(book.all().all(|job| job.state != State::Running));
                }
                Step::Wait(ms) => now_ms += u64::from(ms),
                Step::Scene(there) => {
                    scene = there;
                    let need = || if scene { Need::Nothing } else { Need::Missing("gone".to_owned()) };
                    book.note_missing(now_ms, |_| need());
                    due.retain(|id, _| book.get(*id).is_ok_and(|job| job.state == State::Running));
                }
                Step::Bake(wanted) => bakes = wanted,
            }
            let ids: BTreeSet<JobId> = book.all().map(|job| job.id).collect();
            prop_assert_eq!(&ids, &known);
            for owner in ["ann", "bob"] {
                let own = |job: &&Record| !job.has_ended() && job.owner.as_deref() == Some(owner);
                prop_assert!(book.all().filter(own).count() <= LIMITS.most_unfinished_per_owner());
            }
            prop_assert!(ids.len() <= LIMITS.most);
            let running = book.all().filter(|job| job.state == State::Running).all(|job| {
                held.iter().any(|(id, _)| *id == job.id) || due.contains_key(&job.id)
            });
            prop_assert!(running, "what runs is held, or waits for its next phase");
            prop_assert!(held.iter().all(|(id, _)| book.is_held(*id)));
            for (phase, most) in [(Phase::Baking, 1), (Phase::Drawing, 2), (Phase::Coding, 1)] {
                prop_assert!(held.iter().filter(|(_, at)| *at == phase).count() <= most);
            }
        }
    }
}

#[test]
fn counts_of_a_stored_job_leave_room_for_the_next() {
    let mut before = book();
    let id = admit(&mut before, "a", 1);
    let stored = |field: &str, number: u64| {
        let mut record = serde_json::to_value(before.get(id).unwrap()).unwrap();
        record[field] = number.into();
        serde_json::from_value::<Record>(record)
    };
    for field in ["id", "turn", "drawn"] {
        assert!(stored(field, LARGEST_COUNT).is_ok(), "{field}");
        let refused = stored(field, LARGEST_COUNT + 1).unwrap_err().to_string();
        assert!(refused.contains("up to 9223372036854775807"), "{field}: {refused}");
    }
    let last = stored("turn", LARGEST_COUNT).unwrap();
    let mut book = Book::new(LIMITS, [Record { id: LARGEST_COUNT, ..last }], LARGEST_COUNT);
    assert_eq!(admit(&mut book, "b", 2), LARGEST_COUNT + 1);
    assert_eq!(draw(&mut book, 3, all), Some(LARGEST_COUNT));
}
