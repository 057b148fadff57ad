use super::*;

const MS: u64 = 1_000_000;
const JOB: Client = Client::Job(1);
const STREAM: Client = Client::Stream { of: 1, number: 1 };

#[derive(Debug, PartialEq)]
struct Frame(u32);

impl Waiting for Frame {
    fn is_abandoned(&self) -> bool {
        false
    }
    fn deadline(&self) -> Option<Instant> {
        None
    }
    fn pixels(&self) -> u64 {
        1
    }
}

/// Clients whose frames take so many milliseconds.
struct Bench {
    queue: EncodeQueue<Frame>,
    now: Instant,
    running: Vec<Granted<Frame>>,
}

fn key(client: Client) -> CostKey {
    let kind = match client {
        Client::Unnamed => 0,
        Client::Caller(n) | Client::Job(n) | Client::Stream { number: n, .. } => n,
    };
    CostKey { kind: 4 * kind + client.class() as u64, pixels: 1 }
}

impl Bench {
    fn new(encoders: usize) -> Bench {
        let queue = EncodeQueue::new(encoders, 0.1);
        Bench { queue, now: Instant::now(), running: Vec::new() }
    }

    fn push(&mut self, client: Client, count: u32) {
        for number in 0..count {
            self.queue.push(client, Frame(number), key(client), self.now);
        }
    }

    /// All frames that threads may begin.
    fn begin(&mut self) -> Vec<Client> {
        let begun: Vec<_> = std::iter::from_fn(|| self.queue.take()).collect();
        let clients = begun.iter().map(|granted| granted.client).collect();
        self.running.extend(begun);
        clients
    }

    fn end(&mut self, ms: impl Fn(Client) -> u64) {
        let Granted { client, cost_ns, .. } = self.running.remove(0);
        self.queue.done(client, cost_ns, key(client), ms(client) * MS);
    }
}

#[test]
fn jobs_leave_threads_to_more_urgent_frames() {
    for encoders in 1..4 {
        let mut bench = Bench::new(encoders);
        bench.push(JOB, 9);
        assert_eq!(bench.begin(), vec![JOB; encoders], "no more of jobs at once");
        assert!(!bench.queue.has_room(Class::Job) || encoders > 1);
        assert!(bench.queue.has_room(Class::Request));
        bench.push(Client::Caller(2), 3);
        assert_eq!(bench.begin(), [Client::Caller(2)]);
        bench.push(STREAM, 2);
        assert_eq!(bench.begin(), [STREAM], "there is a thread for streams alone");
        assert_eq!(bench.running.len(), bench.queue.threads());
        // Others have waited longer, and may not have the stream's thread when it is free.
        let last = bench.running.len() - 1;
        bench.running.swap(0, last);
        bench.end(|_| 1);
        assert_eq!(bench.begin(), [STREAM]);
    }
}

#[test]
fn requests_come_before_jobs_and_leave_them_a_share() {
    let mut bench = Bench::new(1);
    let mut got = [0; 2];
    for round in 0..4000 {
        let lacks = |side: &Lanes<Frame>| u32::from(side.len() < 3);
        let (jobs, requests) = (lacks(&bench.queue.jobs), lacks(&bench.queue.first));
        bench.push(JOB, jobs);
        bench.push(Client::Caller(2), requests);
        for client in bench.begin() {
            // The first frames are charged what a frame costs of which nothing is known.
            got[usize::from(client == JOB)] += u64::from(round > 200);
        }
        bench.end(|client| if client == JOB { 40 } else { 8 });
    }
    let share = 40.0 * got[1] as f64 / (40.0 * got[1] as f64 + 8.0 * got[0] as f64);
    assert!((0.08..0.12).contains(&share), "{share}: {got:?}");
}

#[test]
fn clients_share_by_time() {
    let mut bench = Bench::new(2);
    let clients = [Client::Caller(1), Client::Caller(2), Client::Caller(3)];
    let ms = |client: Client| if client == clients[0] { 90 } else { 10 };
    let mut got = [0u64; 3];
    for client in clients {
        bench.push(client, 3);
    }
    for _ in 0..4000 {
        for client in bench.begin() {
            bench.push(client, 1);
            let at = clients.iter().position(|other| *other == client).unwrap();
            got[at] += ms(client);
        }
        bench.end(ms);
    }
    let (least, most) = (got.iter().min().unwrap(), got.iter().max().unwrap());
    assert!(most - least < most / 20, "{got:?}");
}

#[test]
fn a_frame_that_somebody_else_asks_for_comes_forward() {
    let mut bench = Bench::new(1);
    bench.push(JOB, 3);
    assert_eq!(bench.begin(), [JOB]);
    let key = key(JOB);
    bench.queue.advance(JOB, Client::Caller(2), |frame| frame.0 == 2, key, bench.now);
    assert_eq!(bench.begin(), [Client::Caller(2)]);
    assert_eq!(bench.running[1].job, Frame(2));
    assert_eq!(bench.queue.jobs.len(), 1);
}
