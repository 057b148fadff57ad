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
    if number.is_multiple_of(2) { Client::Caller(number) } else { Client::Stream(number) }
}

/// The same cases on every machine.
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
    /// Of a client's waiting jobs, by its place among them.
    Replace {
        client: u64,
        place: usize,
        pixels: u64,
    },
    Remove {
        client: u64,
        place: usize,
    },
    Take,
    /// The last batch comes back.
    PutBack,
}

fn step() -> impl Strategy<Value = Step> {
    let client = 0u64..5;
    prop_oneof![
        6 => (client.clone(), any::<bool>(), 0u8..3, 1u64..600_000).prop_map(|(client, gone, deadline, pixels)| {
            Step::Admit { client, abandoned: gone && deadline == 0, deadline, pixels }
        }),
        3 => (client.clone(), 0usize..3, 1u64..600_000)
            .prop_map(|(client, place, pixels)| Step::Replace { client, place, pixels }),
        1 => (client, 0usize..3).prop_map(|(client, place)| Step::Remove { client, place }),
        4 => Just(Step::Take),
        1 => Just(Step::PutBack),
    ]
}

proptest! {
    #![proptest_config(config(400))]
    #[test]
    fn no_job_is_lost_or_doubled_and_none_overtakes_another_of_its_client(
        capacity in 1usize..20,
        max in 1usize..9,
        steps in prop::collection::vec(step(), 1..150),
    ) {
        let start = Instant::now();
        let now = start + Duration::from_secs(10);
        let mut queue = Queue::new(capacity);
        let (mut admitted, mut out) = (Vec::new(), Vec::new());
        let mut last: Vec<Job> = Vec::new();
        // What waits in each lane, as it should be.
        let mut lanes: HashMap<Client, Vec<usize>> = HashMap::new();
        for (number, step) in steps.into_iter().enumerate() {
            match step {
                Step::Admit { client: who, abandoned, deadline, pixels } => {
                    let who = client(who);
                    let deadline = match deadline { 0 => None, 1 => Some(start), _ => Some(now + Duration::from_secs(1)) };
                    let job = Job { number, client: who, abandoned, deadline, pixels };
                    let was_empty = lanes.get(&who).is_none_or(Vec::is_empty);
                    let (result, dropped) = queue.admit(who, job.clone());
                    prop_assert!(dropped.iter().all(|job| job.abandoned));
                    for gone in dropped {
                        lanes.entry(gone.client).or_default().retain(|number| *number != gone.number);
                        out.push(gone.number);
                    }
                    match result {
                        Ok(()) => {
                            admitted.push(number);
                            lanes.entry(who).or_default().push(number);
                            prop_assert!(queue.len() <= capacity || was_empty || lanes[&who].len() == 1);
                        }
                        Err(back) => { prop_assert_eq!(back, job); prop_assert!(queue.len() >= capacity); }
                    }
                }
                Step::Replace { client: who, place, pixels } => {
                    let who = client(who);
                    let old = lanes.get(&who).and_then(|lane| lane.get(place)).copied();
                    let before = queue.len();
                    let new = Job { number, client: who, abandoned: false, deadline: None, pixels };
                    match (old, queue.replace(who, |job| Some(job.number) == old, new)) {
                        (Some(old), Ok(found)) => {
                            prop_assert_eq!(found.number, old);
                            out.push(old);
                            admitted.push(number);
                            lanes.get_mut(&who).unwrap()[place] = number;
                        }
                        (None, Err(back)) => prop_assert_eq!(back.number, number),
                        other => prop_assert!(false, "{other:?}"),
                    }
                    prop_assert_eq!(queue.len(), before);
                }
                Step::Remove { client: who, place } => {
                    let who = client(who);
                    let old = lanes.get(&who).and_then(|lane| lane.get(place)).copied();
                    let removed = queue.remove(who, |job| Some(job.number) == old).map(|job| job.number);
                    prop_assert_eq!(removed, old);
                    if let Some(old) = old {
                        lanes.get_mut(&who).unwrap().remove(place);
                        out.push(old);
                    }
                }
                Step::PutBack => {
                    out.retain(|number| last.iter().all(|job| job.number != *number));
                    queue.put_back(std::mem::take(&mut last));
                }
                Step::Take => {
                    let taken = queue.take(max, now);
                    prop_assert!(taken.batch.len() <= max);
                    let pixels: u64 = taken.batch.iter().map(|job| job.pixels).sum();
                    prop_assert!(taken.batch.len() <= 1 || pixels <= BATCH_PIXELS);
                    prop_assert!(taken.batch.iter().all(|job| !job.abandoned && job.deadline.is_none_or(|d| d > now)));
                    for job in taken.batch.iter().chain(&taken.expired).chain(&taken.abandoned) {
                        lanes.entry(job.client).or_default().retain(|number| *number != job.number);
                        out.push(job.number);
                    }
                    last = taken.batch;
                    // In order, but for what had been put back and so was before everybody.
                    for job in &last {
                        prop_assert!(lanes[&job.client].iter().all(|later| *later != job.number));
                    }
                }
            }
            prop_assert!(queue.len() <= 2 * capacity + max);
        }
        out.extend(queue.drain().into_iter().map(|job| job.number));
        prop_assert!(queue.is_empty());
        out.sort_unstable();
        admitted.sort_unstable();
        prop_assert_eq!(out, admitted);
    }
}

proptest! {
    #![proptest_config(config(200))]
    /// Streams, with one job waiting each and the next asked for as soon as that is taken, against callers that always have
    /// many: all have a part in equally many batches.
    #[test]
    fn nobody_starves_and_shares_are_fair(
        streams in 0u64..6,
        callers in 1u64..4,
        max in 1usize..17,
        pixels in prop::collection::vec(1u64..400_000, 10),
        rounds in 40usize..80,
    ) {
        let clients: Vec<Client> =
            (0..streams).map(Client::Stream).chain((0..callers).map(Client::Caller)).collect();
        let pixels: HashMap<Client, u64> = clients.iter().copied().zip(pixels).collect();
        let mut queue = Queue::new(64);
        let mut number = 0;
        let mut served: HashMap<Client, u64> = clients.iter().map(|client| (*client, 0)).collect();
        let mut since: HashMap<Client, usize> = served.keys().map(|client| (*client, 0)).collect();
        for _ in 0..rounds {
            for &client in &clients {
                let most = if matches!(client, Client::Stream(_)) { 1 } else { 12 };
                while queue.lanes.get(&client).map_or(0, VecDeque::len) < most {
                    number += 1;
                    prop_assert!(queue.admit(client, job(client, number, pixels[&client])).0.is_ok());
                }
            }
            let taken = queue.take(max, Instant::now());
            prop_assert!(!taken.batch.is_empty());
            for (client, since) in &mut since {
                let has = taken.batch.iter().any(|job| job.client == *client);
                *since = if has { 0 } else { *since + 1 };
                *served.get_mut(client).unwrap() += u64::from(has);
                // Every batch serves at least one, and each at most one turn after all others.
                prop_assert!(*since <= clients.len(), "{client:?} waits for {since} batches");
            }
        }
        let (least, most) = (served.values().min().unwrap(), served.values().max().unwrap());
        prop_assert!(*most <= least + 2, "{served:?}");
    }
}

#[test]
fn what_is_put_back_comes_first_and_in_order() {
    let job = |number| job(Client::Unnamed, number, 1);
    let mut queue = Queue::new(2);
    assert!(queue.admit(Client::Unnamed, job(3)).0.is_ok());
    queue.put_back(vec![job(1), job(2)]);
    let taken = queue.take(8, Instant::now());
    assert_eq!(taken.batch.iter().map(|job| job.number).collect::<Vec<_>>(), [1, 2, 3]);
}

fn numbers(taken: &Taken<Job>) -> Vec<usize> {
    taken.batch.iter().map(|job| job.number).collect()
}

#[test]
fn clients_take_turns_and_keep_their_order() {
    let mut queue = Queue::new(16);
    let [a, b, c] = [1, 2, 3].map(client);
    for (who, number) in [(a, 10), (a, 11), (a, 12), (b, 20), (c, 30), (c, 31)] {
        assert!(queue.admit(who, job(who, number, 1)).0.is_ok());
    }
    assert_eq!(numbers(&queue.take(4, Instant::now())), [10, 20, 30, 11]);
    assert_eq!(numbers(&queue.take(4, Instant::now())), [31, 12]);
}

#[test]
fn a_replaced_job_keeps_its_turn() {
    let mut queue = Queue::new(16);
    let [a, b] = [1, 2].map(client);
    assert!(queue.admit(a, job(a, 1, 1)).0.is_ok());
    assert!(queue.admit(b, job(b, 2, 1)).0.is_ok());
    let old = queue.replace(a, |old| old.number == 1, job(a, 3, 1)).unwrap();
    assert_eq!(old.number, 1);
    assert_eq!(numbers(&queue.take(1, Instant::now())), [3]);
    assert!(queue.replace(a, |old| old.number == 3, job(a, 4, 1)).is_err(), "it is being drawn");
}

#[test]
fn a_busy_client_has_a_batch_to_itself_only_while_it_is_alone() {
    let mut queue = Queue::new(64);
    let [stream, busy] = [Client::Stream(1), Client::Caller(2)];
    for number in 0..40 {
        assert!(queue.admit(busy, job(busy, number, SHARE_PIXELS / 2)).0.is_ok());
    }
    assert_eq!(queue.take(8, Instant::now()).batch.len(), 8);
    assert!(queue.admit(stream, job(stream, 100, SHARE_PIXELS)).0.is_ok());
    assert_eq!(numbers(&queue.take(8, Instant::now())), [8, 100, 9]);
    // The stream is drawn and will be back: the others do not use the gap to take all.
    assert_eq!(numbers(&queue.take(8, Instant::now())), [10, 11]);
    for _ in 0..MEMORY {
        assert!(queue.take(1, Instant::now()).batch.len() == 1);
    }
    assert_eq!(queue.take(8, Instant::now()).batch.len(), 8);
}

#[test]
fn a_full_queue_lets_those_in_who_have_nothing_waiting() {
    let mut queue = Queue::new(2);
    let busy = Client::Caller(0);
    for number in 0..2 {
        assert!(queue.admit(busy, job(busy, number, 1)).0.is_ok());
    }
    assert!(queue.admit(busy, job(busy, 2, 1)).0.is_err());
    for who in 1..=2 {
        let who = Client::Caller(who);
        assert!(queue.admit(who, job(who, 3, 1)).0.is_ok());
        assert!(queue.admit(who, job(who, 4, 1)).0.is_err());
    }
    let late = Client::Caller(3);
    assert!(queue.admit(late, job(late, 5, 1)).0.is_err(), "memory stays bounded");
}
