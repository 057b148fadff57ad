use std::collections::HashMap;

use super::*;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

#[derive(Clone, Debug, PartialEq)]
struct Job {
    number: usize,
    client: Client,
    abandoned: bool,
    deadline: Option<Instant>,
    pixels: u64,
}

impl Waiting for Job {
    fn is_abandoned(&self) -> bool {
        self.abandoned
    }
    fn deadline(&self) -> Option<Instant> {
        self.deadline
    }
    fn pixels(&self) -> u64 {
        self.pixels
    }
}

fn job(client: Client, number: usize, pixels: u64) -> Job {
    Job { number, client, abandoned: false, deadline: None, pixels }
}

fn client(number: u64) -> Client {
    match number % 3 {
        0 => Client::Job(number),
        1 => Client::Caller(number),
        _ => stream_of(number),
    }
}

fn stream_of(number: u64) -> Client {
    Client::Stream { of: number, number }
}

fn queue(capacity: usize) -> Queue<Job> {
    Queue::new(Shares { capacity, capacity_ns: u64::MAX, jobs: 0.1, batch_ns: BATCH_NS })
}

/// Jobs that an idle device is asked to take.
fn idle(now: Instant) -> Moment {
    Moment {
        now,
        flying_ns: 0,
        are_jobs_flying: false,
        are_streams_open: false,
        are_jobs_held: false,
    }
}

fn taken(queue: &mut Queue<Job>, max: usize) -> Taken<Job> {
    queue.take(max, idle(Instant::now()))
}

fn admit(queue: &mut Queue<Job>, client: Client, number: usize, cost_ns: u64) -> bool {
    queue.admit(client, job(client, number, 1), cost_ns, Instant::now()).0.is_ok()
}

const MS: u64 = 1_000_000;

/// Cases are the same on every machine.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, rng_seed: RngSeed::Fixed(0x51ea_0001), ..ProptestConfig::default() }
}

#[derive(Clone, Debug)]
enum Step {
    Admit {
        client: u64,
        abandoned: bool,
        deadline: u8,
        pixels: u64,
    },
    /// A waiting job of a client, by its place among them.
    Replace {
        client: u64,
        place: usize,
        pixels: u64,
    },
    Remove {
        client: u64,
        place: usize,
    },
    /// Another client takes the job over.
    HandOver {
        client: u64,
        place: usize,
        to: u64,
    },
    Take {
        flying: bool,
    },
    /// The last batch was drawn, and took so many times what was estimated.
    Settle {
        percent: u64,
    },
    /// The last batch comes back.
    PutBack,
}

fn step() -> impl Strategy<Value = Step> {
    let client = 0u64..6;
    prop_oneof![
        6 => (client.clone(), any::<bool>(), 0u8..3, 1u64..600_000).prop_map(|(client, gone, deadline, pixels)| {
            Step::Admit { client, abandoned: gone && deadline == 0, deadline, pixels }
        }),
        3 => (client.clone(), 0usize..3, 1u64..600_000)
            .prop_map(|(client, place, pixels)| Step::Replace { client, place, pixels }),
        1 => (client.clone(), 0usize..3).prop_map(|(client, place)| Step::Remove { client, place }),
        1 => (client.clone(), 0usize..3, client).prop_map(|(client, place, to)| Step::HandOver { client, place, to }),
        4 => any::<bool>().prop_map(|flying| Step::Take { flying }),
        2 => (0u64..400).prop_map(|percent| Step::Settle { percent }),
        1 => Just(Step::PutBack),
    ]
}

/// A queue with everything that should be in it.
struct Model {
    queue: Queue<Job>,
    now: Instant,
    capacity: usize,
    /// Waiting jobs of each client.
    lanes: HashMap<Client, Vec<usize>>,
    /// Jobs that were taken last and neither drawn nor put back.
    last: Vec<Granted<Job>>,
    returned: Vec<usize>,
    handed_over: usize,
    admitted: Vec<usize>,
    out: Vec<usize>,
}

impl Model {
    fn new(capacity: usize) -> Self {
        Self {
            queue: queue(capacity),
            now: Instant::now() + Duration::from_secs(10),
            capacity,
            lanes: HashMap::new(),
            last: Vec::new(),
            returned: Vec::new(),
            handed_over: 0,
            admitted: Vec::new(),
            out: Vec::new(),
        }
    }

    fn waiting(&self, client: Client, place: usize) -> Option<usize> {
        self.lanes.get(&client)?.get(place).copied()
    }

    fn gone(&mut self, number: usize) {
        self.lanes.values_mut().for_each(|lane| lane.retain(|other| *other != number));
        self.returned.retain(|other| *other != number);
        self.out.push(number);
    }

    fn step(&mut self, number: usize, step: Step, max: usize) -> Result<(), TestCaseError> {
        let now = self.now;
        match step {
            Step::Admit { client: who, abandoned, deadline, pixels } => {
                let who = client(who);
                let deadline = match deadline {
                    0 => None,
                    1 => Some(now - Duration::from_secs(1)),
                    _ => Some(now + Duration::from_secs(1)),
                };
                let job = Job { number, client: who, abandoned, deadline, pixels };
                let (result, dropped) = self.queue.admit(who, job.clone(), pixels * 50, now);
                prop_assert!(dropped.iter().all(|job| job.abandoned));
                dropped.into_iter().for_each(|job| self.gone(job.number));
                match result {
                    Ok(()) => {
                        self.admitted.push(number);
                        self.lanes.entry(who).or_default().push(number);
                    }
                    Err(back) => {
                        prop_assert_eq!(back, job);
                        prop_assert!(self.queue.len() >= self.capacity.div_ceil(2));
                    }
                }
            }
            Step::Replace { client: who, place, pixels } => {
                let (who, before) = (client(who), self.queue.len());
                let old = self.waiting(who, place);
                let new = Job { number, client: who, abandoned: false, deadline: None, pixels };
                let found =
                    self.queue.replace(who, |job| Some(job.number) == old, new, pixels * 50);
                match (old, found) {
                    (Some(old), Ok(found)) => {
                        prop_assert_eq!(found.number, old);
                        self.gone(old);
                        self.admitted.push(number);
                        self.lanes.entry(who).or_default().push(number);
                    }
                    (None, Err(back)) => prop_assert_eq!(back.number, number),
                    other => prop_assert!(false, "{other:?}"),
                }
                prop_assert_eq!(self.queue.len(), before);
            }
            Step::Remove { client: who, place } => {
                let who = client(who);
                let old = self.waiting(who, place);
                let removed = self.queue.remove(who, |job| Some(job.number) == old);
                prop_assert_eq!(removed.map(|job| job.number), old);
                old.into_iter().for_each(|old| self.gone(old));
            }
            Step::HandOver { client: who, place, to } => {
                let (who, to) = (client(who), client(to));
                let old = self.waiting(who, place);
                let Some(job) = self.queue.remove(who, |job| Some(job.number) == old) else {
                    return Ok(());
                };
                self.lanes.entry(who).or_default().retain(|other| *other != job.number);
                self.lanes.entry(to).or_default().insert(0, job.number);
                let cost_ns = job.pixels * 50;
                self.queue.hand_over(to, Job { client: to, ..job }, cost_ns, now);
                self.handed_over += 1;
            }
            Step::Settle { percent } => {
                for granted in std::mem::take(&mut self.last) {
                    let measured_ns = granted.cost_ns * percent / 100;
                    self.queue.settle(granted.client, granted.cost_ns, measured_ns);
                }
            }
            Step::PutBack => {
                let last = std::mem::take(&mut self.last);
                for granted in &last {
                    self.out.retain(|number| *number != granted.job.number);
                    if granted.client.class() == Class::Job {
                        let lane = self.lanes.entry(granted.client).or_default();
                        lane.push(granted.job.number);
                    } else {
                        self.returned.push(granted.job.number);
                    }
                }
                self.queue.put_back(last, now);
            }
            Step::Take { flying } => self.take(flying, max)?,
        }
        let returned = self.returned.len() + self.handed_over;
        prop_assert!(self.queue.len() <= 3 * self.capacity + 2 * max + returned);
        prop_assert!(self.queue.first.accounts() + self.queue.jobs.accounts() <= 6);
        let waiting: usize = self.lanes.values().map(Vec::len).sum();
        prop_assert_eq!(self.queue.len(), waiting + self.returned.len());
        Ok(())
    }

    fn take(&mut self, flying: bool, max: usize) -> Result<(), TestCaseError> {
        let moment =
            Moment { flying_ns: u64::from(flying), are_jobs_flying: flying, ..idle(self.now) };
        let before = self.queue.len();
        let taken = self.queue.take(max, moment);
        let batch = &taken.batch;
        prop_assert!(batch.len() <= max);
        let jobs: u64 = batch.iter().map(|granted| granted.job.pixels).sum();
        prop_assert!(batch.len() <= 1 || jobs <= BATCH_PIXELS);
        let is_alive = |job: &Job| !job.abandoned && job.deadline.is_none_or(|d| d > self.now);
        prop_assert!(batch.iter().all(|granted| is_alive(&granted.job)));
        let of_jobs = batch.iter().filter(|granted| granted.client.class() == Class::Job).count();
        prop_assert!(of_jobs == 0 || of_jobs == batch.len(), "sides do not mix");
        prop_assert!(
            before == 0 || flying || taken_any(&taken),
            "work is done while there is some"
        );
        let drawn = taken.batch.iter().map(|granted| granted.job.number);
        let others = taken.expired.iter().chain(&taken.abandoned).map(|job| job.number);
        let gone: Vec<usize> = drawn.chain(others).collect();
        gone.into_iter().for_each(|number| self.gone(number));
        self.last = taken.batch;
        Ok(())
    }
}

fn taken_any(taken: &Taken<Job>) -> bool {
    !(taken.batch.is_empty() && taken.expired.is_empty() && taken.abandoned.is_empty())
}

proptest! {
    #![proptest_config(config(400))]
    #[test]
    fn no_job_is_lost_or_doubled_and_memory_is_bounded(
        capacity in 1usize..20,
        max in 1usize..9,
        steps in prop::collection::vec(step(), 1..150),
    ) {
        let mut model = Model::new(capacity);
        for (number, step) in steps.into_iter().enumerate() {
            model.step(number, step, max)?;
        }
        let Model { mut queue, mut out, mut admitted, .. } = model;
        out.extend(queue.drain().into_iter().map(|job| job.number));
        prop_assert!(queue.is_empty());
        prop_assert_eq!((queue.first.cost_ns(), queue.jobs.cost_ns(), queue.returned_ns), (0, 0, 0));
        out.sort_unstable();
        admitted.sort_unstable();
        prop_assert_eq!(out, admitted);
    }
}

fn numbers(taken: &Taken<Job>) -> Vec<usize> {
    taken.batch.iter().map(|granted| granted.job.number).collect()
}

#[test]
fn what_is_put_back_comes_first_and_in_order() {
    let mut queue = queue(2);
    for number in [1, 2] {
        assert!(admit(&mut queue, Client::Unnamed, number, MS));
    }
    let batch = taken(&mut queue, 8).batch;
    assert!(admit(&mut queue, stream_of(0), 3, MS));
    queue.put_back(batch, Instant::now());
    assert_eq!(numbers(&taken(&mut queue, 8)), [1, 2, 3]);
}

#[test]
fn frames_of_jobs_that_are_put_back_go_before_no_others() {
    let mut queue = queue(8);
    for number in [1, 2, 3] {
        assert!(admit(&mut queue, Client::Job(0), number, MS));
    }
    let batch = taken(&mut queue, 2).batch;
    assert!(admit(&mut queue, stream_of(0), 9, MS));
    queue.put_back(batch, Instant::now());
    assert_eq!(numbers(&taken(&mut queue, 8)), [9]);
    assert_eq!(numbers(&taken(&mut queue, 8)), [1, 2, 3]);
}

#[test]
fn clients_share_time_and_keep_their_order() {
    let mut queue = queue(16);
    let [a, b, c] = [Client::Caller(1), Client::Caller(2), stream_of(3)];
    for (who, number, cost) in [
        (a, 10, 6),
        (a, 11, 6),
        (a, 12, 6),
        (b, 20, 2),
        (b, 21, 2),
        (b, 22, 2),
        (b, 23, 2),
        (c, 30, 5),
    ] {
        assert!(admit(&mut queue, who, number, cost * MS));
    }
    // The stream before those that have had as little; then who has had the least; nobody more than another has.
    assert_eq!(numbers(&taken(&mut queue, 16)), [30, 10, 20, 21, 22]);
    assert_eq!(numbers(&taken(&mut queue, 16)), [11, 23]);
}

#[test]
fn what_was_measured_counts() {
    let mut queue = queue(16);
    let [a, b] = [Client::Caller(1), Client::Caller(2)];
    for number in 0..4 {
        assert!(
            admit(&mut queue, a, number, 10 * MS) && admit(&mut queue, b, 10 + number, 10 * MS)
        );
    }
    let order = |queue: &mut Queue<Job>| {
        let taken = taken(queue, 1);
        let granted = &taken.batch[0];
        // One takes three times what was thought.
        let measured_ns = if granted.client == a { 30 * MS } else { 10 * MS };
        queue.settle(granted.client, granted.cost_ns, measured_ns);
        granted.client == a
    };
    let drawn: Vec<bool> = (0..5).map(|_| order(&mut queue)).collect();
    assert_eq!(drawn, [true, false, false, false, true]);
}

#[test]
fn the_nearest_deadline_of_a_client_is_first() {
    let mut queue = queue(16);
    let (who, now) = (Client::Caller(1), Instant::now());
    for (number, ms) in [(1, None), (2, Some(900)), (3, Some(300)), (4, None), (5, Some(90_000))] {
        let deadline = ms.map(|ms| now + Duration::from_millis(ms));
        let job = Job { deadline, ..job(who, number, 1) };
        assert!(queue.admit(who, job, MS, now).0.is_ok());
    }
    // A deadline far off is none.
    assert_eq!(numbers(&queue.take(16, idle(now))), [3, 2, 1, 4, 5]);
    assert!(admit(&mut queue, who, 6, MS));
    let later = now + Duration::from_secs(6);
    let urgent = Job { deadline: Some(later + Duration::from_millis(1)), ..job(who, 7, 1) };
    assert!(queue.admit(who, urgent, MS, later).0.is_ok());
    assert_eq!(numbers(&queue.take(16, idle(later))), [6, 7], "patience ends");
}

#[test]
fn a_replaced_job_keeps_its_turn() {
    let mut queue = queue(16);
    let [a, b] = [1, 2].map(stream_of);
    assert!(admit(&mut queue, a, 1, 9 * MS) && admit(&mut queue, b, 2, 9 * MS));
    let old = queue.replace(a, |old| old.number == 1, job(a, 3, 1), 9 * MS).unwrap();
    assert_eq!(old.number, 1);
    let first = numbers(&taken(&mut queue, 1));
    assert!(first == [3] || first == [2]);
    assert_eq!(numbers(&taken(&mut queue, 1)), [5 - first[0]]);
    assert!(
        queue.replace(a, |old| old.number == 3, job(a, 4, 1), MS).is_err(),
        "it is being drawn"
    );
}

#[test]
fn a_busy_client_has_a_batch_to_itself_only_while_it_is_alone() {
    let mut queue = queue(64);
    let [other, busy] = [1, 2].map(Client::Caller);
    for number in 0..40 {
        assert!(admit(&mut queue, busy, number, SHARE_NS / 2));
    }
    assert_eq!(taken(&mut queue, 8).batch.len(), 8);
    assert!(admit(&mut queue, other, 100, SHARE_NS));
    // It is early, and who has had much waits.
    assert_eq!(numbers(&taken(&mut queue, 8)), [100, 8, 9]);
    // It is drawn and will be back: the others do not use the gap to take all.
    assert_eq!(numbers(&taken(&mut queue, 8)), [10, 11]);
    for _ in 0..MEMORY {
        assert!(taken(&mut queue, 1).batch.len() == 1);
    }
    assert_eq!(taken(&mut queue, 8).batch.len(), 8);
}

#[test]
fn batches_are_short_while_there_are_streams() {
    let mut queue = queue(64);
    for number in 0..40 {
        assert!(admit(&mut queue, Client::Caller(1), number, 10 * MS));
    }
    let moment = idle(Instant::now());
    assert_eq!(queue.take(16, moment).batch.len(), (BATCH_NS / 10 / MS) as usize);
    let watched = Moment { are_streams_open: true, ..moment };
    assert_eq!(queue.take(16, watched).batch.len(), (INTERACTIVE_BATCH_NS / 10 / MS) as usize);
}

/// Encoders that are behind hold back the frames of jobs alone, and what is held back earns nothing.
#[test]
fn encoders_that_are_behind_hold_jobs_back() {
    let mut queue = queue(64);
    let held = Moment { are_jobs_held: true, ..idle(Instant::now()) };
    assert_eq!(queue.take(8, held).held_for, None, "nothing waits");
    for number in 0..8 {
        assert!(admit(&mut queue, Client::Job(0), number, 4 * MS));
    }
    let found = queue.take(8, held);
    assert!(found.batch.is_empty() && found.held_for.is_some(), "{found:?}");
    for number in 100..200 {
        assert!(admit(&mut queue, Client::Caller(1), number, 100 * MS));
        assert_eq!(numbers(&queue.take(1, held)), [number]);
    }
    assert!(queue.credit_ns <= 0, "{}", queue.credit_ns);
    assert!(!taken(&mut queue, 8).batch.is_empty(), "there is room again");
}

#[test]
fn jobs_take_what_is_left() {
    let mut queue = queue(64);
    let (stream, film) = (stream_of(0), Client::Job(0));
    for number in 0..20 {
        assert!(admit(&mut queue, film, number, 4 * MS));
    }
    let alone = taken(&mut queue, 8).batch;
    assert_eq!(alone.len(), 8, "nobody else is about");
    assert!(admit(&mut queue, stream, 100, 20 * MS));
    let moment = Moment { flying_ns: MS, are_jobs_flying: true, ..idle(Instant::now()) };
    assert_eq!(numbers(&queue.take(8, moment)), [100], "the stream is first");
    assert!(
        queue.take(8, moment).batch.is_empty(),
        "no second batch of jobs before the stream's next"
    );
    let landed = Moment { are_jobs_flying: false, ..moment };
    assert!(queue.take(8, landed).batch.is_empty(), "nor behind the stream's frame");
    let rest = queue.take(8, idle(Instant::now())).batch;
    assert_eq!(
        rest.len(),
        (JOB_BATCH_NS / 4 / MS) as usize,
        "a short one, for the stream will be back"
    );
}

#[test]
fn a_full_queue_lets_those_in_who_have_nothing_waiting() {
    let mut queue = queue(2);
    let busy = Client::Caller(0);
    for number in 0..2 {
        assert!(admit(&mut queue, busy, number, 1));
    }
    assert!(!admit(&mut queue, busy, 2, 1));
    for who in 1..=2 {
        let who = Client::Caller(who);
        assert!(admit(&mut queue, who, 3, 1));
        assert!(!admit(&mut queue, who, 4, 1));
    }
    assert!(!admit(&mut queue, Client::Caller(3), 5, 1), "memory stays bounded");
    assert!(admit(&mut queue, Client::Job(0), 6, 1), "jobs have places of their own");
    assert!(!admit(&mut queue, Client::Job(0), 7, 1));
}

#[test]
fn what_waits_is_bounded_in_time_as_well() {
    let shares = Shares { capacity: 100, capacity_ns: 100 * MS, jobs: 0.1, batch_ns: BATCH_NS };
    let mut queue: Queue<Job> = Queue::new(shares);
    let [a, b, c] = [1, 2, 3].map(Client::Caller);
    assert!(admit(&mut queue, a, 1, 500 * MS), "what costs more than may wait waits alone");
    assert!(!admit(&mut queue, a, 2, MS) && !admit(&mut queue, b, 3, MS));
    assert_eq!(taken(&mut queue, 1).batch.len(), 1);
    assert!(admit(&mut queue, a, 4, 60 * MS) && !admit(&mut queue, a, 5, 60 * MS));
    assert!(admit(&mut queue, b, 6, 60 * MS) && !admit(&mut queue, b, 7, MS));
    assert!(!admit(&mut queue, c, 8, 100 * MS) && admit(&mut queue, c, 9, 60 * MS));
}

#[test]
fn waits_are_as_clients_share() {
    let mut queue = queue(64);
    let [a, b, c] = [1, 2, 3].map(Client::Caller);
    for number in 0..10 {
        assert!(admit(&mut queue, a, number, 10 * MS));
    }
    assert!(admit(&mut queue, b, 10, 4 * MS));
    let now = Instant::now();
    let ahead = |queue: &Queue<Job>, who, cost| queue.ahead_ns(who, None, cost * MS, now) / MS;
    assert_eq!(ahead(&queue, a, 10), 104, "its own, and of the other what there is");
    assert_eq!(ahead(&queue, b, 10), 4 + 14, "as much of the other as of its own");
    assert_eq!(ahead(&queue, c, 10), 10 + 4);
    assert_eq!(ahead(&queue, Client::Job(0), 10), 90, "all of the others but its share");
    queue.set_flying_ns(7 * MS);
    assert_eq!(ahead(&queue, c, 10), 21);
    let soon = Some(now + Duration::from_secs(1));
    assert_eq!(queue.ahead_ns(a, soon, 10 * MS, now) / MS, 7 + 4, "before its own others");
}

#[test]
fn lateness_is_judged_only_behind_others() {
    let (now, ms) = (Instant::now(), Duration::from_millis);
    let at = |deadline: u64, wait: u64, own: u64| {
        lateness(Some(now + ms(deadline)), now, ms(wait), ms(own))
    };
    assert_eq!(at(100, 50, 50), None);
    assert_eq!(at(100, 80, 50), Some(ms(30)));
    assert_eq!(at(1, 0, 50), None, "to try costs nobody anything");
    assert_eq!(lateness(None, now, ms(1000), ms(1000)), None);
}
