//! Places of a simulation where work waits: servers in a row, and cores that all tasks share.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// A queue in order of arrival before one or several equal servers.
#[derive(Clone, Debug)]
pub struct Station {
    /// When each server is free.
    free_ns: BinaryHeap<Reverse<u64>>,
    booked_ns: u64,
    served: u64,
}

impl Station {
    pub fn new(servers: usize) -> Station {
        Station {
            free_ns: (0..servers.max(1)).map(|_| Reverse(0)).collect(),
            booked_ns: 0,
            served: 0,
        }
    }

    /// Adds work that arrives now, and returns when it is done. Calls come in order of time.
    pub fn serve(&mut self, now_ns: u64, work_ns: u64) -> u64 {
        let Reverse(free_ns) = self.free_ns.pop().unwrap_or_default();
        let done_ns = free_ns.max(now_ns) + work_ns;
        self.free_ns.push(Reverse(done_ns));
        self.booked_ns += work_ns;
        self.served += 1;
        done_ns
    }

    /// Closes the station until `until_ns`.
    pub fn close(&mut self, until_ns: u64) {
        let free = self.free_ns.drain().map(|Reverse(free_ns)| Reverse(free_ns.max(until_ns)));
        self.free_ns = free.collect::<Vec<_>>().into();
    }

    /// Returns the time that servers have worked until `now_ns`, which is no earlier than the latest arrival.
    pub fn busy_ns(&self, now_ns: u64) -> u64 {
        let ahead = self.free_ns.iter().map(|Reverse(free_ns)| free_ns.saturating_sub(now_ns));
        self.booked_ns.saturating_sub(ahead.sum())
    }

    pub fn servers(&self) -> usize {
        self.free_ns.len()
    }

    /// Returns the number of arrivals.
    pub fn served(&self) -> u64 {
        self.served
    }
}

/// Cores that tasks share equally (processor sharing). A task uses as many cores at a time as it can.
#[derive(Clone, Debug)]
pub struct Cores {
    cores: f64,
    tasks: BTreeMap<u64, Task>,
    now_ns: u64,
    used_ns: f64,
}

#[derive(Clone, Copy, Debug)]
struct Task {
    left_ns: f64,
    most_cores: f64,
}

impl Cores {
    pub fn new(cores: f64) -> Cores {
        Cores { cores: cores.max(1e-3), tasks: BTreeMap::new(), now_ns: 0, used_ns: 0.0 }
    }

    /// Returns the number of cores that each task has: tasks that can use fewer leave the rest to the others.
    fn shares(&self) -> BTreeMap<u64, f64> {
        let mut order: Vec<(u64, f64)> =
            self.tasks.iter().map(|(id, task)| (*id, task.most_cores)).collect();
        order.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut left = self.cores;
        let mut others = order.len();
        let mut shares = BTreeMap::new();
        for (id, most) in order {
            let share = most.min(left / others as f64);
            shares.insert(id, share);
            left -= share;
            others -= 1;
        }
        shares
    }

    fn advance(&mut self, now_ns: u64) {
        let passed = now_ns.saturating_sub(self.now_ns) as f64;
        for (id, share) in self.shares() {
            if let Some(task) = self.tasks.get_mut(&id) {
                task.left_ns -= passed * share;
                self.used_ns += passed * share;
            }
        }
        self.now_ns = self.now_ns.max(now_ns);
    }

    /// Begins a task of `work_ns` of one core's time.
    pub fn begin(&mut self, now_ns: u64, id: u64, work_ns: u64, most_cores: f64) {
        self.advance(now_ns);
        self.tasks.insert(id, Task { left_ns: work_ns as f64, most_cores: most_cores.max(1e-3) });
    }

    /// Ends a task that is not finished.
    pub fn stop(&mut self, now_ns: u64, id: u64) {
        self.advance(now_ns);
        self.tasks.remove(&id);
    }

    /// Returns the tasks that are finished.
    pub fn finished(&mut self, now_ns: u64) -> Vec<u64> {
        self.advance(now_ns);
        let is_done = |task: &Task| task.left_ns < 1.0;
        let done = self.tasks.iter().filter(|(_, task)| is_done(task)).map(|(id, _)| *id);
        let done: Vec<u64> = done.collect();
        self.tasks.retain(|_, task| !is_done(task));
        done
    }

    /// Returns when the next task is finished if none begins before.
    pub fn next_ns(&self) -> Option<u64> {
        let shares = self.shares();
        let time =
            |(id, task): (&u64, &Task)| task.left_ns / shares.get(id).copied().unwrap_or(1.0);
        let least = self.tasks.iter().map(time).min_by(f64::total_cmp)?;
        Some(self.now_ns + least.max(0.0).ceil() as u64)
    }

    /// Returns the cores' time that tasks have used.
    pub fn used_ns(&self) -> f64 {
        self.used_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stations_serve_in_order_with_all_their_servers() {
        let mut station = Station::new(2);
        let done: Vec<u64> = [10, 10, 5, 5].map(|work| station.serve(100, work)).into();
        assert_eq!(done, [110, 110, 115, 115]);
        assert_eq!([100, 105, 112, 115, 200].map(|now| station.busy_ns(now)), [0, 10, 24, 30, 30]);
        station.close(300);
        assert_eq!((station.serve(250, 7), station.served(), station.servers()), (307, 5, 2));
    }

    #[test]
    fn cores_are_shared_equally_and_none_is_lost() {
        let mut cores = Cores::new(2.0);
        cores.begin(0, 1, 1000, 1.0);
        // One task cannot use both cores.
        assert_eq!(cores.next_ns(), Some(1000));
        cores.begin(500, 2, 3000, 8.0);
        cores.begin(500, 3, 300, 8.0);
        // Each has two thirds of a core.
        assert_eq!(cores.next_ns(), Some(950));
        assert_eq!(cores.finished(950), [3]);
        assert_eq!(cores.next_ns(), Some(1150));
        assert_eq!(cores.finished(1150), [1]);
        cores.stop(1150, 2);
        assert_eq!(cores.next_ns(), None);
        assert!((cores.used_ns() - (500.0 + 2.0 * 650.0)).abs() < 1.0, "{}", cores.used_ns());
    }
}
